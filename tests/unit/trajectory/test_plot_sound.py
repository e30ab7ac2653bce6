"""The row of sounds in the picture of a plan."""

from __future__ import annotations

import sys
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import lss_motion as lss
from lss_motion.planning.trajectory.plot import all_beats, plot
from lss_motion.sound.envelope import draw_beats
from tests.speech import spoken

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)


@pytest.fixture
def show(tmp_path):
    soundfile.write(tmp_path / "voice.wav", spoken([0.5, 1.0], 1.5), 22_050)
    robot = {
        "robot": "r",
        "joints": {
            "a": {"id": 1, "model": "LSS-ST1", "range_deg": [0, 90], "speed_max_deg_s": 100,
                  "accel_max_deg_s2": 300}
        },
    }  # fmt: skip
    (tmp_path / "s.yaml").write_text(
        "sequence: s\nkeep: time\nbeats: [0.5, 1.0]\nloop: 2\nkeyframes:\n"
        "  - {at_s: 0, deg: {a: 0}}\n  - {at_s: 0.5, deg: {a: 30}}\n  - {at_s: 1.0, deg: {a: 0}}\n"
        "  - {at_s: 2, deg: {a: 0}}\nevents:\n  - {at_s: 0.25, sound: voice.wav}\n"
    )
    robot = lss.load_robot(robot)
    sequence = lss.load_sequence(tmp_path / "s.yaml", robot)
    return sequence, robot, lss.plan(sequence, robot)


def test_the_sound_is_drawn_where_it_sounds_with_beats_of_every_pass(show, tmp_path, monkeypatch):
    sequence, robot, trajectory = show
    drawn = []
    real = Axes.fill_between
    monkeypatch.setattr(
        Axes, "fill_between", lambda self, x, *rest, **how: drawn.append((x, rest, how)) or
        real(self, x, *rest, **how),
    )  # fmt: skip
    plot(trajectory, robot, tmp_path / "s.png", beats_s=sequence.beats_s)
    waves = [(x, rest) for x, rest, how in drawn if "alpha" not in how]
    assert [x[0] for x, _ in waves] == pytest.approx([0.25, 2.25], abs=0.01), "in both passes"
    x, (_, high) = waves[0]
    assert x[np.argmax(high)] == pytest.approx(0.75, abs=0.03) or x[np.argmax(high)] == (
        pytest.approx(1.25, abs=0.03)
    )
    given_up = [rest for _, rest, how in drawn if "alpha" in how]
    assert max(np.abs(np.subtract(*rest)).max() for rest in given_up) > 5.0
    assert all_beats(trajectory, sequence.beats_s, 4.0) == pytest.approx([0.5, 1.0, 2.5, 3.0])


def test_without_the_extra_the_picture_says_what_is_missing(show, tmp_path, monkeypatch):
    _, robot, trajectory = show
    said = []
    real = Axes.text
    monkeypatch.setattr(
        Axes, "text", lambda self, x, y, s, *rest, **how: said.append(s) or
        real(self, x, y, s, *rest, **how),
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "soundfile", None)
    plot(trajectory, robot, tmp_path / "s.png")
    assert any("voice.wav is not drawn: sound files need a library: " in text for text in said)


@pytest.mark.parametrize("apart_s", [0.05, 0.3, 0.4, 2.0])
@pytest.mark.parametrize("width_in", [3.0, 8.0, 16.0])
def test_the_numbers_of_beats_do_not_touch(apart_s, width_in):
    figure = Figure(figsize=(width_in, 2.0))
    axis = figure.add_axes((0.0, 0.0, 1.0, 0.8))
    axis.set_xlim(0.0, 60.0)
    draw_beats(axis, np.arange(1.0, 60.0, apart_s), (0.0, 60.0), width_in)
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in axis.texts]
    assert len(boxes) >= 3
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
    lines_top = axis.transAxes.transform((0.0, 1.0))[1]
    assert all(box.y0 >= lines_top for box in boxes)
