"""Faults of the joints, found in their answers and in missing answers.

One answer is no proof: a bus without checksums can deliver a wrong number that looks right. So a
fault begins with the second reading in a row that shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.constants import Status
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.on_fault import Cause
from lss_motion.units import NS_PER_MS, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.servo_model import Observation
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
