"""Which drive fits which servo model, and what an LSS-2IO asks of the bus that it is on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.family import Family
from lss_motion.robot.models import FAMILIES

if TYPE_CHECKING:
    from lss_motion.robot.model import Drive, ServoModel

FILTER_FIRMWARE_MIN: Final = 368
"""Firmware 368 brought FPC (lss_facts 1.2)."""

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
    return f"a {model.name} cannot be {drive}: {why}; it can be {' or '.join(allowed)}"
