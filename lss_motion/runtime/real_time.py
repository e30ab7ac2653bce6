"""What an ordinary computer can be asked for, so that a show is on time beside other programs.

Real-time priority lets the player run before any ordinary program; locked memory is never waited
for. Both need a permission on most systems, and a show plays without them: what is refused is said.
"""

from __future__ import annotations

import contextlib
import os
import sys
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

PRIORITY: Final = 20
"""Of 1 to 99 (SCHED_FIFO). Chosen: before all programs, behind the kernel's own threads at 50."""
_PR_SET_TIMERSLACK: Final = 29
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


def set_timer_slack(slack_ns: int) -> None:
    """Linux rounds a wait up to 50 µs unless asked not to; 0 asks for the default again."""
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError, AttributeError):
        _libc().prctl(_PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)


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
