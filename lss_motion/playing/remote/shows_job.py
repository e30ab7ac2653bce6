"""Several shows in one run of the player's process, which a client changes as it likes.

    {"op": "change", "show": "hello"}                  in place of what plays
    {"op": "change", "show": "eyes", "how": "add"}     beside it, on other joints
    {"op": "end_added", "show": "eyes"}
    {"op": "change"}                                   brake, and hold all joints

Here a client decides. A stage file lets the player itself decide, by its cues (`stage.job`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.source import known_names
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.player_end import LossRule, Steering
from lss_motion.playing.remote.telemetry import plan_hash

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.playing.stage_report import StageReport
    from lss_motion.robot.model import Robot


class ShowsOutcome(Struct, frozen=True):
    """How a run ended: with a report, unless it could not begin."""

    report: StageReport | None
    error: LssMotionError | None


class ShowsJob(Struct, frozen=True, kw_only=True):
    """The shows by name, and how they are played: the arguments of `perform_stage`."""

    programs: Mapping[str, Program]
    robot: Robot
    first: str | None = None
    rule: LossRule = field(default_factory=LossRule)
    options: dict[str, Any] = field(default_factory=dict)

    def run(self, operator: Operator) -> ShowsOutcome:
        """Play them with this client as the operator; send the first and the last event."""
        return play_shows(self, ShowsSteering(operator, self.rule, self.programs))


class ShowsSteering(Steering):
    """A client that changes between the shows of a run."""

    def __init__(
        self, operator: Operator, rule: LossRule | None, programs: Mapping[str, Program]
    ) -> None:
        super().__init__(operator, rule)
        self._hashes = {name: plan_hash(program) for name, program in programs.items()}

    def on_event(self, event: Event) -> None:
        """Send what happened; the telemetry names the plan of the show that plays."""
        from lss_motion.playing.player.events import ShowBegan

        if isinstance(event, ShowBegan) and not event.is_added:
            self._plan = self._hashes[event.name]
        super().on_event(event)

    def _apply(self, operation: m.AnyOperation, player: Player, now_ns: int) -> None:
        is_over = self._has_stopped or player.is_finished
        if is_over or not isinstance(operation, s.Change | s.EndAdded):
            super()._apply(operation, player, now_ns)
            return
        if isinstance(operation, s.EndAdded):
            player.end_added(operation.show, now_ns)
            return
        programs = player.repertoire.programs
        if operation.show is not None and operation.show not in programs:
            raise InputError(f"no show {operation.show!r}; {known_names(operation.show, programs)}")
        program = None if operation.show is None else programs[operation.show]
        if operation.how == "replace":
            player.change_to(program, now_ns, start_s=operation.start_s)
        elif program is not None:
            player.add(program, now_ns, start_s=operation.start_s)
        else:
            raise InputError("which show is to be added? Give `show`")


def play_shows(job: ShowsJob, steering: ShowsSteering) -> ShowsOutcome:
    """Play `job` with this operator; send the first and the last event."""
    from lss_motion.playing.connection import is_simulated
    from lss_motion.playing.perform import Observer
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.stage_run import perform_stage

    observer = Observer(on_event=steering.on_event, on_turn=steering.on_turn, controls=steering)
    try:
        repertoire = Repertoire(job.programs, job.robot)
        steering.start(
            m.Started(
                name=job.first or "standing",
                robot=job.robot.name,
                is_simulated=is_simulated(job.robot),
                duration_s=None,
                plan=plan_hash(repertoire.needs(None)).hex(),
                joints=repertoire.joints,
                marks=(),
            )
        )
        result = perform_stage(
            job.programs, job.robot, first=job.first, observer=observer, **job.options
        )
        outcome = ShowsOutcome(result.report, result.error)
    except LssMotionError as error:
        outcome = ShowsOutcome(None, error)
    steering.end(
        m.Ended(
            outcome="fault" if outcome.report is None else outcome.report.outcome,
            error=None if outcome.error is None else str(outcome.error),
            report=None if outcome.report is None else outcome.report.to_dict(),
            exit_code=None if outcome.error is None else outcome.error.exit_code,
        )
    )
    return outcome
