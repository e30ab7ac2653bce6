"""What `lss-motion monitor` shows and writes: a table that lives, lines, CSV, beeps."""

from __future__ import annotations

import contextlib
import csv
import sys
from typing import TYPE_CHECKING, Final, Self, TextIO

from lss_motion.units import NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import RenderableType

    from lss_motion.maintenance.alarms import Alarms
    from lss_motion.maintenance.watch import Reading, Watch

FRAME_NS: Final = NS_PER_S // 8
BARS: Final = "▁▂▃▄▅▆▇█"
SPARK_LEAST_DEG: Final = 1.0
"""A horn that moves less than this shows a flat line, not its noise."""
SETTLED_S: Final = 1.0
"""Until everything has been asked once, lines would have holes; nobody waits longer than this."""
CSV_HEAD: Final = (
    "t_s",
    "servo",
    "position_deg",
    "speed_deg_s",
    "current_a",
    "voltage_v",
    "temperature_c",
    "status",
)


class Screen:
    """A table where there is a terminal, lines where there is none; beeps for new alarms."""

    def __init__(self, watch: Watch, alarms: Alarms, *, every_s: float, is_quiet: bool) -> None:
        self._watch = watch
        self._alarms = alarms
        self._is_quiet = is_quiet
        self._is_live = sys.stdout.isatty()
        self._every_ns = FRAME_NS if self._is_live else ns_from_s(every_s)
        self._next_ns = 0
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        if self._is_live:
            from rich.live import Live

            self._live = self._stack.enter_context(Live(auto_refresh=False))
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def update(self, now_ns: int, started_ns: int) -> None:
        """Show what is known, if it is time to."""
        for text in self._alarms.update(self._watch.readings):
            if not self._is_quiet:
                print("\a", end="", file=sys.stderr, flush=True)
            if not self._is_live:
                print(f"{s_from_ns(now_ns - started_ns):7.1f} s  ALARM  {text}", flush=True)
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + self._every_ns
        elapsed_s = s_from_ns(now_ns - started_ns)
        if self._is_live:
            self._live.update(rendered(self._watch, self._alarms, elapsed_s), refresh=True)
        elif elapsed_s >= SETTLED_S or self._watch.has_asked_all:
            print("\n".join(_lines(self._watch.readings, elapsed_s)), flush=True)
        else:
            self._next_ns = now_ns


class Recorder:
    """Writes readings as CSV, one row a servo and round."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._writer = csv.writer(file, lineterminator="\n")
        self._writer.writerow(CSV_HEAD)

    def write(self, readings: Iterable[Reading], started_ns: int) -> None:
        for reading in readings:
            values = (
                reading.position_deg,
                reading.speed_deg_s,
                reading.current_a,
                reading.voltage_v,
                reading.temperature_c,
            )
            self._writer.writerow(
                [
                    f"{s_from_ns(reading.at_ns - started_ns):.3f}",
                    reading.target.name,
                    *("" if value is None else f"{value:g}" for value in values),
                    "" if reading.status is None else reading.status.value,
                ]
            )
        self._file.flush()


def rendered(watch: Watch, alarms: Alarms, elapsed_s: float) -> RenderableType:
    """Return what a terminal shows."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    for title in ("servo", "id"):
        table.add_column(title)
    for title in ("position", "", "speed", "current", "supply", "heat", "status"):
        table.add_column(title, justify="left" if title in ("", "status") else "right")
    wrong = {name for name, _ in alarms.active}
    for reading in watch.readings:
        name = reading.target.name
        table.add_row(
            Text(name, style="red" if name in wrong else ""),
            str(reading.target.servo_id),
            *_cells(reading),
        )
    rates = ", ".join(
        f"{name} {rounds / max(elapsed_s, 0.1):.0f} rounds/s"
        for name, rounds in watch.rounds.items()
    )
    notes = [Text(text, style="red") for text in alarms.active.values()]
    foot = Text(f"{elapsed_s:.0f} s   {rates}   Ctrl-C ends", style="dim")
    return Group(table, *notes, foot)


def sparkline(values: Sequence[float]) -> str:
    """Return values as little bars, from the lowest to the highest of them."""
    if not values:
        return ""
    low, span = min(values), max(values) - min(values)
    if span < SPARK_LEAST_DEG:
        return BARS[0] * len(values)
    return "".join(BARS[round((value - low) / span * (len(BARS) - 1))] for value in values)


def _cells(reading: Reading) -> tuple[str, ...]:
    if reading.is_silent:
        return ("-", "", "-", "-", "-", "-", "silent")
    position = _said(reading.position_deg, "{:z.1f} deg")
    return (
        position if reading.raw is None else f"{reading.raw:.0f} raw",
        sparkline(reading.positions_deg),
        _said(reading.speed_deg_s, "{:z.0f} deg/s"),
        _said(reading.current_a, "{:.2f} A"),
        _said(reading.voltage_v, "{:.1f} V"),
        _said(reading.temperature_c, "{:.0f} °C"),
        "-" if reading.status is None else reading.status.value,
    )


def _lines(readings: Sequence[Reading], elapsed_s: float) -> list[str]:
    width = max(len(reading.target.name) for reading in readings)
    lines = []
    for reading in readings:
        cells = [cell for column, cell in enumerate(_cells(reading)) if column != 1]
        shown = "  ".join(f"{cell:>10}" for cell in cells[:-1])
        lines.append(f"{elapsed_s:7.1f} s  {reading.target.name:{width}}  {shown}  {cells[-1]}")
    return lines


def _said(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
