"""What a servo makes of what it was sent: moves, settings, and the targets of its filter in EM0.

`LostMoveDetector`: a line without acknowledgement loses a command now and then, and the servo goes
on with the one before. So after every move to another target the servo is polled for its target
(QDT, FACTS.md C2: "the target angle during and after an action"). An answer with the target before
means that the move was lost. Besides, for each of the last moves the profile without it is kept
until a reported target or the readings decide: they tell the profiles apart once these diverge.

`ServoSettings`: a servo that restarts is back with its stored settings, which may allow more than
the joint does. It does not report that. So the settings that a restart would change back, its
probes, are read with the health queries. Between two of them a restart shows by other signs:
queries without an answer, an angle to which the horn cannot have turned, a servo that is limp. With
the first sign the servo is in doubt and a probe is queried at once. With a few signs in a row, or
an answer as after a restart, it is sent no move until a probe is answered. The answer is right: its
moves go on. It is wrong: the servo has restarted. One wrong answer is no proof, since a bus without
checksums can deliver one.

`Setpoints`: the filter steps at unknown instants. It is modelled for several of the possible ones,
and gives the targets that keep the limits for all. `closing_deg` is how fast a joint that is off
its plan closes in on it.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec.structs import replace

from lss_motion.planning.program.reference_grid import DURATION_MAX_MS
from lss_motion.planning.program.streamed import SETTLED_DEG
from lss_motion.protocol.constants import Status
from lss_motion.units import NS_PER_S, ns_from_s, s_from_ms

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.planning.program.reference_grid import ServoLimits
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.robot.profile import Profile

STEP_OFFSETS: Final = 32
"""Step instants that are modelled, evenly spread over one period: 0.6 ms apart. Targets on full
lines have such jitter; between instants 1.25 ms apart a joint went 6 % too fast (measured)."""
ROOM_RATIO: Final = 1.0
"""A fitted course oscillates within its tolerance. So a step may differ from the last one by this
many tolerances more than the acceleration limit allows. Of 52 streamed joints of random shows, the
worst needs 0.94."""
CLOSING_RATIO: Final = 0.5
"""Share of the acceleration that closing in on the plan may use; the plan needs the rest."""
CLOSING_GAIN: Final = 0.5
"""One step closes no more than this share of the distance to the plan."""


@dataclass(slots=True)
class _StepOffset:
    """The filter of a servo if it steps at one of the possible instants."""

    step: int
    """The number of the next step."""
    value_deg: float
    last_deg: float = 0.0
    """Length of the last step."""
    lagged_deg: float = 0.0
    """Difference between successive steps, low-pass filtered as the horn lags."""

    def step_until(self, until: int, target_deg: float, count: int, lag_ratio: float) -> None:
        """Make all steps before `until`. `lag_ratio` of a change reaches the horn at once."""
        while self.step < until:
            if self.value_deg == target_deg and self.last_deg == 0.0:
                self.step, self.lagged_deg = until, 0.0
                return
            self.step += 1
            value_deg = self.value_deg + (target_deg - self.value_deg) / count
            if abs(value_deg - target_deg) < SETTLED_DEG:
                value_deg = target_deg
            step_deg = value_deg - self.value_deg
            self.lagged_deg += lag_ratio * (step_deg - self.last_deg - self.lagged_deg)
            self.value_deg, self.last_deg = value_deg, step_deg


class Setpoints:
    """Model of the filter of one servo in EM0. Instants must not decrease.

    The filter steps every `Response.filter_s`, at unknown instants. A target that arrives a little
    late is one step late for some of the possible instants and on time for the others. So the
    filter is modelled for several of them, and a target is allowed if it keeps the limits for all.
    """

    def __init__(self, position_deg: float, *, count: int, limits: ServoLimits) -> None:
        self._limits = limits
        self._count = count
        self._period_s = limits.response.filter_s
        self._target_deg = position_deg
        response = limits.response
        self._lag_ratio = -math.expm1(-self._period_s / response.lag_s) if response.lag_s else 1.0
        self._offsets = [_StepOffset(0, position_deg) for _ in range(STEP_OFFSETS)]

    def allowed(self, arrival_s: float) -> tuple[float, float]:
        """Return the least and largest target that keep the limits if it arrives at `arrival_s`.

        Where no target keeps them for all possible instants, both are the middle of the gap.
        """
        self._advance(arrival_s)
        room_deg = ROOM_RATIO * self._limits.tolerance_deg
        spans = [self._span(offset, room_deg) for offset in self._offsets]
        low_deg, high_deg = max(low for low, _ in spans), min(high for _, high in spans)
        if low_deg > high_deg:
            low_deg = high_deg = 0.5 * (low_deg + high_deg)
        return low_deg, high_deg

    def commanded(self, arrival_s: float, target_deg: float) -> None:
        """Note that the servo receives `D target` at `received_s`."""
        self._advance(arrival_s)
        self._target_deg = target_deg

    def _advance(self, arrival_s: float) -> None:
        for index, offset in enumerate(self._offsets):
            until = math.ceil(arrival_s / self._period_s - index / STEP_OFFSETS)
            offset.step_until(until, self._target_deg, self._count, self._lag_ratio)

    def _span(self, offset: _StepOffset, room_deg: float) -> tuple[float, float]:
        """Return the targets between which the next step keeps speed, acceleration, and range."""
        limits, value_deg, last_deg = self._limits, offset.value_deg, offset.last_deg
        more_deg = step_gain_deg(limits) + room_deg
        most_deg = limits.speed_max_deg_s * self._period_s
        down_deg = self._brakable_deg(value_deg - limits.position_min_deg, most_deg, more_deg)
        up_deg = self._brakable_deg(limits.position_max_deg - value_deg, most_deg, more_deg)
        lagged_deg = (1.0 - self._lag_ratio) * offset.lagged_deg
        slowest_deg = last_deg + (-more_deg - lagged_deg) / self._lag_ratio
        fastest_deg = last_deg + (more_deg - lagged_deg) / self._lag_ratio
        low_deg = min(max(slowest_deg, -down_deg), fastest_deg)
        high_deg = max(min(fastest_deg, up_deg), slowest_deg)
        return value_deg + self._count * low_deg, value_deg + self._count * high_deg

    def _brakable_deg(self, room_deg: float, most_deg: float, less_deg: float) -> float:
        """Return the longest step, up to `most_deg`, after which the filter can brake in range.

        Every step may be shorter than the last one by `less_deg`. Its target is `count` times as
        far away as the step is long, and must not lie beyond the end of the range.
        """
        count, least_deg, steps = self._count, most_deg, 0
        if room_deg >= most_deg * (count + most_deg / less_deg):
            return most_deg
        while steps * less_deg < least_deg:
            braked_deg = less_deg * steps * (count + 0.5 * (steps - 1))
            least_deg = min(least_deg, (max(room_deg, 0.0) + braked_deg) / (count + steps))
            steps += 1
        return least_deg


def make_setpoints(joint: Joint, position_deg: float, limits: ServoLimits) -> Setpoints | None:
    """Return the filter model of a servo that stands at `position_deg`; None for other drives."""
    if joint.drive != "streamed":
        return None
    return Setpoints(position_deg, count=joint.filter_count, limits=limits)


def closing_deg(off_deg: float, limits: ServoLimits) -> float:
    """Return by how much the next step is longer than that of the plan, to close in on the plan.

    It is never so long that the joint could not brake before it reaches the plan.
    """
    less_deg = CLOSING_RATIO * step_gain_deg(limits)
    most_deg = less_deg * (math.sqrt(0.25 + 2.0 * abs(off_deg) / less_deg) - 0.5)
    return math.copysign(min(most_deg, CLOSING_GAIN * abs(off_deg)), off_deg)


def step_gain_deg(limits: ServoLimits) -> float:
    """Return the difference between successive steps that the acceleration limit allows."""
    return limits.ramp_deg_s2 * limits.response.filter_s * limits.response.filter_s


def with_room(robot: Robot, standing_deg: Mapping[str, float]) -> Robot:
    """Return `robot` with ranges that include where its servos stand (servo angles).

    A joint without T moves step by step. If it stands outside of its range, it must move back into
    it at the same slow speed as everything else, not jump. A timed joint goes back into its range
    with its first move, unless the way is too long for one T.
    """
    joints = dict(robot.joints)
    for name, servo_deg in standing_deg.items():
        joint = joints[name]
        here_deg = joint.joint_deg(servo_deg)
        out_deg = max(joint.position_min_deg - here_deg, here_deg - joint.position_max_deg)
        if joint.drive != "timed" or out_deg > s_from_ms(DURATION_MAX_MS) * robot.approach_deg_s(
            joint
        ):
            joints[name] = replace(
                joint,
                position_min_deg=min(joint.position_min_deg, here_deg),
                position_max_deg=max(joint.position_max_deg, here_deg),
            )
    return replace(robot, joints=joints)


PARTED_DEG: Final = 1.0
"""The horn must be nearer to one profile than to the other by this: ten times the noise of a
reading, and the effect of a lag that is wrong by 10 ms at 100 deg/s. Chosen."""
NEAR_DEG: Final = 0.6
NEAR_RATIO: Final = 0.3
"""The horn may be no further from the other profile than `NEAR_DEG`, or than this share of its
distance from its own: a lag that is not known yet, or a weak motor, leads it away from both."""
SURE_S: Final = 0.01
"""The readings must agree for this long: a horn that only crosses another profile is soon
elsewhere."""
OTHERS_MAX: Final = 3
"""Number of moves that are in doubt at once; the oldest counts as received."""
QUERIES_MAX: Final = 3
"""Queries for the target of one move; after that the readings decide. Chosen: two unanswered
queries take long enough for them."""
MISMATCHES_MAX: Final = 6
"""A servo that reports another target this often in a row means something else by it, such as
limits of its own, and is not polled for it any more. A line that loses every fifth command
causes this once in 15000 moves."""
REPORTED_LOOPS: Final = 1.5
"""Number of control ticks after a move has arrived until a servo reports its target. Assumed, with
half a tick to spare: no document says when it does (FACTS.md C2)."""
DEAD_MAX_S: Final = 0.12
RECHECKED_LOOPS: Final = 3.0
"""A servo that reports the target before a move may take it up late. So it is asked again before
the move counts as lost: after `DEAD_MAX_S`, longer than a lag that can be corrected, or after so
many ticks if it has reported `PROMPT_LEAST` targets at once. It may be a tick later than usual."""
PROMPT_LEAST: Final = 3
SAME_UNITS: Final = 1.5
"""Targets that differ by no more wire units than this are the same, since a servo that counts in
its own units may be one off."""


@dataclass(slots=True)
class LastMove:
    """The last move that was sent to a servo, and its profile before that."""

    before: Profile
    arrival_s: float
    target_deg: float
    duration_s: float | None
    queries_left: int
    recheck_s: float = 0.0
    """Time after its arrival at which the servo, which reported the target before it, is asked
    again; 0: it has not."""
    unknown_deg: float | None = None
    """A target that was never sent, but that the servo reported once."""


@dataclass(slots=True)
class Alternative:
    """The profile of a servo that has lost one of the last moves.

    Most are dropped before a reading is compared with them, so moves are applied only then.
    """

    before: Profile
    """Its profile before `later`; not changed here."""
    since_s: float | None = None
    """Instant since which all readings have matched this profile."""
    later: list[tuple[float, float, float | None]] = field(default_factory=list)
    """Moves that it has received since: arrival, target, duration."""

    @property
    def target_deg(self) -> float:
        return self.later[-1][1] if self.later else self.before.target_deg

    @property
    def profile(self) -> Profile:
        """The profile after all moves that it has received."""
        if self.later:
            self.before = self.before.copy()
            for arrival_s, target_deg, duration_s in self.later:
                self.before.retarget(arrival_s, target_deg, duration_s)
            self.later.clear()
        return self.before


@dataclass(slots=True)
class LostMoveDetector:
    """Detects which moves one servo has lost."""

    unit_deg: float
    """One wire unit."""
    loop_s: float
    """Period of the servo's control tick, at which it starts a move (`Response.loop_s`)."""
    alternatives: list[Alternative] = field(default_factory=list)
    last: LastMove | None = None
    report_s: float = 0.0
    """Time after a move until this servo reports its target, if it is longer than assumed."""
    prompt: int = 0
    """Targets that it reported at the first query."""
    mismatches: int = 0
    """How often in a row the servo reported another target than the one that was sent."""
    is_doubtful: bool = False
    """Whether the last reading matched another profile: then nothing else is learnt from it."""
    target_due_ns: float = math.inf
    """Instant from which the servo must be polled for its target; infinite: it need not be."""

    def commanded(
        self, before: Profile, arrival_s: float, target_deg: float, duration_s: float | None
    ) -> None:
        """Note a new move; `before` is a copy of the profile before it."""
        for other in self.alternatives:
            other.later.append((arrival_s, target_deg, duration_s))
            other.since_s = None
        self.alternatives = [*self.alternatives[-(OTHERS_MAX - 1) :], Alternative(before)]
        is_conclusive = (
            self._differs(before.target_deg, target_deg) and self.mismatches < MISMATCHES_MAX
        )
        queries = QUERIES_MAX if is_conclusive else 0
        self.last = LastMove(before, arrival_s, target_deg, duration_s, queries)
        self._note_due()

    def take_over(self, earlier: LostMoveDetector) -> None:
        """Take over whether the servo reports its targets as they were sent."""
        self.mismatches, self.report_s = earlier.mismatches, earlier.report_s
        self.prompt = earlier.prompt
        self._note_due()

    def _note_due(self) -> None:
        last, self.target_due_ns = self.last, math.inf
        if last is not None and last.queries_left > 0:
            self.target_due_ns = ns_from_s(self._reported_s(last))

    def count_target_query(self) -> None:
        """Note that the servo is polled for its target now."""
        assert self.last is not None
        self.last.queries_left -= 1
        self._note_due()

    def target_reported(self, at_s: float, target_deg: float) -> Profile | None:
        """Use the target that a servo reported at `at_s`; return as `judge` does.

        A target that was never sent must be reported twice, since the answer may be damaged.
        """
        course = self._judge_target(at_s, target_deg)
        self._note_due()
        return course

    def _judge_target(self, at_s: float, target_deg: float) -> Profile | None:
        last = self.last
        if last is None or at_s < self._reported_s(last):
            return None
        if not self._differs(target_deg, last.target_deg):
            self.report_s = max(self.report_s, last.recheck_s)
            self.prompt += not last.recheck_s
            self.mismatches, last.queries_left = 0, 0
            self.alternatives = [o for o in self.alternatives if not self._parts(o)]
            return None
        is_before = not self._differs(target_deg, last.before.target_deg)
        if is_before and not last.recheck_s:  # It may only be slow to take a move up.
            is_prompt = self.prompt >= PROMPT_LEAST
            last.recheck_s = RECHECKED_LOOPS * self.loop_s if is_prompt else DEAD_MAX_S
            last.queries_left = max(last.queries_left, 1)
            return None
        self.mismatches += 1
        course = last.before
        if self._differs(target_deg, course.target_deg):
            if last.unknown_deg is None or self._differs(target_deg, last.unknown_deg):
                last.unknown_deg = target_deg
                return None
            course = course.copy()
            course.retarget(last.arrival_s, target_deg, last.duration_s)
        self.alternatives, self.last = [], None
        return course

    def _reported_s(self, last: LastMove) -> float:
        after_s = REPORTED_LOOPS * self.loop_s
        return last.arrival_s + max(after_s, self.report_s, last.recheck_s)

    def _parts(self, other: Alternative) -> bool:
        """Return whether `other` has another target than the last one that was sent."""
        return self.last is None or self._differs(other.target_deg, self.last.target_deg)

    def _differs(self, one_deg: float, other_deg: float) -> bool:
        return abs(one_deg - other_deg) > SAME_UNITS * self.unit_deg

    def judge(
        self, at_s: float, expected_deg: float, free_deg: float, speed_deg_s: float
    ) -> Profile | None:
        """Return the profile that the servo really follows; None: its own, as far as is known.

        `expected_deg` and `speed_deg_s` are those of its profile at `at_s` (on the time of the
        profile, lag taken off), `free_deg` is the measured angle without the disturbance. Which
        control tick takes a move up is not known: what that leaves open parts no profiles.
        """
        parted_deg = PARTED_DEG + self.loop_s * abs(speed_deg_s)
        off_deg = abs(free_deg - expected_deg)
        nears = [(abs(free_deg - other.profile.at(at_s)[0]), other) for other in self.alternatives]
        nears = [near for near in nears if near[0] - off_deg <= parted_deg]
        self.alternatives = [other for _, other in nears]
        near_deg, likely = min(nears, key=lambda near: near[0], default=(math.inf, None))
        if off_deg - near_deg < parted_deg or near_deg > max(NEAR_DEG, NEAR_RATIO * off_deg):
            likely = None
        for other in self.alternatives:
            if other is not likely:
                other.since_s = None
        self.is_doubtful = likely is not None
        if likely is None:
            return None
        if likely.since_s is None:
            likely.since_s = at_s
        if at_s - likely.since_s < SURE_S:
            return None
        self.alternatives = []
        return likely.profile.copy()  # `last` may share it.


HOLD_SIGNS: Final = 3
"""Signs in a row after which a servo is sent no move. Chosen: on a line that loses every tenth
answer, that is one query in a thousand; a servo that does not answer at all is held back after
50 ms, since each query is given up after 10 to 15 ms."""
PROOFS: Final = 2
"""Wrong answers in a row that prove a restart."""
READ_BACK_NS: Final = 3 * NS_PER_S // 10
"""A probe of a servo is queried at least this often when it is its turn, however slow its line is:
a restart that nothing else shows is found by it. Chosen: on an idle line the health queries do that
every 0.25 s; three servos at 9600 bps need a tenth of the line for it."""


class Probe(NamedTuple):
    """The query of one setting, with answers as wire values."""

    keyword: str
    value: int
    """The answer of a servo that has not restarted."""
    original: int | None
    """The answer before the show, and probably after a restart."""

    @property
    def is_lasting(self) -> bool:
        """Whether no restart changes the answer: only another servo has another one."""
        return self.value == self.original


@dataclass(slots=True)
class _Doubt:
    """Signs of a restart of one servo since its last right answer."""

    signs: int = 0
    last_ns: int = -1
    proofs: int = 0
    wrong: dict[str, int] = field(default_factory=dict)
    """The last wrong answer by keyword."""


class CommonSilence:
    """Whether several servos of one bus fell silent together: their common power may have failed.

    A servo that is silent while another one answers has its own reason, until it answers again.
    """

    def __init__(self) -> None:
        self._timeouts: Counter[int] = Counter()
        """By servo id, since the last answer on the bus."""
        self._mute: set[int] = set()

    def answered(self, servo_id: int | None) -> None:
        """Note an answer of a servo; None: the answer does not say of which."""
        if self._timeouts:
            self._mute.update(self._timeouts)
            self._timeouts.clear()
        if servo_id in self._mute:
            self._mute.remove(servo_id)

    def unanswered(self, servo_id: int) -> bool:
        """Note a query without an answer; return whether several servos fell silent together.

        Besides those of one servo that takes `HOLD_SIGNS` less one timeouts of others.
        """
        if servo_id in self._mute:
            return False
        self._timeouts[servo_id] += 1
        return self._timeouts.total() - max(self._timeouts.values()) >= HOLD_SIGNS - 1


class ServoSettings:
    """Whether one servo still has the settings that it was given, its `probes` (see the module).

    A servo without a probe has the same settings after a restart, so it is never in doubt. It is
    sent no move while it `is_doubtful`, or as its owner decides after signs.
    """

    def __init__(
        self, joint: Joint, probes: Sequence[Probe] = (), doubted: set[str] | None = None
    ) -> None:
        """`doubted` holds the names of all joints whose settings are in doubt."""
        self.joint = joint
        self.powered_ns: int | None = None
        """When the servo received what gives its motor power; None: it may be limp."""
        self.is_limp = False
        """Whether its last status was that of a limp servo although it has power."""
        self._doubted: set[str] = set() if doubted is None else doubted
        self.begin(probes)

    def begin(self, probes: Sequence[Probe]) -> None:
        """Watch from now on: the servo was set to these."""
        self._probes = {probe.keyword: probe for probe in reversed(probes)}
        self._frame = tuple(probe.keyword for probe in probes if probe.is_lasting)
        self._left: list[str] = []
        """Queries that are to be answered rightly: the servo was away, and may be another one."""
        self.keywords = tuple(probe.keyword for probe in probes if not probe.is_lasting)
        """The queries that show whether it has restarted."""
        self.doubt: _Doubt | None = None
        self.is_lost = False
        """Whether the servo was proved to have restarted."""
        self._read_ns: int | None = None
        """Instant of the last probe."""
        self._read_count = 0

    @property
    def has_settings(self) -> bool:
        """Whether its settings are not in doubt, and not known to be lost."""
        return self.doubt is None and not self.is_lost

    @property
    def is_doubtful(self) -> bool:
        """Whether the servo may have restarted, or has."""
        return self.is_limp or not self.has_settings

    @property
    def urgent(self) -> str | None:
        """The probe that must be queried at once; None: there is no doubt.

        After a timeout it is another one. A late answer to an earlier query is as good.
        """
        doubt, words = self.doubt, self._left or self.keywords or self._frame
        return None if doubt is None else words[doubt.signs % len(words)]

    def judges(self, keyword: str) -> bool:
        """Return whether `take` judges answers to this."""
        return keyword in self._probes

    def note_away(self, now_ns: int) -> bool:
        """Note that the servo answers again after a time in which it may have been exchanged.

        Return whether it must be sent no move before its frame is read again.
        """
        if not self._frame or self.is_lost:
            return False
        self._left = [*self.keywords[:1], *self._frame]
        return self.note_sign(now_ns, HOLD_SIGNS)

    def trust(self) -> None:
        """Note that the servo has the settings again that it had lost."""
        self.is_lost, self.is_limp, self.powered_ns = False, False, None
        self._left = []

    def read_back(self, now_ns: int) -> str | None:
        """Return the probe that must be queried since the last one was too long ago."""
        if not self.keywords or self.is_lost:
            return None
        if self._read_ns is not None and now_ns - self._read_ns < READ_BACK_NS:
            return None
        return self.keywords[self._read_count % len(self.keywords)]

    def note_query(self, keyword: str, now_ns: int) -> None:
        """Note a query that was sent to the servo."""
        if keyword in self.keywords:
            self._read_ns, self._read_count = now_ns, self._read_count + 1

    def note_sign(self, now_ns: int, count: int = 1) -> bool:
        """Note a sign of a restart that counts `count` times; several at one instant are one.

        Return whether there were so many that the servo must be sent no move.
        """
        if not (self.keywords or self._frame) or self.is_lost:
            return False
        doubt = self._doubted_now()
        if doubt.last_ns != now_ns:
            doubt.last_ns = now_ns
            doubt.signs += count
        return doubt.signs >= HOLD_SIGNS

    def take(self, keyword: str, value: int | str | None) -> str | None:
        """Judge the answer to a probe; return the text of the fault if the servo has restarted.

        A right answer ends the doubt: it may be sent moves again.
        """
        probe = self._probes[keyword]
        if self.is_lost:
            return None  # That is reported; its settings are sent by the recovery.
        if value == probe.value:
            if keyword in self._left:
                self._left.remove(keyword)
            if not self._left:
                self._end_doubt()
            return None
        doubt = self._doubted_now()
        known = (None if probe.is_lasting else probe.original, doubt.wrong.get(keyword))
        if not isinstance(value, int) or value not in known:
            doubt.proofs = 0
            if isinstance(value, int):
                doubt.wrong[keyword] = value
            return None
        doubt.proofs += 1
        if doubt.proofs < PROOFS:
            return None
        self._end_doubt()
        self.is_lost, self._left = True, []
        if probe.is_lasting:
            return (
                f"may be another servo: servo {self.joint.servo_id} answers {value} to {keyword}, "
                f"and {probe.value} before the show"
            )
        return (
            f"has lost its settings: servo {self.joint.servo_id} answers {value} to {keyword}, it "
            f"was set to {probe.value}. It has restarted. Look at its power supply"
        )

    def _doubted_now(self) -> _Doubt:
        if self.doubt is None:
            self.doubt = _Doubt()
            self._doubted.add(self.joint.name)
        return self.doubt

    def _end_doubt(self) -> None:
        self.doubt = None
        self._doubted.discard(self.joint.name)

    def is_limp_again(self, status: Status, asked_ns: int) -> bool:
        """Judge a status; return whether the servo is limp twice in a row although it has power."""
        was_limp = self.is_limp
        is_driven = self.powered_ns is not None and asked_ns > self.powered_ns
        self.is_limp = is_driven and status is Status.LIMP
        if self.is_limp:
            self.note_sign(asked_ns)
        return self.is_limp and was_limp


class Observation(NamedTuple):
    """What an accepted reading of the angle shows."""

    has_lost_move: bool
    """The servo has not received the move under way: `profile` is the one that it follows."""
    error_deg: float
    """How far the horn is from its plan."""
    model_error_deg: float
    """How far it is from where its moves should have taken it."""
