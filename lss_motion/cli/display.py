"""The live display: a process of its own, so that drawing can never delay a command.

The player's process writes one JSON object a line to its standard input, ten a second, and drops
what a full pipe does not take. Run as `python -m lss_motion.cli.display`.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.controls import KEYS_HELP
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from rich.console import RenderableType

    from lss_motion.player.player import Player

FRAME_NS: Final = NS_PER_S // 10
PIPE_BYTES: Final = 1 << 16
NOTES_SHOWN: Final = 5
ERROR_LOOK_DEG: Final = 2.0
"""Following errors above this are shown in red."""


class Display:
    """The player's end: hands over what is to be shown, never waits."""

    def __init__(self, keys_help: str = KEYS_HELP) -> None:
        self._child = subprocess.Popen(  # noqa: S603  (our own words)
            [sys.executable, "-m", "lss_motion.cli.display", keys_help], stdin=subprocess.PIPE
        )
        assert self._child.stdin is not None
        self._pipe_fd = self._child.stdin.fileno()
        os.set_blocking(self._pipe_fd, False)
        self._rest = b""
        self._next_ns = 0
        self._notes: list[str] = []

    def note(self, text: str) -> None:
        """Show a line of text with the next frame."""
        self._notes.append(text)

    def show(self, player: Player, now_ns: int) -> None:
        """Hand over a frame, if it is time for one and the last has been taken."""
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + FRAME_NS
        if not self._rest:
            frame = frame_of(player, now_ns, self._notes)
            self._notes = []
            self._rest = json.dumps(frame, separators=(",", ":")).encode() + b"\n"
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            self._rest = self._rest[os.write(self._pipe_fd, self._rest) :]

    def close(self) -> None:
        assert self._child.stdin is not None
        with contextlib.suppress(OSError):
            self._child.stdin.close()
        try:
            self._child.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


def frame_of(player: Player, now_ns: int, notes: list[str]) -> dict[str, Any]:
    """Return what there is to see of a run at this instant, as plain values."""
    show = player.show
    duration_s = player.program.duration_s
    joints = []
    late_us = 0
    if show is not None:
        late_us = (show.statistics.late_ns[-1] if show.statistics.late_ns else 0) // 1000
        for name, track in show.tracks.items():
            measured = track.following.measured_deg
            joints.append(
                [
                    name,
                    round(track.joint.joint_deg(track.place(now_ns)[0]), 1),
                    None if measured is None else round(track.joint.joint_deg(measured), 1),
                    round(track.following.error_deg, 2),
                    round(track.following.offset_deg, 2),
                    "" if track.status is None else track.status.value,
                    track.temperature_max_c,
                ]
            )
    return {
        "phase": player.phase.value,
        "name": player.program.name,
        "port": ", ".join(sorted({line.bus.port for line in player.lines.values()})),
        "show_s": None if show is None else round(show.show_s(now_ns), 2),
        "duration_s": None if duration_s == float("inf") else round(duration_s, 2),
        "rate": 1.0 if show is None else round(show.clock.rate(now_ns), 2),
        "late_us": late_us,
        "load": {
            name: round(use.utilisation_ratio, 3) for name, use in player.program.line_use.items()
        },
        "joints": joints,
        "notes": notes,
    }


def rendered(frame: dict[str, Any], notes: list[str], keys_help: str) -> RenderableType:
    """Return a frame as rich draws it."""
    from rich.console import Group
    from rich.padding import Padding
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    show_s, duration_s = frame["show_s"], frame["duration_s"]
    head = f"{frame['name']} on {frame['port']}  {frame['phase']}"
    if show_s is not None:
        head += f"  {max(show_s, 0.0):.1f}" + (f" of {duration_s:.1f} s" if duration_s else " s")
        head += f"  speed {frame['rate']:.0%}"
    lines = ", ".join(f"{bus} {load:.0%}" for bus, load in frame["load"].items())
    foot = f"commands on the line: {lines}   late {frame['late_us']} us   {keys_help}"
    table = Table(box=None, pad_edge=False)
    for title in ("joint", "target", "measured", "error", "correction", "status", "°C"):
        table.add_column(title, justify="left" if title in ("joint", "status") else "right")
    for name, target, measured, error, offset, status, celsius in frame["joints"]:
        table.add_row(
            name,
            f"{target:.1f}",
            "-" if measured is None else f"{measured:.1f}",
            Text(f"{error:+.2f}", style="red" if abs(error) > ERROR_LOOK_DEG else ""),
            f"{offset:+.2f}",
            status,
            "-" if celsius is None else f"{celsius:.0f}",
        )
    total = duration_s or max(show_s or 0.0, 1.0)
    bar = ProgressBar(total=total, completed=min(max(show_s or 0.0, 0.0), total), width=60)
    # A bar ends no line by itself.
    framed = Padding(bar, (0, 0, 0, 0))
    shown = [Text(note, style="yellow") for note in notes[-NOTES_SHOWN:]]
    return Group(Text(head, style="bold"), framed, table, *shown, Text(foot, style="dim"))


def main() -> int:
    """Draw what comes in until there is no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from rich.console import Console
    from rich.live import Live

    notes: list[str] = []
    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for line in sys.stdin:
            frame = json.loads(line)
            notes += frame["notes"]
            live.update(rendered(frame, notes, sys.argv[1]), refresh=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
