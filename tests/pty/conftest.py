"""Simulated servos behind a pseudo-terminal, for commands that are run as a user would."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import pytest
from served_bus import recording_bus, served_bus

from lss_motion.cli.main import main
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.physics import ServoSpec


@pytest.fixture
def servo():
    def make(servo_id, model="LSS-ST1", **options):
        return ServoSpec(servo_id=servo_id, model=SERVO_MODELS[model], **options)

    return make


@pytest.fixture
def on_terminal(tmp_path, monkeypatch):
    """Return a context: servos behind the port `./port`; gives their bus, which records."""
    monkeypatch.chdir(tmp_path)

    @contextmanager
    def serve(*servos, faults=(), baud_bps=115200, physics=None):
        bus = recording_bus(*servos, faults=faults, baud_bps=baud_bps, physics=physics)
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
