"""The keys of a robot file, and of `on_fault` in sequence files: names, units, bounds of each key.

`robot.load` checks what several keys mean together. The descriptions are the reference of the file
format.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

from lss_motion.files.keys import (
    FILE_VERSION,
    VERSION,
    Check,
    Field,
    FileModel,
    Name,
    Plain,
    Text,
    Version,
    check_text,
)
from lss_motion.files.texts import known_names
from lss_motion.protocol.lss_pro import (
    ACCEL_DEG_S2,
    OFFSET_DEG,
    POSITION_DEG,
    SPEED_DEG_S,
    WHEEL_DEG_S,
)
from lss_motion.robot.figure_file import FIGURE_LINKS_MAX, FigureLinkEntry, UrdfEntry
from lss_motion.robot.linkage_file import PATH_MAX_CHARS, AngleDeg, LinkageEntry, Ratio
from lss_motion.robot.model import (
    GOAL_TIME_S,
    PATIENCE_S,
    READING_RATE_MIN_HZ,
    RESUME_S,
    SERVO,
    SILENT_S,
    SUPPLY_V,
    TEMPERATURE_MAX_C,
    VOLTAGE_MIN_V,
)
from lss_motion.robot.on_fault import Cause, Escalations, FaultStep, escalation_problem
from lss_motion.robot.servo_models import BAUD_FIRMWARE_MIN, SERVO_ID_MAX, SERVO_MODELS

if TYPE_CHECKING:
    from collections.abc import Callable


SPEED_MIN_DEG_S: Final = 0.1
"""The unit of SD on the wire (FACTS.md C24: tenths of a degree per second)."""

FILTER_COUNT_MAX: Final = 20
"""The largest FPC that is known to be used (FACTS.md M10)."""

JERK_MIN_DEG_S3: Final = 1.0
JERK_MAX_DEG_S3: Final = 1e6
"""More than 1e6 is 1000 deg/s² in a millisecond, a jump; less than 1 never moves."""

ACCEL_MIN_DEG_S2: Final = 0.1
"""A hundredth of the smallest ramp of a servo; less is a typing error."""


def _check_escalation(
    value: Any,  # noqa: ANN401  (YAML)
    key: str,
) -> tuple[FaultStep, ...]:
    words = value if isinstance(value, list) else [value]
    if problem := escalation_problem(key, words):
        raise ValueError(problem)
    return tuple(map(FaultStep, words))


_WORD = {"enum": [step.value for step in FaultStep]}
Escalation = Annotated[
    tuple[FaultStep, ...] | None,
    Plain(_check_escalation, {"anyOf": [_WORD, {"type": "array", "items": _WORD, "minItems": 1}]}),
]


class JointOnFaultEntry(FileModel, title="on_fault of a joint"):
    """What is done when something is wrong with a joint: one step, or a list of steps.

    The next step of a list is taken when the fault has lasted patience_s. warn: show a warning; a
    servo that is silent or has restarted is sent no move until it replies and has its settings
    again (restarted: resume). slow: slow the show for all joints until this one has caught up.
    resume: brake, wait until the servo replies, return to the position and continue. hold: brake
    and end the show. limp: switch this joint limp, and end the show.
    """

    astray: Escalation = Field(
        default=None, description="Its position error is above following_deg. [slow, hold]"
    )
    stuck: Escalation = Field(
        default=None,
        description="It reports that it cannot move at this speed. [slow, hold]",
    )
    blocked: Escalation = Field(default=None, description="It cannot move at full power. [hold]")
    safe_mode: Escalation = Field(default=None, description="It protects itself. [hold]")
    error: Escalation = Field(default=None, description="It reports an error (LSS-PRO). [hold]")
    hot: Escalation = Field(default=None, description="Above temperature_max_c. [warn]")
    low_voltage: Escalation = Field(default=None, description="Below voltage_min_v. [warn]")
    restarted: Escalation = Field(
        default=None, description="The servo is limp, or has lost its settings. [resume, hold]"
    )
    silent: Escalation = Field(
        default=None, description="No reply to queries for silent_s. [resume, hold]"
    )
    lost_turn: Escalation = Field(
        default=None,
        description="It reports an angle more than half a turn from where it was: it has restarted "
        "in another turn, and is not driven. Only hold or limp. [hold]",
    )


class OnFaultEntry(JointOnFaultEntry, title="on_fault"):
    """The same for all joints. That of a joint comes first, then of the show, then of the robot."""

    lost_port: Escalation = Field(default=None, description="A port is lost. [resume, hold]")
    stalled: Escalation = Field(
        default=None,
        description="This program was held up for more than 0.25 s while a move was due: process "
        "stopped, computer asleep or too slow. [resume, hold]",
    )
    sound: Escalation = Field(
        default=None,
        description="A sound of the show cannot be played, or its device is gone: warn, or hold "
        "(also before anything moves). [warn]",
    )


def escalations(entry: JointOnFaultEntry) -> Escalations:
    """Return the escalations of an entry by cause."""
    return {Cause(key): value for key, value in entry.known().items()}


def _check_model(name: str) -> str:
    if name not in SERVO_MODELS:
        raise ValueError(f"is not a known model; {known_names(name, SERVO_MODELS)}")
    return name


def _check_direction(direction: int) -> int:
    if direction not in {1, -1}:
        raise ValueError("must be 1 or -1")
    return direction


def _check_limit(least: float) -> Callable[[object, str], object]:
    def check(limit: object, _key: str) -> object:
        if limit is None or limit == SERVO:
            return limit
        if (
            isinstance(limit, int | float)
            and not isinstance(limit, bool)
            and least <= limit < math.inf
        ):
            return limit
        raise ValueError(f"must be a number, {least:g} or more, or `{SERVO}`")

    return check


def _limit_schema(least: float) -> dict[str, Any]:
    return {"anyOf": [{"type": "number", "minimum": least}, {"const": SERVO}]}


def _check_baud(baud_bps: int) -> int:
    if baud_bps not in BAUD_FIRMWARE_MIN:
        raise ValueError(f"must be one of {', '.join(map(str, BAUD_FIRMWARE_MIN))}")
    return baud_bps


PortUrl = Annotated[str, Field(min_length=1, max_length=PATH_MAX_CHARS), Check(check_text)]
SpeedLimit = Annotated[
    float | str | None,
    Plain(_check_limit(SPEED_MIN_DEG_S), _limit_schema(SPEED_MIN_DEG_S)),
]
AccelLimit = Annotated[
    float | str | None,
    Plain(_check_limit(ACCEL_MIN_DEG_S2), _limit_schema(ACCEL_MIN_DEG_S2)),
]
PulseUs = Annotated[int, Field(ge=100, le=5000)]


class BusEntry(FileModel, title="bus"):
    """One serial line with servos on it."""

    port: PortUrl = Field(
        default="sim://",
        description="Serial device; sim:// is the built-in simulated bus. Also socket://HOST:PORT, "
        "rfc2217://HOST:PORT, and hwgrep://TEXT for a USB device by its name or numbers.",
        examples=["sim://", "/dev/ttyUSB0", "COM3"],
    )
    baud_bps: Annotated[int, Check(_check_baud)] = Field(
        default=115200,
        description="What the servos are set to. 750000 and 921600 need firmware 369 or later.",
        json_schema_extra={"enum": list(BAUD_FIRMWARE_MIN)},
    )
    firmware: int | None = Field(
        default=None,
        ge=1,
        le=999,
        description="Firmware of the servos (QF). Default 370, and 780 for LSS-PRO servos.",
    )
    reading_rate_min_hz: float = Field(
        default=READING_RATE_MIN_HZ,
        ge=0.0,
        le=1000.0,
        description="Each joint must be polled at least so often between the commands of a show.",
    )


class ResponseEntry(FileModel, title="response"):
    """What is assumed of a servo between command and horn; `lss-motion identify` measures it."""

    lag_s: float | None = Field(
        default=None,
        ge=0.0,
        le=1.0,
        description="The horn follows the servo's profile this much later.",
    )
    loop_s: float | None = Field(
        default=None, gt=0.0, le=0.1, description="Period of the servo's control loop."
    )
    ramp_ratio: float | None = Field(
        default=None,
        ge=0.1,
        le=10.0,
        description="The ramps of the servo are this many times those of AA and AD.",
    )
    retarget: Literal["keep_speed", "from_rest"] | None = Field(
        default=None, description="Speed at which a command during a move starts."
    )
    filter_s: float | None = Field(
        default=None, gt=0.0, le=0.1, description="Period of the filter of a streamed servo."
    )
    t_law: Literal["cruise", "exact"] | None = Field(
        default=None,
        description="cruise: the travel speed is distance / T, ramps come on top. "
        "exact: the whole move takes T.",
    )


class JointDefaults(FileModel, title="joint defaults"):
    """Fields that joints share. Values of a joint come first; settings and response are merged."""

    bus: Name | None = Field(
        default=None, description="Name of the bus; may be left out where there is only one."
    )
    model: Annotated[str, Check(_check_model)] | None = Field(
        default=None, description="Servo model.", json_schema_extra={"enum": list(SERVO_MODELS)}
    )
    range_deg: Annotated[list[AngleDeg], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="Least and largest joint angle that the mechanics allow.",
        examples=[[-90, 90]],
    )
    speed_max_deg_s: SpeedLimit = Field(
        default=None,
        description="Never move faster, in degrees per second. servo: what the servo is set to "
        "(SD); it is read from the servo, or from --robot-cache.",
    )
    accel_max_deg_s2: AccelLimit = Field(
        default=None,
        description="Never speed up or brake harder; 10 to 1000 in steps of 10 (rounded down), "
        "which is all that the ramps (AA, AD) of an LSS can express; an LSS-PRO has steps of 0.01. "
        "servo: what those are set to.",
    )
    jerk_max_deg_s3: float | None = Field(
        default=None,
        ge=JERK_MIN_DEG_S3,
        le=JERK_MAX_DEG_S3,
        description="The acceleration of planned motion never changes faster than this, in degrees "
        "per second cubed, for heads and cameras that must not shake; accel_max_deg_s2 divided by "
        "0.1 s is a good start. Default: no limit, the acceleration may jump. Not for a robot that "
        "is steered while it walks.",
        examples=[6000],
    )
    direction: Annotated[int, Check(_check_direction)] | None = Field(
        default=None,
        description="-1 where the servo turns the other way: "
        "servo angle = zero_deg + direction * joint angle. Default 1.",
        json_schema_extra={"enum": [1, -1]},
    )
    zero_deg: AngleDeg | None = Field(
        default=None, description="Servo angle where the joint angle is 0. Default 0."
    )
    pulse_us: Annotated[list[PulseUs], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="RC servo on an LSS-2IO: its pulses at -90 and +90 degrees, as its data sheet "
        "has them; many have [500, 2500]. Default [544, 2400], the range of the board.",
        examples=[[500, 2500]],
    )
    turns: Literal["by_hand", "powered"] | None = Field(
        default=None,
        description="How the turn is known after power-up, where the range takes the servo further "
        "than 180 degrees from its zero; without it, such a joint is not played. by_hand: a person "
        "brings it within 180 degrees before power-up. powered: the servo keeps its power.",
    )
    following_deg: float | None = Field(
        default=None,
        gt=0.0,
        le=360.0,
        description="Path tolerance: above this position error, a joint is `astray` (see "
        "on_fault). Default 10.",
    )
    goal_tolerance_deg: float | None = Field(
        default=None,
        gt=0.0,
        le=360.0,
        description="Goal tolerance: a joint that is further from its last key when the show ends, "
        "and stays so for goal_time_s, is `astray`, and the show has not finished. Default: "
        "following_deg.",
    )
    goal_time_s: float | None = Field(
        default=None,
        ge=0.0,
        le=60.0,
        description="Longest wait after the show until a joint is within its goal tolerance. "
        f"Default {GOAL_TIME_S:g}.",
    )
    temperature_max_c: float | None = Field(
        default=None,
        ge=20.0,
        le=150.0,
        description=f"Above this, a servo is `hot` (see on_fault). Default {TEMPERATURE_MAX_C:g}.",
    )
    voltage_min_v: float | None = Field(
        default=None,
        ge=0.0,
        le=60.0,
        description="Below this, there is `low_voltage` (see on_fault). "
        f"Default {VOLTAGE_MIN_V:g}.",
    )
    silent_s: float | None = Field(
        default=None,
        ge=0.2,
        le=60.0,
        description="Without a reply to queries for so long, a servo is `silent` (see on_fault). "
        f"Default {SILENT_S:g}; a servo that restarts receives nothing for 1.25 s.",
    )
    settings: dict[str, int] | None = Field(
        default=None,
        description="Session settings sent before playing, as wire values.",
        examples=[{"AS": -2, "AH": 3}],
    )
    stored: dict[str, float | Literal["DIS"]] | None = Field(
        default=None,
        description="Settings that the servo stores, for `lss-motion configure`: by keyword, "
        "in the units of `lss-motion reference`; DIS switches a first position off. Playing "
        "neither reads nor writes them.",
        examples=[{"G": -1, "O": 2.5, "AS": 0, "LED": 3, "FD": "DIS"}],
    )
    drive: Literal["timed", "streamed", "stepped", "auto"] | None = Field(
        default=None,
        description="How it is commanded. timed (default): D…T… by the servo's own ramps. streamed "
        "(LSS, firmware 368): bare D through the filter of EM0. stepped: whole degrees, the "
        "only drive of an LSS-2IO. auto: the best prediction; `lss-motion check` shows why.",
    )
    filter_count: int | None = Field(
        default=None,
        ge=1,
        le=FILTER_COUNT_MAX,
        description="FPC of a streamed joint for the show: the higher, the fewer commands, and "
        "the longer the move after the host has failed. Default 4.",
    )
    response: ResponseEntry | None = None


class ServoLimitsEntry(FileModel, title="servo of a joint"):
    """Limits of the servo of a joint with a ratio or a linkage, in degrees of the servo.

    They hold beside those of the joint. Left out: what the model can do, and what the range of the
    joint needs.
    """

    range_deg: Annotated[list[AngleDeg], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="Least and largest angle of the servo, before zero and direction."
    )
    speed_max_deg_s: float | None = Field(
        default=None, ge=SPEED_MIN_DEG_S, description="The servo never moves faster."
    )
    accel_max_deg_s2: float | None = Field(
        default=None, ge=ACCEL_MIN_DEG_S2, description="It never speeds up or brakes harder."
    )


class JointEntry(JointDefaults, title="joint"):
    """A joint and its limits; with an id, it has a servo of its own."""

    id: int | None = Field(
        default=None,
        ge=0,
        le=SERVO_ID_MAX,
        description="Id of the servo on its bus (QID). Left out: the joint is moved by one of "
        "mechanisms.",
    )
    ratio: Ratio | None = Field(
        default=None,
        description="Gear: the servo turns so many degrees for one degree of the joint.",
        examples=[2.5],
    )
    linkage: LinkageEntry | None = Field(
        default=None,
        description="Push rod or four-bar between servo and joint.",
        examples=[{"joint_deg": [0, 5, 12, 22], "servo_deg": [-8, 6, 30, 71]}],
    )
    servo: ServoLimitsEntry | None = Field(
        default=None,
        description="Limits of the servo in its own degrees, for a joint with ratio or linkage.",
        examples=[{"speed_max_deg_s": 150}],
    )
    on_fault: JointOnFaultEntry = Field(
        default_factory=JointOnFaultEntry,
        description="What is done when something is wrong with this joint.",
    )


class MechanismServoEntry(JointDefaults, title="servo of a mechanism"):
    """One servo of a mechanism. Its range and limits are in degrees of the servo.

    servo angle = zero_deg + direction * what the mechanism makes of the joint angles.
    """

    id: int = Field(ge=0, le=SERVO_ID_MAX, description="Id of the servo on its bus (QID).")


class MechanismEntry(FileModel, title="mechanism"):
    """Servos that move joints together; its servos are called NAME.SERVO, such as neck.left."""

    kind: Literal["differential", "pair", "table"] = Field(
        description="differential: servos move joints by a matrix. pair: two or more servos side "
        "by side move one joint. table: a measured grid of two joints, in a file."
    )
    joint: Name | None = Field(default=None, description="pair: the joint.")
    joints: Annotated[list[Name], Field(min_length=1)] | None = Field(
        default=None,
        description="differential, table: the joints, in the order of the columns.",
        examples=[["neck_tilt", "neck_roll"]],
    )
    servos: Annotated[dict[Name, MechanismServoEntry], Field(min_length=1)] = Field(
        description="The servos by name, in the order of the rows.",
        examples=[{"left": {"id": 5}, "right": {"id": 6, "direction": -1}}],
    )
    matrix: Annotated[list[list[float]], Field(min_length=1)] | None = Field(
        default=None,
        description="differential: servo degrees per joint degree; a row for each servo, a column "
        "for each joint.",
        examples=[[[1.8, 1.2], [1.8, -1.2]]],
    )
    ratio: Ratio | None = Field(
        default=None, description="pair: servo degrees per joint degree. Default 1."
    )
    file: PortUrl | None = Field(
        default=None,
        description="table: a CSV file with a row for each measured place, a column JOINT_deg for "
        "each joint and SERVO_deg for each servo. Every angle of one joint stands beside every "
        "angle of the other. Its path is relative to the robot file.",
        examples=["eyes.csv"],
    )
    on_fault: JointOnFaultEntry = Field(
        default_factory=JointOnFaultEntry,
        description="What is done when something is wrong with one of its servos.",
    )


class SensorEntry(FileModel, title="sensor"):
    """An analog input of an LSS-2IO, for play lists that wait for something."""

    id: int = Field(ge=0, le=SERVO_ID_MAX, description="Id of the input on its bus.")
    bus: Name | None = Field(
        default=None, description="Name of the bus; may be left out where there is only one."
    )
    kind: Literal["raw", "GP2Y0A41SK0F", "GP2Y0A21YK0F", "GP2Y0A02YK0F"] = Field(
        default="raw",
        description="Sensor at the input: a Sharp distance sensor, read in mm, or raw for others, "
        "read as 0 to 1023.",
    )


WIRE_UNITS: Final = (10.0, 1.0, 0.1, 0.01, 0.001)


def _check_wire_unit(unit: float) -> float:
    if unit not in WIRE_UNITS:
        raise ValueError(f"must be one of {', '.join(f'{u:g}' for u in WIRE_UNITS)}")
    return unit


WireUnit = Annotated[float, Check(_check_wire_unit)]
_WIRE_UNITS: Final[dict[str, Any]] = {"enum": list(WIRE_UNITS)}


class UnitsEntry(FileModel, title="units"):
    """What one unit on the wire is for the LSS-PRO servos of this robot.

    The maker's page contradicts itself and the maker's code; the defaults are those of the code.
    """

    position_deg: WireUnit = Field(
        default=POSITION_DEG,
        le=1.0,
        description="D, MD, QD, QDT. Default 0.01.",
        json_schema_extra=_WIRE_UNITS,
    )
    offset_deg: WireUnit = Field(
        default=OFFSET_DEG,
        le=1.0,
        description="O, AR and FD. Default 0.1.",
        json_schema_extra=_WIRE_UNITS,
    )
    speed_deg_s: WireUnit = Field(
        default=SPEED_DEG_S,
        description="SD and QCS, in degrees per second. Default 0.01; the page has 0.1.",
        json_schema_extra=_WIRE_UNITS,
    )
    wheel_deg_s: WireUnit = Field(
        default=WHEEL_DEG_S,
        description="WD and QWD, in degrees per second. Default 1.",
        json_schema_extra=_WIRE_UNITS,
    )
    accel_deg_s2: WireUnit = Field(
        default=ACCEL_DEG_S2,
        description="AA and AD, in degrees per second squared. Default 0.01; the page has 10.",
        json_schema_extra=_WIRE_UNITS,
    )


class MirrorEntry(FileModel, title="mirror"):
    """Pairs of joints that are mirror images; a joint on the midline is its own image."""

    same: dict[Name, Name] = Field(
        default={},
        description="Pairs left: right where the same angle is the mirror image.",
        examples=[{"LKnee": "RKnee"}],
    )
    opposite: dict[Name, Name] = Field(
        default={},
        description="Pairs left: right where the opposite angle is the mirror image.",
        examples=[{"LElbow": "RElbow", "HeadPan": "HeadPan"}],
    )


class SupplyEntry(FileModel, title="supply"):
    """What feeds the servos. With the masses of a figure, `check` holds a plan against it."""

    voltage_v: float = Field(
        default=SUPPLY_V,
        gt=0.0,
        le=60.0,
        description="Under load: top speed and torque of a servo go with it.",
    )
    current_max_a: float | None = Field(
        default=None,
        gt=0.0,
        le=1000.0,
        description="What it gives without a dip of its voltage. Left out: not known.",
    )


class RobotFile(FileModel, title="robot file"):
    """A robot: its buses, its joints with their limits, and named poses."""

    more_schema: ClassVar[dict[str, Any]] = {
        "if": {"not": {"required": ["mechanisms"]}},
        "then": {"properties": {"joints": {"additionalProperties": {"required": ["id"]}}}},
    }

    robot: Text = Field(description="Name of the robot, as shown on screen and in reports.")
    version: Version = Field(default=FILE_VERSION, description=VERSION)
    buses: Annotated[dict[Name, BusEntry], Field(min_length=1)] = Field(
        default_factory=lambda: {"main": BusEntry()},
        description="Serial lines by name. Left out: one simulated bus called main.",
    )
    units: UnitsEntry = Field(
        default_factory=UnitsEntry,
        description="What one unit on the wire is for LSS-PRO servos, if it is not the usual.",
        examples=[{"speed_deg_s": 0.1, "accel_deg_s2": 10}],
    )
    defaults: JointDefaults = Field(
        default_factory=JointDefaults, description="Fields that all joints share."
    )
    joints: Annotated[dict[Name, JointEntry], Field(min_length=1)] = Field(
        description="Joints by name, in the order in which tables and plots show them."
    )
    mechanisms: dict[Name, MechanismEntry] = Field(
        default={},
        description="Servos that move joints together, by name: neck differentials, pairs, eyes.",
        examples=[
            {
                "shoulder": {
                    "kind": "pair",
                    "joint": "upper_arm",
                    "servos": {"front": {"id": 7}, "back": {"id": 8, "direction": -1}},
                }
            }
        ],
    )
    poses: dict[Name, Annotated[dict[Name, AngleDeg], Field(min_length=1)]] = Field(
        default={},
        description="Joint angles in degrees by name; a pose need not name all joints.",
    )
    visemes: dict[Name, Annotated[dict[Name, AngleDeg], Field(min_length=1)]] = Field(
        default={},
        description="Mouth shapes by name, as joint angles in degrees, for lip-sync files: those "
        "of Preston Blair (AI, E, etc, FV, L, MBP, O, rest, U, WQ) or of Rhubarb (A to H, X).",
        examples=[{"rest": {"jaw": 0}, "AI": {"jaw": 25}, "MBP": {"jaw": 0}}],
    )
    groups: dict[Name, Annotated[list[Name], Field(min_length=1)]] = Field(
        default={},
        description="Joints by the name of a group, for tracks and layers.",
        examples=[{"head": ["HeadPan", "HeadTilt"]}],
    )
    sensors: dict[Name, SensorEntry] = Field(
        default={},
        description="Analog inputs by name.",
        examples=[{"eye": {"id": 203, "kind": "GP2Y0A41SK0F"}}],
    )
    mirror: MirrorEntry = Field(
        default_factory=MirrorEntry,
        description="Left and right, for sequences with mirror: true.",
    )
    figure: Annotated[dict[Name, FigureLinkEntry], Field(max_length=FIGURE_LINKS_MAX)] = Field(
        default={},
        description="What the robot looks like, for the pictures of the studio: links by name. No "
        "motion depends on it. A gait has a figure by its legs.",
        examples=[
            {
                "post": {"along": "z", "length_mm": 80},
                "boom": {"parent": "post", "joint": "shoulder", "axis": "y", "length_mm": 150},
            }
        ],
    )
    urdf: UrdfEntry | None = Field(
        default=None,
        description="A URDF file in place of figure.",
        examples=[{"file": "arm.urdf"}],
    )
    approach_speed_deg_s: float = Field(
        default=30.0,
        ge=SPEED_MIN_DEG_S,
        description="Speed of the move from where the robot is to where the show starts.",
    )
    sound_offset_s: Annotated[float, Field(ge=-1.0, le=1.0)] = Field(
        default=0.0,
        description="Sounds sound so much later than the show (below 0: earlier). The lag of the "
        "servos is allowed for without it. The keys , and . of lss-play find the value.",
    )
    supply: SupplyEntry = Field(
        default_factory=SupplyEntry,
        description="The power supply or battery of all servos.",
        examples=[{"voltage_v": 11.1, "current_max_a": 8}],
    )
    end: Literal["hold", "limp"] = Field(
        default="hold",
        description="After the show the servos hold their positions, or are limp.",
    )
    on_fault: OnFaultEntry = Field(
        default_factory=OnFaultEntry,
        description="What is done when something is wrong, unless joint or show have their own.",
    )
    patience_s: float = Field(
        default=PATIENCE_S,
        ge=0.0,
        le=600.0,
        description="How long a fault may last on one step of on_fault before the next is taken.",
    )
    resume_s: float = Field(
        default=RESUME_S,
        gt=0.0,
        le=3600.0,
        description="Longest wait for a lost port or a silent servo (on_fault: resume).",
    )
