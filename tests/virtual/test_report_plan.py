"""The plan in a report is where each joint should have been, other speeds and loops included."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.cli.report import plot_report
from lss_motion.show.model import Cue


def test_the_plan_of_a_report_passes_all_readings_also_at_another_speed(stage, kit):
    show = kit.sequence(2, 5.0)
    show = replace(show, loop=2, events=(Cue(at_s=1.0, say="now"),))
    wishes = (
        (kit.in_show(2.0), kit.rate(0.5)),
        (kit.in_show(3.0), kit.rate(1.0)),
    )
    played = stage.play(kit.robot(2), show, wishes=wishes)
    assert played.report.outcome == "finished"
    for joint in played.report.joints.values():
        plan, trace = joint.plan, joint.trace
        inside = [k for k, at_s in enumerate(trace.at_s) if plan.at_s[0] <= at_s <= plan.at_s[-1]]
        line_deg = np.interp([trace.at_s[k] for k in inside], plan.at_s, plan.deg)
        planned_deg = np.array([trace.planned_deg[k] for k in inside])
        assert len(inside) > 50
        assert np.abs(line_deg - planned_deg).max() < 0.4
        assert np.ptp(plan.deg) == pytest.approx(np.ptp(planned_deg), abs=1.0)
        assert len(plan.at_s) < 400
    events = [one.at_s for one in played.report.timeline if one.kind == "event"]
    assert events[0] == pytest.approx(1.0, abs=0.01)
    # The event of the second pass is later by the pass and the slow second.
    assert events[1] > 6.0 + 0.8
    keyframes = [one for one in played.report.timeline if one.kind == "keyframe"]
    assert len(keyframes) == 2 * len(show.keyframes)


def test_the_picture_draws_the_plan_and_not_a_line_through_readings(
    stage, kit, tmp_path, monkeypatch
):
    from matplotlib.axes import Axes

    lines = []
    usual = Axes.plot

    def noted(self, *given, **more):
        lines.append(given)
        return usual(self, *given, **more)

    monkeypatch.setattr(Axes, "plot", noted)
    played = stage.play(kit.robot(1), kit.sequence(1, 4.0))
    report = played.report.to_dict()
    (joint,) = report["joints"].values()
    # Only every 40th reading is left, as after a long show.
    joint["trace"] = {key: values[::40] for key, values in joint["trace"].items()}
    plot_report(report, tmp_path / "a.svg")
    at_s, deg = next(given[:2] for given in lines if list(given[0]) == list(joint["plan"]["at_s"]))
    times_s = np.linspace(0.1, 3.9, 400)
    wanted_deg = played.trajectory.sample(times_s)[:, 0]
    assert np.interp(times_s, at_s, deg) == pytest.approx(wanted_deg, abs=0.8)
