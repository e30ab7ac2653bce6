"""An edit of a show that plays: from an instant on its program becomes that of the edited show.

Both plans are in the same place with the same speed at that instant (`splice_s`), and the moves
from there on start from the servos as the old program has moved them (`splice.SpliceState`). What
cannot be spliced is refused with the reason: the edit is played from the next start on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.program.splice import Extension, initial_splice_state, splice_lead_s

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

STEP_S: Final = 0.01
"""Instants at which the plans are compared: far shorter than a move."""
SAME_DEG: Final = 0.001
SAME_DEG_S: Final = 0.01
"""Plans that differ by less at an instant are the same there, as in `trajectory.window`."""


class PlannedShow(Struct, frozen=True):
    """A program, and the plan that it was made of."""

    program: Program
    trajectory: Trajectory


class ProgramEdit(Struct, frozen=True, kw_only=True):
    """What a player goes on with: the whole program, and what of it replaces its own."""

    program: Program
    """The moves that are due before the splice are those of the old program."""
    extension: Extension
    splice_s: float
    """Until then the old plan is played."""
    plan: bytes
    """The name of the plan of the edited show."""


def live_edit(
    playing: PlannedShow, edited: PlannedShow, robot: Robot, *, reached_s: float, plan: bytes
) -> ProgramEdit:
    """Return the edit of the show that plays; raises `InputError` with the reason if there is none.

    `reached_s`: what is due before that show time stays. Raises `PlanningError` if the bytes break
    a limit, and `LineLoadError` if the line cannot carry them.
    """
    _require_alike(playing, edited, robot)
    state = initial_splice_state(playing.program, robot)
    state = replace(state, moves=playing.program.moves)
    earliest_s = reached_s + splice_lead_s(robot, state.profiles)
    splice_s = _meeting(playing.trajectory, edited.trajectory, earliest_s)
    if _events(playing.program, splice_s) != _events(edited.program, splice_s):
        raise InputError(f"it moves an event past the splice at {splice_s:.2f} s")
    extension = state.extended(edited.trajectory, starts_s=0.0, from_s=splice_s)
    kept = [move for move in playing.program.moves if move.due_us < extension.from_us]
    program = replace(
        edited.program,
        moves=(*kept, *extension.moves),
        duration_s=extension.duration_s,
        line_use=extension.line_use,
    )
    return ProgramEdit(program=program, extension=extension, splice_s=splice_s, plan=plan)


def _require_alike(playing: PlannedShow, edited: PlannedShow, robot: Robot) -> None:
    """Raise `InputError` for what cannot change while a show plays."""
    old, new = playing.program, edited.program
    for is_other, what in (
        (robot.servos, "the robot has mechanisms"),
        (old.repeat or new.repeat, "the show plays a part again and again"),
        (old.waits or new.waits, "the show waits for a sensor"),
        (old.start_deg.keys() != new.start_deg.keys(), "it moves other joints"),
        (old.drives or new.drives, "a joint is driven without timed moves"),
        (
            _contents(old) != _contents(new),
            "it has other events (lights, sounds, words, functions)",
        ),
        (old.on_fault != new.on_fault, "its reactions to faults differ"),
    ):
        if is_other:
            raise InputError(f"{what}, which cannot change while the show plays")


def _contents(program: Program) -> list[str]:
    return sorted(repr(replace(cue, at_s=0.0, line=None)) for cue in program.cues)


def _events(program: Program, until_s: float) -> list[object]:
    return [replace(cue, line=None) for cue in program.cues if cue.at_s <= until_s]


def _meeting(old: Trajectory, new: Trajectory, earliest_s: float) -> float:
    """Return the first instant from `earliest_s` on at which both plans are the same."""
    shorter_s = min(old.duration_s, new.duration_s)
    times_s = np.arange(earliest_s, shorter_s, STEP_S)
    if not len(times_s):
        raise InputError(f"the show reaches its end, at {shorter_s:.2f} s, before a splice")
    columns = [old.joints.index(name) for name in new.joints]
    is_same = np.ones(len(times_s), dtype=np.bool_)
    for order, most in ((0, SAME_DEG), (1, SAME_DEG_S)):
        off = np.abs(old.sample(times_s, order)[:, columns] - new.sample(times_s, order))
        is_same &= off.max(axis=1) <= most
    if not is_same.any():
        place = np.abs(old.sample(times_s[:1])[:, columns] - new.sample(times_s[:1]))[0]
        joint = new.joints[int(place.argmax())]
        raise InputError(
            f"the show is in the edited part: from {earliest_s:.2f} s on, the earliest that can "
            f"still change, {joint!r} would have to jump; the plans do not meet after that"
        )
    return float(times_s[int(is_same.argmax())])
