"""gait.yaml → `Gait` → `Sequence`: legs in the order of patterns, walks in whole cycles, checked.

Law: the problems of a file come in one `InputError`, each with its line. Reach and joint limits
are checked by `paced`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake, read_yaml
from lss_motion.robot.load import load_named_robot
from lss_motion.show.gait.kinematics import neutral_mm
from lss_motion.show.gait.model import (
    LAID_OUT_CYCLES,
    LEAD_IN_CYCLES,
    PARTS,
    PATTERNS,
    SIDES_NEEDED,
    BodyMove,
    BodyPose,
    Gait,
    Leg,
    LegKind,
    Walk,
    Wave,
    in_order,
)
from lss_motion.show.gait.pacing import action_at, joints_of, paced
from lss_motion.show.gait.passage import Walking
from lss_motion.show.model import KEYFRAMES_MAX, Interpolation, Keyframe, Sequence, Timing

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.file import ActionEntry, GaitFile, LegEntry, MoveEntry, WalkEntry
    from lss_motion.show.gait.model import Action, Pattern
    from lss_motion.show.gait.pacing import Paced

_NEEDED: Final = ("kind", "lengths_mm", "stance_mm")

TWO_LEGS: Final = (
    "a robot with two legs balances by feedback from sensors that servos do not have; four or six "
    "legs are supported"
)

UNLOOPED_CYCLES_MAX: Final = 30
"""A longer walk has a middle that is looped. Chosen: half a minute is planned in one piece."""

ROUNDING: Final = 1e-9
"""Relative error of counts that would be whole without rounding."""

ACTIONS: Final = ("stand", "sit", "pose", "walk", "turn")


def load_gait(path: Path | str, robot: Robot | None = None) -> Gait:
    """Return the gait of a gait file for `robot`, or for the robot that the file names.

    Raises `InputError` with file, line, value and remedy; its `more` holds all further problems.
    Reach and joint limits are not checked here, but by `paced`.
    """
    content, source = _read(Path(path))
    robot = robot or load_named_robot(source, content.robot)
    loader = _GaitLoader(content, source, robot)
    gait = loader.gait()
    if gait is None or loader.problems:
        raise source.error(loader.problems)
    return gait


def gait_schema() -> dict[str, Any]:
    """Return the JSON Schema of a gait file."""
    from lss_motion.files.keys import json_schema
    from lss_motion.show.gait.file import GaitFile

    return json_schema(GaitFile)


def _read(path: Path) -> tuple[GaitFile, YamlSource]:
    from lss_motion.files.validation import validate
    from lss_motion.show.gait.file import GaitFile

    source = read_yaml(path)
    content, problems, _ = validate(GaitFile, source)
    if content is None or problems:
        raise source.error(problems)
    return content, source


@dataclass(slots=True)
class _GaitLoader:
    """Builds the gait of one file and collects its problems."""

    content: GaitFile
    source: YamlSource
    robot: Robot
    problems: list[Mistake] = field(default_factory=list)

    def gait(self) -> Gait | None:
        """Return the gait; it can be used only if there are no `problems`."""
        content = self.content
        legs = self._legs()
        if not legs:
            return None
        pattern = self._pattern(legs)
        start = self._sitting(("start",)) if content.start == "sitting" else BodyPose()
        actions, end = self._actions(start)
        if content.loop == 1:
            actions = _with_loop(actions)
        if content.loop != 1 and end != start:
            self._note(
                ("loop",),
                "a loop must end in the pose in which it began; add an action that returns to it",
            )
        if pattern is None:
            return None
        foot_mm = max(math.hypot(*neutral_mm(leg)) for leg in legs)
        sway_mm = content.sway_mm
        return Gait(
            name=content.gait,
            legs=legs,
            height_mm=content.height_mm,
            pattern=pattern,
            duty=pattern.duty_ratio if content.duty is None else content.duty,
            cycle_s=content.cycle_s,
            step_height_mm=content.step_height_mm,
            sway_mm=pattern.sway_ratio * foot_mm if sway_mm is None else sway_mm,
            actions=actions,
            waves=self._waves(actions),
            start=start,
            sit=None if content.sit_height_mm is None else self._sitting(("sit_height_mm",)),
            loop=None if content.loop == "forever" else content.loop,
            path=self.source.path,
            robot_path=self.robot.path,
        )

    def _waves(self, actions: tuple[Action, ...]) -> tuple[Wave, ...]:
        is_looped = any(isinstance(own, Walk) and own.more_cycles != 0 for own in actions)
        waves = []
        for index, entry in enumerate(self.content.layers):
            swings = self.content.cycle_s / entry.every_s
            if is_looped and abs(swings - round(swings)) > ROUNDING * swings:
                reason = "in a walk that is looped a cycle holds whole swings: divide cycle_s"
                self._note(("layers", index, "every_s"), reason)
            pose = _pose(entry.shift_mm, entry.tilt_deg)
            waves.append(Wave(pose=pose, every_s=entry.every_s, start_ratio=entry.start))
        return tuple(waves)

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _legs(self) -> tuple[Leg, ...]:
        content, named = self.content, self.content.legs_from
        if named is None:
            if content.legs is None:
                self._note((), "no legs: give 'legs', or 'legs_from', a gait file that has them")
                return ()
            legs, problems = legs_of(content, self.robot)
            self.problems += problems
            return legs
        for key in ("legs", "leg"):
            if key in content.given:
                self._note((key,), f"{key!r} and 'legs_from' exclude each other; keep one")
        path = self.source.path.parent / named
        if not path.is_file():
            self._note(("legs_from",), f"gait file {named!r} not found; looked for {path}")
            return ()
        other, source = _read(path)
        if other.legs is None:
            self._note(("legs_from",), f"{named!r} has no 'legs' of its own; name one that has")
            return ()
        legs, problems = legs_of(other, self.robot)
        if problems:
            raise source.error(problems)
        return legs

    def _pattern(self, legs: tuple[Leg, ...]) -> Pattern | None:
        known = PATTERNS[len(legs)]
        name = self.content.pattern
        if name is None:
            return next(iter(known.values()))
        if name not in known:
            reason = f"pattern {name!r} is not for {len(legs)} legs; {known_names(name, known)}"
            self._note(("pattern",), reason)
        return known.get(name)

    def _sitting(self, location: Location) -> BodyPose:
        sit_mm = self.content.sit_height_mm
        if sit_mm is None:
            self._note(location, "sitting needs 'sit_height_mm', the height of the hips then")
            return BodyPose()
        return BodyPose(shift_mm=(0.0, 0.0, sit_mm - self.content.height_mm))

    def _actions(self, start: BodyPose) -> tuple[tuple[Action, ...], BodyPose]:
        actions: list[Action] = []
        pose, is_sitting = start, self.content.start == "sitting"
        for index, entry in enumerate(self.content.do):
            location: Location = ("do", index)
            given = [key for key in ACTIONS if getattr(entry, key) is not None]
            if len(given) != 1:
                names = ", ".join(given) or "nothing"
                known = ", ".join(ACTIONS)
                self._note(location, f"an action is one of {known}; this has {names}")
                continue
            action = self._action(entry, given[0], location)
            if isinstance(action, Walk) and is_sitting:
                self._note(location, "the robot sits and cannot walk; add '- stand: {}' before")
            if isinstance(action, BodyMove):
                pose, is_sitting = action.pose, given[0] == "sit"
            if action is not None:
                actions.append(action)
        return tuple(actions), pose

    def _action(self, entry: ActionEntry, key: str, location: Location) -> Action | None:
        line = self.source.line(location)
        if entry.walk is not None:
            return self._walk(entry.walk, (*location, key), line)
        if (turn := entry.turn) is not None:
            if turn.deg == 0.0:
                self._note((*location, key, "deg"), "turn by 0 deg has no effect; remove it")
                return None
            cycles = _cycles(abs(turn.deg) / turn.turn_deg_s, self.content.cycle_s)
            return Walk(
                forward_mm_s=0.0,
                left_mm_s=0.0,
                turn_deg_s=turn.deg / (cycles * self.content.cycle_s),
                cycles=cycles,
                label=turn.label or "turn",
                line=line,
            )
        if entry.pose is not None:
            pose = _pose(entry.pose.shift_mm, entry.pose.tilt_deg)
            return _move(entry.pose, pose, key, line)
        if entry.sit is not None:
            return _move(entry.sit, self._sitting((*location, key)), key, line)
        assert entry.stand is not None
        return _move(entry.stand, BodyPose(), key, line)

    def _walk(self, entry: WalkEntry, location: Location, line: int) -> Walk | None:
        cycle_s = self.content.cycle_s
        ahead_mm_s = entry.forward_mm_s
        if entry.stride_mm is not None:
            if "forward_mm_s" in entry.given:
                reason = "'stride_mm' and 'forward_mm_s' exclude each other; keep one"
                self._note((*location, "stride_mm"), reason)
            ahead_mm_s = entry.stride_mm / cycle_s
        lengths = ("for_s", "distance_mm", "cycles")
        given = [key for key in lengths if key in entry.given]
        if len(given) != 1:
            reason = f"a walk has one of {', '.join(lengths)}; this has {' and '.join(given) or 0}"
            self._note(location, reason)
            return None
        if entry.cycles == "forever":
            self._check_endless(location)
        ratio, cycles = 1.0, LAID_OUT_CYCLES if entry.cycles == "forever" else entry.cycles
        if entry.for_s is not None:
            cycles = max(1, round(entry.for_s / cycle_s))
        if entry.distance_mm is not None:
            speed_mm_s = math.hypot(ahead_mm_s, entry.left_mm_s)
            if speed_mm_s == 0.0:
                reason = "distance_mm needs a speed; give forward_mm_s, left_mm_s or stride_mm"
                self._note((*location, "distance_mm"), reason)
                return None
            cycles = _cycles(entry.distance_mm / speed_mm_s, cycle_s)
            ratio = entry.distance_mm / (speed_mm_s * cycles * cycle_s)
        return Walk(
            forward_mm_s=ratio * ahead_mm_s,
            left_mm_s=ratio * entry.left_mm_s,
            turn_deg_s=ratio * entry.turn_deg_s,
            cycles=cycles,
            more_cycles=None if entry.cycles == "forever" else 0,
            label=entry.label or "walk",
            line=line,
        )

    def _check_endless(self, location: Location) -> None:
        if location[1] != len(self.content.do) - 1:
            reason = "a walk forever has no end, so nothing can follow; give cycles a count"
            self._note((*location, "cycles"), reason)
        if self.content.loop != 1:
            reason = "a walk without end cannot be looped; leave loop out"
            self._note((*location, "cycles"), reason)


def _with_loop(actions: tuple[Action, ...]) -> tuple[Action, ...]:
    """Return the actions; the middle of the longest walk, if it is long, is a loop of cycles."""
    walks = [own for own in actions if isinstance(own, Walk)]
    longest = max(walks, key=lambda walk: walk.cycles, default=None)
    is_endless = any(walk.more_cycles is None for walk in walks)
    if longest is None or is_endless or longest.cycles <= UNLOOPED_CYCLES_MAX:
        return actions
    more = longest.cycles - LAID_OUT_CYCLES
    looped = replace(longest, cycles=LAID_OUT_CYCLES, more_cycles=more)
    return tuple(looped if own is longest else own for own in actions)


def _cycles(duration_s: float, cycle_s: float) -> int:
    """Return the fewest whole cycles that last that long, apart from rounding."""
    return max(1, math.ceil(duration_s / cycle_s - ROUNDING))


def _pose(shift: list[float], tilt: list[float]) -> BodyPose:
    return BodyPose(shift_mm=(shift[0], shift[1], shift[2]), tilt_deg=(tilt[0], tilt[1], tilt[2]))


def _move(entry: MoveEntry, pose: BodyPose, key: str, line: int) -> BodyMove:
    return BodyMove(
        pose=pose, in_s=entry.in_s, hold_s=entry.hold_s, label=entry.label or key, line=line
    )


def legs_of(content: GaitFile, robot: Robot) -> tuple[tuple[Leg, ...], list[Mistake]]:
    """Return the legs, left before right and front before rear, and their problems.

    With problems, no legs are returned.
    """
    entries = content.legs or {}
    problems: list[Mistake] = []
    legs: list[Leg] = []
    owners: dict[str, str] = {}
    for name, entry in entries.items():
        fields = {
            key: value
            for owner in (content.leg, entry)
            for key in owner.given
            if (value := getattr(owner, key)) is not None
        }
        found = [*_leg_problems(name, fields), *_joint_problems(name, entry, robot, owners)]
        problems += found
        if not found:
            legs.append(_leg(name, fields))
    ordered = in_order(legs)
    if problems:
        return (), problems
    if len(entries) not in PARTS:
        reason = TWO_LEGS if len(entries) == 2 else f"{len(entries)} legs; 4 or 6 are supported"
        return (), [Mistake(("legs",), reason)]
    if ordered is None:
        return (), [Mistake(("legs",), f"a robot needs {SIDES_NEEDED}")]
    return ordered, []


def _leg_problems(name: str, fields: dict[str, Any]) -> Iterator[Mistake]:
    place = ("legs", name)
    for key in _NEEDED:
        if key not in fields:
            yield Mistake((*place, key), f"leg {name!r} has no {key!r}; give it here or in 'leg'")
    kind = fields.get("kind")
    if kind is None:
        return
    if kind not in list(LegKind):
        known = known_names(kind, [own.value for own in LegKind])
        yield Mistake((*place, "kind"), f"leg {name!r}: unknown kind {kind!r}; {known}")
        return
    other = {LegKind.COXA: "knee", LegKind.ABDUCTION: "yaw_deg"}[LegKind(kind)]
    if other in fields:
        yield Mistake((*place, other), f"leg {name!r}: {other!r} has no meaning for {kind} legs")
    if kind == LegKind.COXA and "yaw_deg" not in fields:
        yield Mistake(place, f"leg {name!r} has no 'yaw_deg', where it points: 90 is left")


def _joint_problems(
    name: str, entry: LegEntry, robot: Robot, owners: dict[str, str]
) -> Iterator[Mistake]:
    for index, joint in enumerate(entry.joints):
        place = ("legs", name, "joints", index)
        if joint not in robot.joints:
            known = known_names(joint, robot.joints)
            yield Mistake(place, f"leg {name!r}: unknown joint {joint!r}; {known}")
        elif joint in owners:
            yield Mistake(place, f"joint {joint!r} is already one of leg {owners[joint]!r}")
        owners.setdefault(joint, name)


def _leg(name: str, fields: dict[str, Any]) -> Leg:
    kept: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()
    }
    return Leg(**{"yaw_deg": 0.0} | kept | {"name": name, "kind": LegKind(kept["kind"])})


class _Loop(NamedTuple):
    """How often a sequence is looped (None: forever), and which part of it (None: all)."""

    passes: int | None
    span_s: tuple[float, float] | None = None


TIME_DECIMALS: Final = 6
"""Key times are rounded to a microsecond, for readable files."""


def sequence_of(gait: Gait, robot: Robot) -> Sequence:
    """Return the keyframes of `gait` for `robot`; raises what `paced` raises.

    Only the joints of the legs are keyed. The sequence starts and ends at rest.
    """
    return sequence_from(gait, paced(gait, robot))


def sequence_from(gait: Gait, passages: tuple[Paced, ...]) -> Sequence:
    """Return the keyframes of passages that `paced` returned for `gait`."""
    names = joints_of(gait)
    keyframes: list[Keyframe] = []
    start_s, loop = 0.0, _Loop(gait.loop)
    for part in passages:
        owners = [action_at(part.passage, at_s) for at_s in part.times_s.tolist()]
        is_labelled: set[int] = set()
        rows = part.angles_deg.tolist()
        times_s = (part.times_s * part.pace_ratio).tolist()
        # The first key of a passage is the last one of the passage before.
        for index in range(1 if keyframes else 0, len(rows)):
            is_last = index == len(rows) - 1
            action = part.actions[owners[index]]
            is_first = owners[index] not in is_labelled
            is_labelled.add(owners[index])
            keyframes.append(
                Keyframe(
                    deg=dict(zip(names, rows[index], strict=True)),
                    at_s=round(start_s + times_s[index], TIME_DECIMALS),
                    hold_s=part.hold_s if is_last else 0.0,
                    ease=Interpolation.SPLINE,
                    label=action.label if is_first else "",
                    line=action.line,
                )
            )
        loop = _looped(gait, part, start_s) or loop
        start_s = (keyframes[-1].at_s or 0.0) + part.hold_s
    if len(keyframes) > KEYFRAMES_MAX:
        raise InputError(
            f"the gait has {len(keyframes):,} keyframes, at most {KEYFRAMES_MAX:,} are planned in "
            "one piece; only the longest walk of a gait without loop may be longer, so use shorter "
            "walks, or several gaits in a play list",
            path=gait.path,
        )
    return Sequence(
        name=gait.name,
        keyframes=tuple(keyframes),
        path=gait.path,
        robot_path=gait.robot_path,
        timing=Timing.AUTHORED,
        loop=loop.passes,
        loop_span_s=loop.span_s,
    )


def _looped(gait: Gait, part: Paced, start_s: float) -> _Loop | None:
    """Return the looped cycle of this passage; None if it has none."""
    for index, action in enumerate(part.actions):
        if not isinstance(action, Walk) or action.more_cycles == 0:
            continue
        assert isinstance(part.passage, Walking)
        steady_s = float(part.passage.begins_s[index]) + LEAD_IN_CYCLES * gait.cycle_s
        from_s, to_s = (
            round(start_s + part.pace_ratio * at_s, TIME_DECIMALS)
            for at_s in (steady_s, steady_s + gait.cycle_s)
        )
        more = action.more_cycles
        return _Loop(None if more is None else more + 1, (from_s, to_s))
    return None
