"""Faults of the joints, found in their answers and in missing answers; whether servos restarted.

One answer is no proof: a bus without checksums can deliver a wrong number that looks right. So a
fault begins with the second reading in a row that shows it.

A servo that restarts is back with its stored settings, which may allow more than the joint does. It
does not report that. So the settings that a restart would change back, its probes, are read with
the health queries (`SettingsWatch`). Between two of them a restart shows by other signs: queries
without an answer, an angle to which the horn cannot have turned, a servo that is limp. With the
first sign the servo is in doubt and a probe is queried at once. With a few signs in a row, or an
answer as after a restart, it is sent no move until a probe is answered. The answer is right: its
moves go on. It is wrong: the servo has restarted.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from lss_motion.protocol.constants import Status
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.on_fault import Cause
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from lss_motion.playing.player.joint_state import JointState, Observation
    from lss_motion.robot.model import Joint

    FaultKey = tuple[str, Cause]


ASTRAY_NS: Final = 50 * NS_PER_MS
"""A joint must be off by more than `following_deg` for this long, in all readings, of which there
are as many as the line allows. Chosen: one damaged reading is no fault, and the first step of
`on_fault` is taken within 0.1 s of the reading that showed it."""
BACK_RATIO: Final = 0.5
"""The fault ends when the joint is off by less than this share of `following_deg`."""
CONFIRMATIONS: Final = 2
SILENT_QUERIES: Final = 4
"""So many queries in a row must stay unanswered, and not all at once, as when a clog takes a whole
row of them: on a slow line, or a busy computer, `silent_s` alone is no evidence."""
STATUS_CAUSES: Final = {
    Status.STUCK: Cause.STUCK,
    Status.BLOCKED: Cause.BLOCKED,
    Status.SAFE_MODE: Cause.SAFE_MODE,
    Status.ERROR: Cause.ERROR,
    Status.LIMP: Cause.RESTARTED,
}
STATUS_TEXTS: Final = {
    Cause.STUCK: "is stuck: it cannot make the move at its present speed. Lighten its load, or "
    "lower speed_max_deg_s",
    Cause.BLOCKED: "is blocked: it cannot move at full power. Find what is in its way",
    Cause.SAFE_MODE: "is in safe mode: current, voltage or temperature out of bounds. Find the "
    "cause, then RESET it",
    Cause.ERROR: "reports an error. Find the cause, then RESET it",
    Cause.RESTARTED: "is limp although it is driven: it has restarted, or something let it go. "
    "Look at its power supply",
}


def status_fault(status: Status) -> str | None:
    """Return the fault of a servo that is not driven, as its status shows it; None: it has none."""
    cause = STATUS_CAUSES.get(status, Cause.RESTARTED)
    return None if cause is Cause.RESTARTED else STATUS_TEXTS[cause]


def hot_text(joint: Joint, temperature_c: float) -> str:
    """Return the fault of a servo that is too hot."""
    return (
        f"is hot: {temperature_c:.0f} C, allowed is {joint.temperature_max_c:g} C "
        f"(temperature_max_c). Let it rest, or give it less to carry"
    )


def low_voltage_text(joint: Joint, voltage_v: float) -> str:
    """Return the fault of a servo with too little voltage."""
    return (
        f"has {voltage_v:.1f} V, needed are {joint.voltage_min_v:g} V (voltage_min_v). Charge the "
        f"battery, or look at the wires"
    )


def is_turned(state: JointState, measured_deg: float, read_s: float) -> bool:
    """Return whether a servo angle is in another turn than the joint.

    The joint can be anywhere between its last reading and its profile: moves may be lost.
    """
    expected_deg = state.profile.at(read_s)[0]
    last_deg = state.disturbance.last_deg
    low_deg, high_deg = sorted((expected_deg if last_deg is None else last_deg, expected_deg))
    return not low_deg - HALF_TURN_DEG <= measured_deg <= high_deg + HALF_TURN_DEG


def turn_text(joint: Joint, reported_deg: float, before_deg: float) -> str:
    """Return the text of the fault of a joint in another turn; both are servo angles."""
    return (
        f"is in another turn: servo {joint.servo_id} reports {reported_deg:.1f} deg, and was at "
        f"{before_deg:.1f} deg. It has restarted, and is not driven. Look at its power supply, "
        f"bring the joint to its place by hand and begin anew"
    )


@dataclass(slots=True)
class _Unanswered:
    """A servo without an answer since `since_ns`, and when that was noticed first and last."""

    joint: Joint
    since_ns: int
    first_ns: int
    last_ns: int
    count: int = 0


class HealthMonitor:
    """Keeps `active_faults`: by joint and cause, a text that names a remedy."""

    def __init__(self) -> None:
        self.active_faults: dict[FaultKey, str] = {}
        self.unconfirmed: dict[str, str] = {}
        """Keyword by joint of a query that must be repeated at once to confirm its answer."""
        self._lost_settings: set[str] = set()
        """Joints whose servo has restarted, whatever its status is now."""
        self._turned: set[str] = set()
        """Joints whose last reading is in another turn."""
        self._counts: dict[FaultKey, int] = {}
        self._astray_since_ns: dict[str, int] = {}
        self.awaited: dict[str, _Unanswered] = {}
        """By joint, servos that did not answer their last query."""
        self._before: dict[tuple[str, str], float] = {}
        self.temperatures_c: dict[str, float] = {}
        """Of each joint, what the last two readings confirm."""
        self.currents_a: dict[str, float] = {}
        self.doubled: set[str] = set()
        """Joints whose answers come twice: two servos may have the id."""

    def position(self, joint: Joint, seen: Observation, arrival_ns: int) -> None:
        """Judge an accepted reading; the servo received the query at `arrival_ns`.

        A joint that is on its way back to its plan, as its moves require after a delay of this
        program, is not astray.
        """
        error_deg = min(abs(seen.error_deg), abs(seen.model_error_deg))
        trouble = (joint.name, Cause.ASTRAY)
        if error_deg <= joint.following_deg:
            self._astray_since_ns.pop(joint.name, None)
            self._confirmed(joint.name, "QD")
            if error_deg <= BACK_RATIO * joint.following_deg:
                self.active_faults.pop(trouble, None)
        elif arrival_ns - self._astray_since_ns.setdefault(joint.name, arrival_ns) > ASTRAY_NS:
            self._confirmed(joint.name, "QD")
            self.active_faults[trouble] = (
                f"is {error_deg:.1f} deg off its course, allowed is {joint.following_deg:g} deg "
                f"(following_deg). Look for what holds it, or lower its limits"
            )
        elif trouble not in self.active_faults:
            self.unconfirmed.setdefault(joint.name, "QD")

    def turn(self, state: JointState, measured_deg: float, read_s: float) -> bool:
        """Return whether a reading is in another turn than the joint: then no move is sent to it.

        The second such reading in a row is a fault.
        """
        name, from_deg = state.joint.name, state.disturbance.last_deg
        if from_deg is None or not is_turned(state, measured_deg, read_s):
            if name in self._turned:
                self._turned.remove(name)
                self._confirmed(name, "QD")
            return False
        state.hold_back()
        if name in self._turned:
            self._confirmed(name, "QD")
            text = turn_text(state.joint, measured_deg, from_deg)
            self.active_faults[name, Cause.LOST_TURN] = text
        else:
            self._turned.add(name)
            self.unconfirmed[name] = "QD"
        return True

    def may_be_turned(self, name: str) -> bool:
        """Return whether one reading is in another turn, and the next one is awaited."""
        return name in self._turned and (name, Cause.LOST_TURN) not in self.active_faults

    def lost_settings(self, state: JointState, text: str) -> None:
        """Note that a servo has restarted."""
        self._lost_settings.add(state.joint.name)
        self.active_faults[state.joint.name, Cause.RESTARTED] = text

    def status(self, state: JointState, code: int) -> None:
        state.note_health("Q", code)
        present = None if state.status is None else STATUS_CAUSES.get(state.status)
        for cause, text in STATUS_TEXTS.items():
            self._judge(state, cause, "Q", text, is_bad=cause is present)

    def temperature(self, state: JointState, temperature_c: float) -> None:
        confirmed_c = self._twice(state, "QT", temperature_c, min)
        self.temperatures_c[state.joint.name] = confirmed_c
        state.note_health("QT", confirmed_c)
        text = hot_text(state.joint, temperature_c)
        is_bad = temperature_c > state.joint.temperature_max_c
        self._judge(state, Cause.HOT, "QT", text, is_bad=is_bad)

    def current(self, state: JointState, current_a: float) -> None:
        self.currents_a[state.joint.name] = current_a
        state.note_health("QC", current_a)

    def voltage(self, state: JointState, voltage_v: float) -> None:
        state.note_health("QV", self._twice(state, "QV", voltage_v, max))
        text = low_voltage_text(state.joint, voltage_v)
        is_bad = voltage_v < state.joint.voltage_min_v
        self._judge(state, Cause.LOW_VOLTAGE, "QV", text, is_bad=is_bad)

    def answered(self, state: JointState) -> None:
        """Note any answer of a servo."""
        name = state.joint.name
        if self.awaited:
            self.awaited.pop(name, None)
        if self.active_faults:
            self.active_faults.pop((name, Cause.SILENT), None)

    def unanswered(self, state: JointState, now_ns: int, since_ns: int) -> None:
        """Note that a query to a servo was given up; `advance` judges it.

        `since_ns` is when it last answered, also before the show: a servo that restarts between two
        phases must be noticed before it is back and receives a move without its limits.
        """
        joint = state.joint
        new = _Unanswered(joint, since_ns, first_ns=now_ns, last_ns=now_ns)
        known = self.awaited.setdefault(joint.name, new)
        known.count += 1
        known.last_ns = now_ns

    def advance(self, now_ns: int) -> None:
        """Find silent servos, without waiting for a query that is late on a full line."""
        if not self.awaited:
            return
        for joint, since_ns in self._fading():
            if now_ns >= since_ns + ns_from_s(joint.silent_s):
                silent_s = s_from_ns(now_ns - since_ns)
                self.active_faults[joint.name, Cause.SILENT] = (
                    f"is silent: servo {joint.servo_id} has not answered for {silent_s:.1f} s. "
                    f"Look at its cable and its power"
                )

    def wakeups_ns(self) -> list[int]:
        """Return when `advance` must be called at the latest."""
        if not self.awaited:
            return []
        return [
            since_ns + ns_from_s(joint.silent_s)
            for joint, since_ns in self._fading()
            if (joint.name, Cause.SILENT) not in self.active_faults
        ]

    def _fading(self) -> Iterator[tuple[Joint, int]]:
        """Yield servos that will count as silent, and when they last answered."""
        for one in self.awaited.values():
            if one.count >= SILENT_QUERIES and one.last_ns > one.first_ns:
                yield one.joint, one.since_ns

    def _judge(
        self, state: JointState, cause: Cause, keyword: str, text: str, *, is_bad: bool
    ) -> None:
        name = state.joint.name
        if not is_bad:
            if self._counts.pop((name, cause), 0):
                self._confirmed(name, keyword)
            if cause is not Cause.RESTARTED or name not in self._lost_settings:
                self.active_faults.pop((name, cause), None)
            return
        count = self._counts[name, cause] = self._counts.get((name, cause), 0) + 1
        if count < CONFIRMATIONS:
            self.unconfirmed[name] = keyword
            return
        self._confirmed(name, keyword)
        self.active_faults[name, cause] = text

    def _confirmed(self, name: str, keyword: str) -> None:
        """Repeat a query no more, if it was this one."""
        if self.unconfirmed.get(name) == keyword:
            del self.unconfirmed[name]

    def _twice(
        self, state: JointState, keyword: str, value: float, choose: Callable[[float, float], float]
    ) -> float:
        """Return what this reading and the one before it both confirm."""
        place = (state.joint.name, keyword)
        before = self._before.get(place, value)
        self._before[place] = value
        return choose(before, value)


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


class Watched(Protocol):
    """What the watch needs of the state of a joint."""

    joint: Joint

    def hold_back(self) -> None:
        """Send no move to the servo: it may have lost its limits."""


class Probe(NamedTuple):
    """The query of one setting, with answers as wire values."""

    keyword: str
    value: int
    """The answer of a servo that has not restarted."""
    original: int | None
    """The answer before the show, and probably after a restart."""


@dataclass(slots=True)
class _Doubt:
    """Signs of a restart of one servo since its last right answer."""

    signs: int = 0
    last_ns: int = -1
    proofs: int = 0
    wrong: dict[str, int] = field(default_factory=dict)
    """The last wrong answer by keyword."""


class Silence:
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


class SettingsWatch:
    """Watches the servos of one streamer; `probes` by joint name.

    A joint without a probe has the same settings after a restart, so it is never in doubt.
    """

    def __init__(self, probes: Mapping[str, Sequence[Probe]]) -> None:
        self._probes = probes
        self._keywords = {
            name: tuple(probe.keyword for probe in own) for name, own in probes.items()
        }
        self._doubts: dict[str, _Doubt] = {}
        self.doubted = self._doubts.keys()
        """The joints whose settings are in doubt."""
        self._restarted: set[str] = set()
        """Joints whose servo was proved to have restarted."""
        self._read_backs: dict[str, tuple[int, int]] = {}
        """By joint, the instant of its last probe, and the number of probes so far."""

    def keywords(self, name: str) -> tuple[str, ...]:
        """Return the keywords of the probes of a joint."""
        return self._keywords.get(name, ())

    def urgent(self, name: str) -> str | None:
        """Return the probe that must be queried at once; None: there is no doubt.

        After a timeout it is another one. A late answer to an earlier query is as good.
        """
        if (doubt := self._doubts.get(name)) is None:
            return None
        words = self.keywords(name)
        return words[doubt.signs % len(words)]

    def allows_moves(self, name: str) -> bool:
        """Return whether the settings of a joint are not in doubt, and not known to be lost."""
        return name not in self._doubts and name not in self._restarted

    def trust(self, name: str) -> None:
        """Note that a servo that had restarted was given its settings again."""
        self._restarted.discard(name)

    def read_back(self, name: str, now_ns: int) -> str | None:
        """Return the probe that must be queried since the last one was too long ago."""
        words = self._keywords.get(name)
        if not words or name in self._restarted:
            return None
        if name not in self._read_backs:
            return words[0]
        last_ns, count = self._read_backs[name]
        return None if now_ns - last_ns < READ_BACK_NS else words[count % len(words)]

    def note_query(self, name: str, keyword: str, now_ns: int) -> None:
        """Note a query that was sent to the servo of a joint."""
        if keyword in self.keywords(name):
            _, count = self._read_backs.get(name, (0, 0))
            self._read_backs[name] = now_ns, count + 1

    def note_sign(self, state: Watched, now_ns: int, *, count: int = 1) -> None:
        """Note a sign of a restart that counts `count` times; several at one instant are one."""
        name = state.joint.name
        if not self._probes.get(name) or name in self._restarted:
            return
        doubt = self._doubts.setdefault(name, _Doubt())
        if doubt.last_ns != now_ns:
            doubt.last_ns = now_ns
            doubt.signs += count
        if doubt.signs >= HOLD_SIGNS:
            state.hold_back()

    def take(self, state: Watched, keyword: str, value: int | None) -> str | None:
        """Judge the answer to a probe; return the text of the fault if the servo has restarted.

        A right answer ends the doubt. `state` may then be sent moves again.
        """
        name = state.joint.name
        probe = next(probe for probe in self._probes[name] if probe.keyword == keyword)
        if name in self._restarted:
            return None  # That is reported; its settings are sent by the recovery.
        if value == probe.value:
            self._doubts.pop(name, None)
            return None
        doubt = self._doubts.setdefault(name, _Doubt())
        if value is None or value not in (probe.original, doubt.wrong.get(keyword)):
            doubt.proofs = 0
            if value is not None:
                doubt.wrong[keyword] = value
            return None
        doubt.proofs += 1
        state.hold_back()
        if doubt.proofs < PROOFS:
            return None
        del self._doubts[name]
        self._restarted.add(name)
        return (
            f"has lost its settings: servo {state.joint.servo_id} answers {value} to {keyword}, it "
            f"was set to {probe.value}. It has restarted. Look at its power supply"
        )


class ServoWatch:
    """Watches one servo outside of a show: whether it has restarted since it was set up.

    Its owner sends no move while it `is_doubtful`.
    """

    def __init__(self, joint: Joint) -> None:
        self.joint = joint
        self.powered_ns: int | None = None
        """When the servo received what gives its motor power; None: it may be limp."""
        self._watch = SettingsWatch({})
        self.is_limp = False
        """Whether its last status was that of a limp servo although it has power."""

    def begin(self, probes: Sequence[Probe]) -> None:
        """Watch from now on: the servo was set to these."""
        self._watch = SettingsWatch({self.joint.name: probes})

    def hold_back(self) -> None:
        """Send no move to the servo: `is_doubtful` says so."""

    @property
    def has_settings(self) -> bool:
        """Whether its settings are not in doubt, and not known to be lost."""
        return self._watch.allows_moves(self.joint.name)

    @property
    def is_doubtful(self) -> bool:
        """Whether the servo may have restarted, or has."""
        return self.is_limp or not self.has_settings

    @property
    def keywords(self) -> tuple[str, ...]:
        """The queries whose answers `take` judges."""
        return self._watch.keywords(self.joint.name)

    @property
    def urgent(self) -> str | None:
        """The query that must be sent at once; None: there is no doubt."""
        return self._watch.urgent(self.joint.name)

    def note_timeout(self, now_ns: int) -> None:
        """Note a query without an answer."""
        self._watch.note_sign(self, now_ns)

    def take(self, keyword: str, value: int | str | None) -> str | None:
        """Judge the answer to a probe; return the text of the fault if the servo has restarted."""
        return self._watch.take(self, keyword, value if isinstance(value, int) else None)

    def take_status(self, status: Status, asked_ns: int) -> str | None:
        """Judge a status; return the fault of a servo that is limp twice although it has power."""
        was_limp = self.is_limp
        is_driven = self.powered_ns is not None and asked_ns > self.powered_ns
        self.is_limp = is_driven and status is Status.LIMP
        if not self.is_limp:
            return None
        self._watch.note_sign(self, asked_ns)
        return STATUS_TEXTS[Cause.RESTARTED] if was_limp else None

    def trust(self) -> None:
        """Note that the servo has the settings again that it had lost."""
        self._watch.trust(self.joint.name)
        self.is_limp, self.powered_ns = False, None
