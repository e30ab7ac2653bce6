"""The end of a run: starts the processes that read and send timecode, and leads the player.

`FollowControls` stands between what a person does (`inner`) and the player: a pause of the person
holds the show whatever the leader does. `TimecodeOut.turn` is called on each turn of the loop.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final, Protocol

import msgspec

from lss_motion.errors import InputError
from lss_motion.playing.player.events import PlayerRequest
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.playing.remote.schema import Follow
from lss_motion.stage.timecode import receive, send
from lss_motion.stage.timecode.receive import (
    TimecodeFailed,
    TimecodeLeg,
    TimecodeNews,
    TimecodeOpened,
    TimecodeText,
)
from lss_motion.stage.timecode.send import EndSending, SendLeg
from lss_motion.system.closing import Closing
from lss_motion.system.process import ChildProcess
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.playing.player.following import Following
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.runner import Controls
    from lss_motion.stage.timecode.send import SendOrder
    from lss_motion.stage.timecode.timecode import FollowSpec, SendSpec
    from lss_motion.system.clock_leg import ClockLeg

OPEN_S: Final = 10.0
"""The longest time that a device may take to open."""
END_S: Final = 1.0
AGAIN_NS: Final = 10 * NS_PER_S
"""A source that has gone is opened again this much later. Chosen: a sound card that was unplugged
is back at once, and a start of a process takes a millisecond of the player's."""


class _TimecodeProcess(Closing):
    """One process that reads or sends timecode. Only opening it waits."""

    def __init__(self, module: str, spec: FollowSpec | SendSpec, *, waits: bool = True) -> None:
        """Start it, and wait until it is open; `text` is empty if it failed, or is not yet."""
        self.text = ""
        """What was opened, for a person."""
        self.problems: list[str] = []
        """Why it failed, not yet taken by `take_problems`."""
        self._has_failed = False
        words = msgspec.json.encode(spec).decode()
        child: ChildProcess[TimecodeNews]
        child = ChildProcess(module, words, receives=TimecodeNews, is_quiet=True)
        self._child: ChildProcess[TimecodeNews] | None = child
        end_s = time.monotonic() + OPEN_S
        while waits and not self.text and self._child is not None:
            if time.monotonic() >= end_s:
                self.problems.append(f"it does not open within {OPEN_S:g} s")
                self.close()
            self._note(child.receive_within(end_s - time.monotonic()))

    def filenos(self) -> list[int]:
        """Return what ends a wait."""
        return [] if self._child is None else [self._child.fileno()]

    def take(self) -> list[TimecodeNews]:
        """Return what it has sent since the last call."""
        return [] if self._child is None else self._note(self._child.receive())

    def take_problems(self) -> list[str]:
        """Return why it cannot go on, since the last call."""
        problems, self.problems = self.problems, []
        return problems

    def send(self, order: SendOrder) -> bool:
        """Send an order; False if it does not take it now."""
        return self._child is None or self._child.offer(order) or not self._child.pipe.is_full

    def close(self) -> None:
        """End the process."""
        child, self._child = self._child, None
        if child is not None:
            child.end(END_S)

    def _note(self, arrived: list[TimecodeNews]) -> list[TimecodeNews]:
        """Note what says whether it is open; return all of it."""
        for news in arrived:
            if isinstance(news, TimecodeOpened):
                self.text = news.text
            elif isinstance(news, TimecodeFailed):
                self._has_failed = True
                self.problems.append(news.text)
        if self._child is not None and self._child.has_ended:
            if not self._has_failed:
                self.problems.append("its process has ended")
            self.close()
        return arrived


class TimecodeSource(Closing):
    """One source of timecode, read by a process of its own. A context manager."""

    def __init__(self, spec: FollowSpec, *, is_lasting: bool = False) -> None:
        """Open it; raises `InputError` if that fails.

        A lasting one opens later, and again when it has gone; it tells the same trouble only once.
        """
        self._spec, self._is_lasting = spec, is_lasting
        self._texts: list[str] = []
        self._reported: set[str] = set()
        """Since it was open last."""
        self._open()
        if not is_lasting and not self._process.text:
            reason = "; ".join(self._process.problems)
            raise InputError(f"timecode of {spec.kind} cannot be followed: {reason}")

    def _open(self) -> None:
        self._opened_ns = time.monotonic_ns()
        self._is_named = False
        waits = not self._is_lasting
        self._process = _TimecodeProcess(receive.__name__, self._spec, waits=waits)

    def filenos(self) -> list[int]:
        """Return what ends a wait."""
        return self._process.filenos()

    def take(self) -> list[Follow]:
        """Return what came since the last call, oldest first. Never waits."""
        is_gone = self._is_lasting and not self.filenos()
        if is_gone and time.monotonic_ns() >= self._opened_ns + AGAIN_NS:
            self._open()
        found = []
        for news in self._process.take():
            if isinstance(news, TimecodeLeg):
                found.append(Follow(**msgspec.structs.asdict(news)))
            elif isinstance(news, TimecodeText):
                self._texts.append(news.text)
        return found

    def take_texts(self) -> list[str]:
        """Return what a person should know, since the last call."""
        problems = [f"no timecode is read any more: {one}" for one in self._process.take_problems()]
        texts, self._texts = [*self._texts, *problems], []
        if self._process.text and not self._is_named:
            self._is_named = True
            texts.insert(0, f"follows {self._process.text}")
        if self._is_lasting:
            texts = [text for text in texts if text not in self._reported]
            if self._process.text:
                self._reported.clear()
            self._reported.update(texts)
        return texts

    def close(self) -> None:
        self._process.close()


class TimecodeOut(Closing):
    """Sends timecode from the show clock of one run. A context manager; `turn` never waits."""

    def __init__(self, spec: SendSpec) -> None:
        """Open the receiver; raises `InputError` if that fails."""
        self._process = _TimecodeProcess(send.__name__, spec)
        if not self._process.text:
            reason = "; ".join(self._process.problems)
            raise InputError(f"timecode cannot be sent by {spec.kind}: {reason}")
        self._leg: ClockLeg | None = None
        self._is_ended = False

    @property
    def text(self) -> str:
        """What is sent, for a person."""
        return self._process.text

    def turn(self, player: Player, now_ns: int) -> None:  # noqa: ARG002  (as the loop calls it)
        """Tell the process if the show clock has changed."""
        show = player.show
        if show is None or self._is_ended:
            return
        if player.show_ended_ns is not None:
            self._is_ended = self._process.send(EndSending())
        else:
            self.send_clock(show.clock.leg)

    def send_clock(self, leg: ClockLeg, show: str = "") -> None:
        """Send the clock of a show from now on; the same leg again changes nothing."""
        if leg is not self._leg and self._process.send(SendLeg(leg, show)):
            self._leg = leg

    def close(self) -> None:
        self._process.close()


class LegSource(Protocol):
    """Where legs come from: a `TimecodeSource`, or a test."""

    def filenos(self) -> Sequence[int]: ...

    def take(self) -> Sequence[Follow]: ...

    def take_texts(self) -> Sequence[str]: ...


class FollowControls:
    """Controls of a run that follows. Keys of a person go through `inner`."""

    def __init__(
        self,
        following: Following,
        legs: LegSource,
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
            self.following.lead(LeaderPosition(leg.instant_ns, leg.show_s, leg.rate), now_ns)
        self.following.turn(player, now_ns)
        if self.following.is_over and player.outcome is None:
            self.following.note_request(PlayerRequest("stop"), now_ns)
            player.stop(now_ns)
        for text in (*self._legs.take_texts(), *self.following.take_texts()):
            if self._tell is not None:
                self._tell(text)


class _PausedByPerson:
    """A player as a person steers it while it follows: there is pause, go on, and stop."""

    def __init__(self, player: Player, following: Following) -> None:
        self._player, self._following = player, following

    def set_rate(self, rate: float, now_ns: int) -> None:  # noqa: ARG002
        """Pause at rate 0; the speed is that of the leader."""
        self._following.set_paused(is_paused=rate == 0.0)

    def stop(self, now_ns: int) -> None:
        self._following.note_request(PlayerRequest("stop"), now_ns)
        self._player.stop(now_ns)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._player, name)
