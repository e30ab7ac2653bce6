"""Which drive fits which servo model, and what an LSS-2IO asks of the bus that it is on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.family import Family
from lss_motion.protocol.io2 import BAUD_MAX_BPS, SECTION_MAX_CHARS
from lss_motion.protocol.line import encode_move
from lss_motion.robot.models import FAMILIES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lss_motion.robot.model import Bus, Drive, Joint, ServoModel

FILTER_FIRMWARE_MIN: Final = 368
"""Firmware 368 brought FPC (FACTS.md M5)."""
RC_RANGE_DEG: Final = 90.0
"""An LSS-2IO turns its RC servos by ±90 (FACTS.md B6)."""
DURATION_DIGITS_MS: Final = 9_999
"""The longest T that a move on the bus is given (`program.course.DURATION_MAX_MS`)."""

_WHY: Final = {
    (Family.LSS_PRO, "streamed"): "no document gives an LSS-PRO the filter (FPC) that it needs",
    (Family.IO2, "timed"): "an RC servo knows no T; it jumps",
    (Family.IO2, "streamed"): "an RC servo has no filter; it jumps",
}
_STEPPED_WHY: Final = "whole degrees are for the RC servos of an LSS-2IO"


def drive_problem(model: ServoModel, drive: Drive) -> str:
    """Return why a servo of that model cannot be driven so, or nothing if it can."""
    allowed = FAMILIES[model.family].drives
    if drive in allowed:
        return ""
    why = _WHY.get((model.family, drive), _STEPPED_WHY)
    return f"an {model.name} cannot be {drive}: {why}; it can be {' or '.join(allowed)}"


def can_be_streamed(joint: Joint, bus: Bus) -> bool:
    """Return whether a servo of that model and firmware has the filter of EM0."""
    return "streamed" in FAMILIES[joint.model.family].drives and bus.firmware >= FILTER_FIRMWARE_MIN


def board_problems(
    buses: Mapping[str, Bus], joints: Mapping[str, Joint]
) -> Iterator[tuple[tuple[str, str, str], str]]:
    """Yield place and reason of every drive, line and range that model and bus do not allow."""
    has_board = {j.bus for j in joints.values() if j.model.family is Family.IO2}
    for name in sorted(has_board):
        if buses[name].baud_bps > BAUD_MAX_BPS:
            yield (
                ("buses", name, "baud_bps"),
                f"{buses[name].baud_bps} bps is too fast for the LSS-2IO on bus {name!r}; at most "
                f"{BAUD_MAX_BPS}",
            )
    for joint in joints.values():
        bus = buses[joint.bus]
        if joint.drive != "auto" and (reason := drive_problem(joint.model, joint.drive)):
            yield ("joints", joint.name, "drive"), f"joint {joint.name!r}: {reason}"
        if joint.drive == "streamed" and bus.firmware < FILTER_FIRMWARE_MIN:
            yield (
                ("joints", joint.name, "drive"),
                f"joint {joint.name!r} cannot be streamed: that needs firmware "
                f"{FILTER_FIRMWARE_MIN} or later, but bus {bus.name!r} has {bus.firmware}",
            )
        if joint.model.family is Family.IO2:
            yield from _rc_range_problems(joint)
        elif joint.bus in has_board and len(_longest(joint)) > SECTION_MAX_CHARS:
            yield (
                ("joints", joint.name, "id"),
                f"joint {joint.name!r}: {_longest(joint).decode()} has more than the "
                f"{SECTION_MAX_CHARS} characters that the LSS-2IO on bus {joint.bus!r} can bear; "
                f"give it a shorter id or another bus",
            )


def _rc_range_problems(joint: Joint) -> Iterator[tuple[tuple[str, str, str], str]]:
    ends = (joint.servo_deg(joint.position_min_deg), joint.servo_deg(joint.position_max_deg))
    if max(map(abs, ends)) > RC_RANGE_DEG:
        yield (
            ("joints", joint.name, "range_deg"),
            f"joint {joint.name!r}: its servo would go to {max(ends, key=abs):g} deg; an LSS-2IO "
            f"turns its servos by ±{RC_RANGE_DEG:g}",
        )


def _longest(joint: Joint) -> bytes:
    """Return the longest move of a timed or streamed joint, without its CR."""
    duration_ms = None if joint.drive == "streamed" else DURATION_DIGITS_MS
    ends = (joint.servo_deg(joint.position_min_deg), joint.servo_deg(joint.position_max_deg))
    wires = (round(end * joint.model.wire_per_deg) for end in ends)
    return max((encode_move(joint.servo_id, wire, duration_ms)[:-1] for wire in wires), key=len)
