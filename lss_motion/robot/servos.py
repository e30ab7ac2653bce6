"""Joints behind transmissions, and their servos: from the entries of a robot file to values.

A servo of a mechanism is built as a joint of a file without mechanisms is, in degrees of an ideal
servo. Where no limit is given, it is what its joints need at their own limits.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Protocol

from msgspec.structs import replace

from lss_motion.files.texts import counted, known_names
from lss_motion.robot.mechanism import Mechanism
from lss_motion.robot.mechanisms import (
    joint_transmission,
    mechanism_transmission,
    needed_limits,
    reach_deg,
    scaled_joint,
    tolerance_ratio,
    tolerances_deg,
)
from lss_motion.robot.model import NO_SERVO
from lss_motion.robot.on_fault import DEFAULTS, Cause, FaultStep
from lss_motion.robot.servo_models import SERVO_MODELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from lss_motion.files.source import Location
    from lss_motion.robot.file import JointDefaults, JointEntry, MechanismEntry, RobotFile
    from lss_motion.robot.mechanism import MechanismKind
    from lss_motion.robot.model import Joint
    from lss_motion.robot.on_fault import Escalations

JOINT_KEYS: Final = ("jerk_max_deg_s3", "following_deg", "goal_tolerance_deg", "goal_time_s")
"""Keys of a joint that a servo of a mechanism cannot have."""
LIMIT_KEYS: Final = ("range_deg", "speed_max_deg_s", "accel_max_deg_s2")
OF_JOINT: Final = (*LIMIT_KEYS[1:], *JOINT_KEYS)
"""Fields of a joint that mechanisms move; each other key belongs to its servos."""
LOST: Final = (
    *(Cause.SILENT, Cause.RESTARTED, Cause.BLOCKED, Cause.SAFE_MODE, Cause.ERROR),
    Cause.LOST_TURN,
)
"""With one of these, a servo does not do its part: the others of its mechanism must not go on."""
REACH_SLACK_DEG: Final = 1e-6


class MergedFields(Protocol):
    """The fields of an entry and their places; see `robot.load`."""

    fields: dict[str, Any]
    places: dict[str, Location]

    def place(self, name: str) -> Location: ...

    def put(self, key: str, value: object, place: Location) -> None: ...


class JointBuilder(Protocol):
    """What builds joints of entries and notes problems; see `robot.load`."""

    content: RobotFile
    id_places: dict[str, Location]

    def note(self, location: Location, reason: str) -> None: ...

    def merged(self, name: str, at: Location, entry: JointDefaults) -> Any: ...  # noqa: ANN401

    def bare(self, merged: Any, on_fault: Escalations) -> Joint | None: ...  # noqa: ANN401

    def built(
        self,
        merged: Any,  # noqa: ANN401
        servo_id: int,
        on_fault: Escalations,
    ) -> Joint | None: ...

    def escalations(self, entry: Any) -> Escalations: ...  # noqa: ANN401


class ServoLoader:
    """Joints, servos and mechanisms of a robot file; problems go to its builder."""

    def __init__(self, builder: JointBuilder, joints: Mapping[str, Joint], folder: Path) -> None:
        """Build what is behind transmissions; `joints` has all joints with an id of their own."""
        self._builder, self._folder = builder, folder
        self.joints: dict[str, Joint] = dict(joints)
        self.mechanisms: dict[str, Mechanism] = {}
        self._of: dict[str, dict[str, Joint]] = {}
        content = builder.content
        for name, entry in content.joints.items():
            if name in joints and (entry.ratio is not None or entry.linkage is not None):
                self._geared(name, entry)
        for name, mechanism in content.mechanisms.items():
            self._mechanism(name, mechanism)
        order = [name for name in content.joints if name in self.joints]
        self.joints = {name: self.joints[name] for name in order}
        self.servos = self._servos()

    def _servos(self) -> dict[str, Joint]:
        """Return all servos, those of a mechanism where its first joint stands."""
        found: dict[str, Joint] = {}
        by_joint = {name: m for m in self.mechanisms.values() for name in m.joints}
        for name, joint in self.joints.items():
            own = self._of[by_joint[name].name] if name in by_joint else {name: joint}
            if name not in by_joint and joint.servo_id == NO_SERVO:
                continue  # What moves it is wrong.
            found |= {servo: one for servo, one in own.items() if servo not in found}
        return found

    def _geared(self, name: str, entry: JointEntry) -> None:
        """Build the servo of a joint with a ratio or a linkage."""
        joint, at = self.joints[name], ("joints", name)

        def note(keys: tuple[str, ...], reason: str) -> None:
            self._builder.note((*at, *keys), f"joint {name!r}: {reason}")

        ends = joint.position_min_deg, joint.position_max_deg
        transmission, moved = joint_transmission(entry, ends, note)
        if transmission is None:
            return
        kind: MechanismKind = "ratio" if entry.linkage is None else "linkage"
        mechanism = Mechanism(
            name=name,
            kind=kind,
            joints=(name,),
            servos=(name,),
            transmission=transmission,
            moved_deg=moved,
        )
        merged = self._builder.merged(name, at, entry)
        for key in (*LIMIT_KEYS, *JOINT_KEYS):
            merged.fields.pop(key, None)
        for key, value in ({} if entry.servo is None else entry.servo.known()).items():
            merged.put(key, value, (*at, "servo", key))
        assert entry.id is not None
        on_fault = self._builder.escalations(entry.on_fault)
        self._add(mechanism, [(merged, entry.id, on_fault)], at)

    def _mechanism(self, name: str, entry: MechanismEntry) -> None:
        at = ("mechanisms", name)

        def note(keys: tuple[str, ...], reason: str) -> None:
            self._builder.note((*at, *keys), f"mechanism {name!r}: {reason}")

        if name in self._builder.content.joints:
            note((), "a joint has this name; the names of joints and mechanisms differ")
        names = [entry.joint] if entry.kind == "pair" else entry.joints or []
        moved = [self._moved(one, name, entry) for one in names if one is not None]
        joints = [joint for joint in moved if joint is not None]
        if not joints or len(joints) < len(moved):
            return
        self.joints |= {joint.name: joint for joint in joints}
        transmission = mechanism_transmission(entry, joints, self._folder, note)
        on_fault = self._builder.escalations(entry.on_fault)
        for cause, steps in on_fault.items():
            if cause in LOST and {FaultStep.WARN, FaultStep.SLOW} & {*steps}:
                note(
                    ("on_fault", str(cause)),
                    f"the servos of a mechanism cannot go on without one of them; on "
                    f"{str(cause)!r} they resume, hold or limp",
                )
        own = [self._servo(name, short, one, note, on_fault) for short, one in entry.servos.items()]
        if transmission is None:
            return
        mechanism = Mechanism(
            name=name,
            kind=entry.kind,
            joints=tuple(joint.name for joint in joints),
            servos=tuple(f"{name}.{short}" for short in entry.servos),
            transmission=transmission,
        )
        self._add(mechanism, own, at)

    def _moved(self, name: str, mechanism: str, entry: MechanismEntry) -> Joint | None:
        """Return a joint that a mechanism moves; None: its entry is wrong, and that is noted."""
        builder, entries = self._builder, self._builder.content.joints
        if name not in entries:
            key = "joint" if entry.kind == "pair" else "joints"
            known = known_names(name, entries)
            reason = f"mechanism {mechanism!r}: unknown joint {name!r}; {known}"
            builder.note(("mechanisms", mechanism, key), reason)
            return None
        own, at = entries[name], ("joints", name)
        wrong = sorted(own.given - {"range_deg", "on_fault", *OF_JOINT})
        for key in wrong:
            builder.note(
                (*at, key),
                f"joint {name!r} is moved by mechanism {mechanism!r}, whose servos have {key!r}; "
                f"give it there, or take the joint out of the mechanism",
            )
        if wrong:
            return None
        merged = builder.merged(name, at, own)
        return builder.bare(merged, builder.escalations(own.on_fault))

    def _servo(
        self,
        mechanism: str,
        short: str,
        entry: Any,  # noqa: ANN401
        note: Any,  # noqa: ANN401
        on_fault: Escalations,
    ) -> tuple[Any, int, Escalations]:
        """Return the fields of a servo of a mechanism, its id and what is done on faults."""
        name, at = f"{mechanism}.{short}", ("mechanisms", mechanism, "servos", short)
        self._builder.id_places[name] = (*at, "id")
        if name in self._builder.content.joints:
            note(("servos", short), f"a joint has the name of this servo, {name!r}; rename one")
        for key in JOINT_KEYS:
            if key in entry.given:
                note(("servos", short, key), f"{key} belongs to the joint, not to a servo")
        merged = self._builder.merged(name, at, entry)
        for key in (*LIMIT_KEYS, *JOINT_KEYS):
            if merged.places.get(key, at)[0] == "defaults":
                merged.fields.pop(key, None)
        # What the show or the robot say for all does not count here: one cannot go on alone.
        fixed = {cause: DEFAULTS[cause] for cause in LOST}
        return merged, entry.id, {**fixed, **on_fault}

    def _add(
        self,
        mechanism: Mechanism,
        own: Sequence[tuple[Any, int, Escalations]],
        at: Location,
    ) -> None:
        """Build the servos of a mechanism with the limits that its joints leave them."""
        joints = [self.joints[name] for name in mechanism.joints]
        needed, reached = needed_limits(mechanism, joints), reach_deg(mechanism, joints)
        offs, ratio = tolerances_deg(mechanism, joints), tolerance_ratio(mechanism, joints)
        servos: dict[str, Joint] = {}
        rows = zip(mechanism.servos, own, needed, reached, offs, strict=True)
        for name, (merged, servo_id, on_fault), (speed, accel), reach, (path, goal) in rows:
            if not self._may_reach(name, merged, reach, mechanism):
                return
            model = SERVO_MODELS.get(merged.fields.get("model", ""))
            if model is None:
                self._builder.note((*at, "model"), f"servo {name!r} has no 'model'")
                return
            for key, need, most in (
                ("speed_max_deg_s", speed, model.speed_max_deg_s),
                ("accel_max_deg_s2", accel, model.accel_max_deg_s2),
            ):
                given = merged.fields.get(key, most)
                if isinstance(given, str):
                    reason = f"servo {name!r}: {key} of a servo of a mechanism must be a number"
                    self._builder.note(merged.place(key), reason)
                    return
                # More than the model can do is refused where the servo is built.
                used = given if given > most else min(need, given)
                merged.put(key, used, merged.places.get(key, at))
            merged.places.setdefault("range_deg", (*at, "servos"))
            merged.fields.setdefault("range_deg", reach)
            servo = self._builder.built(merged, servo_id, on_fault)
            if servo is None:
                return
            servos[name] = replace(
                servo,
                tolerance_ratio=ratio,
                is_shared=mechanism.is_redundant,
                following_deg=path,
                goal_tolerance_deg=goal,
                goal_time_s=joints[0].goal_time_s,
            )
        if not self._are_alike(mechanism, servos, at):
            return
        if mechanism.is_scaled:
            name = mechanism.joints[0]
            self.joints[name] = scaled_joint(mechanism, joints[0], servos.values())
        first = next(iter(servos.values()))
        for name in mechanism.joints:
            own_id = first.servo_id if mechanism.servos == (name,) else self.joints[name].servo_id
            self.joints[name] = replace(
                self.joints[name], model=first.model, bus=first.bus, servo_id=own_id
            )
        self.mechanisms[mechanism.name] = mechanism
        self._of[mechanism.name] = servos

    def _may_reach(
        self,
        name: str,
        merged: MergedFields,
        reach: tuple[float, float],
        mechanism: Mechanism,
    ) -> bool:
        """Return whether a servo may go where its only joint takes it; note it if not."""
        given = merged.fields.get("range_deg")
        if given is None or len(mechanism.joints) > 1:
            return True
        if given[0] <= reach[0] + REACH_SLACK_DEG and given[1] >= reach[1] - REACH_SLACK_DEG:
            return True
        joint = self.joints[mechanism.joints[0]]
        self._builder.note(
            merged.place("range_deg"),
            f"joint {joint.name!r} from {joint.position_min_deg:g} to {joint.position_max_deg:g} "
            f"deg takes servo {name!r} from {reach[0]:.1f} to {reach[1]:.1f} deg, outside of its "
            f"range_deg, {given[0]:g} to {given[1]:g}; reduce the range of the joint",
        )
        return False

    def _are_alike(self, mechanism: Mechanism, servos: Mapping[str, Joint], at: Location) -> bool:
        """Return whether servos that can fight each other are driven alike; note it if not."""
        if not mechanism.is_redundant:
            return True
        first, *others = servos.values()
        for other in others:
            for key in ("model", "bus", "drive", "filter_count", "speed_max_deg_s", "response"):
                if getattr(first, key) != getattr(other, key):
                    self._builder.note(
                        (*at, "servos", other.name.rpartition(".")[2]),
                        f"mechanism {mechanism.name!r} has {counted(servos, 'servo')} for "
                        f"{counted(mechanism.joints, 'joint')}, which must move alike, but {key} "
                        f"of {other.name!r} differs from that of {first.name!r}",
                    )
                    return False
        if first.drive == "auto" or not math.isfinite(first.speed_max_deg_s):
            reason = f"mechanism {mechanism.name!r}: drive auto may differ between servos; name one"
            self._builder.note((*at, "servos"), reason)
            return False
        return True
