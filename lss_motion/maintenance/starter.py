"""A robot file to begin with, from what a scan found: valid, sober, and full of hints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.family import Family
from lss_motion.robot.models import SERVO_MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.maintenance.look import Look
    from lss_motion.robot.model import Bus

SPEED_DEG_S: Final = 90
ACCEL_DEG_S2: Final = 300
RANGE_DEG: Final = 45
"""Sober limits for a robot that nobody has measured yet. Chosen."""

_HEAD: Final = """\
# What lss-motion scan found; a start, not the end. Before anything moves:
#   1. give the joints names: elbow instead of joint_3
#   2. turn each by hand to the ends of its mechanics and write them into range_deg
#   3. direction: -1 where the servo turns the other way, zero_deg where the joint's 0 is elsewhere
#   4. lss-motion schema robot tells your editor everything else that may stand here

robot: {name}

buses:
  main: {{port: "{port}", baud_bps: {baud_bps}, firmware: {firmware}}}

defaults:
  model: {model}
  speed_max_deg_s: {speed}      # sober: every servo can do more
  accel_max_deg_s2: {accel}
  range_deg: [-{range}, {range}]

joints:
"""


def starter_file(name: str, bus: Bus, looks: Sequence[Look]) -> str | None:
    """Return the text of a robot file; None if no servo was found that one could name.

    What is no joint, listens at another rate, or shares its id stands in a comment.
    """
    main_bps = bus.baud_bps
    usable: list[Look] = []
    left: list[Look] = []
    for look in looks:
        is_good = look.baud_bps == main_bps and not look.present.is_shared
        model = _model(look)
        (usable if is_good and model is not None else left).append(look)
    if not usable:
        return None
    models = [_model(look) or "" for look in usable]
    model = max(set(models), key=models.count)
    firmwares = [
        look.firmware
        for look in usable
        if look.firmware is not None and look.present.family is Family.LSS
    ]
    text = _HEAD.format(
        name=name,
        port=bus.port,
        baud_bps=main_bps,
        firmware=max(set(firmwares), key=firmwares.count) if firmwares else bus.firmware,
        model=model,
        speed=SPEED_DEG_S,
        accel=ACCEL_DEG_S2,
        range=RANGE_DEG,
    )
    for look, own in zip(usable, models, strict=True):
        fields = [f"id: {look.servo_id}"] + ([f"model: {own}"] if own != model else [])
        text += f"  joint_{look.servo_id}: {{{', '.join(fields)}}}{_seen(look)}\n"
    for look in left:
        text += f"  # not used: id {look.servo_id}, {_why(look, main_bps)}\n"
    return text


def _model(look: Look) -> str | None:
    """Return the model as robot files name it; None where they cannot."""
    named = (name for name in SERVO_MODELS if look.present.model.startswith(name))
    is_pin = look.present.family is Family.IO2 and "-D" not in look.present.model
    return None if is_pin else max(named, key=len, default=None)


def _seen(look: Look) -> str:
    stands = "" if look.position_deg is None else f", stood at {look.position_deg:z.1f} deg"
    number = look.present.serial_number
    return f"    # {look.present.model}{f', serial number {number}' if number else ''}{stands}"


def _why(look: Look, main_bps: int) -> str:
    if look.present.is_shared:
        return "which several servos share"
    if look.baud_bps != main_bps:
        return f"{look.present.model} at {look.baud_bps} bps"
    return f"{look.present.model or 'no model known'}, which no joint of a robot file can be"
