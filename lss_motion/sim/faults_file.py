"""faults.yaml → rows of `faults`, checked as every file of the package is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from lss_motion.sim.faults import INSTANT, Fault, FaultKind
from lss_motion.spelling import known_names
from lss_motion.validation import FileModel, validate
from lss_motion.yaml_source import Problem, read_yaml

NEEDED: dict[FaultKind, tuple[str, ...]] = {
    FaultKind.LATE_REPLY: ("late_s",),
    FaultKind.WRONG_ID: ("servo", "as_id"),
    FaultKind.WEAK: ("speed_ratio",),
    FaultKind.HOT: ("temperature_c",),
}
"""Keys without which a kind says nothing."""

LINE_KINDS = frozenset({FaultKind.LOST_COMMAND, FaultKind.CORRUPT_COMMAND})
"""These befall the line before any servo; a servo that misses commands is `deaf`."""

Ratio = Annotated[float, Field(ge=0.0, le=1.0)]
Seconds = Annotated[float, Field(ge=0.0)]
ServoId = Annotated[int, Field(ge=0, le=254)]


class FaultEntry(FileModel, title="fault"):
    """What goes wrong, when and for whom."""

    kind: str = Field(description="What happens.", json_schema_extra={"enum": list(FaultKind)})
    at_s: Seconds = Field(default=0.0, description="From when on, in seconds from power-up.")
    until_s: Seconds | None = Field(default=None, description="Until when. Left out: for ever.")
    servo: ServoId | None = Field(default=None, description="Id of the servo. Left out: all.")
    ratio: Ratio = Field(default=1.0, description="Which share of lines or replies it befalls.")
    late_s: Seconds | None = Field(default=None, description="late_reply: by how much.")
    as_id: ServoId | None = Field(default=None, description="wrong_id: the id in the replies.")
    speed_ratio: Ratio | None = Field(default=None, description="weak: what is left of the speed.")
    temperature_c: Annotated[float, Field(ge=-40.0, le=200.0)] | None = Field(
        default=None, description="hot: the temperature that the servo has at once."
    )


class FaultsFile(FileModel, title="faults file"):
    """What goes wrong on the simulated buses."""

    faults: list[FaultEntry]


def load_faults(path: Path | str) -> tuple[Fault, ...]:
    """Return the rows of a faults file; `InputError` says file, line, value and what is allowed."""
    source = read_yaml(Path(path))
    blanks = {"faults": FaultEntry(kind=FaultKind.DEAF)}
    content, problems, left_out = validate(FaultsFile, source, blanks=blanks)
    entries = [] if content is None else content.faults
    for index, entry in enumerate(entries):
        if ("faults", index) not in left_out:
            problems += _problems(index, entry)
    if problems:
        raise source.error(problems)
    return tuple(_fault(entry) for entry in entries)


def _problems(index: int, entry: FaultEntry) -> list[Problem]:
    place = ("faults", index)
    if entry.kind not in list(FaultKind):
        known = known_names(entry.kind, map(str, FaultKind))
        return [Problem((*place, "kind"), f"kind {entry.kind!r} is not known; {known}")]
    kind = FaultKind(entry.kind)
    given = entry.model_fields_set
    problems = [
        Problem(place, f"{kind} needs {key!r}") for key in NEEDED.get(kind, ()) if key not in given
    ]
    own = {key for keys in NEEDED.values() for key in keys} - {"servo"}
    problems += [
        Problem((*place, key), f"{key!r} says nothing about {kind}; leave it out")
        for key in sorted(given & own - set(NEEDED.get(kind, ())))
    ]
    if entry.until_s is not None and kind in INSTANT:
        problems.append(Problem((*place, "until_s"), f"{kind} happens once; leave until_s out"))
    elif entry.until_s is not None and entry.until_s <= entry.at_s:
        problems.append(
            Problem((*place, "until_s"), f"until_s {entry.until_s:g} must be after {entry.at_s:g}")
        )
    if entry.servo is not None and kind in LINE_KINDS:
        problems.append(
            Problem((*place, "servo"), f"{kind} befalls the line; for one servo use 'deaf'")
        )
    return problems


def _fault(entry: FaultEntry) -> Fault:
    values = entry.model_dump(exclude_none=True)
    values["kind"] = FaultKind(values.pop("kind"))
    if "servo" in values:
        values["servo_id"] = values.pop("servo")
    return Fault(**values)
