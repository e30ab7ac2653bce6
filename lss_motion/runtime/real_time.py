"""What an ordinary computer can be asked for, so that a show is on time beside other programs.

Real-time priority lets the player run before any ordinary program; locked memory is never waited
for. Both need a permission on most systems, and a show plays without them: what is refused is said.
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
"""Of 0 to 19. Chosen: a tenth of the weight of an ordinary program, on a busy computer still a
few frames a second."""
PRIORITY: Final = 20
"""Of 1 to 99 (SCHED_FIFO). Chosen: before all programs, behind the kernel's own threads at 50."""
SLICE_NS: Final = 100 * NS_PER_US
"""The shortest that Linux knows (sched_setattr(2)). Measured beside two busy programs on two cores,
91 commands a second: the latest of a thousand left 5 to 6 ms late, without it 8 ms."""
_PR_SET_TIMERSLACK: Final = 29
_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274, "armv7l": 380, "armv6l": 380}
"""Numbers of the system call, which few C libraries wrap (Linux, asm/unistd.h)."""
_SCHED_ATTR: Final = struct.Struct("=IIQiIQQQII")
"""`struct sched_attr` with its size, policy, flags, niceness, priority, runtime, deadline, period
and utilisation (Linux, sched_setattr(2))."""
_MCL_CURRENT: Final = 1
_MCL_FUTURE: Final = 2


@contextlib.contextmanager
def real_time(*, is_wanted: bool = True) -> Iterator[list[str]]:
    """Ask for real-time priority and locked memory meanwhile; yield what was refused, as text.

    Processes that are started meanwhile have ordinary priority.
    """
    refused: list[str] = []
    with contextlib.ExitStack() as stack:
        if is_wanted:
            _raise_priority(stack, refused)
            _lock_memory(stack, refused)
        yield refused


def lower_priority() -> None:
    """Let this process never interrupt another: a helper of the player that has time.

    What the player hands over wakes its helper, which an ordinary scheduler lets run first.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICENESS)


@contextlib.contextmanager
def prompt_waits() -> Iterator[None]:
    """Ask Linux meanwhile to end every wait on the instant; it takes no permission.

    Waits are rounded up to 50 us unless asked not to. And since Linux 6.12 an ordinary process may
    say how long it will need a processor: one that needs little interrupts one that needs more.
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
    """0 asks for the default again."""
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError, AttributeError):
        _libc().prctl(_PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)


def _set_slice(slice_ns: int) -> bool:
    """Set how long an ordinary process runs at a time; 0 asks for the default again.

    Return whether that was done: not where there is no such call, nor with real-time priority.
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
    # Not every system that has the call has the flag.
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
            "memory is not locked: the system does not permit so much. On Linux add the line "
            f"`{_user()} - memlock unlimited` to /etc/security/limits.conf and log in again"
        )
        return
    stack.callback(_libc().munlockall)


def _libc() -> Any:  # noqa: ANN401  whatever the C library has
    import ctypes

    return ctypes.CDLL(None)


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "YOU"
