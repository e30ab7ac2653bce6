"""The figure in the browser: the same kinematics as in Python, and a picture that changes."""

from __future__ import annotations

import base64
import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lss_motion.robot.load import load_robot
from lss_motion.show.gait.kinematics import figure_of_legs
from lss_motion.show.gait.load import load_gait

pytestmark = pytest.mark.slow

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
        page.key("Control+Home")
        kind = page.run("document.querySelector('.figure-stage canvas').dataset.kind")
        assert kind == ("webgl" if has_webgl else "2d")
        start = drawn(page)
        for _ in range(8):
            page.key("Shift+ArrowRight")
        moved = drawn(page)
        page.key("Control+Home")
        again = drawn(page)
        page.run("document.querySelectorAll('.figure-views button')[3].click()")
        top = drawn(page)
        asked = [one for one in page.requests if "three.js" in one]
    assert start != moved, "0.8 s later the arm stands elsewhere"
    assert start == again
    assert top not in (start, moved)
    assert bool(asked) == has_webgl, "three.js is loaded where it can be used, and only there"


BOX = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
       [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
URDF = """
<robot name="r"><link name="base"/><link name="up"><visual><geometry>
  <mesh filename="box.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
<joint name="tilt" type="revolute"><parent link="base"/><child link="up"/>
  <origin xyz="0 0 0.02"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
</joint></robot>
"""


def test_a_mesh_is_drawn_and_is_whole_in_the_picture(studio, opened, tmp_path):
    """The mesh is ten times as large as the lines of the figure, from which the size was taken."""
    corners = np.array([[x, y, z] for z in (0, 200) for y in (-40, 40) for x in (-60, 60)])
    triangles = np.zeros(12, dtype=[("normal", "<f4", 3), ("at", "<f4", (3, 3)), ("more", "<u2")])
    triangles["at"] = corners[np.array(BOX)]
    data = b" " * 80 + np.uint32(12).tobytes() + triangles.tobytes()
    (tmp_path / "box.stl").write_bytes(data)
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "r.yaml").write_text(
        "robot: r\nbuses: {main: {port: 'sim://', firmware: 370}}\nurdf: {file: r.urdf}\njoints:\n"
        "  tilt: {id: 1, model: LSS-HS1, range_deg: [-50, 50], speed_max_deg_s: 90, "
        "accel_max_deg_s2: 300}\n"
    )
    show = "sequence: s\nrobot: r.yaml\nkeyframes:\n"
    show += "  - {at_s: 0, deg: {tilt: 0}}\n  - {at_s: 1.5, deg: {tilt: 30}}\n"
    (tmp_path / "s.yaml").write_text(show)
    with studio(tmp_path / "s.yaml") as own, opened(own, has_webgl=True) as page:
        page.key("2")
        page.wait("document.querySelector('.figure-stage canvas')?.dataset.kind === 'webgl'")
        for _ in range(50):  # The mesh is loaded and drawn some time after the rest.
            picture = Image.open(BytesIO(base64.b64decode(drawn(page)))).convert("RGB")
            red, _, blue = np.moveaxis(np.asarray(picture, dtype=int), 2, 0)
            is_solid = blue - red > 60
            if is_solid.any():
                break
    assert is_solid.mean() > 0.03, "it is drawn"
    edges = (is_solid[:3], is_solid[-3:], is_solid[:, :3], is_solid[:, -3:])
    assert not any(edge.any() for edge in edges), "and nothing of it is cut off"


SHAPES = {
    "box": "shape: box, length_mm: 200, size_mm: [60, 60, 200]",
    "capsule": "shape: capsule, length_mm: 140, width_mm: 60, offset_mm: [0, 0, 30]",
    "ellipsoid": "shape: ellipsoid, length_mm: 200, size_mm: [60, 60, 200]",
}
"""Three solids that stand in the same box."""


@pytest.mark.parametrize("has_webgl", [True, False], ids=["3d", "2d"])
def test_each_shape_is_drawn_as_large_as_it_is(studio, opened, tmp_path, has_webgl):
    show = "sequence: s\nrobot: r.yaml\nkeyframes:\n"
    show += "  - {at_s: 0, deg: {pan: 0}}\n  - {at_s: 1.5, deg: {pan: 30}}\n"
    (tmp_path / "s.yaml").write_text(show)
    areas = {}
    for name, shape in SHAPES.items():
        (tmp_path / "r.yaml").write_text(
            "robot: r\nbuses: {main: {port: 'sim://', firmware: 370}}\njoints:\n"
            "  pan: {id: 1, model: LSS-HS1, range_deg: [-50, 50], speed_max_deg_s: 90, "
            "accel_max_deg_s2: 300}\n"
            "figure:\n"
            "  frame: {along: z, length_mm: 200, width_mm: 1, shade: light}\n"
            f"  one: {{joint: pan, axis: z, along: z, {shape}}}\n"
        )
        with studio(tmp_path / "s.yaml") as own, opened(own, has_webgl=has_webgl) as page:
            page.key("2")
            kind = "webgl" if has_webgl else "2d"
            page.wait(f"document.querySelector('.figure-stage canvas')?.dataset.kind === '{kind}'")
            page.wait("document.querySelector('[role=grid]')")
            page.key("Control+Home")
            picture = Image.open(BytesIO(base64.b64decode(drawn(page)))).convert("RGB")
        red, _, blue = np.moveaxis(np.asarray(picture, dtype=int), 2, 0)
        is_solid = blue - red > 60
        edges = (is_solid[:3], is_solid[-3:], is_solid[:, :3], is_solid[:, -3:])
        assert not any(edge.any() for edge in edges), f"nothing of a {name} is cut off"
        rows, columns = np.nonzero(is_solid.any(axis=1))[0], np.nonzero(is_solid.any(axis=0))[0]
        areas[name] = is_solid.sum()
        tall, wide = np.ptp(rows), np.ptp(columns)
        assert 2.0 < tall / wide < 4.5, f"a {name} is {tall} by {wide}"
    # In the same frame a box hides the most and an ellipsoid the least.
    assert areas["box"] > 1.05 * areas["capsule"] > 1.05 * areas["ellipsoid"] > 1000, areas


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
  const { Deviations } = await import('/static/readings.js');
  const deviations = new Deviations();
  const frames = [[10, 12], [40, 12], [50, 51]];
  return frames.map(([predicted, read]) => {
    deviations.take({ plan: 'a', predicted_deg: [predicted], read_deg: [read] });
    return predicted + deviations.of(0);
  });
})()
"""
