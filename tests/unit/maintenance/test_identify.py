"""Results of `identify` for servos that it does not know, and its behaviour during a run."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from msgspec.structs import replace

from benches.identify import MODEL, blind, faults
from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.maintenance.identify import estimate
from lss_motion.maintenance.identify.estimate import identify, read_rests
from lss_motion.maintenance.identify.joint_run import Experiment, ExperimentState
from lss_motion.maintenance.identify.response_fit import (
    HYPOTHESES,
    Hypothesis,
    ResponseShape,
    horn_deg,
)
from lss_motion.maintenance.identify.trials import (
    MotionWindow,
    Recording,
    SentMove,
    Trial,
    TrialKind,
    make_trials,
    make_window,
)
from lss_motion.playing.connection import Connection
from lss_motion.playing.player import checks, handshake
from lss_motion.playing.runner import run
from lss_motion.robot.model import Bus, Response, Robot
from lss_motion.robot.profile import Profile
from lss_motion.sim.bus import SimBus, SimPort
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import TICK_NS, Physics, ServoSpec
from lss_motion.system.clock import VirtualClock
from tests.joints import joint

JOINT = joint("elbow", 3, model=MODEL)
RESTED_WINDOW = MotionWindow(-20.0, 20.0)
RESTORED = {b"#3EM1", b"#3AA100", b"#3AD100", b"#3SD3600"}


class IdentifyBench:
    """A joint on a simulated bus in virtual time, and an experiment with it."""

    def __init__(self, joint=JOINT, span_deg=20.0, baud_bps=115200, **options):
        spec = ServoSpec(
            servo_id=joint.servo_id,
            model=joint.model,
            start_deg=options.pop("start_deg", 10.0),
            droop_deg=options.pop("droop_deg", 0.0),
            backlash_deg=options.pop("backlash_deg", 0.0),
        )
        bus = Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370)
        self.robot = Robot(name="bench", path=None, buses={"main": bus}, joints={"elbow": joint})
        self.joint = joint
        self.connection = Connection(self.robot.buses, VirtualClock())
        self.bus = SimBus([spec], baud_bps=baud_bps, firmware=370, **options)
        self.bus.record()
        self.connection.ports["main"] = SimPort(self.bus, self.connection.clock)
        answers = self.connection.ask(checks.queries([joint]))
        checks.check_answers([joint], answers, self.robot)
        self.standing_deg = handshake.reported(joint, answers, "QD")
        window = make_window(joint, self.standing_deg, span_deg)
        self.experiment = Experiment(
            joint, self.robot, answers, window, standing_deg=self.standing_deg
        )

    def run(self, **options):
        run(self.experiment, self.connection.ports, self.connection.clock, **options)
        self.connection.close()
        return self.experiment

    def identified(self):
        experiment = self.run()
        assert experiment.error is None
        return identify(self.joint, experiment.recording)

    def horn_deg(self):
        times_ns = np.arange(0, self.connection.clock.now_ns(), TICK_NS)
        return self.bus.horn_deg(times_ns.tolist())[:, 0]

    def lines(self):
        return [line.rstrip(b"\r") for _, line in self.bus.lines]


class StopOnce:
    """Presses Ctrl-C, once or more, when `when(experiment)` is true for the first time."""

    def __init__(self, when, times=1):
        self.when, self.left = when, times

    def filenos(self):
        return []

    def act(self, experiment, now_ns):
        if self.left and self.when(experiment):
            self.left -= 1
            experiment.stop(now_ns)


# ---- what is found


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 14, 17])
def test_a_random_servo_is_identified_within_its_limits(seed):
    one = blind(seed)
    assert faults(one) == {}
    assert one.away_deg > 0.5 * one.span_deg  # It did move.


@pytest.mark.slow
def test_the_judge_of_these_tests_finds_wrong_results():
    one = blind(7)
    fast = one.found.top_deg_s._replace(value=2.0 * one.found.top_deg_s.value)
    late = one.found.lag_s._replace(value=0.05)
    wrong = replace(one.found, lag_s=late, top_deg_s=fast, is_top=True)
    assert set(faults(dataclasses.replace(one, found=wrong, away_deg=99.0))) >= {
        "lag",
        "speed",
        "span",
    }


def test_a_bad_line_loses_readings_but_not_the_result():
    rows = [
        Fault(kind=FaultKind.LOST_REPLY, ratio=0.02),
        Fault(kind=FaultKind.CORRUPT_REPLY, ratio=0.02),
    ]
    physics = Physics(lag_s=0.05, t_law="exact")
    found = IdentifyBench(faults=rows, usb_latency_ns=10_000_000, physics=physics).identified()
    assert found.delay_s.value == pytest.approx(0.0525, abs=0.005)
    assert found.turnaround_s[1] > 0.004  # The adapter holds answers back.
    assert found.t_law == ("exact", True)
    assert found.retarget == ("keep_speed", True)


def test_a_servo_too_weak_for_its_limit_is_reported_with_its_top_speed():
    joint = replace(JOINT, speed_max_deg_s=300.0, accel_max_deg_s2=1000.0)
    weak = Fault(kind=FaultKind.WEAK, speed_ratio=0.4)
    bench = IdentifyBench(joint, span_deg=40.0, faults=[weak])
    found = bench.identified()
    assert found.is_top
    assert found.top_deg_s.value == pytest.approx(0.4 * 360.0, rel=0.1)
    assert any(
        "lower it, or check the supply" in line for line in estimate.difference_lines(found, joint)
    )


@pytest.mark.slow
def test_assumed_values_give_no_difference_and_unexplained_readings_are_refused():
    bench = IdentifyBench()
    assert estimate.difference_lines(bench.identified(), bench.joint) == []
    swinging = np.random.default_rng(0).normal(0.0, 3.0, 1000)
    for trial in bench.experiment.recording.trials:
        trial.readings_deg = (swinging[: len(trial.times_s)] + trial.readings_deg).tolist()
    with pytest.raises(PlaybackError, match="no model explains"):
        identify(JOINT, bench.experiment.recording)


# ---- how it ends


def test_ctrl_c_brakes_within_the_ramps_restores_and_holds():
    bench = IdentifyBench()
    fast = StopOnce(
        lambda e: (
            len(e.recording.trials) == 6 and e._trial.sent and e._moves == e._moves and _is_fast(e)
        )
    )
    experiment = bench.run(controls=fast)
    assert experiment.is_stopped
    assert experiment.error is None
    assert experiment.state is ExperimentState.DONE
    received = bench.lines()
    assert received[-1] == b"#3H"
    assert set(received[-5:-1]) == RESTORED
    horn = bench.horn_deg()
    assert np.ptp(horn[-20:]) < 0.01  # At rest when it was told to hold.
    accel = np.diff(horn, n=2) / (1e-9 * TICK_NS) ** 2
    assert np.abs(accel).max() < 1.1 * JOINT.accel_max_deg_s2
    assert np.abs(horn - 10.0).max() < 20.0


def _is_fast(experiment):
    readings = experiment._trial.readings_deg
    is_late = len(experiment.recording.trials) == 6
    return is_late and len(readings) > 5 and abs(readings[-1] - readings[-5]) > 1.0


def test_a_second_ctrl_c_ends_at_once_and_still_restores():
    bench = IdentifyBench()
    bench.run(controls=StopOnce(_is_fast, times=2))
    received = bench.lines()
    assert received[-1] == b"#3H"
    assert set(received[-5:-1]) == RESTORED


def test_a_lost_port_ends_with_an_attempt_to_restore_and_hold():
    bench = IdentifyBench(faults=[Fault(kind=FaultKind.UNPLUGGED, at_s=3.0)])
    with pytest.raises(BusError, match="lost port"):
        bench.run()
    safe = bench.experiment.safe_bytes()["main"].split(b"\r")[:-1]
    assert safe[-1] == b"#3H"
    assert set(safe[:-1]) == RESTORED


def test_a_servo_that_was_not_moved_gets_no_last_bytes():
    bench = IdentifyBench()
    assert bench.experiment.safe_bytes() == {}
    bench.run(controls=StopOnce(lambda _: True))
    assert not any(line.startswith((b"#3D", b"#3H")) for line in bench.lines())
    assert set(bench.lines()[-4:]) == RESTORED


@pytest.mark.parametrize(
    ("fault", "error", "text"),
    [
        (Fault(kind=FaultKind.STUCK, at_s=2.0), PlaybackError, "stuck|blocked|stays at"),
        (Fault(kind=FaultKind.DEAF, at_s=2.0), BusError, "stopped answering"),
        (Fault(kind=FaultKind.HOT, at_s=2.0, temperature_c=95.0), PlaybackError, "safe mode"),
        (Fault(kind=FaultKind.RESET, at_s=2.0), BusError, "stopped answering"),
    ],
)
def test_a_fault_of_a_servo_is_reported_and_it_is_left_safe(fault, error, text):
    bench = IdentifyBench(faults=[fault])
    experiment = bench.run()
    assert isinstance(experiment.error, error)
    assert any(part in str(experiment.error) for part in text.split("|"))
    received = bench.lines()
    assert received[-1] == (b"#254H" if error is BusError else b"#3H")
    assert set(received[-5:-1]) == RESTORED
    assert bench.connection.clock.now_ns() < 6e9


def test_a_blocked_horn_is_not_pushed_any_longer():
    bench = IdentifyBench(faults=[Fault(kind=FaultKind.STUCK, at_s=2.0)])
    bench.run()
    last = [line for line in bench.lines() if line.startswith(b"#3D")][-1]
    assert int(last[3:]) / 10 == pytest.approx(bench.horn_deg()[-1], abs=0.3)


def test_a_horn_that_leaves_its_window_is_stopped():
    bench = IdentifyBench()
    bench.experiment.window = MotionWindow(9.0, 11.0)  # As if its load threw it out.
    bench.experiment._plan = lambda: _plan_as_if(bench)
    experiment = bench.run()
    assert "was to stay within 9.0 to 11.0 deg" in str(experiment.error)
    assert bench.lines()[-1] == b"#3H"
    assert np.abs(bench.horn_deg() - 10.0).max() < 8.0


def _plan_as_if(bench):
    bench.experiment.state = ExperimentState.TRIALS
    if not bench.experiment._plans:
        bench.experiment._plans.extend(make_trials(JOINT, MotionWindow(-10.0, 30.0), 10.0))


def test_a_load_that_leaves_no_room_is_reported_before_any_trial():
    experiment = IdentifyBench(droop_deg=7.0, span_deg=6.0, start_deg=0.0).run()
    assert isinstance(experiment.error, InputError)
    assert "load" in str(experiment.error)
    assert experiment.recording.trials == []


# ---- the plan


@pytest.mark.parametrize(
    ("standing_deg", "span_deg", "text"),
    [
        (95.0, 20.0, "outside its range"),
        (0.0, 3.0, "too little to measure"),
        (89.0, 6.0, "away from its limit"),
    ],
)
def test_a_joint_without_room_is_refused_in_words(standing_deg, span_deg, text):
    with pytest.raises(InputError, match=text):
        make_window(JOINT, standing_deg, span_deg)


def test_a_window_is_the_span_inside_the_range_also_for_a_turned_joint():
    turned = replace(JOINT, direction=-1, zero_deg=5.0, position_min_deg=-30.0)
    assert make_window(turned, 30.0, 20.0) == MotionWindow(10.0, 35.0)


@pytest.mark.parametrize("hypothesis", HYPOTHESES)
@pytest.mark.parametrize(
    ("accel", "speed", "span"), [(1000, 360, 45), (600, 180, 20), (30, 180, 20), (1000, 20, 5)]
)
def test_no_trial_leaves_the_window_or_the_limits_whatever_the_servo_is(
    hypothesis, accel, speed, span
):
    joint = replace(JOINT, accel_max_deg_s2=float(accel), speed_max_deg_s=float(speed))
    window = make_window(joint, 12.0, float(span))
    at_deg = 12.0
    for ramp_ratio in (0.75, 1.3):
        for trial in make_trials(joint, window, at_deg):
            shape = ResponseShape(ramp_ratio * accel, ramp_ratio * accel, float(speed), 0.001)
            orders = [SentMove(m.at_s, m.target_deg, m.duration_ms / 1e3) for m in trial.moves]
            times_s = np.arange(0.0, trial.end_s + 1.0, 0.001)
            delays = [0.0] * len(orders)
            horn, _ = horn_deg(times_s, at_deg, orders, delays, shape, hypothesis)
            spare_deg = 0.04 * window.room_deg  # For what a load and a real horn add.
            assert horn.min() > window.low_deg + spare_deg
            assert horn.max() < window.high_deg - spare_deg
            assert np.abs(np.diff(horn)).max() / 0.001 <= 1.001 * speed
            at_deg = orders[-1].target_deg
            assert horn[-1] == pytest.approx(at_deg, abs=0.01)
            if ramp_ratio > 1.0:  # By then its profile rests, unless its ramps are slower.
                resting = horn[times_s > trial.end_s + 0.01]
                assert np.ptp(resting) < 0.05


# ---- the model


@pytest.mark.parametrize("hypothesis", HYPOTHESES)
def test_the_fitted_model_moves_as_the_response_model_of_the_player(hypothesis):
    random = np.random.default_rng(4)
    compared = 0
    for _ in range(40):
        response = Response(retarget=hypothesis.retarget, t_law=hypothesis.t_law)
        profile = Profile(0.0, ramp_deg_s2=500.0, speed_max_deg_s=200.0, response=response)
        received_s = np.cumsum(random.uniform(0.05, 0.5, 2))
        first, second = random.uniform(-30.0, 30.0, 2)
        orders = [
            SentMove(float(received_s[0]), float(first), float(random.uniform(0.3, 0.8))),
            SentMove(float(received_s[1]), float(second), float(random.uniform(0.3, 0.8))),
        ]
        for order in orders:
            profile.retarget(*order)
        times_s = np.linspace(0.0, 3.0, 400)
        shape = ResponseShape(500.0, 500.0, 200.0, 1e-6)
        horn, _ = horn_deg(times_s, 0.0, orders, [0.0, 0.0], shape, hypothesis)
        if hypothesis == Hypothesis("keep_speed", "exact") and _turns_back(horn, times_s, orders):
            continue  # What T means for a move that must first stop nobody says.
        compared += 1
        expected = [profile.at(t)[0] for t in times_s]
        assert np.abs(horn - expected).max() < 0.01
    assert compared > 10


def _turns_back(horn, times_s, orders):
    """Return whether the second move begins with the horn in the wrong direction, or too fast."""
    at = np.searchsorted(times_s, orders[1].received_s)
    speed = (horn[at - 1] - horn[at - 2]) / (times_s[1] - times_s[0])
    away = orders[1].target_deg - horn[at - 1]
    return away * speed < 0.0 or speed**2 > 2.0 * 500.0 * abs(away) * 0.9


def test_the_lag_of_the_fitted_model_is_that_of_a_slow_motor():
    order = SentMove(0.0, 20.0, 0.5)
    shape = ResponseShape(600.0, 600.0, 180.0, 0.05)
    times_s = np.arange(0.0, 2.0, 1e-4)
    horn, behind = horn_deg(times_s, 0.0, [order], [0.0], shape, HYPOTHESES[0])
    stiff, _ = horn_deg(times_s, 0.0, [order], [0.0], replace(shape, lag_s=1e-6), HYPOTHESES[0])
    stepped = [0.0]
    for target in stiff[:-1]:
        stepped.append(stepped[-1] + (target - stepped[-1]) * 1e-4 / 0.05)
    assert np.abs(horn - stepped).max() < 0.05
    assert np.abs(behind - (stiff - horn)).max() < 1e-3


def rests(missing_deg, *, noise_deg=0.01):
    """Read the rests of two stairs; `missing_deg(target, sign)` is the error at a rest."""
    random = np.random.default_rng(1)
    trials, at_deg = [], -16.0
    for target_deg in [-8.0, 0.0, 8.0, 16.0, 8.0, 0.0, -8.0, -16.0] * 2:
        direction = np.sign(target_deg - at_deg)
        rest_deg = target_deg - missing_deg(target_deg, direction)
        readings = rest_deg + random.normal(0.0, noise_deg, 30)
        trial = Trial(TrialKind.STEP, 0.0, at_deg, [SentMove(0.0, target_deg, 0.3)])
        trial.times_s = [0.7 + 0.01 * index for index in range(30)]
        trial.readings_deg = readings.tolist()
        trials.append(trial)
        at_deg = target_deg
    return read_rests(Recording(RESTED_WINDOW, 600.0, 180.0, trials), trials)


def test_without_load_and_play_both_are_zero():
    found = rests(lambda target, sign: 0.0)
    assert found.play.value == 0.0
    assert np.abs(found.droop_deg).max() < 0.02


def test_a_load_is_a_parabola_over_the_window():
    found = rests(lambda target, sign: 2.0 + 0.5 * (target / 20.0) - 0.3 * (target / 20.0) ** 2)
    assert found.droop_deg == pytest.approx((2.0, 0.5, -0.3), abs=0.02)
    assert found.play.value == 0.0


def test_play_shows_in_the_direction_from_which_a_rest_was_reached():
    found = rests(lambda target, sign: 0.4 + 0.35 * sign)
    assert found.play.value == pytest.approx(0.7, abs=0.02)
    assert not found.is_falling
    assert found.droop_deg[0] == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_gears_that_fall_to_their_other_side_show_their_play_there(side):
    found = rests(lambda target, sign: side * (0.04 * (target - 3.0) + 0.4 * np.sign(target - 3.0)))
    assert found.is_falling
    assert found.play.value == pytest.approx(0.8, abs=0.05)


def test_scatter_is_not_play():
    random = np.random.default_rng(5)
    found = rests(lambda target, sign: random.normal(0.0, 0.1), noise_deg=0.1)
    assert found.play.value == 0.0


# ---- a servo that restarts


@pytest.mark.parametrize("deaf_s", [0.02, 0.1, 0.3, 1.25])
@pytest.mark.parametrize("at_s", [3.013, 5.2, 8.0])
def test_a_restart_is_named_and_no_move_follows_it(at_s, deaf_s):
    reset = Fault(kind=FaultKind.RESET, servo_id=3, at_s=at_s, deaf_s=deaf_s)
    bench = IdentifyBench(joint=replace(JOINT, speed_max_deg_s=60.0), faults=[reset])
    experiment = bench.run()
    text = str(experiment.error)
    assert "restarted" in text or (deaf_s > 1.0 and "stopped answering" in text)
    speed_deg_s = np.abs(np.diff(bench.horn_deg())) / (TICK_NS / 1e9)
    assert speed_deg_s.max() <= 1.1 * 60.0
    back_ns = int((at_s + deaf_s + 0.03) * 1e9)
    assert not [line for at_ns, line in bench.bus.lines if at_ns > back_ns and b"#3D" in line]
    assert bench.lines()[-1] == b"#254H"
