"""What a show consists of besides its keys, by hand beside the Timeline; judged by the file."""

from __future__ import annotations

import json

import pytest

from lss_motion.planning.shows import compiled, load
from tests.browser.test_shaping import SHOW, shaping

pytestmark = pytest.mark.slow

NOD = """\
sequence: nod
robot: two.yaml
keyframes:
  - {at_s: 0, deg: {tilt: 0}}
  - {at_s: 1, deg: {tilt: 10}}
  - {at_s: 2, deg: {tilt: 0}}
"""


class Contents:
    """The fields beside the timeline, as a person uses them."""

    def __init__(self, own):
        self.own, self.page = own, own.page
        self.page.click(".about > .choice button:nth-child(2)")
        self.page.wait("document.querySelector('.part')")

    def press(self, name):
        """Press a button by its name, when what is seen is what the file holds."""
        self.page.wait(
            f"[...document.querySelectorAll('.about button')].find((one) => "
            f"one.getAttribute('aria-label') === {json.dumps(name)} && !one.disabled)"
        )
        self.page.run(
            f"[...document.querySelectorAll('.about button')].find((one) => "
            f"one.getAttribute('aria-label') === {json.dumps(name)}).click()"
        )

    def choose(self, group, name):
        """Press one of a few."""
        found = (
            f"[...document.querySelectorAll('.about [aria-label=\"{group}\"] button')]"
            f".find((one) => one.textContent === {json.dumps(name)})"
        )
        self.page.wait(found)
        self.page.run(f"{found}.click()")

    def type(self, field, value, nth=0):
        """Type into a field and leave it."""
        found = f"document.querySelectorAll('.about [data-field=\"{field}\"]')[{nth}]"
        self.page.wait(found)
        self.page.run(
            f"(() => {{ const own = {found}; own.value = {json.dumps(str(value))}; "
            "own.dispatchEvent(new Event('change', { bubbles: true })); })()"
        )

    def pick(self, name, value):
        """Pick one of a list that folds out."""
        self.page.click(f".pick summary[aria-label^='{name}:']")
        self.choose(name, value)

    def slide(self, name, value, nth=0):
        found = f"document.querySelectorAll('.about [data-slider=\"{name}\"]')[{nth}]"
        self.page.wait(found)
        self.page.run(
            f"(() => {{ const own = {found}; own.value = {value}; "
            "for (const kind of ['input', 'change']) "
            "own.dispatchEvent(new Event(kind, { bubbles: true })); })()"
        )


def test_events_are_made_moved_and_coloured(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        panel = Contents(own)
        own.page.key("Control+End")
        panel.press("Add say")
        made = SHOW + "events:\n  - {at_s: 8, say: text}\n"
        own.becomes(made)
        panel.type("text", "Guten Tag")
        own.becomes(made.replace("text}", "Guten Tag}"))
        own.page.key("Control+Home")
        panel.press("Add LED")
        lines = "  - {at_s: 0, led: {pan: red}}\n  - {at_s: 8, say: Guten Tag}\n"
        own.becomes(SHOW + "events:\n" + lines)
        panel.press("blue")
        own.becomes(SHOW + "events:\n" + lines.replace("red", "blue"))
        panel.type("at", 1.5)
        moved = lines.replace("red", "blue").replace("at_s: 0,", "at_s: 1.5,")
        own.becomes(SHOW + "events:\n" + moved)
        own.page.wait("document.querySelectorAll('.part .items li').length === 2")
        panel.press("Remove event 1")
        panel.press("Remove event 1")
        own.becomes(SHOW)
        for _ in range(7):
            own.page.key("Control+z")
        own.becomes(SHOW)


def test_the_menu_makes_events_where_it_was_opened(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        x, y, *_ = own.place("tilt", 3, 0)
        own.click(x, y, button="right")
        own.page.wait("document.querySelector('.menu [role=menuitem]')")
        own.page.run(
            "[...document.querySelectorAll('.menu button')]"
            ".find((one) => one.textContent.startsWith('LED event')).click()"
        )
        own.becomes(SHOW + "events:\n  - {at_s: 3, led: {tilt: red}}\n")
        own.page.wait("document.querySelector('.part .colour-red').ariaChecked === 'true'")


def test_an_event_is_dragged_on_its_row(studio, opened, tmp_path):
    show = (
        SHOW + "events:\n  - {at_s: 2, say: hello}  # a greeting\n  - {at_s: 5, led: {pan: red}}\n"
    )
    with shaping(studio, opened, tmp_path, show) as own:
        x, y, per_s, _ = own.place("events", 2)
        own.drag((x, y), (1.5 * per_s, 0))
        own.becomes(show.replace("at_s: 2, say", "at_s: 3.5, say"))
        own.page.key("Control+z")
        own.becomes(show)


def test_layers_are_added_weighted_masked_muted_and_soloed(studio, opened, tmp_path):
    for name in ("nod", "shake"):
        text = NOD.replace("nod", name).replace("tilt", "pan" if name == "shake" else "tilt")
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    with shaping(studio, opened, tmp_path) as own:
        panel = Contents(own)
        panel.press("Add a sequence on top")
        one = SHOW + "layers:\n  - {file: nod.yaml, fade_s: 0.3}\n"
        own.becomes(one)
        panel.choose("how nod.yaml is laid on", "added")
        own.becomes(one.replace("nod.yaml, fade_s: 0.3}", "nod.yaml, fade_s: 0.3, mode: add}"))
        panel.slide("weight", 0.5)
        weighted = one.replace(
            "nod.yaml, fade_s: 0.3}", "nod.yaml, fade_s: 0.3, mode: add, weight: 0.5}"
        )
        own.becomes(weighted)
        panel.pick("a sequence on top", "shake.yaml")
        panel.press("Add a sequence on top")
        two = weighted + "  - {file: shake.yaml, fade_s: 0.3}\n"
        own.becomes(two)
        panel.press("Mute nod.yaml")
        own.becomes(two.replace("0.5}", "0.5, mute: true}"))
        panel.press("Solo nod.yaml")
        own.becomes(two.replace("shake.yaml, fade_s: 0.3}", "shake.yaml, fade_s: 0.3, mute: true}"))
        own.page.wait(
            "document.querySelector('[aria-label=\"Solo nod.yaml\"]').ariaPressed === 'true'", 20.0
        )
        panel.press("Solo nod.yaml")
        own.becomes(two)
        panel.press("nod.yaml further up")
        own.becomes(
            SHOW
            + "layers:\n  - {file: shake.yaml, fade_s: 0.3}\n"
            + weighted.splitlines()[-1]
            + "\n"
        )
        own.page.key("Control+s")
        own.page.wait("document.querySelector('.edits button:nth-child(3)').disabled")
        assert compiled(*load(own.path, None)).program.moves, "what was saved is played"


def test_tracks_are_added_named_and_looped(studio, opened, tmp_path):
    show = SHOW.replace(", tilt: 0", "").replace(", tilt: -20", "").replace(", tilt: 10", "")
    with shaping(studio, opened, tmp_path, show) as own:
        panel = Contents(own)
        own.page.run(
            "document.querySelector('[aria-label=\"joints of a new track\"] input').click()"
        )
        panel.press("Add track")
        made = show + "tracks:\n  tilt:\n    keyframes:\n      - {at_s: 0, deg: {tilt: 0}}\n"
        own.becomes(made)
        panel.type("track", "nod")
        own.becomes(made.replace("  tilt:\n", "  nod:\n"))
        panel.choose("how often it is played", "times")
        assert "loop: 2" in own.text()
        own.page.key("Control+z")
        own.becomes(made.replace("  tilt:\n", "  nod:\n"))


def test_a_play_list_is_put_in_order_by_dragging(studio, opened, tmp_path):
    for name in ("nod", "shake"):
        (tmp_path / f"{name}.yaml").write_text(NOD.replace("nod", name), encoding="utf-8")
    show = (
        "sequence: evening\nrobot: two.yaml\nplay:\n  # first\n  - {file: nod.yaml}\n"
        "  - {pause_s: 1}\n  - {file: shake.yaml}\n"
    )
    with shaping(studio, opened, tmp_path, show) as own:
        panel = Contents(own)
        last = "document.querySelector('.part ol li:nth-child(3) .grip')"
        own.page.wait(last)
        own.page.run(f"{last}.scrollIntoView({{ block: 'end' }})")
        own.page.idle()
        x, y = own.page.place(".part ol li:nth-child(3) .grip")
        _, top = own.page.place(".part ol li:nth-child(1) .grip")
        own.drag((x, y), (0, top - y))
        moved = show.replace("  - {file: shake.yaml}\n", "").replace(
            "play:\n", "play:\n  - {file: shake.yaml}\n"
        )
        own.becomes(moved)
        panel.type("times", 3)
        own.becomes(moved.replace("shake.yaml}", "shake.yaml, times: 3}"))
        panel.press("Add pause")
        assert own.text().endswith("  - {pause_s: 1}\n")
