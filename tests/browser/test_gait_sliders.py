"""The parameters of a gait by sliders, with feet, polygon and margin of what is planned."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from tests.browser.conftest import EXAMPLES
from tests.browser.test_contents import Contents
from tests.browser.test_pure import modules
from tests.browser.test_shaping import CHECKED, Shaped

pytestmark = pytest.mark.slow

MARGIN = "Number(document.querySelector('.feet').dataset.margin)"


def margin_mm(points, point=(0.0, 0.0)):
    """Return how far a point is inside of the hull of others."""
    normals = ConvexHull(np.array(points)).equations
    return float(-(normals[:, :2] @ np.array(point) + normals[:, 2]).max())


def test_hull_and_margin_are_those_of_another_program(wave, opened):
    draw = np.random.default_rng(3)
    sets = [draw.uniform(-100, 100, (n, 2)).round(3).tolist() for n in (3, 4, 5, 6, 6, 9)]
    sets.append([[0, 0], [100, 0], [50, 0], [100, 100], [0, 100], [0, 50]])
    with opened(wave) as page:
        found = page.run(
            modules("contents/footing")
            + f""".then(([footing]) => {json.dumps(sets)}.map((set) => (
              footing.marginOf(footing.hullOf(set), [5, -3]))))"""
        )
    assert np.allclose(found, [margin_mm(one, (5.0, -3.0)) for one in sets], atol=1e-6)


def test_sliders_write_the_gait_and_the_feet_follow(studio, opened, tmp_path):
    shutil.copytree(EXAMPLES / "robots", tmp_path / "robots")
    path = tmp_path / "hexapod_walk.yaml"
    shutil.copy(EXAMPLES / "hexapod_walk.yaml", path)
    text = path.read_text("utf-8")
    with studio(path) as own, opened(own) as page:
        page.key("2")
        page.wait("document.querySelector('.board-plan')")
        page.wait(CHECKED)
        shaped = Shaped(page, own, path)
        panel = Contents(shaped)
        page.wait("document.querySelector('.feet')")
        for _ in range(12):
            page.key("Shift+ArrowRight")
        page.wait("document.querySelectorAll('.foot-down').length === 6")
        reach = {
            (hip_x + 145 * math.cos(math.radians(yaw)), hip_y + 145 * math.sin(math.radians(yaw)))
            for hip_x, hip_y, yaw in (
                *((89, 61, 34), (0, 81, 90), (-89, 61, 146)),
                *((89, -61, -34), (0, -81, -90), (-89, -61, -146)),
            )
        }
        assert page.run(MARGIN) == pytest.approx(margin_mm(list(reach)), abs=1.0)
        panel.slide("stance", 120)
        shaped.becomes(text.replace("stance_mm: 145", "stance_mm: 120"))
        page.wait(f"{MARGIN} < {margin_mm(list(reach)) - 5}")
        panel.slide("step height", 30)
        panel.slide("step height", 32)
        panel.slide("forward", 30)
        changed = text.replace("stance_mm: 145", "stance_mm: 120")
        changed = changed.replace("step_height_mm: 20", "step_height_mm: 32")
        shaped.becomes(changed.replace("forward_mm_s: 45", "forward_mm_s: 30"))
        page.key("Control+z")
        shaped.becomes(changed)
        page.key("Control+z")
        shaped.becomes(text.replace("stance_mm: 145", "stance_mm: 120"))
        page.key("Control+z")
        shaped.becomes(text)
        panel.choose("pattern", "ripple")
        shaped.becomes(text.replace("pattern: tripod  ", "pattern: ripple  "))
        page.key("Control+z")
        shaped.becomes(text)
