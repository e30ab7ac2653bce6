"""Plain lists of poses in JSON or CSV, as people write them by hand.

JSON: a list of poses, or an object with a list `poses` (`frames`, `keyframes`) and maybe `joints`
(names) and `fps`. A pose is a list of angles, or an object: angles by joint, directly or below
`deg`, `rad`, `us`, `joints`, `angles`, `positions` or `pose`, with an instant (`time_s`), a
duration (`duration_s`) and a pause (`hold_s`). CSV: one row per pose, without a column of times;
joints in the header, else numbered from 1; columns `duration_s`, `hold_s` and `name` as in JSON.

All times may end in `_ms`. Durations are the way to a pose, after the pause of the pose before.
Angles are degrees if nothing else is given. Poses without times get `STEP_S` each, unless a
column looks like a time.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.interchange.columns import is_time_name, name_and_unit, unit_of_column
from lss_motion.interchange.csv import cells_of, csv_rows, head_of
from lss_motion.interchange.fields import (
    JsonFields,
    TextLines,
    is_number,
    parsed_json,
    starts_json,
    text_head,
)
from lss_motion.interchange.reader import (
    DENSE_MIN,
    FPS_MAX,
    VALUES_MAX,
    Measure,
    Pose,
    Reader,
    motion_label,
    motion_name,
    motion_of_poses,
    summarised,
)

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

STEP_S: Final = 1.0
"""Assumed time of a pose without a time; the comments name it."""

CLOCK_JITTER: Final = 0.5
"""Chosen: steps of a clock differ by less than half of their mean."""

ANGLE_MAX: Final = 1e6
"""Chosen: more than any angle or pulse, less than the seconds since 1970."""

LISTS: Final = ("poses", "frames", "keyframes")
INSTANTS: Final = {
    **dict.fromkeys(["time_s", "at_s", "t_s", "time", "t"], 1.0),
    **dict.fromkeys(["time_ms", "at_ms", "t_ms"], 1e-3),
}
DURATIONS: Final = {
    **dict.fromkeys(["duration_s", "after_s", "duration"], 1.0),
    **dict.fromkeys(["duration_ms", "after_ms"], 1e-3),
}
HOLDS: Final = {
    **dict.fromkeys(["hold_s", "pause_s", "hold", "pause"], 1.0),
    **dict.fromkeys(["hold_ms", "pause_ms"], 1e-3),
}
NAMES: Final = ("name", "label")
VALUES: Final = {
    **dict.fromkeys(["deg", "joints", "angles", "angles_deg", "positions", "pose"], Measure.DEG),
    **dict.fromkeys(["rad", "angles_rad"], Measure.RAD),
    "us": Measure.US,
}

_JSON_ROW: Final = re.compile(rb"\[\s*(\{|\[\s*[-+\d])")


def _is_poses(data: bytes) -> bool:
    head = text_head(data, 65_536)
    if starts_json(data, b"["):
        return _JSON_ROW.match(head.lstrip()) is not None
    if starts_json(data, b"{"):
        return b'"poses"' in data or b'"frames"' in data
    found = head_of(data)
    if found is None:
        return False
    header, rows = found
    try:
        return len(rows) > 0 and all(
            _is_pose(header.names, header.delimiter, row) for row in rows[:2]
        )
    except csv.Error:
        return False


def _poses_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    is_json = starts_json(data, b"[") or starts_json(data, b"{")
    return (_from_json(path, data) if is_json else _from_rows(TextLines.of(path, data)),)


POSES: Final = Reader("poses", _is_poses, _poses_motions)
"""Reads `[{"deg": {joint: angle}, "duration_s": …}]`, `[[…], […]]` and rows of angles."""


def _is_pose(header: list[str], mark: str, row: str) -> bool:
    """Return whether `row` has numbers, maybe with empty cells and names of the pose."""
    names = [name.strip(' "').lower() for name in header]
    cells = cells_of(row, mark)
    # The last row may be cut, where the file is longer than the head.
    words = [cell for name, cell in zip(names, cells, strict=False) if cell and name not in NAMES]
    return (
        len(cells) > 1
        and len(words) > 0
        and all(is_number(word, has_commas=mark != ",") for word in words)
    )


@dataclass(slots=True)
class _Poses:
    """Collects poses; checks that units and kinds of times are the same in all of them."""

    path: Path
    poses: list[Pose] = field(default_factory=list)
    units: dict[str, Measure] = field(default_factory=dict)
    kind: str = ""
    values_count: int = 0

    def add(
        self,
        values: dict[str, tuple[float, Measure]],
        times: dict[str, float],
        *,
        label: str = "",
        place: str = "",
        line: int | None = None,
    ) -> None:
        """Add a pose; `times` has at most an instant, a duration and a pause, in seconds."""
        if not values:
            self._refuse(f"{place} has no angle", line)
        for joint, (_, unit) in values.items():
            if self.units.setdefault(joint, unit) is not unit:
                self._refuse(
                    f"{place}: {joint!r:.60} is in {unit}, before in {self.units[joint]}", line
                )
        self.values_count += len(values)
        if self.values_count > VALUES_MAX:
            self._refuse(f"more than {VALUES_MAX:,} values", line)
        kind = next((kind for kind in ("instant", "duration") if kind in times), "none")
        self.kind = self.kind or kind
        if kind != self.kind:
            self._refuse(
                f"{place}: either all poses have an instant, all a duration, or none", line
            )
        end_s = self.poses[-1].at_s + self.poses[-1].hold_s if self.poses else 0.0
        # The show begins in the first pose, unless the file gives the time to reach it.
        way_s = times.get("duration", STEP_S if self.poses else 0.0)
        at_s = times.get("instant", end_s + way_s)
        if way_s < 0.0 or times.get("hold", 0.0) < 0.0:
            self._refuse(f"{place}: durations and pauses must be 0 s or more", line)
        self.poses.append(
            Pose(
                at_s=at_s,
                values={joint: value for joint, (value, _) in values.items()},
                hold_s=times.get("hold", 0.0),
                label=label,
                place=place,
                line=line,
            )
        )

    def motion(self, name: str, left_out: list[str]) -> ForeignMotion:
        if self.kind == "none":
            self._check_is_no_clock()
        guess = [f"The poses have no times: {STEP_S:g} s each."] if self.kind == "none" else []
        about = [f"Imported from {self.path.name} (list of poses).", *guess, *summarised(left_out)]
        return motion_of_poses(
            self.path, name, self.poses, unit_of=self.units.__getitem__, comments=about
        )

    def _check_is_no_clock(self) -> None:
        """Raise `InputError` if the first value of the poses increases as a time does."""
        joint = next(iter(self.poses[0].values)) if self.poses else ""
        values = [pose.values[joint] for pose in self.poses if joint in pose.values]
        if len(values) < max(DENSE_MIN, len(self.poses)):
            return
        steps = np.diff(values)
        if steps.min() > 0.0 and np.ptp(steps) <= CLOCK_JITTER * steps.mean():
            reason = (
                f"{joint!r:.60} increases evenly, as a time does; name it time_s or time_ms in a "
                "header line, or give the poses a duration_s"
            )
            self._refuse(reason, self.poses[0].line)

    def _refuse(self, reason: str, line: int | None) -> None:
        raise InputError(reason, path=self.path, line=line)


def _from_json(path: Path, data: bytes) -> ForeignMotion:
    fields = JsonFields(path)
    content = parsed_json(path, data)
    top: dict[str, object] = {"poses": content}
    if not isinstance(content, list):
        top = fields.mapping(content, "the file")
    key = next((key for key in LISTS if key in top), LISTS[0])
    names = top.get("joints", top.get("names"))
    if names is not None and not (
        isinstance(names, list) and all(isinstance(name, str) and name for name in names)
    ):
        fields.refuse("joints must be a list of names")
    fps = fields.number(top, "fps", "the file") if "fps" in top else None
    if fps is not None and not 0.0 < fps <= FPS_MAX:
        fields.refuse(f"fps {fps:g} must be more than 0 and at most {FPS_MAX:g}")
    left_out = [
        f"key {name}" for name in top if name not in {key, "joints", "names", "fps", "name"}
    ]
    found = _Poses(path)
    for index, entry in enumerate(fields.items(top, key, "the file")):
        place = f"{key}[{index}]"
        values, times, label = _entry(fields, entry, place, names, left_out)
        if fps is not None:
            times = {"instant": index / fps, **{k: t for k, t in times.items() if k == "hold"}}
        found.add(values, times, label=label, place=place)
    return found.motion(motion_label(top.get("name")), left_out)


Entry = tuple[dict[str, tuple[float, Measure]], dict[str, float], str]


def _entry(
    fields: JsonFields, entry: object, place: str, names: object, left_out: list[str]
) -> Entry:
    """Return values, times and label of one pose."""
    if isinstance(entry, list):
        return _listed(fields, entry, place, names, Measure.DEG), {}, ""
    values: dict[str, tuple[float, Measure]] = {}
    times: dict[str, float] = {}
    label = ""
    for name, value in fields.mapping(entry, place).items():
        where = f"{place}.{name}"
        lower = name.lower()
        for kind, units in (("instant", INSTANTS), ("duration", DURATIONS), ("hold", HOLDS)):
            if lower in units:
                times[kind] = fields.plain_number(value, where) * units[lower]
                break
        else:
            if lower in VALUES and isinstance(value, dict):
                values |= {
                    joint: (fields.plain_number(angle, f"{where}.{joint}"), VALUES[lower])
                    for joint, angle in value.items()
                }
            elif lower in VALUES and isinstance(value, list):
                values |= _listed(fields, value, where, names, VALUES[lower])
            elif lower in NAMES:
                label = motion_label(value)
            elif isinstance(value, int | float) and not isinstance(value, bool):
                joint, unit = unit_of_column(fields.path, None, name)
                values[joint] = (fields.plain_number(value, where), unit)
            else:
                left_out.append(f"{name} of the poses")
    return values, times, label


def _listed(
    fields: JsonFields, listed: list[object], place: str, names: object, unit: Measure
) -> dict[str, tuple[float, Measure]]:
    """Return a list of angles by the names of the joints, or by their numbers from 1."""
    own = names if isinstance(names, list) else [f"J{n}" for n in range(1, len(listed) + 1)]
    if len(own) != len(listed) or len(set(own)) < len(own):
        fields.refuse(f"{place} has {counted(listed, 'value')} for {counted(set(own), 'joint')}")
    return {
        str(joint): (fields.plain_number(value, f"{place}[{index}]"), unit)
        for index, (joint, value) in enumerate(zip(own, listed, strict=True))
    }


def _from_rows(lines: TextLines) -> ForeignMotion:
    table = csv_rows(lines)
    if all(is_number(cell, has_commas=table.has_commas) for cell in table.header):
        numbered = [f"J{n}" for n in range(1, len(table.header) + 1)]
        table = replace(table, header=numbered, first_row=table.header_line - 1)
    times = {**dict.fromkeys(INSTANTS, "instant"), **dict.fromkeys(DURATIONS, "duration"),
             **dict.fromkeys(HOLDS, "hold")}  # fmt: skip
    seconds = INSTANTS | DURATIONS | HOLDS
    found = _Poses(lines.path)
    for number, row in table.rows():
        values: dict[str, tuple[float, Measure]] = {}
        own: dict[str, float] = {}
        label = ""
        for name, cell in zip(table.header, row, strict=True):
            word = cell.strip()
            lower = "_".join(part for part in name_and_unit(name.lower()) if part)
            if lower in NAMES:
                label = motion_label(word)
            elif word and name:
                value = lines.number(word, number, has_commas=table.has_commas)
                if lower in times:
                    own[times[lower]] = value * seconds[lower]
                elif is_time_name(name) or abs(value) > ANGLE_MAX:
                    lines.refuse(
                        number, f"column {name!r:.60} is no angle: is it a time? Name it time_s"
                    )
                else:
                    joint, unit = unit_of_column(lines.path, table.header_line, name)
                    values[joint] = (value, unit)
        found.add(values, own, label=label, place="this row", line=number)
    if not found.poses:
        lines.refuse(None, "has no row with a value")
    return found.motion(motion_name(lines.path), [])
