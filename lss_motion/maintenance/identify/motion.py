"""Where a horn is after some commands, under each hypothesis: a profile, and a horn that lags it.

This is the model that is fitted. Unlike `program.response` it has two ramps and a horn with a
first-order lag, and its commands may be taken up late: what a servo does in between is asked, not
assumed. Angles are servo degrees, instants seconds of one trial.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

TINY_DEG_S: float = 1e-6
"""Slower than this is at rest: a wire unit in a day."""


class Hypothesis(NamedTuple):
    """What no document says of `D…T…` (FACTS.md A10, A11); named as in `robot.model.Response`."""

    retarget: Literal["keep_speed", "from_rest"]
    t_law: Literal["cruise", "exact"]


HYPOTHESES: tuple[Hypothesis, ...] = (
    Hypothesis("keep_speed", "cruise"),
    Hypothesis("keep_speed", "exact"),
    Hypothesis("from_rest", "cruise"),
    Hypothesis("from_rest", "exact"),
)


class Order(NamedTuple):
    """A `D target T duration` whose last byte the servo had at `heard_s`."""

    heard_s: float
    target_deg: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Shape:
    """What shapes a motion: the two ramps, the cap SD, and the time constant of the horn's lag."""

    accel_deg_s2: float
    decel_deg_s2: float
    speed_max_deg_s: float
    lag_s: float


class _State(NamedTuple):
    start_s: float
    position_deg: float
    speed_deg_s: float
    accel_deg_s2: float

    def after(self, duration_s: float) -> tuple[float, float]:
        speed_deg_s = self.speed_deg_s + self.accel_deg_s2 * duration_s
        return (
            self.position_deg + 0.5 * (self.speed_deg_s + speed_deg_s) * duration_s,
            speed_deg_s,
        )


def horn_deg(
    times_s: NDArray[np.float64],
    start_deg: float,
    orders: Sequence[Order],
    delays_s: Sequence[float],
    shape: Shape,
    hypothesis: Hypothesis,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the horn's angle at `times_s`, and how far it is behind the profile there.

    The servo rested on `start_deg` before. It takes up each order its delay after it was heard.
    The horn follows the profile with `lag_s * dh/dt = x - h`, which within a phase of constant
    acceleration is solved exactly.
    """
    states = [_State(-math.inf, start_deg, 0.0, 0.0)]
    for order, delay_s in zip(orders, delays_s, strict=True):
        states = _retargeted(states, order, order.heard_s + delay_s, shape, hypothesis)
    return _lagged(states, shape.lag_s, times_s)


def _retargeted(
    states: list[_State], order: Order, taken_s: float, shape: Shape, hypothesis: Hypothesis
) -> list[_State]:
    """Return the profile up to `taken_s`, and from there on to the order's target."""
    kept = [state for state in states if state.start_s < taken_s]
    last = kept[-1]
    position_deg, speed_deg_s = last.position_deg, 0.0
    if math.isfinite(last.start_s):
        position_deg, speed_deg_s = last.after(taken_s - last.start_s)
    if hypothesis.retarget == "from_rest":
        speed_deg_s = 0.0
    away_deg = order.target_deg - position_deg
    travel_deg_s = min(
        shape.speed_max_deg_s,
        _travel_deg_s(
            abs(away_deg),
            order.duration_s,
            max(math.copysign(1.0, away_deg) * speed_deg_s, 0.0),
            shape,
            hypothesis.t_law,
        ),
    )
    return kept + _move(taken_s, position_deg, speed_deg_s, order.target_deg, travel_deg_s, shape)


def _travel_deg_s(
    distance_deg: float, duration_s: float, speed_deg_s: float, shape: Shape, t_law: str
) -> float:
    """Return the speed that T asks for: distance / T, or that of the trapezoid that lasts T.

    In the latter the ramps cost (v - v0)²/2a and v²/2d of the distance that v alone would make.
    """
    if t_law == "cruise":
        return distance_deg / duration_s
    square = 0.5 / shape.accel_deg_s2 + 0.5 / shape.decel_deg_s2
    slowing_s = duration_s - speed_deg_s / shape.decel_deg_s2
    if slowing_s > 0.0:
        slower = (distance_deg - 0.5 * speed_deg_s**2 / shape.decel_deg_s2) / slowing_s
        if 0.0 < slower <= speed_deg_s:
            return slower
    linear = duration_s + speed_deg_s / shape.accel_deg_s2
    constant = distance_deg + 0.5 * speed_deg_s**2 / shape.accel_deg_s2
    discriminant = linear**2 - 4.0 * square * constant
    return math.inf if discriminant < 0.0 else (linear - math.sqrt(discriminant)) / (2.0 * square)


def _move(
    now_s: float,
    position_deg: float,
    speed_deg_s: float,
    target_deg: float,
    travel_deg_s: float,
    shape: Shape,
) -> list[_State]:
    """Return the phases of a move that ends at rest on `target_deg`.

    One that goes the wrong way, or too fast to stop in time, brakes to rest first and comes back.
    """
    states: list[_State] = []
    accel, decel = shape.accel_deg_s2, shape.decel_deg_s2

    def go(duration_s: float, accel_deg_s2: float) -> None:
        nonlocal now_s, position_deg, speed_deg_s
        if duration_s > 0.0:
            state = _State(now_s, position_deg, speed_deg_s, accel_deg_s2)
            states.append(state)
            position_deg, speed_deg_s = state.after(duration_s)
            now_s += duration_s

    stop_deg = position_deg + 0.5 * speed_deg_s * abs(speed_deg_s) / decel
    sign = math.copysign(1.0, target_deg - stop_deg)
    if sign * speed_deg_s < -TINY_DEG_S:
        go(abs(speed_deg_s) / decel, -math.copysign(decel, speed_deg_s))
        speed_deg_s = 0.0
    distance, speed = abs(target_deg - position_deg), abs(speed_deg_s)
    reach = (2.0 * accel * decel * distance + decel * speed**2) / (accel + decel)
    peak = travel_deg_s if speed > travel_deg_s else min(travel_deg_s, math.sqrt(reach))
    rate = -decel if peak < speed else accel
    ramps_deg = abs(peak**2 - speed**2) / (2.0 * abs(rate)) + peak**2 / (2.0 * decel)
    go((peak - speed) / rate, sign * rate)
    if peak > TINY_DEG_S:
        go(max(0.0, distance - ramps_deg) / peak, 0.0)
        go(peak / decel, -sign * decel)
    states.append(_State(now_s, target_deg, 0.0, 0.0))
    return states


def _lagged(
    states: list[_State], lag_s: float, times_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a horn that follows the profile with a first-order lag, and how far it is behind."""
    table = np.array(states)
    start_s, position, speed, accel = table.T
    start_s = np.where(np.isfinite(start_s), start_s, start_s[1] - 1.0 if len(states) > 1 else 0.0)
    behind = position - lag_s * (speed - lag_s * accel)  # Where it would be, all else long past.
    gap = np.zeros(len(states))
    for index in range(1, len(states)):
        passed_s = start_s[index] - start_s[index - 1]
        before = states[index - 1]
        speed_deg_s = before.speed_deg_s + before.accel_deg_s2 * passed_s
        final_deg = before.position_deg + 0.5 * (before.speed_deg_s + speed_deg_s) * passed_s
        final_deg -= lag_s * (speed_deg_s - lag_s * before.accel_deg_s2)
        fading = math.exp(-passed_s / lag_s)
        gap[index] = final_deg + gap[index - 1] * fading - behind[index]
    at = np.maximum(np.searchsorted(start_s, times_s, side="right") - 1, 0)
    passed = np.maximum(times_s - start_s[at], 0.0)
    now_speed = speed[at] + accel[at] * passed
    profile = position[at] + 0.5 * (speed[at] + now_speed) * passed
    behind_deg: NDArray[np.float64] = lag_s * (now_speed - lag_s * accel[at])
    behind_deg -= gap[at] * np.exp(-passed / lag_s)
    return profile - behind_deg, behind_deg
