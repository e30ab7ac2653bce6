"""Asks the servos where they are and how they fare, in the gaps between the moves, and judges."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from lss_motion.player.events import Faulted
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import Status, status_from
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.player.line import Line
    from lss_motion.player.queries import Asked, Questioner
    from lss_motion.player.track import Track

HEALTH_EVERY: Final = 8
"""One question in so many is about health, not position: status, temperature, voltage in turn."""
HEALTH_KEYWORDS: Final = ("Q", "QT", "QV")
ASTRAY_NS: Final = NS_PER_S // 2
"""A joint must be off by more than `following_deg` this long before the show is stopped: one
wrong reading, or one late move, is no reason."""
SILENT_NS: Final = NS_PER_S
"""A servo that has not answered for this long, though asked, is silent."""
SILENT_ASKS: Final = 4
SPEED_WEIGHT_S_PER_DEG: Final = 0.05
ERROR_WEIGHT_PER_DEG: Final = 2.0
"""A joint is read sooner the faster it moves and the further it strayed (design 8). Chosen: at
20 deg/s, or at half a degree of error, twice as often as one at rest on its place."""
STATUS_FAULTS: Final = {
    Status.STUCK: "is stuck: it cannot make the move at its present speed",
    Status.BLOCKED: "is blocked: it cannot move at full power",
    Status.SAFE_MODE: "is in safe mode: current, voltage or temperature out of bounds; RESET it",
    Status.ERROR: "reports an error",
}
"""What a servo may be doing that ends a show."""


class Reader:
    """The questions of one show. Every joint has its own `Following` in its track."""

    def __init__(
        self,
        tracks: Mapping[str, Track],
        questioners: Mapping[str, Questioner],
        lines: Mapping[str, Line],
    ) -> None:
        self.faults: deque[Faulted] = deque()
        self.unbelieved: dict[str, int] = dict.fromkeys(lines, 0)
        self._questioners = questioners
        self._lines = lines
        self._by_bus: dict[str, list[Track]] = {bus: [] for bus in lines}
        for track in tracks.values():
            if track.joint.drive != "stepped":  # It knows no answer but its last command.
                self._by_bus[track.joint.bus].append(track)
        self._by_address = {(t.joint.bus, t.joint.servo_id): t for t in tracks.values()}
        self._health = dict.fromkeys(lines, 0)

    def ask(self, now_ns: int, quiet_until_ns: int | None) -> None:
        """Ask on every bus whose line stays free until `quiet_until_ns`; None is for ever."""
        for bus, questioner in self._questioners.items():
            if (expired := questioner.expire(now_ns)) is not None:
                self._note_silence(bus, expired, now_ns)
            line = self._lines[bus]
            if questioner.asked is not None or line.free_ns > now_ns:
                continue
            track = self._most_urgent(bus, now_ns)
            if track is None:
                continue
            question = Command(track.joint.servo_id, self._keyword(bus))
            end_ns = line.heard_ns(len(encode(question)), now_ns)
            if quiet_until_ns is None or end_ns <= quiet_until_ns:
                questioner.ask(question, now_ns)
                self._health[bus] += 1

    def receive(
        self, bus: str, reply: Reply, now_ns: int, wanted_deg: Callable[[Track, int], float]
    ) -> None:
        asked = self._questioners[bus].answer(reply, now_ns)
        if asked is None:
            return
        track = self._by_address.get((bus, asked.command.servo_id))
        if track is None:
            return
        track.answered_ns = now_ns
        track.silent_asks = 0
        said = read_reply(track.joint.model.family, reply)
        if said is None or not isinstance(said.value, int | float):
            return
        match reply.keyword:
            case "QD":
                self._take_position(bus, track, said.value, asked, wanted_deg)
            case "Q":
                self._take_status(track, int(said.value))
            case "QT":
                track.temperature_max_c = max(said.value, track.temperature_max_c or said.value)
            case "QV":
                track.voltage_min_v = min(said.value, track.voltage_min_v or said.value)
            case _:
                pass

    def wakeups_ns(self, now_ns: int) -> list[int]:
        """Return when something may have to be done, besides an answer coming in."""
        wakeups_ns = []
        for bus, questioner in self._questioners.items():
            if questioner.asked is not None:
                wakeups_ns.append(questioner.asked.give_up_ns)
            elif self._lines[bus].free_ns > now_ns:
                wakeups_ns.append(self._lines[bus].free_ns)
            else:
                quiet = [questioner.quiet_until_ns(t.joint.servo_id) for t in self._by_bus[bus]]
                wakeups_ns += [instant for instant in quiet if instant is not None]
        return wakeups_ns

    def _keyword(self, bus: str) -> str:
        count = self._health[bus]
        if count % HEALTH_EVERY == HEALTH_EVERY - 1:
            return HEALTH_KEYWORDS[count // HEALTH_EVERY % len(HEALTH_KEYWORDS)]
        return "QD"

    def _most_urgent(self, bus: str, now_ns: int) -> Track | None:
        """Return the joint whose reading is oldest, relative to how fast it moves and strayed."""
        best, best_merit = None, -1.0
        now_s = s_from_ns(now_ns)
        for track in self._by_bus[bus]:
            if not self._questioners[bus].is_free(track.joint.servo_id, now_ns):
                continue
            following = track.following
            if following.read_s is None:
                return track
            _, speed_deg_s = track.profile.at(now_s)
            weight = 1.0 + SPEED_WEIGHT_S_PER_DEG * abs(speed_deg_s)
            weight += ERROR_WEIGHT_PER_DEG * abs(following.error_deg)
            merit = (now_s - following.read_s) * weight
            if merit > best_merit:
                best, best_merit = track, merit
        return best

    def _take_position(
        self,
        bus: str,
        track: Track,
        measured_deg: float,
        asked: Asked,
        wanted_deg: Callable[[Track, int], float],
    ) -> None:
        read_s = s_from_ns(asked.heard_ns)
        expected_deg, speed_deg_s = track.profile.at(read_s - track.lead_s)
        believed = track.following.take(
            measured_deg,
            read_s,
            expected_deg=expected_deg,
            wanted_deg=wanted_deg(track, asked.heard_ns),
            speed_deg_s=speed_deg_s,
        )
        if not believed:
            self.unbelieved[bus] += 1
            return
        error_deg = track.following.error_deg
        if abs(error_deg) <= track.joint.following_deg:
            track.astray_since_ns = None
        elif track.astray_since_ns is None:
            track.astray_since_ns = asked.heard_ns
        elif asked.heard_ns - track.astray_since_ns > ASTRAY_NS:
            self.faults.append(
                Faulted(
                    track.joint.name,
                    f"is {abs(error_deg):.1f} deg off its course, allowed is "
                    f"{track.joint.following_deg:g} deg (following_deg)",
                )
            )

    def _take_status(self, track: Track, status: int) -> None:
        firmware = self._lines[track.joint.bus].bus.firmware
        track.status = status_from(status, track.joint.model.family, firmware)
        if cause := STATUS_FAULTS.get(track.status):
            self.faults.append(Faulted(track.joint.name, cause))

    def _note_silence(self, bus: str, expired: Asked, now_ns: int) -> None:
        track = self._by_address.get((bus, expired.command.servo_id))
        if track is None:
            return
        track.silent_asks += 1
        if track.answered_ns is None:
            track.answered_ns = now_ns
        silent_ns = now_ns - track.answered_ns
        if track.silent_asks >= SILENT_ASKS and silent_ns >= SILENT_NS:
            self.faults.append(
                Faulted(
                    track.joint.name,
                    f"is silent: servo {track.joint.servo_id} has not answered for "
                    f"{s_from_ns(silent_ns):.1f} s",
                )
            )
