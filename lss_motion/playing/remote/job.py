"""What the process plays, and how that ended: the values that both ends exchange once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from lss_motion.errors import LssMotionError
from lss_motion.playing.player.following import Following, FollowRule, require_can_follow
from lss_motion.playing.remote.player_end import LossRule, Steering
from lss_motion.playing.remote.schema import Ended, MarkInfo, Started
from lss_motion.playing.remote.telemetry import duration_of, plan_hash

if TYPE_CHECKING:
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.playing.report import Report
    from lss_motion.robot.model import Robot


class Job(Struct, frozen=True, kw_only=True):
    """What is played, and how: the arguments of `perform`, and the rule for a lost operator."""

    program: Program
    robot: Robot
    trajectory: Trajectory | None = None
    rule: LossRule = field(default_factory=LossRule)
    follow: FollowRule | None = None
    """The show follows a leader, of which operations `follow` tell, and stands until then."""
    options: dict[str, Any] = field(default_factory=dict)

    def run(self, operator: Operator) -> Outcome:
        """Play it with this client as its operator."""
        start_s = self.options.get("start_s")
        following = None
        if self.follow is not None:
            following = Following(self.follow, place_s=start_s, pauses=True)
        return play(self, Steering(operator, self.rule, following=following))


class Outcome(Struct, frozen=True):
    """How a job ended: with a report, unless it could not begin."""

    report: Report | None
    error: LssMotionError | None


def started(job: Job) -> Started:
    """Return the first event of a job."""
    from lss_motion.playing.connection import is_simulated

    program = job.program
    return Started(
        name=program.name,
        robot=job.robot.name,
        is_simulated=is_simulated(job.robot),
        duration_s=duration_of(program),
        plan=plan_hash(program).hex(),
        joints=tuple(program.start_deg),
        marks=tuple(
            MarkInfo(label=mark.label, at_s=mark.planned_s) for mark in program.marks if mark.label
        ),
    )


def play(job: Job, steering: Steering) -> Outcome:
    """Play `job` with this operator; send the first and the last event."""
    from lss_motion.playing.perform import Observer, perform

    observer = Observer(on_event=steering.on_event, on_turn=steering.on_turn, controls=steering)
    try:
        if job.follow is not None:
            require_can_follow(job.program)
        steering.start(started(job))
        result = perform(
            job.program,
            job.robot,
            trajectory=job.trajectory,
            observer=observer,
            **job.options,
        )
        outcome = Outcome(result.report, result.error)
    except LssMotionError as error:
        outcome = Outcome(None, error)
    steering.end(
        Ended(
            outcome="fault" if outcome.report is None else outcome.report.outcome,
            error=None if outcome.error is None else str(outcome.error),
            report=None if outcome.report is None else outcome.report.to_dict(),
            exit_code=None if outcome.error is None else outcome.error.exit_code,
        )
    )
    return outcome
