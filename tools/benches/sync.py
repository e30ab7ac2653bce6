"""Shows that follow timecode: how far the show clock is from it, and what that costs.

The sound is made here (`stage.timecode.ltc`, which libltc reads), with noise of 5 % of full scale,
and heard by a sound input whose clock is 100 ppm off. Decoder, chase and player run in virtual
time; the lateness of moves is real.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benches.table import Row
from lss_motion.planning import shows
from lss_motion.playing.api import with_port
from lss_motion.playing.player.events import Phase
from lss_motion.playing.player.following import Following, FollowingStep, FollowRule
from lss_motion.playing.player.show_clock import ShowClock
from lss_motion.playing.run import Observer, perform
from lss_motion.stage.timecode import chase
from lss_motion.stage.timecode.chase import Chase, TimecodeObservation
from lss_motion.stage.timecode.ltc import sound_of
from lss_motion.stage.timecode.receive import LtcReader
from lss_motion.stage.timecode.timecode import FPS_25, timecode_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.show_clock import LeaderPosition
    from lss_motion.playing.report import TimingReport

RATE_HZ = 48000
DRIFT = 1e-4
BEGIN_S = 4.0
"""The leader is at the start of the show so long after it is first heard."""
NS = 1_000_000_000
SHOW = Path(__file__).parents[2] / "sequences" / "wave.yaml"
GOAL_S = 0.002
TURNS = ("alone", "following", "following", "alone")
"""The computer may have other work for a while: both have their runs near each other."""


def heard(
    seconds: float, jump_at_s: float, jump_s: float
) -> tuple[list[TimecodeObservation], float]:
    """Return the frames of LTC as they are read, and the processor time of a second of sound.

    Instants count from the first sample. Positions are those of the show.
    """
    first = 10 * 3600 * 25
    parts = [(first, jump_at_s), (first + round(25 * (jump_at_s + jump_s)), seconds - jump_at_s)]
    luck = np.random.default_rng(1)
    sound = np.concatenate(
        [
            sound_of(timecode_of(frame, FPS_25), FPS_25, round(25 * lasts_s), RATE_HZ)
            for frame, lasts_s in parts
            if lasts_s > 0.0
        ]
    )
    sound = (0.3 * sound + luck.normal(0.0, 0.05, len(sound))).astype(np.float32)
    reader, found = LtcReader(RATE_HZ, None, print), []
    began_s = time.process_time()
    for start in range(0, len(sound), 512):
        block = sound[start : start + 512]
        found += reader.take(block, lambda at: at / RATE_HZ * NS * (1.0 + DRIFT))
    taken_s = time.process_time() - began_s
    offset_s = 36000.0 + BEGIN_S
    return [one._replace(position_s=one.position_s - offset_s) for one in found], taken_s / seconds


class Tape:
    """Steers a player by observations; notes how far the show is from the leader."""

    def __init__(
        self,
        observations: list[TimecodeObservation],
        leader_s: Callable[[float], float],
        style: chase.Style = chase.LTC,
    ) -> None:
        self.following = Following(FollowRule(freewheel_s=5.0))
        self.off: list[tuple[float, float, FollowingStep]] = []
        self._left, self._leader_s = iter(observations), leader_s
        self._next = next(self._left, None)
        self._chase = Chase(style, freewheel_s=5.0)
        self._start_ns: int | None = None

    def filenos(self) -> list[int]:
        return []

    def act(self, player: Player, now_ns: int) -> None:
        self._start_ns = now_ns if self._start_ns is None else self._start_ns
        since_ns = now_ns - self._start_ns
        while self._next is not None and self._next.instant_ns <= since_ns:
            at = self._next.instant_ns + self._start_ns
            self._chase.take(self._next._replace(instant_ns=at))
            self._next = next(self._left, None)
        self._chase.advance(now_ns)
        for leg in self._chase.take_legs():
            self.following.lead(leg, now_ns)
        self.following.turn(player, now_ns)
        if player.show is not None and player.phase is Phase.SHOW:
            seconds = since_ns / NS
            off_s = player.show.show_s(now_ns) - self._leader_s(seconds)
            self.off.append((seconds, off_s, self.following.step))

    def errors_s(self, from_s: float, to_s: float, *steps: FollowingStep) -> np.ndarray:
        chosen = steps or (FollowingStep.RUNNING,)
        return np.array(
            [
                abs(off_s)
                for at_s, off_s, step in self.off
                if from_s <= at_s < to_s and step in chosen
            ]
        )


def follow(tape: Tape) -> None:
    """Play a show of 19.5 s with this leader, in virtual time."""
    show = shows.prepare(SHOW, None, is_following=True)
    robot = with_port(show.robot, "sim://")
    result = perform(show.program, robot, is_virtual=True, observer=Observer(controls=tape))
    assert result.report.outcome == "finished"


def row(what: str, errors_s: np.ndarray, target: str = "", goal_s: float | None = None) -> Row:
    p50, p99 = np.percentile(errors_s, (50, 99))
    ours = f"p50 {1e3 * p50:.3f}, p99 {1e3 * p99:.3f}, max {1e3 * errors_s.max():.3f} ms"
    is_met = None if goal_s is None else bool(p99 <= goal_s)
    return Row(what=what, ours=ours, target=target, is_met=is_met)


def measure() -> list[Row]:
    """Return the rows."""
    return [*_ltc_rows(), _midi_row(), _hour_row(), *_lateness_rows()]


def _ltc_rows() -> list[Row]:
    jump_at_s, jump_s, drop = 10.0, 4.0, (19.0, 21.0)
    frames, cost = heard(26.0, jump_at_s, jump_s)
    kept = [one for one in frames if not drop[0] <= one.instant_ns / NS < drop[1]]

    def leader_s(seconds: float) -> float:
        played_s = seconds / (1.0 + DRIFT)
        return played_s - BEGIN_S + (jump_s if played_s > jump_at_s else 0.0)

    tape = Tape(kept, leader_s)
    follow(tape)
    back_s = next(
        s for s, _, step in tape.off if s > jump_at_s + 0.5 and step is FollowingStep.RUNNING
    )
    gap = (FollowingStep.FREEWHEELING, FollowingStep.RUNNING)
    return [
        row("LTC, locked, noise 5 %, 100 ppm", tape.errors_s(5.0, 9.9), "p99 2 ms", GOAL_S),
        Row(what="jump of 4 s: out of step for", ours=f"{back_s - jump_at_s:.2f} s"),
        row("from 1 s after that on", tape.errors_s(back_s + 1.0, drop[0]), "p99 2 ms", GOAL_S),
        row("freewheel of 2 s", tape.errors_s(*drop, *gap), "p99 2 ms", GOAL_S),
        Row(what="to read a second of LTC, processor", ours=f"{1e3 * cost:.1f} ms"),
    ]


def _midi_row() -> Row:
    """MIDI timecode as JACK hands it over: what came in 21 ms at once."""
    period_s = 1024 / 48000
    frames = []
    for quarter in range(100 * 26):
        sent_s = quarter / 100.0
        came_s = (np.floor(sent_s / period_s) + 1.0) * period_s
        frames.append(TimecodeObservation(round(came_s * NS), sent_s - BEGIN_S))
    tape = Tape(frames, lambda seconds: seconds - BEGIN_S - 0.5 * period_s, chase.MTC)
    follow(tape)
    return row("MIDI timecode in periods of 21 ms, less half of one", tape.errors_s(6.0, 20.0))


def _hour_row() -> Row:
    """Return the error over an hour, with a leader between -100 and +100 ppm."""
    luck = np.random.default_rng(2)
    chased, clock, errors_s = Chase(chase.LTC), None, []
    leg: LeaderPosition | None = None
    position_s = 0.0
    for number in range(3600 * 25):
        now_s = number / 25.0
        position_s += 0.04 * (1.0 + DRIFT * np.sin(now_s / 300.0))
        chased.take(
            TimecodeObservation(round((now_s + abs(luck.normal(0, 2e-5))) * NS), position_s)
        )
        for leg in chased.take_legs():
            if clock is None:
                clock = ShowClock(leg.instant_ns, leg.show_s, 1.0)
            clock.follow(leg, leg.instant_ns, 0.005, 1.0)
        if clock is not None:
            errors_s.append(abs(clock.show_s(round(now_s * NS)) - position_s))
    return row("an hour of LTC, ±100 ppm in turn", np.array(errors_s[50:]), "p99 2 ms", GOAL_S)


def _lateness_rows() -> list[Row]:
    """Return the lateness of moves in real time, alone and following."""
    show = shows.prepare(SHOW, None, is_following=True, loop=1)
    robot = with_port(show.robot, "sim://")
    found: dict[str, list[TimingReport]] = {"alone": [], "following": []}
    for what in TURNS:
        frames = [
            TimecodeObservation(round(n * 0.04 * (1.0 + DRIFT) * NS), n * 0.04 - BEGIN_S)
            for n in range(25 * 60)
        ]
        tape = Tape(frames, lambda seconds: seconds - BEGIN_S)
        observer = Observer(controls=tape) if what == "following" else Observer()
        found[what].append(perform(show.program, robot, observer=observer).report.timing)
    return [
        Row(
            what=f"lateness of moves in real time, {what} ({len(runs)} runs in turn)",
            ours="p50 {}, p99 {}, max {} us, {} missed".format(
                "/".join(str(one.late_p50_us) for one in runs),
                "/".join(str(one.late_p99_us) for one in runs),
                "/".join(str(one.late_max_us) for one in runs),
                sum(one.missed for one in runs),
            ),
        )
        for what, runs in found.items()
    ]
