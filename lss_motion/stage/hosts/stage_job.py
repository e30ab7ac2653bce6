"""What the conductor's process does for its server: the stage with figures, steered by operators.

`ConductorJob` is given to `playing.remote.process`, as `stage.job.StageJob` is for one robot, and
answers the same operations with the same events: so the pages, the triggers, the alerts and the
stop of a stage are those of any stage. The players of all figures are processes of their own; that
of the conductor's figure is started from here.
"""

from __future__ import annotations

import contextlib
import pickle
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import LssMotionError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.job import Outcome
from lss_motion.playing.remote.player_end import LossRule
from lss_motion.stage.hosts.conducting import ConductedStage, Offer
from lss_motion.stage.hosts.plans import SEPARATOR
from lss_motion.stage.hosts.serving import conduct, host_for
from lss_motion.stage.job import StageSteering
from lss_motion.stage.log import StageLog
from lss_motion.stage.records import must_restart
from lss_motion.stage.stage_timecode import OwnSource, StageTimecode, spec_of
from lss_motion.system.messages import Kind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.playing.player.player import Player
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Robot
    from lss_motion.stage.hosts.plans import PlannedCast
    from lss_motion.stage.model import Stage
    from lss_motion.stage.running import Record

PASSED_ON: Final = frozenset({"checked", "mark", "fault", "phase"})
"""Events of the conductor's own player that operators get."""


def conductor_job(
    stage: Stage, made: Mapping[str, PlannedCast], robot: Robot, hashes: Mapping[str, str]
) -> ConductorJob:
    """Return the job of a planned stage; `hashes` are those of the conductor's own programs."""
    is_joined = any("" in one.shows for one in made.values())
    return ConductorJob(
        stage=replace(stage, robot=None),
        offers={name: Offer(one.cast, one.contents) for name, one in made.items()},
        robot=robot,
        prefix=f"{stage.conductor}{SEPARATOR}" if is_joined else "",
        hashes=dict(hashes),
    )


class ConductorJob(Struct, frozen=True, kw_only=True):
    """A planned stage with figures, for the computer of its conductor.

    `options`: `waits_for_go`, `start_at`, `is_real_time`, `may_run`, `seed`, `log_folder`, `goes`
    (play the first show when all are there), `trusts_network`, `plans`.
    """

    stage: Stage
    offers: Mapping[str, Offer]
    robot: Robot
    prefix: str = ""
    """Before the names of its joints on the pages, where a show has the joints of all."""
    hashes: Mapping[str, str] = field(default_factory=dict)
    """Of the program of the own figure, by show."""
    rule: LossRule = field(default_factory=LossRule)
    options: dict[str, Any] = field(default_factory=dict)

    def run(self, operator: Operator) -> Outcome:
        """Conduct until the operator stops it; send the first and the last event."""
        steering = ConductorSteering(operator, self)
        try:
            self._run(operator, steering)
            error: LssMotionError | None = None
        except LssMotionError as refused:
            error = refused
        outcome = Outcome(None, error)
        steering.note_log(is_last=True)
        steering.end(outcome.message)
        return outcome

    def _run(self, operator: Operator, steering: ConductorSteering) -> None:
        options, given = self.options, self.stage.sync.timecode
        rule = self.stage.log
        if options.get("log_folder") is not None:
            rule = replace(rule, folder=Path(options["log_folder"]))
        start_at = options.get("start_at")

        def pass_on(kind: Kind, content: bytes) -> None:
            if kind is Kind.TELEMETRY:
                operator.link.offer(kind, content)
            elif kind is Kind.EVENT:
                steering.pass_on(m.parse_event(content))

        with contextlib.ExitStack() as stack:
            files = steering.kept = stack.enter_context(StageLog(rule))

            def write(record: Record) -> None:
                files.write(record)
                steering.note(record)

            legs = None if given is None else stack.enter_context(OwnSource(spec_of(given)))
            host = host_for(
                self.stage,
                self.stage.conductor or "",
                self.robot,
                trust_network=bool(options.get("trusts_network")),
                folder=None if options.get("plans") is None else Path(options["plans"]),
                log=steering.log,
                pass_on=pass_on,
                new_stop_end=operator.new_stop_end,
                is_real_time=bool(options.get("is_real_time")),
                may_run=bool(options.get("may_run")),
            )
            stack.callback(host.close)
            run = ConductedStage(
                self.stage,
                self.offers,
                host,
                write,
                timecode=None if given is None else StageTimecode(given, legs),
                waits_for_go=bool(options.get("waits_for_go")),
                start_at=None if start_at is None else datetime.fromisoformat(start_at),
                seed=options.get("seed"),
                plays_first=bool(options.get("goes")),
            )
            steering.begin_conducting(run)
            run.records.note("begins", "the stage begins")

            def act(now_ns: int) -> bool:
                steering.act(None, now_ns)
                return steering.has_stopped

            conduct(host, run, act)


def plans_of(hashes: Mapping[str, str]) -> dict[str, bytes]:
    """Return the names of plans as bytes, by show."""
    return {show: bytes.fromhex(plan) for show, plan in hashes.items()}


class ConductorSteering(StageSteering):
    """Operators of a stage with figures."""

    def __init__(self, operator: Operator, job: ConductorJob) -> None:
        super().__init__(operator, job.rule)
        self._job = job
        self._conducting: ConductedStage | None = None

    def begin_conducting(self, run: ConductedStage) -> None:
        """Send the first event."""
        self._run, self._conducting = run, run
        self.plans = plans_of(self._job.hashes)
        robot = self._job.robot
        joints = (self._job.prefix + name for name in robot.joints)
        self.start_many(run.stage.name, robot, joints)

    def pass_on(self, event: m.AnyEvent) -> None:
        """Let operators see what the player of the own figure does."""
        prefix = self._job.prefix
        if isinstance(event, m.Started):
            joints = tuple(prefix + name for name in event.joints)
            self.start(replace(event, name=self._job.stage.name, joints=joints))
        elif isinstance(event, m.Health):
            named = {prefix + name: one for name, one in event.joints.items()}
            self.operator.offer(replace(event, joints=named))
        elif event.event in PASSED_ON:
            self.operator.send(event)

    def log(self, text: str) -> None:
        """Keep a line of the host, for the log and the pages."""
        if self._conducting is not None:
            self._conducting.records.note("network", text)

    def _renew(self, job: bytes, player: Player | None) -> None:  # noqa: ARG002
        """Go on with newer files, or note why the stage must begin anew for them."""
        assert self._conducting is not None
        newer: ConductorJob = pickle.loads(job)  # noqa: S301  (from the server that started this)
        if newer.robot != self._job.robot:
            kind, text = must_restart("another robot")
        else:
            kind, text = self._conducting.renew(newer.stage, newer.offers)
        self._conducting.records.note(kind, text)
        if kind == "renewed":
            self.plans = plans_of(newer.hashes)

    def _direct(self, operation: m.AnyOperation) -> bool:
        assert self._conducting is not None
        is_done = self._conducting.obey(operation)
        if isinstance(operation, m.Pause | m.Resume | m.Rate):
            legs = self._conducting.conductor.legs
            self.operator.send(m.RateChanged(ratio=legs.speed, is_paused=legs.is_paused))
        return is_done
