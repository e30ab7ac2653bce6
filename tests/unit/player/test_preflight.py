"""The preflight of simulated robots: what it finds, and that a damaged answer is no setting."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError
from lss_motion.playing.connection import connect
from lss_motion.playing.player import checks
from lss_motion.playing.player.preflight import Examination
from lss_motion.robot.model import Bus
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.system.clock import VirtualClock


def examined(kit, *joints, faults=(), baud_bps=115200, seed=0, **options):
    """Return the robot, and its preflight."""
    robot = kit.robot(*joints)
    bus = Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370)
    robot = replace(robot, buses={"main": bus})
    with connect(
        robot.buses, robot=robot, clock=VirtualClock(), faults=faults, seed=seed
    ) as connection:
        run = connection.run(Examination(robot.joints.values(), robot, **options))
        received = [line for _, line in connection.simulated["main"].lines]
    return robot, run.preflight, received


def judged(robot, preflight):
    preflight.require_own_ids()
    return checks.check_answers(
        robot.joints.values(), preflight.answers, robot, stored=preflight.stored
    )


@pytest.mark.parametrize("settings", [{"G": -1}, {"O": 50}, {"AR": 900}])
@pytest.mark.parametrize("model", ["LSS-ST1", "LSS-P-S1"])
def test_a_servo_with_other_settings_is_refused(kit, settings, model):
    one = kit.joint(model=SERVO_MODELS[model], speed_max_deg_s=90.0)
    stored = Fault(kind=FaultKind.STORED, servo_id=1, settings=settings)
    assert judged(*examined(kit, one)[:2]) == []
    with pytest.raises(InputError, match="the robot file says") as refused:
        judged(*examined(kit, one, faults=[stored])[:2])
    assert "lss-motion configure ROBOT --joint j0 --set" in str(refused.value)


def test_a_simulated_robot_agrees_with_its_own_file(kit):
    one = kit.joint(stored={"G": -1.0, "O": 12.5, "AR": 90.0})
    robot, preflight, received = examined(kit, one)
    assert judged(robot, preflight) == []
    assert received.count(b"#1QG\r") == 1, "one answer is enough if it is the right one"
    assert preflight.stored == {}


@pytest.mark.parametrize("seed", range(60))
def test_damaged_answers_refuse_no_robot(kit, seed):
    """A reply without one of its bytes can be a number: it is asked for again."""
    kind = FaultKind.SHORT_REPLY if seed % 2 else FaultKind.CORRUPT_REPLY
    damage = Fault(kind=kind, ratio=0.3)
    one = kit.joint(stored={"G": -1.0, "O": 12.5})
    robot, preflight, _ = examined(kit, one, kit.joint("j1", 2), faults=[damage], seed=seed)
    assert all("does not report" in text for text in judged(robot, preflight))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("baud_bps", [115200, 921600])
def test_two_servos_with_one_id_are_found(kit, baud_bps, seed):
    twin = Fault(kind=FaultKind.TWIN, servo_id=2)
    robot, preflight, _ = examined(
        kit, kit.joint(), kit.joint("j1", 2), faults=[twin], baud_bps=baud_bps, seed=seed
    )
    with pytest.raises(BusError, match=r"'j1'.*several servos.*configure .* --id 2 --new-id N"):
        judged(robot, preflight)


def test_two_rc_servos_with_one_id_are_found(kit):
    board = SERVO_MODELS["LSS-2IO"]
    one = kit.joint(servo_id=209, model=board, drive="stepped", accel_max_deg_s2=1e9)
    twin = Fault(kind=FaultKind.TWIN, servo_id=209)
    assert judged(*examined(kit, one)[:2]) == []
    # The twin is on another board: of two pins of one board with one id only the first answers.
    with pytest.raises(BusError, match=r"answer of id 209 .* as when several servos have one id"):
        judged(*examined(kit, one, faults=[twin])[:2])


@pytest.mark.parametrize("kind", [FaultKind.DOUBLE_REPLY, FaultKind.CORRUPT_REPLY])
def test_a_bad_line_is_no_second_servo(kit, kind):
    for seed in range(10):
        fault = Fault(kind=kind, ratio=1.0 if kind is FaultKind.DOUBLE_REPLY else 0.3)
        _, preflight, _ = examined(kit, kit.joint(), faults=[fault], seed=seed)
        preflight.require_own_ids()
        assert preflight.twins is not None


def test_stored_settings_are_read_where_they_are_wanted(kit):
    _, preflight, _ = examined(kit, kit.joint(), reads_stored=True)
    assert preflight.stored == {
        ("main", 1, "QG"): 1, ("main", 1, "QO"): 0, ("main", 1, "QAR"): 1800,
        ("main", 1, "QSD"): 3600, ("main", 1, "QAA"): 100, ("main", 1, "QAD"): 100,
        ("main", 1, "QEM"): 1,
    }  # fmt: skip
    assert preflight.answers["main", 1, "QSD"] == 3600


def test_only_queries_are_sent(kit):
    stored = Fault(kind=FaultKind.STORED, servo_id=1, settings={"G": -1})
    _, _, received = examined(kit, kit.joint(), faults=[stored], reads_stored=True)
    assert all(line.startswith(b"#1Q") for line in received)
