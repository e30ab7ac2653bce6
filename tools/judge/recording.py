"""The input of the judge: the joints of a robot file, and the recording of one run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NOTICE_S: Final = 1.5
"""After a restart a servo is deaf for 1.25 s, and libraries wait 1.5 to 3 s for it."""
READ_BACK_S: Final = 0.5
"""A host that polls twice a second notices within this time that a servo that answers again has
restarted."""
UNNOTICED_RATIO: Final = 1.5
"""So much faster than its limit may a move be that a host wrote for a servo in full motion, while
it cannot know that the servo restarted and stands still."""

LSS, PRO, IO2 = "LSS", "LSS-PRO", "LSS-2IO"

TOP_SPEED_DEG_S: Final = {"LSS-HS1": 600.0, "LSS-ST1": 360.0, "LSS-HT1": 360.0}
"""No-load speeds of the data sheets: the factory value of SD ("Max per servo")."""


@dataclass(frozen=True)
class JointRow:
    """What the robot file allows one servo."""

    name: str
    bus: str
    servo_id: int
    model: str
    low_deg: float
    high_deg: float
    speed_deg_s: float
    accel_deg_s2: float
    direction: int = 1
    zero_deg: float = 0.0
    gyre: int = 1
    origin_deg: float = 0.0
    filter_step_deg: float = 0.5
    """In EM0 a horn is stepped from target to target: so much within one step of the filter, or the
    tolerance that the host states where its line is too full."""

    @property
    def family(self) -> str:
        """The family, by the model string: PRO models are `LSS-P-…`."""
        if "2IO" in self.model:
            return IO2
        return PRO if self.model.startswith("LSS-P") else LSS

    def joint_deg(self, shaft_deg: float) -> float:
        """Return the joint angle of a shaft angle counted from the factory zero, clockwise."""
        return self.direction * (self.gyre * (shaft_deg - self.origin_deg) - self.zero_deg)

    def outside_deg(self, joint_deg: float) -> float:
        """Return how far a joint angle is out of the range; 0 inside."""
        return max(self.low_deg - joint_deg, joint_deg - self.high_deg, 0.0)


def joints_of(robot: Mapping[str, Any]) -> list[JointRow]:
    """Return the joints of a robot file that was read as plain YAML."""
    buses = list(robot.get("buses") or {"main": {}})
    shared = robot.get("defaults") or {}
    rows = []
    for name, own in robot["joints"].items():
        entry = {**shared, **own}
        stored = {**(shared.get("stored") or {}), **(own.get("stored") or {})}
        low, high = entry["range_deg"]
        rows.append(
            JointRow(
                name=name,
                bus=entry.get("bus") or buses[0],
                servo_id=entry["id"],
                model=entry.get("model") or "LSS-ST1",
                low_deg=float(low),
                high_deg=float(high),
                speed_deg_s=float(entry["speed_max_deg_s"]),
                accel_deg_s2=float(entry["accel_max_deg_s2"]),
                direction=int(entry.get("direction") or 1),
                zero_deg=float(entry.get("zero_deg") or 0.0),
                gyre=int(stored.get("G", 1)),
                origin_deg=float(stored.get("O", 0.0)),
                filter_step_deg=max(float(entry.get("tolerance_deg", 0.0)), 0.5),
            )
        )
    return rows


@dataclass(frozen=True)
class Line:
    """One line on a bus: when its last byte arrived (or was written), and its bytes."""

    at_s: float
    text: str


@dataclass(frozen=True)
class ServoRecord:
    """What one servo received, and what its horn did.

    `stored`     what its EEPROM holds at the start, by keyword, as numbers of the wire
    `changes`    settings that it got at an instant from something else than this host, which it
                 keeps: (instant, wire numbers by keyword)
    `restarts`   instants at which it lost its session (power dip, reset)
    `back`       for some of them, when it answered again: (restart, answer)
    `horn_deg`   shaft angles from the factory zero, `step_s` apart from `horn_from_s` on
    `excuse`     why its horn is not judged, such as "stuck"; empty: it is judged
    """

    bus: str
    servo_id: int
    stored: Mapping[str, int] = field(default_factory=dict)
    received: Sequence[Line] = ()
    changes: Sequence[tuple[float, Mapping[str, int]]] = ()
    restarts: Sequence[float] = ()
    back: Sequence[tuple[float, float]] = ()
    horn_from_s: float = 0.0
    step_s: float = 0.005
    horn_deg: Sequence[float] = ()
    excuse: str = ""

    def noticed_s(self, restart_s: float) -> float:
        """Return when a host must have noticed a restart."""
        backs_s = [back_s for at_s, back_s in self.back if at_s == restart_s]
        return max(restart_s + NOTICE_S, max(backs_s, default=restart_s) + READ_BACK_S)

    def is_unnoticed(self, at_s: float) -> bool:
        """Return whether a host may not know of a restart yet: the servo just answers again."""
        backs = dict(self.back)
        return any(
            restart_s <= at_s < backs.get(restart_s, restart_s) + READ_BACK_S
            for restart_s in self.restarts
        )

    def shaft_deg(self, at_s: float) -> float | None:
        """Return the shaft angle at an instant; None without a record of the horn."""
        if not self.horn_deg:
            return None
        at = (at_s - self.horn_from_s) / self.step_s
        index = min(max(int(at), 0), len(self.horn_deg) - 1)
        after = min(index + 1, len(self.horn_deg) - 1)
        share = min(max(at - index, 0.0), 1.0)
        return self.horn_deg[index] * (1.0 - share) + self.horn_deg[after] * share

    def shafts_deg(self, from_s: float, to_s: float) -> Sequence[float]:
        """Return the recorded shaft angles between two instants."""
        first, last = ((at_s - self.horn_from_s) / self.step_s for at_s in (from_s, to_s))
        return self.horn_deg[max(int(first), 0) : max(int(last) + 1, 0)]


@dataclass(frozen=True)
class BusRecord:
    """What the host wrote to one bus. `gone` are the times in which its port carried nothing."""

    baud_bps: int
    written: Sequence[Line] = ()
    gone: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class Recording:
    """One run. `end_s` is the end of the record, some time after the last byte of the host."""

    joints: Sequence[JointRow]
    buses: Mapping[str, BusRecord]
    servos: Sequence[ServoRecord]
    end_s: float


def recording_of(robot: Mapping[str, Any], record: Mapping[str, Any]) -> Recording:
    """Return the recording that a JSON file holds, of the robot in a plain robot file."""
    buses = {
        name: BusRecord(
            baud_bps=bus["baud_bps"],
            written=_lines(bus["written"]),
            gone=[(float(a), float(b)) for a, b in bus.get("gone", ())],
        )
        for name, bus in record["buses"].items()
    }
    servos = [
        ServoRecord(
            bus=one["bus"],
            servo_id=one["id"],
            stored=one.get("stored", {}),
            received=_lines(one["received"]),
            changes=[(float(at_s), settings) for at_s, settings in one.get("changes", ())],
            restarts=[float(at_s) for at_s in one.get("restarts", ())],
            back=[(float(a), float(b)) for a, b in one.get("back", ())],
            horn_from_s=float(one.get("horn_from_s", 0.0)),
            step_s=float(one.get("step_s", 0.005)),
            horn_deg=one.get("horn_deg", ()),
            excuse=one.get("excuse", ""),
        )
        for one in record["servos"]
    ]
    return Recording(joints_of(robot), buses, servos, float(record["end_s"]))


def _lines(rows: Sequence[Sequence[Any]]) -> list[Line]:
    return [Line(float(at_s), str(text)) for at_s, text in rows]
