"""The horns of all servos of one bus, and what drives them through time.

`Horns` computes how horns follow their profiles: a first-order lag, exact within a phase. `Drives`
gives each horn its phases: limp, a profile (EM1, wheel, hold) or the filter (EM0). Angles are raw.
`HornHistory` records the horns for tests; no servo can read it.

A horn that no load, jam or top speed holds back moves as its phases say, whatever the control loops
do: they only measure. So the loops are owed, until one of their results is asked for. `LoopBlock`
notes the phases meanwhile, and then computes all loops of the bus in a few numpy steps.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import TYPE_CHECKING, Final, NamedTuple, assert_never

import numpy as np

from lss_motion.sim.physics import FILTER_TICKS, TICK_NS
from lss_motion.sim.profile import (
    FilterMove,
    Halt,
    Motion,
    Order,
    PowerOff,
    ProfileMove,
    ProfilePhase,
    Ramps,
    Wheel,
    plan_move,
    plan_wheel,
    rest_at,
    travel_speed_deg_s,
)
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from lss_motion.sim.physics import Physics, ServoSpec

    FloatArray = NDArray[np.float64]

FOREVER_NS = 2**63 - 1

SETTLED_DEG = 1e-4
"""A horn this near to where it will end is at rest: a thousandth of the wire's resolution."""


class Horns:
    """Raw angles of all horns of a bus. Each has its own present phase and its own instant.

    `lag * dh/dt = x - droop - h`: in a phase, where x is a parabola, h is another parabola
    (`x` some way behind) and a gap that fades with `exp(-t / lag)`. So no step is too long,
    unless the motor's top speed or a jam holds the horn back.
    """

    def __init__(self, specs: Sequence[ServoSpec], physics: Physics) -> None:
        count = len(specs)
        self.deg = [float(spec.start_deg) for spec in specs]
        self.deg_s = [0.0] * count
        self.gap_deg = [0.0] * count
        self.droop_deg = [0.0] * count
        self.phases = [rest_at(spec.start_deg) for spec in specs]
        self.end_ns = [FOREVER_NS] * count
        self.next_end_ns = FOREVER_NS
        """When the first of the present phases ends."""
        self.block: LoopBlock | None = None
        """While loops are owed: what they must know of the horns."""
        self._stall_deg = physics.stall_deg
        self.has_ended = [False] * count
        """Whether a phase has ended, and the horn was not brought any further."""
        self._began_ns = [0] * count
        self._lags_s = [physics.lag_s] * count
        self._is_jammed = [False] * count
        self._ns = [0] * count
        self._finals: list[Parabola] = [(deg, 0.0, 0.0) for deg in self.deg]
        """Where the horns would end up but for their droop."""
        self._load_deg = np.array([spec.droop_deg for spec in specs], dtype=float)
        self._level_deg = np.array([spec.level_deg for spec in specs], dtype=float)
        is_touched = any(spec.hand is not None or spec.push is not None for spec in specs)
        self.may_droop = is_touched or bool(self._load_deg.any())
        """Whether a load, a hand or a push pulls any horn."""
        self._half_play_deg = np.array([spec.backlash_deg for spec in specs], dtype=float) / 2.0
        self._has_play = bool(self._half_play_deg.any())
        self.may_owe = not (self.may_droop or self._has_play)
        """Whether loops may be owed: each may be computed without the one before it."""
        self._shaft_deg = np.array(self.deg)
        self.holding_ratio = np.ones(count)
        self.pull_deg = np.zeros(count)
        """How far a hand pulls each powered horn; set by `motors`."""

    def start(self, now_ns: int) -> None:
        self._ns = [now_ns] * len(self._ns)
        self._began_ns = [now_ns] * len(self._ns)

    def begin(self, index: int, now_ns: int, phase: ProfilePhase) -> None:
        """Begin a phase at `now_ns`, to which the horn has been brought."""
        self.phases[index] = phase
        duration_s = phase.duration_s
        is_last = duration_s == math.inf
        self.end_ns[index] = FOREVER_NS if is_last else now_ns + round(duration_s * NS_PER_S)
        self.next_end_ns = min(self.end_ns)
        self._began_ns[index] = now_ns
        self._set_final(index, now_ns)

    def _set_final(self, index: int, now_ns: int) -> None:
        """Note where the horn, which is at `now_ns`, would end up in its phase."""
        _, position_deg, speed_deg_s, accel_deg_s2 = self.phases[index]
        lag_s = self._lags_s[index]
        behind_deg_s = speed_deg_s - lag_s * accel_deg_s2
        final = (position_deg - lag_s * behind_deg_s, behind_deg_s, 0.5 * accel_deg_s2)
        self._finals[index] = final
        phase_s = (now_ns - self._began_ns[index]) / NS_PER_S
        final_deg = (final[2] * phase_s + behind_deg_s) * phase_s + final[0]
        gap_deg = self.deg[index] - (final_deg - self.droop_deg[index])
        self.gap_deg[index] = gap_deg
        if self.block is not None:
            self.block.last_phase_ns = now_ns
            self.block.phases.append((now_ns, index, (*final, gap_deg)))
            self.block.is_held |= self._may_be_held(index, self.block.tops_deg_s[index])

    def _may_be_held(self, index: int, top_deg_s: float) -> bool:
        """Return whether the horn may lag so far in its phase that its motor's limits matter."""
        _, by_deg_s, by_deg_s2 = self._finals[index]
        duration_s = self.phases[index].duration_s
        last_deg_s = by_deg_s if by_deg_s2 == 0.0 else by_deg_s + 2.0 * by_deg_s2 * duration_s
        gap_deg = abs(self.gap_deg[index])
        left_deg_s = top_deg_s - gap_deg / self._lags_s[index]
        is_slow = -left_deg_s <= by_deg_s <= left_deg_s and -left_deg_s <= last_deg_s <= left_deg_s
        return gap_deg > self._stall_deg or not is_slow

    def coast(self, index: int, now_ns: int, top_deg_s: float) -> None:
        """Bring one horn to `now_ns` within its phase."""
        passed_s = (now_ns - self._ns[index]) / NS_PER_S
        if passed_s <= 0.0:
            return
        at_deg, by_deg_s, by_deg_s2 = self._finals[index]
        phase_s = (now_ns - self._began_ns[index]) / NS_PER_S
        final_deg = (by_deg_s2 * phase_s + by_deg_s) * phase_s + at_deg - self.droop_deg[index]
        deg = self.deg[index]
        fading = math.exp(-passed_s / self._lags_s[index])
        moved_deg = final_deg + self.gap_deg[index] * fading - deg
        reach_deg = 0.0 if self._is_jammed[index] else top_deg_s * passed_s
        if not -reach_deg <= moved_deg <= reach_deg:
            moved_deg = math.copysign(reach_deg, moved_deg)
        self.deg[index] = deg + moved_deg
        self.deg_s[index] = moved_deg / passed_s
        self.gap_deg[index] = deg + moved_deg - final_deg
        self._ns[index] = now_ns
        self.has_ended[index] = False
        if self.block is not None:
            self.block.looks.append((now_ns, index, deg + moved_deg))

    def step(self, now_ns: int, tops_deg_s: Sequence[float]) -> None:
        """Bring all horns to `now_ns`; none of their phases ends before."""
        for index, top_deg_s in enumerate(tops_deg_s):
            is_ended = self.has_ended[index] or self._ns[index] == now_ns
            self.coast(index, now_ns, top_deg_s)
            if is_ended:  # A loop in which a phase ends measures only how the gap fades.
                most_deg_s = 0.0 if self._is_jammed[index] else top_deg_s
                fading_deg_s = -self.gap_deg[index] / self._lags_s[index]
                self.deg_s[index] = min(max(fading_deg_s, -most_deg_s), most_deg_s)
        self.has_ended = [False] * len(self.has_ended)
        if self._has_play:
            self._shaft_deg = self.shafts_deg()

    def open_block(self, now_ns: int, tops_deg_s: Sequence[float]) -> None:
        """Owe the loops after `now_ns`, where all horns are, unless one may be held back."""
        if any(self._is_jammed):
            return
        if any(self._may_be_held(index, top_deg_s) for index, top_deg_s in enumerate(tops_deg_s)):
            return
        self.block = LoopBlock(
            now_ns,
            lags_s=self._lags_s,
            began_ns=self._began_ns,
            finals=self._finals,
            deg=self.deg,
            gap_deg=self.gap_deg,
            deg_s=self.deg_s,
            tops_deg_s=tops_deg_s,
        )

    def close_block(self) -> None:
        """Owe no more loops: bring all horns to the last one of the block."""
        block, self.block = self.block, None
        assert block is not None
        states = zip(block.deg.tolist(), block.gap_deg.tolist(), block.deg_s.tolist(), strict=True)
        for index, (deg, gap_deg, deg_s) in enumerate(states):
            passed_ns = self._ns[index] - block.ns
            if passed_ns > 0:  # It has been brought further.
                self.deg_s[index] = (self.deg[index] - deg) * NS_PER_S / passed_ns
                continue
            self._ns[index], self.has_ended[index] = block.ns, False
            self.deg[index], self.gap_deg[index], self.deg_s[index] = deg, gap_deg, deg_s

    def shafts_deg(self) -> NDArray[np.float64]:
        """Return where the horns are: within the play of their gears, on the side of their load."""
        deg = np.array(self.deg)
        if not self._has_play:
            return deg
        low_deg, high_deg = deg - self._half_play_deg, deg + self._half_play_deg
        shaft_deg = np.minimum(np.maximum(self._shaft_deg, low_deg), high_deg)
        pull = self._load_deg * np.cos(np.radians(deg - self._level_deg))
        return np.where(pull == 0.0, shaft_deg, np.where(pull > 0.0, low_deg, high_deg))

    def shaft_deg(self, index: int) -> float:
        """Return where one horn is; see `shafts_deg`."""
        return float(self.shafts_deg()[index]) if self._has_play else self.deg[index]

    def wrap(self, index: int) -> None:
        """Forget whole turns: the angle lies within ±180 from now on."""
        turned_deg = (self.deg[index] + 180.0) % 360.0 - 180.0 - self.deg[index]
        self.deg[index] += turned_deg
        self._shaft_deg[index] += turned_deg

    def sag(self, is_powered: NDArray[np.bool_]) -> None:
        """Let the loads pull as they do at the angles that the horns have now."""
        if self.may_droop:
            level = np.cos(np.radians(np.array(self.deg) - self._level_deg))
            pulled_deg = self._load_deg * self.holding_ratio * level - self.pull_deg
            droop_deg = is_powered * pulled_deg
            self.gap_deg = (np.array(self.gap_deg) + (droop_deg - self.droop_deg)).tolist()
            self.droop_deg = droop_deg.tolist()

    def release(self, index: int) -> None:
        """Take the motor's force away: friction alone keeps the horn where it is."""
        self.droop_deg[index] = self.deg_s[index] = 0.0

    def lead(self, index: int, now_ns: int, deg_s: float) -> None:
        """Let a horn without power turn at `deg_s` from now on."""
        ahead_deg = self._lags_s[index] * deg_s
        self.begin(index, now_ns, ProfilePhase(math.inf, self.deg[index] + ahead_deg, deg_s, 0.0))

    def set_lag(self, index: int, now_ns: int, lag_s: float) -> None:
        self._lags_s[index] = lag_s
        self._set_final(index, now_ns)

    def jam(self, index: int, *, is_jammed: bool) -> None:
        """Keep a horn from turning whatever the motor does, or free it again."""
        self._is_jammed[index] = is_jammed

    def is_moving(self) -> bool:
        """Return whether a profile moves, or a phase follows."""
        return self.next_end_ns < FOREVER_NS or any(p.speed_deg_s != 0.0 for p in self.phases)

    def is_settled(self) -> bool:
        return all(abs(gap_deg) < SETTLED_DEG for gap_deg in self.gap_deg)

    def profile_at(self, index: int, now_ns: int) -> tuple[float, float]:
        """Return where the servo's own profile is, and its speed."""
        _, position_deg, speed_deg_s, accel_deg_s2 = self.phases[index]
        passed_s = (now_ns - self._began_ns[index]) / NS_PER_S
        return (
            position_deg + (speed_deg_s + 0.5 * accel_deg_s2 * passed_s) * passed_s,
            speed_deg_s + accel_deg_s2 * passed_s,
        )


FILTER_NS = FILTER_TICKS * TICK_NS

FILTER_SETTLED_DEG = 0.05
"""The EM0 filter ends on its target when this near: half of the wire's resolution. Assumed."""


class Mode(Enum):
    """The kind of drive of a horn."""

    LIMP = "limp"
    PROFILE = "profile"
    FILTER = "filter"
    FREE = "free"


class Drives:
    """Feeds `horns` with the phases of all servos. Every instant is one of the servo's loops."""

    def __init__(self, horns: Horns, physics: Physics, loop_phases_ns: Sequence[int]) -> None:
        count = len(loop_phases_ns)
        self.mode = [Mode.LIMP] * count
        self.is_powered = np.zeros(count, dtype=bool)
        self.travel_deg_s = [0.0] * count
        self._horns = horns
        self._physics = physics
        self._first_loop_ns = list(loop_phases_ns)
        self._target_deg: list[float | None] = [None] * count
        self._phases: list[deque[ProfilePhase]] = [deque() for _ in range(count)]
        self._filters: list[FilterMove | None] = [None] * count

    def start(self, now_ns: int) -> None:
        self._first_loop_ns = [now_ns + phase_ns for phase_ns in self._first_loop_ns]

    def loop_ns(self, index: int, received_ns: int) -> int:
        """Return the first control loop of a servo from `received_ns` on."""
        return received_ns + (self._first_loop_ns[index] - received_ns) % TICK_NS

    def take_up(self, index: int, now_ns: int, order: Order) -> None:
        """Begin an order from the present position and speed of the profile."""
        position_deg, speed_deg_s = self._horns.profile_at(index, now_ns)
        if self.mode[index] is Mode.LIMP:  # Without a profile: from where the horn is.
            position_deg, speed_deg_s = self._horns.deg[index], 0.0
        if self._physics.retarget == "from_rest":
            speed_deg_s = 0.0
        match order:
            case ProfileMove():
                ramps = _timed(position_deg, speed_deg_s, order, self._physics)
                phases = plan_move(position_deg, speed_deg_s, order.target_deg, ramps)
                self.travel_deg_s[index] = ramps.speed_deg_s
                self._follow(index, now_ns, order.target_deg, phases)
            case PowerOff():
                self.go_limp(index, now_ns)
            case Halt():
                self.hold(index, now_ns, position_deg)
            case FilterMove():
                self._chase(index, now_ns, position_deg, order)
            case Wheel(wheel_deg_s, wheel_ramps, is_free):
                self.travel_deg_s[index] = abs(wheel_deg_s)
                if wheel_ramps is None:
                    phases = [ProfilePhase(math.inf, position_deg, wheel_deg_s, 0.0)]
                else:
                    phases = plan_wheel(position_deg, speed_deg_s, wheel_deg_s, wheel_ramps)
                self._follow(index, now_ns, None, phases)
                if is_free:
                    self.mode[index] = Mode.FREE
            case _:
                assert_never(order)

    def _follow(
        self, index: int, now_ns: int, target_deg: float | None, phases: list[ProfilePhase]
    ) -> None:
        self._filters[index] = None
        self._target_deg[index] = target_deg
        self.mode[index] = Mode.PROFILE
        self.is_powered[index] = True
        self._start(index, now_ns, phases)

    def hold(self, index: int, now_ns: int, position_deg: float) -> None:
        """Hold a position from now on."""
        self._follow(index, now_ns, position_deg, [rest_at(position_deg)])

    def _chase(self, index: int, now_ns: int, position_deg: float, chase: FilterMove) -> None:
        self._filters[index] = chase
        self.mode[index] = Mode.FILTER
        self.is_powered[index] = True
        if not chase.is_repeated:
            self._start(index, now_ns, [rest_at(_filtered(position_deg, chase))])
        else:
            since_ns = now_ns - self._first_loop_ns[index]
            wait_s = s_from_ns(FILTER_NS - since_ns % FILTER_NS)
            self._start(index, now_ns, [ProfilePhase(wait_s, position_deg, 0.0, 0.0)])

    def go_limp(self, index: int, now_ns: int) -> None:
        """Take the power off, where the horn is."""
        self._filters[index] = None
        self._target_deg[index] = None
        self.mode[index] = Mode.LIMP
        self.is_powered[index] = False
        self._horns.release(index)
        self._start(index, now_ns, [rest_at(self._horns.deg[index])])

    def _start(self, index: int, now_ns: int, phases: list[ProfilePhase]) -> None:
        first, *others = phases
        self._phases[index] = deque(others)
        self._horns.begin(index, now_ns, first)

    def next_phase(self, index: int, now_ns: int) -> None:
        """Begin the phase that follows the one that ends now."""
        if self._phases[index]:
            self._horns.begin(index, now_ns, self._phases[index].popleft())
            return
        chase = self._filters[index]
        assert chase is not None, "only the filter makes its phases as it goes"
        position_deg = _filtered(self._horns.phases[index].position_deg, chase)
        wait_s = math.inf if position_deg == chase.target_deg else s_from_ns(FILTER_NS)
        self._horns.begin(index, now_ns, ProfilePhase(wait_s, position_deg, 0.0, 0.0))

    def motion(self, index: int, now_ns: int) -> Motion:
        """Return the state of a servo from its profile."""
        if self.mode[index] is Mode.LIMP:
            return Motion.LIMP
        if self.mode[index] is Mode.FREE:
            return Motion.FREE_MOVING
        _, speed_deg_s = self._horns.profile_at(index, now_ns)
        accel_deg_s2 = self._horns.phases[index].accel_deg_s2
        if self.mode[index] is Mode.FILTER or speed_deg_s == accel_deg_s2 == 0.0:
            return Motion.HOLDING
        if accel_deg_s2 == 0.0:
            return Motion.TRAVELING
        is_faster = speed_deg_s * accel_deg_s2 >= 0.0
        return Motion.ACCELERATING if is_faster else Motion.DECELERATING

    def target_deg(self, index: int) -> float | None:
        """Return the target; in EM0 the present output of the filter (FACTS.md M9)."""
        if self.mode[index] is Mode.FILTER:
            return self._horns.phases[index].position_deg
        return self._target_deg[index]


def _timed(position_deg: float, speed_deg_s: float, move: ProfileMove, physics: Physics) -> Ramps:
    """Return the ramps of a move with the travel speed that its T requires."""
    away_deg = move.target_deg - position_deg
    duration_s = None if move.duration_s is None else _obeyed_s(move.duration_s, physics)
    if duration_s is None or away_deg == 0.0:
        return move.ramps
    towards_deg_s = math.copysign(1.0, away_deg) * speed_deg_s
    travel_deg_s = travel_speed_deg_s(
        abs(away_deg), duration_s, towards_deg_s, move.ramps, physics.t_law
    )
    return Ramps(travel_deg_s, move.ramps.accel_deg_s2, move.ramps.decel_deg_s2)


def _obeyed_s(duration_s: float, physics: Physics) -> float | None:
    """Return what a servo makes of a T; None: it ignores it."""
    if duration_s < physics.t_ignored_s:
        return None
    duration_s = max(duration_s, physics.t_least_s)
    if physics.t_step_s > 0.0:
        duration_s = physics.t_step_s * max(1, round(duration_s / physics.t_step_s))
    return duration_s


def _filtered(position_deg: float, chase: FilterMove) -> float:
    """Return one step of the EM0 filter: `x = (x*(FPC-1)+target)/FPC` (FACTS.md M6)."""
    count = max(chase.filter_count, 1)
    stepped_deg = (position_deg * (count - 1) + chase.target_deg) / count
    is_near = abs(stepped_deg - chase.target_deg) < FILTER_SETTLED_DEG
    return chase.target_deg if is_near else stepped_deg


FIRST_ROWS = 1024
"""Rows of the first buffer; it doubles when full."""


class HornHistory:
    """A growing table of instants and raw angles, in order of time.

    Angles between two rows are interpolated, so a horn at rest needs no rows.
    """

    def __init__(self, servo_count: int) -> None:
        self._count = 0
        self._times_ns = np.zeros(FIRST_ROWS, dtype=np.int64)
        self._angles_deg = np.zeros((FIRST_ROWS, servo_count))

    def append(self, time_ns: int, angles_deg: NDArray[np.float64]) -> None:
        self.extend(np.array([time_ns]), angles_deg[None])

    def extend(self, times_ns: NDArray[np.int64], angles_deg: NDArray[np.float64]) -> None:
        """Append rows of (instants, servos)."""
        assert not self._count or self._times_ns[self._count - 1] < times_ns[0], (
            "rows must be in order of time"
        )
        end = self._count + len(times_ns)
        while end > len(self._times_ns):
            self._times_ns = np.concatenate([self._times_ns, np.zeros_like(self._times_ns)])
            self._angles_deg = np.concatenate([self._angles_deg, np.zeros_like(self._angles_deg)])
        self._times_ns[self._count : end] = times_ns
        self._angles_deg[self._count : end] = angles_deg
        self._count = end

    def horn_deg(self, times_ns: Iterable[int] | NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the angles at the given instants, (instants, servos), in the order of the specs.

        Before the first row and after the last the horn stands still.
        """
        asked_ns = np.asarray(list(times_ns), dtype=np.int64)
        start_ns = self._times_ns[0] if self._count else 0
        asked_s = (asked_ns - start_ns).astype(np.float64)
        rows = slice(0, self._count)
        if len(asked_ns):  # Of an hour, only the rows around these instants are converted.
            within = self._times_ns[: self._count]
            first = int(np.searchsorted(within, asked_ns.min(), side="right")) - 1
            last = int(np.searchsorted(within, asked_ns.max(), side="left"))
            rows = slice(max(first, 0), max(min(last + 1, self._count), 1))
        known_s = (self._times_ns[rows] - start_ns).astype(np.float64)
        known_deg = self._angles_deg[rows]
        columns = [np.interp(asked_s, known_s, column) for column in known_deg.T]
        return np.stack(columns, axis=1)


BLOCK_NS: Final = 64 * TICK_NS
"""The loops of so long a time are owed at most. Chosen: a current or a temperature is asked for
more often, and a block stays small."""

Parabola = tuple[float, float, float]
"""Where a horn would end up: a parabola of the seconds since its phase began, in degrees."""


class Loops(NamedTuple):
    """What was measured in control loops, a row each: at the loop, or (`deg_s`) over it."""

    ns: NDArray[np.int64]
    deg: FloatArray
    deg_s: FloatArray
    gap_deg: FloatArray

    def first(self, count: int) -> Loops:
        return Loops(self.ns[:count], self.deg[:count], self.deg_s[:count], self.gap_deg[:count])


class LoopBlock:
    """What the horns do from the loop at `ns` on; its arguments are their states there.

    `deg`, `gap_deg` and `deg_s` are those at the loop at `ns`, the last one that is not owed.
    """

    def __init__(
        self,
        ns: int,
        *,
        lags_s: Sequence[float],
        began_ns: Sequence[int],
        finals: Sequence[Parabola],
        deg: Sequence[float],
        gap_deg: Sequence[float],
        deg_s: Sequence[float],
        tops_deg_s: Sequence[float],
    ) -> None:
        self.ns = ns
        self.deg, self.gap_deg, self.deg_s = np.array(deg), np.array(gap_deg), np.array(deg_s)
        self.tops_deg_s = tops_deg_s
        """Speeds that every motor reaches, whatever the others do."""
        self.last_phase_ns = ns
        """When the last phase began."""
        self.is_held = False
        """Whether a motor may hold its horn back from `last_phase_ns` on: the block must end."""
        self._lags_s = np.array(lags_s)
        self._since_ns = np.array([began_ns, [ns] * len(deg)]).T
        """When the phase of each horn began, and when its gap was as large as noted."""
        self._motion = np.column_stack([finals, gap_deg])
        self.phases: list[tuple[int, int, tuple[float, float, float, float]]] = []
        """Phases that have begun: when, of which horn, its final parabola and its gap."""
        self.looks: list[tuple[int, int, float]] = []
        """When which horn was brought to which angle: the speed of its loop counts from there. NaN:
        its phase has ended; then the loop measures only how its gap fades."""

    def loops(self, now_ns: int) -> Loops | None:
        """Return the loops that are owed up to `now_ns`; None: there are none."""
        count = (now_ns - self.ns) // TICK_NS
        if count <= 0:
            return None
        ns = self.ns + TICK_NS * np.arange(1, count + 1)
        loop_ns = ns[:, None]
        since_ns = np.repeat(self._since_ns[None], count, axis=0)
        motion = np.repeat(self._motion[None], count, axis=0)
        until_ns = int(ns[-1])
        for at_ns, index, values in self.phases:
            if at_ns <= until_ns:
                row = max(-((self.ns - at_ns) // TICK_NS) - 1, 0)
                since_ns[row:, index] = at_ns
                motion[row:, index] = values
        at_deg, by_deg_s, by_deg_s2, gap_deg = np.moveaxis(motion, 2, 0)
        phase_s = (loop_ns - since_ns[:, :, 0]) / NS_PER_S
        gap_deg = gap_deg * np.exp((since_ns[:, :, 1] - loop_ns) / NS_PER_S / self._lags_s)
        deg = (by_deg_s2 * phase_s + by_deg_s) * phase_s + at_deg + gap_deg
        loops = Loops(ns, deg, self._speeds_deg_s(ns, deg, gap_deg), gap_deg)
        self._since_ns, self._motion = since_ns[-1], motion[-1]
        self.phases = [phase for phase in self.phases if phase[0] > until_ns]
        self.looks = [look for look in self.looks if look[0] > until_ns]
        return loops

    def measured(self, loops: Loops) -> None:
        """Note that `loops` are no longer owed."""
        self.ns = int(loops.ns[-1])
        self.deg, self.deg_s, self.gap_deg = loops.deg[-1], loops.deg_s[-1], loops.gap_deg[-1]

    def _speeds_deg_s(
        self, ns: NDArray[np.int64], deg: FloatArray, gap_deg: FloatArray
    ) -> FloatArray:
        """Return how fast the horns turned since they were last brought to an instant."""
        from_ns = np.repeat((ns - TICK_NS)[:, None], len(self.deg), axis=1)
        from_deg = np.concatenate([self.deg[None], deg[:-1]])
        if self.looks:
            at_ns, indices, at_deg = map(np.array, zip(*self.looks, strict=True))
            rows = -((self.ns - at_ns) // TICK_NS) - 1
            is_within = (at_ns > self.ns) & (at_ns <= ns[-1])
            is_within &= np.isnan(at_deg) | ((at_ns - self.ns) % TICK_NS > 0)
            place = rows[is_within], indices[is_within]
            from_ns[place], from_deg[place] = at_ns[is_within], at_deg[is_within]
        passed_s = np.maximum(ns[:, None] - from_ns, 1) / NS_PER_S
        deg_s: FloatArray = np.where(
            np.isnan(from_deg), -gap_deg / self._lags_s, (deg - from_deg) / passed_s
        )
        return deg_s
