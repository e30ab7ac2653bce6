"""Zero and direction of a joint, computed from positions to which a person moved it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct

from lss_motion.playing.player.checks import expected_frame
from lss_motion.protocol.codec import language_table, storable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Joint

MOVED_MIN_DEG: Final = 5.0
"""The smallest push that shows a direction. Chosen: far above backlash and noise, easy to do."""

ZERO_DECIMALS: Final = 1
"""Servos report tenths of a degree."""


class Frame(Struct, frozen=True, kw_only=True):
    """The relation of joint and servo angles: `servo_deg = zero_deg + direction * joint_deg`."""

    zero_deg: float
    direction: Literal[1, -1]


def frame_of(
    joint: Joint, *, servo_deg: float, pose_deg: float, pushed_deg: float | None
) -> Frame | None:
    """Return the frame of a joint that stands at `pose_deg` while its servo reports `servo_deg`.

    `pushed_deg` is the servo angle after a push towards larger joint angles, or None to keep the
    direction of the robot file. Returns None if the push was too small.
    """
    direction: Literal[1, -1] = joint.direction
    if pushed_deg is not None:
        if abs(pushed_deg - servo_deg) < MOVED_MIN_DEG:
            return None
        direction = 1 if pushed_deg > servo_deg else -1
    zero_deg = round(servo_deg - direction * pose_deg, ZERO_DECIMALS) + 0.0
    return Frame(zero_deg=zero_deg, direction=direction)


def stated_frame(joint: Joint, wires: Mapping[str, int]) -> dict[str, float]:
    """Return which settings `stored:` must state so that the file has those of the servo.

    `wires` are gyre (G) and origin (O) of the servo, in wire units.
    """
    rows, expected = storable(joint.model.language), expected_frame(joint)
    return {
        name: rows[name].physical(wire)
        for name, wire in wires.items()
        if name in expected and expected[name] != wire
    }


def moved_origin(joint: Joint, *, origin_wire: int, gyre: int, zero_deg: float) -> int:
    """Return the origin offset (wire unit) that makes the servo report 0 at its present `zero_deg`.

    A servo reports `gyre * (raw - origin)`; the offset is kept within half a turn.
    """
    row = language_table(joint.model.language).row("O")
    turn, moved = row.wire(360.0), origin_wire + gyre * row.wire(zero_deg)
    return (moved + turn // 2) % turn - turn // 2
