"""robot.yaml → `Robot`: defaults are merged, and all that depends on several keys is checked.

Law: all problems of a file come in one `InputError`, each with its line. What could not be read
is left out of later checks, so that one mistake is reported once.
"""

# ruff: noqa: TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec.structs import replace

from lss_motion.errors import ProtocolError
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake, read_yaml, source_of
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import DISABLED
from lss_motion.protocol.io2 import rc_zero_deg
from lss_motion.protocol.lss import LSS_FIRMWARE
from lss_motion.protocol.lss_pro import PRO_FIRMWARE, Units
from lss_motion.robot.figure_links import figure_from
from lss_motion.robot.model import (
    NO_SERVO,
    SERVO,
    Bus,
    Joint,
    Response,
    Robot,
    Sensor,
    Supply,
    UrdfSource,
)
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

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.file import (
        JointDefaults,
        JointEntry,
        JointOnFaultEntry,
        MechanismEntry,
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

_NOT_SHARED: Final = frozenset({"id", "on_fault", "ratio", "linkage", "servo"})

_MADE: Final = ("model", "bus", "range_deg", "pulse_us", "settings", "stored", "response")
"""Keys of which a field of `Joint` is made; each other key is a field of the same name."""


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
    """The fields of one servo, its own in place of the defaults, and the location of each."""

    name: str
    at: Location
    """The location of its entry."""
    fields: dict[str, Any] = field(default_factory=dict)
    places: dict[str, Location] = field(default_factory=dict)

    def place(self, name: str) -> Location:
        return self.places[name]

    def put(self, key: str, value: object, place: Location) -> None:
        """Set a field, as if it stood at that place."""
        self.fields[key], self.places[key] = value, place


def _merge(name: str, at: Location, defaults: JointDefaults, entry: JointDefaults) -> _Merged:
    merged = _Merged(name, at)
    for owner, location in ((defaults, ("defaults",)), (entry, at)):
        for key in owner.given:
            value = getattr(owner, key)
            if value is None or key in _NOT_SHARED:  # None: validation has reported it.
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
    id_places: dict[str, Location] = field(default_factory=dict)
    """Where the ids of the servos of mechanisms stand."""

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
        moved = self._movers()
        built = {
            name: self._joint(name, entry)
            for name, entry in content.joints.items()
            if name not in moved
        }
        joints = {name: joint for name, joint in built.items() if joint is not None}
        servos, mechanisms = joints, {}
        if moved or content.mechanisms or any(map(has_transmission, content.joints.values())):
            from lss_motion.robot.servos import ServoLoader

            found = ServoLoader(self, joints, path.parent)
            joints, servos, mechanisms = found.joints, found.servos, found.mechanisms
        self._check_ids(servos)
        self._check_units(servos)
        for place, reason in board_problems(buses, servos):
            if self._is_checked(*place[:2]):
                at = self.id_places.get(place[1])
                self.note(place if at is None else (*at[:-1], place[2]), reason)
        self._check_poses(joints)
        sensors, problems = sensors_of(content.sensors, buses, servos)
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
            mechanisms=mechanisms,
            servos=servos if mechanisms else {},
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
            supply=Supply(**content.supply.known()),
        )

    def _urdf(self, path: Path) -> UrdfSource | None:
        entry = self.content.urdf
        if entry is None:
            return None
        if self.content.figure:
            self.note(("urdf",), "'urdf' and 'figure' exclude each other; keep one")
        file = PurePosixPath(entry.file.replace("\\", "/"))
        if file.is_absolute() or ".." in file.parts or ":" in entry.file:
            reason = f"urdf file {entry.file!r} must be a path below the folder of the robot file"
            self.note(("urdf", "file"), reason)
        named = self._named()
        for joint in entry.joints:
            if joint not in named:
                reason = f"urdf: unknown joint {joint!r}; {known_names(joint, named)}"
                self.note(("urdf", "joints", joint), reason)
        lines = {name: self.line(("urdf", "joints", name)) for name in entry.joints}
        return UrdfSource(
            path=path.parent / file,
            robot_path=path,
            joints=entry.joints,
            lines={**lines, "": self.line(("urdf", "file"))},
        )

    def note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _is_checked(self, *location: str) -> bool:
        return not any(self.left_out & {location[:1], location[:2]})

    def _check_buses(self, buses: Mapping[str, Bus]) -> None:
        ports: dict[str, str] = {}
        for name, bus in buses.items():
            firmware_min = BAUD_FIRMWARE_MIN[bus.baud_bps]
            if bus.firmware < firmware_min:
                self.note(
                    ("buses", name, "baud_bps"),
                    f"{bus.baud_bps} bps needs firmware {firmware_min} or later, but bus "
                    f"{name!r} has {bus.firmware}; lower baud_bps or update the servos",
                )
            if bus.port == SIMULATED_PORT:
                continue
            if bus.port in ports:
                self.note(
                    ("buses", name, "port"),
                    f"port {bus.port!r} already carries bus {ports[bus.port]!r}; "
                    "give each bus its own port",
                )
            ports.setdefault(bus.port, name)

    def _movers(self) -> dict[str, str]:
        """Return the mechanism of each joint that has one; note what has two."""
        found: dict[str, str] = {}
        for mechanism, entry in self.content.mechanisms.items():
            key = "joint" if entry.kind == "pair" else "joints"
            if getattr(entry, "joints" if key == "joint" else "joint") is not None:
                wrong = "joints" if key == "joint" else "joint"
                reason = f"mechanism {mechanism!r} of kind {entry.kind} has {key!r}, not {wrong!r}"
                self.note(("mechanisms", mechanism, wrong), reason)
            names = joints_of(entry)
            if not names:
                reason = f"mechanism {mechanism!r} of kind {entry.kind} has no {key!r}"
                self.note(("mechanisms", mechanism, key), reason)
            for name in names:
                owner = found.setdefault(name, mechanism)
                if owner != mechanism or names.count(name) > 1:
                    reason = f"joint {name!r} is in mechanism {owner!r} already; it can be in one"
                    self.note(("mechanisms", mechanism, key), reason)
        return found

    def _joint(self, name: str, entry: JointEntry) -> Joint | None:
        if entry.id is None:
            reason = "'id' is missing"
            if self.content.mechanisms:
                reason += f", and no mechanism moves joint {name!r}; it needs one of both"
            self.note(("joints", name, "id"), reason)
            return None
        merged = _merge(name, ("joints", name), self.content.defaults, entry)
        if not has_transmission(entry):
            if entry.servo is not None:
                reason = (
                    f"joint {name!r} has neither ratio nor linkage, so its limits are those of its "
                    f"servo; give them to the joint"
                )
                self.note(("joints", name, "servo"), reason)
            return self.built(merged, entry.id, _escalations(entry.on_fault))
        return self.bare(merged, _escalations(entry.on_fault))

    def merged(self, name: str, at: Location, entry: JointDefaults) -> _Merged:
        """Return the fields of an entry with the defaults of the file."""
        return _merge(name, at, self.content.defaults, entry)

    def escalations(self, entry: JointOnFaultEntry) -> Escalations:
        """Return the steps of an entry by cause."""
        return _escalations(entry)

    def _lacks(self, merged: _Merged, keys: Sequence[str]) -> bool:
        """Note the needed keys that are missing; return whether one is."""
        missing = [key for key in keys if key not in merged.fields]
        for key in missing:
            if self._is_checked("defaults", key):
                self.note(
                    (*merged.at, key),
                    f"joint {merged.name!r} has no {key!r}; give it here or under 'defaults'",
                )
        return bool(missing)

    def bare(self, merged: _Merged, on_fault: Escalations) -> Joint | None:
        """Return a joint behind a transmission: with its own limits, and no servo."""
        from lss_motion.robot.servos import OF_JOINT

        name, fields = merged.name, merged.fields
        if self._lacks(merged, _NEEDED[1:]):
            return None
        for key in MODEL_LIMITS:
            if fields[key] == SERVO:
                reason = (
                    f"joint {name!r} stands behind a ratio, linkage or mechanism, so {key} cannot "
                    f"be read from a servo; give a number, in degrees of the joint"
                )
                self.note(merged.place(key), reason)
                return None
        joint = Joint(
            name=name,
            servo_id=NO_SERVO,
            bus="",
            model=SERVO_MODELS[fields.get("model", next(iter(SERVO_MODELS)))],
            position_min_deg=fields["range_deg"][0],
            position_max_deg=fields["range_deg"][1],
            on_fault=on_fault,
            lines={key: self.line(place) for key, place in merged.places.items()},
            **{key: value for key, value in fields.items() if key in OF_JOINT},
        )
        if joint.position_min_deg >= joint.position_max_deg:
            self.note(*next(joint_field_problems(joint, merged.place)))
            return None
        return joint

    def built(self, merged: _Merged, servo_id: int, on_fault: Escalations) -> Joint | None:
        """Return a joint that is its own servo, or a servo of a mechanism."""
        name, fields = merged.name, merged.fields
        lacks = self._lacks(merged, _NEEDED)
        bus = self._bus(name, merged)
        if bus is None or lacks:
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
            servo_id=servo_id,
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
            on_fault=on_fault,
            unread=unread,
            lines={key: self.line(place) for key, place in merged.places.items()},
            **{key: value for key, value in fields.items() if key not in _MADE},
        )
        for location, reason in joint_field_problems(joint, merged.place):
            self.note(location, reason)
        return within_ramps(joint) if joint.drive in ("timed", "auto") else joint

    def _check_pulses(
        self, name: str, model: ServoModel, pulse_us: Sequence[int], merged: _Merged
    ) -> None:
        place = merged.place("pulse_us")
        if model.family is not Family.IO2 and place[0] != "defaults":
            reason = f"joint {name!r}: pulse_us is for an RC servo on an LSS-2IO; remove it"
            self.note(place, reason)
        if pulse_us[0] >= pulse_us[1]:
            reason = (
                f"joint {name!r}: pulse_us must rise, but goes from {pulse_us[0]} to "
                f"{pulse_us[1]}; `direction: -1` turns a servo round"
            )
            self.note(place, reason)

    def _bus(self, name: str, merged: _Merged) -> str | None:
        buses = self.content.buses
        if not self._is_checked("buses") or any(place[0] == "buses" for place in self.left_out):
            return None
        if "bus" not in merged.fields:
            if len(buses) == 1:
                return next(iter(buses))
            self.note(
                (*merged.at, "bus"),
                f"joint {name!r} has no 'bus', and there are several: {', '.join(buses)}",
            )
            return None
        bus = str(merged.fields["bus"])
        if bus not in buses:
            self.note(merged.place("bus"), f"unknown bus {bus!r}; {known_names(bus, buses)}")
            return None
        return bus

    def _check_ids(self, joints: Mapping[str, Joint]) -> None:
        owners: dict[tuple[str, int], str] = {}
        for name, joint in joints.items():
            owner = owners.setdefault((joint.bus, joint.servo_id), name)
            if owner != name:
                self.note(
                    self.id_places.get(name, ("joints", name, "id")),
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
            self.note(("units",), reason)

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
                        self.note(place, f"{word} {pose!r}: unknown joint {name!r}; {known}")
                    elif name in joints and (reason := joints[name].range_problem(angle_deg)):
                        self.note(place, f"{word} {pose!r}: {reason}")


def has_transmission(entry: JointEntry) -> bool:
    """Return whether a joint has a servo of its own and something in between."""
    return entry.ratio is not None or entry.linkage is not None


def joints_of(entry: MechanismEntry) -> list[str]:
    """Return the names of the joints of a mechanism."""
    named = [entry.joint] if entry.kind == "pair" else entry.joints or []
    return [name for name in named if name is not None]


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
