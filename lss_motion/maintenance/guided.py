"""Calibrate and identify a joint, led step by step by a client that answers questions.

A `Guide` says what happens now and what a person has to do (`schema.MaintenanceChanged`), and takes
the answers. It never waits. `Calibration` works while the robot is in the hands of the client;
`Identification` begins where the measurement of `maintenance.identify.joint_run` has ended.
Nothing is written before the person agrees.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError, LssMotionError, PlaybackError
from lss_motion.files.texts import known_names
from lss_motion.maintenance.settings import MOVED_MIN_DEG, frame_of, stated_frame
from lss_motion.playing.remote import schema as m
from lss_motion.protocol.constants import Family

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from lss_motion.maintenance.identify.estimate import Identified
    from lss_motion.maintenance.identify.joint_run import Experiment
    from lss_motion.maintenance.settings import JointFrame
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Joint, Robot

    State = m.MaintenanceState
    What = m.MaintenanceTask

CANCEL: Final = "Cancel"
RELEASE: Final = "I hold it: make it limp"
AT_ZERO: Final = "It is at zero"
PUSHED: Final = "I have pushed it"
KEEP: Final = "Keep its direction"
WRITE: Final = "Write it to the robot file"
DISCARD: Final = "Write nothing"
RECONNECT: Final = "disconnect and connect again, so that the robot is moved by it"


class Guide(ABC):
    """Steps of one task about one joint. `now` is the state that a client should know."""

    what: What

    def __init__(self, robot: Robot, joint: Joint) -> None:
        self.robot, self.joint = robot, joint
        self.now = m.MaintenanceChanged(what=self.what, joint=joint.name, state="running", step="")

    @property
    def is_over(self) -> bool:
        """Whether it takes no more answers."""
        return self.now.question is None

    def answer(self, text: str, hands_on: HandsOn) -> None:
        """Take an answer to the question of `now`; raises `InputError` for one it did not offer."""
        if self.now.question is None:
            raise InputError(f"{self.what} of {self.joint.name} asks nothing now")
        if text not in self.now.question.answers:
            raise InputError(f"{known_names(text, self.now.question.answers)}")
        if text in (CANCEL, DISCARD):
            self.cancel(hands_on)
        else:
            self._answered(text, hands_on)

    @abstractmethod
    def cancel(self, hands_on: HandsOn) -> None:
        """End it; nothing is written."""

    @abstractmethod
    def _answered(self, text: str, hands_on: HandsOn) -> None:
        """Go on after an answer that was offered."""

    def _ask(self, text: str, *answers: str, step: str | None = None) -> None:
        question = m.Question(text=text, answers=answers)
        step = self.now.step if step is None else step
        self._set("asking", step, question=question, result=self.now.result)

    def _set(
        self,
        state: State,
        step: str,
        *,
        question: m.Question | None = None,
        result: m.MaintenanceResult | None = None,
        progress: float | None = None,
    ) -> None:
        self.now = m.MaintenanceChanged(
            what=self.what,
            joint=self.joint.name,
            state=state,
            step=step,
            progress=progress,
            question=question,
            result=result,
        )

    def _write(self, write: Callable[[Path], None]) -> None:
        path = self.robot.path
        if path is None:
            self._set("failed", "nothing was written: this robot has no file")
            return
        try:
            write(path)
        except InputError as error:
            self._set("failed", f"nothing was written: {error}", result=self.now.result)
        else:
            self._set("done", f"written to {path.name}: {RECONNECT}", result=self.now.result)


class Calibration(Guide):
    """Zero and direction of one joint, by hand: limp, to its zero, a push, the result."""

    what: What = "calibrate"

    def __init__(self, robot: Robot, joint: Joint) -> None:
        super().__init__(robot, joint)
        self._servo_deg: float | None = None
        self._frame: JointFrame | None = None
        self._ask("The joint goes limp and falls. Hold it.", RELEASE, CANCEL, step="step 1 of 4")

    def cancel(self, hands_on: HandsOn) -> None:
        hands_on.hold([self.joint.name])
        self._set("stopped", "nothing was written; the joint is held")

    def _answered(self, text: str, hands_on: HandsOn) -> None:
        name = self.joint.name
        reads_deg = self.joint.servo_deg(hands_on.readings[name].deg)
        match text:
            case str() if text == RELEASE:
                hands_on.let_go([name])
                self._ask(f"Bring {name} to its zero.", AT_ZERO, CANCEL, step="step 2 of 4")
            case str() if text == AT_ZERO:
                self._servo_deg = reads_deg
                self._ask(self._push_text(), PUSHED, KEEP, CANCEL, step="step 3 of 4")
            case str() if text in (PUSHED, KEEP):
                self._conclude(reads_deg if text == PUSHED else None)
            case _:
                hands_on.hold([name])
                wires = {
                    key: wire
                    for key in ("G", "O")
                    if (wire := hands_on.answer_of(name, f"Q{key}")) is not None
                }
                self._write(lambda path: self._write_frame(path, stated_frame(self.joint, wires)))

    def _push_text(self) -> str:
        return (
            f"Push {self.joint.name} by {MOVED_MIN_DEG:g}° or more towards its larger angles, and "
            f"keep it there."
        )

    def _conclude(self, pushed_deg: float | None) -> None:
        assert self._servo_deg is not None
        joint = self.joint
        self._frame = frame_of(
            joint, servo_deg=self._servo_deg, pose_deg=0.0, pushed_deg=pushed_deg
        )
        if self._frame is None:
            text = f"It has moved less than {MOVED_MIN_DEG:g}°. {self._push_text()}"
            self._ask(text, PUSHED, KEEP, CANCEL)
            return
        lines = (
            f"zero_deg {joint.zero_deg:g} → {self._frame.zero_deg:g}",
            f"direction {joint.direction} → {self._frame.direction}",
        )
        self._set("running", "step 4 of 4", result=m.MaintenanceResult(lines=lines))
        self._ask("Is that right? The joint is held then.", WRITE, DISCARD)

    def _write_frame(self, path: Path, stored: dict[str, float]) -> None:
        from lss_motion.robot.write import write_frames

        assert self._frame is not None
        name, frame = self.joint.name, self._frame
        write_frames(path, {name: (frame.zero_deg, frame.direction)}, {name: stored})


class Identification(Guide):
    """The result of a measurement, and the question whether it is written."""

    what: What = "identify"

    def __init__(self, robot: Robot, joint: Joint, experiment: Experiment) -> None:
        """Compute the result; that takes a second or two, during which the joint is held."""
        super().__init__(robot, joint)
        self._found: Identified | None = None
        if experiment.is_stopped:
            self._set("stopped", "stopped; nothing was measured")
        elif experiment.error is not None:
            self._set("failed", str(experiment.error))
        else:
            self._conclude(experiment)

    def cancel(self, hands_on: HandsOn) -> None:  # noqa: ARG002  (nothing moves)
        self._set("stopped", "nothing was written", result=self.now.result)

    def _answered(self, text: str, hands_on: HandsOn) -> None:  # noqa: ARG002  (one is left)
        self._write(self._write_response)

    def _conclude(self, experiment: Experiment) -> None:
        from lss_motion.maintenance.identify import estimate
        from lss_motion.maintenance.identify.estimate import identify

        try:
            self._found = found = identify(self.joint, experiment.recording)
        except PlaybackError as error:
            self._set("failed", str(error))
            return
        differences = estimate.difference_lines(found, self.joint)
        lines = [line.strip() for line in estimate.summary_lines(found)]
        lines += differences or ["it matches the assumptions of the robot file"]
        plots = estimate.plots(found, self.joint, experiment.recording)
        result = m.MaintenanceResult(lines=tuple(lines), plots=plots)
        self._set("running", "measured", result=result)
        self._ask("Write it as the response of the joint?", WRITE, DISCARD)

    def _write_response(self, path: Path) -> None:
        from lss_motion.maintenance.identify import estimate
        from lss_motion.robot.write import write_response

        assert self._found is not None
        today = datetime.now(tz=UTC).date().isoformat()
        values = estimate.response_values(self._found, self.joint)
        write_response(path, self.joint.name, values, estimate.comment_lines(self._found, today))


class ServoTasks(Struct, frozen=True):
    """Calibration and identification for a live robot (`playing.live_end.GuidedTasks`)."""

    def joint(self, robot: Robot, name: str) -> Joint:
        """Return the joint; raises `InputError` for one that is unknown or that cannot be read."""
        if name not in robot.joints:
            raise InputError(f"unknown joint {name!r}; {known_names(name, robot.joints)}")
        joint = robot.joints[name]
        if joint.model.family is Family.IO2:
            raise InputError(f"joint {name!r} is an RC servo of an LSS-2IO: it reports no position")
        return joint

    def calibration(self, robot: Robot, joint: Joint) -> Calibration:
        from lss_motion.maintenance.api import require_own_servo

        require_own_servo(robot, joint.name, "calibrate")
        return Calibration(robot, joint)

    def measured(
        self, connection: Connection, robot: Robot, name: str, operator: Operator
    ) -> tuple[Identification | None, bool]:
        """Measure a joint that is free to move; return what follows, and whether it was stopped.

        None: the joint cannot be measured, and the client was told why. The joint holds afterwards.
        """
        from lss_motion.maintenance.api import measurable
        from lss_motion.maintenance.identify.joint_run import Experiment
        from lss_motion.maintenance.identify.trials import SPAN_DEG, make_window
        from lss_motion.playing.player import handshake
        from lss_motion.playing.runner import run

        try:
            joint = measurable(robot, self.joint(robot, name).name)
            robot = robot.servo_robot
            answers, _ = connection.examined([joint], robot)
            standing_deg = handshake.reported(joint, answers, "QD")
            assert standing_deg is not None, "`examined` raises without it"
            window = make_window(joint, standing_deg, SPAN_DEG)
        except LssMotionError as error:
            operator.send(
                m.MaintenanceChanged(what="identify", joint=name, state="failed", step=str(error))
            )
            return None, False
        experiment = Experiment(joint, robot, answers, window, standing_deg=standing_deg)
        controls = Measuring(operator, joint)
        run(experiment, connection.ports, connection.clock, controls=controls)
        return Identification(robot, joint, experiment), controls.has_stopped


class Measuring:
    """The controls of a measurement: it can only be stopped, and its progress is sent."""

    def __init__(self, operator: Operator, joint: Joint) -> None:
        self.has_stopped = False
        self._operator, self._joint = operator, joint
        self._percent = -1

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""
        return self._operator.filenos()

    def act(self, experiment: Experiment, now_ns: int) -> None:
        """Stop if the client says so or is gone; refuse the rest; send the progress."""
        self._operator.look_for_client()
        for operation in self._operator.take(now_ns):
            match operation:
                case m.Estop():
                    self._stop(experiment, now_ns)
                    experiment.stop(now_ns)  # The second call ends at once.
                case m.Stop():
                    self._stop(experiment, now_ns)
                case m.Beat():
                    continue
                case _:
                    text = f"{self._joint.name} is being measured; wait, or stop"
                    self._operator.refuse(operation, text)
                    continue
            self._operator.accept(operation)
        if self._operator.take_signals() or self._operator.is_cut:
            self._stop(experiment, now_ns)
        percent = int(100.0 * experiment.progress_ratio)
        if percent != self._percent:
            self._percent = percent
            self._operator.offer(
                m.MaintenanceChanged(
                    what="identify",
                    joint=self._joint.name,
                    state="running",
                    step=experiment.state.value,
                    progress=experiment.progress_ratio,
                )
            )

    def _stop(self, experiment: Experiment, now_ns: int) -> None:
        if not self.has_stopped:
            self.has_stopped = True
            experiment.stop(now_ns)
