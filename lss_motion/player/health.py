"""Faults of the joints, found in their answers and in missing answers.

One answer is no proof: a bus without checksums can deliver a wrong number that looks right. So a
fault begins with the second reading in a row that shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.constants import Status
from lss_motion.robot.on_fault import Cause
from lss_motion.units import NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lss_motion.player.joint_state import JointState
    from lss_motion.robot.model import Joint

    FaultKey = tuple[str, Cause]


ASTRAY_NS: Final = NS_PER_S // 2
"""A joint must be off by more than `following_deg` for this long: one late move is no fault."""
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
        self._counts: dict[FaultKey, int] = {}
        self._astray_since_ns: dict[str, int] = {}
        self._unanswered: dict[str, _Unanswered] = {}
        """Servos that did not answer their last query."""
        self._before: dict[tuple[str, str], float] = {}

    def position(self, state: JointState, arrival_ns: int) -> None:
        """Judge the last accepted reading; the servo received the query at `arrival_ns`."""
        joint, error_deg = state.joint, abs(state.disturbance.error_deg)
        trouble = (joint.name, Cause.ASTRAY)
        if error_deg <= joint.following_deg:
            self._astray_since_ns.pop(joint.name, None)
            if error_deg <= BACK_RATIO * joint.following_deg:
                self.active_faults.pop(trouble, None)
        elif arrival_ns - self._astray_since_ns.setdefault(joint.name, arrival_ns) > ASTRAY_NS:
            self.active_faults[trouble] = (
                f"is {error_deg:.1f} deg off its course, allowed is {joint.following_deg:g} deg "
                f"(following_deg). Look for what holds it, or lower its limits"
            )

    def status(self, state: JointState, code: int, firmware: int) -> None:
        state.note_status(code, firmware)
        present = None if state.status is None else STATUS_CAUSES.get(state.status)
        for cause, text in STATUS_TEXTS.items():
            self._judge(state, cause, "Q", text, is_bad=cause is present)

    def temperature(self, state: JointState, temperature_c: float) -> None:
        state.note_temperature(self._twice(state, "QT", temperature_c, min))
        limit_c = state.joint.temperature_max_c
        text = (
            f"is hot: {temperature_c:.0f} C, allowed is {limit_c:g} C (temperature_max_c). Let it "
            f"rest, or give it less to carry"
        )
        self._judge(state, Cause.HOT, "QT", text, is_bad=temperature_c > limit_c)

    def voltage(self, state: JointState, voltage_v: float) -> None:
        state.note_voltage(self._twice(state, "QV", voltage_v, max))
        limit_v = state.joint.voltage_min_v
        text = (
            f"has {voltage_v:.1f} V, needed are {limit_v:g} V (voltage_min_v). Charge the battery, "
            f"or look at the wires"
        )
        self._judge(state, Cause.LOW_VOLTAGE, "QV", text, is_bad=voltage_v < limit_v)

    def answered(self, state: JointState) -> None:
        """Note any answer of a servo."""
        name = state.joint.name
        self._unanswered.pop(name, None)
        self.active_faults.pop((name, Cause.SILENT), None)

    def unanswered(self, state: JointState, now_ns: int, since_ns: int) -> None:
        """Note that a query to a servo was given up; `advance` judges it.

        `since_ns` is when it last answered, also before the show: a servo that restarts between two
        phases must be noticed before it is back and receives a move without its limits.
        """
        joint = state.joint
        new = _Unanswered(joint, since_ns, first_ns=now_ns, last_ns=now_ns)
        known = self._unanswered.setdefault(joint.name, new)
        known.count += 1
        known.last_ns = now_ns

    def advance(self, now_ns: int) -> None:
        """Find silent servos, without waiting for a query that is late on a full line."""
        for joint, since_ns in self._fading():
            if now_ns >= since_ns + ns_from_s(joint.silent_s):
                silent_s = s_from_ns(now_ns - since_ns)
                self.active_faults[joint.name, Cause.SILENT] = (
                    f"is silent: servo {joint.servo_id} has not answered for {silent_s:.1f} s. "
                    f"Look at its cable and its power"
                )

    def wakeups_ns(self) -> list[int]:
        """Return when `advance` must be called at the latest."""
        return [
            since_ns + ns_from_s(joint.silent_s)
            for joint, since_ns in self._fading()
            if (joint.name, Cause.SILENT) not in self.active_faults
        ]

    def unresponsive(self) -> set[str]:
        """Return the joints whose last query was not answered."""
        return set(self._unanswered)

    def _fading(self) -> Iterator[tuple[Joint, int]]:
        """Yield servos that will count as silent, and when they last answered."""
        for one in self._unanswered.values():
            if one.count >= SILENT_QUERIES and one.last_ns > one.first_ns:
                yield one.joint, one.since_ns

    def _judge(
        self, state: JointState, cause: Cause, keyword: str, text: str, *, is_bad: bool
    ) -> None:
        name = state.joint.name
        if not is_bad:
            if self._counts.pop((name, cause), 0) and self.unconfirmed.get(name) == keyword:
                del self.unconfirmed[name]
            self.active_faults.pop((name, cause), None)
            return
        count = self._counts[name, cause] = self._counts.get((name, cause), 0) + 1
        if count < CONFIRMATIONS:
            self.unconfirmed[name] = keyword
            return
        if self.unconfirmed.get(name) == keyword:
            del self.unconfirmed[name]
        self.active_faults[name, cause] = text

    def _twice(
        self, state: JointState, keyword: str, value: float, choose: Callable[[float, float], float]
    ) -> float:
        """Return what this reading and the one before it both confirm."""
        place = (state.joint.name, keyword)
        before = self._before.get(place, value)
        self._before[place] = value
        return choose(before, value)
