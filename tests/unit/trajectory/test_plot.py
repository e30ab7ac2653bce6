"""Pictures of trajectories."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.planning.picture import envelope
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.plot import ASKED, plot
from lss_motion.show.model import Cue, Sequence


@pytest.fixture
def trajectory(frame, make_robot):
    frames = (
        frame(0.0, base=0.0, elbow=0.0, label="rest"),
        frame(0.2, base=90.0, label="up"),
        frame(2.0, base=0.0, elbow=40.0, label="rest"),
    )
    return plan(Sequence(name="wave", keyframes=frames, loop=1), make_robot())


@pytest.mark.parametrize(
    ("suffix", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_the_suffix_chooses_the_kind(trajectory, make_robot, tmp_path, suffix, magic):
    target = tmp_path / f"plan.{suffix}"
    plot(trajectory, make_robot(), target)
    assert target.read_bytes().startswith(magic)


def test_the_picture_names_joints_keyframes_and_slowed_spans(
    trajectory, make_robot, tmp_path, monkeypatch
):
    import matplotlib as mpl

    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")
    times_s = np.linspace(0.0, 2.0, 50)
    plot(trajectory, make_robot(), tmp_path / "a.svg", horn=(times_s, trajectory.sample(times_s)))
    text = (tmp_path / "a.svg").read_text()
    for word in ("base", "elbow", "rest", "up", "stretched", "horn", "acceleration"):
        assert word in text


def test_what_was_asked_is_drawn_beside_what_is_given(make_robot, frame, tmp_path, monkeypatch):
    import matplotlib as mpl
    from matplotlib.axes import Axes

    drawn = []
    usual = Axes.plot

    def plotted(self, *given, **more):
        drawn.append((given, more.get("color")))
        return usual(self, *given, **more)

    monkeypatch.setattr(Axes, "plot", plotted)
    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")
    frames = [frame(0.0, base=0.0), frame(0.1, base=50.0), frame(1.0, base=0.0)]
    sequence = Sequence(name="s", keyframes=tuple(frames), keeps_time=frozenset({"base"}))
    trajectory = plan(sequence, make_robot(1))
    plot(trajectory, make_robot(1), tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert "asked" in text
    assert "deg given up to keep the time" in text
    ((times_s, asked_deg),) = [given for given, color in drawn if color == ASKED]
    assert max(asked_deg) == pytest.approx(50.0, abs=0.5)
    assert times_s[int(np.argmax(asked_deg))] == pytest.approx(0.1, abs=0.02)


def test_an_unknown_suffix_is_refused_with_the_supported_ones(trajectory, make_robot, tmp_path):
    with pytest.raises(InputError, match=r"\.png"):
        plot(trajectory, make_robot(), tmp_path / "plan.doc")


def test_a_folder_that_does_not_exist_is_an_input_error(trajectory, make_robot, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        plot(trajectory, make_robot(), tmp_path / "no" / "plan.png")


def test_a_long_show_is_drawn_from_few_shapes_and_names_what_happens(
    make_robot, frame, tmp_path, monkeypatch
):
    import matplotlib as mpl
    from matplotlib.axes import Axes

    shapes = []
    for kind in ("plot", "vlines", "fill_between", "broken_barh", "axvspan", "text"):
        usual = getattr(Axes, kind)

        def counted(self, *given, _usual=usual, _kind=kind, **more):
            shapes.append(_kind)
            return _usual(self, *given, **more)

        monkeypatch.setattr(Axes, kind, counted)
    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")
    frames = [frame(0.5 * k, base=5.0 * (k % 2), label=f"beat {k}") for k in range(1200)]
    frames[800] = frame(400.0, base=0.0, hold_s=0.2, anchor=True, label="the finale")
    cues = (Cue(at_s=30.0, say="hello there"), Cue(at_s=599.0, sound="a/drum.wav"))
    show = Sequence(name="s", keyframes=tuple(frames), events=cues)
    plot(plan(show, make_robot(1)), make_robot(1), tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    for word in ("keyframes (1199)", "anchors (1)", "events (2)", "the finale", "hello there"):
        assert word in text
    assert 10 < text.count("beat ") < 120  # Texts only where there is room.
    assert shapes.count("vlines") <= 9
    assert shapes.count("fill_between") == 3
    assert len(shapes) < 200


def test_the_envelope_of_a_curve_holds_its_extremes():
    times_s = np.linspace(0.0, 600.0, 120_000)
    values = np.sin(times_s)
    values[70_001] = 9.0
    at_s, low, high = envelope(times_s, values, 1000)
    assert len(at_s) == 1000
    assert high.max() == 9.0
    assert at_s[int(high.argmax())] == pytest.approx(times_s[70_001], abs=0.6)
    assert low.min() == pytest.approx(-1.0, abs=1e-3)
    assert (low[1:] <= high[:-1]).all()
    assert (high[1:] >= low[:-1]).all()
