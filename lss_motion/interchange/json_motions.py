"""Motions in JSON: keyframes of humanoids, recordings of Poppy, frames of Blender, Bottango.

Bit-Bots: goals in degrees, durations and pauses in seconds. A keyframe is reached `duration` after
the end of the pause before it (the first one: after the start), and is held for `pause`. The file
does not contain the pose before the first keyframe.

HULKs: groups of joints in radians, durations in seconds, from `initial_positions` on. Older files
have `frames` in place of `motion`, and conditions among them. Jumps have stiffnesses:
`{"positions", "stiffnesses"}` in place of the groups of joints, at the start and in each keyframe.

Reachy Mini: a recorded move, of which the turn of the head (roll, pitch, yaw about its base), the
body and the antennas are angles. Where the head is moved to is left out.

pypot (Poppy): degrees at measured times, in any order.

The Blender add-on for servo animation: one position per frame and servo. Version 2 has a list of
`{"<servo id>": position}`, version 1 a list of positions per servo. A servo that is missing in a
frame keeps its position. The unit depends on the set-up of the animator (often microseconds, or
ticks of a PWM board), so a map must define it. Files that this package wrote contain it in `unit`.

Bottango (`AnimationCommands.json`): Bezier curves in time, signals between two pulse widths. A
curve `sC,id,start,duration,y0,x0,c0,y1,x1,c1` runs from y0 to y1. 0 is the least and 8192 the
largest signal. The control points (x in ms, c in signal) are relative to the ends of the
curve. Between curves an effector keeps its signal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import NUMBER_MAX, JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import (
    DIGITS,
    FPS_MAX,
    VALUES_MAX,
    Channel,
    Measure,
    Pose,
    Reader,
    motion_label,
    motion_of_poses,
    recording,
    summarised,
    thinned,
)
from lss_motion.show.model import TIME_MAX_S
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray, ForeignMotion


_ABOUT: Final = ("author", "description", "last_edited", "version")
"""Keys that are copied into comments, for people only."""

_KEYFRAME_KEYS: Final = frozenset({"duration", "pause", "goals", "name"})


def _is_bitbots(data: bytes) -> bool:
    return starts_json(data, b"{") and b'"keyframes"' in data and b'"goals"' in data


def _bitbots_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    top = fields.mapping(parsed_json(path, data), "the file")
    entries = [
        fields.mapping(entry, f"keyframes[{index}]")
        for index, entry in enumerate(fields.items(top, "keyframes", "the file"))
    ]
    poses: list[Pose] = []
    for index, entry in enumerate(entries):
        end_s = poses[-1].at_s + poses[-1].hold_s if poses else 0.0
        poses.append(_pose(fields, entry, index, end_s))
    motion = motion_of_poses(
        path,
        motion_label(top.get("name")),
        poses,
        comments=(
            f"Imported from {path.name} (Bit-Bots keyframes).",
            *(f"{key}: {top[key]}" for key in _ABOUT if top.get(key)),
            *_not_carried(top, entries),
        ),
    )
    return (motion,)


BITBOTS: Final = Reader("bitbots", _is_bitbots, _bitbots_motions)
"""Reads `{"name", "keyframes": [{"duration", "pause", "goals": {joint: deg}, "name"}]}`."""


def _pose(fields: JsonFields, entry: dict[str, object], index: int, end_s: float) -> Pose:
    where = f"keyframes[{index}]"
    duration_s = fields.duration(entry, "duration", where)
    if duration_s == 0.0 and index > 0:
        fields.refuse(f"{where}.duration is 0, but must be more than 0 s")
    goals = fields.mapping(entry.get("goals"), f"{where}.goals")
    if not goals:
        fields.refuse(f"{where}.goals names no joint")
    return Pose(
        at_s=end_s + duration_s,
        values={joint: fields.number(goals, joint, f"{where}.goals") for joint in goals},
        hold_s=fields.duration(entry, "pause", where),
        label=motion_label(entry.get("name")),
        place=where,
    )


def _not_carried(top: dict[str, object], entries: list[dict[str, object]]) -> tuple[str, ...]:
    """Return a comment for every key that has a value and is not imported."""
    known = {"name", "keyframes", *_ABOUT}
    found = [key for key, value in top.items() if key not in known and value]
    for entry in entries:
        found += [
            f"keyframes: {k}" for k, value in entry.items() if k not in _KEYFRAME_KEYS and value
        ]
    return summarised(found)


MATRIX_ERROR: Final = 0.05
"""Chosen: how far the matrix of a head may be from a rotation."""

START: Final = "initial_positions"
STIFFNESSES: Final = "stiffnesses"
"""Also found among the groups of joints, in `jump_left.json` of the team."""


def _is_hulks(data: bytes) -> bool:
    if not starts_json(data, b"{") or b'"initial_positions"' not in data:
        return False
    return (b'"motion"' in data and b'"keyframes"' in data) or b'"frames"' in data


def _hulks_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    top = fields.mapping(parsed_json(path, data), "the file")
    values, left = _values(fields, top.get(START), START)
    poses = [Pose(at_s=0.0, values=values, place=START)]
    found = [f"{START}: {name}" for name in left]
    known = {START, "motion", "frames", "interpolation_mode"}
    found += [key for key in top if key not in known and top[key]]
    found += _mode(top)
    for where, part, key in _parts(fields, top):
        if part is not top:
            known = {"keyframes", "interpolation_mode"}
            found += [f"motion: {name}" for name in part if name not in known and part[name]]
            found += _mode(part)
        for index, listed in enumerate(fields.items(part, key, where or "the file")):
            place = f"{where}.{key}[{index}]".lstrip(".")
            keyframe = fields.mapping(listed, place)
            if keyframe and all(name.endswith("Condition") for name in keyframe):
                found += keyframe
                continue
            at_s = poses[-1].at_s + fields.duration(keyframe, "duration", place)
            values, left = _values(fields, keyframe.get("positions"), f"{place}.positions")
            poses.append(Pose(at_s=at_s, values=values, place=place))
            known = {"duration", "positions", "interpolation_mode"}
            left += [name for name in keyframe if name not in known]
            found += [f"keyframes: {name}" for name in left]
            found += _mode(keyframe)
    comments = (f"Imported from {path.name} (HULKs motion).", *summarised(found))
    return (motion_of_poses(path, path.stem, poses, unit_of=_unit, comments=comments),)


HULKS: Final = Reader("hulks", _is_hulks, _hulks_motions)
"""Reads `{"initial_positions", "motion": [{"keyframes": [{"duration", "positions"}]}]}`.

Positions may be `{"positions", "stiffnesses"}`, at the start and in each keyframe.

The name of a joint is `group.joint`, such as `left_arm.elbow_roll`.
"""


def _parts(fields: JsonFields, top: dict[str, object]) -> list[tuple[str, dict[str, object], str]]:
    """Return place, content and key of each list of keyframes."""
    if "motion" not in top:
        return [("", top, "frames")]
    entries = enumerate(fields.items(top, "motion", "the file"))
    places = [(f"motion[{number}]", entry) for number, entry in entries]
    return [(where, fields.mapping(entry, where), "keyframes") for where, entry in places]


def _mode(part: dict[str, object]) -> list[str]:
    mode = part.get("interpolation_mode")
    return [f"interpolation_mode {mode!s:.40}; the keys are joined smoothly"] if mode else []


def _values(fields: JsonFields, listed: object, where: str) -> tuple[dict[str, float], list[str]]:
    """Return the values by joint, and the names of what is no position."""
    groups = fields.mapping(listed, where)
    left_out: list[str] = []
    if "positions" in groups:
        left_out = [name for name in groups if name != "positions" and groups[name]]
        where = f"{where}.positions"
        groups = fields.mapping(groups["positions"], where)
    if STIFFNESSES in groups:
        left_out.append(STIFFNESSES)
    values = {
        f"{group}.{joint}": fields.plain_number(value, f"{where}.{group}.{joint}")
        for group, joints in groups.items()
        if group != STIFFNESSES
        for joint, value in fields.mapping(joints, f"{where}.{group}").items()
    }
    return values, left_out


def _unit(name: str) -> Measure:
    # A hand opens by a share from 0 to 1; all other joints rotate.
    return Measure.RAW if name.endswith(".hand") else Measure.RAD


def _is_reachy(data: bytes) -> bool:
    return starts_json(data, b"{") and b'"set_target_data"' in data and b'"time"' in data


def _reachy_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    top = fields.mapping(parsed_json(path, data), "the file")
    times = fields.items(top, "time", "the file")
    frames = fields.items(top, "set_target_data", "the file")
    if len(times) != len(frames):
        fields.refuse(f"has {counted(frames, 'frame')} for {counted(times, 'time')}")
    poses = []
    for index, (at, item) in enumerate(zip(times, frames, strict=True)):
        where = f"set_target_data[{index}]"
        frame = fields.mapping(item, where)
        poses.append(
            Pose(
                at_s=fields.plain_number(at, f"time[{index}]"),
                values=_reachy_values(fields, frame, where),
                place=where,
            )
        )
    known = {"time", "set_target_data", "description"}
    comments = (
        f"Imported from {path.name} (Reachy Mini move).",
        *([f"description: {top['description']!s:.200}"] if top.get("description") else []),
        *summarised(["the place of the head", *(key for key in top if key not in known)]),
    )
    return (motion_of_poses(path, "", poses, comments=comments),)


REACHY: Final = Reader("reachy", _is_reachy, _reachy_motions)
"""Reads `{"time": […], "set_target_data": [{"head": 4x4, "antennas": [2], "body_yaw"}]}`."""


def _reachy_values(fields: JsonFields, frame: dict[str, object], where: str) -> dict[str, float]:
    """Return angles in degrees: of the head about x, y, z of its base, of body and antennas."""
    values: dict[str, float] = {}
    if frame.get("head") is not None:
        rows = np.array(_flat(fields, frame["head"], f"{where}.head"))
        if rows.size != 16:
            fields.refuse(f"{where}.head must be a matrix of 4 x 4")
        turn = rows.reshape(4, 4)[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=MATRIX_ERROR):
            fields.refuse(f"{where}.head is no rotation")
        values["head_roll"] = math.degrees(math.atan2(turn[2, 1], turn[2, 2]))
        values["head_pitch"] = math.degrees(math.asin(min(max(-turn[2, 0], -1.0), 1.0)))
        values["head_yaw"] = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
    if frame.get("body_yaw") is not None:
        values["body_yaw"] = math.degrees(fields.number(frame, "body_yaw", where))
    if frame.get("antennas") is not None:
        for number, angle in enumerate(_flat(fields, frame["antennas"], f"{where}.antennas"), 1):
            values[f"antenna_{number}"] = math.degrees(angle)
    return values


def _flat(fields: JsonFields, listed: object, where: str) -> list[float]:
    """Return the numbers of a list, or of a list of lists."""
    if not isinstance(listed, list) or len(listed) > 16:
        fields.refuse(f"{where} must be a list of numbers")
    rows = [row if isinstance(row, list) else [row] for row in listed]
    return [fields.plain_number(value, where) for row in rows for value in row[:16]]


def _is_pypot(data: bytes) -> bool:
    keys = (b'"framerate"', b'"positions"')
    return starts_json(data, b"{") and all(key in data for key in keys)


def _pypot_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    top = fields.mapping(parsed_json(path, data), "the file")
    listed = fields.mapping(top.get("positions"), "positions")
    poses = sorted(
        (_pypot_pose(fields, key, positions) for key, positions in listed.items()),
        key=lambda pose: pose.at_s,
    )
    found = [key for key in top if key not in {"framerate", "positions"} and top[key]]
    comments = (
        f"Imported from {path.name} (pypot move): {counted(poses, 'sample')} at measured times.",
        *summarised(["recorded speeds", *found]),
    )
    return (motion_of_poses(path, path.stem, poses, comments=comments),)


PYPOT: Final = Reader("pypot", _is_pypot, _pypot_motions)
"""Reads `{"framerate", "positions": {"<seconds>": {motor: [deg, deg/s]}}}`."""


def _pypot_pose(fields: JsonFields, key: str, positions: object) -> Pose:
    where = f"positions.{key:.40}"
    try:
        at_s = float(key)
    except ValueError:
        fields.refuse(f"{where}: the name must be a time in seconds")
    return Pose(
        at_s=fields.plain_number(at_s, where),
        values={
            motor: fields.plain_number(
                value[0] if isinstance(value, list) and value else value, f"{where}.{motor}"
            )
            for motor, value in fields.mapping(positions, where).items()
        },
        place=where,
    )


TENTHS: Final = "0.1 deg"
"""Value of `unit` in exported files, an addition of this package: joint angles in 0.1 deg."""

_BLENDER_ABOUT: Final = ("description", "file", "scene", "armature")
_KNOWN: Final = frozenset(
    {*_BLENDER_ABOUT, "fps", "frames", "seconds", "bones", "positions", "servos", "unit", "names"}
)


def _is_blender(data: bytes) -> bool:
    is_object = starts_json(data, b"{") and b'"positions"' in data
    return is_object and b'"fps"' in data


def _blender_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    top = fields.mapping(parsed_json(path, data), "the file")
    fps = fields.number(top, "fps", "the file")
    if not 0.0 < fps <= FPS_MAX:
        fields.refuse(f"fps is {fps:g}, but must be more than 0 and at most {FPS_MAX:g}")
    columns = _by_servo(fields, top) if "servos" in top else _by_frame(fields, top)
    is_exported = top.get("unit") == TENTHS
    channels = [
        Channel(
            name=name,
            unit=Measure.DEG if is_exported else Measure.RAW,
            times_s=np.round(frames / fps, DIGITS),
            values=values / 10.0 if is_exported else values,
        )
        for name, (frames, values) in columns.items()
    ]
    comments = (
        f"Imported from {path.name} (Blender servo animation, {fps:g} frames a second).",
        *(f"{key}: {top[key]}" for key in _BLENDER_ABOUT if isinstance(top.get(key), str)),
        *summarised([key for key in top if key not in _KNOWN and top[key]]),
    )
    return (recording(path, path.stem, channels, comments=comments),)


BLENDER: Final = Reader("blender", _is_blender, _blender_motions)
"""Reads `{"fps", "positions": [{id: position}]}` and `{"fps", "servos": {id: {...}}}`."""


_Columns = dict[str, "tuple[FloatArray, FloatArray]"]


def _by_servo(fields: JsonFields, top: dict[str, object]) -> _Columns:
    columns: _Columns = {}
    for servo, entry in fields.mapping(top["servos"], "servos").items():
        where = f"servos.{servo:.40}"
        listed = fields.items(fields.mapping(entry, where), "positions", where)
        values = [fields.plain_number(v, f"{where}.positions[{i}]") for i, v in enumerate(listed)]
        columns[servo] = (np.arange(len(values), dtype=np.float64), np.array(values))
    if not columns:
        fields.refuse("servos names no servo")
    return columns


def _by_frame(fields: JsonFields, top: dict[str, object]) -> _Columns:
    """Return frames and positions of each servo; missing positions repeat the one before."""
    frames = [
        fields.mapping(entry, f"positions[{index}]")
        for index, entry in enumerate(fields.items(top, "positions", "the file"))
    ]
    names = fields.mapping(top.get("names", {}), "names")
    servos = dict.fromkeys(servo for frame in frames for servo in frame)
    if not servos:
        fields.refuse("positions names no servo in any frame")
    if len(servos) * len(frames) > VALUES_MAX:
        fields.refuse(f"{len(servos)} servos in {len(frames)} frames: more than {VALUES_MAX:,}")
    columns: _Columns = {}
    for servo in servos:
        first = next(index for index, frame in enumerate(frames) if servo in frame)
        values: list[float] = []
        for index, frame in enumerate(frames[first:], start=first):
            given = servo in frame
            values.append(
                fields.number(frame, servo, f"positions[{index}]") if given else values[-1]
            )
        name = names.get(servo)
        frame_numbers = np.arange(first, len(frames), dtype=np.float64)
        columns[name if isinstance(name, str) else servo] = (frame_numbers, np.array(values))
    return columns


FULL_SIGNAL: Final = 8192.0
"""Largest y of a curve; the least is 0 (FACTS.md F2)."""

SAMPLE_MS: Final = 10.0
"""Curves are sampled at 100 Hz; the reduction to keys follows later."""

CURVE_SAMPLES_MAX: Final = 500
"""Enough for a cubic: straight lines between 500 samples differ from it by 1e-5 of its height."""

OVERLAP_MAX_S: Final = 0.0015
"""Allowed overlap of two curves, because starts and durations are rounded to a millisecond."""

BISECTIONS: Final = 40
"""Halvings of the curve parameter; for a curve of an hour the rest is about 3 ns."""

_SIGNALS: Final = {
    "rSVPin": (2, Measure.US),
    "rSVI2C": (3, Measure.US),
    "rMTR": (2, Measure.RAW),
}
"""Command that registers an effector → position of the least signal in it, and the unit."""


@dataclass(slots=True)
class _Controller:
    """The effectors of one controller: least signal, largest signal and unit by id."""

    prefix: str
    signals: dict[str, tuple[float, float, Measure]] = field(default_factory=dict)


def _is_bottango(data: bytes) -> bool:
    return starts_json(data, b"[") and b'"Animation Commands"' in data


def _bottango_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    content = parsed_json(path, data)
    if not isinstance(content, list) or not content:
        fields.refuse("the file must be a list of controllers")
    animations = _Animations(fields)
    for index, entry in enumerate(content):
        where = f"[{index}]"
        controller = fields.mapping(entry, where)
        title = str(controller.get("Controller Name") or index)
        animations.add(controller, where, f"{title}/" if len(content) > 1 else "")
    return animations.motions()


BOTTANGO: Final = Reader("bottango", _is_bottango, _bottango_motions)
"""Reads a list of controllers; each animation, over all controllers, is one motion.

The name of a joint is the id of its effector, with the prefix `controller/` if the file has
several controllers.
"""


@dataclass(slots=True)
class _Animations:
    """Collects the curves of the file by animation and joint."""

    fields: JsonFields
    curves: dict[str, dict[str, list[FloatArray]]] = field(default_factory=dict)
    units: dict[str, Measure] = field(default_factory=dict)
    left_out: dict[str, list[str]] = field(default_factory=dict)
    values_count: int = 0

    def add(self, entry: dict[str, object], where: str, prefix: str) -> None:
        """Add the animations of one controller."""
        controller = _Controller(prefix)
        setup = self.fields.mapping(entry.get("Setup", {}), f"{where}.Setup")
        for line in str(setup.get("Controller Setup Commands", "")).splitlines():
            self._register(controller, line.strip(), f"{where}.Setup")
        for number, listed in enumerate(self.fields.items(entry, "Animations", where)):
            place = f"{where}.Animations[{number}]"
            animation = self.fields.mapping(listed, place)
            name = str(animation.get("Animation Name") or f"animation {number + 1}")
            self.curves.setdefault(name, {})
            self.left_out.setdefault(name, [])
            text = self.fields.text(animation, "Animation Commands", place)
            for row, line in enumerate(text.splitlines(), start=1):
                self._commands(controller, name, line, f"{place} command {row}")
            if str(animation.get("Animation Loop Commands", "")).strip():
                self.left_out[name].append("the return to the start (Animation Loop Commands)")

    def _register(self, controller: _Controller, line: str, where: str) -> None:
        kind, *words = line.split(",")
        if kind not in _SIGNALS:
            return
        at, unit = _SIGNALS[kind]
        if len(words) < at + 1:
            self.fields.refuse(f"{where}: {line!r:.60} is cut short")
        # The id of a servo behind I2C is its address followed by its channel (FACTS.md F2).
        effector = "".join(words[: at - 1])
        low, high = (self._number(word, where) for word in words[at - 1 : at + 1])
        controller.signals[effector] = (low, high, unit)

    def _commands(self, controller: _Controller, name: str, line: str, where: str) -> None:
        text = line.strip()
        is_group = text.startswith("sSY,")  # Only the first curve of a group begins with sC.
        for command in text.removeprefix("sSY,").split(";"):
            words = command.split(",")
            if words[0] == "sC":
                self._curve(controller, name, words[1:], where)
            elif is_group and words[0] in controller.signals:
                self._curve(controller, name, words, where)
            elif command:
                self.left_out[name].append(f"commands {words[0]:.20}")

    def _curve(self, controller: _Controller, name: str, words: list[str], where: str) -> None:
        if len(words) != 9:
            self.fields.refuse(f"{where}: a curve has an id and 8 numbers, not {len(words) - 1}")
        effector = words[0]
        if effector not in controller.signals:
            self.fields.refuse(f"{where}: effector {effector!r:.40} is not set up")
        low, high, unit = controller.signals[effector]
        numbers = [self._number(word, where) for word in words[1:]]
        start_ms, duration_ms = numbers[:2]
        if start_ms < 0.0 or duration_ms < 0.0 or s_from_ms(start_ms + duration_ms) > TIME_MAX_S:
            self.fields.refuse(f"{where}: must lie between 0 s and a day ({TIME_MAX_S:g} s)")
        self.values_count += min(int(duration_ms / SAMPLE_MS), CURVE_SAMPLES_MAX) + 3
        if self.values_count > VALUES_MAX:
            self.fields.refuse(f"{where}: comes to more than {VALUES_MAX:,} samples")
        samples = _sampled(*numbers)
        samples[1] = low + (high - low) * samples[1] / FULL_SIGNAL
        joint = controller.prefix + effector
        self.units[joint] = unit
        self.curves[name].setdefault(joint, []).append(samples)

    def _number(self, word: str, where: str) -> float:
        try:
            number = float(word)
        except ValueError:
            self.fields.refuse(f"{where}: {word!r:.40} is not a number")
        if not abs(number) < NUMBER_MAX:
            self.fields.refuse(f"{where}: {word!r:.40} is out of range")
        return number

    def motions(self) -> tuple[ForeignMotion, ...]:
        path = self.fields.path
        found: list[ForeignMotion] = []
        for name, joints in self.curves.items():
            if not joints:
                continue
            comments = (
                f"Imported from {path.name} (Bottango animation {name!r:.60}).",
                *summarised(self.left_out[name]),
            )
            channels = [self._channel(name, joint, curves) for joint, curves in joints.items()]
            found.append(recording(path, name, channels, comments=comments))
        if not found:
            self.fields.refuse("no animation has a curve (sC) of a servo or motor")
        return tuple(found)

    def _channel(self, name: str, joint: str, curves: list[FloatArray]) -> Channel:
        curves = sorted(curves, key=lambda samples: float(samples[0, 0]))
        rows = [curves[0]]
        for before, after in pairwise(curves):
            gap_s = after[0, 0] - before[0, -1]
            if gap_s < -OVERLAP_MAX_S:
                self.fields.refuse(
                    f"animation {name!r:.60}: two curves of {joint!r:.40} overlap "
                    f"at {after[0, 0]:g} s"
                )
            if gap_s > s_from_ms(SAMPLE_MS):
                rows.append(np.array([[after[0, 0] - s_from_ms(SAMPLE_MS)], [before[1, -1]]]))
            rows.append(after)
        times_s, values = thinned(*np.concatenate(rows, axis=1))
        return Channel(name=joint, unit=self.units[joint], times_s=times_s, values=values)


def _sampled(
    start_ms: float,
    duration_ms: float,
    start_y: float,
    start_x_ms: float,
    start_dy: float,
    end_y: float,
    end_x_ms: float,
    end_dy: float,
) -> FloatArray:
    """Return times (s) and heights of a cubic Bezier curve at even times, with both ends."""
    steps = min(int(duration_ms / SAMPLE_MS), CURVE_SAMPLES_MAX)
    times_ms = np.linspace(0.0, duration_ms, steps + 2)
    # A control point outside the time of the curve would make its time run backwards.
    first_ms, second_ms = np.clip([start_x_ms, duration_ms + end_x_ms], 0.0, duration_ms)
    low, high = np.zeros_like(times_ms), np.ones_like(times_ms)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        is_early = _bezier(middle, 0.0, first_ms, second_ms, duration_ms) < times_ms
        low, high = np.where(is_early, middle, low), np.where(is_early, high, middle)
    heights = _bezier(0.5 * (low + high), start_y, start_y + start_dy, end_y + end_dy, end_y)
    heights[[0, -1]] = start_y, end_y
    return np.stack([(start_ms + times_ms) / 1000.0, heights])


def _bezier(u: FloatArray, a: float, b: float, c: float, d: float) -> FloatArray:
    v = 1.0 - u
    return a * v**3 + 3.0 * b * v**2 * u + 3.0 * c * v * u**2 + d * u**3
