"""`start` plays a show in a process of its own and returns at once with a `Handle`.

    handle = lss.start(program, robot)     # returns at once; the show plays
    handle.pause(); handle.resume(); handle.rate(0.5); handle.stop()
    report = handle.wait()                 # as `lss.play` returns it

As a context manager the handle stops the show when the block is left, whatever the reason. Whatever
becomes of this process, the one that plays stops the show and makes the robot safe.
"""

# ruff: noqa: TC001 - public: `help` looks up the annotations.
from __future__ import annotations

import contextlib
import math
import pickle
import queue
import sys
import threading
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError, in_python_words
from lss_motion.planning.program.model import Program
from lss_motion.playing.connection import with_port
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.job import Job, WalkRule
from lss_motion.playing.remote.message import Telemetry
from lss_motion.playing.remote.player_end import LossRule
from lss_motion.playing.remote.process import packed, start_process
from lss_motion.robot.model import Robot
from lss_motion.system.closing import Closing
from lss_motion.system.messages import Kind, PipeClosedError
from lss_motion.system.reactor import wait_for

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lss_motion.playing.remote.job import Outcome
    from lss_motion.playing.report import Report

STOP_S: Final = 30.0
"""A show that was stopped has ended by then: it brakes, settles and gives back the settings."""
END_S: Final = 2.0
"""The process of a show that has ended is gone by then."""
FLUSH_S: Final = 0.25
"""What a player that stands still did not take is offered to it again so often."""
STANDS_STILL: Final = (
    "the process that plays (pid {}) stands still. When it goes on, it stops the show, also if "
    "this program has ended; the servos come to rest by themselves. Cut their power if they must "
    "be limp"
)
GONE: Final = (
    "the process that plays has ended without a report; the servos come to rest by themselves"
)
BEATS: Final = 4
"""So often within the time of the rule the player is told that this process is alive."""
TARGET_EVERY_S: Final = 0.005
"""Targets are sent at most this often. Chosen: a quarter of the tick at which joints obey them."""
KEPT_EVENTS: Final = 10_000
"""Events that `events` has not returned yet; older ones are dropped."""


class Reading(Struct, frozen=True):
    """One joint at the last moment that is known: joint degrees; None where nothing was read."""

    planned_deg: float
    predicted_deg: float
    read_deg: float | None
    error_deg: float | None
    """Planned minus measured angle, of the last reading."""
    status: str | None
    temperature_c: float | None
    voltage_v: float | None
    current_a: float | None


def start(  # noqa: PLR0913  (the options of one run)
    program: Program,
    robot: Robot,
    *,
    port: str | None = None,
    has_feedback: bool = True,
    start_s: float | None = None,
    must_ask: bool = False,
    allow_run: bool = False,
    is_forced: bool = False,
    is_real_time: bool = False,
    is_virtual: bool = False,
    seed: int = 0,
    rule: LossRule | None = None,
) -> Handle:
    """Play `program` on `robot` in a process of its own; return at once.

    The options are those of `lss.play`. `start_s` begins in the middle of the show. With `must_ask`
    nothing moves before `go`. Nothing that this process does delays a command to the servos. `rule`
    says what becomes of the show when this process ends or falls silent; by default it stops.

    Raises `InputError` where the system has no socket pairs that a new process can inherit
    (Windows): use `lss.play` there. What is wrong with the robot is raised by `wait`.
    """
    _require_processes("start")
    job = Job(
        shows=program,
        robot=with_port(robot, port),
        rule=rule or LossRule(),
        options={
            "has_feedback": has_feedback,
            "start_s": start_s,
            "must_ask": must_ask,
            "may_run": allow_run,
            "is_forced": is_forced,
            "is_real_time": is_real_time,
            "is_virtual": is_virtual,
            "seed": seed,
        },
    )
    return Handle(job, program)


def walk(  # noqa: PLR0913  (the options of one run)
    path: Path | str,
    robot: Robot | None = None,
    *,
    port: str | None = None,
    forward_mm_s: float | None = None,
    left_mm_s: float | None = None,
    turn_deg_s: float | None = None,
    has_feedback: bool = True,
    must_ask: bool = False,
    is_forced: bool = False,
    seed: int = 0,
    rule: LossRule | None = None,
) -> Handle:
    """Walk the gait of a file in a process of its own; return at once, steer with `Handle.steer`.

    The robot stands until it is steered, and can always reach a stable stand; it goes there on
    `stop` and when this process ends. The velocities are the largest that can be asked for; by
    default those of the file. The other options are those of `lss.start`.

    Raises `InputError` or `PlanningError` for a file or a velocity that cannot be walked.
    """
    from lss_motion.planning.shows import GAIT_TOLERANCE_DEG
    from lss_motion.playing.walking.planner import WalkPlanner
    from lss_motion.playing.walking.steered import fastest
    from lss_motion.robot.load import load_robot
    from lss_motion.show.gait.load import load_gait
    from lss_motion.show.gait.model import BodyPose

    _require_processes("walk")
    gait = load_gait(Path(path), robot)
    if robot is None:
        assert gait.robot_path is not None, "without a robot it would not have been loaded"
        robot = load_robot(gait.robot_path)
    wanted = {"forward_mm_s": forward_mm_s, "left_mm_s": left_mm_s, "turn_deg_s": turn_deg_s}
    gait, top = fastest(replace(gait, start=BodyPose()), robot, wanted)
    robot = with_port(robot, port)
    program = WalkPlanner(gait, robot, GAIT_TOLERANCE_DEG).program
    job = Job(
        shows=program,
        robot=robot,
        rule=rule or LossRule(),
        walk=WalkRule(gait=gait, top=top, tolerance_deg=GAIT_TOLERANCE_DEG),
        options={
            "has_feedback": has_feedback,
            "must_ask": must_ask,
            "is_forced": is_forced,
            "is_open": True,
            "seed": seed,
        },
    )
    return Handle(job, program)


def _require_processes(name: str) -> None:
    if sys.platform == "win32":
        raise InputError(f"{name} needs Linux or macOS; play(program, robot) works here")


class Handle(Closing):
    """A show that plays in another process. Its methods return at once, except `wait` and `close`.

    They may be called from any thread. Operations on a show that has ended do nothing.
    """

    def __init__(self, job: Job, program: Program) -> None:
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._events: queue.Queue[m.AnyEvent] = queue.Queue(KEPT_EVENTS)
        self._telemetry: Telemetry | None = None
        self._health: m.Health | None = None
        self._started: m.Started | None = None
        self._outcome: Outcome | None = None
        self._next_id = 1
        self._targets: dict[str, float] = {}
        self._has_targets = threading.Event()
        self._program = program
        self.phase = "connecting"
        """The phase of the player, by the names of `playing.player.events.Phase`."""
        self._process = start_process(packed(job))
        self._link = self._process.pipe
        # A handle that is forgotten goes on playing; the end of this process ends the show.
        self._listener = threading.Thread(target=self._listen, name="lss-handle", daemon=True)
        self._listener.start()
        if job.rule.silent_s is not None:
            every_s = job.rule.silent_s / BEATS
            threading.Thread(target=self._beat, args=(every_s,), daemon=True).start()
        if job.targets is not None:
            threading.Thread(target=self._send_targets, daemon=True).start()

    # ---- operations

    def go(self) -> None:
        """Begin to move, if the show was started with `must_ask` and the robot was checked."""
        self._send(m.Go)

    def pause(self) -> None:
        """Brake within the limits, on the path, and stand there."""
        self._send(m.Pause)

    def resume(self) -> None:
        """Go on after `pause`."""
        self._send(m.Resume)

    def rate(self, ratio: float) -> None:
        """Play at this share of the speed of the plan, from `schema.RATE_LEAST` to 1."""
        if not m.RATE_LEAST <= ratio <= 1.0:
            raise InputError(
                f"rate {ratio:g}: from {m.RATE_LEAST:g} to 1, the speed of the plan, which is "
                f"within the limits at that speed only; pause() stands"
            )
        self._send(m.Rate, ratio=float(ratio))

    def seek(self, to: float | str) -> None:
        """Brake, move to where the show is at `to`, a show time or a label, and go on from there.

        Raises `InputError` for a place that is not in the show.
        """
        self._program.instant_of(to)
        self._send(m.Seek, to=to if isinstance(to, str) else float(to))

    def set_target(self, deg: Mapping[str, float]) -> None:
        """Lead joints to these angles; the newest of each joint counts.

        It is for a job with `targets`.
        """
        with self._lock:
            self._targets |= deg
        self._has_targets.set()

    def steer(
        self, *, forward_mm_s: float = 0.0, left_mm_s: float = 0.0, turn_deg_s: float = 0.0
    ) -> None:
        """Walk at this velocity of the body from the next steps on; without any go to a stand.

        It is for what `walk` has started. Each part is kept within the largest velocity.
        """
        parts = {"forward_mm_s": forward_mm_s, "left_mm_s": left_mm_s, "turn_deg_s": turn_deg_s}
        for name, value in parts.items():
            if not abs(value) <= m.WALK_MAX:
                raise InputError(f"{name} is {value:g}; from {-m.WALK_MAX:g} to {m.WALK_MAX:g}")
        self._send(m.SteerWalk, **{name: float(value) for name, value in parts.items()})

    def stop(self) -> None:
        """Brake within the limits, hold, and give the servos back their settings."""
        self._send(m.Stop)

    def estop(self) -> None:
        """Send the safe bytes at once and end. The servos keep the settings of the show."""
        self._send(m.Estop)

    def _send(self, operation: type[m.Operation], **fields: object) -> None:
        with self._lock:
            if not self._ended.is_set():
                is_last = operation in (m.Stop, m.Estop)  # Kept, however full the link is.
                content = self._message(operation, **fields)
                self._link.send(Kind.OPERATION, content, is_last=is_last)

    def _message(self, operation: type[m.Operation], **fields: object) -> bytes:
        message = operation(id=self._next_id, **fields)
        self._next_id += 1
        return message.to_json()

    # ---- what happens

    @property
    def is_playing(self) -> bool:
        """Whether the process that plays has not ended."""
        return not self._ended.is_set()

    @property
    def show_s(self) -> float | None:
        """The show time that was last reported; None before the show begins."""
        return None if self._telemetry is None else self._telemetry.show_s

    def readings(self) -> Mapping[str, Reading]:
        """Return the newest state of every joint, by name; empty before the show begins."""
        telemetry, health, begun = self._telemetry, self._health, self._started
        if telemetry is None or begun is None:
            return {}
        found = {}
        for name, angles in zip(begun.joints, telemetry.angles_deg, strict=True):
            planned_deg, predicted_deg, read_deg = angles
            own = None if health is None else health.joints.get(name)
            found[name] = Reading(
                planned_deg,
                predicted_deg,
                None if math.isnan(read_deg) else read_deg,
                None if own is None else own.error_deg,
                None if own is None else own.status,
                None if own is None else own.temperature_c,
                None if own is None else own.voltage_v,
                None if own is None else own.current_a,
            )
        return found

    def events(self, timeout_s: float | None = None) -> Iterator[m.AnyEvent]:
        """Yield what happens, as values of `playing.remote.schema`, until the show has ended.

        Ends earlier when nothing has happened for `timeout_s`.
        """
        while True:
            try:
                event = self._events.get(timeout=timeout_s)
            except queue.Empty:
                return
            yield event
            if isinstance(event, m.Ended):
                return

    def wait(self, timeout_s: float | None = None) -> Report:
        """Wait until the show has ended; return its report, as `lss.play` does.

        Raises what `lss.play` raises, and `TimeoutError` after `timeout_s`: then it plays on.
        """
        if not self._ended.wait(timeout_s):
            raise TimeoutError(f"the show plays on after {timeout_s:g} s")
        outcome = self._outcome
        if outcome is None:
            raise BusError(f"{GONE} (exit code {self._process.wait(END_S)})")
        if outcome.error is not None:
            raise in_python_words(outcome.error)
        # A run without an error has a report, and one show that of `lss.play`.
        return cast("Report", outcome.report)

    # ---- the end

    def close(self) -> None:
        """Stop the show if it plays, and wait for its end; raises nothing about the robot.

        A player that stands still is waited for twice `STOP_S`, and then left with a warning: what
        it was sent stays in its link, so that it makes the robot safe when it goes on.
        """
        self.stop()
        if not self._ended.wait(STOP_S):
            self.estop()
            if not self._ended.wait(STOP_S):
                warnings.warn(STANDS_STILL.format(self._process.pid), RuntimeWarning, stacklevel=2)
                return
        self._listener.join(END_S)

    def __repr__(self) -> str:
        """Return one line: what plays, its phase, and the show time."""
        name = "" if self._started is None else f" {self._started.name!r}"
        show_s = "" if self.show_s is None else f", {self.show_s:.1f} s"
        state = self.phase if self.is_playing else "ended"
        return f"<show{name}: {state}{show_s}>"

    def _beat(self, every_s: float) -> None:
        """Tell the player that this process is alive, until the show has ended."""
        while not self._ended.wait(every_s):
            with self._lock:  # One that is late is worthless: a stop needs the room.
                self._link.offer(Kind.OPERATION, self._message(m.Beat))

    def _send_targets(self) -> None:
        """Send the newest targets, and not so many that any must wait, until it has ended."""
        while not self._ended.wait(TARGET_EVERY_S):
            self._has_targets.wait()
            self._has_targets.clear()
            with self._lock:
                newest, self._targets = self._targets, {}
            if newest:
                self._send(m.LeadJoints, deg=newest)

    def _listen(self) -> None:
        """Take what the player sends until it ends."""
        try:
            with contextlib.suppress(PipeClosedError, OSError):
                while True:
                    wait_for([self._link.fileno()], FLUSH_S)
                    with self._lock:
                        self._link.flush()
                    for kind, content in self._link.receive():
                        self._take(kind, content)
            if self._outcome is None:
                self._note(m.Ended(outcome="lost", error=GONE, report=None))
            self._process.wait(END_S)
        finally:
            self._ended.set()
            self._has_targets.set()
            with self._lock:
                self._link.close()

    def _take(self, kind: Kind, content: bytes) -> None:
        match kind:
            case Kind.TELEMETRY:
                self._telemetry = Telemetry.from_bytes(content)
            case Kind.OBJECT:
                self._outcome = pickle.loads(content)  # noqa: S301  (from our own process)
            case _:
                self._note(m.parse_event(content))

    def _note(self, event: m.AnyEvent) -> None:
        match event:
            case m.Started():
                self._started = event
            case m.PhaseChanged():
                self.phase = event.phase
            case m.Health():
                self._health = event
                return
        while True:
            try:
                self._events.put_nowait(event)
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._events.get_nowait()
            else:
                return
