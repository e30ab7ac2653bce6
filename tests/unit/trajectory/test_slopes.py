"""A keyframe says with which slope a joint passes it: the curve, its limits, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.shows import load
from lss_motion.planning.summaries import plan_lines
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.parts import mirrored

ROBOT = """\
robot: two
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
joints:
  pan: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 120, accel_max_deg_s2: 500}
  tilt: {id: 2, model: LSS-ST1, range_deg: [-45, 45], speed_max_deg_s: 120, accel_max_deg_s2: 500}
mirror: {opposite: {pan: tilt}}
"""
KEYS = (
    "{at_s: 0, deg: {pan: 0, tilt: 0}}",
    "{at_s: 1.5, deg: {pan: 20}}",
    "{at_s: 3, deg: {pan: 0}}",
    "{at_s: 4, deg: {pan: 10, tilt: 0}}",
)


@pytest.fixture
def loaded(tmp_path):
    (tmp_path / "two.yaml").write_text(ROBOT)

    def made(keys=KEYS, more=""):
        path = tmp_path / "show.yaml"
        lines = "".join(f"  - {one}\n" for one in keys)
        path.write_text(f"sequence: s\nrobot: two.yaml\n{more}keyframes:\n{lines}")
        return load(path, None)

    return made


def with_slope(slope, index=1, keys=KEYS, more=""):
    changed = list(keys)
    changed[index] = f"{keys[index][:-1]}, slope_deg_s: {{pan: {slope}}}{more}}}"
    return changed


def passed(trajectory, index=1, joint="pan"):
    """Return angle and speed of a joint at a keyframe, and when that is."""
    at_s = np.array([trajectory.marks[index].planned_s])
    column = trajectory.joints.index(joint)
    deg, deg_s = (float(trajectory.sample(at_s, order)[0, column]) for order in (0, 1))
    return deg, deg_s, float(at_s[0])


@pytest.mark.parametrize("ease", ["smooth", "spline"])
@pytest.mark.parametrize("slope", [-40, -7.5, 0, 12, 60])
def test_a_joint_passes_its_key_with_the_slope_that_is_written(loaded, ease, slope):
    sequence, robot = loaded(with_slope(slope), f"interpolation: {ease}\n")
    found = plan(sequence, robot)
    assert passed(found) == pytest.approx((20.0, slope, 1.5), abs=1e-6)
    assert not found.stretched
    before, after = found.sample(np.array([1.5 - 1e-6, 1.5 + 1e-6]), 1)[:, 0]
    assert before == pytest.approx(after, abs=0.01), "no corner"
    verify(found, robot)


def test_without_a_slope_all_is_as_before(loaded):
    plain, robot = loaded()
    turned, _ = loaded(with_slope(0.0))
    times_s = np.linspace(0.0, 4.0, 400)
    assert np.array_equal(plan(plain, robot).sample(times_s), plan(turned, robot).sample(times_s))


def test_where_it_is_late_it_passes_as_much_slower(loaded):
    sequence, robot = loaded(with_slope(300))
    found = plan(sequence, robot)
    verify(found, robot)
    deg, speed, at_s = passed(found)
    assert deg == pytest.approx(20.0, abs=1e-6)
    assert at_s >= 1.5 - 1e-9
    assert 60.0 < speed <= 120.1
    assert {span.joint for span in found.stretched} == {"pan"}


def test_it_goes_beyond_its_keys_and_is_told_by_how_much(loaded):
    sequence, robot = loaded(with_slope(40))
    found = plan(sequence, robot)
    most_deg = found.sample(np.linspace(0.0, 4.0, 4001))[:, 0].max()
    assert most_deg > 25.0
    (line,) = [one for one in plan_lines(found, robot) if one.startswith("beyond:")]
    assert f"joint 'pan' goes {most_deg - 20.0:.1f} deg beyond its keys" in line
    plain, robot = loaded()
    assert not [one for one in plan_lines(plan(plain, robot), robot) if one.startswith("beyond:")]


def test_out_of_its_range_it_is_refused_with_the_key(loaded):
    keys = ["{at_s: 0, deg: {pan: 0}}", "{at_s: 3, deg: {pan: 85}}", "{at_s: 6, deg: {pan: 0}}"]
    sequence, robot = loaded(with_slope(40, keys=keys))
    with pytest.raises(PlanningError, match=r"pan.*smaller slope_deg_s"):
        plan(sequence, robot)


def test_between_equal_angles_it_swings_and_does_not_rest(loaded):
    keys = [f"{{at_s: {at_s}, deg: {{pan: 10}}}}" for at_s in (0, 1, 2)]
    sequence, robot = loaded(with_slope(20, keys=keys))
    found = plan(sequence, robot)
    assert passed(found) == pytest.approx((10.0, 20.0, 1.0), abs=1e-6)
    assert found.sample(np.array([0.7, 1.3]))[:, 0] == pytest.approx([7.06, 12.94], abs=1e-6)


def test_times_that_are_scaled_scale_it(loaded):
    sequence, robot = loaded(with_slope(15), "speed_ratio: 0.5\n")
    assert passed(plan(sequence, robot)) == pytest.approx((20.0, 7.5, 3.0), abs=1e-6)
    sequence, robot = loaded(with_slope(15), "timing: fit\nduration_s: 8\n")
    assert passed(plan(sequence, robot)) == pytest.approx((20.0, 7.5, 3.0), abs=1e-6)


def test_a_mirrored_sequence_has_it_on_the_other_side(loaded):
    sequence, robot = loaded(with_slope(15))
    image = mirrored(sequence, robot.mirror)
    assert image.keyframes[1].slope_deg_s == {"tilt": -15}
    assert passed(plan(image, robot), joint="tilt") == pytest.approx((-20.0, -15.0, 1.5), abs=1e-6)


@pytest.mark.parametrize("more", ["smooth_s: 0.1\n", "keep: time\n", "loop: 2\n"])
def test_it_holds_with_what_else_a_show_may_ask(loaded, more):
    keys = [*KEYS[:-1], KEYS[-1].replace("pan: 10", "pan: 0")]
    sequence, robot = loaded(with_slope(-25, keys=keys), more)
    found = plan(sequence, robot)
    verify(found, robot)
    _, speed, _ = passed(found)
    assert speed == pytest.approx(-25.0, abs=4.0 if "smooth_s" in more else 0.01)


@pytest.mark.parametrize(
    ("keys", "more", "why"),
    [
        (with_slope(5, index=0), "", "begins and ends at rest"),
        (with_slope(5, index=3), "", "begins and ends at rest"),
        (with_slope(5, more=", hold_s: 0.2"), "", "is held here"),
        (with_slope(5, more=", ease: linear"), "", "ease: linear"),
        (with_slope(5), "interpolation: hold\n", "ease: hold"),
        ([one.replace("pan: 20}", "tilt: 2}") for one in with_slope(5)], "", "no angle here"),
        (with_slope("x"), "", "slope_deg_s"),
        (with_slope(20_000), "", "10000"),
    ],
)
def test_what_no_joint_can_do_is_refused_at_its_line(loaded, keys, more, why):
    with pytest.raises(InputError, match=why) as caught:
        loaded(keys, more)
    index = next(k for k, one in enumerate(keys) if "slope" in one)
    assert caught.value.line == 4 + more.count("\n") + index


def test_without_times_there_is_no_slope(loaded):
    keys = ["{deg: {pan: 0}}", "{deg: {pan: 20}, slope_deg_s: {pan: 5}}", "{deg: {pan: 0}}"]
    with pytest.raises(InputError, match="fastest finds the speeds itself"):
        loaded(keys)
