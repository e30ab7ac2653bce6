"""What the pages of the studio cost: view, load, frames; and how fast an E-stop is at the servos.

The frames are those of a show of ten minutes, 18 joints and 1,200 keyframes, zoomed and moved over
the whole of it: milliseconds of script, not frames a second, which depend on the screen. Without
WebGL: a machine without a graphics card computes the figure with its processor.

A stop is measured from the press of the pointer, which goes through the browser, to the instant at
which the last servo has received the safe bytes.

All processes share this machine, as they do at a desk. What a show is late with clients that watch:
`benches.studio`.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from cdp import Browser, found_browser
from msgspec.structs import replace
from running_studio import Studio

from benches.behind_pty import robot_behind_pty
from benches.shows import lively_show, robot_of
from benches.studio import robot_text
from benches.table import Row, core_seconds
from lss_motion.planning.shows import Show
from lss_motion.playing import api
from lss_motion.playing.remote.telemetry import plan_hash
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.show.write import write_sequence
from lss_motion.studio.view import view_bytes, view_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cdp import Page


JOINTS: Final = 18
LONG_S: Final = 600.0
KEYS: Final = 1200
FRAMES: Final = 120
ROUNDS: Final = 3
PLAYED_S: Final = 10.0
SAFE: Final = b"#254H\r"
FRAME_MS: Final = 16.0
STOP_MS: Final = 100.0
WATCHED: Final = """(async () => {
  const frames = await import('/static/frames.js');
  Object.assign(frames.work, { frames: 0, total_ms: 0, max_ms: 0 });
  const board = document.querySelector('.board-live');
  const box = board.getBoundingClientRect();
  const wheel = (more) => board.dispatchEvent(new WheelEvent('wheel', {
    bubbles: true, clientX: box.x + box.width * 0.4, clientY: box.y + 200, ...more }));
  for (let n = 0; n < COUNT; n += 1) {
    if (n < COUNT / 3) wheel({ ctrlKey: true, deltaY: -120 });
    else if (n < 2 * COUNT / 3) wheel({ shiftKey: true, deltaY: 160 });
    else wheel({ ctrlKey: true, deltaY: 160 });
    wheel({ deltaY: n % 2 ? 40 : -30 });
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  }
  return frames.work;
})()"""


def measure() -> list[Row]:
    """Return the figures; without a browser, those that need none."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = _view(folder)
        if found_browser() is None:
            rows.append(Row(what="pages", ours="no browser here: tools/browser"))
        else:
            rows += _pages(folder)
    return rows


def _view(folder: Path) -> list[Row]:
    """Write the long show; return size and cost of its view."""
    robot = robot_of(JOINTS)
    (folder / "long_robot.yaml").write_text(robot_text(robot), encoding="utf-8")
    random = np.random.default_rng(1)
    names = list(robot.joints)
    frames = [Keyframe(at_s=0.0, deg=dict.fromkeys(names, 0.0))]
    for number in range(1, KEYS):
        keyed = random.choice(names, 2, replace=False).tolist()
        deg = {name: round(float(random.uniform(-25.0, 25.0)), 1) for name in keyed}
        frames.append(Keyframe(at_s=round(LONG_S / KEYS * number, 3), deg=deg))
    sequence = Sequence(name="long", keyframes=tuple(frames), robot_path=folder / "long_robot.yaml")
    write_sequence(sequence, folder / "long.yaml")
    trajectory = api.plan(sequence, robot)
    program = api.compile(trajectory, robot)
    show = Show(robot=robot, program=program, trajectory=trajectory, sequence=sequence)
    made: list[bytes] = []
    plan = plan_hash(program).hex()
    taken_s = core_seconds(lambda: made.append(view_bytes(view_of(show, plan))))
    return [
        Row(
            what=f"view of {LONG_S / 60:.0f} min, {JOINTS} joints, {KEYS} keyframes",
            ours=f"{taken_s:.2f} s CPU, {len(made[0]) / 1e6:.2f} MB",
        )
    ]


def _pages(folder: Path) -> list[Row]:
    with Browser() as browser, Studio(folder / "long.yaml") as studio:
        with _no_webgl(browser) as page:
            empty_mb = browser.memory_mb
            started_s = time.monotonic()
            page.go(studio.url)
            page.wait("document.querySelector('.head')")
            shell_s = time.monotonic() - started_s
            page.wait("document.querySelector('.joints tbody tr')", seconds=90.0)
            sent = page.run(
                "performance.getEntriesByType('resource').filter((one) =>"
                " one.name.includes('/static/')).reduce((sum, one) => sum + one.encodedBodySize, 0)"
            )
            page.key("2")
            page.wait("document.querySelector('.board-plan')")
            page.idle()
            work = page.run(WATCHED.replace("COUNT", str(FRAMES)))
            mean_ms = work["total_ms"] / work["frames"]
            usage = _usage(browser, studio, page, empty_mb)
        return [
            Row(what="page from a cold start to its shell", ours=f"{shell_s * 1e3:.0f} ms",
                reference=f"{sent / 1e3:.0f} kB of modules"),
            Row(what="script of a frame, mean (zoom and move)", ours=f"{mean_ms:.1f} ms",
                reference=f"{work['frames']} frames", ratio=mean_ms / FRAME_MS,
                target=f"at most {FRAME_MS:g} ms", is_met=mean_ms <= FRAME_MS),
            Row(what="… of the worst frame", ours=f"{work['max_ms']:.1f} ms"),
            *usage,
            *_stops(folder, browser),
        ]  # fmt: skip


@contextlib.contextmanager
def _no_webgl(browser: Browser) -> Iterator[Page]:
    with browser.page() as page:
        source = (
            "const own = HTMLCanvasElement.prototype.getContext;"
            "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {"
            " return kind.startsWith('webgl') ? null : own.call(this, kind, ...rest); };"
        )
        page.call("Page.addScriptToEvaluateOnNewDocument", source=source)
        yield page


def _usage(browser: Browser, studio: Studio, page: Page, empty_mb: float) -> list[Row]:
    """Return what server and browser take of a core while the long show plays, and memory."""
    page.key("1")
    page.key("Enter")
    page.wait("document.querySelector('.word').textContent.trim() === 'playing'", seconds=60.0)
    before = _cpu_s(studio.process.pid), browser.cpu_s
    started_s = time.monotonic()
    browser.pump(PLAYED_S)
    page.run("0")
    while time.monotonic() - started_s < PLAYED_S:
        browser.pump(0.5)
        time.sleep(0.1)
    taken_s = time.monotonic() - started_s
    shares = [
        (after - own) / taken_s
        for after, own in zip((_cpu_s(studio.process.pid), browser.cpu_s), before, strict=True)
    ]
    memory_mb = browser.memory_mb
    page.key("Escape")
    return [
        Row(
            what=f"of a core while {JOINTS} joints play: server",
            ours=f"{shares[0]:.1%}",
            reference=f"{_rss_mb(studio.process.pid):.0f} MB",
        ),
        Row(
            what="… browser, Show page",
            ours=f"{shares[1]:.1%}",
            reference=f"{memory_mb:.0f} MB, {empty_mb:.0f} MB with an empty page",
        ),
    ]


def _stops(folder: Path, browser: Browser) -> list[Row]:
    """Return how long an E-stop takes to the servos."""
    taken_ms = [_stop_ms(folder, browser) for _ in range(ROUNDS)]
    median_ms = statistics.median(taken_ms)
    return [
        Row(
            what="E-STOP, from pointer-down to the servos",
            ours=f"{median_ms:.0f} ms (worst {max(taken_ms):.0f})",
            ratio=median_ms / STOP_MS,
            target=f"at most {STOP_MS:g} ms, idle machine",
            is_met=median_ms <= STOP_MS,
        )
    ]


def _stop_ms(folder: Path, browser: Browser) -> float:
    with (
        _behind_port(folder) as (show, received),
        Studio(show) as studio,
        _no_webgl(browser) as page,
    ):
        page.go(studio.url)
        page.wait("document.querySelector('.joints tbody tr')", seconds=60.0)
        page.key("Enter")
        page.wait("document.querySelector('.go-ready')", seconds=60.0)
        page.key("Enter")
        clock = "document.querySelector('[data-clock]').textContent"
        page.wait(f"/^0:0[1-9]/.test({clock})", seconds=60.0)
        place = page.place("#estop")
        pressed_ns = time.monotonic_ns()
        page.press_pointer(*place)
        page.wait("document.body.dataset.latched === 'true'")
        browser.pump(0.5)
        safe_ns = min(at_ns for at_ns, line in received() if line == SAFE)
        return (safe_ns - pressed_ns) / 1e6


@contextlib.contextmanager
def _behind_port(folder: Path) -> Iterator[tuple[Path, Any]]:
    """Give a lively show of 18 servos behind a port, and what they have received."""
    with robot_behind_pty(robot_of(JOINTS)) as (robot, received):
        (folder / "robot.yaml").write_text(robot_text(robot), encoding="utf-8")
        show = lively_show(robot, PLAYED_S, seed=4)
        write_sequence(replace(show, robot_path=folder / "robot.yaml"), folder / "lively.yaml")
        yield folder / "lively.yaml", received


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
