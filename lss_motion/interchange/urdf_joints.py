"""The joints of a URDF file that servos turn: their limits as a servo can have them.

What a value stands for that the file does not have, or that no servo can do, is a note.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.files.keys import TEXT_MAX_CHARS
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.servo_models import SERVO_ID_MAX
from lss_motion.robot.urdf import TURNING, UrdfJoint

if TYPE_CHECKING:
    from lss_motion.robot.model import ServoModel
    from lss_motion.robot.urdf import UrdfFile

DEGENERATE_DEG: Final = 90.0
"""Chosen: the range of a joint whose limits are equal. Most brackets allow it."""
SPEED_SHARE: Final = 1.0 / 3.0
"""Chosen: the share of a servo's speed without load for a joint whose file has no velocity."""
ACCEL_DEG_S2: Final = 500.0
"""Chosen: half of what the ramps of an LSS can express. URDF has no acceleration."""
WIRE_DEG: Final = 0.1
"""Limits are written in these steps, inwards: one unit of an LSS (FACTS.md C1)."""
SAME_DEG: Final = 0.01
"""A limit this close to a step is rounded to it: radians with four decimals."""
RATIO_MAX: Final = 10.0
"""Chosen: a gear with a larger ratio is that inside of a servo, which has 146 and more
(FACTS.md E3)."""
NOT_IN_NAMES: Final = re.compile(r"[^\w.\-]+")


class ServoJoint(Struct, frozen=True, kw_only=True):
    """One joint that a servo turns: the joint of the URDF file, its name in the robot file."""

    urdf: UrdfJoint
    name: str
    range_deg: tuple[float, float]
    speed_max_deg_s: float
    ratio: float
    """Degrees of the servo for one degree of the joint."""


class ImportNotes:
    """Collects notes; what holds for several joints or links is one line with all their names."""

    def __init__(self) -> None:
        self._names: dict[str, list[str]] = {}

    def add(self, name: str, text: str) -> None:
        self._names.setdefault(text, []).append(name)

    def lines(self) -> tuple[str, ...]:
        return tuple(
            f"{', '.join(names)}: {text}" if names[0] else text
            for text, names in self._names.items()
        )


def servo_joints(file: UrdfFile, model: ServoModel, notes: ImportNotes) -> tuple[ServoJoint, ...]:
    found, used = [], set[str]()
    reductions = _reductions(file)
    for joint in file.joints.values():
        if joint.kind not in TURNING:
            if joint.kind == "prismatic":
                notes.add(joint.name, "slides; a servo turns, so it stands at its origin")
            continue
        if (mimic := joint.element.one("mimic")) is not None:
            other = file.text(mimic, "joint")
            notes.add(joint.name, f"mimics {other}: it is drawn, and no servo turns it")
            continue
        name = NOT_IN_NAMES.sub("_", joint.name)[:TEXT_MAX_CHARS]
        while name in used:
            name = f"{name[: TEXT_MAX_CHARS - 1]}_"
        used.add(name)
        ratio = _ratio(reductions.get(joint.name, 1.0), name, notes)
        found.append(
            ServoJoint(
                urdf=joint,
                name=name,
                range_deg=_range_deg(file, joint, name, HALF_TURN_DEG / max(ratio, 1.0), notes),
                speed_max_deg_s=_speed_deg_s(file, joint, name, model, notes),
                ratio=ratio,
            )
        )
    if not found:
        file.refuse(file.root, "no joint in it turns; a servo needs a revolute or continuous one")
    if len(found) > SERVO_ID_MAX:
        file.refuse(file.root, f"has {len(found)} joints that turn; a bus has {SERVO_ID_MAX} ids")
    counting = f"1 to {len(found)}" if len(found) > 1 else "1"
    notes.add("", f"ids {counting} are numbered in the order of the file: write yours")
    notes.add("", f"accel_max_deg_s2 {ACCEL_DEG_S2:g} is chosen: URDF has no acceleration")
    notes.add("", "direction and zero_deg are not in URDF: find them with lss-motion calibrate")
    return tuple(found)


def _reductions(file: UrdfFile) -> dict[str, float]:
    """Return the mechanical reduction of each joint that a `<transmission>` names."""
    found = {}
    for one in file.root.of("transmission"):
        for joint in one.of("joint"):
            for part in (*one.of("actuator"), joint):
                given = part.one("mechanicalReduction")
                if given is not None and (number := finite(given.text) or 0.0) > 0.0:
                    found[joint.attributes.get("name", "")] = number
    return found


def _ratio(reduction: float, name: str, notes: ImportNotes) -> float:
    if reduction == 1.0:
        return 1.0
    gear = f"has a gear of {reduction:g} between actuator and joint"
    if not 1.0 / RATIO_MAX <= reduction <= RATIO_MAX:
        notes.add(name, f"{gear}, which counts as the one inside of the servo")
        return 1.0
    notes.add(name, f"{gear}; remove `ratio` if it is the one inside of the servo")
    return reduction


def finite(text: str | None) -> float | None:
    """Return the number that a text holds; None: it holds none."""
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _range_deg(
    file: UrdfFile, joint: UrdfJoint, name: str, most_deg: float, notes: ImportNotes
) -> tuple[float, float]:
    limit, spare_deg = joint.element.one("limit"), min(DEGENERATE_DEG, most_deg)
    if joint.kind == "continuous":
        notes.add(name, f"turns without end; {_text(-most_deg, most_deg)} is allowed")
        return -most_deg, most_deg
    if limit is None or not {"lower", "upper"} & limit.attributes.keys():
        notes.add(name, f"has no limits; {_text(-spare_deg, spare_deg)} is assumed")
        return -spare_deg, spare_deg
    lower = math.degrees(file.number(limit, "lower", 0.0))
    upper = math.degrees(file.number(limit, "upper", 0.0))
    if lower > upper:
        notes.add(name, f"its limits stand in the wrong order; {_text(upper, lower)} is written")
        lower, upper = upper, lower
    if upper - lower < WIRE_DEG:
        text = _text(lower - spare_deg, upper + spare_deg)
        notes.add(name, f"both limits are {lower:g} deg; {text} is assumed")
        lower, upper = lower - spare_deg, upper + spare_deg
    low, high = max(_inwards(lower, 1), -most_deg), min(_inwards(upper, -1), most_deg)
    if lower < -most_deg - SAME_DEG or upper > most_deg + SAME_DEG:
        if low >= high:
            low, high = -most_deg, most_deg
        notes.add(
            name,
            f"its limits are {_text(lower, upper)}; without `turns` its servo counts "
            f"{_text(low, high)}, which is written",
        )
    return low, high


def _inwards(angle_deg: float, side: int) -> float:
    """Return the angle in whole steps: the nearest one if it is close, else up or down."""
    near = round(angle_deg / WIRE_DEG) * WIRE_DEG
    if abs(near - angle_deg) > SAME_DEG:
        steps = angle_deg / WIRE_DEG
        near = (math.ceil(steps) if side > 0 else math.floor(steps)) * WIRE_DEG
    return round(near, 1) + 0.0


def _text(low: float, high: float) -> str:
    return f"{low:.4g}..{high:.4g} deg"


def _speed_deg_s(
    file: UrdfFile, joint: UrdfJoint, name: str, model: ServoModel, notes: ImportNotes
) -> float:
    limit = joint.element.one("limit")
    given = 0.0 if limit is None else math.degrees(file.number(limit, "velocity", 0.0))
    if given <= 0.0:
        speed = round(SPEED_SHARE * model.speed_max_deg_s)
        share = "a third of what the servo does without load"
        notes.add(name, f"has no velocity; {speed:g} deg/s is chosen, {share}")
        return float(speed)
    if given > model.speed_max_deg_s + SAME_DEG:
        most = model.speed_max_deg_s
        notes.add(name, f"its velocity is {given:.0f} deg/s; an {model.name} does {most:g}")
        return most
    return math.floor(given * 10.0 + SAME_DEG) / 10.0
