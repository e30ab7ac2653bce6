"""The rules about bytes. Each function returns what one rule objects to, for one servo or bus.

Margins, all of them:

| what | allowed |
|---|---|
| position of a command | the range, and one unit of the wire; further out only to lead a horn back that stands there, or stood there within `STOOD_S` (`BACK_DEG`), or by a command that is no further out than the one before it |
| speed of a command | 2 % above the limit, which covers the rounding of SD and T |
| speed of a bare `D` in EM0 | over 60 ms of the filter, 10 % and 10 deg/s above the limit: the phase of its 20 ms is not known |
| speed of a 2IO | over 200 ms, 10 %, two whole degrees, and 20 ms of waiting for its turn on the line |
| ramps (AA, AD) | 1 % above the limit |
| settings lost in a restart | a host cannot know of a restart at once: what it writes until `ServoRecord.noticed_s` may go with factory ramps; above the limit of speed only within `ServoRecord.is_unnoticed`, and by `UNNOTICED_RATIO` at most; one that counts in another unit (`OTHER_UNITS`) has no other bound then than its own speed, nor has what was written before the restart |
| flood | 12 moves for a servo in 100 ms; half a second of bytes ahead of the line |
"""  # noqa: E501  (a table)

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from judge.recording import IO2, UNNOTICED_RATIO, Line
from judge.servo import BOARD_CHARS, BROADCAST, MOVES, WHEELS, Session, sections_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from judge.recording import BusRecord, JointRow, Recording, ServoRecord
    from judge.servo import Move, Section

SPEED_RATIO: Final = 1.02
RAMP_RATIO: Final = 1.01
BACK_DEG: Final = 1.0
STOOD_S: Final = 1.0
"""A host knows where a horn stood when it was asked; garbled bytes may have moved it since."""
LAG_S: Final = 0.03
"""The profile from which a servo starts leads its horn by so much at most (not documented)."""
NOISE_DEG: Final = 0.5
FILTER_S: Final = 0.02
FILTER_STEPS: Final = 3
FILTER_RATIO: Final = 1.1
FILTER_SPARE_DEG_S: Final = 10.0
STEPPED_S: Final = 0.2
STEPPED_WAIT_S: Final = 0.02
STEPPED_RATIO: Final = 1.1
STEPPED_SPARE_DEG: Final = 2.0
OTHER_UNITS: Final = "wrong_scale"
OTHER_ANGLES: Final = f"{OTHER_UNITS} D"
"""Excuse of a servo that counts its angles in another unit."""
FLOOD_S: Final = 0.1
FLOOD_MOVES: Final = 12
AHEAD_S: Final = 0.5
BITS_PER_BYTE: Final = 10
MATCH_S: Final = 30.0
"""A line may wait in an adapter that sends nothing for as long as this."""
LATE_S: Final = 0.06


@dataclass(frozen=True)
class Objection:
    """One thing that no host may do."""

    rule: str
    servo: str
    at_s: float
    text: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.servo} at {self.at_s:.3f} s: {self.text}"


@dataclass
class Told:
    """What a servo received, sorted by where it came from.

    `moves` are those that the host wrote. `foreign_s` is the first instant at which it obeyed
    something that the host did not write: a garbled line, or another host. `gaps` are times in
    which it missed lines of the host, or got them late, or several as one line.
    """

    session: Session
    moves: list[Move]
    foreign_s: float
    gaps: list[tuple[float, float]]
    powerless_s: list[float]
    """Instants at which its motor lost its power (limp, restart), or at which it was halted for
    good: H stops it at once."""


def told(joint: JointRow, servo: ServoRecord, bus: BusRecord) -> Told:
    """Return what a servo received, with the settings that were in force for each move."""
    sent, gaps = _own(bus.written, joint), []
    texts = {line.text for line in bus.written}
    merged_s = {line.at_s for line in servo.received if line.text not in texts}
    session = Session(joint, servo.stored)
    moves, foreign_s, powerless = [], math.inf, []
    restarts = deque(sorted(servo.restarts))
    changes = deque(sorted(servo.changes, key=lambda change: change[0]))
    last: tuple[str, float] = ("", -math.inf)
    halted_s: float | None = None
    for at_s, section in _own(servo.received, joint):
        while restarts and restarts[0] <= at_s:
            powerless.append(restarts[0])
            session.restart(restarts.popleft())
        while changes and changes[0][0] <= at_s:
            session.change(changes.popleft()[1])
        own_s = _take(sent, section.text, at_s, gaps)
        is_again = own_s is None and last[0] == section.text and at_s - last[1] < LATE_S
        if own_s is None and not is_again and not section.is_query:
            foreign_s = min(foreign_s, at_s)
        elif own_s is not None and (at_s - own_s > LATE_S or at_s in merged_s):
            gaps.append((own_s, at_s))
        last = (section.text, at_s)
        if section.keyword in MOVES | WHEELS | {"H"}:  # To be halted again changes nothing.
            halted_s = (halted_s or at_s) if section.keyword == "H" else None
        move = session.obey(section, at_s, servo.shaft_deg(at_s))
        if section.keyword in {"L", "RESET", "RS"}:
            powerless.append(at_s)
        if move is not None and own_s is not None:
            moves.append(replace(move, written_s=own_s))
    for at_s in restarts:
        powerless.append(at_s)
        session.restart(at_s)
    powerless += [] if halted_s is None else [halted_s]
    gaps += [(at_s, at_s) for at_s, section in sent if not section.is_query]
    gaps += bus.gone  # Lines that waited there arrive together.
    return Told(session, moves, foreign_s, gaps, powerless)


def _own(lines: Iterable[Line], joint: JointRow) -> deque[tuple[float, Section]]:
    """Return the commands for a servo, in order."""
    return deque(
        (line.at_s, section)
        for line in lines
        for section in sections_of(line.text)
        if section.is_for(joint.servo_id)
    )


def _take(
    sent: deque[tuple[float, Section]], text: str, at_s: float, gaps: list[tuple[float, float]]
) -> float | None:
    """Return when the host wrote a command that arrived; those before it were missed."""
    for index, (written_s, section) in enumerate(sent):
        if written_s > at_s:
            break
        if section.text == text and at_s - written_s < MATCH_S:
            for _ in range(index):
                missed_s, missed = sent.popleft()
                if not missed.is_query:
                    gaps.append((missed_s, at_s))
            sent.popleft()
            return written_s
    return None


# -- one servo ----------------------------------------------------------------------------------


def about_moves(joint: JointRow, servo: ServoRecord, received: Told) -> Iterator[Objection]:
    """Judge every move that a servo received from the host, one by one."""
    last_out_deg = 0.0
    for move in received.moves:
        is_tampered = received.foreign_s <= move.at_s
        if is_tampered and not move.is_frame_right:
            # Garbled bytes changed gyre or origin; a host compares them before anything moves.
            move = replace(move, shaft_deg=move.filed_deg)  # noqa: PLW2901
        texts = [("range", _range_text(joint, servo, move, last_out_deg))]
        last_out_deg = 0.0 if move.shaft_deg is None else _out_deg(joint, move.shaft_deg)
        if not is_tampered:
            texts.append(("frame", _frame_text(joint, move)))
        if joint.family != IO2 and not is_tampered:
            texts.append(("speed", _speed_text(joint, servo, move)))
            texts.append(("settings", _settings_text(joint, servo, move)))
        for rule, text in texts:
            if text:
                yield Objection(rule, joint.name, move.at_s, f"{move.text}: {text}")
    if joint.family == IO2:
        yield from _stepped(joint, received)
    else:
        yield from _filtered(joint, servo, received)


def _out_deg(joint: JointRow, shaft_deg: float) -> float:
    return joint.outside_deg(joint.joint_deg(shaft_deg))


def _range_text(joint: JointRow, servo: ServoRecord, move: Move, last_out_deg: float) -> str:
    if move.shaft_deg is None:
        return "it turns without end"
    target_deg = joint.joint_deg(move.shaft_deg)
    out_deg = joint.outside_deg(target_deg)
    if OTHER_ANGLES in servo.excuse:
        return ""  # The host can only go by what the servo reports.
    if out_deg <= max(0.5 if joint.family == IO2 else 0.11, last_out_deg):
        return ""
    if not servo.excuse:
        stood_deg = servo.shafts_deg(move.at_s - STOOD_S, move.at_s)
        stood_out_deg = max((_out_deg(joint, shaft_deg) for shaft_deg in stood_deg), default=0.0)
        if stood_out_deg > 0.0 and out_deg <= stood_out_deg + BACK_DEG:
            return ""
    return f"{target_deg:.2f} deg is out of the range {joint.low_deg:g} to {joint.high_deg:g} deg"


def _frame_text(joint: JointRow, move: Move) -> str:
    if move.is_frame_right:
        return ""
    return f"the servo has another gyre or origin than the robot file ({joint.gyre})"


def _way_deg(servo: ServoRecord, move: Move) -> float:
    """Return how far a move goes, at least: the profile may lead the horn a little."""
    shaft_deg = servo.shaft_deg(move.at_s)
    if shaft_deg is None or move.shaft_deg is None:
        return math.inf
    before_deg = servo.shaft_deg(move.at_s - LAG_S)
    lead_deg = abs(shaft_deg - (shaft_deg if before_deg is None else before_deg))
    return max(abs(move.shaft_deg - shaft_deg) - lead_deg - NOISE_DEG, 0.0)


def _speed_text(joint: JointRow, servo: ServoRecord, move: Move) -> str:
    """Judge the speed that a move implies: distance over T, at most SD."""
    if not move.has_profile:
        if move.duration_s is not None:
            return "in EM0 neither T nor SD counts: it jumps at full speed"
        return ""
    if move.restarted_s is not None and move.written_s < move.restarted_s:
        return ""  # It was on its way when the servo restarted: no host can call it back.
    allowed_deg_s = joint.speed_deg_s * SPEED_RATIO
    if servo.is_unnoticed(move.written_s):
        if OTHER_UNITS in servo.excuse:
            return ""  # It is not where its host believes; only SD bounded its speed, and is lost.
        allowed_deg_s *= UNNOTICED_RATIO
    if move.cap_deg_s <= allowed_deg_s:
        return ""
    way_deg = _way_deg(servo, move)
    peak_deg_s = math.sqrt(way_deg * move.accel_deg_s2) if math.isfinite(way_deg) else math.inf
    speed_deg_s = min(move.cap_deg_s, peak_deg_s)
    if move.duration_s is not None and math.isfinite(way_deg):
        speed_deg_s = min(speed_deg_s, way_deg / move.duration_s)
    if speed_deg_s <= allowed_deg_s:
        return ""
    return (
        f"it goes at {speed_deg_s:.0f} deg/s, allowed is {joint.speed_deg_s:g} (SD in force "
        f"{move.cap_deg_s:g} deg/s{_since(move)})"
    )


def _settings_text(joint: JointRow, servo: ServoRecord, move: Move) -> str:
    """Judge whether a servo that is driven has its limits."""
    if not move.has_profile:
        return ""
    if move.restarted_s is not None and move.written_s < servo.noticed_s(move.restarted_s):
        return ""
    if _way_deg(servo, move) == 0.0:
        return ""  # It stays where it is.
    has_speed = move.cap_deg_s <= joint.speed_deg_s * SPEED_RATIO
    has_ramps = move.accel_deg_s2 <= joint.accel_deg_s2 * RAMP_RATIO
    if has_speed and has_ramps:
        return ""
    return (
        f"driven without its limits: SD {move.cap_deg_s:g} deg/s of {joint.speed_deg_s:g}, "
        f"ramps {move.accel_deg_s2:g} deg/s2 of {joint.accel_deg_s2:g}{_since(move)}"
    )


def _since(move: Move) -> str:
    return "" if move.restarted_s is None else f"; it restarted at {move.restarted_s:.3f} s"


def _filtered(joint: JointRow, servo: ServoRecord, received: Told) -> Iterator[Objection]:
    """Judge the speed of the filter of EM0: every 20 ms, x = (x (FPC - 1) + target) / FPC."""
    streamed = [
        move for move in received.moves if not move.has_profile and move.shaft_deg is not None
    ]
    if not streamed or received.foreign_s < math.inf or servo.excuse:
        return
    first, at_s = streamed[0], streamed[0].at_s
    shaft_deg = servo.shaft_deg(at_s)
    past = deque([first.shaft_deg if shaft_deg is None else shaft_deg], maxlen=FILTER_STEPS + 1)
    allowed_deg_s = joint.speed_deg_s * FILTER_RATIO + FILTER_SPARE_DEG_S
    restarted_s = first.restarted_s
    for move, after in zip(streamed, [*streamed[1:], None], strict=True):
        end_s = move.at_s + 1.0 if after is None else after.at_s
        if move.restarted_s != restarted_s:  # Its filter begins where the horn is now.
            restarted_s, shaft_deg = move.restarted_s, servo.shaft_deg(move.at_s)
            past.clear()
            past.append(move.shaft_deg if shaft_deg is None else shaft_deg)
            at_s = move.at_s
        while at_s < end_s:
            assert past[-1] is not None
            assert move.shaft_deg is not None
            step = (move.shaft_deg - past[-1]) / move.filter_count
            if abs(step) < 1e-3 and after is not None:  # Settled: nothing until the next target.
                at_s += math.ceil((end_s - at_s) / FILTER_S) * FILTER_S
                past.extend([past[-1]] * FILTER_STEPS)
                break
            past.append(past[-1] + step)
            at_s += FILTER_S
            speed_deg_s = abs(past[-1] - past[0]) / (FILTER_S * (len(past) - 1))
            is_whole = len(past) > FILTER_STEPS
            if is_whole and speed_deg_s > allowed_deg_s and not _is_in_gap(received, at_s):
                text = f"{move.text}: its filter goes at {speed_deg_s:.0f} deg/s"
                text += f", allowed is {joint.speed_deg_s:g}"
                yield Objection("speed", joint.name, at_s, text)
                return


def _is_in_gap(received: Told, at_s: float, after_s: float = 0.5) -> bool:
    """Return whether a line that was lost or late explains what happened."""
    powerless = any(cut_s - FILTER_S <= at_s <= cut_s + after_s for cut_s in received.powerless_s)
    return powerless or any(a - FILTER_S <= at_s <= b + after_s for a, b in received.gaps)


def _stepped(joint: JointRow, received: Told) -> Iterator[Objection]:
    """Judge an RC servo, which jumps to each whole degree: the way in 100 ms."""
    if received.foreign_s < math.inf:
        return
    recent: deque[Move] = deque()
    for move in received.moves:
        if any(recent and recent[-1].at_s < cut_s <= move.at_s for cut_s in received.powerless_s):
            recent.clear()
        recent.append(move)
        while len(recent) > 2 and move.at_s - recent[1].at_s > STEPPED_S:
            recent.popleft()
        targets = [one.shaft_deg for one in recent if one.shaft_deg is not None]
        gone_s = move.at_s - recent[0].at_s
        way_deg = abs(targets[-1] - targets[0])
        most_deg = joint.speed_deg_s * STEPPED_RATIO * (gone_s + STEPPED_WAIT_S)
        if way_deg > most_deg + STEPPED_SPARE_DEG and not _is_in_gap(received, move.at_s):
            text = f"{move.text}: {way_deg:.0f} deg in {gone_s:.2f} s"
            text += f", allowed is {joint.speed_deg_s:g} deg/s"
            yield Objection("speed", joint.name, move.at_s, text)
            return


# -- one bus ------------------------------------------------------------------------------------


def about_writes(name: str, bus: BusRecord, joints: Sequence[JointRow]) -> Iterator[Objection]:
    """Judge what the host wrote: no flood, no section that overruns a 2IO."""
    per_s = bus.baud_bps / BITS_PER_BYTE
    ahead_bytes, last_s = 0.0, 0.0
    recent: dict[int, deque[float]] = {}
    has_board = any(joint.family == IO2 for joint in joints)
    is_flooded = is_long = False
    for line in bus.written:
        ahead_bytes = max(ahead_bytes - (line.at_s - last_s) * per_s, 0.0) + len(line.text)
        last_s = line.at_s
        if ahead_bytes > AHEAD_S * per_s and not is_flooded:
            is_flooded = True
            yield Objection("flood", name, line.at_s, f"{ahead_bytes:.0f} bytes wait for the line")
        for section in sections_of(line.text):
            if has_board and len(section.text) > BOARD_CHARS and not is_long:
                is_long = True
                yield Objection("board", name, line.at_s, f"{section.text} has more than "
                                f"{BOARD_CHARS} characters: it overruns the 2IO")  # fmt: skip
            if section.keyword not in MOVES | WHEELS:
                continue
            times_s = recent.setdefault(section.servo_id, deque())
            times_s.append(line.at_s)
            while line.at_s - times_s[0] > FLOOD_S:
                times_s.popleft()
            if len(times_s) > FLOOD_MOVES and not is_flooded:
                is_flooded = True
                yield Objection("flood", name, line.at_s, f"{len(times_s)} moves for servo "
                                f"{section.servo_id} within {FLOOD_S:g} s")  # fmt: skip


def about_end(recording: Recording, joint: JointRow) -> Iterator[Objection]:
    """Judge the last bytes: after its last move a servo is told to hold or to be limp.

    A servo without such a command is safe as well if its last move has ended in time. Where the
    port was gone at the end, the host could not write. A 2IO has no H.
    """
    bus = recording.buses[joint.bus]
    moved: tuple[float, Section] | None = None
    for line in bus.written:
        for section in sections_of(line.text):
            if not section.is_for(joint.servo_id):
                continue
            if section.keyword in MOVES | WHEELS:
                moved = (line.at_s, section)
            elif section.keyword in {"L", "H", "RESET"} and _stops(joint, section):
                moved = None
    if moved is None or any(b >= recording.end_s - 2.0 for _, b in bus.gone):
        return
    at_s, section = moved
    if joint.family == IO2 and section.keyword in MOVES:
        return
    yield Objection("end", joint.name, at_s, f"{section.text} is its last motion command: "
                    f"neither H nor L follows")  # fmt: skip


def _stops(joint: JointRow, section: Section) -> bool:
    return section.keyword != "H" or joint.family != IO2 or section.servo_id == BROADCAST
