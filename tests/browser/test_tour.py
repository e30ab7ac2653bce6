"""From an empty folder to a head that talks, without a text editor: the guided tour."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lss_motion.planning.shows import compiled, load
from tests.browser.conftest import NO_WEBGL
from tests.browser.test_contents import Contents
from tests.browser.test_shaping import CHECKED, Shaped
from tests.browser.test_sounds import PEAKS_S, RATE_HZ, drop, sound
from tests.speech import spoken

pytestmark = pytest.mark.slow

STEP = "document.querySelector('.tour')?.dataset.step"
HEAD = """\
# Without a port it is simulated; lss-motion studio FILE --port /dev/ttyUSB0 moves servos.
robot: skull
joints:
  jaw:  {id: 1, model: LSS-ST1, range_deg: [0, 20], speed_max_deg_s: 360, accel_max_deg_s2: 1000}
  nod:  {id: 2, model: LSS-ST1, range_deg: [-20, 20], speed_max_deg_s: 180, accel_max_deg_s2: 600}
  turn: {id: 3, model: LSS-ST1, range_deg: [-60, 60], speed_max_deg_s: 180, accel_max_deg_s2: 600}
"""


def typed(page, label, text):
    """Type into the field of a dialog that has this label."""
    found = f"document.querySelector('dialog input[aria-label={json.dumps(label)}]')"
    page.wait(found)
    page.run(
        f"(() => {{ const own = {found}; own.value = {json.dumps(text)}; "
        "for (const kind of ['input', 'change']) "
        "own.dispatchEvent(new Event(kind, { bubbles: true })); })()"
    )


def pressed(page, name):
    """Press a button of a dialog or banner by its name."""
    found = (
        "[...document.querySelectorAll('dialog button, .banners button')].find((one) => "
        f"(one.getAttribute('aria-label') ?? one.textContent) === {json.dumps(name)} && "
        "!one.disabled)"
    )
    page.wait(found)
    page.run(f"{found}.click()")


def test_from_an_empty_folder_to_a_head_that_talks(studio, browser, tmp_path):
    folder = tmp_path / "new"
    folder.mkdir()
    voice = sound(tmp_path / "voice.wav", spoken(PEAKS_S, 3.0, rate_hz=RATE_HZ))
    with studio(folder) as own, browser.page(1366, 768) as page:
        page.call("Page.addScriptToEvaluateOnNewDocument", source=NO_WEBGL)
        page.go(own.url)
        page.wait("document.body.innerText.includes('Nothing is open')")
        page.click("[aria-label^='Files:']")
        pressed(page, "Guide me from nothing to a talking head")
        page.wait(f"{STEP} === '0'")
        pressed(page, "Files")
        typed(page, "name of the figure", "skull")
        pressed(page, "Make the figure")
        page.wait(f"{STEP} === '1'")
        robot = (folder / "skull.yaml").read_text("utf-8")
        assert robot.startswith(HEAD)
        assert "joint: jaw" in robot
        pressed(page, "Files")
        typed(page, "name of the show", "First night")
        pressed(page, "Make the show")
        page.wait(f"{STEP} === '2'")
        page.wait(CHECKED)
        shaped = Shaped(page, own, folder / "First_night.yaml")
        drop(page, "voice.wav", voice)
        page.wait(f"{STEP} === '3'")
        panel = Contents(shaped)
        panel.press("voice.wav is the sound of the show")
        page.wait(f"{STEP} === '4'")
        panel.press("A joint follows voice.wav")
        panel.press("Let jaw follow")
        page.wait(f"{STEP} === '5'")
        page.wait(CHECKED)
        shaped.page.click(".about > .choice button:nth-child(1)")
        page.key("End")
        page.wait("document.querySelector('.cursor-time output').textContent.includes('10')")
        for _ in range(20):
            page.key("Shift+ArrowLeft")
        page.run(
            "(() => { const own = document.querySelector('input[data-pose=turn]'); own.value = 30;"
            "own.dispatchEvent(new Event('change', { bubbles: true })); })()"
        )
        page.wait(f"{STEP} === '6'")
        page.wait("!document.querySelector('.edits button:nth-child(3)').disabled")
        page.key("Control+s")
        page.wait("document.querySelector('.edits button:nth-child(3)').disabled")
        assert shaped.path.read_text("utf-8") == (
            'sequence: "First night"\nrobot: skull.yaml\nkeyframes:\n'
            "  - {at_s: 0, deg: {jaw: 0, nod: 0, turn: 0}}\n"
            "  - {at_s: 8, deg: {turn: 30}}\n"
            "  - {at_s: 10, deg: {jaw: 0, nod: 0, turn: 0}}\n"
            "sound: voice.wav\n"
            "layers:\n  - {file: voice_jaw.yaml, joints: [jaw]}\n"
        )
        page.key("Space")
        page.wait(f"{STEP} === '7'")
        page.wait("document.querySelector('.head-state').innerText.includes('playing')")
        page.key("Escape")
        assert page.errors == []
    plan = compiled(*load(shaped.path, None)).trajectory
    jaw = plan.sample(np.array(PEAKS_S))[:, list(plan.joints).index("jaw")]
    assert jaw.min() > 2.0, "it opens with each syllable"


def test_a_show_is_opened_and_duplicated_and_a_figure_has_what_a_person_types(
    studio, browser, tmp_path
):
    (tmp_path / "skull.yaml").write_text(HEAD, encoding="utf-8")
    text = "sequence: a\nrobot: skull.yaml\nkeyframes:\n  - {at_s: 0, deg: {jaw: 0}}  # ü\n"
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    with studio(tmp_path) as own, browser.page(820, 1180) as page:
        page.call("Page.addScriptToEvaluateOnNewDocument", source=NO_WEBGL)
        page.go(own.url)
        page.wait("document.body.innerText.includes('Nothing is open')")
        page.click("[aria-label^='Files:']")
        pressed(page, "a.yaml")
        page.wait("document.querySelector('.joints')")
        page.click("[aria-label^='Files:']")
        typed(page, "name of the copy", "b two")
        pressed(page, "Make the copy")
        page.wait("document.querySelector('[aria-label=\"Files: b_two.yaml\"]')")
        assert (tmp_path / "b_two.yaml").read_text("utf-8") == text
        page.click("[aria-label^='Files:']")
        typed(page, "name of the copy", "a")
        pressed(page, "Make the copy")
        page.wait("document.querySelector('.banners').innerText.includes('not overwritten')")
        assert (tmp_path / "a.yaml").read_text("utf-8") == text
        pressed(page, "only joints")
        typed(page, "name of the figure", "Kran")
        typed(page, "name of joint 1", "haken")
        typed(page, "servo id of haken", "7")
        typed(page, "least angle of haken", "90")
        page.wait("document.querySelector('dialog').innerText.includes('a range ends above')")
        typed(page, "least angle of haken", "-45")
        pressed(page, "Make the figure")
        page.wait("document.querySelector('[aria-label=\"Files: Kran.yaml\"]')")
        made = (tmp_path / "Kran.yaml").read_text("utf-8")
        assert "haken: {id: 7, model: LSS-ST1, range_deg: [-45, 90]," in made
        assert page.errors == []
