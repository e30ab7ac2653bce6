"""Random shows that are edited while they play: each edit is spliced in, or refused in words.

Edits come at random show times, several one after the other, some too late for their splice, while
the show is paused or slowed. Judged at the simulated horns: no limit is broken, the
run ends by itself, and what was spliced is where the edited plan has it at the end.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from campaign import Told
from campaign.allowances import (
    ACCEL_EXCESS,
    RANGE_EXCESS_DEG,
    RESTS_WITHIN_DEG,
    SPEED_EXCESS,
    STEP_NS,
    WINDOW,
)
from campaign.anchors import any_show
from lss_motion.errors import InputError, LssMotionError, PlanningError
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.live_edit import PlannedShow, ProgramEdit, live_edit
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform
from lss_motion.show.model import Cue, Interpolation, Keyframe, Sequence
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable

    from lss_motion.playing.player.player import Player
    from lss_motion.robot.model import Robot

SEEDS: Final = 1_000
LOOKS_EVERY_NS: Final = NS_PER_S // 50
SETTLES_NS: Final = NS_PER_S


def add_to(_: argparse.ArgumentParser) -> None:
    """Add the options of this kind: none."""


def play(seed: int, options: argparse.Namespace) -> Told:  # noqa: ARG001  (as every kind)
    """Play a seed; return what became of it."""
    run = run_of(seed)
    outcome = f"{len(run.spliced)} spliced, {len(run.refused)} refused"
    return Told(outcome, tuple(run.broken()), about=tuple(run.refused))


def run_of(seed: int) -> EditedRun:
    """Return the run of a seed."""
    random = Random(seed)
    show, robot = any_show(seed)
    show = replace(_relaxed(show), events=_events(random, show))
    try:
        ends_s = plan(show, robot).duration_s
    except PlanningError:  # A spline swings out of a range.
        frames = [replace(frame, ease=Interpolation.SMOOTH) for frame in show.keyframes]
        show = replace(show, keyframes=tuple(frames))
        ends_s = plan(show, robot).duration_s
    edits, edited, at_s = [], show, 0.0
    for _ in range(random.randint(1, 4)):
        at_s += random.uniform(0.0, 0.4) * ends_s
        edited = changed(random, edited, at_s)
        margin_s = random.choice((0.0, 0.05, 0.3, 1.0))
        arrives_s = margin_s * random.choice((0.0, 0.5, 0.9, 1.5))
        edits.append((at_s, margin_s, arrives_s, edited))
    return EditedRun(robot, show, edits, seed=seed, whims=random.random() < 0.4)


def _relaxed(show: Sequence) -> Sequence:
    """Return a show three times in a row, without anchors that an edit would break."""
    last = show.keyframes[-1]
    each_s = 1.5 * ((last.at_s or 0.0) + last.hold_s) + 1.0
    return replace(
        show,
        keyframes=tuple(
            replace(frame, is_anchor=False, at_s=count * each_s + 1.5 * (frame.at_s or 0.0))
            for count in range(3)
            for frame in show.keyframes
        ),
    )


def _events(random: Random, show: Sequence) -> tuple[Cue, ...]:
    times = [frame.at_s or 0.0 for frame in show.keyframes if random.random() < 0.5]
    return tuple(Cue(at_s=at_s, say=f"at {at_s:.1f}") for at_s in times)


def changed(random: Random, show: Sequence, at_s: float) -> Sequence:
    """Return a show as an animator changes it: a key turned, moved, added or taken away.

    Most keys are behind the place at which the show is.
    """
    frames = list(show.keyframes)
    from_s = at_s if random.random() < 0.8 else 0.0
    index = random.choice(
        [k for k, frame in enumerate(frames) if k and (frame.at_s or 0.0) > from_s]
        or [len(frames) - 1]
    )
    frame = frames[index]
    before_s = (frames[index - 1].at_s or 0.0) + frames[index - 1].hold_s
    match random.randrange(5):
        case 0 | 1:
            name = random.choice(list(frame.deg))
            deg = {**frame.deg, name: round(random.uniform(-80.0, 80.0), 1)}
            frames[index] = replace(frame, deg=deg)
        case 2:
            by_s = random.uniform(0.0, 1.0)
            frames[index:] = [replace(k, at_s=(k.at_s or 0.0) + by_s) for k in frames[index:]]
        case 3 if len(frames) > 2 and index < len(frames) - 1:
            del frames[index]
        case _:
            new_s = random.uniform(before_s, frame.at_s or 0.0)
            deg = {name: round(random.uniform(-60.0, 60.0), 1) for name in frame.deg}
            if before_s + 0.05 < new_s < (frame.at_s or 0.0) - 0.05:
                frames.insert(index, Keyframe(at_s=new_s, deg=deg, ease=frame.ease))
    return replace(show, keyframes=tuple(frames))


def planned(show: Sequence, robot: Robot) -> PlannedShow:
    """Return the plan of a show and its program."""
    trajectory = plan(show, robot)
    return PlannedShow(compile_program(trajectory, robot), trajectory)


class EditedRun:
    """A run of a show to which edits come: `(show time, margin, arrives after, edited show)`.

    An edit is made at its show time for what is not due within its margin, and is there later. With
    `whims` the rate changes, too, and the show is paused.
    """

    def __init__(
        self,
        robot: Robot,
        show: Sequence,
        edits: Iterable[tuple[float, float, float, Sequence]],
        *,
        seed: int = 0,
        whims: bool = False,
    ) -> None:
        self._robot, self._edits, self._random = robot, list(edits), Random(seed)
        self.playing = planned(show, robot)
        self.spliced: list[ProgramEdit] = []
        self.refused: list[str] = []
        self.said: list[str] = []
        self._waiting: tuple[float, ProgramEdit, PlannedShow] | None = None
        self._whims = 3 if whims else 0
        self._rate_again_ns: int | None = None
        self.result = perform(
            self.playing.program,
            robot,
            trajectory=self.playing.trajectory,
            is_virtual=True,
            seed=seed,
            observer=Observer(on_event=self._note, controls=self),
        )
        self._ended_ns = max(bus.lines[-1][0] for bus in self.result.simulated.values())
        for bus in self.result.simulated.values():
            bus.advance(self._ended_ns + SETTLES_NS)

    def _note(self, event: Any, *_: Any) -> None:  # noqa: ANN401  (any event of a player)
        if (cue := getattr(event, "cue", None)) is not None and cue.say:
            self.said.append(cue.say)

    def filenos(self) -> list[int]:
        """Return nothing that ends a wait."""
        return []

    def act(self, player: Player, now_ns: int) -> None:
        """Do what is due: an edit that is made, one that arrives, a whim."""
        if player.phase is not Phase.SHOW or player.show is None:
            return
        show_s = player.show.show_s(now_ns)
        if self._waiting is not None and show_s >= self._waiting[0]:
            self._take(player, now_ns)
        elif self._waiting is None and self._edits and show_s >= self._edits[0][0]:
            self._make(show_s)
        self._be_moody(player, now_ns)
        if self._waiting is not None or self._edits or self._rate_again_ns is not None:
            player.wake_at(now_ns + LOOKS_EVERY_NS)

    def _make(self, show_s: float) -> None:
        _, margin_s, arrives_s, show = self._edits.pop(0)
        try:
            edited = planned(show, self._robot)
            edit = live_edit(
                self.playing, edited, self._robot, reached_s=show_s + margin_s, plan=b""
            )
        except LssMotionError as error:
            self.refused.append(str(error))
        else:
            self._waiting = show_s + arrives_s, edit, edited

    def _take(self, player: Player, now_ns: int) -> None:
        assert self._waiting is not None
        (_, edit, edited), self._waiting = self._waiting, None
        try:
            player.edit(edit, now_ns)
        except InputError as error:
            self.refused.append(str(error))
        else:
            self.spliced.append(edit)
            self.playing = PlannedShow(edit.program, edited.trajectory)

    def _be_moody(self, player: Player, now_ns: int) -> None:
        if self._rate_again_ns is not None and now_ns >= self._rate_again_ns:
            player.set_rate(1.0, now_ns)
            self._rate_again_ns = None
        elif self._whims and self._rate_again_ns is None and self._random.random() < 0.02:
            self._whims -= 1
            player.set_rate(self._random.choice((0.0, 0.0, 0.4)), now_ns)
            self._rate_again_ns = now_ns + int(self._random.uniform(0.1, 2.0) * NS_PER_S)

    def horns(self) -> dict[str, np.ndarray]:
        """Return the joint angles of the horns over the run, `STEP_NS` apart, by name."""
        found = {}
        for name, bus in self.result.simulated.items():
            times_ns = np.arange(bus.lines[0][0], self._ended_ns + SETTLES_NS, STEP_NS)
            servo_deg = bus.horn_deg(times_ns)
            joints = [joint for joint in self._robot.joints.values() if joint.bus == name]
            for column, joint in enumerate(joints):
                found[joint.name] = joint.direction * (servo_deg[:, column] - joint.zero_deg)
        return found

    def broken(self) -> list[str]:
        """Return every promise that the run broke, as texts."""
        assert self.result.report is not None
        texts = []
        if self.result.report.outcome != "finished":
            texts.append(f"the run {self.result.report.outcome}: {self.result.error}")
        last_deg = self.playing.trajectory.sample(np.array([self.playing.trajectory.duration_s]))[0]
        wanted = dict(zip(self.playing.trajectory.joints, last_deg.tolist(), strict=True))
        for name, horn in self.horns().items():
            joint = self._robot.joints[name]
            least, most = float(horn.min()), float(horn.max())
            if least < joint.position_min_deg - RANGE_EXCESS_DEG:
                texts.append(f"{name} came to {least:.2f} deg")
            if most > joint.position_max_deg + RANGE_EXCESS_DEG:
                texts.append(f"{name} came to {most:.2f} deg")
            span_s = WINDOW * STEP_NS / NS_PER_S
            speed = (horn[WINDOW:] - horn[:-WINDOW]) / span_s
            accel = float(np.abs(speed[WINDOW:] - speed[:-WINDOW]).max()) / span_s
            fastest = float(np.abs(speed).max())
            if fastest > SPEED_EXCESS * joint.speed_max_deg_s:
                texts.append(f"{name} came to {fastest:.1f} deg/s of {joint.speed_max_deg_s:g}")
            if accel > ACCEL_EXCESS * joint.accel_max_deg_s2:
                texts.append(f"{name} came to {accel:.0f} deg/s2 of {joint.accel_max_deg_s2:g}")
            if name in wanted and abs(horn[-1] - wanted[name]) > RESTS_WITHIN_DEG:
                texts.append(f"{name} ends at {horn[-1]:.1f} deg, planned {wanted[name]:.1f}")
        return texts
