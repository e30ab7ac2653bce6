"""The operator's page of a stage, in a real browser, against the real server."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
SHOW = """\
sequence: {name}
robot: robots/desk_arm.yaml
keyframes:
  - {{at_s: 0, pose: home}}
  - {{at_s: {half_s}, deg: {{base: {deg}}}}}
  - {{at_s: {end_s}, pose: home}}
"""
STAGE = """\
stage: hall
robot: robots/desk_arm.yaml
shows: {idle: idle.yaml, scare: scare.yaml}
idle: idle
cues:
  - {cue: door, on: {key: d}, play: scare, start: terminate}
  - {cue: first, on: {go: true}, play: scare, start: terminate}
  - {cue: second, on: {go: true}, play: scare, start: terminate}
log: {ring_s: 0}
"""
ON = "document.querySelector('.stage-state dd')?.textContent"
STATE = "document.querySelector('.state').dataset.state"


def test_cues_are_fired_enabled_and_armed_on_the_page_of_a_stage(
    studio, opened, tmp_path, monkeypatch
):
    monkeypatch.setenv("LSS_MOTION_STATE_DIR", str(tmp_path / "state"))
    shutil.copytree(EXAMPLES / "robots", tmp_path / "robots")
    for name, half_s, deg in (("idle", 2, 5), ("scare", 1.5, 40)):
        text = SHOW.format(name=name, half_s=half_s, end_s=2 * half_s, deg=deg)
        (tmp_path / f"{name}.yaml").write_text(text)
    (tmp_path / "hall.yaml").write_text(STAGE)
    with studio(tmp_path / "hall.yaml", command="serve") as own, opened(own) as page:
        page.wait(f"{ON} === 'idle'")
        cues = (
            "[...document.querySelectorAll('[data-stage-cue]')].map((one) => one.dataset.stageCue)"
        )
        assert page.run(cues) == ["door", "first", "second"]
        named = {(role, name) for role, name in page.names()}
        assert ("button", "Fire door") in named
        assert ("switch", "door can fire") in named
        goes = [name for role, name in named if role == "button" and name.startswith("GO")]
        assert len(goes) == 1, "one button for GO"
        assert goes[0].startswith("GO: first")
        page.click("[data-stage-cue=door] .fire")
        page.wait(f"{ON} === 'scare'")
        # Times and curves are those of the show that plays.
        page.wait("document.querySelector('.clock-of').textContent === 'of 0:03.0'")
        focus = page.run("document.activeElement === document.body")
        assert focus, "Enter is GO, not a second fire"
        page.click("[data-stage-cue=door] input")
        page.wait("document.querySelector('[data-stage-cue=door]').className === 'past'")
        page.wait(f"{ON} === 'idle'")
        page.click("[data-stage-cue=second] .plain")
        page.wait("document.querySelector('[data-go]').textContent.includes('GO: second')")
        page.key("Enter")
        page.wait(f"{ON} === 'scare'")
        page.click(".stage-head button")
        page.wait(f"{STATE} === 'rests'")
        page.wait("document.querySelector('.state-detail').textContent.includes('operator')")
        page.click(".stage-head button")
        page.wait(f"{ON} === 'idle'")
        page.wait("document.querySelector('.stage-notes').textContent.includes('cue second')")
        page.key("Escape")
        page.wait("document.body.dataset.latched === 'true'")
        page.wait("document.querySelector('.stage-state') === null")
