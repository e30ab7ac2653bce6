"""The sources of the pages."""

import re
from pathlib import Path

import lss_motion

STATIC = Path(lss_motion.__file__).parent / "studio" / "static"
COVERS = re.compile(
    r"showModal|requestFullscreen|popover|<select|<datalist|\b(alert|confirm|prompt)\("
)
"""What a browser shows above the page, where STOP and E-STOP cannot be pressed."""


def test_no_page_has_what_a_browser_shows_above_stop():
    found = [
        f"{path.relative_to(STATIC)}: {match[0]}"
        for path in STATIC.rglob("*.*")
        if path.suffix in (".js", ".html") and "vendor" not in path.parts
        for match in COVERS.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []
