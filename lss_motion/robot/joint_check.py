"""What must agree within one joint of a robot file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.errors import ProtocolError
from lss_motion.protocol.family import Family
from lss_motion.robot.models import FAMILIES
from lss_motion.spelling import known_names

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lss_motion.robot.model import Joint
    from lss_motion.yaml_source import Location


def joint_problems(
    joint: Joint, place: Callable[[str], Location]
) -> Iterator[tuple[Location, str]]:
    """Yield what is wrong with a joint, and where; `place` says where a key of it stands."""
    model, facts = joint.model, FAMILIES[joint.model.family]
    if joint.position_min_deg >= joint.position_max_deg:
        yield (
            place("range_deg"),
            f"joint {joint.name!r}: range_deg must rise, but goes from "
            f"{joint.position_min_deg:g} to {joint.position_max_deg:g}",
        )
    yield from _unread_problems(joint, place)
    if joint.speed_max_deg_s > model.speed_max_deg_s:
        yield (
            place("speed_max_deg_s"),
            f"joint {joint.name!r}: {joint.speed_max_deg_s:g} deg/s is faster than an "
            f"{model.name} can turn without load, {model.speed_max_deg_s:g} deg/s",
        )
    if joint.drive == "timed" and joint.accel_max_deg_s2 > facts.accel_max_deg_s2:
        yield (
            place("accel_max_deg_s2"),
            f"joint {joint.name!r}: {joint.accel_max_deg_s2:g} deg/s² is more than the ramps of "
            f"the servo (AA, AD) can express, {facts.accel_max_deg_s2:g} deg/s²; a joint with "
            f"`drive: streamed` needs none",
        )
    if joint.drive in ("timed", "auto") and joint.accel_max_deg_s2 < facts.accel_step_deg_s2:
        yield (
            place("accel_max_deg_s2"),
            f"joint {joint.name!r}: {joint.accel_max_deg_s2:g} deg/s² is less than the ramps of "
            f"the servo (AA, AD) can express, {facts.accel_step_deg_s2:g} deg/s²",
        )
    for keyword, value in joint.settings.items():
        where = place(f"settings.{keyword}")
        if keyword not in facts.settings:
            known = known_names(keyword, facts.settings)
            yield where, f"joint {joint.name!r}: unknown setting {keyword!r}; {known}"
        elif not facts.settings[keyword][0] <= value <= facts.settings[keyword][1]:
            least, most = facts.settings[keyword]
            yield where, f"joint {joint.name!r}: {keyword} {value} must be {least} to {most}"
    if joint.stored:
        yield from _stored_problems(joint, place)


def _unread_problems(
    joint: Joint, place: Callable[[str], Location]
) -> Iterator[tuple[Location, str]]:
    if joint.unread and joint.model.family is Family.IO2:
        yield (
            place(max(joint.unread)),
            f"joint {joint.name!r}: an RC servo on a 2IO knows no limits; give a number",
        )
    elif "accel_max_deg_s2" in joint.unread and joint.drive == "streamed":
        yield (
            place("accel_max_deg_s2"),
            f"joint {joint.name!r}: the ramps of a servo do not act while it is streamed; give a "
            f"number",
        )


def _stored_problems(
    joint: Joint, place: Callable[[str], Location]
) -> Iterator[tuple[Location, str]]:
    # Only a file that has the key pays for the tables of the protocol.
    from lss_motion.protocol.storing import stored_wire

    for keyword, stored in joint.stored.items():
        try:
            stored_wire(joint.model.family, keyword, stored)
        except ProtocolError as error:
            yield place(f"stored.{keyword}"), f"joint {joint.name!r}: {error}"
