"""What the log of an ordinary show holds about its servos: moves, readings, settings.

The bytes are given to the line and the query tracker of the player once more, so each move has the
instant at which its servo received it, and each reading the query that it answers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.maintenance.identify.trials import SentMove
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.framing import Command, CommandParser, encode
from lss_motion.robot.profile import ramp_setting_deg_s2
from lss_motion.robot.servo_models import ramp_of_steps
from lss_motion.units import s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.playing.player.query_tracker import PendingQuery
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Joint, Robot

BREAKING: Final = frozenset({"D", "MD", "P", "M", "WD", "WR", "L", "H", "RESET", "RDM", "EM"})
"""Commands after which the profile of a servo is unknown, but for `D…T…`."""


class LoggedBytes(NamedTuple):
    """What left for a bus or came from it at one instant."""

    at_ns: int
    bus: str
    is_sent: bool
    data: bytes


@dataclass(slots=True)
class ShowRecording:
    """One servo in a show. Servo degrees; seconds since the run began."""

    joint: Joint
    ramp_deg_s2: float
    """The setting of AA and AD."""
    moves: list[SentMove] = field(default_factory=list)
    breaks_s: list[float] = field(default_factory=list)
    """When its profile became unknown."""
    times_s: list[float] = field(default_factory=list)
    """When it received each query for its position, taken as the instant of the reading."""
    readings_deg: list[float] = field(default_factory=list)
    turnarounds_s: list[float] = field(default_factory=list)
    """From the end of each of these queries to the start of its answer, at the host."""


def recordings(logged: Iterable[LoggedBytes], robot: Robot) -> dict[str, ShowRecording]:
    """Return by joint what a log holds about it; joints that it does not name are left out."""
    buses = {name: _LoggedBus(name, robot) for name in robot.buses}
    for one in logged:
        if (bus := buses.get(one.bus)) is not None:
            bus.take(one)
    found = {}
    for name, joint in robot.joints.items():
        recording = buses[joint.bus].by_id[joint.servo_id]
        if recording.moves or recording.times_s:
            found[name] = recording
    return found


class _LoggedBus:
    """One bus of a log."""

    def __init__(self, name: str, robot: Robot) -> None:
        self.by_id = {
            joint.servo_id: ShowRecording(joint, ramp_setting_deg_s2(joint))
            for joint in robot.joints.values()
            if joint.bus == name
        }
        self._line = SerialLine(robot.buses[name])
        self._tracker = QueryTracker(self._line)
        self._parser = CommandParser(grouped=False)
        self._ramps_deg_s2: dict[int, float] = {}
        """By servo: the last AA. After the show another one may be given back."""

    def take(self, one: LoggedBytes) -> None:
        """Use what was written or read at once."""
        self._tracker.expire(one.at_ns)
        if not one.is_sent:
            for reply, ended_ns in self._line.receive(one.data, one.at_ns):
                for query, answer in self._tracker.receive(reply, ended_ns):
                    self._answered(query, answer, ended_ns)
            return
        for item in self._parser.feed(one.data):
            if isinstance(item, Command) and item.keyword.startswith("Q"):
                self._tracker.send(item, one.at_ns)
            elif isinstance(item, Command):
                self._ordered(item, s_from_ns(self._line.send(encode(item), one.at_ns)))
        self._line.take()

    def _ordered(self, command: Command, received_s: float) -> None:
        is_for_all = command.servo_id == BROADCAST_ID
        ids = list(self.by_id) if is_for_all else [command.servo_id]
        for recording in filter(None, map(self.by_id.get, ids)):
            value, modifiers = command.value, dict(command.modifiers)
            if command.keyword == "AA" and isinstance(value, int):
                ramp_deg_s2 = ramp_of_steps(recording.joint.model, value)
                self._ramps_deg_s2[recording.joint.servo_id] = ramp_deg_s2
            elif command.keyword == "D" and isinstance(value, int) and list(modifiers) == ["T"]:
                target_deg = value / recording.joint.model.wire_per_deg
                duration_s = s_from_ms(max(modifiers["T"], 1))
                recording.moves.append(SentMove(received_s, target_deg, duration_s))
                known_deg_s2 = self._ramps_deg_s2.get(recording.joint.servo_id)
                recording.ramp_deg_s2 = known_deg_s2 or recording.ramp_deg_s2
            elif command.keyword in BREAKING:
                recording.breaks_s.append(received_s)

    def _answered(self, query: PendingQuery, reply: Reply, ended_ns: int) -> None:
        recording = self.by_id.get(query.command.servo_id)
        if recording is None or reply.keyword != "QD":
            return
        answer = read_reply(recording.joint.model.language, reply)
        if answer is None or not isinstance(answer.value, int | float):
            return
        began_ns = ended_ns - self._line.time_ns(len(encode(reply)))
        recording.times_s.append(s_from_ns(query.arrival_ns))
        recording.readings_deg.append(float(answer.value))
        recording.turnarounds_s.append(s_from_ns(max(began_ns - query.arrival_ns, 0)))
