"""The serial lines of a bus, byte by byte, and the order in which replies are sent.

`HostLine` carries bytes from the host to all servos. `ServoLine` carries replies to the host;
replies that overlap damage each other. `Adapter` is the USB adapter, which collects replies into
packets. `Answering` delays replies by the turnaround of the firmware and applies their faults.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from itertools import groupby
from random import Random
from typing import TYPE_CHECKING, NamedTuple, Protocol

from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.framing import TEXT_REPLIES, Command, Reply, encode, encode_joined
from lss_motion.sim.faults import damaged
from lss_motion.sim.physics import CORRUPT_SERIAL_RATIO, corrupt_reply_ratio_of, turnaround_of
from lss_motion.sim.servo import ORDERED_FIRMWARE, Servo
from lss_motion.units import line_time_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.sim.faults import Faults
    from lss_motion.sim.physics import Physics


LINE_KEPT_BYTES = 4096
"""A line without CR is cut after this many bytes; forty servos in one group need under 1000."""

Spans = list[tuple[int, int]]
"""Times in which something does not work: from, until."""


class HostLine:
    """From the host to all servos: bytes queue behind each other, each ten bits long."""

    def __init__(self, baud_bps: int) -> None:
        self._baud_bps = baud_bps
        self._burst_ns = 0
        self._burst_bytes = 0
        self._free_ns = 0
        self._partial = b""
        self._clogs_ns: Sequence[tuple[int, int]] = ()
        self._outages_ns: Sequence[tuple[int, int]] = ()
        self.lines: deque[tuple[int, bytes]] = deque()
        """Whole lines (CR included) and the instants at which their CR has arrived."""

    def start(self, clogs_ns: Spans, outages_ns: Spans) -> None:
        """Set when no byte leaves the adapter (clogs) and when bytes are lost (outages)."""
        self._clogs_ns = clogs_ns
        self._outages_ns = outages_ns

    def set_rate(self, baud_bps: int) -> None:
        """Continue at another rate. The unfinished line is dropped: no servo can read it."""
        self._baud_bps = baud_bps
        self._partial = b""
        self._burst_bytes = 0

    def write(self, data: bytes, now_ns: int) -> None:
        """Take the host's bytes; the first leaves as soon as the line is free."""
        if now_ns > self._free_ns or not self._burst_bytes:
            self._burst_ns = now_ns
            self._burst_bytes = 0
        partial = self._partial
        if partial:
            self._burst_bytes -= len(partial)  # It is counted again, with the end of its line.
            data = partial + data
        *lines, rest = data.split(b"\r")
        for line in lines:
            self._burst_bytes += len(line) + 1
            self._free_ns = self._arrival_ns()
            if not (self._outages_ns and self._is_lost(now_ns, self._free_ns)):
                self.lines.append((self._free_ns, line + b"\r"))
        self._partial = rest[-LINE_KEPT_BYTES:]
        if rest:
            self._burst_bytes += len(rest)
            self._free_ns = self._arrival_ns()

    def backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes written so far still occupy the line."""
        return max(self._free_ns - now_ns, 0)

    def _arrival_ns(self) -> int:
        left_ns = line_time_ns(self._burst_bytes, self._baud_bps)
        at_ns = self._burst_ns
        for from_ns, until_ns in self._clogs_ns:
            if until_ns > at_ns and from_ns < at_ns + left_ns:
                left_ns -= max(from_ns - at_ns, 0)
                at_ns = until_ns
        return at_ns + left_ns

    def _is_lost(self, now_ns: int, arrival_ns: int) -> bool:
        return any(
            from_ns < arrival_ns and now_ns < until_ns for from_ns, until_ns in self._outages_ns
        )


PAIR_GAP_BYTES = 4
"""Replies with a smaller gap between them are handed over together, as by an adapter. Chosen: a
servo that is asked twice in a row needs no longer between its replies."""


class ServoLine:
    """From all servos to the host. Servos that send at once damage each other's bytes.

    The receiver reads one byte after the other. A byte that starts while another is under way is
    lost and damages that other byte. A reply that overlaps no other is kept whole, which is faster.
    """

    def __init__(self, baud_bps: int, random: Random, adapter: Adapter) -> None:
        self._baud_bps = baud_bps
        self._edges_ns: list[int] = []
        self._random = random
        self._adapter = adapter
        self._whole: deque[tuple[int, int, bytes]] = deque()
        """Replies that overlap no other: when each begins and ends. Then `_coming` is empty."""
        self._read_bytes = 0
        """Bytes of the first of them that were read."""
        self._coming: list[tuple[int, int, int, int]] = []
        """Bytes of the others: when each begins, its number, when it ends, and its value."""
        self._ends_ns: list[int] = []
        """When each of the others ends."""
        self._count = 0
        self._current: tuple[int, int] | None = None
        self._echoes: deque[tuple[int, bytes]] = deque()
        """Lines of the host that its adapter returns, and when their CR was sent."""
        self._echoing_ns: Spans = []

    def send(self, data: bytes, start_ns: int) -> int:
        """Let a servo send `data` from `start_ns` on; return when its last byte has arrived."""
        size = len(data)
        while len(self._edges_ns) <= size:
            self._edges_ns.append(line_time_ns(len(self._edges_ns), self._baud_bps))
        end_ns = start_ns + self._edges_ns[size]
        is_clear = not self._whole or start_ns >= self._whole[-1][1]
        if is_clear and not self._coming and self._current is None and self._adapter.is_prompt:
            self._whole.append((start_ns, end_ns, data))
            return end_ns
        self._take_apart()
        self._send_bytes(data, start_ns, end_ns)
        return end_ns

    def start(self, echoing_ns: Spans) -> None:
        """Set when the adapter of the host returns what the host sends."""
        self._echoing_ns = echoing_ns

    def echo(self, line: bytes, sent_ns: int) -> None:
        """Return a line to the host, whose last byte has just left, if its adapter does so now."""
        if any(from_ns <= sent_ns < until_ns for from_ns, until_ns in self._echoing_ns):
            self._echoes.append((sent_ns, line))

    def _take_apart(self) -> None:
        """Send what is left of the whole replies byte by byte."""
        for start_ns, end_ns, data in self._whole:
            self._send_bytes(data, start_ns, end_ns, self._read_bytes)
            self._read_bytes = 0
        self._whole.clear()

    def _send_bytes(self, data: bytes, start_ns: int, end_ns: int, skipped: int = 0) -> None:
        """Send the bytes of a reply, but for the first `skipped` ones."""
        heapq.heappush(self._ends_ns, end_ns)
        for number in range(skipped, len(data)):
            self._count += 1
            begin_ns, until_ns = (start_ns + self._edges_ns[edge] for edge in (number, number + 1))
            heapq.heappush(self._coming, (begin_ns, self._count, until_ns, data[number]))

    def time_ns(self, size_bytes: int) -> int:
        """Return how long so many bytes occupy the line."""
        return line_time_ns(size_bytes, self._baud_bps)

    def set_rate(self, baud_bps: int) -> None:
        """Send replies that begin from now on at another rate."""
        self._take_apart()
        self._baud_bps = baud_bps
        self._edges_ns.clear()

    def read(self, now_ns: int) -> bytes:
        """Return the bytes that arrived by `now_ns`. Replies that start until then must be sent."""
        while self._echoes and self._echoes[0][0] <= now_ns:
            sent_ns, line = self._echoes.popleft()
            self._read_replies(sent_ns)
            for value in line:
                self._adapter.take(sent_ns, value)
        self._read_replies(now_ns)
        return self._adapter.read(now_ns)

    def _read_replies(self, now_ns: int) -> None:
        """Hand over the bytes of replies that arrived by `now_ns`."""
        if self._ends_ns:
            self._read_mixed(now_ns)
        while self._whole and self._whole[0][0] < now_ns:
            start_ns, end_ns, data = self._whole[0]
            first, edges_ns = self._read_bytes, self._edges_ns
            if end_ns <= now_ns:
                self._whole.popleft()
                self._read_bytes = 0
                self._adapter.take_all(edges_ns, start_ns, data, first, len(data))
                continue
            self._read_bytes = bisect_right(edges_ns, now_ns - start_ns) - 1
            self._adapter.take_all(edges_ns, start_ns, data, first, self._read_bytes)
            break

    def _read_mixed(self, now_ns: int) -> None:
        """Hand over the bytes of replies that are not whole."""
        coming, current, adapter = self._coming, self._current, self._adapter
        while coming and coming[0][0] <= now_ns:
            begin_ns, _, end_ns, value = heapq.heappop(coming)
            if current is not None and begin_ns < current[0]:
                current = (current[0], self._random.getrandbits(8))
                continue
            if current is not None:
                adapter.take(*current)
            current = (end_ns, value)
        if current is not None and current[0] <= now_ns:
            adapter.take(*current)
            current = None
        self._current = current
        while self._ends_ns and adapter.due_ns(self._ends_ns[0]) <= now_ns:
            heapq.heappop(self._ends_ns)

    def next_end_ns(self) -> int | None:
        """Return when the earliest reply, or echo, that was not read to its end is complete.

        Two replies that follow each other count as one: that saves the host a turn.
        With an adapter that sends packets: when the host gets it, or a full packet before it.
        """
        end_ns = self._next_reply_ns()
        if not self._echoes:
            return end_ns
        echo_ns = self._adapter.due_ns(self._echoes[0][0])
        return echo_ns if end_ns is None else min(end_ns, echo_ns)

    def _next_reply_ns(self) -> int | None:
        if self._whole:
            first_ns = self._whole[0][1]
            if len(self._whole) == 1:
                return first_ns
            begin_ns, end_ns, _ = self._whole[1]
            return end_ns if begin_ns - first_ns <= self._edges_ns[PAIR_GAP_BYTES] else first_ns
        if not self._ends_ns:
            return None
        due_ns = self._adapter.due_ns(self._ends_ns[0])
        room_bytes = self._adapter.room_bytes()
        is_under_way = self._current is not None
        if room_bytes is None or len(self._coming) + is_under_way < room_bytes:
            return due_ns
        ends_ns = [end_ns for _, _, end_ns, _ in heapq.nsmallest(room_bytes, self._coming)]
        if self._current is not None:
            ends_ns = [self._current[0], *ends_ns]
        return min(due_ns, ends_ns[room_bytes - 1])


PACKET_BYTES = 62
"""Data bytes in one packet of an FTDI adapter: 64 bytes of USB less two of status (FACTS.md H3)."""


@dataclass(slots=True)
class HostPacket:
    """Bytes that reach the host together."""

    due_ns: int
    data: bytearray = field(default_factory=bytearray)


class Adapter:
    """Delivers the bytes of the servos: each at once, or, with a latency, in packets.

    With a latency the bytes of a packet wait for the next tick of a timer, or until the packet
    is full (FACTS.md H1: 16 ms, or 1 ms where the host asks for it).
    """

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns
        self._origin_ns = 0
        self._outages_ns: Sequence[tuple[int, int]] = ()
        self._packets: deque[HostPacket] = deque()
        self._delivered = bytearray()
        """Without a latency: the bytes that have arrived since the last `read`."""

    def start(self, now_ns: int, outages_ns: Sequence[tuple[int, int]]) -> None:
        """Start the timer. In an outage the adapter is unplugged."""
        self._origin_ns = now_ns
        self._outages_ns = outages_ns

    def take(self, end_ns: int, value: int) -> None:
        """Take a byte that has arrived at `end_ns`; bytes come in order of time."""
        if not self._latency_ns:
            if not self._is_lost(end_ns):
                self._delivered.append(value)
            return
        last = self._packets[-1] if self._packets else None
        is_full = last is not None and len(last.data) == PACKET_BYTES
        if last is None or is_full or last.due_ns < end_ns:
            last = HostPacket(self.due_ns(end_ns))
            self._packets.append(last)
        last.data.append(value)
        if len(last.data) == PACKET_BYTES:
            last.due_ns = end_ns

    @property
    def is_prompt(self) -> bool:
        """Whether every byte is delivered when it arrives."""
        return not self._latency_ns

    def take_all(
        self, edges_ns: Sequence[int], start_ns: int, data: bytes, first: int, until: int
    ) -> None:
        """Take the bytes from `first` to before `until` of a reply, without a latency."""
        if not self._outages_ns:
            self._delivered += data[first:until]
            return
        for number in range(first, until):
            self.take(start_ns + edges_ns[number + 1], data[number])

    def read(self, now_ns: int) -> bytes:
        """Return what has been delivered by `now_ns`, the present instant."""
        data, self._delivered = self._delivered, bytearray()
        while self._packets and self._packets[0].due_ns <= now_ns:
            packet = self._packets.popleft()
            if not self._is_lost(packet.due_ns):
                data += packet.data
        return bytes(data)

    def due_ns(self, end_ns: int) -> int:
        """Return when a byte that arrives at `end_ns` is delivered at the latest."""
        if not self._latency_ns:
            return end_ns
        return end_ns + (self._origin_ns - end_ns) % self._latency_ns

    def room_bytes(self) -> int | None:
        """Return how many bytes still fill the present packet; None: there are no packets."""
        if not self._latency_ns:
            return None
        used = len(self._packets[-1].data) if self._packets else 0
        return PACKET_BYTES - used % PACKET_BYTES

    def _is_lost(self, due_ns: int) -> bool:
        outages_ns = self._outages_ns
        return bool(outages_ns) and any(a_ns <= due_ns < z_ns for a_ns, z_ns in outages_ns)


class Talker(Protocol):
    """Sends one reply after the other: a servo, or a board for all its pins."""

    sent_ns: int
    random: Random


class Answer(NamedTuple):
    """A reply, the command that it answers, its sender and the id of the sender."""

    talker: Talker
    servo_id: int
    command: Command
    reply: Reply


class Answering:
    """Puts replies on the line from the servos to the host."""

    def __init__(
        self, line: ServoLine, faults: Faults, *, physics: Physics, firmware: int, seed: int
    ) -> None:
        self._line = line
        self._faults = faults
        self._turnaround = physics.turnaround or turnaround_of(firmware)
        self._is_ordered = firmware >= ORDERED_FIRMWARE
        ratio = physics.corrupt_reply_ratio
        self._race_ratio = corrupt_reply_ratio_of(firmware) if ratio is None else ratio
        self._race = Random(f"{seed}/race")

    def send(
        self, received_ns: int, commands: Sequence[Command], answers: Sequence[Answer]
    ) -> None:
        """Send the replies to a line: each by itself, or those to a group together.

        Each reply has its own turnaround; replies that overlap damage each other.
        """
        if self._is_ordered and len(commands) > 1:
            is_to_all = [command.servo_id == BROADCAST_ID for command in commands]
            if not any(is_to_all):
                self._send_in_turn(received_ns, answers)
                return
            if all(is_to_all):
                self._send_in_slots(received_ns, answers)
                return
        for answer in answers:
            self._send((answer,), self._start_ns(answer, received_ns, 1))

    def _send_in_turn(self, received_ns: int, answers: Sequence[Answer]) -> None:
        """Send the replies to a group line one after another, in its order (FACTS.md W17)."""
        start_ns = received_ns + self._turnaround.group_ns
        runs = [list(run) for _, run in groupby(answers, lambda answer: answer.talker)]
        for number, run in enumerate(runs):
            if number:
                start_ns += self._turnaround.group_gap_ns
            start_ns = self._send_run(run, start_ns, is_last=run is runs[-1])

    def _send_in_slots(self, received_ns: int, answers: Sequence[Answer]) -> None:
        """Send the replies to several queries to all servos, each servo's together."""
        runs: dict[Talker, list[Answer]] = {}
        for answer in answers:
            runs.setdefault(answer.talker, []).append(answer)
        for talker, run in runs.items():
            is_last = isinstance(talker, Servo) and (
                talker.settings.number("SLOT") + 1 >= talker.settings.number("SLOTCOUNT")
            )
            start_ns = self._start_ns(run[0], received_ns, len(run))
            self._send_run(run, start_ns, is_last=is_last)

    def _send_run(self, run: Sequence[Answer], start_ns: int, *, is_last: bool) -> int:
        """Send the replies of one servo in one line, or as a part of one line for all (PROTOCOL).

        Text could not be told from the keyword that follows, so it ends its line.
        """
        is_one_line = isinstance(run[0].talker, Servo) and bool(
            run[0].talker.settings.number("PROTOCOL")
        )
        section: list[Answer] = []
        for answer in run:
            section.append(answer)
            if answer.reply.keyword in TEXT_REPLIES:
                start_ns = self._send(section, start_ns)
                section = []
        if section:
            start_ns = self._send(section, start_ns, has_end=is_last or not is_one_line)
        return start_ns

    def _start_ns(self, answer: Answer, received_ns: int, count: int) -> int:
        """Return when the replies to `count` queries of one line begin."""
        turnaround, command, servo = self._turnaround, answer.command, answer.talker
        is_slotted = self._is_ordered and command.servo_id == BROADCAST_ID
        if is_slotted and isinstance(servo, Servo):
            is_delayed = servo.settings.row("ID").suffix_is_delay and command.keyword == "QID"
            if is_delayed and isinstance(command.value, int):
                slot_ns = command.value * 1000 * servo.servo_id
                return received_ns + turnaround.broadcast_ns + slot_ns
            if servo.settings.number("SLOTCOUNT"):
                slot_ns = turnaround.slot_gap_ns
                slot_ns += self._line.time_ns(count * turnaround.slot_reply_bytes)
                slot_ns *= servo.settings.number("SLOT")
                return received_ns + turnaround.broadcast_ns + slot_ns
        spread_ns = turnaround.single_max_ns - turnaround.single_min_ns
        bits = (spread_ns + 1).bit_length()
        while (more_ns := servo.random.getrandbits(bits)) > spread_ns:
            pass  # As `randint` draws, without its checks.
        return received_ns + turnaround.single_min_ns + more_ns

    def _send(self, answers: Sequence[Answer], start_ns: int, *, has_end: bool = True) -> int:
        """Send replies of one sender together, after its last ones; return when they end."""
        talker, servo_id, _, reply = answers[0]
        faults, sender = self._faults, servo_id
        if faults.wrong_ids:
            sender = faults.sender(servo_id, start_ns)
        if sender == servo_id and len(answers) == 1:
            data = encode(reply)
        else:
            data = encode_joined([_sent_by(sender, answer) for answer in answers])
        if not has_end:
            data = data.removesuffix(b"\r")
        if self._race_ratio and isinstance(talker, Servo):
            ratio = self._race_ratio * (CORRUPT_SERIAL_RATIO if reply.keyword == "QN" else 1.0)
            if self._race.random() < ratio:
                data = damaged(data, self._race)
        pieces = [(data, start_ns)]
        if faults.about_replies:
            pieces = faults.sent(servo_id, data, start_ns)
        for piece, begin_ns in pieces:
            talker.sent_ns = self._line.send(piece, max(begin_ns, talker.sent_ns))
        return max(start_ns, talker.sent_ns)


def _sent_by(sender: int, answer: Answer) -> Reply:
    """Return the reply with the id of `sender` in place of that of its own sender."""
    reply = answer.reply
    return reply._replace(servo_id=sender) if reply.servo_id == answer.servo_id else reply
