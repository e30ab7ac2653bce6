"""A bus with servos of the test's choice, in virtual time."""

from __future__ import annotations

import pytest

from lss_motion.cli.main import main
from lss_motion.playing import connection as connections
from lss_motion.playing.connection import Connection
from lss_motion.robot.model import Bus
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import SimBus, SimPort
from lss_motion.sim.physics import Physics, ServoSpec
from lss_motion.system.clock import VirtualClock


@pytest.fixture
def spec():
    def make(servo_id, model="LSS-ST1", **options):
        return ServoSpec(servo_id=servo_id, model=SERVO_MODELS[model], **options)

    return make


@pytest.fixture
def connected():
    """Return a function that connects to servos on the bus `connection.simulated["main"]`."""

    def make(*specs, baud_bps=115200, firmware=370, seed=0, **options):
        bus = Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=firmware)
        connection = Connection({"main": bus}, VirtualClock())
        physics = Physics(noise_deg=0.0)
        sim_bus = SimBus(
            specs, baud_bps=baud_bps, firmware=firmware, seed=seed, physics=physics, **options
        )
        sim_bus.record()
        connection.simulated["main"] = sim_bus
        connection.ports["main"] = SimPort(sim_bus, connection.clock)
        return connection

    return make


@pytest.fixture
def command(connected, monkeypatch, capsys):
    """Return what runs a command on servos in virtual time: exit code, output, errors, lines."""

    def run(*words, servos, faults=()):
        connection = connected(*servos, faults=faults)
        monkeypatch.setattr(connections, "connect", lambda *_, **__: connection)
        code = main([str(word) for word in words])
        lines = [line for _, line in connection.simulated["main"].lines]
        return (code, *capsys.readouterr(), lines)

    return run
