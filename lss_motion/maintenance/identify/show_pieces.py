"""From the log of an ordinary show to pieces of a few moves, which a fit can compute all at once.

The bytes of the log are given to the line and the query tracker of the player once more, so each
move has the instant at which its servo received it, and each reading the query that it answers.

A piece begins a few moves before the readings that are scored: where the profile of its servo is at
that moment is known from a model only, and what is wrong with it fades with each move. What is left
is for the fit: `Pieces.start_error` says how well each begin is known.

`ShowModel` is the response model of a servo over all pieces, for many sets of parameters at once: a
row is a set of parameters, a column a piece. The profile of the servo is that of
`planning.program.response`; the horn follows it with a lag, at most at the top speed, with play,
and pulled by its load.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import PlaybackError
from lss_motion.maintenance.identify.trials import SentMove
from lss_motion.planning.program.response import FADED, States, Trapezoids, exact_speeds, trapezoids
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.framing import Command, CommandParser, encode
from lss_motion.robot.profile import Profile, ramp_setting_deg_s2
from lss_motion.robot.servo_models import ramp_of_steps
from lss_motion.units import s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.response_fit import Hypothesis
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.playing.player.query_tracker import PendingQuery
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Joint, Robot

PIECE_S: Final = 1.5
"""A piece is scored over this time: a few moves."""
PIECES_MAX: Final = 40
"""Chosen: a minute of motion, a second of computing for a joint."""
TAIL_S: Final = 2.0
"""After the last move of a piece no later readings are used."""
WARM_MOVES: Final = 4
"""Moves before a piece, since the profile at its begin is only known from a model."""
REST_S: Final = 0.3
"""After a longer rest the profile is known."""
MOTION_DEG: Final = 3.0
"""Pieces in which the readings differ by less show no motion."""
RESTS_RATIO: Final = 0.2
"""Share of the pieces that may be without motion: they show the load."""
NEVER_S: Final = 1e9
"""Instant of a move that does not exist."""
RESTED: Final = (0.05, 0.5)
"""How well a begin at rest is known: angle (deg) and speed (deg/s). Chosen: half a wire unit."""


class TooLittleMotionError(PlaybackError):
    """A joint did not move enough in a show to be measured."""


def too_little(joint: Joint, why: str) -> TooLittleMotionError:
    """Return the error that says why a joint did not move enough, and what to do."""
    return TooLittleMotionError(
        f"joint {joint.name!r} did not move enough to be measured: {why}. Play a longer show, or "
        f"measure it by an experiment",
        joint=joint.name,
    )


class Believed(NamedTuple):
    """What the profile of a servo is taken to do, and how well that is known."""

    ramp_deg_s2: float
    hypothesis: Hypothesis
    start_error: tuple[float, float]
    """Standard errors of angle (deg) and speed (deg/s) of a profile in mid-move."""


class _ScoredMoves(NamedTuple):
    """Moves `first` to `last` (not included), scored between two instants."""

    first: int
    last: int
    from_s: float
    until_s: float


class Pieces(Struct, frozen=True):
    """Pieces as arrays, (pieces, moves); times count from the begin of each piece."""

    begin_s: FloatArray
    received_s: FloatArray
    target_deg: FloatArray
    duration_s: FloatArray
    start_deg: FloatArray
    start_deg_s: FloatArray
    start_error: FloatArray
    """(pieces, 2): standard errors of the last two."""
    last_s: float
    """The last reading of all."""
    piece: NDArray[np.intp]
    """Of each reading; they rise."""
    time_s: FloatArray
    reading_deg: FloatArray

    @property
    def firsts(self) -> NDArray[np.intp]:
        """The first reading of each piece."""
        return np.searchsorted(self.piece, np.arange(len(self.begin_s)))


def cut(recording: ShowRecording, believed: Believed, most: int = PIECES_MAX) -> Pieces:
    """Return at most `most` pieces with motion of a show, and some without; or raise."""
    states = list(_states(recording, believed))
    found = list(_cut(recording, states))
    times_s, readings_deg = np.array(recording.times_s), np.array(recording.readings_deg)
    owns = [np.flatnonzero((times_s >= p.from_s) & (times_s < p.until_s)) for p in found]
    ranges_deg = [float(np.ptp(readings_deg[own])) if len(own) > 2 else -1.0 for own in owns]
    moving = [n for n, range_deg in enumerate(ranges_deg) if range_deg >= MOTION_DEG]
    still = [n for n, range_deg in enumerate(ranges_deg) if 0.0 <= range_deg < MOTION_DEG]
    chosen = [*_spread(moving, most), *_spread(still, int(RESTS_RATIO * most))]
    if len(moving) < 3:
        raise too_little(recording.joint, "in fewer than 3 pieces of the show")
    some, count = [found[n] for n in chosen], max(found[n].last - found[n].first for n in chosen)
    received_s = np.full((len(some), count), NEVER_S)
    target_deg, duration_s = np.zeros((len(some), count)), np.ones((len(some), count))
    begin_s = np.array([recording.moves[piece.first].received_s for piece in some])
    for row, piece in enumerate(some):
        own = recording.moves[piece.first : piece.last]
        received_s[row, : len(own)] = [move.received_s - begin_s[row] for move in own]
        target_deg[row, : len(own)] = [move.target_deg for move in own]
        duration_s[row, : len(own)] = [move.duration_s for move in own]
    piece_of = np.concatenate([np.full(len(owns[n]), row) for row, n in enumerate(chosen)])
    reading = np.concatenate([owns[n] for n in chosen])
    time_s = times_s[reading] - begin_s[piece_of]
    starts = [states[piece.first] for piece in some]
    return Pieces(
        begin_s,
        received_s,
        target_deg,
        duration_s,
        np.array([state.position_deg for state in starts]),
        np.array([state.speed_deg_s for state in starts]),
        np.array([RESTED if state.is_rest else believed.start_error for state in starts]),
        float(time_s.max()),
        piece_of,
        time_s,
        readings_deg[reading],
    )


def _spread(numbers: Sequence[int], most: int) -> list[int]:
    """Return at most `most` of the numbers, evenly spread."""
    if len(numbers) <= most:
        return [*numbers]
    return [numbers[round(at)] for at in np.linspace(0, len(numbers) - 1, most).tolist()]


class _State(NamedTuple):
    """The profile when it receives a move, and whether it rested."""

    position_deg: float
    speed_deg_s: float
    is_rest: bool


def _states(recording: ShowRecording, believed: Believed) -> Iterator[_State]:
    """Yield the state of the profile at the receipt of each move; the horn where it is unknown."""
    profile, ends_s = None, -math.inf
    times_s, breaks_s = np.array(recording.times_s), np.array([*recording.breaks_s, math.inf])
    last_s = -math.inf
    for received_s, target_deg, duration_s in recording.moves:
        is_broken = np.searchsorted(breaks_s, last_s) != np.searchsorted(breaks_s, received_s)
        if profile is None or is_broken:
            at = max(int(np.searchsorted(times_s, received_s)) - 1, 0)
            standing_deg = recording.readings_deg[at] if len(times_s) else target_deg
            profile, ends_s = _profile(recording.joint, believed, standing_deg), -math.inf
        is_rest = not is_broken and received_s > ends_s + REST_S
        yield _State(*profile.at(received_s), is_rest)
        profile.retarget(received_s, target_deg, duration_s)
        profile.forget_before(received_s)
        *_, last = profile.pieces()
        last_s, ends_s = received_s, last.start_s


def _profile(joint: Joint, believed: Believed, position_deg: float) -> Profile:
    retarget, t_law = believed.hypothesis
    return Profile(
        position_deg,
        ramp_deg_s2=believed.ramp_deg_s2,
        speed_max_deg_s=joint.speed_max_deg_s,
        response=replace(joint.response, retarget=retarget, t_law=t_law),
    )


def _cut(recording: ShowRecording, states: Sequence[_State]) -> Iterator[_ScoredMoves]:
    """Yield the pieces of a show, of `PIECE_S` or up to a break."""
    moves, breaks_s = recording.moves, np.array([*recording.breaks_s, math.inf])
    after = np.searchsorted(breaks_s, [move.received_s for move in moves])
    begin = 0
    for index in range(1, len(moves) + 1):
        is_end = index == len(moves)
        is_broken = not is_end and after[index] != after[begin]
        passed_s = 0.0 if is_end else moves[index].received_s - moves[begin].received_s
        if not (is_end or is_broken or passed_s >= PIECE_S):
            continue
        next_s = math.inf if is_end else moves[index].received_s
        until_s = min(next_s, moves[index - 1].received_s + TAIL_S, breaks_s[after[begin]])
        first = begin
        while first > max(begin - 2 * WARM_MOVES, 0) and after[first - 1] == after[begin]:
            if states[first].is_rest or begin - first >= WARM_MOVES:
                break
            first -= 1
        yield _ScoredMoves(first, index, moves[begin].received_s, float(until_s))
        begin = index


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


RAMP, LAG, DEAD, LOAD, PLAY, TOP = 0, 1, 2, 3, 6, 7
SIZE: Final = 8
"""Shared parameters: logarithms of ramp and lag, dead time, three of the load, play, logarithm of
the top speed. Those of a piece: the waits of its moves, then angle and speed of its begin."""
TINY_DEG_S: Final = 1e-6
"""A move to where the servo stands has this speed."""


class Vectors(NamedTuple):
    """Sets of parameters: shared (sets, `SIZE`), and of pieces (sets, pieces, moves + 2)."""

    shared: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, shared: FloatArray, pieces: Pieces) -> Vectors:
        """Return sets without waits, that begin where the pieces say."""
        count, moves = pieces.received_s.shape
        return cls(shared, np.zeros((1, count, moves + 2)))

    def at(self, index: int) -> Vectors:
        """Return one set as a set of sets."""
        own = self.own[index : index + 1] if len(self.own) > 1 else self.own
        return Vectors(self.shared[index : index + 1], own)


class ShowModel:
    """The pieces of one joint, and what its servo does in them under one hypothesis."""

    def __init__(
        self, pieces: Pieces, hypothesis: Hypothesis, *, speed_max_deg_s: float, step_s: float
    ) -> None:
        """Compute horns in steps of `step_s`."""
        self._pieces, self._hypothesis = pieces, hypothesis
        self._speed_max_deg_s, self._step_s = speed_max_deg_s, step_s
        self._grid_s = step_s * np.arange(math.ceil(pieces.last_s / step_s) + 2)

    def speeds_deg_s(self, vectors: Vectors) -> FloatArray:
        """Return the speed of the profile at each reading."""
        profile_deg = self._profiles_deg(vectors)[0]
        speed_deg_s = np.asarray(np.gradient(profile_deg, self._step_s, axis=1), dtype=np.float64)
        found: FloatArray = np.abs(self._at_readings(speed_deg_s[None])[0])
        return found

    def readings_deg(self, vectors: Vectors) -> FloatArray:
        """Return what the servo would read, (sets, readings)."""
        horn_deg = self._at_readings(self._horns_deg(vectors, self._profiles_deg(vectors)))
        angle = np.radians(horn_deg)
        load = vectors.shared[:, LOAD : LOAD + 3, None]
        found: FloatArray = horn_deg - (
            load[:, 0] + load[:, 1] * np.sin(angle) + load[:, 2] * np.cos(angle)
        )
        return found

    def _at_readings(self, values: FloatArray) -> FloatArray:
        """Return values on the grid, (sets, pieces, steps), at the readings."""
        place = self._pieces.time_s / self._step_s
        low = np.clip(place.astype(np.intp), 0, len(self._grid_s) - 2)
        part, row = place - low, self._pieces.piece
        found: FloatArray = (1.0 - part) * values[:, row, low] + part * values[:, row, low + 1]
        return found

    def _profiles_deg(self, vectors: Vectors) -> FloatArray:
        """Return the profiles on the grid, (sets, pieces, steps).

        Each move is four parabolas of time: ramp, cruise, ramp, rest. Each holds for the points of
        the grid up to the next one, or to the next move.
        """
        moves = self._moves(vectors)
        rows = [phase for move in moves for phase in _phases(move)]
        starts_s, positions, speeds, accels = (
            np.stack([row[column] for row in rows], axis=-1) for column in range(4)
        )
        next_s = np.stack([move.start.time_s for move in moves[1:]], axis=-1).repeat(4, axis=-1)
        begins_s = starts_s.copy()
        np.minimum(begins_s[..., :-4], next_s, out=begins_s[..., :-4])
        count = len(self._grid_s)
        first = np.minimum(np.ceil(begins_s / self._step_s), count).astype(np.intp)
        first = np.maximum(np.maximum.accumulate(first, axis=-1), 0)
        first[..., 0] = 0
        counts = np.diff(first, axis=-1, append=count).ravel()
        shape = (*first.shape[:2], count)
        begun_s, position, speed, accel = (
            np.repeat(column.ravel(), counts).reshape(shape)
            for column in (starts_s, positions, speeds, 0.5 * accels)
        )
        passed_s = np.maximum(self._grid_s - begun_s, 0.0)
        found: FloatArray = position + passed_s * (speed + passed_s * accel)
        return found

    def _moves(self, vectors: Vectors) -> list[Trapezoids]:
        """Return each move with the state in which the servo takes it up, (sets, pieces)."""
        pieces, own = self._pieces, vectors.own
        shape = (len(vectors.shared), len(pieces.start_deg))
        ramp = np.broadcast_to(np.exp(vectors.shared[:, RAMP, None]), shape)
        taken_s = pieces.received_s + vectors.shared[:, DEAD, None, None] + own[..., :-2]
        position_deg = pieces.start_deg + own[..., -2]
        speed_deg_s = pieces.start_deg_s + own[..., -1]
        moves: list[Trapezoids] = []
        for index in range(pieces.received_s.shape[1]):
            begin_s = taken_s[:, :, index]
            if moves:
                begin_s = np.maximum(begin_s, moves[-1].start.time_s)
                state = moves[-1].at(begin_s)
                position_deg, speed_deg_s = state.position_deg, state.speed_deg_s
            if self._hypothesis.retarget == "from_rest":
                speed_deg_s = np.zeros(shape)
            start = States(
                begin_s, np.broadcast_to(position_deg, shape), np.broadcast_to(speed_deg_s, shape)
            )
            target_deg = np.broadcast_to(pieces.target_deg[:, index], shape)
            travel_deg_s = self._travel_deg_s(start, target_deg, pieces.duration_s[:, index], ramp)
            moves.append(trapezoids(start, target_deg, travel_deg_s, ramp))
        return moves

    def _travel_deg_s(
        self, start: States, target_deg: FloatArray, duration_s: FloatArray, ramp: FloatArray
    ) -> FloatArray:
        """Return the travel speeds that the servo makes of each T."""
        if self._hypothesis.t_law == "exact":
            asked_deg_s = exact_speeds(start, target_deg, duration_s, ramp)
        else:
            asked_deg_s = np.abs(target_deg - start.position_deg) / duration_s
        asked_deg_s = np.maximum(asked_deg_s, TINY_DEG_S)
        found: FloatArray = np.minimum(asked_deg_s, self._speed_max_deg_s)
        return found

    def _horns_deg(self, vectors: Vectors, profile_deg: FloatArray) -> FloatArray:
        """Return the shafts of horns that follow profiles: with lag, top speed and play."""
        sets, pieces, count = profile_deg.shape
        columns = np.ascontiguousarray(profile_deg.reshape(-1, count).T)
        lag_s, top_deg_s = np.exp(vectors.shared[:, [LAG, TOP]].T)
        half_deg = 0.5 * np.maximum(vectors.shared[:, PLAY], 0.0)
        horn_deg = _horns_deg(
            columns,
            lag_s.repeat(pieces) / self._step_s,
            self._step_s * top_deg_s.repeat(pieces),
            half_deg.repeat(pieces),
        )
        return horn_deg.T.reshape(sets, pieces, count)


def _phases(move: Trapezoids) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return begin, position, speed and acceleration of the four phases of a move."""
    sign, ramp, peak = move.sign, move.ramp_deg_s2, move.peak_deg_s
    change = np.copysign(ramp, peak - move.first_deg_s)
    first_s = move.start.time_s
    second_s = first_s + move.first_s
    third_s, last_s = second_s + move.cruise_s, peak / ramp
    at_deg = move.start.position_deg
    second_deg = at_deg + sign * 0.5 * (move.first_deg_s + peak) * move.first_s
    third_deg = second_deg + sign * peak * move.cruise_s
    end_deg = third_deg + sign * 0.5 * peak * last_s
    none = np.zeros_like(peak)
    return [
        (first_s, at_deg, sign * move.first_deg_s, sign * change),
        (second_s, second_deg, sign * peak, none),
        (third_s, third_deg, sign * peak, -sign * ramp),
        (third_s + last_s, end_deg, none, none),
    ]


def _horns_deg(
    profile_deg: FloatArray, lag_steps: FloatArray, reach_deg: FloatArray, half_deg: FloatArray
) -> FloatArray:
    """Return the shafts of horns that follow profiles, (steps, horns).

    Of each horn: the lag, the way that it can turn in a step, and half its play. Profiles are taken
    as straight between two steps.
    """
    late_deg = lag_steps * np.diff(profile_deg, axis=0)
    goal_deg = np.concatenate([profile_deg[:1], profile_deg[1:]])
    goal_deg[1:] -= late_deg
    goal_deg[0] -= late_deg[0]
    begin_deg = profile_deg[:-1] - late_deg
    keep_ratio = np.exp(-1.0 / lag_steps)
    horn_deg = goal_deg.copy()
    horn_deg[1:] -= keep_ratio * begin_deg
    shift, kept_ratio = 1, keep_ratio
    while kept_ratio.max() > FADED and shift < len(horn_deg):  # As in `response.lagged_deg`.
        horn_deg[shift:] += kept_ratio * horn_deg[:-shift]
        shift, kept_ratio = 2 * shift, kept_ratio * kept_ratio
    is_slow = (np.abs(np.diff(horn_deg, axis=0)) > reach_deg).any(axis=0)
    if is_slow.any():
        slow = np.flatnonzero(is_slow)
        own = (goal_deg[:, slow], begin_deg[:, slow], keep_ratio[slow], reach_deg[slow])
        horn_deg[:, slow] = _slow_horns_deg(*own)
    play = np.flatnonzero(half_deg)
    if len(play):
        low_deg, high_deg = horn_deg[:, play] - half_deg[play], horn_deg[:, play] + half_deg[play]
        shaft_deg = horn_deg[:, play]
        for step in range(1, len(shaft_deg)):
            np.minimum(shaft_deg[step - 1], high_deg[step], out=shaft_deg[step])
            np.maximum(shaft_deg[step], low_deg[step], out=shaft_deg[step])
        horn_deg[:, play] = shaft_deg
    return horn_deg


def _slow_horns_deg(
    goal_deg: FloatArray, begin_deg: FloatArray, keep_ratio: FloatArray, reach_deg: FloatArray
) -> FloatArray:
    """Return the horns of `_horns_deg` that cannot always turn as fast as they should."""
    found = np.empty_like(goal_deg)
    horn_deg = found[0] = goal_deg[0]
    for step in range(1, len(goal_deg)):
        moved_deg = goal_deg[step] + (horn_deg - begin_deg[step - 1]) * keep_ratio - horn_deg
        horn_deg = horn_deg + np.minimum(np.maximum(moved_deg, -reach_deg), reach_deg)
        found[step] = horn_deg
    return found
