"""The legs of a gait file: defaults merged, checked against the robot, in the order of patterns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from lss_motion.gait.model import Leg, LegKind
from lss_motion.gait.patterns import PARTS, SIDES_NEEDED, in_order
from lss_motion.spelling import known_names
from lss_motion.yaml_source import Problem

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.gait.file import GaitFile, LegEntry
    from lss_motion.robot.model import Robot

_NEEDED: Final = ("kind", "lengths_mm", "stance_mm")

TWO_LEGS: Final = (
    "two legs balance only while they fall from step to step, which needs a sense of balance that "
    "servos do not have; four or six legs are walked"
)


def legs_of(content: GaitFile, robot: Robot) -> tuple[tuple[Leg, ...], list[Problem]]:
    """Return the legs, left before right and front before rear, and what is wrong with them.

    There are no legs where something is wrong.
    """
    entries = content.legs or {}
    problems: list[Problem] = []
    legs: list[Leg] = []
    owners: dict[str, str] = {}
    for name, entry in entries.items():
        fields = {
            key: value
            for owner in (content.leg, entry)
            for key in owner.model_fields_set
            if (value := getattr(owner, key)) is not None
        }
        found = [*_problems(name, fields), *_joint_problems(name, entry, robot, owners)]
        problems += found
        if not found:
            legs.append(_leg(name, fields))
    ordered = in_order(legs)
    if problems:
        return (), problems
    if len(entries) not in PARTS:
        reason = TWO_LEGS if len(entries) == 2 else f"{len(entries)} legs; 4 or 6 are walked"
        return (), [Problem(("legs",), reason)]
    if ordered is None:
        return (), [Problem(("legs",), f"a robot needs {SIDES_NEEDED}")]
    return ordered, []


def _problems(name: str, fields: dict[str, Any]) -> Iterator[Problem]:
    place = ("legs", name)
    for key in _NEEDED:
        if key not in fields:
            yield Problem((*place, key), f"leg {name!r} has no {key!r}; give it here or in 'leg'")
    kind = fields.get("kind")
    if kind is None:
        return
    if kind not in list(LegKind):
        known = known_names(kind, [own.value for own in LegKind])
        yield Problem((*place, "kind"), f"leg {name!r}: unknown kind {kind!r}; {known}")
        return
    other = {LegKind.COXA: "knee", LegKind.ABDUCTION: "yaw_deg"}[LegKind(kind)]
    if other in fields:
        yield Problem((*place, other), f"leg {name!r}: {other!r} means nothing for {kind} legs")
    if kind == LegKind.COXA and "yaw_deg" not in fields:
        yield Problem(place, f"leg {name!r} has no 'yaw_deg', where it points: 90 is left")


def _joint_problems(
    name: str, entry: LegEntry, robot: Robot, owners: dict[str, str]
) -> Iterator[Problem]:
    for index, joint in enumerate(entry.joints):
        place = ("legs", name, "joints", index)
        if joint not in robot.joints:
            known = known_names(joint, robot.joints)
            yield Problem(place, f"leg {name!r}: unknown joint {joint!r}; {known}")
        elif joint in owners:
            yield Problem(place, f"joint {joint!r} is already one of leg {owners[joint]!r}")
        owners.setdefault(joint, name)


def _leg(name: str, fields: dict[str, Any]) -> Leg:
    kept: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()
    }
    return Leg(**{"yaw_deg": 0.0} | kept | {"name": name, "kind": LegKind(kept["kind"])})
