"""The sounds of a show on one open stream: the player's end of the pipes.

The process `lss_motion.sound.device` plays. It is told the show clock and each sound some seconds
ahead, so that it never waits for the player, and it reports what is heard of the bed; the show
clock follows that. Nothing here waits but the opening of the device, before the show.

Where it cannot play (no library, no device), `SoundDesk.problem` says why, and
`playing.performer` spawns players of the system instead.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError, install_command
from lss_motion.playing.performer_process import SOUND_PLAYERS, sound_player
from lss_motion.playing.player.events import Noted, PlayerRequest, note_nowhere
from lss_motion.playing.player.show_clock import TRIM_MAX_RATIO, LeaderPosition
from lss_motion.playing.sound_choice import SoundReport
from lss_motion.system.clock_leg import RATE_BAND
from lss_motion.system.process import ChildProcess
from lss_motion.system.sound_messages import (
    ClearSounds,
    DeviceLost,
    DeviceOpened,
    Dropouts,
    EndSounds,
    Heard,
    NoDevice,
    PlaySound,
    SetLeads,
    SetLeg,
    SetOffset,
    SoundBegun,
    SoundFailed,
    SoundNews,
    StillPlaying,
    WrongRate,
)
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.sound_choice import SoundChoice
    from lss_motion.show.model import Cue
    from lss_motion.system.clock_leg import ClockLeg
    from lss_motion.system.sound_messages import SoundOrder

OPEN_S: Final = 10.0
"""The longest time that a device may take to open. A Bluetooth speaker needs 3 s."""
AHEAD_S: Final = 3.0
"""A sound is handed over so long before its time, so that its file can be opened and read."""
BACK_S: Final = 0.02
"""A stall or a wait takes the show clock back by a little."""
ALIVE_NS: Final = NS_PER_S // 5
PROCESS: Final = "lss_motion.sound.device"
NAMES_MAX: Final = 200
"""The files of so many last sounds are known by name if they fail."""
END_S: Final = 1.5
"""The longest time that fading out may take."""


class SoundDesk:
    """Plays the sounds of one show. `turn` is called on each turn of the loop; never waits."""

    def __init__(
        self, program: Program, choice: SoundChoice, *, offset_s: float, start_s: float | None
    ) -> None:
        """Open the device, and check all files; `problem` is why nothing can be played."""
        self.report = SoundReport(offset_s=offset_s)
        self.problem = ""
        self.troubles: list[str] = []
        """Texts about sounds that cannot be played, not yet taken by `take_troubles`."""
        from lss_motion.sound.files import has_soundfile

        self._choice = choice
        self._note_request: Callable[[PlayerRequest, int], None] = note_nowhere
        self._tell: Callable[[Event], None] = _ignore
        self._program = program
        self._changes, self._is_cleared = 0, False
        self._robot_offset_s = self._sent_offset_s = offset_s
        self._cues = program.unrolled_cues()
        self._next: tuple[float, Cue] | None = None
        self._number = 0
        self._names: dict[int, str] = {}
        self._leg: ClockLeg | None = None
        self._alive_ns = 0
        self._start_s = self._shown_s = start_s or 0.0
        self._followed_s: float | None = None
        self._child: ChildProcess[SoundNews] | None = None
        self._lengths_s = self._checked({cue.sound: cue for cue in program.cues if cue.sound})
        if not has_soundfile():
            self.problem = f"a library is missing: {install_command('sound')}"
        else:
            self._open(choice.device)
        self._advance()
        if self.problem:
            self.troubles.append(_fallback_text(self.problem))
            if sound_player() is None:
                names = [Path(cue.sound).name for cue in program.cues if cue.sound]
                self.report.not_played = list(dict.fromkeys(names))

    @property
    def is_open(self) -> bool:
        return self._child is not None

    def note_to(
        self,
        tell: Callable[[Event], None],
        note_request: Callable[[PlayerRequest, int], None] | None,
    ) -> None:
        """Tell a person what has changed; write what decides about the show to a log, too."""
        self._tell = tell
        self._note_request = note_request or note_nowhere

    def turn(self, player: Player, now_ns: int) -> None:
        """Tell the process what has changed; let the show follow what is heard."""
        if self._child is not None:
            self._read(self._child, player, now_ns)
            self._play(player, now_ns)
        for text in self.take_troubles():
            self._note_request(PlayerRequest("sound", (text,)), now_ns)
            player.lose_sound(text, now_ns)

    def _play(self, player: Player, now_ns: int) -> None:
        show = player.show
        if player.changes != self._changes:
            self._change(player)
        if player.is_leaving and not self._is_cleared:
            self._is_cleared = self._send(ClearSounds())
        if show is not None and player.show_ended_ns is None and not player.is_leaving:
            if show.clock.leg is not self._leg:
                self._leg = leg = show.clock.leg
                self._send(SetLeg(leg))
            show_s = show.show_s(now_ns)
            if show_s < self._shown_s - BACK_S:
                self._go_back(show_s)
            self._shown_s = show_s
            self._feed(show_s)
        offset_s = self._robot_offset_s + self._choice.shift_s
        if offset_s != self._sent_offset_s:
            self._sent_offset_s = self.report.offset_s = round(offset_s, 4)
            self._send(SetOffset(offset_s))
            self._tell(Noted(f"sounds {1000.0 * offset_s:+.0f} ms"))
        if now_ns - self._alive_ns >= ALIVE_NS:
            self._alive_ns = now_ns
            self._send(StillPlaying())
        if player.show_ended_ns is not None:
            self.silence()

    def silence(self) -> None:
        """Fade everything out: the show is over."""
        self._send(EndSounds())

    def take_troubles(self) -> list[str]:
        """Return what cannot be played, since the last call."""
        texts, self.troubles = self.troubles, []
        return texts

    def close(self) -> None:
        """Fade out and end the process, for `END_S` at most."""
        child, self._child = self._child, None
        if child is not None:
            child.end(END_S, lambda news: self._take(news, None, 0))

    # ---- before the show

    def _checked(self, cues: dict[str, Cue]) -> dict[str, float]:
        """Return the durations of the files that can be read; note those that cannot."""
        from lss_motion.sound.files import has_soundfile, sound_info

        lengths_s = {}
        if not has_soundfile():
            return {}
        for path, cue in cues.items():
            speed = cue.style.speed_ratio
            try:
                lengths_s[path] = sound_info(Path(path)).duration_s / speed
            except InputError as error:
                self._fail(path, error.reason)
                continue
            if abs(speed - 1.0) > RATE_BAND:
                del lengths_s[path]
                self._fail(
                    path, f"at {speed:g} of its speed it would not sound right (5 % at most)"
                )
        return lengths_s

    def _fail(self, path: str, reason: str) -> None:
        name = Path(path).name
        if name not in self.report.not_played:
            self.report.not_played.append(name)
            self.troubles.append(f"sound {name} cannot be played: {reason}")

    def _open(self, device: str) -> None:
        child: ChildProcess[SoundNews]
        child = ChildProcess(PROCESS, device, receives=SoundNews, is_quiet=True)
        self._child = child
        end_s = time.monotonic() + OPEN_S
        while not self.report.device and not self.problem:
            for news in child.receive_within(end_s - time.monotonic()):
                self._take(news, None, 0)
            if child.has_ended:
                self.problem = "the process that plays sounds has ended"
            elif time.monotonic() >= end_s:
                self.problem = f"the sound device does not open within {OPEN_S:g} s"
        if self.problem:
            child.close()
            self._child = None
            return
        if self._sent_offset_s:
            self._send(SetOffset(self._sent_offset_s))
        if not self._choice.leads:
            self._send(SetLeads(leads=False))

    # ---- during the show

    def _change(self, player: Player) -> None:
        """Fade out what sounds; from now on, the sounds of another program are played."""
        if not self._is_cleared and not self._send(ClearSounds()):
            return  # The pipe is full: on the next turn.
        self._changes, self._is_cleared = player.changes, False
        self._program, self._start_s = player.program, player.start_s or 0.0
        self._shown_s, self._followed_s, self._leg = self._start_s, None, None
        new = {cue.sound: cue for cue in self._program.cues if cue.sound not in self._lengths_s}
        self._lengths_s |= self._checked({path: cue for path, cue in new.items() if path})
        self._cues = self._program.unrolled_cues(self._start_s)
        self._advance()

    def _go_back(self, show_s: float) -> None:
        """Hand over again what sounds from `show_s` on: the show was sent back there."""
        self._send(ClearSounds())
        self._cues = self._program.unrolled_cues()
        self._start_s = show_s
        self._advance()

    def _feed(self, show_s: float) -> None:
        """Hand over the sounds that are due soon; those that were over before it are skipped."""
        while self._next is not None and self._next[0] <= show_s + AHEAD_S:
            start_s, cue = self._next
            if not self._hand_over(start_s + cue.lead_s, cue, show_s):
                return  # The pipe is full: on the next turn.
            self._advance()

    def _hand_over(self, at_s: float, cue: Cue, show_s: float) -> bool:
        """Send a sound, unless it is over or cannot be played; False if the pipe is full."""
        length_s, style = self._lengths_s.get(cue.sound), cue.style
        if length_s is None:
            return True
        end_s = math.inf if style.is_looped else at_s + length_s
        if style.lasts_s is not None:
            end_s = min(end_s, at_s + style.lasts_s)
        if min(end_s, self._program.duration_s) <= max(show_s, self._start_s):
            return True
        is_cut = style.lasts_s is not None or end_s > self._program.duration_s
        self._number += 1
        self._names[self._number] = cue.sound
        self._names.pop(self._number - NAMES_MAX, None)
        return self._send(
            PlaySound(
                number=self._number,
                path=cue.sound,
                at_s=at_s,
                gain_ratio=10.0 ** (style.gain_db / 20.0),
                is_bed=style.is_bed,
                is_looped=style.is_looped,
                duck_ratio=10.0 ** (-style.duck_db / 20.0),
                speed_ratio=style.speed_ratio,
                until_s=min(end_s, self._program.duration_s) if is_cut else math.inf,
            )
        )

    def _advance(self) -> None:
        """Go to the next sound of the show."""
        self._next = next(((start_s, cue) for start_s, cue in self._cues if cue.sound), None)

    def _send(self, order: SoundOrder) -> bool:
        """Send an order; False if the pipe is full."""
        if self._child is None or self._child.offer(order):
            return True
        if self._child.pipe.is_full:
            self._leg = None  # Told again on the next turn.
            return False
        self._lose("the process that plays sounds has ended")
        return True

    def _lose(self, reason: str) -> None:
        if not self.problem:
            self.problem = reason
            self.troubles.append(
                f"{reason}: the show goes on without sound, by the computer's clock"
            )

    def _read(self, child: ChildProcess[SoundNews], player: Player, now_ns: int) -> None:
        for news in child.receive():
            self._take(news, player, now_ns)
        if child.has_ended:
            self._lose("the process that plays sounds has ended")

    def _take(self, news: SoundNews, player: Player | None, now_ns: int) -> None:
        match news:
            case DeviceOpened():
                self.report.device, self.report.driver = news.name, news.driver
                self.report.latency_s = news.latency_s
            case NoDevice():
                self.problem = news.text
            case SoundBegun():
                self.report.begun += 1
            case SoundFailed():
                self._fail(self._names.get(news.number, "file"), news.text)
            case Heard():
                if player is not None:
                    self._follow(
                        player, LeaderPosition(news.instant_ns, news.show_s, news.rate), now_ns
                    )
            case WrongRate():
                self.troubles.append(
                    f"the sound device runs at {news.ratio:g} of its rate: the show does not "
                    f"follow it, and its sounds are bent to fit. Use another device (lss-motion "
                    f"devices)"
                )
            case DeviceLost():
                self._lose(news.text)
            case Dropouts():
                self.report.dropouts = news.count

    def _follow(self, player: Player, leader: LeaderPosition, now_ns: int) -> None:
        # As it is written to the log, so that a replay computes the same.
        leader = LeaderPosition(now_ns, leader.at_s(now_ns), leader.rate)
        off_s = player.follow(leader, now_ns, TRIM_MAX_RATIO)
        if off_s is None:
            return
        values = (leader.show_s, leader.rate, TRIM_MAX_RATIO)
        self._note_request(PlayerRequest("follow", values), now_ns)
        self.report.leads = True
        assert player.show is not None
        if player.show.clock.target_rate == 1.0:
            self.report.device_ppm = round((leader.rate - 1.0) * 1e6, 1)
        self._followed_s = leader.show_s if self._followed_s is None else self._followed_s
        if leader.show_s >= self._followed_s + 10.0:
            self.report.off_max_s = round(max(self.report.off_max_s, abs(off_s)), 6)


def _ignore(_event: Event) -> None:
    """No person watches."""


def _fallback_text(problem: str) -> str:
    """Return what happens instead where no stream can be opened."""
    player = sound_player()
    if player is None:
        names = ", ".join(words[0] for words in SOUND_PLAYERS)
        return f"no sounds: {problem}. None of {names} is installed either"
    return (
        f"the sounds are played by {player[0]}: they are up to 1.3 s late, drift, and go on in a "
        f"pause. {problem}"
    )
