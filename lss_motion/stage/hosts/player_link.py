"""The player of a figure: a process of its own, steered through its link (`remote`).

It gets its plan when the figure is armed, moves to the start of the show and stands there until a
leg comes (`playing.player.following`). It is started before, when the one before it ends, so that
no show waits until Python has imported it. When this process dies or falls silent, the player
brakes and holds.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.errors import EXIT_UNREACHABLE, LssMotionError
from lss_motion.playing.player.events import Phase
from lss_motion.playing.player.following import SLOW_RATE, FollowRule
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.job import Job
from lss_motion.playing.remote.message import Telemetry
from lss_motion.playing.remote.player_end import LossRule
from lss_motion.playing.remote.process import begin_process, give_job, packed
from lss_motion.playing.sound_choice import SoundChoice
from lss_motion.robot.on_fault import Cause
from lss_motion.stage.hosts.figure import KEPT_PLANS, PlayerReport
from lss_motion.stage.hosts.messages import hash_of
from lss_motion.stage.hosts.plans import read_plan
from lss_motion.stage.hosts.remote_figures import LOST_NS
from lss_motion.system.messages import Kind, PipeClosedError
from lss_motion.system.reactor import wait_for
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from lss_motion.robot.model import Robot
    from lss_motion.system.messages import MessagePipe
    from lss_motion.system.process import ChildProcess

PLAYER_MODULES: Final = (
    "lss_motion.playing.remote.job",
    "lss_motion.playing.run",
    "lss_motion.sim.bus",
)
"""What a player imports before it gets its job: 1.5 s of a core here, of which 0.1 s are left."""
CLOSE_S: Final = 10.0
"""A player that was stopped has ended by then, or it is told to end at once."""


class PlayerLink:
    """Starts, steers and watches the player of one robot; `options` are those of `perform`."""

    def __init__(
        self,
        robot: Robot,
        *,
        freewheel_s: float = 2.0,
        log: Callable[[str], None] = lambda _text: None,
        pass_on: Callable[[Kind, bytes], None] = lambda _kind, _content: None,
        new_stop_end: Callable[[], socket.socket | None] = lambda: None,
        **options: Any,  # noqa: ANN401
    ) -> None:
        """`pass_on` gets its events and telemetry, for operators.

        `new_stop_end` gives each player a pipe for stops of its own, where there is a process that
        only stops.
        """
        self._robot, self._options, self._log = robot, options, log
        self._pass_on, self._new_stop_end = pass_on, new_stop_end
        self._rule = FollowRule(
            freewheel_s=s_from_ns(LOST_NS) + freewheel_s,
            lost="hold",
            slowest=SLOW_RATE,
            goes_to_it=True,
        )
        """From the last beat: a conductor is lost after `LOST_NS`, and then comes the freewheel."""
        self._process: ChildProcess[Any] | None = None
        self._link: MessagePipe | None = None
        self._spare: ChildProcess[Any] | None = None
        """The next player, which waits for its job."""
        self._report = PlayerReport()
        self._show_s: float | None = None
        self._rate, self._shown_ns = 0.0, 0
        """Of the show, when `_show_s` arrived, and when that was."""
        self._cause = ""
        self._number = 0
        self._jobs_lock = threading.Lock()
        self._jobs: dict[str, bytes] = {}
        """The packed jobs of the plans that were prepared last, by their hashes."""
        self._is_closing = False
        self._leaving: list[ChildProcess[Any]] = []
        """Processes that end by themselves."""
        self.reports: list[dict[str, Any]] = []
        """Reports of the runs that have ended."""

    def prepare(self, plan: bytes) -> str:
        """Read and verify a plan, and keep it for `arm`; return why it cannot be played.

        Called in a thread: of a long plan it takes a second, and beats must not wait for it.
        """
        try:
            program = read_plan(plan, self._robot)
        except LssMotionError as error:
            return str(error)
        job = Job(
            shows=program,
            robot=self._robot,
            rule=LossRule(on_lost="stop"),
            follow=self._rule,
            # Sounds of the conductor's robot follow the legs, as the robot does.
            options={"sound": SoundChoice(leads=False), **self._options},
        )
        name, content = hash_of(plan), packed(job)
        with self._jobs_lock:
            jobs = [(one, kept) for one, kept in self._jobs.items() if one != name]
            # More than the figure counts on.
            self._jobs = dict([*jobs[1 - 2 * KEPT_PLANS :], (name, content)])
        return ""

    def arm(self, plan: str, start_s: float) -> None:
        """Start the player with a plan that was prepared; it moves to `start_s`, and waits there.

        `plan` is its hash.
        """
        if self._link is not None:  # Of a run that has ended: its figure waits for that.
            self._gone()
        job = self._jobs.get(plan)
        if job is None:
            self._report = _failed("the plan is not prepared")
            return
        self._process = self._take_spare()
        give_job(self._process, job, options={"start_s": start_s or None})
        self._link = self._process.pipe
        self._show_s, self._rate, self._cause = None, 0.0, ""
        self._report = PlayerReport(is_running=True)

    def _take_spare(self) -> ChildProcess[Any]:
        """Return the player that waits, or a new one where there is none."""
        spare, self._spare = self._spare, None
        if spare is not None and spare.exit_code() is not None:
            spare.pipe.close()
            spare = None
        return spare or self._begin()

    def _begin(self) -> ChildProcess[Any]:
        with contextlib.ExitStack() as stack:
            if (stop_end := self._new_stop_end()) is not None:
                stack.enter_context(stop_end)
            return begin_process(stop_end, PLAYER_MODULES)

    def _keep_spare(self) -> None:
        """Start the next player as soon as the present one is about to end."""
        is_free = self._link is None or self._report.is_stopped
        if is_free and self._spare is None and self._jobs and not self._is_closing:
            self._spare = self._begin()

    def follow(self, instant_ns: int, show_s: float, rate: float) -> None:
        """Tell it where the show is."""
        self._send(m.Follow, instant_ns=instant_ns, show_s=show_s, rate=rate, source="conductor")

    def stop(self) -> None:
        """Let it brake, hold and end."""
        self._report = replace(self._report, is_stopped=True)
        self._send(m.Stop)

    def report(self, now_ns: int) -> PlayerReport:
        """Take what it sent, and return what is known of it."""
        self._keep_spare()
        if self._link is not None:
            self._link.flush()
            try:
                for kind, content in self._link.receive():
                    self._take(kind, content)
            except PipeClosedError:
                self._gone()
        show_s = self._show_s
        if show_s is not None:  # It was there when it was sent.
            show_s += self._rate * s_from_ns(max(now_ns - self._shown_ns, 0))
        stands = self._report.phase == Phase.SHOW and self._rate == 0.0
        return replace(self._report, show_s=show_s, stands=stands)

    def _take(self, kind: Kind, content: bytes) -> None:
        self._pass_on(kind, content)
        if kind is Kind.TELEMETRY:
            telemetry = Telemetry.from_bytes(content)
            self._show_s, self._rate = telemetry.show_s, telemetry.rate
            self._shown_ns = time.monotonic_ns()
        elif kind is Kind.EVENT:
            match m.parse_event(content):
                case m.PhaseChanged() as event:
                    self._report = replace(self._report, phase=event.phase)
                case m.WarningRaised() as event:
                    self._log(f"player: {event.text}")
                case m.Health() as event:
                    known = [one.temperature_c for one in event.joints.values()]
                    hottest_c = max((c for c in known if c is not None), default=None)
                    self._report = replace(self._report, hottest_c=hottest_c, late_us=event.late_us)
                case m.FaultFound() as event:
                    self._cause = event.kind
                    self._log(f"player: joint {event.joint!r}: {event.kind}: {event.step}")
                case m.Refused() as event:
                    self._log(f"player refused: {event.text}")
                case m.Ended() as event:
                    self._end(event)

    def _end(self, event: m.Ended) -> None:
        if event.report is not None:
            self.reports.append(event.report)
        lost = Cause.LOST_PORT.value if event.exit_code == EXIT_UNREACHABLE else "error"
        if event.outcome == "finished":
            self._report = PlayerReport(outcome="finished")
        elif event.outcome == "stopped" and event.error is None:
            self._report = PlayerReport()
        else:
            self._report = _failed(event.error or event.outcome, self._cause or lost)

    def _gone(self) -> None:
        """Forget the process: it has ended."""
        if self._report.is_running:
            self._report = _failed("its process is gone; the servos come to rest by themselves")
        if self._link is not None:
            self._link.close()
        if self._process is not None:
            self._leaving.append(self._process)
        self._leaving = [process for process in self._leaving if process.exit_code() is None]
        self._link = self._process = None

    def _send(self, operation: type[m.Operation], **fields: object) -> None:
        link = self._link
        if link is None or link.is_closed:
            return
        self._number += 1
        message = operation(id=self._number, **fields)
        link.send(Kind.OPERATION, message.to_json())

    def close(self) -> None:
        """Stop it, and wait until it has ended."""
        self._is_closing = True
        if self._spare is not None:
            self._spare.pipe.close()  # It ends by that.
            self._leaving.append(self._spare)
            self._spare = None
        if self._link is not None:
            self.stop()
            if not self._wait() and self._link is not None:
                self._send(m.Estop)
                self._wait()
            self._gone()
        for process in self._leaving:
            process.wait(CLOSE_S)

    def _wait(self) -> bool:
        end_ns = time.monotonic_ns() + int(CLOSE_S * 1e9)
        while self._link is not None and time.monotonic_ns() < end_ns:
            wait_for([self._link.fileno()], 0.1)
            self.report(time.monotonic_ns())
        return self._link is None


def _failed(text: str, cause: str = "error") -> PlayerReport:
    return PlayerReport(outcome="failed", text=text, cause=cause)
