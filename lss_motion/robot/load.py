"""robot.yaml → `Robot`: defaults are merged, and all that depends on several keys is checked.

Law: all problems of a file come in one `InputError`, each with its line. What could not be read
is left out of later checks, so that one mistake is reported once.
"""

# ruff: noqa: TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec.structs import replace

from lss_motion.errors import ProtocolError
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Location, Mistake, read_yaml, source_of
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import DISABLED
from lss_motion.protocol.io2 import rc_zero_deg
from lss_motion.protocol.lss import LSS_FIRMWARE
from lss_motion.protocol.lss_pro import PRO_FIRMWARE, Units
from lss_motion.robot.figure import ORIGIN, Figure, FigureLink, Shape, unit_vector
from lss_motion.robot.model import SERVO, Bus, Joint, Response, Robot, Sensor, UrdfSource
from lss_motion.robot.servo_models import (
    BAUD_FIRMWARE_MIN,
    FAMILIES,
    SERVO_MODELS,
    board_problems,
    ramp_of_steps,
    ramp_steps,
    ramp_steps_max,
    with_units,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.figure import Shade, Vector
    from lss_motion.robot.file import (
        FigureLinkEntry,
        JointDefaults,
        JointEntry,
        JointOnFaultEntry,
        MirrorEntry,
        RobotFile,
        SensorEntry,
    )
    from lss_motion.robot.model import ServoModel
    from lss_motion.robot.on_fault import Escalations

    Image = tuple[str, Literal[1, -1]]

SIMULATED_PORT: Final = "sim://"
"""Several buses may have this port, since each has its own simulation; a real port has one bus."""

_NEEDED: Final = ("model", "range_deg", "speed_max_deg_s", "accel_max_deg_s2")

MODEL_LIMITS: Final[Mapping[str, Callable[[ServoModel], float]]] = {
    "speed_max_deg_s": lambda model: model.speed_max_deg_s,
    "accel_max_deg_s2": lambda model: model.accel_max_deg_s2,
}
"""The largest value that a model allows, by the name of the limit."""

_PLAIN: Final = (
    "speed_max_deg_s",
    "accel_max_deg_s2",
    "jerk_max_deg_s3",
    "direction",
    "zero_deg",
    "following_deg",
    "goal_tolerance_deg",
    "goal_time_s",
    "turns",
    "drive",
    "filter_count",
    "temperature_max_c",
    "voltage_min_v",
    "silent_s",
)


def load_robot(path: Path | str | Mapping[str, object]) -> Robot:
    """Return the robot of a robot file, or of the same keys and values as a dict.

    Joints keep the order of the file. Raises `InputError` with file, line, value and remedy;
    its `more` holds all further problems of the file.
    """
    from lss_motion.files.validation import validate
    from lss_motion.robot.file import RobotFile

    source = read_yaml(Path(path)) if isinstance(path, Path | str) else source_of(path)
    content, problems, left_out = validate(RobotFile, source)
    if content is not None:
        loader = _RobotLoader(content, left_out, source.line)
        robot = loader.robot(source.path)
        if not source.has_lines:
            robot = replace(robot, path=None)
        problems += loader.problems
        if not problems:
            return robot
    raise source.error(problems)


def load_named_robot(source: YamlSource, name: str | None) -> Robot:
    """Return the robot that the key `robot` of a sequence or gait file names.

    The path is relative to that file. Raises `InputError` if the key or the file is missing.
    """
    if name is None:
        raise source.error([Mistake((), "no robot: give 'robot: FILE' here, or --robot FILE")])
    path = source.path.parent / name
    if not path.exists():
        raise source.error(
            [Mistake(("robot",), f"robot file {name!r} not found; looked for {path}")]
        )
    return load_robot(path)


def robot_schema() -> dict[str, Any]:
    """Return the JSON Schema of a robot file."""
    from lss_motion.files.keys import json_schema
    from lss_motion.robot.file import RobotFile

    return json_schema(RobotFile)


@dataclass(slots=True)
class _Merged:
    """The fields of one joint, its own in place of the defaults, and the location of each."""

    fields: dict[str, Any]
    places: dict[str, Location]

    def place(self, name: str) -> Location:
        return self.places[name]


def _merge(name: str, defaults: JointDefaults, entry: JointEntry) -> _Merged:
    merged = _Merged({}, {})
    for owner, location in ((defaults, ("defaults",)), (entry, ("joints", name))):
        for key in owner.given:
            value = getattr(owner, key)
            if value is None:  # A key without a value; validation has reported it.
                continue
            if key == "response":
                value = merged.fields.get(key, {}) | value.known()
            elif key in {"settings", "stored"}:
                value = merged.fields.get(key, {}) | value
                merged.places |= {f"{key}.{k}": (*location, key, k) for k in getattr(owner, key)}
            merged.fields[key] = value
            merged.places[key] = (*location, key)
    return merged


@dataclass(slots=True)
class _RobotLoader:
    """Builds the robot of one file and collects its problems.

    `left_out` are locations that could not be read; what depends on them is not checked.
    """

    content: RobotFile
    left_out: frozenset[Location]
    line: Callable[[Location], int]
    problems: list[Mistake] = field(default_factory=list)

    @property
    def _units(self) -> Units:
        return Units(**self.content.units.known())

    def robot(self, path: Path) -> Robot:
        """Return the robot; it can be used only if there are no `problems`."""
        content = self.content
        buses = {
            name: Bus(
                name=name,
                port=b.port,
                baud_bps=b.baud_bps,
                firmware=LSS_FIRMWARE if b.firmware is None else b.firmware,
                pro_firmware=PRO_FIRMWARE if b.firmware is None else b.firmware,
                reading_rate_min_hz=b.reading_rate_min_hz,
            )
            for name, b in content.buses.items()
        }
        self._check_buses(buses)
        built = {name: self._joint(name, entry) for name, entry in content.joints.items()}
        joints = {name: joint for name, joint in built.items() if joint is not None}
        self._check_ids(joints)
        self._check_units(joints)
        for location, reason in board_problems(buses, joints):
            if self._is_checked(*location[:2]):
                self._note(location, reason)
        self._check_poses(joints)
        sensors, problems = sensors_of(content.sensors, buses, joints)
        self.problems += problems if self._is_checked("buses") else []
        self.problems += group_problems(content.groups, self._named())
        self.problems += mirror_problems(content.mirror, self._named())
        figure = None
        if self._is_checked("figure") and not any(place[0] == "figure" for place in self.left_out):
            figure, problems = figure_from(content.figure, self._named())
            self.problems += problems
        return Robot(
            name=content.robot,
            path=path,
            buses=buses,
            joints=joints,
            poses=content.poses,
            visemes=content.visemes,
            groups=grouped(content.groups, joints),
            mirror=mirror_images(content.mirror),
            sensors=sensors,
            approach_speed_deg_s=content.approach_speed_deg_s,
            sound_offset_s=content.sound_offset_s,
            end=content.end,
            on_fault=_escalations(content.on_fault),
            patience_s=content.patience_s,
            resume_s=content.resume_s,
            figure=figure,
            urdf=self._urdf(path),
        )

    def _urdf(self, path: Path) -> UrdfSource | None:
        entry = self.content.urdf
        if entry is None:
            return None
        if self.content.figure:
            self._note(("urdf",), "'urdf' and 'figure' exclude each other; keep one")
        file = PurePosixPath(entry.file.replace("\\", "/"))
        if file.is_absolute() or ".." in file.parts or ":" in entry.file:
            reason = f"urdf file {entry.file!r} must be a path below the folder of the robot file"
            self._note(("urdf", "file"), reason)
        named = self._named()
        for joint in entry.joints:
            if joint not in named:
                reason = f"urdf: unknown joint {joint!r}; {known_names(joint, named)}"
                self._note(("urdf", "joints", joint), reason)
        lines = {name: self.line(("urdf", "joints", name)) for name in entry.joints}
        return UrdfSource(
            path=path.parent / file,
            robot_path=path,
            joints=entry.joints,
            lines={**lines, "": self.line(("urdf", "file"))},
        )

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _is_checked(self, *location: str) -> bool:
        return not any(self.left_out & {location[:1], location[:2]})

    def _check_buses(self, buses: Mapping[str, Bus]) -> None:
        ports: dict[str, str] = {}
        for name, bus in buses.items():
            firmware_min = BAUD_FIRMWARE_MIN[bus.baud_bps]
            if bus.firmware < firmware_min:
                self._note(
                    ("buses", name, "baud_bps"),
                    f"{bus.baud_bps} bps needs firmware {firmware_min} or later, but bus "
                    f"{name!r} has {bus.firmware}; lower baud_bps or update the servos",
                )
            if bus.port == SIMULATED_PORT:
                continue
            if bus.port in ports:
                self._note(
                    ("buses", name, "port"),
                    f"port {bus.port!r} already carries bus {ports[bus.port]!r}; "
                    "give each bus its own port",
                )
            ports.setdefault(bus.port, name)

    def _joint(self, name: str, entry: JointEntry) -> Joint | None:
        merged = _merge(name, self.content.defaults, entry)
        fields = merged.fields
        missing = [
            key for key in _NEEDED if key not in fields and self._is_checked("defaults", key)
        ]
        for key in missing:
            self._note(
                ("joints", name, key),
                f"joint {name!r} has no {key!r}; give it here or under 'defaults'",
            )
        bus = self._bus(name, merged)
        if bus is None or any(key not in fields for key in _NEEDED):
            return None
        model = SERVO_MODELS[fields["model"]]
        units = self._units
        if pulse_us := fields.get("pulse_us"):
            self._check_pulses(name, model, pulse_us, merged)
            if pulse_us[0] < pulse_us[1]:
                units = replace(units, rc_pulse_us=(pulse_us[0], pulse_us[1]))
        model = with_units(model, units)
        if model.family is Family.IO2:
            fields["zero_deg"] = fields.get("zero_deg", 0.0) - rc_zero_deg(units.rc_pulse_us)
        fields.setdefault("drive", FAMILIES[model.family].drives[0])
        unread = frozenset(key for key in MODEL_LIMITS if fields[key] == SERVO)
        fields |= {key: MODEL_LIMITS[key](model) for key in unread}
        joint = Joint(
            name=name,
            servo_id=entry.id,
            bus=bus,
            model=model,
            position_min_deg=fields["range_deg"][0],
            position_max_deg=fields["range_deg"][1],
            settings=fields.get("settings", {}),
            stored={
                name: None if value == DISABLED else value
                for name, value in fields.get("stored", {}).items()
            },
            response=Response(**fields.get("response", {})),
            on_fault=_escalations(entry.on_fault),
            unread=unread,
            lines={key: self.line(place) for key, place in merged.places.items()},
            **{key: fields[key] for key in _PLAIN if key in fields},
        )
        for location, reason in joint_field_problems(joint, merged.place):
            self._note(location, reason)
        return within_ramps(joint) if joint.drive in ("timed", "auto") else joint

    def _check_pulses(
        self, name: str, model: ServoModel, pulse_us: Sequence[int], merged: _Merged
    ) -> None:
        place = merged.place("pulse_us")
        if model.family is not Family.IO2 and place[0] == "joints":
            reason = f"joint {name!r}: pulse_us is for an RC servo on an LSS-2IO; remove it"
            self._note(place, reason)
        if pulse_us[0] >= pulse_us[1]:
            reason = (
                f"joint {name!r}: pulse_us must rise, but goes from {pulse_us[0]} to "
                f"{pulse_us[1]}; `direction: -1` turns a servo round"
            )
            self._note(place, reason)

    def _bus(self, name: str, merged: _Merged) -> str | None:
        buses = self.content.buses
        if not self._is_checked("buses") or any(place[0] == "buses" for place in self.left_out):
            return None
        if "bus" not in merged.fields:
            if len(buses) == 1:
                return next(iter(buses))
            self._note(
                ("joints", name, "bus"),
                f"joint {name!r} has no 'bus', and there are several: {', '.join(buses)}",
            )
            return None
        bus = str(merged.fields["bus"])
        if bus not in buses:
            self._note(merged.place("bus"), f"unknown bus {bus!r}; {known_names(bus, buses)}")
            return None
        return bus

    def _check_ids(self, joints: Mapping[str, Joint]) -> None:
        owners: dict[tuple[str, int], str] = {}
        for name, joint in joints.items():
            owner = owners.setdefault((joint.bus, joint.servo_id), name)
            if owner != name:
                self._note(
                    ("joints", name, "id"),
                    f"joints {owner!r} and {name!r} both have id {joint.servo_id} on bus "
                    f"{joint.bus!r}; every servo of a bus needs its own id",
                )

    def _check_units(self, joints: Mapping[str, Joint]) -> None:
        """Refuse units that no servo has: the owner expects them to change something."""
        families = {joint.model.family for joint in joints.values()}
        if joints and self.content.units.given and Family.LSS_PRO not in families:
            reason = (
                "units are those of LSS-PRO servos, and no joint is one (model LSS-P-…); those of "
                "the other servos are fixed. Remove `units`"
            )
            self._note(("units",), reason)

    def _named(self) -> list[str]:
        """Return the names of all joints, including those that could not be read."""
        return [
            *self.content.joints,
            *(str(place[1]) for place in self.left_out if place[0] == "joints" and len(place) > 1),
        ]

    def _check_poses(self, joints: Mapping[str, Joint]) -> None:
        named = self._named()
        both = ("poses", "pose", self.content.poses), ("visemes", "viseme", self.content.visemes)
        for key, word, poses in both:
            for pose, angles in poses.items():
                for name, angle_deg in angles.items():
                    place = (key, pose, name)
                    if name not in named:
                        known = known_names(name, named)
                        self._note(place, f"{word} {pose!r}: unknown joint {name!r}; {known}")
                    elif name in joints and (reason := joints[name].range_problem(angle_deg)):
                        self._note(place, f"{word} {pose!r}: {reason}")


def _escalations(entry: JointOnFaultEntry) -> Escalations:
    from lss_motion.robot.file import escalations

    return escalations(entry)


def within_ramps(joint: Joint) -> Joint:
    """Return the joint with the largest acceleration that the ramps of its servo can express."""
    model, ratio = joint.model, joint.ramp_ratio
    if model.accel_step_deg_s2 == 0.0:
        return joint
    steps = ramp_steps(model, joint.accel_max_deg_s2, ratio)
    if joint.accel_max_deg_s2 <= model.accel_max_deg_s2:
        steps = min(steps, ramp_steps_max(model))
    return replace(joint, accel_max_deg_s2=ramp_of_steps(model, steps) * ratio)


def joint_field_problems(
    joint: Joint, place: Callable[[str], Location]
) -> Iterator[tuple[Location, str]]:
    """Yield location and reason of each problem; `place` gives the location of a key."""
    model, facts = joint.model, FAMILIES[joint.model.family]
    if joint.position_min_deg >= joint.position_max_deg:
        yield (
            place("range_deg"),
            f"joint {joint.name!r}: range_deg must rise, but goes from "
            f"{joint.position_min_deg:g} to {joint.position_max_deg:g}",
        )
    yield from _unread_problems(joint, place)
    if joint.speed_max_deg_s > model.speed_max_deg_s:
        yield (
            place("speed_max_deg_s"),
            f"joint {joint.name!r}: {joint.speed_max_deg_s:g} deg/s is faster than an "
            f"{model.name} can turn without load, {model.speed_max_deg_s:g} deg/s",
        )
    if joint.drive == "timed" and joint.accel_max_deg_s2 > model.accel_max_deg_s2:
        yield (
            place("accel_max_deg_s2"),
            f"joint {joint.name!r}: {joint.accel_max_deg_s2:g} deg/s² is more than the ramps of "
            f"the servo (AA, AD) can express, {model.accel_max_deg_s2:g} deg/s²; a joint with "
            f"`drive: streamed` needs none",
        )
    if joint.drive in ("timed", "auto") and joint.accel_max_deg_s2 < model.accel_step_deg_s2:
        yield (
            place("accel_max_deg_s2"),
            f"joint {joint.name!r}: {joint.accel_max_deg_s2:g} deg/s² is less than the ramps of "
            f"the servo (AA, AD) can express, {model.accel_step_deg_s2:g} deg/s²",
        )
    for keyword, value in joint.settings.items():
        where = place(f"settings.{keyword}")
        if keyword not in facts.settings:
            known = known_names(keyword, facts.settings)
            yield where, f"joint {joint.name!r}: unknown setting {keyword!r}; {known}"
        elif not facts.settings[keyword][0] <= value <= facts.settings[keyword][1]:
            least, most = facts.settings[keyword]
            yield where, f"joint {joint.name!r}: {keyword} {value} must be {least} to {most}"
    if joint.stored:
        yield from _stored_problems(joint, place)


def _unread_problems(
    joint: Joint, place: Callable[[str], Location]
) -> Iterator[tuple[Location, str]]:
    if joint.unread and joint.model.family is Family.IO2:
        yield (
            place(max(joint.unread)),
            f"joint {joint.name!r}: an RC servo on a 2IO has no limits to read; give a number",
        )
    elif "accel_max_deg_s2" in joint.unread and joint.drive == "streamed":
        yield (
            place("accel_max_deg_s2"),
            f"joint {joint.name!r}: the ramps of a servo do not act while it is streamed; give a "
            f"number",
        )


def _stored_problems(
    joint: Joint, place: Callable[[str], Location]
) -> Iterator[tuple[Location, str]]:
    # Importing the tables of the protocol takes time, so only files with this key do it.
    from lss_motion.protocol.codec import stored_wire

    for keyword, stored in joint.stored.items():
        try:
            stored_wire(joint.model.language, keyword, stored)
        except ProtocolError as error:
            yield place(f"stored.{keyword}"), f"joint {joint.name!r}: {error}"


def sensors_of(
    entries: Mapping[str, SensorEntry], buses: Iterable[str], joints: Mapping[str, Joint]
) -> tuple[dict[str, Sensor], list[Mistake]]:
    """Return the sensors by name, and their problems."""
    known = list(buses)
    owners = {(joint.bus, joint.servo_id): f"joint {name!r}" for name, joint in joints.items()}
    sensors: dict[str, Sensor] = {}
    problems = []
    for name, entry in entries.items():
        place = ("sensors", name)
        bus = entry.bus or (known[0] if len(known) == 1 else None)
        if bus is None:
            reason = f"sensor {name!r} has no 'bus', and there are several: {', '.join(known)}"
            problems.append(Mistake((*place, "bus"), reason))
        elif bus not in known:
            reason = f"unknown bus {bus!r}; {known_names(bus, known)}"
            problems.append(Mistake((*place, "bus"), reason))
        elif (
            owner := owners.setdefault((bus, entry.id), f"sensor {name!r}")
        ) != f"sensor {name!r}":
            reason = f"{owner} and sensor {name!r} both have id {entry.id} on bus {bus!r}"
            problems.append(Mistake((*place, "id"), reason))
        else:
            sensors[name] = Sensor(name=name, servo_id=entry.id, bus=bus, kind=entry.kind)
    return sensors, problems


def grouped(
    groups: Mapping[str, Sequence[str]], joints: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """Return the joints of every group, in the order of `joints`."""
    return {
        group: tuple(name for name in joints if name in members)
        for group, members in groups.items()
    }


def group_problems(
    groups: Mapping[str, Sequence[str]], joints: Collection[str]
) -> Iterator[Mistake]:
    """Yield every member that is not a joint, and every group with the name of a joint."""
    for group, members in groups.items():
        if group in joints:
            yield Mistake(("groups", group), f"group {group!r} has the name of a joint")
        for index, name in enumerate(members):
            if name not in joints:
                reason = f"group {group!r}: unknown joint {name!r}; {known_names(name, joints)}"
                yield Mistake(("groups", group, index), reason)


def mirror_images(entry: MirrorEntry) -> dict[str, Image]:
    """Return the image of every joint that has one, and the sign of its angle there."""
    images: dict[str, Image] = {}
    for left, right in entry.same.items():
        images |= {left: (right, 1), right: (left, 1)}
    for left, right in entry.opposite.items():
        images |= {left: (right, -1), right: (left, -1)}
    return images


def mirror_problems(entry: MirrorEntry, joints: Collection[str]) -> Iterator[Mistake]:
    """Yield every pair with a joint that is unknown or already has an image."""
    seen: set[str] = set()
    for key, pairs in (("same", entry.same), ("opposite", entry.opposite)):
        for left, right in pairs.items():
            place = ("mirror", key, left)
            for name in sorted({left, right}):
                if name not in joints:
                    yield Mistake(place, f"unknown joint {name!r}; {known_names(name, joints)}")
                elif name in seen:
                    yield Mistake(place, f"joint {name!r} has a mirror image already; keep one")
            seen |= {left, right}


def figure_from(
    entries: Mapping[str, FigureLinkEntry], joints: Collection[str]
) -> tuple[Figure | None, list[Mistake]]:
    """Return the figure of the links of a robot file, or their problems."""
    problems = list(figure_problems(entries, joints))
    if problems or not entries:
        return None, problems
    parents = {name: {entry.parent} - {None} for name, entry in entries.items()}
    order = [name for name in TopologicalSorter(parents).static_order() if name is not None]
    links: list[FigureLink] = []
    ends: list[Vector] = []
    feet = []
    for name in order:
        entry = entries[name]
        parent = -1 if entry.parent is None else order.index(entry.parent)
        start = ends[parent] if parent >= 0 else ORIGIN
        x, y, z = unit_vector(entry.along or "x")
        end = (entry.length_mm * x, entry.length_mm * y, entry.length_mm * z)
        ends.append(end)
        if entry.foot:
            feet.append((len(links), end))
        links.append(
            FigureLink(
                name=name,
                parent=parent,
                joint=entry.joint,
                rest_deg=entry.rest_deg,
                axis=unit_vector(entry.axis or "z"),
                origin_mm=(
                    start[0] + entry.offset_mm[0],
                    start[1] + entry.offset_mm[1],
                    start[2] + entry.offset_mm[2],
                ),
                lines_mm=((ORIGIN, end),) if entry.length_mm and not entry.ball_mm else (),
                width_mm=entry.width_mm,
                shade=entry.shade,
                shapes=() if entry.ball_mm is None else (_ball(entry.ball_mm, end, entry.shade),),
            )
        )
    return Figure(source="figure", links=tuple(links), feet=tuple(feet)), []


def _ball(ball_mm: Sequence[float], end: Vector, shade: Shade | None) -> Shape:
    """Return a ball in the middle of a link that ends there."""
    x, y, z = ball_mm
    middle = (end[0] / 2.0, end[1] / 2.0, end[2] / 2.0)
    half_axes = (x / 2.0, y / 2.0, z / 2.0)
    return Shape(kind="ball", size_mm=half_axes, origin_mm=middle, shade=shade)


def figure_problems(
    entries: Mapping[str, FigureLinkEntry], joints: Collection[str]
) -> Iterator[Mistake]:
    for name, entry in entries.items():
        place = ("figure", name)
        if entry.parent is not None and entry.parent not in entries:
            reason = f"link {name!r}: unknown parent {entry.parent!r}"
            yield Mistake((*place, "parent"), f"{reason}; {known_names(entry.parent, entries)}")
        if entry.joint is not None and entry.joint not in joints:
            known = known_names(entry.joint, joints)
            yield Mistake(
                (*place, "joint"), f"link {name!r}: unknown joint {entry.joint!r}; {known}"
            )
        if entry.joint is not None and entry.axis is None:
            reason = f"link {name!r} has a joint and no 'axis', about which that turns it: y, …"
            yield Mistake((*place, "axis"), reason)
        if entry.joint is None and (given := {"axis", "rest_deg"} & entry.given):
            key = min(given)
            reason = f"link {name!r} has no 'joint', so {key!r} has no meaning; remove it"
            yield Mistake((*place, key), reason)
    parents = {name: {entry.parent} for name, entry in entries.items() if entry.parent}
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        reason = f"links are parents of each other: {' → '.join(cycle)}; one must stand alone"
        yield Mistake(("figure", cycle[0], "parent"), reason)
