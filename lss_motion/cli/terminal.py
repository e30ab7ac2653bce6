"""Keys and signals during a run: space pauses, + and - change the speed, q and Ctrl-C stop.

`Inputs` collects keys and signals and never blocks. `Terminal` turns them into orders for what is
driven.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import time
from typing import TYPE_CHECKING, Any, Final, Protocol, Self, runtime_checkable

from lss_motion.playing.player.events import PlayerRequest, note_nowhere
from lss_motion.playing.sound_choice import OFFSET_STEP_S
from lss_motion.system.reactor import wait_for
from lss_motion.system.signals import ENDING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import FrameType, TracebackType

    from lss_motion.playing.sound_choice import SoundChoice


KEYS_HELP: Final = "space pause, - slower, + up to full speed, q stop"
RATE_STEP: Final = 0.1
RATE_MIN: Final = 0.1
_HANGUP: Final = getattr(signal, "SIGHUP", None)
LOOK_S: Final = 0.02
"""In virtual time the keyboard is looked at so often. Chosen: a person notices no delay, and
there are thousands of turns a second."""
KEYS_MAX: Final = 65536
"""So many keys are taken in a turn; what a terminal holds of a flood is less."""
STOP_KEYS: Final = frozenset("qQ")
_PENDING_MAX: Final = 5
"""One more signal that no call of `take` has collected ends a program that hangs."""


def is_at_keyboard() -> bool:
    """Return whether standard input is a terminal in the foreground, from which keys can be read.

    False on a system without Unix terminals.
    """
    try:
        import termios  # noqa: F401  (Windows has none)

        stdin = sys.stdin.fileno()
        return os.isatty(stdin) and os.tcgetpgrp(stdin) == os.getpgrp()
    except (OSError, ValueError, ImportError):
        return False


class Inputs:
    """Collects keys and signals; a context manager.

    `signal_number` is the last signal that ended the run, or None. In virtual time no wait ends for
    a key, and keys are looked for every `LOOK_S` of the computer's time.
    """

    def __init__(self, *, is_virtual: bool = False) -> None:
        self._is_virtual = is_virtual
        self._look_s = 0.0
        self.signal_number: int | None = None
        self._pending: list[int] = []
        self._has_hung_up = False
        self._stack = contextlib.ExitStack()
        self._keys_fd: int | None = None
        self._wake, self._alarm = socket.socketpair()

    def __enter__(self) -> Self:
        for end in (self._wake, self._alarm):
            end.setblocking(False)  # noqa: FBT003
            self._stack.callback(end.close)
        before = signal.set_wakeup_fd(self._alarm.fileno(), warn_on_full_buffer=False)
        self._stack.callback(signal.set_wakeup_fd, before)
        for number in ENDING:
            if number != _HANGUP or signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                self._stack.callback(signal.signal, number, signal.signal(number, self._note))
        with contextlib.suppress(OSError, ValueError, ImportError):
            self._read_keys()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def filenos(self) -> Sequence[int]:
        """Return the descriptors that become readable when a key or a signal arrives."""
        return [self._wake.fileno()] + ([] if self._keys_fd is None else [self._keys_fd])

    @property
    def has_keys(self) -> bool:
        """True while keys are read, from a terminal in the foreground."""
        return self._keys_fd is not None

    def take(self) -> tuple[int, str]:
        """Return the number of signals since the last call, and the keys."""
        if self._is_virtual and not self._pending:
            now_s = time.monotonic()
            if now_s < self._look_s:
                return 0, ""
            self._look_s = now_s + LOOK_S
        with contextlib.suppress(BlockingIOError):
            self._wake.recv(64)
        count = len(self._pending)
        if count:
            self.signal_number = self._pending[-1]
            del self._pending[:count]
        return count, self._keys()

    def _note(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        if number == _HANGUP:
            # The system and the shell both send it when one terminal is closed.
            if self._has_hung_up:
                return
            self._has_hung_up = True
        self._pending.append(number)
        if len(self._pending) == _PENDING_MAX + 1:  # Once: the end must not be interrupted again.
            raise KeyboardInterrupt

    def _keys(self) -> str:
        """Return all that was typed, so that no key waits behind those before it."""
        keys = b""
        while self._keys_fd is not None and len(keys) < KEYS_MAX and wait_for([self._keys_fd], 0.0):
            typed = b""
            with contextlib.suppress(OSError):
                typed = os.read(self._keys_fd, KEYS_MAX)
            if not typed:
                self._keys_fd = None  # The terminal is closed: no more keys can arrive.
            keys += typed
        return keys.decode("ascii", "ignore")

    def _read_keys(self) -> None:
        """Read single keys from the terminal, if standard input is one in the foreground."""
        import termios
        import tty

        if not is_at_keyboard():
            return
        stdin = sys.stdin.fileno()
        before: list[Any] = termios.tcgetattr(stdin)

        def restore() -> None:
            with contextlib.suppress(termios.error):  # The terminal may be closed.
                termios.tcsetattr(stdin, termios.TCSADRAIN, before)

        self._stack.callback(restore)
        tty.setcbreak(stdin)
        self._keys_fd = stdin


class Stoppable(Protocol):
    """A motion that `Terminal` stops."""

    def stop(self, now_ns: int) -> None: ...


@runtime_checkable
class Steerable(Stoppable, Protocol):
    """A motion that has other speeds, too."""

    def set_rate(self, rate: float, now_ns: int) -> None: ...


class Terminal(Inputs):
    """Turns keys and signals into orders for what is driven.

    The speed never exceeds that of the plan, which is within the limits at that speed only. With
    `on_keys`, that function gets the keys instead. `rate` is set at the first call of `act`. The
    keys , and . shift the sounds of `sound`.
    """

    def __init__(
        self,
        on_keys: Callable[[str], None] | None = None,
        *,
        rate: float = 1.0,
        sound: SoundChoice | None = None,
        is_virtual: bool = False,
    ) -> None:
        super().__init__(is_virtual=is_virtual)
        self.sound = sound
        self._on_keys = on_keys
        self._rate = rate
        self._must_set = rate != 1.0
        self._is_paused = False
        self.note_request: Callable[[PlayerRequest, int], None] = note_nowhere
        """Notes the orders for a log, from which `replay` repeats them."""

    def act(self, driven: Stoppable, now_ns: int) -> None:
        """Apply the keys and signals since the last call."""
        if self._must_set:
            self._must_set = False
            self._set_rate(driven, self._rate, now_ns)
        signals_count, keys = self.take()
        if self._on_keys is not None:
            self._on_keys(keys)
            keys = ""
        stops_count = signals_count + sum(key in STOP_KEYS for key in keys)
        for _ in range(stops_count):
            self.note_request(PlayerRequest("stop"), now_ns)
            driven.stop(now_ns)
        if stops_count == 0:
            for key in keys:
                self._press(key, driven, now_ns)

    def _set_rate(self, driven: Stoppable, rate: float, now_ns: int) -> None:
        if isinstance(driven, Steerable):
            self.note_request(PlayerRequest("rate", (rate,)), now_ns)
            driven.set_rate(rate, now_ns)

    def _press(self, key: str, driven: Stoppable, now_ns: int) -> None:
        match key:
            case " ":
                self._is_paused = not self._is_paused
                self._set_rate(driven, 0.0 if self._is_paused else self._rate, now_ns)
            case "+" | "=" | "-" | "_":
                step = RATE_STEP if key in "+=" else -RATE_STEP
                self._rate = round(min(max(self._rate + step, RATE_MIN), 1.0), 3)
                if not self._is_paused:
                    self._set_rate(driven, self._rate, now_ns)
            case "," | "." if self.sound is not None:
                self.sound.shift(OFFSET_STEP_S if key == "." else -OFFSET_STEP_S)
            case "k" | "K" if self.sound is not None:
                self.sound.is_kept = True
            case _:
                pass
