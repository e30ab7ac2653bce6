"""The live display: a process of its own, so that drawing never delays a command.

`Display` runs in the process of the player. It sends ten frames a second to a process of its own
(`main`), and skips frames while the pipe to that is full.
"""

from __future__ import annotations

import bisect
import math
import sys
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct

from lss_motion.cli.messages import put, shown
from lss_motion.cli.terminal import KEYS_HELP
from lss_motion.files.texts import escaped
from lss_motion.playing.player.events import Phase
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve
from lss_motion.system.real_time import lower_priority
from lss_motion.units import NS_PER_MS, NS_PER_S, NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import RenderableType
    from rich.table import Table
    from rich.text import Text

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.player import Player
    from lss_motion.system.messages import MessagePipe

FRAME_NS: Final = NS_PER_S // 10
ROOM_NS: Final = 3 * NS_PER_MS
"""No frame is written within this time before a move is due; writing takes 1 ms (measured)."""
NOTES_SHOWN: Final = 5
PAUSED: Final = "paused"
TITLES: Final = ("joint", "target", "measured", "error", "correction", "status", "°C")
HIDDEN_FIRST: Final = ("correction", "°C", "target", "measured", "status")
"""Columns that a narrow terminal does not show, in this order; joint and error always stay."""
GAP_CHARS: Final = 2
MARKS_SHOWN: Final = 3
"""Named keyframes ahead that are shown."""
BAR_CHARS: Final = 60
US_PER_MS: Final = 1000
CLOSE_S: Final = 2.0
"""After this time without progress, the display process is killed."""


class DisplayFrame(Struct, frozen=True, tag=True):
    """What the display shows of a run at one instant."""

    phase: str
    name: str
    port: str
    show_s: float | None
    whole_s: float | None
    is_endless: bool
    rate: float
    late_us: int
    missed: int
    buses: dict[str, tuple[float, float]]
    """For each bus the share of its capacity that was sent, and the replies a second."""
    joints: list[list[Any]]
    """For each joint the columns `TITLES`; before the correction, the error that is allowed."""
    marks: list[tuple[float, str]]


class Notes(Struct, frozen=True, tag=True):
    """Lines for a person, shown with the next frame."""

    texts: list[str]


class Display:
    """The end in the player's process: writes frames and never waits.

    Drawing begins when the robot has been checked and may move; until then, lines go to
    `print_line`.
    """

    def __init__(
        self, keys_help: str = KEYS_HELP, *, print_line: Callable[[str], None] = put
    ) -> None:
        self._keys_help = keys_help
        self._print_line = print_line
        self._child: ChildProcess[None] | None = None
        self._next_ns = 0
        self._notes: list[str] = []
        self._history = FrameHistory()

    def note(self, text: str) -> None:
        """Show a line of text with the next frame."""
        if self._child is None:
            self._print_line(text)
        else:
            self._notes.append(text)

    def show(self, player: Player, now_ns: int) -> None:
        """Write a frame, if one is due and the one before has been written."""
        if now_ns < self._next_ns or player.phase in (Phase.CONNECT, Phase.READY):
            return
        if player.is_due_within(ROOM_NS, now_ns) and now_ns < self._next_ns + FRAME_NS:
            return
        if self._child is None:
            self._child = ChildProcess(__name__, self._keys_help)
        self._next_ns = now_ns + FRAME_NS
        self._child.pipe.flush()
        if not self._child.pipe.is_full:
            self._child.send(Notes(self._notes))
            self._child.send(frame_of(player, now_ns, self._history))
            self._notes = []

    def close(self) -> None:
        """Write the notes since the last frame, and clear the screen."""
        if self._child is not None:
            self._child.send(Notes(self._notes))
            self._child.end(CLOSE_S)


class FrameHistory:
    """The values of earlier frames from which a frame is computed."""

    def __init__(self) -> None:
        self._before: dict[str, tuple[int, int, int]] = {}
        self._named: list[tuple[float, str]] | None = None

    def marks_around(self, player: Player, now_ns: int) -> list[tuple[float, str]]:
        """Return the last named keyframe that was passed and the next ones, with their times."""
        if self._named is None:
            marks = player.program.marks
            self._named = [(round(mark.planned_s, 2), mark.label) for mark in marks if mark.label]
        show = player.show
        show_s = 0.0 if show is None else player.program.within(show.show_s(now_ns))
        passed = bisect.bisect_right(self._named, show_s, key=lambda mark: mark[0])
        around = self._named[max(passed - 1, 0) : passed + MARKS_SHOWN]
        if show is None or player.program.is_endless:
            return around
        passes_s = show.show_s(now_ns) - show_s
        return [(round(at_s + passes_s, 2), label) for at_s, label in around]

    def bus_use(self, player: Player, now_ns: int) -> dict[str, tuple[float, float]]:
        """Return for each bus the share of its capacity that was sent, and the replies a second."""
        found: dict[str, tuple[float, float]] = {}
        for name, line in player.lines.items():
            answered = player.trackers[name].reply_count
            then_ns, then_bytes, then_answered = self._before.get(name, (now_ns, 0, 0))
            self._before[name] = (now_ns, line.sent_bytes, answered)
            if now_ns > then_ns:
                busy_ns = line.time_ns(line.sent_bytes - then_bytes)
                elapsed_s = (now_ns - then_ns) / NS_PER_S
                share = busy_ns / NS_PER_S / elapsed_s
                found[name] = (round(share, 3), round((answered - then_answered) / elapsed_s))
        return found


def _shown_s(program: Program, show_s: float) -> float:
    """Return the time that is shown: within its pass, if there is no end to count to."""
    return program.within(show_s) if program.is_endless else show_s


def frame_of(player: Player, now_ns: int, history: FrameHistory) -> DisplayFrame:
    """Return what the display shows of a run at this instant."""
    show, program = player.show, player.program
    latest_ns = show.statistics.latest_ns if show is not None else ()
    whole_s = program.pass_s if program.is_endless else program.duration_s
    is_standing = player.is_paused and player.phase is Phase.SHOW
    return DisplayFrame(
        phase=PAUSED if is_standing else player.phase.value,
        name=program.name,
        port=", ".join(sorted({line.bus.port for line in player.lines.values()})),
        show_s=None if show is None else round(_shown_s(program, show.show_s(now_ns)), 2),
        whole_s=None if math.isinf(whole_s) else round(whole_s, 2),
        is_endless=program.is_endless,
        rate=1.0 if show is None else round(show.clock.rate(now_ns), 2),
        late_us=max(latest_ns, default=0) // NS_PER_US,
        missed=0 if show is None else show.statistics.missed,
        buses=history.bus_use(player, now_ns),
        joints=[_joint(track, now_ns) for track in show.joint_states.values()] if show else [],
        marks=history.marks_around(player, now_ns),
    )


def _joint(track: JointState, now_ns: int) -> list[Any]:
    """Return the row of a joint; target, measured angle and error are those of one reading."""
    joint, measured_deg = track.joint, track.disturbance.measured_deg
    if measured_deg is None:
        target_deg, error_deg = track.place(now_ns)[0], 0.0
    else:
        error_deg = track.disturbance.error_deg
        target_deg = measured_deg + error_deg
    return [
        joint.name,
        round(joint.joint_deg(target_deg), 1),
        None if measured_deg is None else round(joint.joint_deg(measured_deg), 1),
        round(joint.direction * error_deg, 2),
        joint.following_deg,
        round(joint.direction * track.disturbance.offset_deg, 2),
        "" if track.status is None else track.status.value,
        track.temperature_max_c,
    ]


def rendered(frame: DisplayFrame, notes: list[str], keys_help: str, width: int) -> RenderableType:
    """Return a frame for rich. The most important lines are on top, for terminals with few rows.

    A table wider than `width` characters loses columns, the least important ones first.
    """
    from rich.console import Group
    from rich.padding import Padding
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    show_s, whole_s = frame.show_s or 0.0, frame.whole_s
    head = f"{frame.name} on {frame.port}  {frame.phase}"
    head += f"  {max(show_s, 0.0):.1f}" + (f" of {whole_s:.1f} s" if whole_s else " s")
    head += ", repeated" if frame.is_endless else ""
    if frame.phase != PAUSED:
        head += f"  speed {frame.rate:.0%}" + (" (full)" if frame.rate == 1.0 else "")
    total_s = whole_s or max(show_s, 1.0)
    bar = ProgressBar(total=total_s, completed=min(max(show_s, 0.0), total_s), width=BAR_CHARS)
    marks = Text()
    for at_s, label in frame.marks:
        style = "bold green" if at_s <= show_s else ""
        marks.append(f"{escaped(label)} {at_s:.1f} s", style=style).append("   ")
    used = ", ".join(
        f"{bus} {share:.0%} sent, {replies_hz} replies/s"
        for bus, (share, replies_hz) in frame.buses.items()
    )
    timing = f"late {frame.late_us / US_PER_MS:.1f} ms at most"
    latest = [_note_text(note) for note in notes[-NOTES_SHOWN:]]
    return Group(
        shown(head, style="bold"),
        # The bar itself does not end its line.
        Padding(bar, (0, 0, 0, 0)),
        marks,
        shown(f"{used}   {timing}").append(
            f"   {frame.missed} missed", style="bold red" if frame.missed else ""
        ),
        shown(keys_help, style="dim"),
        *latest,
        _table(frame.joints, width),
    )


def is_trouble(note: str) -> bool:
    """Return whether a note stays on the screen after the frame is gone: a warning or a fault."""
    return note.startswith(("warning:", "fault:"))


def _note_text(note: str) -> Text:

    return shown(note, style="bold yellow" if is_trouble(note) else "dim")


def _table(joints: list[list[Any]], width: int) -> Table:
    from rich.table import Table

    rows = []
    for name, target, measured, error, allowed, offset, status, celsius in joints:
        # Red is beyond the limit that ends the show; yellow is beyond half of it.
        style = "red" if abs(error) > allowed else "yellow" if abs(error) > allowed / 2 else ""
        cells = (
            name,
            f"{target:z.1f}",
            "-" if measured is None else f"{measured:z.1f}",
            f"{error:+z.2f}",
            f"{offset:+z.2f}",
            status,
            "-" if celsius is None else f"{celsius:.0f}",
        )
        styles = {"error": style}
        rows.append({t: shown(c, styles.get(t, "")) for t, c in zip(TITLES, cells, strict=True)})
    needed = {title: max(len(title), *(len(row[title]) for row in rows), 0) for title in TITLES}
    for title in HIDDEN_FIRST:
        if sum(needed.values()) + GAP_CHARS * (len(needed) - 1) > width:
            del needed[title]
    table = Table(box=None, pad_edge=False)
    for title in needed:
        side: Literal["left", "right"] = "left" if title in ("joint", "status") else "right"
        table.add_column(title, justify=side, no_wrap=True)
    for row in rows:
        table.add_row(*(row[title] for title in needed))
    return table


def main(pipe: MessagePipe, keys_help: str) -> int:
    """Draw the frames that arrive until the pipe ends."""
    lower_priority()
    from rich.console import Console
    from rich.live import Live

    notes: list[str] = []
    console = Console(file=sys.__stderr__)
    typed: TypedPipe[DisplayFrame | Notes] = TypedPipe(pipe, DisplayFrame | Notes)
    with Live(console=console, auto_refresh=False, transient=True) as live:

        def draw(message: DisplayFrame | Notes) -> None:
            if isinstance(message, DisplayFrame):
                live.update(rendered(message, notes, keys_help, console.width), refresh=True)
                return
            for note in message.texts:
                if is_trouble(note):
                    console.print(_note_text(note))  # Above the frame, to stay.
                else:
                    notes.append(note)

        serve(typed, draw)
    return 0
