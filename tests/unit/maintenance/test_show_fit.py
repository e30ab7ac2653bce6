"""What a show tells of a servo is stated with errors that hold, also where its moves say less."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from lss_motion.maintenance.identify.response_fit import HYPOTHESES, ResponseShape, horn_deg
from lss_motion.maintenance.identify.show_fit import identify_from_show
from lss_motion.maintenance.identify.show_pieces import ShowRecording
from lss_motion.maintenance.identify.trials import SentMove
from tests.virtual.conftest import make_robot

LOOP_S, LAG_S, RAMP_DEG_S2 = 0.005, 0.03, 500.0
JOINT = make_robot(1, speed_max_deg_s=200.0, accel_max_deg_s2=800.0).joints["j0"]


def recording_of(gap_s, phase_s: float) -> ShowRecording:
    """Return moves `gap_s` apart to a servo with loops at `phase_s`; `horn_deg` is the truth."""
    random, now_s, sent = Random(7), 0.0, []
    for _ in range(24):
        target_deg = round(random.uniform(-40.0, 40.0), 1)
        sent.append(SentMove(now_s, target_deg, random.uniform(0.3, 0.5)))
        now_s = round(now_s + gap_s(random), 4)
    waits_s = [(phase_s - move.received_s) % LOOP_S for move in sent]
    times_s = np.arange(0.03, now_s, 0.1)
    shape = ResponseShape(RAMP_DEG_S2, RAMP_DEG_S2, 200.0, LAG_S)
    truth_deg, _ = horn_deg(times_s, 0.0, sent, waits_s, shape, HYPOTHESES[0])
    noise_deg = [random.uniform(-0.1, 0.1) for _ in times_s]
    readings_deg = np.round(truth_deg + noise_deg, 1).tolist()
    made = ShowRecording(JOINT, 800.0, sent, [], times_s.tolist(), readings_deg)
    made.turnarounds_s = [0.0005] * len(times_s)
    return made


@pytest.mark.parametrize(
    ("gap_s", "phase_s", "error_s"),
    [
        (lambda random: LOOP_S * random.randint(60, 120), 0.0004, (0.0013, 0.0025)),
        (lambda random: random.uniform(0.3, 0.6), 0.0004, (0.0005, 0.002)),
    ],
    ids=["moves at multiples of the loop all wait as long", "moves at any time"],
)
def test_the_wait_for_the_loop_of_the_servo_is_in_the_errors(gap_s, phase_s, error_s) -> None:
    """Of moves at multiples of the loop no log can tell how long they wait: 0 to 5 ms."""
    found = identify_from_show(recording_of(gap_s, phase_s))
    assert found.retarget == ("keep_speed", True)
    assert found.t_law == ("cruise", True)
    for measured, true in (
        (found.delay_s, LAG_S + 0.5 * LOOP_S),
        (found.accel_deg_s2, RAMP_DEG_S2),
    ):
        assert abs(measured.value - true) < 3.0 * measured.error
    assert error_s[0] < found.delay_s.error < error_s[1]
    assert found.accel_deg_s2.error < 0.05 * RAMP_DEG_S2
    assert not found.unsure
