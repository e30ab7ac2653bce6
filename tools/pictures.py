"""Make the pictures of the studio from the real thing.

tools/run python tools/pictures.py                       those of the guide, into sequences/pictures
tools/run python tools/pictures.py studio_show           these of them
tools/run python tools/pictures.py --all DIR [GROUP]...  every state and dialog, on every page, in
                                                         both themes and three sizes

Those of the guide show a page of `lss-motion studio` in a headless browser, with a simulated robot,
while a show plays. The states are those of `tools/scenes.py`.
"""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import scenes
from cdp import Browser
from running_studio import running

if TYPE_CHECKING:
    from collections.abc import Iterator

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
    "studio": Picture("owl.yaml", "1", 5.4),
    "studio_show": Picture("owl.yaml", "1", 5.4, (820, 1180), "light"),
    "studio_timeline": Picture("hexapod_dance.yaml", "22f", 8.0),
    "studio_robot": Picture("hexapod_dance.yaml", "3", 9.0, theme="light"),
}
STAGE_PICTURE: Final = "studio_stage"


def main(words: list[str]) -> int:
    """Make the pictures that the words ask for."""
    with Browser() as browser:
        if words[:1] == ["--all"]:
            return make_all(browser, Path(words[1]), words[2:] or list(scenes.GROUPS))
        for name in words or [*PICTURES, STAGE_PICTURE]:
            if name == STAGE_PICTURE:
                take_stage(browser)
            else:
                take(browser, PICTURES[name], FOLDER / f"{name}.png")
            print(FOLDER / f"{name}.png")
    return 0


def take(browser: Browser, chosen: Picture, path: Path) -> None:
    """Play the show, go to a page, and take its picture at an instant."""
    with running(ROOT / "sequences" / chosen.file) as own, browser.page(*chosen.size) as page:
        page.go(own.url)
        page.wait("document.querySelector('.joints')")
        if page.run("document.documentElement.dataset.theme") != chosen.theme:
            page.key("t")
        page.key(" ")
        for key in chosen.keys:
            page.key(key)
        at_s = f"Number(document.querySelector('.way input').value) >= {chosen.from_s}"
        page.wait(at_s, seconds=90.0)
        page.idle()
        page.picture(path)
        assert not page.errors, page.errors


def take_stage(browser: Browser) -> None:
    """Take the picture of a stage that plays."""
    with private_state() as folder:
        for scene in scenes.GROUPS["stage"](browser, folder):
            if scene.name == "stage_plays":
                scenes.look(scene.page, "show", "dark", scenes.SIZES["1366"])
                scene.page.picture(FOLDER / f"{STAGE_PICTURE}.png")


def make_all(browser: Browser, folder: Path, groups: list[str]) -> int:
    """Take a picture of each state and dialog, on each page, in both themes and three sizes."""
    folder.mkdir(parents=True, exist_ok=True)
    for group in groups:
        with private_state() as files:
            for scene in scenes.GROUPS[group](browser, files):
                look_round(scene.page, scene.name, folder)
                print(group, scene.name, flush=True)
    return 0


def look_round(page: Page, name: str, folder: Path) -> None:
    """Take all pictures of a scene; leave its page as it was."""
    back = scenes.shown_page(page)
    for theme in scenes.THEMES:
        for size, pixels in scenes.SIZES.items():
            for own in scenes.pages_of(name):
                scenes.look(page, own, theme, pixels)
                page.picture(folder / f"{name}-{own}-{size}-{theme}.png")
    scenes.look(page, back, scenes.THEMES[0], scenes.SIZES["1366"])


@contextmanager
def private_state() -> Iterator[Path]:
    """Give a folder for the files of scenes, and for what programs keep."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["LSS_MOTION_STATE_DIR"] = str(Path(folder) / "state")
        yield Path(folder)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
