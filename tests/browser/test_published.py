"""A published page in a browser without network: figure and sound follow the clock."""

from __future__ import annotations

import shutil
import wave

import pytest

from lss_motion.studio.publish import page_of, published
from tests.browser.conftest import EXAMPLES

PICTURE = "document.querySelector('#figure canvas').toDataURL()"
SOUNDED = """
window.played = [];
HTMLMediaElement.prototype.play = function () {
  window.played.push([document.getElementById('clock').textContent, this.src.slice(0, 22)]);
  return Promise.resolve();
};
"""


@pytest.mark.slow
def test_a_page_plays_offline(browser, tmp_path):
    shutil.copytree(EXAMPLES, tmp_path / "shows", ignore=shutil.ignore_patterns("my_*", "pictures"))
    with wave.open(str(tmp_path / "shows" / "bell.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(8000))
    show = tmp_path / "shows" / "owl.yaml"
    text = show.read_text(encoding="utf-8")
    show.write_text(text + "\nevents:\n  - {at_s: 0.5, sound: bell.wav}\n", encoding="utf-8")
    page_path = tmp_path / "owl.html"
    page_path.write_text(page_of(published(show)), encoding="utf-8")
    with browser.page(1000, 900) as page:
        page.call("Network.enable")
        page.call(
            "Network.emulateNetworkConditions",
            offline=True,
            latency=0,
            downloadThroughput=0,
            uploadThroughput=0,
        )
        page.call("Page.addScriptToEvaluateOnNewDocument", source=SOUNDED)
        page.go(page_path.as_uri())
        page.wait("document.querySelector('#figure canvas')?.width > 0")
        page.wait("document.getElementById('clock').textContent.startsWith('0.0 of')")
        first = page.run(PICTURE)
        page.click("#play")
        page.wait("parseFloat(document.getElementById('clock').textContent) > 1.5")
        page.click("#play")
        assert page.run(PICTURE) != first
        (played,) = page.run("window.played")
        assert played[1].startswith("data:audio/wav;base64")
        stopped = page.run("document.getElementById('clock').textContent")
        page.run("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        assert page.run("document.getElementById('clock').textContent") == stopped
        assert page.errors == []
