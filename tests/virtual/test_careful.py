"""The careful run of a joint in virtual time, judged at its simulated horn."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.maintenance.careful import CarefulRun, way_of
from lss_motion.maintenance.identify.joint_run import ExperimentState
from lss_motion.playing.connection import connect
from lss_motion.playing.player import handshake
from lss_motion.playing.runner import run
from lss_motion.robot.load import load_robot
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import TICK_NS
from lss_motion.system.clock import VirtualClock

ROBOT = """
robot: bench
buses: {main: {port: "sim://", firmware: %s}}
defaults: {model: LSS-ST1, range_deg: [-90, 60], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 3, direction: -1, %s}
"""
RESTORED = {b"#3EM1", b"#3AA100", b"#3AD100", b"#3SD3600"}
TOP_DEG_S = 30.0
"""The approach speed, which is below a fifth of the joint's limit."""
FEW_DEG = 5.5


class CarefulBench:
    """One joint on a simulated bus, and its careful run."""

    def __init__(self, tmp_path, *faults, joint="following_deg: 10", firmware=780):
        path = tmp_path / "robot.yaml"
        path.write_text(ROBOT % (firmware, joint))
        self.robot = load_robot(path)
        self.joint = self.robot.joints["pan"]
        self.connection = connect(
            self.robot.buses, robot=self.robot, clock=VirtualClock(), faults=faults
        )
        answers, _ = self.connection.examined([self.joint], self.robot)
        self.standing_deg = handshake.reported(self.joint, answers, "QD")
        way_deg = way_of(self.joint, self.robot, self.standing_deg)
        self.careful = CarefulRun(
            self.joint, self.robot, answers, standing_deg=self.standing_deg, way_deg=way_deg
        )
        self.began_ns = self.connection.clock.now_ns()

    def run(self, controls=None):
        run(self.careful, self.connection.ports, self.connection.clock, controls=controls)
        self.connection.close()
        return self.careful

    @property
    def bus(self):
        return self.connection.simulated["main"]

    def lines(self):
        return [line.rstrip(b"\r") for _, line in self.bus.lines]

    def horn_deg(self):
        """Return the servo angle of the horn at every control tick."""
        times_ns = range(self.began_ns, self.connection.clock.now_ns(), TICK_NS)
        return self.bus.horn_deg(list(times_ns))[:, 0]

    def speeds_deg_s(self):
        return np.abs(np.diff(self.horn_deg())) / (1e-9 * TICK_NS)


class StopAtReading:
    """Presses Ctrl-C when a leg has so many readings."""

    def __init__(self, leg, readings, count=1):
        self.leg, self.readings, self.count = leg, readings, count

    def filenos(self):
        return []

    def act(self, careful, now_ns):
        is_moving = careful._leg is not None and careful._trial.sent
        is_there = is_moving and len(careful._results) == self.leg
        if self.count and is_there and len(careful._trial.readings_deg) >= self.readings:
            self.stopped_ns = now_ns
            for _ in range(self.count):
                careful.stop(now_ns)
            self.count = 0


def wrong(setting, ratio):
    return Fault(kind=FaultKind.WRONG_SCALE, servo_id=3, setting=setting, scale_ratio=ratio)


def test_a_right_servo_passes_within_a_fifth_of_its_speed_and_a_few_degrees(tmp_path):
    bench = CarefulBench(tmp_path)
    careful = bench.run()
    assert careful.error is None
    assert careful.found.way_deg == 5.0 * np.sign(careful.found.way_deg)
    assert careful.found.lag_s == pytest.approx(0.022, abs=0.01)
    assert careful.found.has_witness
    assert bench.speeds_deg_s().max() <= 1.01 * TOP_DEG_S
    turned_deg = bench.horn_deg() - bench.standing_deg
    assert 4.5 < np.ptp(turned_deg) < FEW_DEG
    accel = np.diff(bench.horn_deg(), n=2) / (1e-9 * TICK_NS) ** 2
    assert np.abs(accel).max() <= 1.02 * bench.joint.accel_max_deg_s2
    assert bench.lines()[-1] == b"#3H"
    assert set(bench.lines()[-5:-1]) == RESTORED


@pytest.mark.parametrize(
    ("setting", "ratio"),
    [
        (setting, ratio)
        for setting in ("D", "SD", "T", "AA", "AD")
        for ratio in (1000.0, 100.0, 10.0, 0.1, 0.001)
        if (setting, ratio) != ("D", 0.001)  # Its readings scatter by 100 deg: refused before.
    ],
)
def test_a_unit_that_is_wrong_is_found_within_a_few_degrees(tmp_path, setting, ratio):
    bench = CarefulBench(tmp_path, wrong(setting, ratio))
    careful = bench.run()
    assert careful.error is not None
    assert careful.found is None
    assert "joint 'pan'" in str(careful.error)
    assert "expected" in str(careful.error) or "are to be the same" in str(careful.error)
    assert np.abs(bench.horn_deg() - bench.standing_deg).max() < FEW_DEG
    assert bench.speeds_deg_s().max() <= 1.01 * TOP_DEG_S
    assert bench.lines()[-1] == b"#3H"
    assert np.ptp(bench.horn_deg()[-10:]) < 0.01


PRO = (
    "model: LSS-P-S1, range_deg: [-60, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300, "
    "following_deg: 10"
)


@pytest.mark.parametrize(
    "faults",
    [
        (),
        *(
            (wrong(setting, ratio),)
            for setting in ("D", "SD", "AA")
            for ratio in (1000.0, 10.0, 0.1)
        ),
        tuple(wrong(setting, 10.0) for setting in ("D", "SD", "AA", "AD")),
    ],
)
def test_the_units_of_an_lss_pro_are_found_by_its_angles_and_its_speed(tmp_path, faults):
    bench = CarefulBench(tmp_path, *faults, joint=PRO)
    careful = bench.run()
    assert bool(careful.error) is bool(faults)
    assert bool(careful.found) is not bool(faults)
    assert np.abs(bench.horn_deg() - bench.standing_deg).max() < FEW_DEG
    assert bench.speeds_deg_s().max() <= (46.0 if len(faults) > 1 else 18.1)


def test_an_older_lss_pro_that_holds_is_in_no_error(tmp_path):
    """Code 6 is `holding` up to firmware 779, and `error` from 780 on."""
    assert CarefulBench(tmp_path, joint=PRO, firmware=779).run().error is None


@pytest.mark.parametrize("kind", ["lost_reply", "corrupt_reply", "double_reply"])
def test_a_line_with_faults_is_no_wrong_servo(tmp_path, kind):
    bench = CarefulBench(tmp_path, Fault(kind=FaultKind(kind), ratio=0.03))
    careful = bench.run()
    assert careful.error is None, str(careful.error)


def test_a_move_that_the_line_lost_is_sent_once_more(tmp_path):
    bench = CarefulBench(tmp_path)
    bench.run()
    first_ns = next(at_ns for at_ns, line in bench.bus.lines if line.startswith(b"#3D"))
    lost = Fault(
        kind=FaultKind.LOST_COMMAND, at_s=1e-9 * first_ns - 0.005, until_s=1e-9 * first_ns + 0.001
    )
    bench = CarefulBench(tmp_path, lost)
    careful = bench.run()
    assert careful.error is None, str(careful.error)
    moves = [line for line in bench.lines() if line.startswith(b"#3D")]
    assert len(moves) == 6  # The lost one reached no servo.


def test_units_that_are_all_wrong_are_found_by_the_pulses(tmp_path):
    bench = CarefulBench(tmp_path, *(wrong(setting, 10.0) for setting in ("D", "SD", "AA", "AD")))
    assert "by its pulses (QP)" in str(bench.run().error)
    assert np.abs(bench.horn_deg() - bench.standing_deg).max() < FEW_DEG


@pytest.mark.parametrize("at_s", [0.3, 1.0, 2.6, 4.0])
def test_a_gyre_that_changes_stops_the_joint_within_a_few_degrees(tmp_path, at_s):
    fault = Fault(
        kind=FaultKind.STORED, servo_id=3, at_s=at_s, settings={"G": -1, "O": 100, "SD": 3600}
    )
    bench = CarefulBench(tmp_path, fault)
    careful = bench.run()
    assert any(text in str(careful.error) for text in ("gyre (G)", "expected", "the same"))
    assert np.abs(bench.horn_deg() - bench.standing_deg).max() < FEW_DEG + 2.0


@pytest.mark.parametrize("leg", range(6))
def test_ctrl_c_brakes_by_the_ramps_restores_and_holds(tmp_path, leg):
    bench = CarefulBench(tmp_path)
    stop_at = StopAtReading(leg, 6)
    careful = bench.run(stop_at)
    assert careful.is_stopped
    assert careful.error is None
    assert careful.state is ExperimentState.DONE
    assert bench.lines()[-1] == b"#3H"
    assert set(bench.lines()[-5:-1]) == RESTORED
    accel = np.diff(bench.horn_deg(), n=2) / (1e-9 * TICK_NS) ** 2
    assert np.abs(accel).max() <= 1.02 * bench.joint.accel_max_deg_s2
    assert np.ptp(bench.horn_deg()[-10:]) < 0.01
    after = (stop_at.stopped_ns - bench.began_ns) // TICK_NS
    turned_deg = careful._leg.sign * bench.horn_deg()[after:]
    assert turned_deg[-1] > turned_deg.max() - 0.1  # It did not turn back.
    braking_deg = 0.5 * bench.speeds_deg_s()[after - 8 :].max() ** 2 / careful._leg.settings["AD"]
    assert np.ptp(turned_deg) < braking_deg + 1.0


def test_a_second_ctrl_c_ends_at_once_and_safely(tmp_path):
    bench = CarefulBench(tmp_path)
    careful = bench.run(StopAtReading(1, 6, count=2))
    assert careful.state is ExperimentState.DONE
    assert bench.lines()[-1] == b"#3H"
    assert set(bench.lines()[-9:-1]) == RESTORED


@pytest.mark.parametrize(
    ("joint", "least_deg", "most_deg"),
    [
        ("range_deg: [-3, 1]", 2.0, 2.6),
        ("range_deg: [-1, 90]", 4.5, 5.5),
        ("speed_max_deg_s: 10", 0.8, 1.3),
    ],
)
def test_a_small_range_or_a_slow_joint_is_moved_less(tmp_path, joint, least_deg, most_deg):
    bench = CarefulBench(tmp_path, joint=joint)
    careful = bench.run()
    assert careful.error is None, str(careful.error)
    turned_deg = bench.horn_deg() - bench.standing_deg
    assert least_deg < np.abs(turned_deg).max() < most_deg
    inside_deg = [bench.joint.joint_deg(deg) for deg in bench.horn_deg()]
    assert bench.joint.position_min_deg - 0.2 <= min(inside_deg)
    assert max(inside_deg) <= bench.joint.position_max_deg + 0.2


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (Fault(kind=FaultKind.STUCK), "is too slow|blocked|stuck"),
        (Fault(kind=FaultKind.HOT, at_s=1.5, temperature_c=95.0), "safe mode|is too slow|stands"),
        (Fault(kind=FaultKind.DEAF, at_s=1.0), "stopped answering"),
    ],
)
def test_a_fault_of_the_servo_is_reported_and_it_is_left_safe(tmp_path, fault, text):
    bench = CarefulBench(tmp_path, fault)
    careful = bench.run()
    assert any(part in str(careful.error) for part in text.split("|"))
    assert bench.lines()[-1] == (b"#254H" if "answering" in text else b"#3H")
