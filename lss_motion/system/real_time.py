"""Requests to the operating system that keep a show on time beside other programs.

With real-time priority the player runs before any ordinary program; locked memory is never
swapped out. Most systems require a permission for both, and a show plays without them: each
refusal is returned as a text.
"""

from __future__ import annotations

import contextlib
import os
import platform
import struct
import sys
from typing import TYPE_CHECKING, Any, Final

from lss_motion.units import NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Iterator

NICENESS: Final = 10
"""Of 0 to 19. Chosen: a tenth of the weight of an ordinary program, which still gives a few frames
a second on a busy computer."""
PRIORITY: Final = 20
"""Of 1 to 99 (SCHED_FIFO). Chosen: before all programs, behind the kernel's own threads at 50."""
SLICE_NS: Final = 100 * NS_PER_US
"""The shortest that Linux accepts (sched_setattr(2)). Measured beside two busy programs on two
cores, at 91 commands a second: the latest of a thousand left 5 to 6 ms late, without it 8 ms."""
_PR_SET_TIMERSLACK: Final = 29
_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274, "armv7l": 380, "armv6l": 380}
"""Numbers of the system call, for which few C libraries have a function (Linux, asm/unistd.h)."""
_SCHED_ATTR: Final = struct.Struct("=IIQiIQQQII")
"""`struct sched_attr` with its size, policy, flags, niceness, priority, runtime, deadline, period
and utilisation (Linux, sched_setattr(2))."""
_MCL_CURRENT: Final = 1
_MCL_FUTURE: Final = 2


@contextlib.contextmanager
def real_time(*, is_wanted: bool = True) -> Iterator[list[str]]:
    """Request real-time priority and locked memory inside the block; yield the refusals.

    Processes that are started inside the block get ordinary priority.
    """
    refused: list[str] = []
    with contextlib.ExitStack() as stack:
        if is_wanted:
            _raise_priority(stack, refused)
            _lock_memory(stack, refused)
        yield refused


def lower_priority() -> None:
    """Let this process interrupt no other: for helper processes of the player.

    Data from the player wakes its helper, which an ordinary scheduler then runs first.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICENESS)


@contextlib.contextmanager
def prompt_waits() -> Iterator[None]:
    """Request that waits inside the block end without delay (Linux; needs no permission).

    Linux rounds waits up to 50 us by default. Since Linux 6.12 an ordinary process may also
    state how long it will need a processor: a short request interrupts a longer one.
    """
    _set_timer_slack(1)
    is_brief = _set_slice(SLICE_NS)
    try:
        yield
    finally:
        _set_timer_slack(0)
        if is_brief:
            _set_slice(0)


def _set_timer_slack(slack_ns: int) -> None:
    """Set by how much Linux may round waits up; 0 restores the default."""
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError, AttributeError):
        _libc().prctl(_PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)


def _set_slice(slice_ns: int) -> bool:
    """Set how long an ordinary process runs at a time; 0 restores the default.

    Returns whether it was set: not without the system call, nor with real-time priority.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if not sys.platform.startswith("linux") or number is None:
        return False
    if os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = _SCHED_ATTR.pack(
        _SCHED_ATTR.size, os.SCHED_OTHER, 0, niceness, 0, slice_ns, 0, 0, 0, 0
    )
    try:
        return bool(_libc().syscall(number, 0, attributes, 0) == 0)
    except (OSError, AttributeError):
        return False


def _raise_priority(stack: contextlib.ExitStack, refused: list[str]) -> None:
    if not hasattr(os, "sched_setscheduler"):
        refused.append("no real-time priority: this system offers none to Python")
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    # Some systems have the call without the flag.
    flag = getattr(os, "SCHED_RESET_ON_FORK", 0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | flag, os.sched_param(PRIORITY))
    except OSError:
        refused.append(
            "no real-time priority: the system does not permit it. On Linux add the line "
            f"`{_user()} - rtprio {PRIORITY}` to /etc/security/limits.conf and log in again"
        )
        return

    def restore() -> None:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, policy, parameters)

    stack.callback(restore)


def _lock_memory(stack: contextlib.ExitStack, refused: list[str]) -> None:
    try:
        is_locked = _libc().mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    except (OSError, AttributeError, TypeError):
        refused.append("memory is not locked: this system does not offer it")
        return
    if not is_locked:
        refused.append(
            "memory is not locked: the system does not permit it. On Linux add the line "
            f"`{_user()} - memlock unlimited` to /etc/security/limits.conf and log in again"
        )
        return
    stack.callback(_libc().munlockall)


def _libc() -> Any:  # noqa: ANN401  the functions depend on the C library
    import ctypes

    return ctypes.CDLL(None)


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "YOU"
