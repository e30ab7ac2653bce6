"""Simulated servos behind a pseudo-terminal, for commands that are run as a user would."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from lss_motion.cli.main import main
from lss_motion.protocol.constants import Family
from lss_motion.robot.model import ServoModel
from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics, ServoSpec
from tests.served_bus import served_bus

ST1 = ServoModel(name="LSS-ST1", family=Family.LSS, speed_max_deg_s=360.0, wire_per_deg=10)
FAMILIES = {
    "LSS-ST1": ST1,
    "LSS-P-S1": replace(ST1, name="LSS-P-S1", family=Family.LSS_PRO, wire_per_deg=100),
    "LSS-2IO": replace(ST1, name="LSS-2IO", family=Family.IO2),
}


@pytest.fixture
def servo():
    def make(servo_id, model="LSS-ST1", **options):
        return ServoSpec(servo_id=servo_id, model=FAMILIES[model], **options)

    return make


@pytest.fixture
def on_terminal(tmp_path, monkeypatch):
    """Return a context: servos behind the port `./port`; gives their bus, which records."""
    monkeypatch.chdir(tmp_path)

    @contextmanager
    def serve(*servos, faults=(), baud_bps=115200, physics=None):
        bus = SimBus(
            servos,
            baud_bps=baud_bps,
            firmware=370,
            physics=physics or Physics(noise_deg=0.0),
            faults=faults,
        )
        bus.record()
        with served_bus(bus, Path("port")):
            yield bus

    return serve


@pytest.fixture
def lss_motion(capsys):
    """Return what runs one command in this process: exit code, output, errors."""

    def run(*words):
        capsys.readouterr()
        code = main([str(word) for word in words])
        out, errors = capsys.readouterr()
        return code, out, errors

    return run
