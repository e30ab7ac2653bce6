"""What an edit would do, before it is made: the plan of a window around it, in the planner process.

It answers while a key is dragged. `edited_window` plans what lies around the edit, from the plan of
the whole that was made last. Where that is no answer, only a plan of the whole is.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.source import read_text, with_edits
from lss_motion.files.yaml_source import with_values
from lss_motion.playing.remote import edit_messages as m
from lss_motion.studio.allowed import path_inside, read, require_harmless
from lss_motion.studio.operations import RobotNames, new_values
from lss_motion.studio.view_curves import packed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from lss_motion.planning.shows import Show
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.planning.trajectory.window import EditedWindow
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Keyframe, Sequence

SAME_S: Final = 1e-6
POINTS_MAX: Final = 400
"""Points of a curve of a window: more than it is wide in pixels while a key is dragged."""
STEP_S: Final = 0.02


class WholePlan(Struct, frozen=True):
    """The plan of the whole that was made last, and how its file is read again."""

    show: Show
    folder: Path
    load: Callable[[], tuple[Sequence, Robot]]


def tried(
    operation: m.AnyChange, texts: Mapping[Path, bytes], whole: WholePlan | None
) -> tuple[str | None, m.TriedWindow | None]:
    """Return what an edit would do, or why that cannot be planned; raises nothing about the files.

    `texts` is what edited files have that is not saved yet. Neither: only the whole plan can tell.
    """
    if whole is None:
        return "there is no plan yet; wait a moment", None
    try:
        with with_edits(texts):
            text_of = _reader(whole.folder)
            robot = whole.show.robot
            values = new_values(operation, text_of, RobotNames(robot.poses, robot.mirror))
            for path, source in values.items():
                before = read(path, read_text(path)).source.value
                require_harmless(whole.folder, path, before, source.value)
            with with_values(values):
                sequence, robot = whole.load()
        window = _window(sequence, robot, whole.show)
    except LssMotionError as error:
        return error.reason if isinstance(error, InputError) else str(error), None
    return None, None if window is None else _shown(window)


def _reader(folder: Path) -> Callable[[str], tuple[Path, str]]:
    def text_of(name: str) -> tuple[Path, str]:
        path = path_inside(folder, name)
        return path, read_text(path)

    return text_of


def _window(sequence: Sequence, robot: Robot, show: Show) -> EditedWindow | None:
    """Return the plan around what differs from the plan of the whole, if there is one."""
    from lss_motion.planning.trajectory.tracks import ParallelPass
    from lss_motion.planning.trajectory.window import edited_window
    from lss_motion.show.keyframes import at_speed

    assert show.sequence is not None
    assert show.trajectory is not None
    old, new = at_speed(show.sequence), at_speed(sequence)
    whole = show.trajectory
    if new.play or new.layers or old.play or old.layers:
        return None
    pairs: list[tuple[Sequence, Sequence, Trajectory]] = [(old, new, whole)]
    if isinstance(whole.first, ParallelPass):
        pairs = list(_tracks(old, new, whole.first.parts))
    changed = [pair for pair in pairs if pair[0].keyframes != pair[1].keyframes]
    if len(changed) != 1:
        return None
    before, after, plan = changed[0]
    span_s = _span(before.keyframes, after.keyframes)
    return None if span_s is None else edited_window(after, robot, plan, *span_s)


def _tracks(
    old: Sequence, new: Sequence, parts: tuple[Trajectory, ...]
) -> list[tuple[Sequence, Sequence, Trajectory]]:
    """Return the tracks of a show, before and after an edit, with their plans."""
    from msgspec.structs import replace

    def of(show: Sequence) -> list[Sequence]:
        own = [replace(show, tracks=())] if show.keyframes else []
        return [*own, *show.tracks]

    before, after = of(old), of(new)
    if not len(before) == len(after) == len(parts):
        return []
    return list(zip(before, after, parts, strict=True))


def _span(old: tuple[Keyframe, ...], new: tuple[Keyframe, ...]) -> tuple[float, float] | None:
    """Return between which times of the new keyframes they differ from the old ones.

    Those behind may all be later by the same time. None: one of them has no time.
    """
    if any(frame.at_s is None for frame in (*old, *new)) or not old or not new:
        return None
    most = min(len(old), len(new))
    first = sum(1 for _ in itertools.takewhile(lambda k: old[k] == new[k], range(most)))
    by_s = _at(new, -1) - _at(old, -1)
    last = sum(
        1
        for _ in itertools.takewhile(
            lambda k: _is_same(old[-1 - k], new[-1 - k], by_s), range(most - first)
        )
    )
    ends = [_at(new, min(first, len(new) - 1)), _at(old, min(first, len(old) - 1))]
    ends += [_at(new, max(len(new) - last - 1, 0))]
    ends += [_at(old, max(len(old) - last - 1, 0)) + by_s]
    return min(ends), max(ends)


def _at(frames: tuple[Keyframe, ...], index: int) -> float:
    return frames[index].at_s or 0.0


def _is_same(old: Keyframe, new: Keyframe, by_s: float) -> bool:
    from msgspec.structs import replace

    is_later = abs((new.at_s or 0.0) - (old.at_s or 0.0) - by_s) < SAME_S
    return is_later and replace(old, at_s=0.0) == replace(new, at_s=0.0)


def _shown(window: EditedWindow) -> m.TriedWindow:
    trajectory = window.trajectory
    count = int(np.clip(np.ceil(trajectory.duration_s / STEP_S) + 1, 2, POINTS_MAX))
    times_s = np.linspace(0.0, trajectory.duration_s, count)
    deg: Any = trajectory.sample(times_s, 0)
    return m.TriedWindow(
        from_s=window.from_s,
        to_s=window.to_s,
        later_s=window.later_s,
        is_joined=window.is_joined,
        keys=tuple(
            m.TriedKey(
                place=mark.place,
                label=mark.label,
                authored_s=mark.authored_s or 0.0,
                planned_s=mark.planned_s,
                is_missed=mark.is_anchor and mark.planned_s > (mark.authored_s or 0.0) + SAME_S,
            )
            for mark in window.marks
        ),
        slow=tuple(
            m.TriedSlow(
                from_s=span.from_s,
                to_s=span.to_s,
                by_s=span.by_s,
                joint=span.joint,
                limit=span.limit,
                text=span.text,
            )
            for span in window.stretched
        ),
        step_s=trajectory.duration_s / (count - 1),
        deg={name: packed(deg[:, column], "<f4") for column, name in enumerate(trajectory.joints)},
    )
