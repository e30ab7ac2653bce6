"""Robotis `.mtn` text (RoboPlus Motion): pages of up to seven steps, positions of servos by id.

512 of 1024 is 0 deg and 300 deg are the whole range (AX servos, `motor_type` 0). A step's values
are 26 positions, the pause after it and the time it takes, in seconds; times are divided by the
page's speed. Pages link to each other by number; each is a motion of its own here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from lss_motion.interchange.poses import Pose, motion_of_poses
from lss_motion.interchange.reader import read_or_refused, summarised
from lss_motion.interchange.text_lines import TextLines

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion, RefusedMotion

SERVOS_COUNT: Final = 26
"""FACTS.md F5: 26 values, by id from 0."""

POSITIONS_COUNT: Final = 1024
RANGE_DEG: Final = 300.0
"""AX servos: 1024 positions over 300 deg, 512 in the middle (FACTS.md F5)."""

REPEAT_MAX: Final = 255
"""A byte in the binary form."""

SPEED_MAX: Final = 100.0
"""Chosen: real pages are played at 0.5 to 3 times their speed; more is a slip of the key."""


def ax_deg(position: float) -> float:
    """Return the angle of an AX position."""
    return (position - POSITIONS_COUNT / 2) * RANGE_DEG / POSITIONS_COUNT


@dataclass(slots=True)
class _Page:
    number: int
    line: int
    name: str = ""
    links: str = ""
    repeat: int = 1
    speed_ratio: float = 1.0
    steps: list[tuple[int, list[float]]] = field(default_factory=list)
    has_compliance: bool = False

    @property
    def title(self) -> str:
        return self.name or f"page {self.number}"


@dataclass(frozen=True, slots=True)
class RobotisTextReader:
    """Reads `type=motion` … `page_begin` … `step=` … `page_end`; joints are `ID<n>`."""

    name: str = "mtn"

    def recognises(self, data: bytes) -> bool:
        head = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
        return head.startswith(b"type=motion") or (b"page_begin" in head and b"=" in head)

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
        lines = TextLines.of(path, data)
        enabled, pages = _parsed(lines)
        found = [
            read_or_refused(page.title, partial(_motion, lines, page, enabled))
            for page in pages
            if page.steps
        ]
        if not found:
            lines.refuse(None, "has no page with a step")
        return tuple(found)


def _parsed(lines: TextLines) -> tuple[list[int], list[_Page]]:
    """Return the enabled ids and all pages, the empty ones too: they count in the numbering."""
    enabled = list(range(SERVOS_COUNT))
    pages: list[_Page] = []
    page: _Page | None = None
    for number, line in lines.numbered():
        key, _, value = line.partition("=")
        match key.strip():
            case "page_begin" if page is None:
                page = _Page(len(pages) + 1, number)
            case "page_end" if page is not None:
                pages.append(page)
                page = None
            case "page_begin" | "page_end":
                lines.refuse(number, f"{key} stands where no page can {key[5:]}")
            case "enable" if page is None:
                flags = _row(lines, value, number, SERVOS_COUNT)
                enabled = [servo for servo, flag in enumerate(flags) if flag]
            case "motor_type":
                types = _row(lines, value, number, SERVOS_COUNT)
                if odd := [servo for servo in enabled if types[servo]]:
                    lines.refuse(
                        number,
                        f"servo {odd[0]} is of type {types[odd[0]]:g}; only type 0 (AX, 1024 "
                        "positions over 300 deg) is known",
                    )
            case _ if page is not None:
                _read_page(lines, page, key.strip(), value.strip(), number)
            case _:
                pass  # type=, version=: nothing that a motion needs.
    if page is not None:
        lines.refuse(page.line, "this page has no page_end: the file is cut short")
    return enabled, pages


def _read_page(lines: TextLines, page: _Page, key: str, value: str, number: int) -> None:
    match key:
        case "name":
            page.name = value
        case "play_param":
            following, leaving, repeat, speed, _ = _row(lines, value, number, 5)
            if not 0.0 < speed <= SPEED_MAX:
                lines.refuse(number, f"speed {speed:g} must be more than 0, at most {SPEED_MAX:g}")
            if not 0.0 <= repeat <= REPEAT_MAX:
                lines.refuse(number, f"repeat {repeat:g} is not in 0 to {REPEAT_MAX}")
            page.repeat, page.speed_ratio = max(1, int(repeat)), speed
            if following or leaving:
                page.links = f"page {following:g} as next, page {leaving:g} as exit"
        case "compliance":
            page.has_compliance = True
        case "step":
            page.steps.append((number, _row(lines, value, number, SERVOS_COUNT + 2)))
        case _:
            lines.refuse(number, f"{key!r:.40} is no key of a page")


def _row(lines: TextLines, text: str, number: int, count: int) -> list[float]:
    words = text.split()
    if len(words) != count:
        lines.refuse(number, f"{len(words)} values where {count} belong")
    return [lines.number(word, number) for word in words]


def _motion(lines: TextLines, page: _Page, enabled: list[int]) -> ForeignMotion:
    poses: list[Pose] = []
    end_s = 0.0
    for turn in range(page.repeat):
        for index, (number, values) in enumerate(page.steps, start=1):
            pause_s, play_s = values[-2] / page.speed_ratio, values[-1] / page.speed_ratio
            if play_s <= 0.0 or pause_s < 0.0:
                lines.refuse(number, f"step {index} of page {page.number} takes {play_s:g} s")
            for servo in enabled:
                if not 0.0 <= values[servo] < POSITIONS_COUNT:
                    lines.refuse(number, f"position {values[servo]:g} of servo {servo}: 0 to 1023")
            poses.append(
                Pose(
                    at_s=end_s + play_s,
                    values={f"ID{servo}": ax_deg(values[servo]) for servo in enabled},
                    hold_s=pause_s,
                    place=f"page {page.number}, turn {turn + 1}, step {index}",
                    line=number,
                )
            )
            end_s += play_s + pause_s
    found = [f"links to {page.links}"] if page.links else []
    found += ["compliance and inertia"] if page.has_compliance else []
    comments = (
        f"Imported from {lines.path.name} (Robotis motion, page {page.number}); 512 = 0 deg.",
        *summarised(found),
    )
    return motion_of_poses(lines.path, page.title, poses, comments=comments)
