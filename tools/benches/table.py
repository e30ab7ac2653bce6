"""One measured figure next to what it is compared with, and how they are shown."""

from __future__ import annotations

import statistics
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """`ratio` is what the target speaks of; without a target nothing is judged."""

    what: str
    ours: str
    reference: str = ""
    ratio: float | None = None
    target: str = ""
    is_met: bool | None = None

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def shown(rows: Sequence[Row]) -> str:
    """Return the rows as an aligned table."""
    head = ("what", "ours", "reference", "ratio", "target", "")
    verdicts = {True: "pass", False: "SHORT", None: ""}
    cells = [head] + [
        (
            row.what,
            row.ours,
            row.reference,
            "" if row.ratio is None else f"{row.ratio:.4g}",
            row.target,
            verdicts[row.is_met],
        )
        for row in rows
    ]
    widths = [max(len(line[column]) for line in cells) for column in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    )


def core_seconds(do: Callable[[], object]) -> float:
    """Return how long one call keeps a core busy, whatever else the machine does."""
    started = time.process_time()
    do()
    return time.process_time() - started


def interleaved(*calls: Callable[[], object], repeats: int) -> list[float]:
    """Return the median processor time of each call; they take turns, so that noise hits all."""
    taken: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for call, times in zip(calls, taken, strict=True):
            times.append(core_seconds(call))
    return [statistics.median(times) for times in taken]
