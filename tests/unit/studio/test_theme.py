"""Colours of both themes: their contrast is that of WCAG AA."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

STATIC = Path(__file__).resolve().parents[3] / "lss_motion" / "studio" / "static"
TEXTS = [  # text, ground: 4.5 to 1
    *((text, ground) for text in ("text", "muted") for ground in ("ground", "surface", "raised")),
    *((text, "surface") for text in ("accent", "good", "warn", "bad", "anchor", "predicted")),
    *((text, "raised") for text in ("predicted", "text", "accent")),
    *(("text", f"{name}-ground") for name in ("bad", "warn", "note")),
    *(("event", ground) for ground in ("surface",)),
    *((f"{name}-ink", name) for name in ("accent", "stop", "estop", "go")),
    *((text, f"{text}-ground") for text in ("bad", "warn")),
    *(("ground", tone) for tone in ("bad", "warn")),
    ("accent", "ground"),
    ("good", "ground"),
    ("warn", "ground"),
    ("bad", "ground"),
]
SHAPES = [  # lines and signs: 3 to 1
    *(
        (name, "surface")
        for name in (
            *("plan", "predicted", "reading", "authored", "key", "anchor", "event", "limit"),
            *("stretched", "given-up", "playhead", "cursor", "edge", "wave"),
        )
    ),
    ("edge", "raised"),
    ("reading", "raised"),
    ("plan", "raised"),
    ("stop", "stop-ink"),
]


def themes():
    text = re.sub(
        r"/\*.*?\*/", "", (STATIC / "theme.css").read_text(encoding="utf-8"), flags=re.DOTALL
    )
    found = {}
    for head, body in re.findall(r"([^{}]+)\{([^{}]*)\}", text):
        name = "light" if "light" in head else "dark"
        found[name] = dict(re.findall(r"--([\w-]+):\s*(#[0-9a-f]{6})\s*;", body))
    return found


def luminance(colour):
    parts = [int(colour[n : n + 2], 16) / 255.0 for n in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_contrast_is_computed_as_wcag_does():
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_every_text_and_sign_has_the_contrast_of_aa(theme):
    colours = themes()[theme]
    low = [
        f"{one} on {other}: {found:.2f}, at least {least}"
        for pairs, least in ((TEXTS, 4.5), (SHAPES, 3.0))
        for one, other in pairs
        if (found := contrast(colours[one], colours[other])) < least
    ]
    assert low == []


def test_every_colour_that_is_used_is_in_both_themes():
    both = themes()
    assert set(both["light"]) == set(both["dark"])
    used = set()
    for path in [*STATIC.rglob("*.css"), *(STATIC / "timeline").glob("*.js")]:
        used |= set(re.findall(r"var\(--([\w-]+)|\"--([\w-]+)\"", path.read_text(encoding="utf-8")))
    named = {one or other for one, other in used}
    sheets = "".join(
        (STATIC / name).read_text(encoding="utf-8") for name in ("theme.css", "app.css")
    )
    defined = set(re.findall(r"--([\w-]+):", sheets))
    assert named <= defined, named - defined
