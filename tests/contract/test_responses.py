"""The response models of streamed and stepped joints against the simulated servos, at the horn.

Two implementations that share no code receive the same bytes. (Timed moves: tests/property.)
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.streamed import FilterProfile, StepProfile
from lss_motion.robot.model import Response
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics, ServoSpec

CRISP = Physics(lag_s=1e-4, noise_deg=0.0)
"""A horn that is where its servo's profile is."""
SPEED_DEG_S, PERIOD_S, BAUD_BPS = 60.0, 0.02, 500_000
PULSE_DEG = 180.0 / (2400 - 544)
"""An RC servo turns by whole microseconds: its board maps degrees to them and cuts the rest off."""
START_S = 0.05


def simulated(model="LSS-HS1", *, settings=b"", physics=CRISP, seed=3):
    spec = ServoSpec(servo_id=5, model=SERVO_MODELS[model])
    bus = SimBus([spec], baud_bps=BAUD_BPS, firmware=370, seed=seed, physics=physics)
    bus.record()
    bus.advance(0)
    bus.write(settings, 0)
    return bus


def tell(bus, said):
    """Write bare `D`s, `(at_s, wire)`; return when each is received."""
    received_s = []
    for at_s, wire in said:
        bus.write(b"#5D%d\r" % wire, round(at_s * 1e9))
        received_s.append(at_s + bus.backlog_ns(round(at_s * 1e9)) / 1e9)
    return received_s


@cache
def filter_step_s():
    """Return one instant at which the filter of the simulated servo steps, from outside.

    The middle of those that explain best where a horn was, to a quarter of a millisecond.
    """
    bus = simulated(settings=b"#5FPC1\r#5EM0\r")
    said = swing(99)
    received_s = tell(bus, said)
    bus.advance(6_000_000_000)
    trials_s = np.arange(0.0, PERIOD_S, 0.00025)
    errors = []
    for step_s in trials_s:
        held_s = step_s + PERIOD_S * np.arange(200)
        held_deg = model_of(1, said, received_s, float(step_s)).sample(held_s + 0.5 * PERIOD_S)
        errors.append(np.abs(settled(bus, held_s) - held_deg).mean())
    best = trials_s[np.array(errors) <= min(errors) + 1e-3]
    return float(np.mean(best))


def settled(bus, steps_s):
    """Return where the horn is shortly before the filter makes its next step."""
    return bus.horn_deg(((steps_s + 0.72 * PERIOD_S) * 1e9).astype(np.int64))[:, 0]


def swing(seed, *, spread_s=(0.004, 0.09)):
    """Targets along a swing that is nowhere faster than `SPEED_DEG_S`, at odd instants."""
    random = np.random.default_rng(seed)
    at_s, said = START_S, []
    while at_s < 3.0:
        said.append((at_s, round(10 * SPEED_DEG_S / 4.0 * np.sin(4.0 * (at_s - START_S)))))
        at_s += float(random.uniform(*spread_s))
    return said


def clear_of_loops(said, step_s):
    """Leave out what is received so near to a control loop that nobody can say which one it is."""
    line_s = 8 * 10 / BAUD_BPS
    return [one for one in said if 0.0006 < (one[0] + line_s - step_s) % 0.005 < 0.0044]


def model_of(count, said, received_s, step_s):
    model = FilterProfile(0.0, count=count, response=Response(), step_s=step_s)
    for (_, wire), instant_s in zip(said, received_s, strict=True):
        model.retarget(instant_s, wire / 10, None)
    return PiecewiseProfile(model.pieces())


@pytest.mark.parametrize("count", [1, 2, 3, 5, 14])
@pytest.mark.parametrize("seed", range(3))
def test_with_the_same_parameters_the_filter_is_predicted_to_its_rounding(count, seed):
    step_s = filter_step_s()
    bus = simulated(settings=b"#5FPC%d\r#5EM0\r" % count)
    # Without a filter a horn needs time for a jump: closer together, they are small.
    spread_s = (0.004, 0.03 if count == 1 else 0.09)
    said = clear_of_loops(swing(seed, spread_s=spread_s), step_s)
    assert len(said) > 40
    received_s = tell(bus, said)
    bus.advance(6_000_000_000)
    expected = model_of(count, said, received_s, step_s)
    steps = np.arange(240)
    held_s = step_s + PERIOD_S * steps
    horn_deg = settled(bus, held_s)
    assert np.ptp(horn_deg) > 15.0, "it moved"
    assert np.abs(horn_deg - expected.sample(held_s + 0.5 * PERIOD_S)).max() < 0.06


def test_at_a_horn_with_its_lag_the_prediction_is_the_mean_over_a_period():
    step_s, count, lag_s = filter_step_s(), 4, 0.02
    bus = simulated(
        settings=b"#5FPC4\r#5EM0\r", physics=Physics(lag_s=lag_s, noise_deg=0.0)
    )  # fmt: skip
    said = swing(1, spread_s=(0.02, 0.02))
    expected = model_of(count, said, tell(bus, said), step_s)
    bus.advance(6_000_000_000)
    times_ns = np.arange(0, 5_000_000_000, 1_000_000)
    horn_deg = np.convolve(bus.horn_deg(times_ns)[:, 0], np.ones(20) / 20, "same")
    late_deg = expected.sample(times_ns / 1e9 - lag_s)
    inside = slice(100, -100)
    assert np.abs(horn_deg - late_deg)[inside].max() < 0.5
    assert np.sqrt(np.mean((horn_deg - late_deg)[inside] ** 2)) < 0.2


@pytest.mark.parametrize("wrong_s", [0.002, 0.005, 0.01, 0.013, 0.019])
def test_not_knowing_when_the_filter_steps_costs_no_more_than_one_period_of_motion(wrong_s):
    step_s = filter_step_s()
    bus = simulated(settings=b"#5FPC4\r#5EM0\r")
    said = swing(2, spread_s=(0.02, 0.02))
    received_s = tell(bus, said)
    bus.advance(6_000_000_000)
    times_s = step_s + PERIOD_S * (np.arange(240) + 0.5)
    horn_deg = settled(bus, times_s - 0.5 * PERIOD_S)
    right = np.abs(horn_deg - model_of(4, said, received_s, step_s).sample(times_s)).max()
    wrong = np.abs(horn_deg - model_of(4, said, received_s, step_s + wrong_s).sample(times_s)).max()
    assert right < wrong < 1.1 * SPEED_DEG_S * PERIOD_S + 0.1


@pytest.mark.parametrize("wrong", [3, 5])
def test_another_fpc_is_off_by_the_difference_of_the_lags(wrong):
    step_s = filter_step_s()
    bus = simulated(settings=b"#5FPC4\r#5EM0\r")
    said = swing(2, spread_s=(0.02, 0.02))
    expected = model_of(wrong, said, tell(bus, said), step_s)
    bus.advance(6_000_000_000)
    times_s = step_s + PERIOD_S * (np.arange(240) + 0.5)
    horn_deg = settled(bus, times_s - 0.5 * PERIOD_S)
    error_deg = np.abs(horn_deg - expected.sample(times_s)).max()
    assert 0.5 * SPEED_DEG_S * PERIOD_S < error_deg < 1.1 * SPEED_DEG_S * PERIOD_S


@pytest.mark.parametrize("seed", range(3))
def test_an_rc_servo_jumps_to_the_whole_degrees_that_it_was_told(seed):
    random = np.random.default_rng(seed)
    instants_s = START_S + np.cumsum(random.uniform(0.13, 0.3, 30))
    said = [(float(s), 10 * int(random.integers(-20, 21))) for s in instants_s]
    bus = simulated("LSS-2IO", physics=Physics(lag_s=1e-4, noise_deg=0.0))
    model = StepProfile(0.0)
    received_s = tell(bus, said)
    for (_, wire), instant_s in zip(said, received_s, strict=True):
        model.retarget(instant_s, wire / 10, None)
    bus.advance(9_000_000_000)
    reference = PiecewiseProfile(model.pieces())
    for next_s, _ in said[1:]:
        (horn_deg,) = bus.horn_deg([round((next_s - 0.006) * 1e9)])[:, 0]
        assert horn_deg == pytest.approx(reference.at(next_s - 0.006)[0], abs=PULSE_DEG)
