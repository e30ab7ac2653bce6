"""Make the pictures of the studio in the guide and the README from the real thing.

tools/run python tools/pictures.py              all of them, into sequences/pictures
tools/run python tools/pictures.py studio_show  these

Each is a page of `lss-motion studio` in a headless browser, with a simulated robot, while a show
plays.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cdp import Browser
from running_studio import running

if TYPE_CHECKING:
    from cdp import Page

ROOT: Final = Path(__file__).resolve().parent.parent
FOLDER: Final = ROOT / "sequences" / "pictures"


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture: which file, how large, which keys are pressed, and at which show time."""

    file: str
    keys: str
    from_s: float
    size: tuple[int, int] = (1366, 768)
    theme: str = "dark"


PICTURES: Final = {
    "studio": Picture("wave.yaml", "2", 10.6),
    "studio_show": Picture("owl.yaml", "1", 4.8, (820, 1180), "light"),
    "studio_timeline": Picture("hexapod_dance.yaml", "2s", 8.0),
    "studio_robot": Picture("hexapod_dance.yaml", "3", 9.0, theme="light"),
}


def main(names: list[str]) -> int:
    """Make the named pictures, or all."""
    with Browser() as browser:
        for name in names or PICTURES:
            chosen = PICTURES[name]
            with (
                running(ROOT / "sequences" / chosen.file) as own,
                browser.page(*chosen.size) as page,
            ):
                take(page, own.url, chosen, FOLDER / f"{name}.png")
            print(FOLDER / f"{name}.png")
    return 0


def take(page: Page, url: str, chosen: Picture, path: Path) -> None:
    """Play the show, go to a page, and take its picture at an instant."""
    page.go(url)
    page.wait("document.querySelector('.joints')")
    page.wait("document.querySelector('.head')")
    if page.run("document.documentElement.dataset.theme") != chosen.theme:
        page.key("t")
    page.key(" ")
    for key in chosen.keys:
        page.key(key)
    page.key("f")
    at_s = f"Number(document.querySelector('.way input').value) >= {chosen.from_s}"
    page.wait(at_s, seconds=90.0)
    page.idle()
    page.picture(path)
    assert not page.errors, page.errors


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
