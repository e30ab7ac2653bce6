"""Robotis motion files: `.mtn` text (RoboPlus Motion) and binary pages of Robotis humanoids.

Both consist of pages with up to seven steps. A step has positions of servos by id, the time to
reach them, and the pause after it. A page has a speed that divides all times, a repeat count, and
links to other pages by number. Each page is one motion here; its links are not followed.

- Text: a step has 26 positions, then pause and time in seconds. 512 of 1024 is 0 deg, and the range
  is 300 deg (AX servos, `motor_type` 0).
- Binary: a page has 512 bytes whose sum ends in 0xFF. The header of 64 bytes has the name, repeat
  (byte 15), schedule (16), steps (20), speed (22), next (25), exit (26) and checksum (31). Seven
  steps of 64 bytes follow: 31 positions (16 bit, low byte first), pause and time in 7.8125 ms,
  divided by speed / 32. Positions are 4096 per turn (2048 is 0 deg), or as in the text form.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import Pose, Reader, motion_of_poses, read_or_refused, summarised

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion, RefusedMotion


SERVOS_COUNT: Final = 26
"""Servos of the text form, by id from 0 (FACTS.md F5)."""

POSITIONS_COUNT: Final = 1024
RANGE_DEG: Final = 300.0
"""AX servos: 1024 positions over 300 deg, 512 in the middle (FACTS.md F5)."""

REPEAT_MAX: Final = 255
"""Largest repeat count: a byte in the binary form."""

SPEED_MAX: Final = 100.0
"""Chosen: real pages have 0.5 to 3; more is a typing error."""


def ax_deg(position: float) -> float:
    """Return the angle of an AX position."""
    return (position - POSITIONS_COUNT / 2) * RANGE_DEG / POSITIONS_COUNT


class _PageStep(Struct, frozen=True):
    """One step of a page, checked, at the speed of the page."""

    values: Mapping[str, float]
    play_s: float
    pause_s: float
    line: int | None = None


def _page_motion(
    path: Path,
    page: _TextPage | _BinaryPage,
    steps: Sequence[_PageStep],
    scale: str,
    not_carried: Iterable[str],
) -> ForeignMotion:
    """Return the motion of a page: its steps one after the other, `repeat` times."""
    poses: list[Pose] = []
    end_s = 0.0
    for turn in range(page.repeat):
        for index, step in enumerate(steps, start=1):
            pose = Pose(
                at_s=end_s + step.play_s,
                values=step.values,
                hold_s=step.pause_s,
                place=f"page {page.number}, turn {turn + 1}, step {index}",
                line=step.line,
            )
            poses.append(pose)
            end_s = pose.at_s + pose.hold_s
    comments = (
        f"Imported from {path.name} (Robotis motion, page {page.number}); {scale}.",
        *summarised([*not_carried]),
    )
    return motion_of_poses(path, page.title, poses, comments=comments)


# -- the text form -------------------------------------------------------------------------------

PAGE_BEGIN: Final = b"page_begin"
PAGE_END: Final = b"page_end"
MARKS: Final = (PAGE_BEGIN.decode(), PAGE_END.decode())

OUTSIDE_MAX: Final = 10
"""Chosen: more lines without a meaning are counted only."""


@dataclass(slots=True)
class _TextPage:
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


def _is_robotis_text(data: bytes) -> bool:
    head = text_head(data, 4096).lstrip()
    return head.startswith(b"type=motion") or (b"page_begin" in head and b"=" in head)


def _robotis_text_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    data, tail = _without_tail(data)
    lines = TextLines.of(path, data)
    enabled, pages, outside = _parsed(lines)
    outside += tail
    found = [
        read_or_refused(page.title, partial(_text_motion, lines, page, enabled, outside))
        for page in pages
        if page.steps
    ]
    if not found:
        lines.refuse(None, "has no page with a step")
    return tuple(found)


ROBOTIS_TEXT: Final = Reader("mtn", _is_robotis_text, _robotis_text_motions)
"""Reads `type=motion` … `page_begin` … `step=` … `page_end`; joints are `ID<n>`."""


def _without_tail(data: bytes) -> tuple[bytes, list[str]]:
    """Return the text to the end of the last page, and what follows it, for a comment.

    Some editors leave old bytes after the last page, which are not always text.
    """
    end = data.rfind(PAGE_END) + len(PAGE_END)
    tail = data[end:].strip(b"\r\n\t \0\x1a")
    if end < len(PAGE_END) or not tail or PAGE_BEGIN in tail:
        return data, []
    return data[:end], [f"{counted(tail, 'byte')} after the last page"]


def _parsed(lines: TextLines) -> tuple[list[int], list[_TextPage], list[str]]:
    """Return the enabled ids, all pages, and lines outside of them that have no meaning.

    Empty pages count in the numbering.
    """
    enabled = list(range(SERVOS_COUNT))
    outside: list[str] = []
    pages: list[_TextPage] = []
    page: _TextPage | None = None
    for number, line in lines.numbered():
        mark = line.split(maxsplit=1)[0]
        if mark in MARKS and line != mark:
            outside.append(f"line {number}, after {mark}: {line[len(mark) :].strip()!r:.40}")
        match mark:
            case "page_begin" if page is None:
                page = _TextPage(len(pages) + 1, number)
            case "page_end" if page is not None:
                pages.append(page)
                page = None
            case "page_begin" | "page_end":
                lines.refuse(number, f"{mark} is not allowed here")
            case _:
                key, _, value = (word.strip() for word in line.partition("="))
                if page is not None:
                    _read_page(lines, page, key, value, number)
                elif key == "enable":
                    flags = _row(lines, value, number, SERVOS_COUNT)
                    enabled = [servo for servo, flag in enumerate(flags) if flag]
                else:
                    _read_head(lines, key, value, number, enabled, outside)
    if page is not None:
        lines.refuse(page.line, "this page has no page_end: the file is cut short")
    return enabled, pages, outside


def _read_head(
    lines: TextLines, key: str, value: str, number: int, enabled: list[int], outside: list[str]
) -> None:
    """Check a line outside of the pages; one without a meaning is added to `outside`."""
    if key == "motor_type":
        types = _row(lines, value, number, SERVOS_COUNT)
        if odd := [servo for servo in enabled if types[servo]]:
            lines.refuse(
                number,
                f"servo {odd[0]} is of type {types[odd[0]]:g}; only type 0 (AX, 1024 "
                "positions over 300 deg) is known",
            )
    elif key not in {"type", "version"}:
        outside.append(f"line {number}, outside of the pages: {f'{key}={value}'!r:.40}")


def _read_page(lines: TextLines, page: _TextPage, key: str, value: str, number: int) -> None:
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
        is_last = number == max((at for at, _ in lines.numbered()), default=0)
        advice = ": the file was cut off, copy it again" if is_last else ""
        lines.refuse(number, f"{counted(words, 'value')}, but {count} are required{advice}")
    # Windows writes the times with the decimal sign of its language.
    return [lines.number(word, number, has_commas=True) for word in words]


def _text_motion(
    lines: TextLines, page: _TextPage, enabled: list[int], outside: list[str]
) -> ForeignMotion:
    steps: list[_PageStep] = []
    for index, (number, values) in enumerate(page.steps, start=1):
        pause_s, play_s = values[-2] / page.speed_ratio, values[-1] / page.speed_ratio
        if play_s <= 0.0 or pause_s < 0.0:
            lines.refuse(number, f"step {index} of page {page.number} takes {play_s:g} s")
        for servo in enabled:
            if not 0.0 <= values[servo] < POSITIONS_COUNT:
                lines.refuse(number, f"position {values[servo]:g} of servo {servo}: 0 to 1023")
        angles_deg = {f"ID{servo}": ax_deg(values[servo]) for servo in enabled}
        steps.append(_PageStep(angles_deg, play_s, pause_s, number))
    not_carried = [f"links to {page.links}"] if page.links else []
    not_carried += ["compliance and inertia"] if page.has_compliance else []
    not_carried += outside[:OUTSIDE_MAX]
    if len(outside) > OUTSIDE_MAX:
        not_carried.append(
            f"{counted(len(outside) - OUTSIDE_MAX, 'more line')} outside of the pages"
        )
    return _page_motion(lines.path, page, steps, "512 = 0 deg", not_carried)


# -- the binary form -----------------------------------------------------------------------------

PAGE_BYTES: Final = 512
PAGES_MAX: Final = 256
"""Maximum number of pages: the number of a page is a byte."""

STEP_BYTES: Final = 64
STEPS_MAX: Final = 7
BINARY_SERVOS_COUNT: Final = 31
CHECKSUM: Final = 0xFF
TIME_BASED: Final = 10
"""Schedule of pages whose steps have times. Schedule 0 has speeds, so times depend on the pose."""

UNIT_S: Final = 0.0078125
SPEED_NORMAL: Final = 32
"""Speed at which times are not scaled (FACTS.md F13: t = x * 32 / speed * 7.8125 ms)."""

NOT_KEYED: Final = 0x4000
"""Bit of a position that the step does not set."""

TORQUE_OFF: Final = 0x2000
"""Bit of the position of a servo that goes limp in the step."""

BINARY_POSITIONS_COUNT: Final = 4096
ZERO: Final = 2048
"""4096 positions over 360 deg, 2048 is 0 deg. Older files have 1024, as in the text form."""


class _BinaryPage(Struct, frozen=True):
    """One page. Its steps are (positions, pause, time) in units of the file."""

    number: int
    data: bytes

    @property
    def title(self) -> str:
        shown = "".join(chr(byte) if 32 <= byte < 127 else " " for byte in self.data[:14])
        return shown.strip() or f"page {self.number}"

    @property
    def is_whole(self) -> bool:
        """Whether the checksum is right."""
        return sum(self.data) & 0xFF == CHECKSUM

    @property
    def repeat(self) -> int:
        return max(1, self.data[15])

    @property
    def steps(self) -> list[tuple[tuple[int, ...], int, int]]:
        count = min(self.data[20], STEPS_MAX)
        rows = (STEP_BYTES + index * STEP_BYTES for index in range(count))
        return [
            (struct.unpack_from(f"<{BINARY_SERVOS_COUNT}H", self.data, at), self.data[at + 62],
             self.data[at + 63])
            for at in rows
        ]  # fmt: skip


def _is_robotis_pages(data: bytes) -> bool:
    if len(data) < PAGE_BYTES or len(data) > PAGES_MAX * PAGE_BYTES:
        return False
    pages = _pages(data[: len(data) - len(data) % PAGE_BYTES])  # The last one may be cut.
    # Page 0 is often not written. A text file does not have the right sums by chance.
    return b"\0" in data and sum(page.is_whole for page in pages) * 2 > len(pages)


def _robotis_pages_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    if not data or len(data) % PAGE_BYTES or len(data) > PAGES_MAX * PAGE_BYTES:
        raise InputError(
            f"{len(data)} bytes are not 1 to {PAGES_MAX} pages of {PAGE_BYTES}: cut short, or "
            "another format",
            path=path,
        )
    pages = [page for page in _pages(data) if page.is_whole and page.data[20]]
    broken = [page.number for page in _pages(data) if not page.is_whole and any(page.data)]
    if not pages:
        raise InputError("has no page with steps and a right checksum", path=path)
    unused = _unused(pages)
    scale = _Scale(_is_fine(pages, unused), unused, broken)
    return tuple(
        read_or_refused(page.title, partial(_binary_motion, path, page, scale)) for page in pages
    )


ROBOTIS_PAGES: Final = Reader("robotis-bin", _is_robotis_pages, _robotis_pages_motions)
"""Reads up to 256 pages: one motion per page with steps; joints are `ID<n>`."""


class _Scale(Struct, frozen=True):
    """Properties of the whole file: the scale of positions, unused servos, broken pages."""

    is_fine: bool
    """Whether positions are 4096 over 360 deg, not 1024 over 300 deg."""
    unused: Sequence[int]
    broken: Sequence[int]

    def deg(self, position: int) -> float:
        return (
            (position - ZERO) * 360.0 / BINARY_POSITIONS_COUNT if self.is_fine else ax_deg(position)
        )


def _pages(data: bytes) -> list[_BinaryPage]:
    starts = range(0, len(data), PAGE_BYTES)
    return [_BinaryPage(n, data[at : at + PAGE_BYTES]) for n, at in enumerate(starts)]


def _is_position(value: int) -> bool:
    return not value & (NOT_KEYED | TORQUE_OFF) and value < BINARY_POSITIONS_COUNT


def _unused(pages: Sequence[_BinaryPage]) -> list[int]:
    """Return the ids that no step moves: always 0, limp, not set, or not a position."""
    used = {
        servo
        for page in pages
        for positions, _, _ in page.steps
        for servo, value in enumerate(positions)
        if _is_position(value) and value
    }
    return [servo for servo in range(BINARY_SERVOS_COUNT) if servo not in used]


def _is_fine(pages: Sequence[_BinaryPage], unused: Sequence[int]) -> bool:
    return any(
        _is_position(value) and value >= 1024 and servo not in unused
        for page in pages
        for positions, _, _ in page.steps
        for servo, value in enumerate(positions)
    )


def _binary_motion(path: Path, page: _BinaryPage, scale: _Scale) -> ForeignMotion:
    header = page.data
    if header[20] > STEPS_MAX:
        raise _error(path, page, f"{counted(header[20], 'step')}, at most {STEPS_MAX} have room")
    if header[16] != TIME_BASED:
        raise _error(
            path, page, f"schedule {header[16]} gives speeds, not times; only {TIME_BASED} is read"
        )
    if not header[22]:
        raise _error(path, page, "speed 0, so the page would not move")
    unit_s = UNIT_S * SPEED_NORMAL / header[22]
    steps: list[_PageStep] = []
    left_out: list[str] = []
    for index, (positions, pause, time) in enumerate(page.steps, start=1):
        if not time:
            raise InputError(f"page {page.number}, step {index}: takes no time", path=path)
        values, odd = _values(positions, scale)
        left_out += odd
        steps.append(_PageStep(values, play_s=time * unit_s, pause_s=pause * unit_s))
    links = [f"page {n} as {what}" for n, what in ((header[25], "next"), (header[26], "exit")) if n]
    not_carried: list[str] = []
    if scale.unused:
        not_carried.append(f"ids {', '.join(map(str, scale.unused))}, which no step moves")
    if scale.broken:
        not_carried.append(f"pages {', '.join(map(str, scale.broken))}: wrong checksum")
    if links:
        not_carried.append(f"links to {', '.join(links)}")
    return _page_motion(
        path,
        page,
        steps,
        "4096 positions a turn" if scale.is_fine else "1024 positions over 300 deg",
        [*not_carried, *left_out, "gains and acceleration time"],
    )


def _values(positions: Sequence[int], scale: _Scale) -> tuple[dict[str, float], list[str]]:
    """Return the angles by joint, and a text for each value that is not an angle."""
    values: dict[str, float] = {}
    odd: list[str] = []
    for servo, value in enumerate(positions):
        if servo in scale.unused or value & NOT_KEYED:
            continue
        if value & TORQUE_OFF:
            odd.append(f"ID{servo} goes limp")
        elif not _is_position(value):
            odd.append(f"ID{servo} at {value}, which is not a position")
        else:
            values[f"ID{servo}"] = scale.deg(value)
    return values, odd


def _error(path: Path, page: _BinaryPage, reason: str) -> InputError:
    return InputError(f"page {page.number} ({page.title!r}): {reason}", path=path)
