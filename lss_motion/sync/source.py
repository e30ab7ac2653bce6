"""The end of a run that follows: starts the process that reads timecode, and leads the player.

`FollowControls` stands between what a person does (`inner`) and the player: a pause of the person
holds the show whatever the leader does.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any, Final, Protocol

from lss_motion.errors import InputError
from lss_motion.player.show_clock import Leg
from lss_motion.remote.schema import Follow, parse_operation
from lss_motion.sync.receive import spec_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.player.following import Following
    from lss_motion.player.player import Player
    from lss_motion.runtime.runner import Controls
    from lss_motion.sync.options import FollowSpec

COMMAND: Final = (sys.executable, "-P", "-m", "lss_motion.sync.receive")
"""-P: no module of the current folder is imported in place of an installed one."""
OPEN_S: Final = 10.0
"""The longest time that a source may take to open."""
READ_BYTES: Final = 65536
END_S: Final = 1.0


class TimecodeSource:
    """A process that reads one source of timecode. A context manager; `take` never waits."""

    def __init__(self, spec: FollowSpec) -> None:
        """Start it, and wait until the source is open; raises `InputError` if it is not."""
        self.text = ""
        """What is read, for a person."""
        self._rest = b""
        self._texts: list[str] = []
        self._process: subprocess.Popen[bytes] | None = subprocess.Popen(  # noqa: S603
            [*COMMAND, spec_text(spec)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # Drivers print there whatever they try.
            start_new_session=True,  # Ctrl-C ends the player only; this ends with its pipe.
        )
        assert self._process.stdout is not None
        self._fd = self._process.stdout.fileno()
        os.set_blocking(self._fd, False)
        end_s = time.monotonic() + OPEN_S
        while not self.text and self._process is not None:
            left_s = max(end_s - time.monotonic(), 0.0)
            if not select.select([self._fd], [], [], left_s)[0]:
                self._texts.append(f"the source does not open within {OPEN_S:g} s")
                break
            self.take()
        if not self.text:
            self.close()
            raise InputError(f"--follow {spec.kind}: {'; '.join(self._texts)}")

    def filenos(self) -> list[int]:
        """Return what ends a wait."""
        return [] if self._process is None else [self._fd]

    def take(self) -> list[Follow]:
        """Return what came since the last call, oldest first."""
        try:
            data = os.read(self._fd, READ_BYTES) if self._process is not None else b""
        except BlockingIOError:
            return []
        if not data:
            if self._process is not None:
                self.close()
                self._texts.append("the process that reads timecode has ended")
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        found = []
        for line in lines:
            values: dict[str, Any] = json.loads(line)
            match values:
                case {"op": "follow"}:
                    operation = parse_operation(line)
                    assert isinstance(operation, Follow)
                    found.append(operation)
                case {"ready": text}:
                    self.text = str(text)
                case {"failed": text} | {"text": text}:
                    self._texts.append(str(text))
                case _:
                    pass
        return found

    def take_texts(self) -> list[str]:
        """Return what a person should know, since the last call."""
        texts, self._texts = self._texts, []
        return texts

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def __enter__(self) -> TimecodeSource:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class Legs(Protocol):
    """Where legs come from: a `TimecodeSource`, or a test."""

    def filenos(self) -> Sequence[int]: ...

    def take(self) -> Sequence[Follow]: ...

    def take_texts(self) -> Sequence[str]: ...


class FollowControls:
    """Controls of a run that follows. Keys of a person go through `inner`."""

    def __init__(
        self,
        following: Following,
        legs: Legs,
        *,
        inner: Controls[Any] | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self.following = following
        self._legs = legs
        self._inner = inner
        self._tell = tell

    def filenos(self) -> Sequence[int]:
        inner = () if self._inner is None else self._inner.filenos()
        return [*self._legs.filenos(), *inner]

    def act(self, player: Player, now_ns: int) -> None:
        """Apply what the person and the leader have done since the last call."""
        if self._inner is not None:
            self._inner.act(_PausedByPerson(player, self.following), now_ns)
        for leg in self._legs.take():
            self.following.lead(Leg(leg.instant_ns, leg.show_s, leg.rate), now_ns)
        self.following.turn(player, now_ns)
        for text in (*self._legs.take_texts(), *self.following.take_texts()):
            if self._tell is not None:
                self._tell(text)


class _PausedByPerson:
    """A player as a person steers it while it follows: there is only pause, and go on."""

    def __init__(self, player: Player, following: Following) -> None:
        self._player, self._following = player, following

    def set_rate(self, rate: float, now_ns: int) -> None:  # noqa: ARG002
        """Pause at rate 0; the speed is that of the leader."""
        self._following.set_paused(is_paused=rate == 0.0)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._player, name)
