"""The values of a robot: buses, joints, limits and poses.

They are immutable. `robot.load` makes them from files.
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import ClassVar, Final, Literal

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.source import Located
from lss_motion.files.texts import counted
from lss_motion.protocol.codec import Language
from lss_motion.protocol.constants import Family
from lss_motion.protocol.lss_pro import PRO_FIRMWARE, UNITS, Units
from lss_motion.robot.figure import Figure
from lss_motion.robot.mechanism import Mechanism
from lss_motion.robot.on_fault import DEFAULTS, Cause, Escalations, FaultStep

FOLLOWING_DEG: Final = 10.0
"""Chosen: ten times the position error of a healthy joint, and small enough to avoid collisions."""
TEMPERATURE_MAX_C: Final = 75.0
"""Chosen: ten degrees below the safe mode of an LSS (FACTS.md S7)."""
VOLTAGE_MIN_V: Final = 6.0
"""The lowest voltage of an LSS (FACTS.md E4); no document gives it for an LSS-PRO."""
SUPPLY_V: Final = 12.0
"""The nominal voltage of an LSS, at which its data sheet holds (FACTS.md E4)."""
SILENT_S: Final = 1.0
"""Chosen: shorter than the 1.25 s for which a restarting servo receives nothing, so that a restart
is detected before the servo is driven without its settings; long enough for a line that loses every
third reply."""
READING_RATE_MIN_HZ: Final = 2.0
"""Chosen: two polls before a joint counts as silent (`SILENT_S`)."""
GOAL_TIME_S: Final = 1.0
"""Chosen: a servo has settled after 0.15 s; more is a load that it carries slowly to its place."""
PATIENCE_S: Final = 3.0
"""Chosen: at a tenth of the speed a joint catches up with a heavy move in this time."""
RESUME_S: Final = 10.0
"""Chosen: time to push a plug back in. Later, a person may have reached into the robot."""

NO_SERVO: Final = -1
"""The servo id of a joint without a servo of its own: a mechanism moves it."""

SERVO: Final = "servo"
"""In place of a limit in a robot file: the limit that is set in the servo."""

Drive = Literal["timed", "streamed", "stepped"]
"""How a joint is commanded (FACTS.md M1): `D…T…` in EM1; bare `D` through the filter of EM0; whole
degrees to the RC servo of a 2IO."""

Turns = Literal["by_hand", "powered"]
"""How the turn of a servo is known after power-up, where its range is more than one turn: a person
brings it within half a turn of its zero, or it keeps its power, and so its count of turns."""
RAMP_PER_STIFFNESS_RATIO: Final = 1.1
"""One step of AS makes the ramps so many times those of AA and AD. A stiffer servo reaches its
travel speed sooner and brakes harder (FACTS.md M24); the amount is assumed."""
HALF_TURN_DEG: Final = 180.0
"""After power-up a servo reports an angle within half a turn of its zero (FACTS.md R5). Turns are
360 deg apart, so a horn that seems to be further away than this is in another one."""


class Response(Struct, frozen=True, kw_only=True):
    """What is assumed of a servo between the command and the horn. Every field is an assumption.

    `lag_s`        the horn follows the servo's own profile this much later
    `loop_s`       the servo starts a command at its next control tick (5 ms: maker's staff)
    `filter_s`     in EM0 the filter steps this often (20 ms, four ticks: maker's staff). The phase
                   of its steps cannot be observed, so half a period is assumed
    `ramp_ratio`   its ramps are this many times those of AA and AD; the sources for their unit,
                   10 deg/s², are weak (FACTS.md M20)
    `retarget`     a new `D…T…` in mid-move starts from the profile's position and speed
                   (`keep_speed`) or from rest (`from_rest`); it is not documented (FACTS.md A10)
    `t_law`        `cruise`: travel speed = distance / T, so the ramps come on top;
                   `exact`: the whole move takes T
    """

    lag_s: float = 0.02
    loop_s: float = 0.005
    filter_s: float = 0.02
    ramp_ratio: float = 1.0
    retarget: Literal["keep_speed", "from_rest"] = "keep_speed"
    t_law: Literal["cruise", "exact"] = "cruise"


class ServoModel(Struct, frozen=True, kw_only=True):
    """One row of the table of servo models (`robot.servo_models`)."""

    name: str
    family: Family
    speed_max_deg_s: float
    """No-load top speed; a joint's configured limit must not exceed it."""
    wire_per_deg: float
    """Position units on the wire per degree: 10 (LSS, tenths), 100 (LSS-PRO, hundredths), 10 or a
    fraction (2IO, by the range of the RC servo's pulses)."""
    wire_step: int = 1
    """A target is a multiple of so many wire units: 10 for a 2IO, which has whole degrees only."""
    accel_step_deg_s2: float = 10.0
    """The unit of AA and AD; 0 for a servo without ramps."""
    accel_max_deg_s2: float = 1000.0
    """The largest acceleration that AA and AD can express."""
    units: Units = UNITS
    """The units on the wire of an LSS-PRO."""

    @property
    def language(self) -> Language:
        """What the tables of `protocol.codec` are found with."""
        return Language(self.family, self.units)


class Bus(Struct, frozen=True, kw_only=True):
    """One serial line. `port` is what `system.devices.opened_name` allows, or `sim://`."""

    name: str
    port: str
    baud_bps: int
    firmware: int
    reading_rate_min_hz: float = READING_RATE_MIN_HZ
    """Each joint of a show must be polled at least so often between its commands."""
    pro_firmware: int = PRO_FIRMWARE
    """Firmware of the LSS-PRO servos on it: the same where the robot file states one."""

    @property
    def is_simulated(self) -> bool:
        """Whether its servos are simulated in this process."""
        return self.port.startswith("sim://")

    def firmware_of(self, family: Family) -> int:
        """Return the firmware that its servos of a family are taken to have."""
        return self.pro_firmware if family is Family.LSS_PRO else self.firmware


class Joint(Located, frozen=True, kw_only=True):
    """One servo with its name, limits, direction and zero.

    Joint angle and servo angle: `servo_deg = zero_deg + direction * joint_deg`.
    """

    _where: ClassVar = frozenset({"lines"})
    name: str
    servo_id: int
    bus: str
    model: ServoModel
    position_min_deg: float
    position_max_deg: float
    speed_max_deg_s: float
    accel_max_deg_s2: float
    jerk_max_deg_s3: float = math.inf
    """Largest change of the acceleration in a second; infinite: the acceleration may jump."""
    unread: frozenset[str] = frozenset()
    """Limits that are set in the servo and were not read yet. Until they are, they have the largest
    value of the model, and `plan` refuses the joint."""
    direction: Literal[1, -1] = 1
    zero_deg: float = 0.0
    following_deg: float = FOLLOWING_DEG
    """Path tolerance: above this position error the joint is astray."""
    goal_tolerance_deg: float | None = None
    """Largest position error where the show ends; None: the path tolerance."""
    goal_time_s: float = GOAL_TIME_S
    """How long after its end the show waits until the joint is within its goal tolerance."""
    temperature_max_c: float = TEMPERATURE_MAX_C
    voltage_min_v: float = VOLTAGE_MIN_V
    silent_s: float = SILENT_S
    """Without a reply to queries for so long, its servo is silent."""
    on_fault: Escalations = field(default_factory=dict)
    """Escalations of this joint, in place of those of its show and its robot."""
    settings: Mapping[str, int] = field(default_factory=dict)
    """Session settings to send before playing, such as `{"AS": -2}`; wire values."""
    stored: Mapping[str, float | None] = field(default_factory=dict)
    """What `lss-motion configure` writes into the servo, such as `{"O": 2.5}`: by the name of the
    setting in the family's table, in its unit; None: no first position."""
    response: Response = field(default_factory=Response)
    turns: Turns | None = None
    """How the turn of its servo is known; None: its range is within half a turn of 0."""
    drive: Drive | Literal["auto"] = "timed"
    filter_count: int = 4
    """FPC of a streamed joint. Chosen: see `planning.program.streamed`."""
    tolerance_ratio: float = 1.0
    """A servo of a mechanism may be off its plan by so many times what its joints may: as far as
    they stay within that everywhere in their ranges."""
    is_shared: bool = False
    """One of several servos of one joint: it gets no correction of its own, with which it would
    work against the others."""
    filter_phase_ratio: float = 0.0
    """When in its period the filter of a streamed joint is assumed to step (`verify.driven`)."""
    lines: Mapping[str, int] = field(default_factory=dict)
    """The line of each field in the robot file."""

    @property
    def unit_deg(self) -> float:
        """The smallest difference between two targets."""
        return self.model.wire_step / self.model.wire_per_deg

    @property
    def ramp_ratio(self) -> float:
        """The ramps of its servo are this many times AA and AD, with the AS that is in force."""
        stored = self.stored.get("AS") or 0.0
        stiffness = self.settings.get("AS", stored) if self.model.family is Family.LSS else 0.0
        return float(self.response.ramp_ratio * RAMP_PER_STIFFNESS_RATIO**stiffness)

    @property
    def goal_deg(self) -> float:
        """The goal tolerance."""
        own = self.goal_tolerance_deg
        return self.following_deg if own is None else own

    def servo_deg(self, joint_deg: float) -> float:
        """Return the servo angle of a joint angle."""
        return self.zero_deg + self.direction * joint_deg

    def within_deg(self, joint_deg: float) -> float:
        """Return the joint angle within the range that is nearest to an angle."""
        return min(max(joint_deg, self.position_min_deg), self.position_max_deg)

    @property
    def servo_range_deg(self) -> tuple[float, float]:
        """Least and largest servo angle of the range."""
        ends = (self.servo_deg(self.position_min_deg), self.servo_deg(self.position_max_deg))
        return min(ends), max(ends)

    def joint_deg(self, servo_deg: float) -> float:
        """Return the joint angle of a servo angle."""
        return self.direction * (servo_deg - self.zero_deg)

    def turns_problem(self) -> str:
        """Return why the turn of the servo is unknown after power-up; an empty text if it is not.

        A servo that does not know its turn takes the way through the other turns.
        """
        ends_deg = map(self.servo_deg, (self.position_min_deg, self.position_max_deg))
        far_deg = max(ends_deg, key=abs)
        if self.turns is not None or abs(far_deg) <= HALF_TURN_DEG or self.drive == "stepped":
            return ""
        return (
            f"joint {self.name!r}: its range of {self.position_min_deg:g} to "
            f"{self.position_max_deg:g} deg takes the servo to {far_deg:g} deg. After power-up a "
            f"servo reports an angle within 180 deg of its zero, so it would be unknown in which "
            f"turn it is. Shift the zero of the servo so that the range fits (`stored: {{O: …}}`, "
            f"then calibrate), reduce range_deg, or state how the turn is known: `turns: by_hand` "
            f"(a person brings the joint within 180 deg of the zero before power-up) or `turns: "
            f"powered` (the servo keeps its power between shows)"
        )

    def range_problem(self, joint_deg: float) -> str:
        """Return why `joint_deg` is not allowed; an empty text if it is."""
        if self.position_min_deg <= joint_deg <= self.position_max_deg:
            return ""
        return (
            f"joint {self.name!r} at {joint_deg:g} deg is outside its range, "
            f"{self.position_min_deg:g} to {self.position_max_deg:g} deg"
        )


class Sensor(Struct, frozen=True, kw_only=True):
    """One analog input of an LSS-2IO, which is read with `QA`.

    `kind` is `raw` (0 to 1023), or the model of the distance sensor at that input; the board
    converts its readings to millimetres.
    """

    name: str
    servo_id: int
    bus: str
    kind: str = "raw"

    @property
    def unit(self) -> Literal["raw", "mm"]:
        """The unit of its readings."""
        return "raw" if self.kind == "raw" else "mm"


class Supply(Struct, frozen=True, kw_only=True):
    """What feeds all servos of a robot, as far as its robot file says."""

    voltage_v: float = SUPPLY_V
    current_max_a: float | None = None
    """What it gives without a dip of its voltage; None: not known."""


class UrdfSource(Located, frozen=True, kw_only=True):
    """The URDF file of a robot, as its robot file names it; it is read where it is drawn."""

    _where: ClassVar = frozenset({"lines"})
    path: Path
    robot_path: Path
    """The robot file; nothing outside of its folder is read."""
    joints: Mapping[str, str]
    """The joint of the URDF file for each joint of the robot, where the names differ."""
    lines: Mapping[str, int] = field(default_factory=dict)
    """The line of each of `joints` in the robot file, and of `file` (an empty name)."""


class Robot(Struct, frozen=True, kw_only=True):
    """Buses and joints by name, in the order of the file, and the named poses."""

    name: str
    path: Path | None
    buses: Mapping[str, Bus]
    joints: Mapping[str, Joint]
    mechanisms: Mapping[str, Mechanism] = field(default_factory=dict)
    """What stands between joints and servos, by name; joints in none of them are their servos."""
    servos: Mapping[str, Joint] = field(default_factory=dict)
    """The servos of a robot with mechanisms, as joints in degrees of an ideal servo; else empty."""
    poses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    visemes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Mouth shapes by name, for lip-sync files."""
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Joints by the name of their group, such as `head` or `left_arm`."""
    mirror: Mapping[str, tuple[str, Literal[1, -1]]] = field(default_factory=dict)
    """For each joint its mirror image and the sign of the angle there."""
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    approach_speed_deg_s: float = 30.0
    sound_offset_s: float = 0.0
    """Sounds sound this much later than the show."""
    end: Literal["hold", "limp"] = "hold"
    read_limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Limits by joint and name that were read from the servos, as the file requires (`servo`)."""
    on_fault: Escalations = field(default_factory=dict)
    patience_s: float = PATIENCE_S
    """How long a fault may last on one step of its escalation before the next is taken."""
    resume_s: float = RESUME_S
    """Longest wait for a lost port or a silent servo."""
    figure: Figure | None = None
    """What it looks like, for pictures; no motion depends on it."""
    urdf: UrdfSource | None = None
    """A URDF file in place of `figure`: `robot.urdf` reads it."""
    supply: Supply = field(default_factory=Supply)

    def identify_command(self, name: str) -> str:
        """Return the command line that measures a joint."""
        file = "FILE" if self.path is None else shlex.quote(str(self.path))
        return f"lss-motion identify {name} --robot {file}"

    def __repr__(self) -> str:
        """Return one line: name and counts."""
        counts = f"{counted(self.joints, 'joint')}, {counted(self.buses, 'bus', 'buses')}"
        return f"Robot({self.name!r}, {counts}, {counted(self.poses, 'pose')})"

    @property
    def servo_robot(self) -> Robot:
        """The robot whose joints are the servos of this one; itself where there is no mechanism.

        Bytes, ports and everything that asks servos know only servos. Its mechanisms stay known:
        they say which servos move together.
        """
        if not self.servos:
            return self
        return replace(
            self, joints=self.servos, servos={}, poses={}, visemes={}, groups={}, mirror={}
        )

    def together(self, servo: str) -> tuple[str, ...]:
        """Return the servos of the mechanism of a servo, which go limp together."""
        own = (m.servos for m in self.mechanisms.values() if servo in m.servos)
        return next(own, (servo,))

    def require_servos(self, what: str = "this command") -> None:
        """Raise `InputError` if joints are not servos, for `what`, which knows servos only."""
        if self.servos:
            raise InputError(
                f"robot {self.name!r} has joints behind a ratio, a linkage or a mechanism "
                f"({', '.join(self.mechanisms)}), with which {what} cannot work yet; nothing was "
                f"sent to a servo",
                path=self.path,
            )

    @property
    def unread(self) -> list[Joint]:
        """The joints with a limit that is set in the servo and was not read yet."""
        return [joint for joint in self.joints.values() if joint.unread]

    def approach_deg_s(self, joint: Joint) -> float:
        """Return the speed at which a joint is led to where a show starts, or moved by hand."""
        return min(self.approach_speed_deg_s, joint.speed_max_deg_s)

    def require_turns(self, joints: Iterable[Joint]) -> None:
        """Raise `InputError` for the first joint whose turn is unknown after power-up."""
        for joint in joints:
            if problem := joint.turns_problem():
                raise InputError(problem, path=self.path, line=joint.lines.get("range_deg"))

    def escalation(
        self, cause: Cause, joint: Joint | None, show: Escalations
    ) -> tuple[FaultStep, ...]:
        """Return the steps for `cause`: of joint, else show, else robot, else the default."""
        own: Escalations = {} if joint is None else joint.on_fault
        return next(
            given[cause] for given in (own, show, self.on_fault, DEFAULTS) if cause in given
        )


def learnt_path(robot_path: Path) -> Path:
    """Return the path of what `robot.learnt` keeps about the robot of a robot file."""
    return robot_path.with_name(f"{robot_path.stem}.learnt.yaml")
