"""Skills of OpenCat robots (Petoi): C arrays of `int8_t` (older: `char`), angles in degrees.

The first number is the count of frames: 1 is a posture, more is a gait, less than 0 a behaviour.
Roll, pitch and a ratio follow, by which all angles are multiplied. A behaviour then has the first
and the last frame of its loop and how often that is played, and each of its frames ends in speed,
delay (in 50 ms), and two numbers of a trigger.

The arrays have no times, since the boards move as fast as they compute. `STEP_S` and `GAIT_FRAME_S`
are assumptions; the comments name them.
"""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import (
    VALUES_MAX,
    Pose,
    Reader,
    motion_of_poses,
    read_or_refused,
    summarised,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion, RefusedMotion

STEP_S: Final = 0.005
"""Assumed time of one step of a transition. A frame takes `largest change / (speed / 4)` steps."""

SPEED_PER_DEG: Final = 4.0
"""Speed at which a step is one degree (FACTS.md F15)."""

GAIT_FRAME_S: Final = 0.02
"""Assumed time of one frame of a gait."""

DELAY_S: Final = 0.05
"""Unit of the delay of a frame (FACTS.md F15)."""

JUMP_S: Final = 0.2
"""Assumed time of a frame with speed 0: the servos go as fast as they can."""

JOINTS_COUNT: Final = 16
"""Joints of a robot, numbered from 0. A gait with fewer moves the last ones."""

HEADER_COUNT: Final = 4
BEHAVIOUR_HEADER_COUNT: Final = 7
TAIL_COUNT: Final = 4
"""Numbers after the angles in a frame of a behaviour."""

LOOPS_MAX: Final = 127
"""Largest `int8_t`."""

_COMMENT: Final = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_START: Final = re.compile(
    rb"int8_t\s+\w{1,60}\s*\["
    rb"|\bchar\s+\w{1,60}\s*\[\s*\d{0,5}\s*\]\s*(?:PROGMEM\s*)?=\s*\{\s*-?\d{1,3}\s*,"
    rb"|^\{\s*-?\d{1,3}\s*,[-+\d,\s]{8,}",
    re.MULTILINE,
)
"""An array with its name, of numbers of type `char` in older files, or a line that begins with bare
numbers, as in the skill library."""
_ARRAY: Final = re.compile(
    r"(?:\b(\w{1,60})\s*\[\s*\d{0,5}\s*\]\s*(?:PROGMEM\s*)?=\s*)?\{([-+\d,\s]*)\}", re.ASCII
)
_CUT: Final = re.compile(
    r"\b(\w{1,60})\s*\[\s*\d{0,5}\s*\]\s*(?:PROGMEM\s*)?=\s*\{[-+\d,\s]*\Z", re.ASCII
)


def _is_opencat(data: bytes) -> bool:
    return _START.search(text_head(data, 65_536)) is not None


def _opencat_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    text = _COMMENT.sub(lambda match: "\n" * match[0].count("\n"), lines.text)
    found: list[ForeignMotion | RefusedMotion] = []
    line, end = 1, 0
    for number, match in enumerate(_ARRAY.finditer(text), start=1):
        line += text.count("\n", end, match.start())
        end = match.start()
        name = match[1] or f"skill {number}"
        read = partial(_motion, lines, line, name, match[2])
        found.append(read_or_refused(name, read))
    if cut := _CUT.search(text, end):
        line += text.count("\n", end, cut.start())
        refuse = partial(lines.refuse, line, "this array has no end: the file was cut off")
        found.append(read_or_refused(cut[1], refuse))
    if not found:
        lines.refuse(None, "has no array of numbers, `const int8_t name[] = {…};`")
    return tuple(found)


OPENCAT: Final = Reader("opencat", _is_opencat, _opencat_motions)
"""Reads `const int8_t name[] PROGMEM = {…};` or bare `{…}`: one motion per array.

The joints are `J<n>`.
"""


class _Skill(Struct, frozen=True):
    """The numbers of one array: frames of angles in degrees, and what else the frames have."""

    frames: list[list[float]]
    tails: list[list[int]]
    joints: list[str]


def _motion(lines: TextLines, line: int, name: str, text: str) -> ForeignMotion:
    words = [word for word in text.split(",") if word.strip()]
    if len(words) > VALUES_MAX:
        lines.refuse(line, f"{name}: more than {VALUES_MAX:,} numbers")
    numbers = [_int8(lines, line, name, word) for word in words]
    if len(numbers) <= HEADER_COUNT or not numbers[0]:
        lines.refuse(line, f"{name}: no skill: it needs a count of frames, roll, pitch and a ratio")
    period, ratio = numbers[0], numbers[3]
    if ratio < 1:
        lines.refuse(line, f"{name}: ratio {ratio} must be 1 or more")
    skill, beyond = _skill(lines, line, name, text, numbers)
    about = [f"Imported from {lines.path.name} (OpenCat skill {name})."]
    if period > 1:
        about.append(
            f"One pass of the gait, back to its first frame; a frame is assumed to take "
            f"{GAIT_FRAME_S:g} s. `loop: forever` repeats it."
        )
        poses = _gait(skill)
    elif period == 1:
        poses = _gait(skill)
    else:
        poses, notes = _behaviour(skill, numbers[HEADER_COUNT:BEHAVIOUR_HEADER_COUNT])
        about += [
            f"A step of one degree at speed {SPEED_PER_DEG:g} is assumed to take {STEP_S:g} s."
        ]
        about += summarised(notes)
    if beyond:
        about += summarised(
            [f"{counted(beyond, 'number')} after the {counted(skill.frames, 'frame')}"]
        )
    about += summarised([f"roll {numbers[1]}, pitch {numbers[2]}"] * any(numbers[1:3]))
    for index, pose in enumerate(poses):
        poses[index] = Pose(at_s=pose.at_s, hold_s=pose.hold_s, values=pose.values, line=line)
    return motion_of_poses(lines.path, name, poses, comments=about)


def _int8(lines: TextLines, line: int, name: str, word: str) -> int:
    number = lines.number(word, line)
    if not number.is_integer() or not -128 <= number <= 127:
        lines.refuse(line, f"{name}: {word.strip()!r:.20} is not a whole number from -128 to 127")
    return int(number)


def _skill(
    lines: TextLines, line: int, name: str, text: str, numbers: list[int]
) -> tuple[_Skill, int]:
    """Return the frames that the header counts, and how many numbers follow them.

    A board reads no further than its header says.
    """
    period, ratio = numbers[0], numbers[3]
    header = HEADER_COUNT if period > 0 else BEHAVIOUR_HEADER_COUNT
    tail_count = 0 if period > 0 else TAIL_COUNT
    size = _frame_size(text, len(numbers), period, header, tail_count)
    count = size - tail_count
    if not 0 < count <= JOINTS_COUNT:
        lines.refuse(
            line,
            f"{name}: {counted(numbers, 'number')} do not make {abs(period)} frames of 1 to "
            f"{JOINTS_COUNT} joints: is the array cut short?",
        )
    end = header + size * abs(period)
    rows = [numbers[at : at + size] for at in range(header, end, size)]
    first = JOINTS_COUNT - count if period > 1 else 0
    skill = _Skill(
        frames=[[float(ratio * angle) for angle in row[:count]] for row in rows],
        tails=[row[count:] for row in rows],
        joints=[f"J{first + index}" for index in range(count)],
    )
    return skill, len(numbers) - end


def _frame_size(text: str, total: int, period: int, header: int, tail_count: int) -> int:
    """Return how many numbers a frame has, or 0.

    An array that is longer than its header says has frames of all joints, or, in a gait, as many
    numbers as each of its lines.
    """
    size, left = divmod(total - header, abs(period))
    fits = not left and tail_count < size <= JOINTS_COUNT + tail_count
    if period > 1:
        widths = [sum(1 for word in row.split(",") if word.strip()) for row in text.split("\n")]
        rows, before = [], 0
        for width in widths:
            if before >= header and width:
                rows.append(width)
            before += width
        is_even = len(set(rows)) == 1 and sum(rows) == total - header
        is_longer = is_even and len(rows) > period and rows[0] <= JOINTS_COUNT
        if is_longer and not (fits and len(rows) % period == 0):
            return rows[0]
    if fits:
        return size
    whole = JOINTS_COUNT + tail_count
    return whole if total - header > whole * abs(period) else 0


def _gait(skill: _Skill) -> list[Pose]:
    frames = [*skill.frames, skill.frames[0]] if len(skill.frames) > 1 else skill.frames
    return [
        Pose(at_s=GAIT_FRAME_S * index, values=dict(zip(skill.joints, frame, strict=True)))
        for index, frame in enumerate(frames)
    ]


def _behaviour(skill: _Skill, loop: Sequence[int]) -> tuple[list[Pose], list[str]]:
    """Return the poses with the loop played as often as the header gives, and what is left out."""
    first, last, times = loop
    order = list(range(len(skill.frames)))
    notes: list[str] = []
    if times < 0:
        notes.append("the endless loop: it is played once")
    elif times > 1 and 0 <= first <= last < len(order) and last:
        order = [*order[: last + 1], *order[first : last + 1] * (times - 1), *order[last + 1 :]]
    poses: list[Pose] = []
    before = skill.frames[0]
    for index in order:
        frame, (speed, delay, axis, angle) = skill.frames[index], skill.tails[index]
        if axis:
            notes.append(f"frame {index + 1}: trigger at axis {axis}, {angle} deg")
        change_deg = max(abs(a - b) for a, b in zip(frame, before, strict=True))
        steps = change_deg / (speed / SPEED_PER_DEG) if speed > 0 else 0.0
        move_s = max(STEP_S, STEP_S * round(steps)) if speed > 0 else JUMP_S
        at_s = poses[-1].at_s + poses[-1].hold_s + move_s if poses else 0.0
        values = dict(zip(skill.joints, frame, strict=True))
        poses.append(Pose(at_s=at_s, hold_s=DELAY_S * abs(delay), values=values))
        before = frame
    return poses, notes
