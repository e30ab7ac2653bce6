"""The figure in the browser: the same kinematics as in Python, and a picture that changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lss_motion.gait.figure import figure_of_legs
from lss_motion.gait.load import load_gait
from lss_motion.robot.load import load_robot

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
PLACED = """
(async () => {
  const { placeLinks } = await import('/static/figure/kinematics.js');
  return CASES.map(({ figure, pose }) => Array.from(placeLinks(figure, pose)));
})()
"""


def figures():
    names = ("desk_arm", "owl", "figure", "hexapod")
    yield from (load_robot(EXAMPLES / f"robots/{name}.yaml").figure for name in names)
    yield figure_of_legs(load_gait(EXAMPLES / "quadruped_trot.yaml").legs)


def test_links_stand_where_python_puts_them(wave, opened):
    draw = np.random.default_rng(6)
    cases, expected = [], []
    for figure in figures():
        joints = {link.joint for link in figure.links} - {None}
        for _ in range(3):
            pose = {joint: draw.uniform(-170.0, 170.0) for joint in sorted(joints)}
            cases.append({"figure": figure.as_json(), "pose": pose})
            frames = [np.column_stack(frame).ravel() for frame in figure.placed(pose)]
            expected.append(np.concatenate(frames))
    with opened(wave) as page:
        found = page.run(PLACED.replace("CASES", json.dumps(cases)))
    assert len(found) == len(cases) == 15
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def drawn(page):
    """Return the pixels of the figure alone, whatever draws it."""
    page.idle()
    box = page.run(
        "(() => { const b = document.querySelector('.figure-stage canvas').getBoundingClientRect();"
        " return [b.x, b.y, b.width, b.height]; })()"
    )
    assert min(box[2:]) > 50.0, "the figure has room"
    clip = dict(zip(("x", "y", "width", "height"), box, strict=True), scale=1)
    return page.call("Page.captureScreenshot", format="png", clip=clip)["data"]


@pytest.mark.parametrize("has_webgl", [True, False], ids=["3d", "2d"])
def test_the_picture_changes_with_the_pose_and_only_with_it(wave, opened, has_webgl):
    with opened(wave, has_webgl=has_webgl) as page:
        page.key("2")
        page.wait("document.querySelector('.figure-stage canvas')")
        page.wait("document.querySelector('[role=grid]')")
        page.key("Home")
        kind = page.run("document.querySelector('.figure-stage canvas').dataset.kind")
        assert kind == ("webgl" if has_webgl else "2d")
        start = drawn(page)
        for _ in range(8):
            page.key("Shift+ArrowRight")
        moved = drawn(page)
        page.key("Home")
        again = drawn(page)
        page.run("document.querySelectorAll('.figure-views button')[3].click()")
        top = drawn(page)
        asked = [one for one in page.requests if "three.js" in one]
    assert start != moved, "0.8 s later the arm stands elsewhere"
    assert start == again
    assert top not in (start, moved)
    assert bool(asked) == has_webgl, "three.js is loaded where it can be used, and only there"


SOLID = """
(() => {
  const canvas = document.querySelector('.figure-stage canvas');
  const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let at = 0; at < pixels.length; at += 4) {
    if (pixels[at + 3] > 200 && pixels[at + 2] - pixels[at] > 60) count += 1;
  }
  return count;
})()
"""


def test_two_fingers_enlarge_the_figure_and_the_timeline(wave, opened):
    with opened(wave, has_webgl=False) as page:
        page.key("2")
        page.wait("document.querySelector('.figure-stage canvas')")
        page.wait("document.querySelector('[role=grid]')")
        page.idle()
        whole, solid = page.picture(), page.run(SOLID)
        place = page.place(".figure-stage canvas")
        page.pinch(*place, 20.0, 40.0)
        page.idle()
        assert page.run(SOLID) > 1.2 * solid > 100
        page.pinch(*place, 40.0, 20.0)
        page.idle()
        assert page.run(SOLID) == pytest.approx(solid, rel=0.02)
        place = page.place(".board-plan")
        page.pinch(*place, 20.0, 80.0)
        page.idle()
        assert page.picture() != whole


def test_an_old_reading_is_not_drawn_as_a_lag(wave, opened):
    """A joint that was 2 degrees off when it was read is drawn so until it is read again."""
    with opened(wave) as page:
        found = page.run(DEVIATIONS)
    assert found == pytest.approx([12.0, 42.0, 51.0], abs=1e-5)


DEVIATIONS = """
(async () => {
  const { Deviations } = await import('/static/figure/panel.js');
  const deviations = new Deviations();
  const frames = [[10, 12], [40, 12], [50, 51]];
  return frames.map(([predicted, read]) => {
    deviations.take({ predicted_deg: [predicted], read_deg: [read] });
    return predicted + deviations.of(0);
  });
})()
"""
