"""What `check --json` prints, as classes: the attributes are the keys of the JSON object.

A change of a name or of a meaning needs another `SCHEMA_VERSION`; `lss-motion schema check` prints
the JSON Schema. Angles are degrees of the joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence  # noqa: TC003  (msgspec reads the fields)
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec
from msgspec import UNSET, Struct, UnsetType, to_builtins

from lss_motion.planning.program.line import LineUse  # noqa: TC001
from lss_motion.planning.summaries import (
    advice_of,
    joint_errors,
    late_marks,
    limit_uses,
    shortened_holds,
    shortened_rests,
    smoothings,
)
from lss_motion.planning.trajectory.model import GivenUp, SlowSpan, Smoothing  # noqa: TC001
from lss_motion.planning.trajectory.torques import PlanLoad, plan_load
from lss_motion.planning.trajectory.touches import Touch, touches
from lss_motion.robot.model import NO_SERVO
from lss_motion.show.functions import calls_of

if TYPE_CHECKING:
    from lss_motion.planning.shows import Show
    from lss_motion.planning.trajectory.model import Mark, Trajectory
    from lss_motion.robot.model import Joint, Robot

SCHEMA_VERSION: Final = 1


class JointUse(Struct, frozen=True, kw_only=True):
    """The largest speed, acceleration and predicted error of a joint, and where they are.

    A compiled program without its plan has the errors only.
    """

    speed_deg_s: float | UnsetType = UNSET
    speed_max_deg_s: float | UnsetType = UNSET
    speed_at_s: float | UnsetType = UNSET
    accel_deg_s2: float | UnsetType = UNSET
    accel_max_deg_s2: float | UnsetType = UNSET
    accel_at_s: float | UnsetType = UNSET
    error_max_deg: float | UnsetType = UNSET
    """Of the horn, by the response that the robot file states."""
    bound_deg: float | UnsetType = UNSET
    """With what that leaves open."""


class LateKeyframe(Struct, frozen=True, kw_only=True):
    """A keyframe that is reached later than the file asks."""

    label: str
    at_s: float | None
    place: str
    late_s: float


class ShortHold(Struct, frozen=True, kw_only=True):
    """A hold that became shorter."""

    label: str
    at_s: float | None
    place: str
    hold_s: float
    held_s: float


class ShortRest(Struct, frozen=True, kw_only=True):
    """A rest between keyframes that became shorter."""

    label: str
    at_s: float | None
    place: str
    rest_s: float
    rested_s: float


class EaseChange(Struct, frozen=True, kw_only=True):
    """What another ease at some keyframes would do for the sum of the lateness of all."""

    name: str
    ease: str
    at_s: Sequence[float | None]
    late_s: float
    would_be_s: float


class CalledFunction(Struct, frozen=True, kw_only=True):
    """A Python function that events call, and the files that it is read from."""

    run: str
    files: Sequence[str]
    count: int


class ShowCheck(Struct, frozen=True, kw_only=True):
    """A sequence, a gait or a program."""

    kind: Literal["show"] = "show"
    schema: int = SCHEMA_VERSION
    name: str
    robot: str
    duration_s: float
    tolerance_deg: float
    joints: Mapping[str, JointUse]
    stretched: Sequence[SlowSpan]
    given_up: Sequence[GivenUp]
    late_keyframes: Sequence[LateKeyframe]
    shortened_holds: Sequence[ShortHold]
    shortened_rests: Sequence[ShortRest]
    smoothing: Sequence[Smoothing]
    ease_advice: Sequence[EaseChange]
    buses: Mapping[str, LineUse]
    functions: Sequence[CalledFunction]
    load: PlanLoad | UnsetType = UNSET
    """What the plan asks of the servos; only where the robot has masses."""
    touches: Sequence[Touch] | UnsetType = UNSET
    """Links of the figure that touch; only where any do."""
    robust: Mapping[str, Any] | UnsetType = UNSET
    """With `--robust`: the runs on simulated robots that are worse than assumed."""


class BusCheck(Struct, frozen=True, kw_only=True):
    """A serial line of a robot."""

    port: str
    baud_bps: int


class JointCheck(Struct, frozen=True, kw_only=True):
    """A joint and its limits; null: the servo has the limit."""

    bus: str
    id: int | None
    """Of its servo; null: a mechanism moves it."""
    model: str
    range_deg: tuple[float, float]
    speed_max_deg_s: float | None
    accel_max_deg_s2: float | None


class MechanismCheck(Struct, frozen=True, kw_only=True):
    """What stands between joints and servos."""

    kind: str
    joints: Sequence[str]
    servos: Sequence[str]


class FigureCheck(Struct, frozen=True, kw_only=True):
    """What the figure of a robot is made of."""

    links: int
    notes: Sequence[str]


class RobotCheck(Struct, frozen=True, kw_only=True):
    """A robot file."""

    kind: Literal["robot"] = "robot"
    schema: int = SCHEMA_VERSION
    name: str
    buses: Mapping[str, BusCheck]
    joints: Mapping[str, JointCheck]
    servos: Mapping[str, JointCheck] | UnsetType = UNSET
    """In degrees of ideal servos; only of a robot with mechanisms, as those."""
    mechanisms: Mapping[str, MechanismCheck] | UnsetType = UNSET
    poses: Sequence[str]
    figure: FigureCheck | None


def check_schema() -> dict[str, Any]:
    """Return the JSON Schema of what `check --json` prints of a show or a robot."""
    kinds, parts = msgspec.json.schema_components(
        (ShowCheck, RobotCheck), ref_template="#/$defs/{name}"
    )
    return {"anyOf": list(kinds), "$defs": parts}


def show_as_json(show: Show) -> dict[str, Any]:
    """Return the result of `check --json` for a show.

    Raises `InputError` if the URDF file of its robot is wrong.
    """
    program, trajectory = show.program, show.trajectory
    found = ShowCheck(
        name=program.name,
        robot=program.robot,
        duration_s=program.duration_s if trajectory is None else trajectory.duration_s,
        tolerance_deg=program.tolerance_deg,
        joints=_joints(show),
        stretched=program.stretched,
        given_up=program.given_up,
        **(_NOT_LATE if trajectory is None else _late(trajectory)),
        smoothing=[] if trajectory is None else smoothings(trajectory),
        ease_advice=[
            EaseChange(
                name=advice.name,
                ease=advice.ease,
                at_s=[frame.at_s for frame in advice.keyframes],
                late_s=advice.late.total_s,
                would_be_s=advice.would_be.total_s,
            )
            for advice in advice_of(show)
        ],
        buses=program.line_use,
        functions=[
            CalledFunction(run=call.run, files=[str(file) for file in call.files], count=call.count)
            for call in calls_of(program.cues)
        ],
        touches=UNSET if trajectory is None else touches(trajectory, show.robot) or UNSET,
        load=UNSET if trajectory is None else plan_load(trajectory, show.robot) or UNSET,
    )
    made: dict[str, Any] = to_builtins(found)
    return made


def _joints(show: Show) -> dict[str, JointUse]:
    program, trajectory = show.program, show.trajectory
    values: dict[str, dict[str, float]] = {name: {} for name in program.start_deg}
    errors, bounds = program.error_max_deg, program.bound_deg
    if show.robot.servos:
        errors, bounds = joint_errors(errors, show.robot), joint_errors(bounds, show.robot)
        values = {name: {} for name in errors}
    for use in () if trajectory is None else limit_uses(trajectory, show.robot):
        values[use.joint.name] |= {
            "speed_deg_s": use.speed_deg_s,
            "speed_max_deg_s": use.joint.speed_max_deg_s,
            "speed_at_s": use.speed_at_s,
            "accel_deg_s2": use.accel_deg_s2,
            "accel_max_deg_s2": use.joint.accel_max_deg_s2,
            "accel_at_s": use.accel_at_s,
        }
    for name, error_deg in errors.items():
        values[name] |= {"error_max_deg": error_deg, "bound_deg": bounds[name]}
    return {name: JointUse(**own) for name, own in values.items()}


_NOT_LATE: Final[dict[str, Any]] = {
    "late_keyframes": (),
    "shortened_holds": (),
    "shortened_rests": (),
}


def _late(trajectory: Trajectory) -> dict[str, Any]:
    """Return the late keyframes, and the holds and rests that became shorter."""

    def named(mark: Mark) -> dict[str, Any]:
        return {"label": mark.label, "at_s": mark.authored_s, "place": mark.place}

    return {
        "late_keyframes": [
            LateKeyframe(late_s=late_s, **named(mark)) for mark, late_s in late_marks(trajectory)
        ],
        "shortened_holds": [
            ShortHold(hold_s=mark.hold_s, held_s=mark.held_s, **named(mark))
            for mark in shortened_holds(trajectory)
        ],
        "shortened_rests": [
            ShortRest(rest_s=mark.rest_s, rested_s=mark.rested_s, **named(mark))
            for mark in shortened_rests(trajectory)
        ],
    }


def _joint_checks(joints: Mapping[str, Joint]) -> dict[str, JointCheck]:
    return {
        joint.name: JointCheck(
            bus=joint.bus,
            id=None if joint.servo_id == NO_SERVO else joint.servo_id,
            model=joint.model.name,
            range_deg=(joint.position_min_deg, joint.position_max_deg),
            **{
                limit: None if limit in joint.unread else getattr(joint, limit)
                for limit in ("speed_max_deg_s", "accel_max_deg_s2")
            },
        )
        for joint in joints.values()
    }


def robot_as_json(robot: Robot) -> dict[str, Any]:
    """Return the result of `check --json` for a robot file.

    Raises `InputError` if the URDF file of its figure is wrong.
    """
    from lss_motion.show.gait.kinematics import figure_of

    figure = figure_of(robot)
    found = RobotCheck(
        name=robot.name,
        buses={b.name: BusCheck(port=b.port, baud_bps=b.baud_bps) for b in robot.buses.values()},
        joints=_joint_checks(robot.joints),
        servos=_joint_checks(robot.servos) if robot.servos else UNSET,
        mechanisms={
            name: MechanismCheck(kind=one.kind, joints=one.joints, servos=one.servos)
            for name, one in robot.mechanisms.items()
        }
        or UNSET,
        poses=list(robot.poses),
        figure=None
        if figure is None
        else FigureCheck(links=len(figure.links), notes=list(figure.notes)),
    )
    made: dict[str, Any] = to_builtins(found)
    return made
