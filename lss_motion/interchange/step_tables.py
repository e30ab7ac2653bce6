"""Steps with times for servos, in text: Pololu Maestro, SSC-32 sequencer, Webots, PyPose.

Maestro (settings XML): sequences of frames, targets in quarter microseconds. The Maestro sends the
targets of a frame at its start and then waits for its duration; the speed of the channels is not
known. The reader therefore puts the targets at the end of the frame.

Lynxmotion SSC-32 visual sequencer (`PROJECT;SEQUENCE;STEP;PIN0…;T0…`): a step gives each pin an
angle in degrees and a time in ms. The next step begins when the slowest pin has arrived, or after
TMAX if that is later.

Webots (`.motion`): `[[minutes:]seconds:]milliseconds,pose,values`; `*` sets no key. The names of
the joints are in the first line, or in a second line of their own. Version 1.1 has `%` in place of
`,`, no names of poses, and in its first column an instant with colons, or a duration. The unit of
the duration is assumed: milliseconds since the row before.

PyPose projects (`.ppr`): named poses in Dynamixel positions, and sequences of `pose|ms`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, parse_xml, text_head
from lss_motion.interchange.reader import (
    DIGITS,
    Channel,
    ForeignMotion,
    Measure,
    Pose,
    PoseNote,
    Reader,
    motion_name,
    motion_of_poses,
    read_or_refused,
    summarised,
    thinned,
    unit_of_ros_joint,
)
from lss_motion.interchange.robotis import ax_deg
from lss_motion.show.model import TIME_MAX_S
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import RefusedMotion


QUARTERS_PER_US: Final = 4.0
CHANNELS_MAX: Final = 24
"""Channels of the largest Maestro."""

TARGET_MAX: Final = 65_535
DURATION_MAX_MS: Final = 65_535
"""Targets and durations are 16-bit numbers (FACTS.md F4)."""

OFF: Final = 0
"""Target that switches the channel off."""


@dataclass(slots=True)
class _StepFrame:
    line: int
    name: str
    duration_ms: int
    text: str = ""


@dataclass(slots=True)
class _MaestroContent:
    """Channels and sequences of the file, in its order."""

    channels: list[Mapping[str, str]] = field(default_factory=list)
    sequences: list[tuple[str, list[_StepFrame]]] = field(default_factory=list)
    open_frame: _StepFrame | None = None

    def start(self, lines: TextLines, line: int, tag: str, attributes: dict[str, str]) -> None:
        if tag == "Channel":
            self.channels.append(attributes)
        elif tag == "Sequence":
            self.sequences.append((attributes.get("name", ""), []))
        elif tag == "Frame" and self.sequences:
            if "duration" not in attributes:
                lines.refuse(line, "this frame has no duration; give it one in milliseconds")
            duration_ms = lines.whole(attributes["duration"], line, DURATION_MAX_MS)
            self.open_frame = _StepFrame(line, attributes.get("name", ""), duration_ms)
            self.sequences[-1][1].append(self.open_frame)

    def end(self, tag: str) -> None:
        if tag == "Frame":
            self.open_frame = None

    def add_text(self, part: str) -> None:
        if self.open_frame is not None:
            self.open_frame.text += part


def _is_maestro(data: bytes) -> bool:
    return b"<UscSettings" in data[:4096]


def _maestro_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    content = _parsed(lines)
    names = _names(content)
    found = [
        read_or_refused(title, partial(_motion, lines, title, frames, content, names))
        for title, frames in content.sequences
        if frames
    ]
    if not found:
        lines.refuse(None, "has no sequence with a frame (scripts are programs: not read)")
    return tuple(found)


MAESTRO: Final = Reader("maestro", _is_maestro, _maestro_motions)
"""Reads `<UscSettings>`: one motion per sequence. Values are pulses, so a map is needed."""


def _parsed(lines: TextLines) -> _MaestroContent:
    content = _MaestroContent()
    parse_xml(lines, partial(content.start, lines), content.end, content.add_text)
    return content


def _names(content: _MaestroContent) -> list[str]:
    """Return the name of each channel: its own name if that is unique, else `channel<n>`."""
    given = [channel.get("name", "").strip() for channel in content.channels]
    given += [""] * (CHANNELS_MAX - len(given))
    return [
        name if name and given.count(name) == 1 else f"channel{index}"
        for index, name in enumerate(given)
    ]


def _motion(
    lines: TextLines,
    title: str,
    frames: list[_StepFrame],
    content: _MaestroContent,
    names: list[str],
) -> ForeignMotion:
    poses: list[Pose] = []
    left_out: list[str] = []
    end_ms = 0
    for number, frame in enumerate(frames, start=1):
        words = frame.text.split()
        if len(words) > len(names):
            lines.refuse(frame.line, f"{counted(words, 'target')}, a Maestro has {CHANNELS_MAX}")
        targets = [lines.whole(word, frame.line, TARGET_MAX) for word in words]
        left_out += [f"{names[i]} is switched off" for i, t in enumerate(targets) if t == OFF]
        end_ms += frame.duration_ms
        poses.append(
            Pose(
                at_s=s_from_ms(end_ms),
                values={names[i]: t / QUARTERS_PER_US for i, t in enumerate(targets) if t != OFF},
                label=frame.name,
                place=f"frame {number} of {title!r:.40}",
                line=frame.line,
            )
        )
    limited = [
        name
        for name, channel in zip(names, content.channels, strict=False)
        if any(channel.get(key, "0") != "0" for key in ("speed", "acceleration"))
    ]
    left_out += [f"speed and acceleration of {', '.join(limited)}"] * bool(limited)
    comments = (
        f"Imported from {lines.path.name} (Maestro sequence {title!r:.60}).",
        "A frame's targets are reached at the end of its duration.",
        *summarised(left_out),
    )
    return motion_of_poses(
        lines.path, title, poses, unit_of=lambda _: Measure.US, comments=comments
    )


PINS_COUNT: Final = 32
SSC32_DURATION_MAX_MS: Final = 65_535
"""Times are 16-bit numbers on the board."""

_ABOUT: Final = ("PROJECT", "SEQUENCE", "STEP")


def _is_ssc32_table(data: bytes) -> bool:
    head = text_head(data, 4096).lstrip().split(b"\n", 1)[0]
    return b"STEP;" in head and b";PIN" in head


def _ssc32_table_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    head_line, head, rows = lines.with_head()
    columns = {word.strip(): at for at, word in enumerate(head.split(";")) if word.strip()}
    pins = [f"PIN{n}" for n in range(PINS_COUNT) if f"PIN{n}" in columns]
    needed = [*_ABOUT, *pins, *(f"T{pin[3:]}" for pin in pins)]
    missing = [name for name in needed if name not in columns]
    if not pins or missing:
        lines.refuse(head_line, f"column {missing[0] if missing else 'PIN0'} is missing")
    groups: defaultdict[tuple[str, str], list[tuple[int, list[str]]]] = defaultdict(list)
    width = 1 + max(columns[name] for name in needed)
    for number, row in rows:
        cells = [cell.strip() for cell in row.split(";")]
        if len(cells) < width:
            lines.refuse(number, f"{len(cells)} fields, at least {width} are needed")
        groups[cells[columns["PROJECT"]], cells[columns["SEQUENCE"]]].append((number, cells))
    if not groups:
        lines.refuse(head_line, "has no step")
    titles = [f"{project} {sequence}".strip() or motion_name(path) for project, sequence in groups]
    return tuple(
        read_or_refused(title, partial(_ssc32_motion, lines, title, steps, columns, pins))
        for title, steps in zip(titles, groups.values(), strict=True)
    )


SSC32_TABLE: Final = Reader("ssc32-csv", _is_ssc32_table, _ssc32_table_motions)
"""Reads the table: one motion per project and sequence; joints are `PIN<n>`."""


def _ssc32_motion(
    lines: TextLines,
    title: str,
    steps: Sequence[tuple[int, list[str]]],
    columns: Mapping[str, int],
    pins: Sequence[str],
) -> ForeignMotion:
    keys: dict[str, list[tuple[float, float, int]]] = {pin: [] for pin in pins}
    start_s = 0.0
    for number, cells in steps:
        times_s = [
            s_from_ms(lines.whole(cells[columns[f"T{pin[3:]}"]], number, SSC32_DURATION_MAX_MS))
            for pin in pins
        ]
        longest = _cell(cells, columns, "TMAX")
        step_s = s_from_ms(lines.whole(longest, number, SSC32_DURATION_MAX_MS)) if longest else 0.0
        step_s = max([step_s, *times_s])
        for pin, time_s in zip(pins, times_s, strict=True):
            angle_deg = lines.number(cells[columns[pin]], number, has_commas=True)
            if time_s == 0.0:
                lines.refuse(number, f"{pin} takes no time; give T{pin[3:]}")
            keys[pin].append((start_s + time_s, angle_deg, number))
            if time_s < step_s:  # The pin waits for the others.
                keys[pin].append((start_s + step_s, angle_deg, number))
        start_s += step_s
        if start_s > TIME_MAX_S:
            lines.refuse(number, f"ends more than a day ({TIME_MAX_S:g} s) after the start")
    idle = [pin for pin in pins if not any(angle for _, angle, _ in keys[pin])]
    idle = idle if len(idle) < len(pins) else []
    found = [f"{', '.join(idle)}, which stay at 0"] * bool(idle)
    channels: list[Channel] = []
    for pin in pins:
        if pin not in idle:
            times_s, angles_deg, numbers = np.array(keys[pin]).T
            own_times_s, own_deg = thinned(times_s, angles_deg)
            own_lines = numbers[np.searchsorted(np.round(times_s, DIGITS), own_times_s)]
            channels.append(
                Channel(
                    name=pin,
                    unit=Measure.DEG,
                    times_s=own_times_s,
                    values=own_deg,
                    lines=own_lines.astype(np.int32),
                )
            )
    return ForeignMotion(
        path=lines.path,
        name=motion_name(lines.path, title),
        channels=tuple(channels),
        notes=dict[float, PoseNote](),
        comments=(
            f"Imported from {lines.path.name} (SSC-32 visual sequencer, {title!r:.60}).",
            *summarised(found),
        ),
    )


def _cell(cells: Sequence[str], columns: Mapping[str, int], name: str) -> str:
    """Return a cell, or "" if it is missing: rows are often shorter than the header."""
    at = columns.get(name)
    return "" if at is None or at >= len(cells) else cells[at]


HEADER: Final = "#WEBOTS_MOTION"
_TIME: Final = re.compile(r"(?:(?:(\d{1,4}):)?(\d{1,5}):)?(\d{1,8})", re.ASCII)
"""Minutes and seconds may be absent, as in the player of Webots (FACTS.md F16)."""
_VERSION: Final = re.compile(r"V1\.\d{1,2}", re.ASCII | re.IGNORECASE)

VARIANTS: Final = (
    f"variants: `{HEADER},V1.0,joint,...` and rows `mm:ss:mmm,pose,value,...`; the joints in a "
    f"line of their own; `{HEADER},V1.1`, joints and rows divided by `%`, first column "
    "mm:ss:mmm or a duration in ms"
)
"""What is read, for messages."""


def _is_webots(data: bytes) -> bool:
    return text_head(data, 1024).lstrip().startswith(HEADER.encode())


def _webots_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    lines = TextLines.of(path, data)
    table = _table(lines)
    poses: list[Pose] = []
    durations_count = 0
    for number, row in table.rows:
        cells = [cell.strip() for cell in row.split(table.delimiter)]
        is_duration = table.delimiter == "%" and cells[0].isascii() and cells[0].isdigit()
        if is_duration:
            before_s = poses[-1].at_s if poses else 0.0
            at_s = before_s + s_from_ms(lines.whole(cells[0], number, WEBOTS_DURATION_MAX_MS))
        else:
            at_s = _instant_s(lines, number, cells[0])
        durations_count += is_duration
        poses.append(_pose(table, number, cells, at_s))
    if not poses:
        lines.refuse(None, "has no row with values")
    keyed = {name for pose in poses for name in pose.values}
    idle = [f"joint {name}, which has no value" for name in table.names if name not in keyed]
    guess = ["The first column has durations; their unit is assumed to be milliseconds."] * bool(
        durations_count
    )
    comments = (f"Imported from {path.name} (Webots motion).", *guess, *summarised(idle))
    return (motion_of_poses(path, path.stem, poses, unit_of=unit_of_ros_joint, comments=comments),)


WEBOTS: Final = Reader("webots", _is_webots, _webots_motions)
"""Reads `#WEBOTS_MOTION,V1.0,joint,…` and its rows; radians (metres for sliding joints)."""


WEBOTS_DURATION_MAX_MS: Final = 3_600_000
"""Chosen: one hour between two rows."""


class _Table(Struct, frozen=True):
    lines: TextLines
    delimiter: str
    names: list[str]
    rows: list[tuple[int, str]]


def _table(lines: TextLines) -> _Table:
    """Return names and rows; the names are in the first line or in the one after it."""
    line, head, rows = lines.with_head()
    title, *words = (word.strip() for word in re.split("[,%]", head))
    if title != HEADER or not words or not _VERSION.fullmatch(words[0]):
        lines.refuse(line, f"the first line must be `{HEADER},V1.0,joint,...`; {VARIANTS}")
    delimiter = "%" if "%" in head else ","
    names = words[1:]
    if not any(names):
        if not rows:
            lines.refuse(line, f"names no joint; {VARIANTS}")
        (line, head), *rows = rows
        delimiter = "%" if "%" in head else ","
        names = [word.strip() for word in head.rstrip(f"{delimiter} ").split(delimiter)]
        if ":" in names[0] and _TIME.fullmatch(names[0]):
            lines.refuse(line, f"names of joints are expected here; {VARIANTS}")
    if len(set(names)) < len(names) or not all(names):
        lines.refuse(line, "every joint needs a name of its own")
    return _Table(lines, delimiter, names, rows)


def _instant_s(lines: TextLines, number: int, word: str) -> float:
    time = _TIME.fullmatch(word)
    if time is None:
        lines.refuse(
            number,
            f"{word!r:.60} is not a time of the form mm:ss:mmm, ss:mmm or mmm; {VARIANTS}",
        )
    minutes, seconds, milliseconds = (int(part or 0) for part in time.groups())
    return 60.0 * minutes + seconds + s_from_ms(milliseconds)


def _pose(table: _Table, number: int, cells: list[str], at_s: float) -> Pose:
    lines, names = table.lines, table.names
    if cells[-1] == "" and len(cells) > len(names) + 1:
        cells = cells[:-1]  # A row may end in a delimiter.
    # Older files have no pose names, only times and values.
    has_label = len(cells) == len(names) + 2
    values = cells[2 if has_label else 1 :]
    if len(values) != len(names):
        lines.refuse(number, f"{counted(values, 'value')} for {counted(names, 'joint')}")
    return Pose(
        at_s=at_s,
        values={
            name: lines.number(value, number)
            for name, value in zip(names, values, strict=True)
            if value != "*"
        },
        label=cells[1] if has_label else "",
        line=number,
    )


PYPOSE_DURATION_MAX_MS: Final = 65_535
SERVOS_MAX: Final = 253
"""Number of ids of a Dynamixel bus."""

AX_POSITIONS: Final = 1024
MX_POSITIONS: Final = 4096
"""The two resolutions of Dynamixel servos: 300 deg in 1024 and 360 deg in 4096; the middle is 0."""

_POSE: Final = re.compile(r"pose\s*=", re.IGNORECASE)
_HEADER: Final = re.compile(r"[^:=]{0,200}:\s*\d{1,3}\s*(:.*)?", re.ASCII)


def _is_pypose(data: bytes) -> bool:
    head = text_head(data, 65_536)
    rows = [row.strip() for row in head.decode("utf-8", "replace").splitlines() if row.strip()]
    is_headed = bool(rows) and _HEADER.fullmatch(rows[0]) is not None
    return is_headed and any(_POSE.match(row) for row in rows)


def _pypose_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    head_line, head, rows = lines.with_head()
    if _HEADER.fullmatch(head) is None:
        lines.refuse(head_line, "the first line must be `name:number of servos`")
    scales = _scales(lines, head_line, head)
    poses: dict[str, dict[str, float]] = {}
    sequences: list[tuple[int, str, str]] = []
    for number, line in rows:
        kind, _, rest = line.partition("=")
        name, colon, values = rest.partition(":")
        match kind.strip().lower():
            case "pose" if colon:
                poses[name.strip()] = _angles(lines, number, values, scales)
            case "seq" if colon:
                sequences.append((number, name.strip(), values))
            case _:
                lines.refuse(number, "is neither `Pose=name: …` nor `Seq=name: …`")
    if not sequences:
        lines.refuse(None, "has no sequence (`Seq=name: pose|ms, …`)")
    return tuple(
        read_or_refused(name, partial(_pypose_motion, lines, number, name, text, poses))
        for number, name, text in sequences
    )


PYPOSE: Final = Reader("pypose", _is_pypose, _pypose_motions)
"""Reads `name:count[:resolution…]`, `Pose=` and `Seq=` lines; joints are `ID<n>`, from 1."""


def _scales(lines: TextLines, line: int, head: str) -> list[Callable[[float], float]]:
    _, count, *rest = head.split(":")
    servos_count = lines.whole(count, line, SERVOS_MAX)
    words = [word for part in rest for word in part.replace(",", " ").split()]
    sizes = [lines.whole(word, line, MX_POSITIONS) for word in words] or [AX_POSITIONS]
    if len(sizes) == 1:
        sizes *= servos_count
    if len(sizes) != servos_count or not sizes:
        lines.refuse(line, f"{counted(sizes, 'resolution')} for {counted(servos_count, 'servo')}")
    known = {AX_POSITIONS: ax_deg, MX_POSITIONS: lambda position: (position - 2048) * 360.0 / 4096}
    if odd := [size for size in sizes if size not in known]:
        lines.refuse(line, f"resolution {odd[0]} is not {AX_POSITIONS} or {MX_POSITIONS}")
    return [known[size] for size in sizes]


def _angles(
    lines: TextLines, number: int, text: str, scales: list[Callable[[float], float]]
) -> dict[str, float]:
    words = [word for word in text.split(",") if word.strip()]
    if len(words) != len(scales):
        lines.refuse(number, f"{counted(words, 'position')} for {counted(scales, 'servo')}")
    positions = [lines.whole(word, number, MX_POSITIONS) for word in words]
    pairs = enumerate(zip(positions, scales, strict=True), start=1)
    return {f"ID{servo}": scale(position) for servo, (position, scale) in pairs}


def _pypose_motion(
    lines: TextLines, number: int, name: str, text: str, known: dict[str, dict[str, float]]
) -> ForeignMotion:
    poses: list[Pose] = []
    for index, step in enumerate((s for s in text.split(",") if s.strip()), start=1):
        pose, bar, time = (part.strip() for part in step.partition("|"))
        if not bar:
            lines.refuse(number, f"step {index} ({step.strip()!r:.40}) is not `pose|milliseconds`")
        if pose not in known:
            lines.refuse(number, f"step {index} names pose {pose!r:.40}, which does not exist")
        start_s = poses[-1].at_s if poses else 0.0
        at_s = start_s + s_from_ms(lines.whole(time, number, PYPOSE_DURATION_MAX_MS))
        place = f"step {index} of {name!r:.40}"
        poses.append(Pose(at_s=at_s, values=known[pose], label=pose, place=place, line=number))
    comments = [
        f"Imported from {lines.path.name} (PyPose sequence {name!r:.60}).",
        "Positions are read as Dynamixel: 1024 = 300 deg or 4096 = 360 deg, the middle is 0 deg.",
    ]
    return motion_of_poses(lines.path, name, poses, comments=comments)
