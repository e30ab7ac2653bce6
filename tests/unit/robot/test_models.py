"""The table of servo models."""

from __future__ import annotations

from lss_motion.protocol.constants import Family
from lss_motion.robot.servo_models import BAUD_FIRMWARE_MIN, FAMILIES, SERVO_MODELS


def test_every_model_has_the_wire_unit_of_its_family() -> None:
    assert {model.wire_per_deg for model in SERVO_MODELS.values()} == {10, 100}
    for name, model in SERVO_MODELS.items():
        assert model.name == name
        assert model.wire_per_deg == FAMILIES[model.family].wire_per_deg
        family = {"LSS-P": Family.LSS_PRO, "LSS-2": Family.IO2}.get(name[:5], Family.LSS)
        assert model.family is family


def test_no_load_speeds_are_those_of_the_datasheets() -> None:
    speeds = {name: model.speed_max_deg_s for name, model in SERVO_MODELS.items()}
    assert (speeds["LSS-ST1"], speeds["LSS-HS1"], speeds["LSS-HT1"]) == (360.0, 600.0, 360.0)


def test_the_fast_baud_rates_came_with_firmware_369() -> None:
    late = {baud_bps for baud_bps, firmware in BAUD_FIRMWARE_MIN.items() if firmware == 369}
    assert late == {750000, 921600}
    assert len(BAUD_FIRMWARE_MIN) == 11
