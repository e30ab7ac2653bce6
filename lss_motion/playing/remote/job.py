"""What the process plays, and how that ended: the values that both ends exchange once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import LssMotionError, PlanningError
from lss_motion.planning.program.model import Program
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.player.following import Following, FollowRule, require_can_follow
from lss_motion.playing.remote.message import duration_of, plan_hash
from lss_motion.playing.remote.player_end import LossRule, Steering
from lss_motion.playing.remote.schema import Ended, MarkInfo, Started
from lss_motion.playing.targets import TargetLimiter, TargetRule, live_program
from lss_motion.playing.walking.steered import SteeredWalk

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.playing.report import Report, StageReport
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.stepping import Twist


class WalkRule(Struct, frozen=True, kw_only=True):
    """How a robot walks: its gait, with a cycle that it can follow, and its largest velocity."""

    gait: Gait
    top: Twist
    tolerance_deg: float


class Job(Struct, frozen=True, kw_only=True):
    """What is played, and how: the arguments of `perform`, and the rule for a lost operator.

    A client of many shows changes between them, with `change` and `end_added`.
    """

    shows: Program | Mapping[str, Program]
    """One program, or the shows of a run by name."""
    robot: Robot
    trajectory: Trajectory | None = None
    rule: LossRule = field(default_factory=LossRule)
    follow: FollowRule | None = None
    """The show follows a leader, of which operations `follow` tell, and stands until then."""
    targets: TargetRule | None = None
    """The joints follow targets, of which operations `target` tell; the show is a live program."""
    walk: WalkRule | None = None
    """The robot walks as operations `walk.steer` tell; the show is that of its planner."""
    options: dict[str, Any] = field(default_factory=dict)
    """Those of `run.RunOptions`."""

    def run(self, operator: Operator) -> Outcome:
        """Play it with this client as its operator."""
        following = None
        if self.follow is not None:
            following = Following(self.follow, place_s=self.options.get("start_s"), pauses=True)
        if self.walk is not None:
            return self._walked(operator, self.walk)
        limiter = None
        if self.targets is not None:
            assert isinstance(self.shows, Program), "a robot that follows targets plays no shows"
            limiter = TargetLimiter(self.shows, self.robot, self.targets)
        return play(self, Steering(operator, self.rule, following=following, led=limiter))

    def _walked(self, operator: Operator, rule: WalkRule) -> Outcome:
        try:
            with SteeredWalk(rule.gait, self.robot, rule.top, rule.tolerance_deg) as walk:
                outcome = play(self, Steering(operator, self.rule, led=walk))
                return replace(outcome, error=outcome.error or walk.pilot.lost)
        except PlanningError as error:
            outcome = Outcome(None, error)
            operator.send(outcome.message)
            return outcome


class PuppetJob(Struct, frozen=True, kw_only=True):
    """Joints that follow targets, from where they stand: `standing_deg` of the options."""

    robot: Robot
    rule: LossRule = field(default_factory=LossRule)
    targets: TargetRule = field(default_factory=TargetRule)
    options: dict[str, Any] = field(default_factory=dict)

    def run(self, operator: Operator) -> Outcome:
        """Let them follow this client until it stops."""
        robot = replace(self.robot, end="hold")
        try:
            robot.require_servos("a joint that follows targets")
            program = live_program(robot, self.options["standing_deg"])
        except LssMotionError as error:
            outcome = Outcome(None, error)
            operator.send(outcome.message)
            return outcome
        options = {"is_open": True}
        job = Job(shows=program, robot=robot, rule=self.rule, targets=self.targets, options=options)
        return job.run(operator)


def puppet_latency_s(robot: Robot) -> float:
    """Return the bound from a target at the player to the horn of any joint of a robot.

    It holds without faults, and while the computer keeps time (`TargetLimiter.latency_s`). Raises
    `InputError` for a robot whose joints cannot follow targets.
    """
    robot.require_servos("a joint that follows targets")
    low_deg = {one.name: one.position_min_deg for one in robot.joints.values()}
    limiter = TargetLimiter(live_program(robot, low_deg), robot)
    return max(limiter.latency_s(name) for name in low_deg)


class Outcome(Struct, frozen=True):
    """How a job ended: with a report, unless it could not begin."""

    report: Report | StageReport | None
    error: LssMotionError | None

    @property
    def _word(self) -> str:
        return "stopped" if self.error is None else "fault"

    @property
    def message(self) -> Ended:
        """The last event of the job."""
        return Ended(
            outcome=self._word if self.report is None else self.report.outcome,
            error=None if self.error is None else str(self.error),
            report=None if self.report is None else self.report.to_dict(),
            exit_code=None if self.error is None else self.error.exit_code,
        )


def play(job: Job, steering: Steering) -> Outcome:
    """Play `job` with this operator; send the first and the last event."""
    from lss_motion.playing.player.repertoire import STANDING, Repertoire
    from lss_motion.playing.run import Observer, perform

    observer = Observer(on_event=steering.on_event, on_turn=steering.on_turn, controls=steering)
    try:
        if job.targets is not None or job.walk is not None:
            job.robot.require_servos("a walk, or a joint that follows targets,")
        if isinstance(job.shows, Program):
            if job.follow is not None:
                require_can_follow(job.shows)
            steering.start(started(job.shows, job.robot), job.robot)
            result = perform(
                job.shows,
                job.robot,
                trajectory=job.trajectory,
                observer=observer,
                **job.options,
            )
            outcome = Outcome(result.report, result.error)
        else:
            shows = Repertoire(job.shows, job.robot)
            steering.plans = {name: plan_hash(one) for name, one in job.shows.items()}
            joints = JointView(job.robot).joints_of(shows.joints)
            steering.start_many(job.options.get("first") or STANDING, job.robot, joints)
            many = perform(shows, job.robot, observer=observer, **job.options)
            outcome = Outcome(many.report, many.error)
    except LssMotionError as error:
        outcome = Outcome(None, error)
    steering.end(outcome.message)
    return outcome


def started(program: Program, robot: Robot) -> Started:
    """Return the first event of a run of one show."""
    from lss_motion.playing.connection import is_simulated

    return Started(
        name=program.name,
        robot=robot.name,
        is_simulated=is_simulated(robot),
        duration_s=duration_of(program),
        plan=plan_hash(program).hex(),
        joints=JointView(robot).joints_of(program.start_deg),
        marks=tuple(
            MarkInfo(label=mark.label, at_s=mark.planned_s) for mark in program.marks if mark.label
        ),
    )
