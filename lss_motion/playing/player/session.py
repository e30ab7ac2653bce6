"""The servos during one show: their lines, their settings before it, and where they stand.

`Session` belongs to one `Player`. It builds the dialogues and the streamers of the phases, and
carries what they share: the answers before anything was changed, the positions at rest, the joints
that are left out, and the estimates that a later streamer takes over. It has no phase and decides
nothing. `approach` makes the slow program from where the robot stands to where the show starts.
"""

from __future__ import annotations

import itertools
import math
from enum import Enum, auto
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from lss_motion.planning.program.model import TOLERANCE_DEG, Move, Program, driving_of
from lss_motion.planning.program.move_table import lines_use
from lss_motion.planning.program.moves import standing_wire
from lss_motion.planning.program.reference_grid import GRID_S, Reference, servo_limits
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.verify import profiles
from lss_motion.playing.player import checks, handshake
from lss_motion.playing.player.cues import SensorWatch
from lss_motion.playing.player.estimators import OFFSET_MAX_DEG
from lss_motion.playing.player.handshake import Dialogue, SettingsDialogue
from lss_motion.playing.player.health import is_turned
from lss_motion.playing.player.joint_state import (
    LONGEST_NS,
    make_joint_states,
)
from lss_motion.playing.player.preflight import Preflight
from lss_motion.playing.player.query_choice import BY_NEED
from lss_motion.playing.player.query_tracker import AWAY_NS, QueryTracker, SerialLine
from lss_motion.playing.player.servo_model import Probe, with_room
from lss_motion.playing.player.streamer import Streamer
from lss_motion.playing.player.unasked import UnaskedWatches
from lss_motion.protocol.framing import Command, encode
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.profile import Piece, profile_lead_s, ramp_deg_s2, trapezoid
from lss_motion.units import (
    MS_PER_S,
    NS_PER_MS,
    NS_PER_US,
    line_time_ns,
    s_from_ns,
    s_from_us,
    us_from_s,
)

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.handshake import Answers, Item
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.robot.model import Joint, Robot


UNRESTORED_TEXT: Final = (
    "stopped at once, so the servos were not given back their settings: {} stay as this show "
    "needed them until their power is off, and the next show takes them for the servos' own. "
    "Switch their power off and on, or RESET them; hold the robot, it goes limp"
)


COUNT_IN_NS: Final = 200 * NS_PER_MS
"""Time from the arrival of all joints to the first instant of the show. Preparing a show takes time
(13 ms of processor time for 18 joints, measured), and no move may be due meanwhile."""
APPROACHES_MAX: Final = 3
"""Chosen: a move that the line lost is sent again, but a joint that cannot reach its start is not
pushed for ever."""


class Arrival(Enum):
    """What follows an approach."""

    THERE = auto()
    AGAIN = auto()
    ASTRAY = auto()


class Session:
    """The servos of one robot during one run."""

    def __init__(
        self,
        program: Program,
        robot: Robot,
        *,
        has_feedback: bool,
        is_forced: bool = False,
        pace: Pace | None = BY_NEED,
        watched: Iterable[str] = (),
    ) -> None:
        """Take what all programs of the run need together, as one program."""
        self.on_fault = program.on_fault
        """The steps that the present show requires about faults."""
        self.robot = robot
        self.joints = [robot.joints[name] for name in program.start_deg]
        self.lines = {name: SerialLine(robot.buses[name]) for name in robot.buses}
        self.trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self.unasked = UnaskedWatches(self.trackers)
        self.led_joints = {name for cue in program.cues for name, _ in cue.led}
        """Joints whose LED colour is changed, also by later programs."""
        self.has_feedback = has_feedback
        self._pace = pace
        self.is_forced = is_forced
        """Whether a person accepts what a show without feedback gives up."""
        self.original: Answers = {}
        """Answers of every servo before anything was changed."""
        self._before: Preflight | None = None
        self.standing_deg: dict[str, float] = {}
        """Servo angles by joint, as of the last query while nothing moved."""
        self.watched = SensorWatch(robot.sensors[name] for name in watched)
        """Sensors that are polled from the first streamer on, for a caller that acts on them."""
        self.left_out: set[str] = set()
        """Joints that are sent no move."""
        self._proved_ns: dict[str, int] = {}
        """By joint, when its servo was last compared with what it was before the show."""
        self.limp: list[Joint] = []
        """Joints whose motor has no power until the end."""
        self.beside: list[Streamer] = []
        """Streamers of shows that are played beside the present one, on joints of their own."""
        self._states: dict[str, JointState] = {}
        """The newest state of each joint, for its estimates."""

    @property
    def driven(self) -> list[Joint]:
        return [joint for joint in self.joints if joint.name not in self.left_out]

    @property
    def lent(self) -> set[str]:
        """The joints that shows beside the present one move."""
        return {name for streamer in self.beside for name in streamer.joint_states}

    @property
    def timeouts(self) -> int:
        """How many queries had no answer, on all buses."""
        return sum(tracker.timeouts for tracker in self.trackers.values())

    def leave_out(self, name: str) -> None:
        """Send a joint no move from now on."""
        self.left_out.add(name)

    def put_back(self, names: set[str]) -> None:
        """Send these joints moves again."""
        self.left_out -= names

    def make_limp(self, joint: Joint, now_ns: int) -> None:
        """Take the power from one motor, until the end."""
        self.limp.append(joint)
        self.lines[joint.bus].send(handshake.limp_bytes(joint), now_ns)

    def halt(self, joint: Joint, now_ns: int) -> None:
        """Stop one servo where it is, whatever it was sent before."""
        self.lines[joint.bus].send(encode(Command(joint.servo_id, "H")), now_ns)

    def safe_bytes(self, *, is_limp: bool) -> Mapping[str, bytes]:
        return handshake.safe_bytes(self.robot, is_limp=is_limp, limp=self.limp)

    # ---- dialogues

    def dialogue(self, items: Iterable[Item]) -> Dialogue:
        return Dialogue(items, self.trackers)

    def preflight(self, program: Program) -> Preflight:
        """Return the dialogue before anything is changed: servos, settings, sensors.

        Without feedback the stored limits must be right. What a simulated servo stores tells
        nothing about a real one, so otherwise it is not asked for it.
        """
        is_simulated = all(bus.is_simulated for bus in self.robot.buses.values())
        return Preflight(
            self.joints,
            self.robot,
            self.trackers,
            more=checks.sensor_queries(program, self.robot),
            led_joints=self.led_joints,
            reads_stored=not (self.has_feedback and is_simulated),
            show=program.on_fault,
        )

    def proof(
        self, joints: Iterable[Joint], answers: Answers, suspects: Sequence[Joint] = ()
    ) -> Preflight:
        """Return the dialogue with servos that were away, before anything moves them.

        They have given `answers` since. Other servos may have the ids of `suspects`.
        """
        return Preflight(
            joints,
            self.robot,
            self.trackers,
            before=self._before,
            answers=answers,
            suspects=suspects,
        )

    def settings_dialogue(self, now_ns: int) -> SettingsDialogue:
        """Return the dialogue that gives the servos their settings and polls their positions."""
        expected_deg = self._expected_deg(now_ns)
        return SettingsDialogue.of(self.driven, self.original, self.trackers, expected_deg)

    def arrival_dialogue(self, now_ns: int) -> Dialogue:
        """Return the queries around an approach: positions, and whether a servo has restarted."""
        probes = handshake.restart_probes(self.driven, self.original)
        positions = handshake.position_queries(self.driven, self._expected_deg(now_ns))
        return self.dialogue([*handshake.read_back(probes), *positions])

    def restoring_dialogue(self) -> Dialogue:
        """Return the orders that give the servos back their settings."""
        joints, led_joints = self.joints, self.led_joints
        return self.dialogue(handshake.restoring_orders(joints, self.original, led_joints))

    # ---- answers

    def note_original(
        self, preflight: Preflight, program: Program, start_deg: Mapping[str, float]
    ) -> list[Event]:
        """Keep what the servos answered before any change; return what a person should know.

        Raises if a servo or a sensor is missing, or a servo must not do what the program requires.
        """
        self.original, self._before = preflight.answers, preflight
        self.standing_deg = handshake.standing_deg(self.joints, preflight.answers)
        preflight.require_own_ids()
        self.unasked.start()
        return checks.check(
            program,
            self.robot,
            self.joints,
            preflight,
            self.trackers,
            start_deg,
            has_feedback=self.has_feedback,
            is_forced=self.is_forced,
        )

    def turned(self, answers: Answers, now_ns: int) -> list[tuple[Joint, float, float]]:
        """Return joints that are more than half a turn from where they were sent, or stood.

        With each the servo angle that it reports, and the one where it was.
        """
        found = []
        for name, reported_deg in handshake.standing_deg(self.driven, answers).items():
            state, before_deg = self._states.get(name), self.standing_deg[name]
            if state is not None:
                is_elsewhere = is_turned(state, reported_deg, s_from_ns(now_ns))
                before_deg = state.place(now_ns)[0]
            else:
                is_elsewhere = abs(reported_deg - before_deg) > HALF_TURN_DEG
            joint = self.robot.joints[name]
            if is_elsewhere and joint.drive != "stepped":
                found.append((joint, reported_deg, before_deg))
        return found

    def note_positions(self, answers: Answers) -> list[Joint]:
        """Keep where the driven servos stand; return those that did not answer."""
        standing = handshake.standing_deg(self.driven, answers)
        self.standing_deg |= standing
        return [joint for joint in self.driven if joint.name not in standing]

    def note_readings(self, streamer: Streamer, since_s: float) -> bool:
        """Keep where the servos of `streamer`, which rests, have read themselves since `since_s`.

        Return whether all have. For joints that cannot be asked in a dialogue: others move.
        """
        missing = 0
        for name, state in streamer.joint_states.items():
            load = state.disturbance
            if state.joint.drive == "stepped":  # It answers with its last command only.
                self.standing_deg[name] = state.profile.at(since_s)[0]
            elif load.measured_deg is not None and (load.read_s or 0.0) >= since_s:
                self.standing_deg[name] = load.measured_deg
            else:
                missing += state.is_driven
        return not missing

    def judge_arrival(
        self, pose_deg: Mapping[str, float], approaches: int, now_ns: int
    ) -> tuple[Arrival, str, float]:
        """Return whether the joints are where they were sent, by where they stand.

        Besides the joint that is furthest away, and by how much. Their loads are learnt.
        """
        is_first = approaches == 1
        if self.has_feedback:
            # Also before it goes on: what went wrong may have been taken for a load. The first move
            # may have been lost.
            within_deg = handshake.ARRIVED_DEG if is_first else OFFSET_MAX_DEG
            for name in pose_deg:
                if name in self._states:
                    self._states[name].learn_droop(self.standing_deg[name], now_ns, within_deg)
        joint, off_deg = self.furthest(pose_deg)
        is_uncorrected = self.has_feedback and is_first
        if off_deg <= (handshake.LOADED_DEG if is_uncorrected else handshake.ARRIVED_DEG):
            return Arrival.THERE, joint, off_deg
        if approaches < APPROACHES_MAX:
            return Arrival.AGAIN, joint, off_deg
        is_near = off_deg <= self.robot.joints[joint].following_deg
        return Arrival.THERE if is_near else Arrival.ASTRAY, joint, off_deg

    def restarted(self, answers: Answers, since_ns: int) -> tuple[list[Joint], list[Joint]]:
        """Return the driven servos that no longer have their settings, and those that may not.

        The latter did not report them, or were away, and have answered again since `since_ns`.
        """
        probes = handshake.restart_probes(self.driven, self.original)
        has_reported = {
            (order.bus, order.command.servo_id): handshake.is_answered(order, answers)
            for order in handshake.not_applied(probes, answers)
        }
        wrong = [(one, has_reported.get((one.bus, one.servo_id))) for one in self.driven]
        back = [j for j in self.driven if self.trackers[j.bus].back_ns(j.servo_id) > since_ns]
        return [j for j, has in wrong if has], [j for j, has in wrong if has is False] + back

    def note_proved(self, joints: Iterable[Joint], now_ns: int) -> None:
        """Note that the servos of these joints are the ones of before."""
        self._proved_ns |= {joint.name: now_ns for joint in joints}

    def unproved(self) -> list[Joint]:
        """Return the driven joints whose servos were away since they were last compared."""
        return [
            joint
            for joint in self.driven
            if self.trackers[joint.bus].back_ns(joint.servo_id) > self._proved_ns.get(joint.name, 0)
        ]

    def unheard(self, now_ns: int) -> list[Joint]:
        """Return the driven joints whose servos could have been exchanged since compared last.

        They were not heard for long enough, asked or not.
        """
        found = []
        for joint in self.driven:
            tracker, servo_id = self.trackers[joint.bus], joint.servo_id
            last_ns, proved_ns = tracker.last_reply_ns(servo_id), self._proved_ns.get(joint.name, 0)
            is_unheard = last_ns is None or now_ns - max(last_ns, proved_ns) >= AWAY_NS
            if is_unheard or tracker.gap_ns(servo_id) > proved_ns:
                found.append(joint)
        return found

    def unrestored_text(self) -> str:
        """Return a warning about settings that are not given back; empty if none was changed."""
        orders = handshake.changing_orders(self.joints, self.original)
        words = ", ".join(sorted({order.command.keyword for order in orders}))
        return UNRESTORED_TEXT.format(words) if words else ""

    # ---- places

    def start_of(self, program: Program, start_s: float | None) -> dict[str, float]:
        """Return the joint angles of the horns at `start_s` of a program, or at its beginning.

        Its profiles are early by the lead of each joint (`Streamer.planned_deg`).
        """
        if start_s is None:
            return dict(program.start_deg)
        pose_deg = {}
        for name, plan in profiles(program, self.robot).items():
            joint = self.robot.joints[name]
            plan_s = program.within(start_s - profile_lead_s(joint))
            pose_deg[name] = joint.joint_deg(plan.at(plan_s)[0])
        return pose_deg

    def furthest(self, pose_deg: Mapping[str, float]) -> tuple[str, float]:
        """Return the driven joint that stands furthest from `pose_deg`, and its distance in deg."""
        return max(
            (
                (name, abs(self.robot.joints[name].servo_deg(angle) - self.standing_deg[name]))
                for name, angle in pose_deg.items()
            ),
            key=lambda far: far[1],
            default=("", 0.0),
        )

    def _commanded_deg(self, now_ns: int) -> dict[str, float]:
        """Return the servo angles to which the last moves sent the servos."""
        return {name: state.place(now_ns)[0] for name, state in self._states.items()}

    def _expected_deg(self, now_ns: int) -> dict[str, float]:
        """Return the servo angles where the servos, which rest, were sent, or stood."""
        return self.standing_deg | self._commanded_deg(now_ns)

    # ---- streamers

    def approach(
        self, pose_deg: Mapping[str, float], now_ns: int, *, is_beside: bool = False
    ) -> Streamer:
        """Return the streamer that takes these joints from where they stand to `pose_deg`.

        `is_beside`: while a show moves the other joints.
        """
        standing_deg = without_noise(self.robot, self.standing_deg)
        program = approach(self.robot, standing_deg, pose_deg)
        streamer = self._stream(program, standing_deg, now_ns, is_beside=is_beside)
        for state in streamer.joint_states.values():
            state.limit_speed(self.robot.approach_speed_deg_s)
        return streamer

    def begin(
        self, program: Program, start_s: float | None, start_ns: int, *, is_beside: bool = False
    ) -> Streamer:
        """Return a show, which starts at `start_ns` with every joint at its start.

        The servos stand where they were sent: at the start, corrected for their load. `is_beside`:
        it is played beside the present one, on joints of its own.
        """
        start_deg, joints = self.start_of(program, start_s), self.robot.joints
        standing = {name: joints[name].servo_deg(deg) for name, deg in start_deg.items()}
        commanded = self._commanded_deg(start_ns)
        standing |= {name: commanded[name] for name in standing if name in commanded}
        return self._stream(program, standing, start_ns, start_s, is_beside=is_beside)

    def take_back(self, program: Program, streamer: Streamer, now_ns: int) -> dict[str, JointState]:
        """Return states for joints that `streamer` has moved beside a show, and that rest now.

        With them, the present show, which plays `program`, holds these joints where they stand.
        """
        program = replace(
            program, start_deg=streamer.pose_deg(now_ns), moves=(), repeat=None, cues=()
        )
        commanded = self._commanded_deg(now_ns)
        states = make_joint_states(
            program,
            self.robot,
            commanded,
            s_from_ns(now_ns),
            has_feedback=self.has_feedback,
        )
        for name, state in states.items():
            before = self._states[name]
            state.firmware, state.is_driven = before.firmware, before.is_driven
            state.take_over(before)
            if before.in_doubt:
                state.hold_back()
            self._states[name] = state
            self.standing_deg[name] = commanded[name]
        return states

    def note_standing(self, now_ns: int) -> None:
        """Keep where the last moves have sent the servos, which have braked since."""
        self.standing_deg |= self._commanded_deg(now_ns)

    def resume(self, show: Streamer, now_ns: int) -> None:
        """Go on with `show` from where the approach sent the servos, with its estimates."""
        commanded = self._commanded_deg(now_ns)
        show.resume({n: commanded[n] for n in show.joint_states if n in commanded}, self.left_out)
        self._take_over(show)

    def _probes(self) -> dict[str, list[Probe]]:
        """Return what shows that a servo has restarted, or that another one is in its place."""
        found = handshake.probes(self.driven, self.original)
        for joint in self.driven:
            for keyword in (f"Q{name}" for name in checks.FRAME):
                value = self.original.get((joint.bus, joint.servo_id, keyword))
                if isinstance(value, int):
                    found.setdefault(joint.name, []).append(Probe(keyword, value, value))
        return found

    def _stream(
        self,
        program: Program,
        standing_deg: Mapping[str, float],
        now_ns: int,
        start_s: float | None = None,
        *,
        is_beside: bool = False,
    ) -> Streamer:
        streamer = Streamer(
            program,
            self.robot,
            trackers=self.trackers,
            standing_deg=standing_deg,
            has_feedback=self.has_feedback,
            start_ns=now_ns,
            start_s=start_s,
            probes=self._probes(),
            pace=self._pace,
            beside=() if is_beside else self.beside,
            is_polling=not is_beside,
        )
        if streamer.scheduler is not None:
            streamer.scheduler.watched = self.watched
        streamer.leave_out(self.left_out)
        self._take_over(streamer, () if is_beside else self.lent)
        return streamer

    def _take_over(self, streamer: Streamer, lent: Container[str] = ()) -> None:
        """Give the joints of `streamer` the estimates of the streamer before it.

        Another streamer moves the joints `lent`.
        """
        for name, state in streamer.joint_states.items():
            if name in lent:
                continue
            state.firmware = checks.reported_firmware(state.joint, self.original)
            if name in self._states:
                state.take_over(self._states[name])
            self._states[name] = state


APPROACH_LEAST_S: Final = 0.3
"""Even a servo that stands in its place is given this long: it may be limp."""
GLIDE_AFTER_S: Final = 0.25
"""A course of bare `D`s begins this long after the first commands, so that each gets its slot."""
GLIDE_TOLERANCE_DEG: Final = 0.05
"""Half a wire unit: there is no hurry, and the speed should be even."""
NOISE_UNITS: Final = 3.0
"""A joint in EM0 that reads less than this outside of its range stands on its edge. Chosen: the
noise of a reading (FACTS.md E7), of which the filter makes a start of 5 deg/s at most. Without it,
each approach would send the joint further out by the noise of one reading."""
GLIDE_END_S: Final = 0.1
"""Time for which a course stands at its end, so that the end is fitted as a rest."""


def without_noise(robot: Robot, standing_deg: Mapping[str, float]) -> dict[str, float]:
    """Return the servo angles where joints stand, those in EM0 not outside of a range by noise."""
    standing = dict(standing_deg)
    for name, servo_deg in standing_deg.items():
        joint = robot.joints[name]
        edge_deg = _within_range(joint, servo_deg)
        is_near = abs(edge_deg - servo_deg) <= NOISE_UNITS * joint.unit_deg
        if joint.drive == "streamed" and is_near:
            standing[name] = edge_deg
    return standing


class _TimedLeg(NamedTuple):
    """One move of every timed joint at the same time: servo angles, and T in seconds."""

    targets_deg: dict[str, float]
    lasts_s: float


def _legs(
    robot: Robot, standing_deg: Mapping[str, float], end_deg: Mapping[str, float]
) -> list[_TimedLeg]:
    """Return the moves of the timed joints: as few as T allows, none above the approach speed.

    Every target is in the range of its joint. So a joint that stands outside has a longer way in
    its first move than in the others, and this move takes longer for all joints.
    """
    joints = [robot.joints[name] for name in end_deg]
    for count in itertools.count(1):
        legs, before_deg = [], dict(standing_deg)
        for number in range(1, count + 1):
            targets_deg, lasts_s = {}, APPROACH_LEAST_S / count
            for joint in joints:
                from_deg, whole_deg = standing_deg[joint.name], end_deg[joint.name]
                whole_deg -= from_deg
                target_deg = _within_range(joint, from_deg + number / count * whole_deg)
                way_deg = abs(whole_deg) / count
                if joint.drive == "timed":
                    is_cut = _within_range(joint, from_deg) != from_deg
                    way_deg = abs(target_deg - before_deg[joint.name]) if is_cut else way_deg
                    targets_deg[joint.name] = before_deg[joint.name] = target_deg
                lasts_s = max(lasts_s, way_deg / robot.approach_deg_s(joint))
            legs.append(_TimedLeg(targets_deg, lasts_s))
        if all(leg.lasts_s <= s_from_ns(LONGEST_NS) for leg in legs):
            return legs
    raise AssertionError("moves get shorter with their number")


def _within_range(joint: Joint, servo_deg: float) -> float:
    """Return the servo angle within the range of a joint that is nearest to `servo_deg`."""
    here_deg = joint.joint_deg(servo_deg)
    if joint.position_min_deg <= here_deg <= joint.position_max_deg:
        return servo_deg
    return joint.servo_deg(joint.within_deg(here_deg))


def approach(
    robot: Robot, standing_deg: Mapping[str, float], start_deg: Mapping[str, float]
) -> Program:
    """Return the program that takes every joint from where it stands to where the show starts.

    Every joint receives a command at once, which also ends being limp. All take equally long, and
    none is faster than `approach_speed_deg_s`. A timed joint arrives with that one move (or a few,
    where T would become too long), by its servo's own ramps. The others know no T: their first
    command holds them where they stand, and then they follow the same trapezoid. `standing_deg` are
    servo angles, `start_deg` joint angles.
    """
    robot = with_room(robot, standing_deg)
    joints = [robot.joints[name] for name in start_deg]
    end_deg = {joint.name: joint.servo_deg(start_deg[joint.name]) for joint in joints}
    legs = _legs(robot, standing_deg, end_deg)
    slowest_ramp_s = max(
        (robot.approach_deg_s(joint) / ramp_deg_s2(joint) for joint in joints), default=0
    )
    longest_s = sum(leg.lasts_s for leg in legs)
    moves: list[Move] = []
    begins_s = leg_s = 0.0
    for leg in legs:
        targets = dict(leg.targets_deg)
        if leg is legs[0]:
            leg_s = leg.lasts_s + slowest_ramp_s
            targets = {name: targets.get(name, standing_deg[name]) for name in end_deg}
        moves += _at_once(robot, targets, us_from_s(begins_s), math.ceil(MS_PER_S * leg.lasts_s))
        begins_s += leg.lasts_s + slowest_ramp_s
    first_s = s_from_us(max((m.due_us for m in moves if m.due_us < us_from_s(leg_s)), default=0))
    courses = {
        joint.name: _course(
            joint,
            standing_deg[joint.name],
            joint.servo_deg(start_deg[joint.name]),
            (first_s, first_s + GLIDE_AFTER_S, longest_s),
        )
        for joint in joints
        if joint.drive != "timed"
    }
    if courses:
        from lss_motion.planning.program.compile import (
            glide_moves,  # Timed joints need no compiler.
        )

        moves += glide_moves(courses, robot, GLIDE_TOLERANCE_DEG)
    moves.sort(key=lambda move: move.due_us)
    program = Program(
        name="approach",
        robot=robot.name,
        robot_path=robot.path,
        moves=tuple(moves),
        duration_s=0.0,
        start_deg={n: robot.joints[n].joint_deg(standing_deg[n]) for n in start_deg},
        tolerance_deg=TOLERANCE_DEG,
        drives=driving_of(robot, start_deg),
        line_use=lines_use(moves, robot),
    )
    ends_s = [reference.end_s for reference in profiles(program, robot).values()]
    return replace(program, duration_s=max([0.0, *ends_s]))


def approach_s(robot: Robot, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
    """Return about how long the approach between two poses (joint angles) takes."""
    lasts_s, ramp_s = APPROACH_LEAST_S, 0.0
    for name, target_deg in to_deg.items():
        joint = robot.joints[name]
        lasts_s = max(lasts_s, abs(target_deg - from_deg[name]) / robot.approach_deg_s(joint))
        ramp_s = max(ramp_s, robot.approach_deg_s(joint) / ramp_deg_s2(joint))
    return lasts_s + ramp_s


def _at_once(
    robot: Robot, targets_deg: Mapping[str, float], at_us: int, duration_ms: int
) -> list[Move]:
    """Return one command for every joint, one after another on each bus from `at_us` on."""
    moves, due_us = [], dict.fromkeys(robot.buses, at_us)
    for name, servo_deg in targets_deg.items():
        joint = robot.joints[name]
        move = Move(
            due_us=due_us[joint.bus],
            bus=joint.bus,
            servo_id=joint.servo_id,
            target_wire=standing_wire(servo_deg, servo_limits(joint, TOLERANCE_DEG)),
            duration_ms=duration_ms if joint.drive == "timed" else None,
        )
        moves.append(move)
        size_ns = line_time_ns(len(move.data), robot.buses[joint.bus].baud_bps)
        due_us[joint.bus] += -(-size_ns // NS_PER_US)
    return moves


def _course(
    joint: Joint, from_deg: float, to_deg: float, times_s: tuple[float, float, float]
) -> Reference:
    """Return a course that stands from the first of `times_s`, and moves from the second on.

    It takes as long as the third and the ramps, like a timed move with that T.
    """
    stands_s, starts_s, lasts_s = times_s
    state = Piece(starts_s, from_deg, 0.0, 0.0)
    travel_deg_s = max(abs(to_deg - from_deg) / lasts_s, joint.unit_deg)
    reference = PiecewiseProfile(trapezoid(state, to_deg, travel_deg_s, ramp_deg_s2(joint)))
    steps = math.ceil((reference.end_s + GLIDE_END_S - stands_s) / GRID_S) + 1
    grid_s = stands_s + GRID_S * np.arange(steps, dtype=np.float64)
    return Reference(start_s=stands_s, position_deg=reference.sample(grid_s))
