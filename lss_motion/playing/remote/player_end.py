"""The player's end: applies what clients ask for, and sends what happens.

`Steering` is the controls and the observer of one run (`run.Observer`). It never waits,
and a client that floods it, or does not read, changes no move (`operator_end`): the rate is changed
at most every `RATE_EVERY_NS`, and nothing is sent shortly before a move is due.
"""

from __future__ import annotations

import math
import pickle
from typing import TYPE_CHECKING, Final, Literal, Protocol

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.player import events
from lss_motion.playing.player.events import Phase
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.joint_health import joints_health
from lss_motion.playing.remote.message import Telemetry
from lss_motion.playing.targets import TargetLimiter
from lss_motion.playing.walking.steered import SteeredWalk
from lss_motion.protocol.constants import Led
from lss_motion.system.messages import Kind
from lss_motion.units import NS_PER_MS, NS_PER_S, NS_PER_US, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lss_motion.planning.program.live_edit import ProgramEdit
    from lss_motion.playing.joint_view import Angles
    from lss_motion.playing.player.following import Following
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.streamer import Streamer
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Robot

OnLost = Literal["stop", "hold", "go_on"]
"""What the player does when its operator is lost."""

TELEMETRY_NS: Final = 25 * NS_PER_MS
MAPPED_RATIO: Final = 4
"""Angles of servos behind mechanisms are sent so many times less often, and need so much more room:
to map them takes 3 ms of nine servos (measured)."""
HEALTH_NS: Final = NS_PER_S // 4
ROOM_NS: Final = 3 * NS_PER_MS
"""Nothing is sent to the client within this time before a move is due (as `cli.display`)."""
OVERDUE_NS: Final = NS_PER_S // 4
"""Telemetry that is later than this is sent in any case. Of 18 joints it takes a millisecond or two
on a busy computer (measured), so it must not be often."""
RATE_EVERY_NS: Final = 100 * NS_PER_MS
"""The newest wish for a rate is applied this long after the one before. A ramp takes three times
as long; more changes a second would only fill the line with moves."""


class LossRule(Struct, frozen=True):
    """When the operator counts as lost, and what is done then.

    `silent_s`: without a message for so long; None: only when the link is closed.
    """

    on_lost: OnLost = "stop"
    silent_s: float | None = None


class MotionSource(Protocol):
    """What extends an open show by what a client asks for: a walk, or joints that follow targets.

    It never waits.
    """

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""

    def act(self, player: Player, now_ns: int) -> None:
        """Extend the show, if that is due."""

    def brake(self, player: Player, now_ns: int) -> None:
        """Bring the robot to rest as soon as its limits allow; the show ends after that."""

    def take_texts(self) -> Sequence[str]:
        """Return what a client should know since the last call."""


class Steering:
    """One client that steers one run. Its methods are the callbacks of `run.Observer`."""

    def __init__(
        self,
        operator: Operator,
        rule: LossRule | None = None,
        *,
        following: Following | None = None,
        led: MotionSource | None = None,
    ) -> None:
        """Steer by what `operator` asks for.

        With `following` the show follows its legs; `led` extends it by what is asked for.
        """
        self.operator = operator
        self._led = led
        self._following = following
        self._rule = rule or LossRule()
        self._is_lost = self._has_stopped = False
        self._rate, self._is_paused = 1.0, False
        self._applied = (1.0, False)
        self._rated_ns = -RATE_EVERY_NS
        self._telemetry_ns = self._health_ns = 0
        self._shown_s = 0.0
        self.plans: dict[str, bytes] = {}
        """The names of the plans of a run of many shows, by show."""
        self._plan = b""
        self._slower = 1
        self._view: JointView | None = None
        """The joints of the robot that plays, from the first event on."""
        self._use: dict[str, tuple[int, int, int]] = {}

    # ---- controls

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""
        return [*self.operator.filenos(), *(() if self._led is None else self._led.filenos())]

    def act(self, player: Player, now_ns: int) -> None:
        """Apply what has arrived since the last call, stops first."""
        if signals := self.operator.take_signals():
            self._obey_signals(player, now_ns, signals)
        for operation in self.operator.take(now_ns):
            try:
                self._apply(operation, player, now_ns)
            except InputError as refused:
                self.operator.refuse(operation, str(refused))
            else:
                self.operator.accept(operation)
        self._take_edits(player, now_ns)
        self._apply_rate(player, now_ns)
        self._watch(player, now_ns)
        if self._led is not None and not self._has_stopped:
            self._led.act(player, now_ns)
            for text in self._led.take_texts():
                self.operator.send(m.WarningRaised(text=text))
        if self._following is not None and not self._has_stopped:
            self._following.turn(player, now_ns)
            for text in self._following.take_texts():
                self.operator.send(m.WarningRaised(text=text))

    def _take_edits(self, player: Player, now_ns: int) -> None:
        """Go on with edited programs of the server that started this, if they come in time."""
        if player.repertoire.only is None:
            return  # A stage goes on with newer files in its own way.
        for content in self.operator.take_objects():
            operation, packed = pickle.loads(content)  # noqa: S301  (from our own program)
            edit: ProgramEdit = pickle.loads(packed)  # noqa: S301
            try:
                self._edit(edit, player, now_ns)
            except InputError as refused:
                self.operator.refuse(operation, str(refused))
            else:
                self._plan = edit.plan
                self.operator.accept(operation)

    def _edit(self, edit: ProgramEdit, player: Player, now_ns: int) -> None:
        if self._has_stopped or self._led is not None or self._following is not None:
            raise InputError("the show is stopped, led, or follows a leader")
        player.edit(edit, now_ns)

    def _obey_signals(self, player: Player, now_ns: int, count: int) -> None:
        """Brake at the first signal, end at the second one."""
        if not self._has_stopped:
            self._stop(player, now_ns)
            count -= 1
        if count:
            player.abort(now_ns)

    def _apply(self, operation: m.AnyOperation, player: Player, now_ns: int) -> None:
        match operation:
            case m.Estop():
                self._has_stopped = True
                player.abort(now_ns)
            case m.Stop():
                self._stop(player, now_ns)
            case m.Beat():
                pass
            case _ if self._has_stopped or player.is_finished:
                raise InputError("the show has been stopped; start it again")
            case m.Follow():
                self._lead(operation, now_ns)
            case m.LeadJoints() | m.SteerWalk():
                self._lead_on(operation, now_ns)
            case m.Go() | m.Pause() | m.Resume() | m.Rate() | m.Seek():
                self._steer(operation, player, now_ns)
            case s.Change() | s.EndAdded() if player.repertoire.only is None:
                self._change(operation, player, now_ns)
            case _:
                raise InputError(f"{operation.op} is no operation on a running show")

    def _steer(self, operation: m.ShowOperation, player: Player, now_ns: int) -> None:
        """Apply an operation that ends nothing."""
        if self._led is not None and not isinstance(operation, m.Go):
            raise InputError(f"the robot is led: {operation.op} has no meaning now")
        if self._following is not None and isinstance(operation, m.Rate | m.Seek):
            raise InputError(f"the show follows a leader: {operation.op} has no meaning now")
        match operation:
            case m.Go():
                if player.phase is not Phase.READY:
                    raise InputError("go is for a robot that was checked and waits: not now")
                player.go()
            case m.Pause():
                self._is_paused = True
            case m.Resume():
                self._is_paused = False
            case m.Rate():
                self._rate = operation.ratio
            case m.Seek():
                player.seek(operation.to, now_ns)

    def _change(self, operation: s.Change | s.EndAdded, player: Player, now_ns: int) -> None:
        """Change between the shows of a run of many."""
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

    def _lead(self, operation: m.Follow, now_ns: int) -> None:
        if self._following is None:
            raise InputError("the show was not started to follow a leader")
        leg = LeaderPosition(operation.instant_ns, operation.show_s, operation.rate)
        self._following.lead(leg, now_ns)

    def _lead_on(self, operation: m.LeadJoints | m.SteerWalk, now_ns: int) -> None:
        match operation:
            case m.LeadJoints() if isinstance(self._led, TargetLimiter):
                self._led.set(operation.deg, now_ns)
            case m.SteerWalk() if isinstance(self._led, SteeredWalk):
                self._led.steer(operation.forward_mm_s, operation.left_mm_s, operation.turn_deg_s)
            case _:
                raise InputError(f"the player was not started for {operation.op}")

    def _stop(self, player: Player, now_ns: int) -> None:
        """Brake and end; the second call changes nothing, as both ways of a stop may arrive."""
        if not self._has_stopped:
            self._has_stopped = True
            if self._led is not None:
                self._led.brake(player, now_ns)
            player.stop(now_ns)

    def _apply_rate(self, player: Player, now_ns: int) -> None:
        """Set the newest rate that was asked for, unless the last change was just now."""
        wish = (self._rate, self._is_paused)
        if wish == self._applied or now_ns < self._rated_ns + RATE_EVERY_NS:
            return
        if self._has_stopped or player.is_finished:
            return
        self._applied, self._rated_ns = wish, now_ns
        if self._following is None:
            player.set_rate(0.0 if self._is_paused else self._rate, now_ns)
        else:
            self._following.set_paused(is_paused=self._is_paused)
        self.operator.send(m.RateChanged(ratio=self._rate, is_paused=self._is_paused))

    # ---- a lost operator

    def _watch(self, player: Player, now_ns: int) -> None:
        """Do what the rule says when the operator is gone, and when it is back."""
        if not self.operator.is_lost(now_ns, self._rule.silent_s):
            self._is_lost = False
            return
        if self._has_stopped or player.is_finished:
            return
        # Without a link the show can never be stopped, started or resumed by a client.
        is_stuck = self.operator.is_cut and (
            player.program.is_endless
            or player.phase is Phase.READY
            or self._is_paused
            or self._rule.on_lost == "hold"
        )
        if self._rule.on_lost == "stop" or is_stuck:
            self._stop(player, now_ns)
        elif self._rule.on_lost == "hold" and not self._is_lost:
            self._is_paused = True
        self._is_lost = True

    # ---- observer

    def on_event(self, event: events.Event) -> None:
        """Send what happened; the telemetry names the plan of the show that plays."""
        if isinstance(event, events.ShowBegan) and not event.is_added:
            self._plan = self.plans.get(event.name, b"")
        if (message := message_of(event, self._view)) is not None:
            self.operator.send(message)

    def on_turn(self, player: Player, now_ns: int) -> None:
        """Send telemetry and health if they are due, and no move is."""
        operator = self.operator
        if operator.is_cut:
            return
        if now_ns < min(self._telemetry_ns, self._health_ns) and not operator.link.is_full:
            return
        is_overdue = now_ns > self._telemetry_ns + OVERDUE_NS
        if player.is_due_within(self._slower * ROOM_NS, now_ns) and not is_overdue:
            return
        operator.link.flush()
        if now_ns >= self._telemetry_ns:
            self._telemetry_ns = now_ns + self._slower * TELEMETRY_NS
            operator.look_for_client()
            moving = player.moving
            if moving is not None and not operator.link.is_full:
                self._offer_telemetry(player, moving, now_ns)
        if now_ns >= self._health_ns:
            self._health_ns = now_ns + HEALTH_NS
            if not operator.link.is_full:
                operator.offer(self._health(player, now_ns))

    def start(self, message: m.Started, robot: Robot) -> None:
        """Send the first event; keep the name of the plan for the telemetry, and the joints."""
        self._plan, self._view = bytes.fromhex(message.plan), JointView(robot)
        self._slower = 1 if self._view.is_plain else MAPPED_RATIO
        self.operator.send(message)

    def start_many(self, name: str, robot: Robot, joints: Iterable[str]) -> None:
        """Send the first event of a run of many shows, whose `plans` are known."""
        from lss_motion.playing.connection import is_simulated

        self.start(
            m.Started(
                name=name,
                robot=robot.name,
                is_simulated=is_simulated(robot),
                duration_s=None,
                plan=next(iter(self.plans.values()), bytes(8)).hex(),
                joints=tuple(joints),
                marks=(),
            ),
            robot,
        )

    def end(self, message: m.Ended) -> None:
        """Send the last event."""
        self.operator.send(message)

    def _offer_telemetry(self, player: Player, moving: Streamer, now_ns: int) -> None:
        """Send the angles; on the way to a show, its clock stands where the last one was."""
        planned, states = moving.all_pose_deg(now_ns), moving.all_states()
        names = list(player.program.start_deg)
        if any(name not in states for name in names):
            return  # An approach does not lead joints that are left out.
        angles: Sequence[Angles] = [
            (planned[name], *_seen_deg(states[name], now_ns)) for name in names
        ]
        if self._view is not None:
            angles = self._view.angles(names, angles)
        rate = 0.0
        if player.show is not None:
            rate, self._shown_s = player.show.clock.rate(now_ns), player.show.show_s(now_ns)
        telemetry = Telemetry(self._plan, self._shown_s, rate, angles)
        self.operator.link.offer(Kind.TELEMETRY, telemetry.to_bytes())

    def _health(self, player: Player, now_ns: int) -> m.Health:
        show = player.show
        states = {} if show is None else show.all_states()
        joints = {name: _joint_health(state) for name, state in states.items()}
        if self._view is not None and not self._view.is_plain:
            here_deg = {name: _seen_deg(state, now_ns)[0] for name, state in states.items()}
            joints = joints_health(self._view, joints, here_deg)
        return m.Health(
            phase=player.phase.value,
            show_s=None if show is None else show.show_s(now_ns),
            rate=1.0 if show is None else show.clock.rate(now_ns),
            is_paused=player.is_paused,
            late_us=0 if show is None else max(show.statistics.latest_ns, default=0) // NS_PER_US,
            missed=0 if show is None else show.statistics.missed,
            joints=joints,
            buses=self._bus_use(player, now_ns),
        )

    def _bus_use(self, player: Player, now_ns: int) -> dict[str, m.BusHealth]:
        """Return the use of each line since the last call."""
        found = {}
        for name, line in player.lines.items():
            replies = player.trackers[name].reply_count
            then_ns, then_bytes, then_replies = self._use.get(name, (now_ns, 0, 0))
            self._use[name] = (now_ns, line.sent_bytes, replies)
            if now_ns > then_ns:
                use_ratio = line.time_ns(line.sent_bytes - then_bytes) / (now_ns - then_ns)
                replies_hz = (replies - then_replies) * NS_PER_S / (now_ns - then_ns)
                found[name] = m.BusHealth(
                    use_ratio=round(use_ratio, 3), replies_hz=round(replies_hz, 1)
                )
        return found


def _seen_deg(state: JointState, now_ns: int) -> tuple[float, float]:
    """Return the predicted and the last measured angle of a joint."""
    measured_deg = state.disturbance.measured_deg
    read_deg = math.nan if measured_deg is None else state.joint.joint_deg(measured_deg)
    return state.joint.joint_deg(state.predicted_deg(now_ns)), read_deg


def _joint_health(state: JointState) -> m.JointHealth:
    disturbance, sense = state.disturbance, state.joint.direction
    is_read = disturbance.measured_deg is not None
    return m.JointHealth(
        status=None if state.status is None else state.status.value,
        temperature_c=state.temperature_max_c,
        voltage_v=state.voltage_min_v,
        current_a=state.current_max_a,
        error_deg=round(sense * disturbance.error_deg, 3) if is_read else None,
        correction_deg=round(sense * disturbance.offset_deg, 3),
        allowed_deg=state.joint.following_deg,
    )


def message_of(event: events.Event, view: JointView | None = None) -> m.Message | None:
    """Return the message of an event of the player; None: it is not for clients.

    With `view` joints are named in place of the servos that move them.
    """
    match event:
        case events.PhaseEntered():
            return m.PhaseChanged(phase=event.phase.value)
        case events.Warned():
            return m.WarningRaised(text=event.text)
        case events.MarkPassed():
            return m.LabelPassed(label=event.label, at_s=event.show_s) if event.label else None
        case events.CueReached() | events.ShowBegan() | events.ShowOver():
            return _show_message(event, view)
        case events.Noted():
            return None
        case events.Waited():
            return m.WaitChanged(text=event.text, state=event.state)
        case events.Faulted():
            event = event if view is None else view.fault(event)
            return m.FaultFound(
                joint=event.joint,
                cause=event.cause,
                kind=event.kind.value,
                step=event.step.value,
            )
        case events.Checked():
            return m.ServosChecked(servos=len(event.servos), notes=event.notes)


def _show_message(
    event: events.CueReached | events.ShowBegan | events.ShowOver, view: JointView | None
) -> m.Message:
    if isinstance(event, events.CueReached):
        return _cue_message(event)
    if isinstance(event, events.ShowBegan):
        return m.ShowStarted(name=event.name, from_s=event.from_s, is_added=event.is_added)
    one = event.summary
    errors_deg = [
        joint.error_max_deg / (1.0 if view is None else view.ratio(name))
        for name, joint in one.joints.items()
    ]
    return m.ShowEnded(
        name=one.name,
        outcome=one.outcome,
        is_added=one.is_added,
        reached_s=one.reached_s,
        lasted_s=s_from_ns(one.ended_ns - one.began_ns),
        missed=one.missed,
        error_max_deg=max(errors_deg, default=0.0),
    )


def _cue_message(event: events.CueReached) -> m.CueFired:
    cue, at_s = event.cue, event.show_s
    if cue.sound:
        return m.CueFired(kind="sound", text=cue.sound, at_s=at_s)
    if cue.run:
        return m.CueFired(kind="run", text=cue.run, at_s=at_s)
    if cue.led:
        colours = ", ".join(f"{joint} {Led(code).name.lower()}" for joint, code in cue.led)
        return m.CueFired(kind="led", text=colours, at_s=at_s)
    return m.CueFired(kind="say", text=cue.say, at_s=at_s)
