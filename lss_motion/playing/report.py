"""The report of a run: what was late, what was corrected, what failed.

`make_report` collects the numbers from a player. `write_report` writes them as the JSON object of
`lss-play --report`. The attributes of the classes here are the keys of that object, in the same
order; a change of a name or of a meaning needs another `SCHEMA_VERSION`.

`StageReport` is that of a run with many shows: totals, and the last shows one by one. Its size does
not grow with the run. Who needs every show takes each `events.ShowOver` when it comes.
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

import itertools
import json
import math
import re
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from msgspec import Struct, to_builtins

from lss_motion.files.output import write_output
from lss_motion.files.texts import counted
from lss_motion.planning.trajectory.model import GivenUp, SlowSpan
from lss_motion.planning.trajectory.servo_motion import servo_name
from lss_motion.playing.player.events import Faulted, ShowOver, ShowSummary, Warned
from lss_motion.playing.player.show_clock import Statistics
from lss_motion.playing.sound_choice import SoundReport
from lss_motion.show.splines import polyline
from lss_motion.units import LINE_BITS_PER_BYTE, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.player import Player

    Item = TypeVar("Item")
    FloatArray = NDArray[np.float64]

SCHEMA_VERSION: Final = 1
PLAN_TOLERANCE_DEG: Final = 0.1
"""The plan in a report is a line so close to it: the unit of most servos."""

PLAN_STEP_S: Final = 0.01
PLAN_STEP_NS: Final = 10_000_000
PLAN_SAMPLES_MAX: Final = 200_000
"""Samples of the plan before it is a line; half an hour at full resolution."""

HAPPENED_MAX: Final = 10_000
"""Keyframes and events of a report, each: as many as a file may have."""

JUMP_S: Final = 0.001
"""A show that comes so much further in no time was sent there."""

_NUMBERS: Final = re.compile(r"\[([-\d.,e\s]+)\]")


class TimingReport(Struct, frozen=True, kw_only=True):
    """When commands left the host, compared with the instants at which they were due."""

    commands: int
    missed: int
    """Commands that were never sent because they were too late."""
    late_p50_us: int
    late_p99_us: int
    late_max_us: int
    late_histogram_us: tuple[tuple[int, int], ...]
    """`(up to, count)`: commands that were late by at most `up to` and more than the one before."""


class BusReport(Struct, frozen=True, kw_only=True):
    """Bytes and replies of one bus."""

    baud_bps: int
    tx_utilisation_ratio: float
    queries: int
    replies: int
    timeouts: int
    garbage: int
    """Bytes or packets that no reply format matches."""
    rejected: int
    """Replies to no open query, and values that the servo cannot have reached."""
    query_rate_hz: float
    unasked: int
    """Replies and unreadable packets beyond the queries, where so many came that another host asks
    on this bus, or something sends by itself."""


class TraceReport(Struct, frozen=True, kw_only=True):
    """Readings of a joint, evenly spread over the run: seconds since its start, joint degrees."""

    at_s: tuple[float, ...]
    planned_deg: tuple[float, ...]
    measured_deg: tuple[float, ...]


class PlanReport(Struct, frozen=True, kw_only=True):
    """The plan of a joint: straight between these, within `PLAN_TOLERANCE_DEG`; as `TraceReport`.

    Pauses and other speeds are in it: it is where the joint should have been in this run.
    """

    at_s: tuple[float, ...] = ()
    deg: tuple[float, ...] = ()


class HappenedReport(Struct, frozen=True, kw_only=True):
    """A keyframe or an event that the run came to, in seconds since its start."""

    kind: str
    """`keyframe`, `anchor` or `event`."""
    at_s: float
    hold_s: float
    text: str


class JointReport(Struct, frozen=True, kw_only=True):
    """How one joint followed the plan, as measured by its servo."""

    readings: int
    error_rms_deg: float
    error_max_deg: float
    offset_max_deg: float
    """The largest correction that was added to a target."""
    predicted_error_max_deg: float | None
    """By the response that the robot file states."""
    predicted_bound_deg: float | None
    """With what that leaves open: `Program.bound_deg`."""
    lag_extra_s: float
    """The measured lag of the servo beyond that of the robot file."""
    resent: int
    """Moves that the servo did not execute and that were sent a second time."""
    temperature_max_c: float | None
    voltage_min_v: float | None
    current_max_a: float | None
    trace: TraceReport
    plan: PlanReport = PlanReport()
    horn_error_rms_deg: float | None = None
    """Distance of the simulated horn from the plan. None, and not in the JSON, where unknown."""
    horn_error_max_deg: float | None = None


class FightReport(Struct, frozen=True, kw_only=True):
    """By how much servos of one joint were apart, in degrees of ideal servos."""

    measured_max_deg: float
    """By readings of different instants, between which the errors of servos change evenly."""
    bound_deg: float
    """The largest to expect on the way: `Program.fight_deg`."""


class Report(Struct, frozen=True, kw_only=True):
    """The numbers of one run. `to_dict` gives them as the JSON object of `--report`."""

    schema: int = SCHEMA_VERSION
    sequence: str
    robot: str
    simulated: bool
    outcome: str
    """`finished`, `stopped`, `fault` or `lost`."""
    planned_s: float | None
    """Duration of the plan; None if it repeats until it is stopped."""
    played_s: float
    """Show time that was reached, at most that of the plan."""
    run_s: float
    """Duration of the run in real or virtual time, setup and approach included."""
    tolerance_deg: float
    timing: TimingReport
    buses: Mapping[str, BusReport]
    joints: Mapping[str, JointReport]
    """Empty when the run ended before the show started."""
    timeline: tuple[HappenedReport, ...]
    """Keyframes, holds, anchors and events, in order of time."""
    stretched: tuple[SlowSpan, ...]
    given_up: tuple[GivenUp, ...]
    faults: tuple[Faulted, ...]
    warnings: tuple[str, ...]
    sound: SoundReport | None = None
    """None: the show has no sounds, or was played in virtual time."""
    servos: Mapping[str, JointReport] = {}
    """Of a robot with mechanisms, whose joints they move, in degrees of ideal servos; else not in
    the JSON, as `fights`."""
    fights: Mapping[str, FightReport] = {}
    """By mechanism with more servos than joints."""

    def __repr__(self) -> str:
        """Return one line: names, outcome and counts."""
        counts = ", ".join(
            (
                counted(self.joints, "joint"),
                f"{counted(self.timing.commands, 'command')}",
                f"{self.timing.missed} missed",
                counted(self.faults, "fault"),
            )
        )
        return f"Report({self.sequence!r}: {self.outcome} after {self.played_s:.2f} s, {counts})"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as the object that `json.dumps` writes."""
        found: dict[str, Any] = to_builtins(self)
        for key in ("servos", "fights"):
            if not found[key]:
                del found[key]
        for joint in (*found["joints"].values(), *found.get("servos", {}).values()):
            for key in ("horn_error_rms_deg", "horn_error_max_deg"):
                if joint[key] is None:
                    del joint[key]
        for fault in found["faults"]:
            del fault["type"]
        return found


def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of a report, as `--report` writes it."""
    import msgspec

    made: dict[str, Any] = msgspec.json.schema(Report)
    return made


def make_report(
    player: Player,
    *,
    run_s: float,
    is_simulated: bool,
    outcome: str,
    warnings: Sequence[str] = (),
    sound: SoundReport | None = None,
    horn_error_deg: Mapping[str, tuple[float, float]] | None = None,
) -> Report:
    """Return the report of a run that took `run_s` in all, from the first query on.

    `horn_error_deg` holds, by joint, the RMS and the largest distance of the simulated horn from
    the plan; of a servo behind a mechanism as `servo_name`.
    """
    program, show = player.program, player.show
    statistics = show.statistics if show is not None else Statistics()
    played = _Played.of(player)
    errors_deg = horn_error_deg or {}
    joints = {
        name: _joint(track, program, errors_deg.get(servo_name(name), errors_deg.get(name)), played)
        for name, track in (show.joint_states if show is not None else {}).items()
    }
    return Report(
        sequence=program.name,
        robot=program.robot,
        simulated=is_simulated,
        outcome=outcome,
        planned_s=None if math.isinf(program.duration_s) else round(program.duration_s, 6),
        played_s=round(_played_s(player), 6),
        run_s=round(run_s, 3),
        tolerance_deg=program.tolerance_deg,
        timing=TimingReport(
            **statistics.timing(), late_histogram_us=tuple(statistics.histogram_us())
        ),
        buses={name: bus_report(player, name, run_s) for name in player.lines},
        joints=joints,
        timeline=() if played is None else tuple(played.timeline(program)),
        stretched=tuple(program.stretched),
        given_up=tuple(program.given_up),
        faults=tuple(player.faults),
        warnings=(
            *warnings,
            *_findings(show.joint_states if show is not None else {}, warnings),
        ),
        sound=sound,
    )


def _findings(joint_states: Mapping[str, JointState], warnings: Sequence[str]) -> Iterator[str]:
    """Yield what the robot file says wrongly about its servos, if no warning has said so yet."""
    for name, state in joint_states.items():
        is_named = any(text.startswith(f"joint {name!r}: ") for text in warnings)
        if not is_named and (text := state.finding):
            yield text


def _played_s(player: Player) -> float:
    """Return the show time that was reached, at most the duration of the plan."""
    if player.show is None or player.show_ended_ns is None:
        return 0.0
    reached_s = max(0.0, player.show.show_s(player.show_ended_ns))
    return min(reached_s, player.program.duration_s)


def bus_report(player: Player, name: str, run_s: float) -> BusReport:
    """Return the use of one bus during a run."""
    line, tracker = player.lines[name], player.trackers[name]
    reader = player.show.scheduler if player.show is not None else None
    busy_s = line.sent_bytes * LINE_BITS_PER_BYTE / line.bus.baud_bps
    return BusReport(
        baud_bps=line.bus.baud_bps,
        tx_utilisation_ratio=round(busy_s / run_s, 4) if run_s > 0.0 else 0.0,
        queries=tracker.query_count,
        replies=tracker.reply_count,
        timeouts=tracker.timeouts,
        garbage=line.garbage,
        rejected=tracker.strays + (reader.rejected[name] if reader is not None else 0),
        query_rate_hz=round(tracker.query_count / run_s, 1) if run_s > 0.0 else 0.0,
        unasked=player.unasked.total(name),
    )


def _joint(
    track: JointState,
    program: Program,
    horn_error_deg: tuple[float, float] | None,
    played: _Played | None,
) -> JointReport:
    following = track.disturbance
    predicted_deg = program.error_max_deg.get(track.joint.name)
    bound_deg = program.bound_deg.get(track.joint.name)
    rms_deg, max_deg = horn_error_deg or (None, None)
    return JointReport(
        readings=following.readings,
        error_rms_deg=round(following.error_rms_deg, 3),
        error_max_deg=round(following.error_max_deg, 3),
        offset_max_deg=round(following.offset_max_deg, 3),
        predicted_error_max_deg=None if predicted_deg is None else round(predicted_deg, 3),
        predicted_bound_deg=None if bound_deg is None else round(bound_deg, 3),
        lag_extra_s=round(track.disturbance.horn.lag_s, 4),
        resent=track.resent,
        temperature_max_c=track.temperature_max_c,
        voltage_min_v=track.voltage_min_v,
        current_max_a=track.current_max_a,
        trace=_trace(track),
        plan=PlanReport() if played is None else played.plan(track, program),
        horn_error_rms_deg=None if rms_deg is None else round(rms_deg, 3),
        horn_error_max_deg=None if max_deg is None else round(max_deg, 3),
    )


def planned_horn_deg(track: JointState, program: Program, show_s: FloatArray) -> FloatArray:
    """Return where the horn of a joint should be at show times, in joint degrees."""
    return _joint_deg(track, _plan_s(track, program, show_s))


def _plan_s(track: JointState, program: Program, show_s: FloatArray) -> FloatArray:
    """Return the times in `track.plan` of show times: earlier by the lead, and within a pass."""
    plan_s = show_s - track.lead_s
    if program.repeat is not None:
        plan_s = np.array([program.within(at_s) for at_s in plan_s.tolist()])
    return plan_s


def _joint_deg(track: JointState, plan_s: FloatArray) -> FloatArray:
    deg: FloatArray = track.joint.direction * (track.plan.sample(plan_s) - track.joint.zero_deg)
    return deg


class _Played:
    """The show time over the time of a run: `run_s` counts from the start of the show."""

    def __init__(self, run_s: FloatArray, show_s: FloatArray) -> None:
        self._run_s, self._show_s = run_s, show_s

    @classmethod
    def of(cls, player: Player) -> _Played | None:
        """Return it for a run that came to its show, else None."""
        if player.show is None or player.show_ended_ns is None:
            return None
        knots = list(player.show.clock.course(player.show_ended_ns, PLAN_STEP_NS))
        origin_s = next((state.origin_s for state in player.show.joint_states.values()), 0.0)
        run_s = np.array([s_from_ns(instant_ns) for instant_ns, _ in knots]) - origin_s
        show_s = np.array([show_s for _, show_s in knots])
        return cls(run_s, show_s) if len(run_s) and run_s[-1] > run_s[0] else None

    def plan(self, track: JointState, program: Program) -> PlanReport:
        """Return where the horn of a joint should have been; later than its moves by the lead."""
        first_s, last_s = float(self._run_s[0]), float(self._run_s[-1])
        count = min(PLAN_SAMPLES_MAX, math.ceil((last_s - first_s) / PLAN_STEP_S) + 2)
        run_s = np.linspace(first_s, last_s, count)
        show_s = _plan_s(track, program, np.interp(run_s, self._run_s, self._show_s))
        is_known = show_s >= track.plan.table[0][0]  # A walk forgets what is over.
        run_s, show_s = run_s[is_known | (show_s < 0.0)], show_s[is_known | (show_s < 0.0)]
        if len(run_s) < 2:
            return PlanReport()
        deg = _joint_deg(track, show_s)
        kept = polyline(run_s, deg, PLAN_TOLERANCE_DEG)
        return PlanReport(
            at_s=tuple(np.round(run_s[kept], 3).tolist()),
            deg=tuple(np.round(deg[kept], 3).tolist()),
        )

    def timeline(self, program: Program) -> Iterator[HappenedReport]:
        """Yield the keyframes and events in the order of the run, each as often as it was passed.

        A show that is sent back, or goes back for idle motion, passes some again.
        """
        last_s = float(self._show_s.max())

        def until_end(items: Iterator[tuple[float, Item]]) -> Iterator[tuple[float, Item]]:
            return itertools.takewhile(
                lambda pair: pair[0] <= last_s, itertools.islice(items, HAPPENED_MAX)
            )

        found = [
            (at_s, "anchor" if mark.is_anchor else "keyframe", mark.held_s, mark.label)
            for at_s, mark in until_end(program.unrolled_marks())
        ]
        found += [
            (at_s + cue.lead_s, "event", 0.0, cue.text)
            for at_s, cue in until_end(program.unrolled_cues())
        ]
        found.sort(key=lambda one: one[0])
        made = (
            HappenedReport(
                kind=kind,
                at_s=round(float(np.interp(at_s, show_s, run_s)), 3),
                hold_s=round(hold_s, 3),
                text=text,
            )
            for show_s, run_s in self._ways()
            for at_s, kind, hold_s, text in found
            if show_s[0] <= at_s <= show_s[-1]
        )
        yield from itertools.islice(made, HAPPENED_MAX)

    def _ways(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield the parts of the run in which the show goes forward, without jumps."""
        forward_s, took_s = np.diff(self._show_s), np.diff(self._run_s)
        cuts = 1 + np.flatnonzero((forward_s < 0.0) | ((took_s <= 0.0) & (forward_s > JUMP_S)))
        for first, end in itertools.pairwise([0, *cuts.tolist(), len(self._show_s)]):
            yield self._show_s[first:end], self._run_s[first:end]


def _trace(track: JointState) -> TraceReport:
    points = track.trace.points
    columns = zip(*points, strict=True) if points else ([], [], [])
    at_s, planned_deg, measured_deg = (tuple(round(x, 3) for x in column) for column in columns)
    return TraceReport(at_s=at_s, planned_deg=planned_deg, measured_deg=measured_deg)


def write_report(report: Report, path: Path) -> None:
    """Write a report as JSON, each list of numbers on one line. Raises `InputError`."""
    text = json.dumps(report.to_dict(), indent=1)
    text = _NUMBERS.sub(lambda found: "[" + " ".join(found[1].split()) + "]", text)
    write_output(path, text + "\n")


STAGE_SCHEMA_VERSION: Final = 1
SHOWS_KEPT: Final = 200
"""So many of the last shows are in the report one by one."""
WARNINGS_KEPT: Final = 200
NAMES_MAX: Final = 500
"""Shows with more names than this are counted together: a stage may be given new ones for ever."""
OTHER_NAMES: Final = "(others)"


@dataclass(slots=True)
class ShowTotals:
    """All times that one show was played."""

    plays: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    lasted_s: float = 0.0
    """Run time of all of them together."""
    commands: int = 0
    missed: int = 0
    late_max_us: int = 0
    error_max_deg: float = 0.0
    error_max_joint: str = ""

    def add(self, one: ShowSummary) -> None:
        """Count a show that is over."""
        self.plays += 1
        self.outcomes[one.outcome] += 1
        self.lasted_s += s_from_ns(one.ended_ns - one.began_ns)
        self.commands += one.commands
        self.missed += one.missed
        self.late_max_us = max(self.late_max_us, one.late_max_us)
        for name, joint in one.joints.items():
            if joint.error_max_deg > self.error_max_deg:
                self.error_max_deg, self.error_max_joint = joint.error_max_deg, name


class StageReport(Struct, frozen=True, kw_only=True):
    """The numbers of one run with many shows."""

    schema: int = STAGE_SCHEMA_VERSION
    robot: str
    simulated: bool
    outcome: str
    """`stopped`, `fault` or `lost`."""
    run_s: float
    buses: Mapping[str, BusReport]
    totals: Mapping[str, ShowTotals]
    """By the name of the show."""
    last_shows: tuple[ShowSummary, ...]
    faults: tuple[Faulted, ...]
    warnings: tuple[str, ...]
    """The last ones, each once."""
    sound: SoundReport | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the report as an object for `json.dumps`."""
        found: dict[str, Any] = to_builtins(self)
        for fault in found["faults"]:
            del fault["type"]
        return found


class Ledger:
    """Keeps what a report needs, while the events of a run come in."""

    def __init__(self) -> None:
        self.totals: dict[str, ShowTotals] = {}
        self.last_shows: deque[ShowSummary] = deque(maxlen=SHOWS_KEPT)
        self._warnings: dict[str, None] = {}

    def note(self, event: Event) -> None:
        """Keep what an event tells, if it tells anything."""
        if isinstance(event, Warned):
            self._warnings.pop(event.text, None)
            self._warnings[event.text] = None
            if len(self._warnings) > WARNINGS_KEPT:
                del self._warnings[next(iter(self._warnings))]
        elif isinstance(event, ShowOver):
            one = event.summary
            is_known = one.name in self.totals or len(self.totals) < NAMES_MAX
            name = one.name if is_known else OTHER_NAMES
            self.totals.setdefault(name, ShowTotals()).add(one)
            self.last_shows.append(one)

    def report(
        self,
        player: Player,
        *,
        run_s: float,
        is_simulated: bool,
        outcome: str,
        sound: SoundReport | None,
    ) -> StageReport:
        """Return the report of a run that has ended."""
        return StageReport(
            robot=player.robot.name,
            simulated=is_simulated,
            outcome=outcome,
            run_s=round(run_s, 3),
            buses={name: bus_report(player, name, run_s) for name in player.lines},
            totals=dict(self.totals),
            last_shows=tuple(self.last_shows),
            faults=tuple(player.faults),
            warnings=tuple(self._warnings),
            sound=sound,
        )
