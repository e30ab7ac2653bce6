"""Gait → joint angles at keys, at the pace of the author or as fast as the servo limits allow.

The actions are split into passages from rest to rest; each is checked for reach, joint ranges and
stability, and slowed as a whole. `gait_lines` describes the result in text.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.show.gait.curves import spline
from lss_motion.show.gait.kinematics import forward, inverse, reach_excess_mm
from lss_motion.show.gait.model import PATTERNS, BodyMove, Walk
from lss_motion.show.gait.passage import Walking, posing, walking

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.kinematics import Stance
    from lss_motion.show.gait.model import Action, BodyPose, Gait
    from lss_motion.show.gait.passage import Passage

    FloatArray = NDArray[np.float64]


KEYS_PER_CYCLE: Final = 16
"""Keys of one cycle, or of a second of posing, at first; doubled while feet deviate too much."""

FOOT_ERROR_MM: Final = 0.05
"""Largest deviation of a foot between keys. Chosen: a tenth of the slip that is allowed."""

DOUBLINGS_MAX: Final = 5
"""512 keys a cycle. Measured: one doubling is usual, two are needed near the end of the reach."""

ANGLE_DECIMALS: Final = 5
"""Keys are rounded, for people to read. At 512 keys a cycle this is 2 % of the acceleration."""

ACCEL_SHARE: Final = 0.9
"""Share of a joint's acceleration that is used: a servo that is limited by its ramp cannot catch
up. Measured, nine patterns with five seeds each: the largest error of a horn is 0.62 deg with 1.0,
0.52 with 0.9, 0.37 with 0.8; 0.9 takes 5 % longer and 0.8 12 %. The slip of feet is the same for
all three. Chosen: most of the speed."""

ROUNDING: Final = 1e-9
"""Absolute error of counts that would be whole without rounding."""

TIP_RATIO_MIN: Final = 0.15
"""A robot that tips onto its lifted feet within this share of their step goes nowhere. Measured in
MuJoCo (`tools/benches/walks.py`, 60 gaits): with shares up to 0.10 it gets to less than a twentieth
of the way, with shares from 0.23 on to more than half; none lies between."""

SWAYS: Final = (0.5, 0.75, 1.25, 1.5, 2.0)
SWAYS_MM: Final = (10.0, 20.0, 40.0)
"""Chosen: the sways that are tried where a static pattern would fall, by the present one and alone:
beyond twice the present one joints leave their ranges."""
SWAY_SAMPLES: Final = 400

TURN_S: Final = 1e-6
"""Stability is checked this long before and after a foot lifts or lands."""


class Paced(Struct, frozen=True, kw_only=True):
    """One passage within the servo limits: all of it is slowed by `pace_ratio`, 1 or more.

    `times_s` are those of the author. The joints follow the clamped spline through `angles_deg`,
    (n, joints), ordered by legs. `joint` and `limit` are the ones used most. `margin_min_mm` is
    the smallest stability margin (see `Stance.margin_mm`), at `margin_min_s`. `slope_max_deg` is a
    slope on which nothing is left of it at some instant (`Stance.slope_deg`).
    """

    passage: Passage
    actions: tuple[Action, ...]
    times_s: FloatArray
    angles_deg: FloatArray
    pace_ratio: float
    joint: str
    limit: Literal["speed", "acceleration"]
    margin_min_mm: float
    margin_min_s: float
    slope_max_deg: float
    tip_ratio: float
    """How soon the body tips onto its lifted feet, as a share of the time of their step; 1 or more:
    it does not, or not before they land."""
    hold_s: float

    @property
    def duration_s(self) -> float:
        """How long it takes, without the hold after it."""
        return float(self.times_s[-1]) * self.pace_ratio


def joints_of(gait: Gait) -> tuple[str, ...]:
    """Return the joints of all legs, in the order of `Paced.angles_deg`."""
    return tuple(joint for leg in gait.legs for joint in leg.joints)


def paced(gait: Gait, robot: Robot) -> tuple[Paced, ...]:
    """Return the passages of a gait, each within the limits of the joints of `robot`.

    A passage that is too fast is slowed evenly, so that body and feet keep their paths and a
    steady cycle stays steady. Raises `InputError` with the line for a foot out of reach or a
    joint out of its range, and `PlanningError` where a static pattern would fall.
    """
    return tuple(_paced(gait, robot, *part) for part in _passages(gait))


def _passages(gait: Gait) -> Iterator[tuple[Passage, tuple[Action, ...]]]:
    """Split the actions where the robot rests: at holds, and between posing and walking."""
    pose: BodyPose = gait.start
    together: list[Action] = []
    for action, following in pairwise([*gait.actions, None]):
        assert action is not None
        together.append(action)
        is_held = isinstance(action, BodyMove) and action.hold_s > 0.0
        if following is not None and type(following) is type(action) and not is_held:
            continue
        moves = [own for own in together if isinstance(own, BodyMove)]
        walks = [own for own in together if isinstance(own, Walk)]
        yield (posing(gait, pose, moves) if moves else walking(gait, pose, walks)), (*together,)
        pose = moves[-1].pose if moves else pose
        together = []


def _paced(gait: Gait, robot: Robot, passage: Passage, actions: tuple[Action, ...]) -> Paced:
    times_s, angles_deg = _keys(gait, passage, actions)
    check_range(gait, robot, passage, times_s, angles_deg, actions)
    speed, accel = spline(float(times_s[1]), angles_deg).peaks()
    joints = [robot.joints[name] for name in joints_of(gait)]
    by_speed = speed / np.array([joint.speed_max_deg_s for joint in joints])
    # Acceleration falls with the square of the pace ratio; its root compares with the speed.
    allowed = ACCEL_SHARE * np.array([joint.accel_max_deg_s2 for joint in joints])
    by_accel = np.sqrt(accel / allowed)
    used = np.maximum(by_speed, by_accel)
    tightest = int(np.argmax(used))
    checked_s = checked_times_s(passage, times_s)
    stance = passage.at(checked_s)
    margin_mm = stance.margin_mm()
    worst = int(np.argmin(margin_mm))
    check_margin(gait, passage, actions, float(margin_mm[worst]), float(checked_s[worst]))
    last, pace_ratio = actions[-1], max(1.0, float(used[tightest]))
    return Paced(
        passage=passage,
        actions=actions,
        times_s=times_s,
        angles_deg=angles_deg,
        pace_ratio=pace_ratio,
        joint=joints[tightest].name,
        limit="speed" if by_speed[tightest] >= by_accel[tightest] else "acceleration",
        margin_min_mm=float(margin_mm[worst]),
        margin_min_s=float(checked_s[worst]),
        slope_max_deg=float(stance.slope_deg().min()),
        tip_ratio=_tip_ratio(gait, stance, margin_mm, pace_ratio),
        hold_s=last.hold_s if isinstance(last, BodyMove) else 0.0,
    )


def _tip_ratio(gait: Gait, stance: Stance, margin_mm: FloatArray, pace_ratio: float) -> float:
    """Return how soon the body tips, at the middle one of the instants at which it does."""
    is_outside = margin_mm < 0.0
    if not is_outside.any():
        return 1.0
    tips_s = stance.tip_s(gait.step_height_mm)[is_outside]
    return min(1.0, float(np.median(tips_s)) / _step_s(gait, pace_ratio))


def _step_s(gait: Gait, pace_ratio: float) -> float:
    """Return how long a foot is in the air."""
    return (1.0 - gait.duty) * gait.cycle_s * pace_ratio


def _keys(
    gait: Gait, passage: Passage, actions: tuple[Action, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return equidistant keys, as many as keep the feet on their paths between them.

    Every cycle of a walk has the same whole number of keys, so that steady cycles are equal.
    """
    unit_s, end_s = 1.0, passage.duration_s
    if isinstance(passage, Walking):
        unit_s = gait.cycle_s
    count = max(2, math.ceil(KEYS_PER_CYCLE * end_s / unit_s - ROUNDING))
    if isinstance(passage, Walking):
        end_s = count * unit_s / KEYS_PER_CYCLE
    for _ in range(DOUBLINGS_MAX + 1):
        times_s = np.linspace(0.0, end_s, count + 1)
        angles_deg = angles_at(gait, passage, times_s, actions)
        angles_deg = np.round(angles_deg, ANGLE_DECIMALS) + 0.0  # No negative zeros.
        between_deg = spline(float(times_s[1]), angles_deg).middles()
        if error_mm(gait, passage, times_s, between_deg) <= FOOT_ERROR_MM:
            return times_s, angles_deg
        count *= 2
    raise InputError(
        "a leg is so close to the end of its reach that its joints cannot follow the foot; lower "
        "the body, or take shorter steps",
        path=gait.path,
        line=actions[0].line,
    )


def angles_at(
    gait: Gait, passage: Passage, times_s: FloatArray, actions: tuple[Action, ...]
) -> FloatArray:
    """Return the joint angles at instants of a passage; `InputError`: a foot is out of reach."""
    feet = passage.at(times_s).feet_in_body()
    columns = []
    for index, leg in enumerate(gait.legs):
        try:
            columns.append(inverse(leg, feet[:, index]))
        except InputError as error:
            worst = int(np.argmax(np.abs(reach_excess_mm(leg, feet[:, index]))))
            line = _line(passage, actions, float(times_s[worst]))
            raise InputError(error.reason, path=gait.path, line=line) from error
    return np.concatenate(columns, axis=1)


def _line(passage: Passage, actions: tuple[Action, ...], at_s: float) -> int | None:
    """Return the line of the action that is under way."""
    return actions[action_at(passage, at_s)].line


def action_at(passage: Passage, at_s: float) -> int:
    """Return the index of the action that is under way `at_s` after the passage's start."""
    return max(0, int(np.searchsorted(passage.starts_s, at_s, side="right")) - 1)


def error_mm(gait: Gait, passage: Passage, times_s: FloatArray, between_deg: FloatArray) -> float:
    """Return the largest deviation of a foot from its path, halfway between keys."""
    path_mm = passage.at(0.5 * (times_s[1:] + times_s[:-1])).feet_in_body()
    return max(
        float(np.linalg.norm(forward(leg, own) - path_mm[:, index], axis=1).max())
        for index, (leg, own) in enumerate(
            zip(gait.legs, np.split(between_deg, len(gait.legs), axis=1), strict=True)
        )
    )


def check_range(
    gait: Gait,
    robot: Robot,
    passage: Passage,
    times_s: FloatArray,
    angles_deg: FloatArray,
    actions: tuple[Action, ...],
) -> None:
    """Raise `InputError` where a joint would leave its range."""
    for own_deg, name in zip(angles_deg.T, joints_of(gait), strict=True):
        for worst in (int(own_deg.argmin()), int(own_deg.argmax())):
            if reason := robot.joints[name].range_problem(float(own_deg[worst])):
                raise InputError(
                    f"{reason}; take shorter steps, another height, or a smaller shift or tilt",
                    path=gait.path,
                    line=_line(passage, actions, float(times_s[worst])),
                )


def checked_times_s(passage: Passage, times_s: FloatArray) -> FloatArray:
    """Return the instants to check for stability: all keys, and next to lifts and landings."""
    turns_s = passage.turns_s
    return np.concatenate([times_s, turns_s - TURN_S, turns_s + TURN_S])


def check_margin(
    gait: Gait, passage: Passage, actions: tuple[Action, ...], margin_mm: float, at_s: float
) -> None:
    """Raise `PlanningError` if the margin is negative in a static pattern or a pose."""
    is_walk = isinstance(actions[0], Walk)
    if margin_mm >= 0.0 or (is_walk and not gait.pattern.is_static):
        return
    line = _line(passage, actions, at_s)
    place = "" if gait.path is None or line is None else f"{gait.path}:{line}: "
    what = f"the pattern {gait.pattern.name!r}" if is_walk else "this pose"
    remedy = _walk_remedy(gait, actions, margin_mm) if is_walk else "a smaller shift"
    raise PlanningError(
        f"{place}{what} would fall: {at_s:.2f} s after its start the body's centre is "
        f"{-margin_mm:.1f} mm outside of the feet that stand; try {remedy}",
        time_s=at_s,
    )


def _walk_remedy(gait: Gait, actions: tuple[Action, ...], margin_mm: float) -> str:
    """Return what would keep the body over its feet: the best of some sways, if one does."""
    walks = [own for own in actions if isinstance(own, Walk)]
    best_mm, best = margin_mm, gait.sway_mm
    for sway_mm in sorted({0.0, *(gait.sway_mm * r for r in SWAYS), *SWAYS_MM}):
        changed = replace(gait, sway_mm=sway_mm)
        passage = walking(changed, changed.start, walks)
        times_s = np.linspace(0.0, passage.duration_s, SWAY_SAMPLES)
        found_mm = float(passage.at(checked_times_s(passage, times_s)).margin_mm().min())
        if found_mm > best_mm:
            best_mm, best = found_mm, sway_mm
    now = f"duty (now {gait.duty:g})"
    if best_mm > 0.0:
        return (
            f"sway_mm: {best:.0f} (now {gait.sway_mm:.0f}), with which it stays {best_mm:.0f} mm "
            f"inside, or a longer {now}"
        )
    return f"a longer {now} or shorter steps; no sway_mm alone helps (now {gait.sway_mm:.0f})"


def gait_lines(gait: Gait, passages: tuple[Paced, ...]) -> list[str]:
    """Return a line for the gait, and lines for each passage and its actions."""
    lasts_s = sum(part.duration_s + part.hold_s + looped_s(gait, part) for part in passages)
    lasts = "without end" if lasts_s == math.inf else f"one pass {lasts_s:.2f} s"
    safe = "static" if gait.pattern.is_static else "dynamic"
    lines = [
        f"{gait.name}: {len(gait.legs)} legs, pattern {gait.pattern.name} ({safe}), duty "
        f"{gait.duty:.2f}, {lasts}"
    ]
    start_s = 0.0
    for part in passages:
        end_s = start_s + part.duration_s + looped_s(gait, part)
        until = "on" if end_s == math.inf else f"to {end_s:.2f} s"
        lines.append(f"{start_s:.2f} s {until}: {_pace_text(part)}")
        if part.tip_ratio < TIP_RATIO_MIN:
            lines.append(f"  {_tip_text(gait, part)}")
        lines += [f"  {_action_text(gait, action, part.pace_ratio)}" for action in part.actions]
        start_s = end_s + part.hold_s
    return lines


def gait_as_json(gait: Gait, passages: tuple[Paced, ...]) -> dict[str, Any]:
    """Return what `gait_lines` says as the JSON object of `gait --json`; null: without end."""
    start_s, parts = 0.0, []
    for part in passages:
        end_s = start_s + part.duration_s + looped_s(gait, part)
        parts.append(
            {
                "start_s": start_s,
                "end_s": None if end_s == math.inf else end_s,
                "hold_s": part.hold_s,
                "pace_ratio": part.pace_ratio,
                "joint": part.joint,
                "limit": part.limit,
                "margin_min_mm": part.margin_min_mm,
                "slope_max_deg": part.slope_max_deg,
                "tip_ratio": part.tip_ratio,
                "margin_at_s": part.margin_min_s * part.pace_ratio,
                "actions": [
                    {"label": action.label, "line": action.line} | _action_json(action, part)
                    for action in part.actions
                ],
            }
        )
        start_s = end_s + part.hold_s
    return {
        "kind": "gait",
        "schema": 1,
        "name": gait.name,
        "legs": [leg.name for leg in gait.legs],
        "pattern": gait.pattern.name,
        "is_static": gait.pattern.is_static,
        "duty_ratio": gait.duty,
        "duration_s": None if start_s == math.inf else start_s,
        "passages": parts,
    }


def _action_json(action: Action, part: Paced) -> dict[str, Any]:
    if not isinstance(action, Walk):
        return {"in_s": action.in_s * part.pace_ratio, "hold_s": action.hold_s}
    more = action.more_cycles
    return {
        "forward_mm_s": action.forward_mm_s / part.pace_ratio,
        "left_mm_s": action.left_mm_s / part.pace_ratio,
        "turn_deg_s": action.turn_deg_s / part.pace_ratio,
        "cycles": None if more is None else action.cycles + more,
    }


def looped_s(gait: Gait, part: Paced) -> float:
    """Return how long the looped cycles take that are not laid out; `math.inf`: forever."""
    more = [own.more_cycles for own in part.actions if isinstance(own, Walk)]
    cycles = sum(math.inf if count is None else count for count in more)
    return cycles * gait.cycle_s * part.pace_ratio


def _pace_text(part: Paced) -> str:
    margin_mm, at_s = part.margin_min_mm, part.margin_min_s * part.pace_ratio
    text = (
        f"body at least {margin_mm:.0f} mm inside of its feet (after {at_s:.2f} s), on ground that "
        f"slopes by less than {part.slope_max_deg:.1f} deg"
    )
    if margin_mm < 0.0:
        text = f"body up to {-margin_mm:.0f} mm outside of its feet (after {at_s:.2f} s)"
        if part.tip_ratio < 1.0:
            text += f", tipping onto the lifted ones after {part.tip_ratio:.0%} of a step"
    pace = "at the pace of the file"
    if part.pace_ratio > 1.0:
        pace = f"{part.pace_ratio:.3f} times slower, for {part.limit} of joint {part.joint!r}"
    return f"{pace}; {text}"


def _tip_text(gait: Gait, part: Paced) -> str:
    """Return the warning about a robot that tips onto the feet that should step."""
    step_s = _step_s(gait, part.pace_ratio)
    others = ", ".join(sorted(p.name for p in PATTERNS[len(gait.legs)].values() if p.is_static))
    return (
        f"it will not get far: the body tips onto its lifted feet after "
        f"{part.tip_ratio * step_s:.2f} of the {step_s:.2f} s of a step. Take a shorter cycle_s "
        f"(now {gait.cycle_s:g}), a higher step_height_mm (now {gait.step_height_mm:g}), or "
        f"another pattern (now {gait.pattern.name}; {others} cannot tip)"
    )


def _action_text(gait: Gait, action: Action, pace_ratio: float) -> str:
    place = "" if action.line is None else f" (line {action.line})"
    if not isinstance(action, Walk):
        hold = f", held {action.hold_s:g} s" if action.hold_s > 0.0 else ""
        return f"{action.label}{place}: in {action.in_s * pace_ratio:.2f} s{hold}"
    speed_mm_s = float(np.hypot(action.forward_mm_s, action.left_mm_s))
    moves = []
    if speed_mm_s > 0.0:
        moves.append(f"{speed_mm_s / pace_ratio:.1f} mm/s")
    if action.turn_deg_s != 0.0:
        moves.append(f"{action.turn_deg_s / pace_ratio:.1f} deg/s")
    cycle_s = gait.cycle_s * pace_ratio
    how = " and ".join(moves) or "on the spot"
    more = action.more_cycles
    count = None if more is None else action.cycles + more
    cycles = "forever, in cycles" if count is None else f"{count} cycle{'' if count == 1 else 's'}"
    return f"{action.label}{place}: {how}, {cycles} of {cycle_s:.2f} s"
