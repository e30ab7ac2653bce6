"""Reads a faults file into rows of `faults`, with the checks that all authors' files get."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from lss_motion.errors import ProtocolError
from lss_motion.files.keys import FILE_VERSION, VERSION, Field, FileModel, Version
from lss_motion.files.texts import known_names
from lss_motion.files.validation import validate
from lss_motion.files.yaml_source import Mistake, read_yaml
from lss_motion.protocol.codec import language_table, stored_wire
from lss_motion.protocol.constants import Family
from lss_motion.protocol.io2 import PIN_IDS
from lss_motion.sim.boards import RAW_MAX, SENSORS
from lss_motion.sim.faults import ABOUT_LINE, INSTANT, Fault, FaultKind

if TYPE_CHECKING:
    from lss_motion.protocol.codec import Language
    from lss_motion.robot.model import Robot

SENSOR_NAMES = {suffix.name: sensor for suffix, sensor in SENSORS.items()}

Ratio = Annotated[float, Field(ge=0.0, le=1.0)]
Seconds = Annotated[float, Field(ge=0.0)]
ServoId = Annotated[int, Field(ge=0, le=254)]


class FaultEntry(FileModel, title="fault"):
    """One fault: its kind, its time and its servo."""

    kind: str = Field(description="What happens.", json_schema_extra={"enum": list(FaultKind)})
    at_s: Seconds = Field(default=0.0, description="From when on, in seconds from power-up.")
    until_s: Seconds | None = Field(default=None, description="Until when. Left out: for ever.")
    servo: ServoId | None = Field(default=None, description="Id of the servo. Left out: all.")
    bus: str | None = Field(default=None, description="Name of the bus. Left out: all.")
    ratio: Ratio = Field(default=1.0, description="Which share of lines or replies it befalls.")
    late_s: Seconds | None = Field(default=None, description="How late a reply or the host is.")
    as_id: ServoId | None = Field(default=None, description="wrong_id: the id in the replies.")
    speed_ratio: Ratio | None = Field(default=None, description="weak: what is left of the speed.")
    temperature_c: Annotated[float, Field(ge=-40.0, le=200.0)] | None = Field(
        default=None, description="hot: the temperature that the servo has at once."
    )
    drift_ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] | None = Field(
        default=None, description="clock_drift: millionths by which the servos' time runs faster."
    )
    deaf_s: Seconds | None = Field(
        default=None,
        description="reset, factory, exchanged: how long the servo is deaf; left out: 1.25.",
    )
    raw: Annotated[int, Field(ge=0, le=RAW_MAX)] | None = Field(
        default=None, description="input: the value of the converter."
    )
    distance_mm: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="input: instead of raw, a distance before a sensor."
    )
    sensor: str | None = Field(
        default=None,
        description="input: the model of that sensor.",
        json_schema_extra={"enum": list(SENSOR_NAMES)},
    )
    settings: Annotated[dict[str, float], Field(min_length=1)] | None = Field(
        default=None,
        description="stored: settings by name, in the units of `lss-motion reference`; ID as well. "
        "exchanged: those of the other servo that are not the factory's.",
        examples=[{"G": -1, "O": 5.0, "SD": 360}],
    )
    supply_v: Annotated[float, Field(ge=0.0, le=60.0)] | None = Field(
        default=None, description="low_voltage: what the supply gives without load."
    )
    setting: Literal["D", "SD", "AA", "AD", "T"] | None = Field(
        default=None, description="wrong_scale: the value that has another scale."
    )
    scale_ratio: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None,
        description="wrong_scale: one unit on the wire is so many times that of the documents.",
        examples=[0.1, 10],
    )
    text: str | None = Field(
        default=None,
        description="second_master: the line that another host sends, without its end.",
        examples=["#5QD", "#254L"],
    )
    every_s: Annotated[float, Field(ge=0.001)] | None = Field(
        default=None, description="second_master: how often it sends that line."
    )


class FaultsFile(FileModel, title="faults file"):
    """What goes wrong on the simulated buses."""

    version: Version = Field(default=FILE_VERSION, description=VERSION)
    faults: list[FaultEntry] = Field()


def load_faults(path: Path | str, robot: Robot | None = None) -> tuple[Fault, ...]:
    """Return the rows of a faults file; `InputError` says file, line, value and what is allowed.

    With a robot, rows that name a bus or a servo which it does not have are mistakes too.
    """
    source = read_yaml(Path(path))
    blanks = {"faults": FaultEntry(kind=FaultKind.DEAF)}
    content, problems, left_out = validate(FaultsFile, source, blanks=blanks)
    entries = [] if content is None else content.faults
    for index, entry in enumerate(entries):
        if ("faults", index) not in left_out:
            problems += _problems(index, entry)
            problems += [] if robot is None else _strangers(index, entry, robot)
            problems += _setting_problems(index, entry, robot)
    if problems:
        raise source.error(problems)
    return tuple(_fault(entry, robot) for entry in entries)


def _problems(index: int, entry: FaultEntry) -> list[Mistake]:
    place = ("faults", index)
    if entry.kind not in list(FaultKind):
        known = known_names(entry.kind, map(str, FaultKind))
        return [Mistake((*place, "kind"), f"kind {entry.kind!r} is not known; {known}")]
    kind = FaultKind(entry.kind)
    given = entry.given
    problems = [Mistake(place, f"{kind} needs {key!r}") for key in kind.needs if key not in given]
    problems += [
        Mistake((*place, key), f"{key!r} says nothing about {kind}; leave it out")
        for key in sorted(given)
        if not kind.has(key)
    ]
    if entry.until_s is not None and kind in INSTANT:
        problems.append(Mistake((*place, "until_s"), f"{kind} happens once; leave until_s out"))
    elif entry.until_s is not None and entry.until_s <= entry.at_s:
        problems.append(
            Mistake((*place, "until_s"), f"until_s {entry.until_s:g} must be after {entry.at_s:g}")
        )
    if entry.servo is not None and kind in ABOUT_LINE:
        hint = "; for one servo use 'deaf'" if kind is not FaultKind.LOW_VOLTAGE else ""
        problems.append(Mistake((*place, "servo"), f"{kind} befalls the line{hint}"))
    if kind is FaultKind.INPUT:
        problems += _input_problems(index, entry)
    return problems


def _input_problems(index: int, entry: FaultEntry) -> list[Mistake]:
    place = ("faults", index)
    has_distance = entry.distance_mm is not None
    if (entry.raw is None) is not has_distance:
        return [Mistake(place, "input needs 'raw', or 'distance_mm' with 'sensor'")]
    if has_distance is (entry.sensor is None):
        return [Mistake(place, "input needs 'distance_mm' and 'sensor' together")]
    if entry.sensor is not None and entry.sensor not in SENSOR_NAMES:
        known = known_names(entry.sensor, SENSOR_NAMES)
        return [Mistake((*place, "sensor"), f"sensor {entry.sensor!r} is not known; {known}")]
    return []


def _strangers(index: int, entry: FaultEntry, robot: Robot) -> list[Mistake]:
    """Return what a row names and the robot does not have."""
    place = ("faults", index)
    if entry.bus is not None and entry.bus not in robot.buses:
        known = known_names(entry.bus, robot.buses)
        return [Mistake((*place, "bus"), f"robot {robot.name!r} has no bus {entry.bus!r}; {known}")]
    buses = robot.buses if entry.bus is None else {entry.bus}
    ids = {joint.servo_id for joint in robot.joints.values() if joint.bus in buses}
    if entry.kind == FaultKind.INPUT:
        models = {joint.model.family for joint in robot.joints.values() if joint.bus in buses}
        sensors = {one.servo_id for one in robot.sensors.values() if one.bus in buses}
        ids |= sensors
        if Family.IO2 not in models and not sensors:
            return [Mistake(place, f"robot {robot.name!r} has no LSS-2IO there, so no inputs")]
        ids |= {PIN_IDS[name] for name in PIN_IDS if name.startswith("A")}
    if entry.servo is not None and entry.servo not in ids:
        known = ", ".join(map(str, sorted(ids)))
        return [
            Mistake(
                (*place, "servo"),
                f"robot {robot.name!r} has no servo {entry.servo} there; known ids are {known}",
            )
        ]
    return []


def _setting_problems(index: int, entry: FaultEntry, robot: Robot | None) -> list[Mistake]:
    """Return the settings that a servo does not have, or not with that value."""
    problems = []
    for name, value in (entry.settings or {}).items():
        try:
            _wire(name, value, _language(entry, robot))
        except ProtocolError as error:
            problems.append(Mistake(("faults", index, "settings", name), str(error)))
    return problems


def _language(entry: FaultEntry, robot: Robot | None) -> Family | Language:
    """Return the language of the servo of a row; LSS if that is not known."""
    joints = () if robot is None else robot.joints.values()
    return next(
        (
            joint.model.language
            for joint in joints
            if entry.servo in (None, joint.servo_id) and entry.bus in (None, joint.bus)
        ),
        Family.LSS,
    )


def _wire(name: str, value: float, language: Family | Language) -> int:
    """Return the wire value of a setting; raise `ProtocolError` as `stored_wire` does."""
    if name == "ID":
        row = language_table(language).row("CID")
        if not row.allows(round(value)):
            raise ProtocolError(f"ID {value:g}: {row.allowed()}")
        return round(value)
    wire = stored_wire(language, name, value)
    assert wire is not None, "a number was given"
    return wire


def _fault(entry: FaultEntry, robot: Robot | None) -> Fault:
    values = entry.known()
    values["kind"] = FaultKind(values.pop("kind"))
    if "servo" in values:
        values["servo_id"] = values.pop("servo")
    if entry.settings is not None:
        language = _language(entry, robot)
        values["settings"] = {n: _wire(n, value, language) for n, value in entry.settings.items()}
    sensor = values.pop("sensor", None)
    if sensor is not None:
        values["raw"] = SENSOR_NAMES[sensor].raw(values.pop("distance_mm"))
    return Fault(**values)
