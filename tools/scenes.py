"""Every state of the studio's pages and every dialog, brought about with the real thing.

`GROUPS` names functions that start a studio or a stage, with a ghost of three simulated servos
behind a port, and go with it through some states of `states.js`. Each yields a `Scene`: the page is
in that state, and stays there while the caller looks at it in other sizes, in the other theme and
on the other pages. The caller closes no dialog and sends no stop. `tools/pictures.py` makes
pictures of them, `tests/browser/test_scenes.py` measures them.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from running_studio import Studio
from served_bus import ServedBus

from lss_motion.protocol.constants import Family
from lss_motion.robot.model import ServoModel
from lss_motion.sim.bus import SimBus
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics, ServoSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cdp import Browser, Page

ROOT: Final = Path(__file__).resolve().parent.parent
EXAMPLES: Final = ROOT / "sequences"
PAGES: Final = ("show", "timeline", "robot")
SIZES: Final = {"1366": (1366, 768), "1920": (1920, 1080), "820": (820, 1180)}
THEMES: Final = ("dark", "light")
PLAYER: Final = "lss_motion.playing.remote.process"
PLANNER: Final = "lss_motion.studio.planner"
FAULT_AT_S: Final = 12.0
"""The servo goes deaf so long after it was switched on: when the show plays."""

SHOW: Final = """\
sequence: {name}
robot: robots/ghost.yaml
keyframes:
  - {{at_s: 0, pose: home, label: hangs}}
  - {{at_s: 1.2, deg: {{arm: 60, jaw: 30}}, label: menace, hold_s: 1}}
  - {{at_s: 4, deg: {{head: 40}}, label: looks at you}}
  - {{at_s: {to_s}, deg: {{head: -40, arm: 20}}, label: looks away}}
  - {{at_s: {end_s}, pose: home, label: asleep}}
"""
STAGE: Final = """\
stage: haunted_hall
robot: robots/ghost.yaml
shows: {{breathe: breathe.yaml, scare: scare.yaml}}
idle: breathe
cues:
  - {{cue: visitor, on: {{key: v}}, play: scare, start: terminate}}
  - {{cue: strikes, on: {{time: "0 * * * *"}}, play: scare, start: queue}}
  - {{cue: opening, on: {{go: true}}, play: scare, start: terminate}}
  - {{cue: enough, on: {{key: r}}, do: rest}}
duty: {{quiet: [{quiet}]}}
on_fault: {{wait_s: 1, total: 1}}
log: {{ring_s: 0}}
"""


RICH: Final = """\
sequence: rich
robot: robots/ghost.yaml
keep: {arm: time}
keyframes:
  - {at_s: 0, deg: {head: 0, arm: 0}, label: hangs}
  - {at_s: 0.5, deg: {head: 70, arm: 60}, label: menace}
  - {at_s: 4, deg: {head: 40, arm: 0}, label: looks at you, hold_s: 0.5}
  - {at_s: 12, deg: {head: 0, arm: 10}, label: asleep}
tracks:
  mouth:
    loop: 5
    keyframes:
      - {at_s: 0, deg: {jaw: 5}}
      - {at_s: 1, deg: {jaw: 20}, ease: linear}
      - {at_s: 2, deg: {jaw: 5}}
layers: [{file: nod.yaml, mode: add, from_s: 5, fade_s: 0.5}]
events:
  - {at_s: 1, say: boo}
  - {at_s: 2.5, led: {head: red}}
"""
NOD: Final = """\
sequence: nod
robot: robots/ghost.yaml
loop: 3
keyframes:
  - {at_s: 0, deg: {head: 0}}
  - {at_s: 0.8, deg: {head: 8}}
  - {at_s: 1.6, deg: {head: 0}}
"""


class Scene(NamedTuple):
    """A page in a state of `states.js`; `dialog`: the title of what is open over it."""

    name: str
    page: Page
    state: str
    dialog: str | None = None


class Ghost:
    """The files of a ghost in a folder, and its servos behind a port that can be pulled."""

    def __init__(self, folder: Path, fault: Fault | None = None, on_fault: str = "{}") -> None:
        self.folder, self._fault = folder, fault
        self._served: ServedBus | None = None
        robots = folder / "robots"
        shutil.copytree(EXAMPLES / "robots", robots, dirs_exist_ok=True)
        text = (robots / "ghost.yaml").read_text(encoding="utf-8")
        a, b = text.index("sensors:"), text.index("poses:")
        text = text[:a] + text[b:]
        text = text.replace('port: "sim://"', f"port: {folder / 'port'}, firmware: 370")
        (robots / "ghost.yaml").write_text(
            f"{text}on_fault: {on_fault}\npatience_s: 300\n", "utf-8"
        )
        for name, to_s, end_s in (("breathe", 110, 600), ("scare", 110, 600), ("short", 5, 6)):
            shown = SHOW.format(name=name, to_s=to_s, end_s=end_s)
            (folder / f"{name}.yaml").write_text(shown, "utf-8")

    def plug(self) -> None:
        """Let the servos answer at the port."""
        models = [("LSS-ST1", 360.0), ("LSS-ST1", 360.0), ("LSS-HT1", 360.0)]
        servos = [
            ServoSpec(
                servo_id=number,
                model=ServoModel(
                    name=name, family=Family.LSS, speed_max_deg_s=speed, wire_per_deg=10
                ),
            )
            for number, (name, speed) in enumerate(models, 1)
        ]
        faults = [] if self._fault is None else [self._fault]
        bus = SimBus(servos, baud_bps=115200, firmware=370, physics=Physics(), faults=faults)
        self._served = ServedBus(bus, self.folder / "port")

    def unplug(self) -> None:
        """Pull the port."""
        if self._served is not None:
            self._served.unplug()
            self._served = None


class Opened:
    """A studio with its page: what a person does there, and when a state is reached."""

    def __init__(self, studio: Studio, page: Page) -> None:
        self.studio, self.page = studio, page

    def is_in(self, name: str, seconds: float = 60.0) -> Scene:
        """Wait for a state; return its scene."""
        self.page.wait(f"document.querySelector('.state')?.dataset.state === '{name}'", seconds)
        return Scene(name, self.page, name)

    def asks(self, name: str, title: str, state: str) -> Scene:
        """Wait for a dialog; return its scene."""
        self.page.wait(f"document.querySelector('dialog h2')?.textContent === {json.dumps(title)}")
        return Scene(name, self.page, state, title)

    def click(self, text: str) -> None:
        """Click the button with this text or label, when it may be clicked."""
        self.page.wait(
            "((one) => one !== undefined && (one.click(), true))([...document.querySelectorAll("
            "'button')].find((one) => !one.disabled && (one.getAttribute('aria-label') ?? "
            f"one.textContent).trim() === {json.dumps(text)}))"
        )

    def go(self) -> None:
        """Press GO as a person does, and not twice at once."""
        self.page.run("new Promise((done) => setTimeout(done, 700))")
        self.page.click("[data-go]")


@contextmanager
def opened(
    browser: Browser, file: Path, *options: str, command: str = "studio"
) -> Iterator[Opened]:
    """Run a studio for a file, with its page open and its plan shown."""
    with Studio(file, *options, command=command) as studio, browser.page(1366, 768) as page:
        page.go(studio.url)
        page.wait("document.querySelector('.state')")
        yield Opened(studio, page)


def look(page: Page, own: str, theme: str, size: tuple[int, int]) -> None:
    """Show a page in a theme and a size, also below a dialog."""
    page.resize(*size)
    page.run(
        f"[...document.querySelectorAll('[role=tab]')][{PAGES.index(own)}]?.click();"
        f"document.querySelector('[aria-label=\"{theme.title()} theme\"]')?.click()"
    )
    page.idle()
    page.wait("!document.body.innerText.includes('Loading…')")
    page.wait(
        "(['.figure-stage canvas', '.quiet', '.page > p', '.boot', '.stand:empty']"
        ".some((one) => document.querySelector(one) !== null))"
    )
    page.idle()


def shown_page(page: Page) -> str:
    """Return which of `PAGES` is open."""
    tabs = "[...document.querySelectorAll('[role=tab]')]"
    return PAGES[page.run(f"{tabs}.findIndex((one) => one.ariaSelected === 'true')")]


def pages_of(name: str) -> tuple[str, ...]:
    """Return the pages on which a scene is seen: the theatre is the Show page."""
    return {"theatre": PAGES[:1], "menu": PAGES[1:2], "contents": PAGES[1:2]}.get(name, PAGES)


# ---------------------------------------------------------------------- the groups


def of_a_show(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Go from at rest through preparing, GO, playing, paused and both stops to connected."""
    ghost = Ghost(folder)
    with ExitStack() as stack:
        ghost.plug()
        stack.callback(ghost.unplug)
        own = stack.enter_context(opened(browser, folder / "scare.yaml"))
        own.page.wait("document.querySelector('.joints')")
        yield own.is_in("at_rest")
        own.go()
        player = _part(own, PLAYER)
        os.kill(player, signal.SIGSTOP)
        yield own.is_in("preparing")
        os.kill(player, signal.SIGCONT)
        yield own.is_in("waits")
        own.go()
        yield own.is_in("playing")
        own.page.wait("document.querySelector('[data-now]')?.textContent === 'looks at you'")
        own.page.key(" ")
        yield own.is_in("paused")
        own.page.key(" ")
        own.is_in("playing")
        os.kill(player := _part(own, PLAYER), signal.SIGSTOP)
        own.page.key("Escape")
        yield own.is_in("stopping")
        os.kill(player, signal.SIGCONT)
        yield own.is_in("stopped")
        yield from _rearmed(own, "stopped")
        own.page.key("Enter")
        own.is_in("waits")
        own.page.key("Shift+Escape")
        yield own.is_in("emergency")
        yield from _rearmed(own, "emergency")
        own.page.key("3")
        own.click("Connect")
        yield own.is_in("connected")


def _rearmed(own: Opened, state: str) -> Iterator[Scene]:
    own.click("Arm again…")
    yield own.asks(f"arm_again_{state}", "Arm again?", state)
    own.click("Arm")
    own.page.wait("document.querySelector('.rearm') === null")
    own.page.run("[...document.querySelectorAll('[role=tab]')][0].click()")


def _part(own: Opened, module: str, other_than: int | None = None) -> int:
    """Return the process of the studio that runs a module, once there is such, or another one."""
    for _ in range(3000):
        found = own.studio.parts().get(module)
        if found is not None and found != other_than:
            return found
        own.page.run("new Promise((done) => setTimeout(done, 10))")
    raise AssertionError(f"no process {module}")


def of_faults(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Recovering from a pulled cable, ended, ended by a fault of a joint, player gone."""
    with ExitStack() as stack:
        ghost = Ghost(folder)
        ghost.plug()
        stack.callback(ghost.unplug)
        own = stack.enter_context(opened(browser, folder / "scare.yaml"))
        _plays(own)
        ghost.unplug()
        scene, player = own.is_in("recovering"), _part(own, PLAYER)
        os.kill(player, signal.SIGSTOP)  # It would give up after a while.
        yield scene
        os.kill(player, signal.SIGKILL)
        yield own.is_in("player_gone")
    with ExitStack() as stack:
        own = stack.enter_context(opened(browser, EXAMPLES / "owl.yaml"))
        own.page.wait("document.querySelector('.joints')")
        own.page.key("Enter")
        yield own.is_in("ended", 120.0)
    with ExitStack() as stack:
        deaf = Fault(kind=FaultKind.DEAF, servo_id=3, at_s=FAULT_AT_S)
        ghost = Ghost(folder, deaf, "{silent: [hold], astray: [hold]}")
        own = stack.enter_context(opened(browser, folder / "scare.yaml"))
        own.page.wait("document.querySelector('.joints')")
        ghost.plug()
        stack.callback(ghost.unplug)
        _plays(own)
        yield own.is_in("fault", 90.0)


def _plays(own: Opened) -> None:
    own.page.wait("document.querySelector('.joints')")
    own.go()
    own.is_in("waits")
    own.go()
    own.is_in("playing")


def of_gone(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Go through planner frozen, planner gone and server gone."""
    Ghost(folder)
    show = folder / "scare.yaml"
    with ExitStack() as stack:
        own = stack.enter_context(opened(browser, show))
        own.page.wait("document.querySelector('.joints')")
        planner = _part(own, PLANNER)
        os.kill(planner, signal.SIGSTOP)
        show.write_text(show.read_text("utf-8") + "# changed\n", "utf-8")
        own.page.wait("document.querySelector('.chips').textContent.includes('has not answered')")
        yield own.is_in("at_rest")._replace(name="planner_frozen")
        os.kill(planner, signal.SIGKILL)
        os.kill(_part(own, PLANNER, planner), signal.SIGKILL)
        yield own.is_in("planner_gone")
        os.kill(own.studio.process.pid, signal.SIGKILL)
        yield own.is_in("no_link")


def of_a_stage(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Go through a stage that waits for its cable, plays, rests in quiet hours, and gives up."""
    ghost = Ghost(folder)
    hall = folder / "hall.yaml"
    hall.write_text(STAGE.format(quiet=""), "utf-8")
    options = ("--wait-port",)
    with ExitStack() as stack:
        stack.callback(ghost.unplug)
        own = stack.enter_context(opened(browser, hall, *options, command="serve"))
        own.page.wait("document.querySelector('.fire')")
        yield own.is_in("waits")._replace(name="stage_waits")
        ghost.plug()
        own.is_in("playing", 90.0)
        own.page.click("[data-stage-cue=visitor] .fire")
        own.page.wait("document.querySelector('[data-stage-cue=visitor]').className === 'present'")
        yield own.is_in("playing")._replace(name="stage_plays")
        own.click("Rest")
        own.is_in("rests")
        hall.write_text(STAGE.format(quiet='"00:00-12:00", "12:00-00:00"'), "utf-8")
        own.page.wait("document.querySelector('.state-detail').textContent.includes('quiet hours')")
        own.click("Wake")
        yield own.is_in("rests")._replace(name="quiet_hours")
    (again := folder / "again").mkdir()
    deaf = Fault(kind=FaultKind.DEAF, servo_id=3, at_s=FAULT_AT_S)
    ghost = Ghost(again, deaf, "{silent: [hold], astray: [hold]}")
    hall = again / "hall.yaml"
    hall.write_text(STAGE.format(quiet="").replace("total: 1", "total: 0"), "utf-8")
    with ExitStack() as stack:
        own = stack.enter_context(opened(browser, hall, "--wait-port", command="serve"))
        own.is_in("waits")
        ghost.plug()
        stack.callback(ghost.unplug)
        own.is_in("playing", 90.0)
        yield own.is_in("fault", 90.0)._replace(name="stage_given_up")


def of_dialogs(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Every question and message, at rest and on a robot that is connected."""
    ghost = Ghost(folder)
    with ExitStack() as stack:
        ghost.plug()
        stack.callback(ghost.unplug)
        listening = ("--listen", "127.0.0.2")
        own = stack.enter_context(opened(browser, folder / "scare.yaml", *listening))
        page = own.page
        page.wait("document.querySelector('.joints')")
        page.key("v")
        yield own.is_in("at_rest")._replace(name="theatre")
        page.key("v")
        page.key("?")
        yield own.asks("help", "Keys", "at_rest")
        page.key("Escape")
        own.click("Pair a tablet")
        yield own.asks("pairing", "Pair another device", "at_rest")
        page.key("Escape")
        yield from _of_keys(own)
        with opened_again(browser, own.studio) as other:
            other.page.wait(
                "document.querySelector('.operator')?.textContent.includes(' operates')"
            )
            other.page.key("Enter")
            other.page.wait("document.querySelector('dialog h2')")
            title = other.page.run("document.querySelector('dialog h2').textContent")
            yield other.asks("take_over", title, "at_rest")
        page.key("Alt+3")
        own.click("Connect")
        own.is_in("connected")
        own.click("Limp all …")
        yield own.asks("limp_all", "Limp all?", "connected")
        page.key("Escape")
        own.click("Save over home …")
        yield own.asks("save_over", "Save over home?", "connected")


def _of_keys(own: Opened) -> Iterator[Scene]:
    """Go through the text of a file, a hint, several keys and one."""
    page = own.page
    page.key("2")
    page.wait("document.querySelector('.board-plan')")
    page.key("]")
    page.click(".about .file-line")
    page.wait("document.querySelector('.file-text [aria-current]')")
    yield own.asks("file", "scare.yaml", "at_rest")
    page.run(
        "[...document.querySelectorAll('dialog button')]"
        ".find((one) => one.textContent === 'Change the text').click()"
    )
    page.wait("document.querySelector('textarea.file-text')")
    yield own.asks("file_text", "scare.yaml", "at_rest")
    page.key("Escape")
    page.key("Escape")
    page.key("Delete")
    page.wait("document.querySelector('.banner-note')")
    yield own.is_in("at_rest")._replace(name="hint")
    page.key("Escape")
    page.key("a")
    page.wait("document.querySelector('.about h2')?.textContent === '5 keys'")
    yield own.is_in("at_rest")._replace(name="keys")
    page.key("Alt+a")
    page.key("[")
    page.wait("document.querySelector('.about h2')?.textContent.startsWith('Key')")
    yield own.is_in("at_rest")._replace(name="key")
    page.key("Escape")


def of_contents(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Go through a show with all that one has: what it consists of, a menu, what it is asked."""
    Ghost(folder)
    (folder / "nod.yaml").write_text(NOD, "utf-8")
    (show := folder / "rich.yaml").write_text(RICH, "utf-8")
    with opened(browser, show) as own:
        page = own.page
        page.wait("document.querySelector('.joints')")
        yield own.is_in("at_rest")._replace(name="rich")
        page.key("2")
        page.wait("document.querySelector('.board-plan')")
        page.idle()
        x, y = page.place(".board-plan")
        for kind in ("mousePressed", "mouseReleased"):
            page.pointer(kind, x, y, button="right")
        page.wait("document.querySelector('.menu')")
        yield own.is_in("at_rest")._replace(name="menu")
        page.key("Escape")
        own.click("Contents")
        page.wait("document.querySelector('.part')")
        page.run("document.querySelector('.about-part').scrollTo(0, 1e6)")
        yield own.is_in("at_rest")._replace(name="contents")
        own.click("Remove track mouth")
        yield own.asks("remove_track", "Remove track mouth?", "at_rest")
        page.key("Escape")
        own.click("Remove event 2")
        page.wait("document.querySelectorAll('.part .items li').length < 4")
        show.write_text(RICH + "# of another hand\n", "utf-8")
        page.wait("document.querySelector('.banner .difference')")
        yield own.is_in("at_rest")._replace(name="conflict")
    with opened(browser, EXAMPLES / "playlist.yaml") as own:
        page = own.page
        page.wait("document.querySelector('.joints')")
        page.key("2")
        own.click("Contents")
        page.wait("document.querySelector('.part')")
        page.run("document.querySelector('.about-part').scrollTo(0, 1e6)")
        yield own.is_in("at_rest")._replace(name="play_list")


def of_files(browser: Browser, folder: Path) -> Iterator[Scene]:
    """Open a robot file and a stage file, and try to pair a tablet where none can come."""
    Ghost(folder)
    with opened(browser, folder / "robots" / "owl.yaml") as own:
        own.page.wait("document.querySelector('.robot-page')")
        yield own.is_in("at_rest")._replace(name="robot_file")
        own.click("Pair a tablet")
        own.page.wait("document.querySelector('.banner-warn')")
        yield own.is_in("at_rest")._replace(name="pair_refused")
    (folder / "hall.yaml").write_text(STAGE.format(quiet=""), "utf-8")
    with opened(browser, folder / "hall.yaml") as own:
        own.page.wait("document.querySelector('.cues .muted')?.textContent.includes('serve')")
        yield own.is_in("at_rest")._replace(name="stage_file")


@contextmanager
def opened_again(browser: Browser, studio: Studio) -> Iterator[Opened]:
    """Open the pages of a studio once more."""
    with browser.page(1366, 768) as page:
        page.go(studio.url)
        page.wait("document.querySelector('.joints')")
        yield Opened(studio, page)


GROUPS: Final[dict[str, Callable[[Browser, Path], Iterator[Scene]]]] = {
    "show": of_a_show,
    "faults": of_faults,
    "gone": of_gone,
    "stage": of_a_stage,
    "dialogs": of_dialogs,
    "contents": of_contents,
    "files": of_files,
}

if __name__ == "__main__":
    sys.exit("tools/pictures.py makes the pictures")
