"""The small moves of a careful run, and what they show of a servo.

A joint turns `WAY_DEG` out and back three times (`make_legs`). Of the settings that shape a move
(SD, T, AA, AD), each limits one of the first four legs: the leg has the expected speed only if the
servo counts this setting in the unit of the documents. If it does not, another setting still limits
the speed to `SPEED_RATIO` of that of the joint. The last two legs are as in a show, slower.

`judged` compares the readings of one leg with its `Course`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS
from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.protocol.codec import language_table
from lss_motion.robot.profile import Piece, ramp_setting_deg_s2, travel_speed
from lss_motion.robot.servo_models import ramp_of_steps, ramp_steps
from lss_motion.units import MS_PER_S, s_from_ms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.robot.model import Joint, Robot


WAY_DEG: Final = 5.0
"""A small move. Chosen: fifty times the scatter of a reading (FACTS.md E7), five times the backlash
of worn gears, and less than what brings a limb into contact with another in a pose of rest."""
WAY_LEAST_DEG: Final = 1.0
"""In a shorter move, scatter and backlash hide the speed."""
MARGIN_DEG: Final = 0.5
"""Distance that is kept from the end of the range."""
SPEED_RATIO: Final = 0.2
"""No leg is faster than this share of the joint's speed limit, nor than the approach speed."""
SLOWER_RATIO: Final = 0.25
"""Speed of the legs that one setting limits, as a share of what the others allow. Chosen: a unit
that is 10 times as large, or as small, changes the speed by 4 or 10, which no load does."""
SLOW_LEG_S: Final = 2.0
"""A slow joint turns less than `WAY_DEG`, so that a leg does not last much longer than this."""
GENTLE_RATIO: Final = 1.0 / 9.0
"""Ramp of the legs that test it, in units of speed² / way: a third of the speed is reached."""
JUDGED: Final = (0.2, 0.8)
"""The part of the way over which the speed is measured, as shares of it: without backlash and
without the end, where a load slows the horn."""
ARRIVED_RATIO: Final = 0.6
"""A horn that turned less than this share of its way is blocked: backlash and load take less."""
SCATTER_DEG: Final = 0.2
"""Scatter of two readings (FACTS.md E7): at a low speed, it hides the lag."""
RATIO_MAX: Final = 1.7
"""A horn whose speed is within 1/1.7 and 1.7 times what is expected has the right units. Chosen: a
loaded servo and other ramps make 1.3 (measured), a wrong unit at least 2.5."""


class Course(Struct, frozen=True):
    """A profile from rest to rest over `way_deg`, from its start on; magnitudes above 0."""

    way_deg: float
    speed_deg_s: float
    accel_deg_s2: float
    decel_deg_s2: float

    @property
    def peak_deg_s(self) -> float:
        """The highest speed."""
        both = self.accel_deg_s2 * self.decel_deg_s2 / (self.accel_deg_s2 + self.decel_deg_s2)
        return min(self.speed_deg_s, math.sqrt(2.0 * both * self.way_deg))

    @property
    def duration_s(self) -> float:
        """When it rests."""
        peak = self.peak_deg_s
        ramps_deg = 0.5 * peak * peak * (1.0 / self.accel_deg_s2 + 1.0 / self.decel_deg_s2)
        cruise_s = (self.way_deg - ramps_deg) / peak
        return cruise_s + peak / self.accel_deg_s2 + peak / self.decel_deg_s2

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the angle from the start, and the speed."""
        peak, left_s = self.peak_deg_s, self.duration_s - time_s
        if time_s <= 0.0:
            return 0.0, 0.0
        if left_s <= 0.0:
            return self.way_deg, 0.0
        if time_s < peak / self.accel_deg_s2:
            return 0.5 * self.accel_deg_s2 * time_s**2, self.accel_deg_s2 * time_s
        if left_s < peak / self.decel_deg_s2:
            return (
                self.way_deg - 0.5 * self.decel_deg_s2 * left_s**2,
                self.decel_deg_s2 * left_s,
            )
        return peak * (time_s - 0.5 * peak / self.accel_deg_s2), peak

    def time_s(self, angle_deg: float) -> float:
        """Return when it is at `angle_deg`, between its ends."""
        peak, left_deg = self.peak_deg_s, self.way_deg - angle_deg
        if angle_deg <= 0.5 * peak**2 / self.accel_deg_s2:
            return math.sqrt(2.0 * angle_deg / self.accel_deg_s2)
        if left_deg <= 0.5 * peak**2 / self.decel_deg_s2:
            return self.duration_s - math.sqrt(2.0 * left_deg / self.decel_deg_s2)
        return angle_deg / peak + 0.5 * peak / self.accel_deg_s2


class CarefulMove(Struct, frozen=True, kw_only=True):
    """One move from rest to rest. Servo degrees."""

    tests: str
    """The setting whose unit it tests; empty: it is as in a show."""
    start_deg: float
    target_deg: float
    duration_ms: int
    settings: dict[str, float]
    """The settings of the session by keyword, in physical units."""
    course: Course

    @property
    def sign(self) -> float:
        """The direction of the move."""
        return math.copysign(1.0, self.target_deg - self.start_deg)


def way_of(joint: Joint, robot: Robot, standing_deg: float) -> float:
    """Return by how many servo degrees the joint turns, towards the end that is further away.

    0: its range has no room for a move that shows anything. Raises `InputError` for a joint that
    stands outside of its range.
    """
    ends = joint.servo_range_deg
    if not ends[0] - MARGIN_DEG <= standing_deg <= ends[1] + MARGIN_DEG:
        raise InputError(
            f"joint {joint.name!r} stands at {joint.joint_deg(standing_deg):.1f} deg, outside of "
            f"its range of {joint.position_min_deg:g} to {joint.position_max_deg:g} deg, where no "
            f"careful move begins. Bring it inside by hand while it is limp, or see whether "
            f"`zero_deg` and `direction` are right (lss-motion calibrate)",
            path=robot.path,
            line=joint.lines.get("range_deg"),
        )
    room_deg = max(standing_deg - ends[0], ends[1] - standing_deg) - MARGIN_DEG
    slow_deg = max(SLOW_LEG_S * SLOWER_RATIO * top_deg_s(joint, robot), WAY_LEAST_DEG)
    way_deg = min(WAY_DEG, slow_deg, room_deg)
    if way_deg < WAY_LEAST_DEG:
        return 0.0
    return way_deg if ends[1] - standing_deg >= standing_deg - ends[0] else -way_deg


def top_deg_s(joint: Joint, robot: Robot) -> float:
    """Return the highest speed of the joint in a careful run."""
    return min(SPEED_RATIO * joint.speed_max_deg_s, robot.approach_speed_deg_s)


def make_legs(joint: Joint, robot: Robot, standing_deg: float, way_deg: float) -> list[CarefulMove]:
    """Return the legs of a joint: out and back three times, by `way_deg` (servo degrees)."""
    top = top_deg_s(joint, robot)
    ramp = ramp_setting_deg_s2(joint)
    steps = ramp_steps(joint.model, GENTLE_RATIO * top * top / abs(way_deg), 1.0)
    gentle = min(ramp_of_steps(joint.model, max(steps, 1)), ramp)
    slow = SLOWER_RATIO * top
    plans = (
        ("SD", slow, top, ramp, ramp),
        ("T", top, slow, ramp, ramp),
        ("AA", top, top, gentle, ramp),
        ("AD", top, top, ramp, gentle),
        ("", top, top, ramp, ramp),
        ("", top, top, ramp, ramp),
    )
    legs = []
    for number, (tests, limit, travel, accel, decel) in enumerate(plans):
        ends = (standing_deg, standing_deg + way_deg)
        start_deg, target_deg = ends[:: -1 if number % 2 else 1]
        settings = {"EM": 1.0, "AA": accel, "AD": decel, "SD": _settable(joint, limit)}
        legs.append(_leg(joint, tests, (start_deg, target_deg), travel, settings))
    return legs


def _settable(joint: Joint, speed_deg_s: float) -> float:
    """Return the speed nearest below that SD can express, at least its smallest."""
    row = language_table(joint.model.language).row("SD")
    return max(math.floor(row.wire_per_unit * speed_deg_s), 1) / float(row.wire_per_unit)


def _leg(
    joint: Joint,
    tests: str,
    ends_deg: tuple[float, float],
    travel_deg_s: float,
    settings: dict[str, float],
) -> CarefulMove:
    """Return a leg whose T makes the joint travel at `travel_deg_s`, if nothing else slows it."""
    start_deg, target_deg = ends_deg
    way_deg, ratio = abs(target_deg - start_deg), joint.ramp_ratio
    duration_s = way_deg / travel_deg_s
    if joint.response.t_law == "exact":  # Its T includes the ramps.
        duration_s += travel_deg_s / (ratio * min(settings["AA"], settings["AD"]))
    duration_ms = min(math.ceil(MS_PER_S * duration_s), DURATION_MAX_MS)
    ramp = ratio * max(settings["AA"], settings["AD"])
    travel = travel_speed(
        Piece(0.0, 0.0, 0.0, 0.0), way_deg, s_from_ms(duration_ms), ramp, joint.response
    )
    course = Course(
        way_deg=way_deg,
        speed_deg_s=min(settings["SD"], travel),
        accel_deg_s2=ratio * settings["AA"],
        decel_deg_s2=ratio * settings["AD"],
    )
    return CarefulMove(
        tests=tests,
        start_deg=start_deg,
        target_deg=target_deg,
        duration_ms=duration_ms,
        settings=settings,
        course=course,
    )


class MoveRatios(Struct, frozen=True):
    """What the readings of a leg show: the share of the way, of the speed, and the lag."""

    way_ratio: float
    speed_ratio: float
    """0: the horn did not come far enough to tell."""
    expected_deg_s: float
    """The expected speed over the part of the way that is judged."""
    lag_s: float
    """By how much it was later than its profile, half-way."""


def measured(leg: CarefulMove, times_s: Sequence[float], turned_deg: Sequence[float]) -> MoveRatios:
    """Return what the readings show; `times_s` count from the instant of the command.

    `turned_deg` are angles from the rest before the leg, in its direction. A load may keep the horn
    short of its target, so shares are those of the way that it went.
    """
    course, way_deg = leg.course, turned_deg[-1] if turned_deg else 0.0
    way_ratio = way_deg / course.way_deg
    if way_ratio < ARRIVED_RATIO:
        return MoveRatios(way_ratio, 0.0, 0.0, 0.0)
    angles_deg = [share * way_deg for share in (JUDGED[0], 0.5, JUDGED[1])]
    first_s, middle_s, last_s = (_crossing_s(times_s, turned_deg, deg) for deg in angles_deg)
    # What backlash takes, it takes at the start.
    lost_deg = max(course.way_deg - way_deg, 0.0)
    begins_s, half_s, ends_s = (
        course.time_s(min(deg + lost_deg, course.way_deg)) for deg in angles_deg
    )
    judged_deg, least_s = angles_deg[2] - angles_deg[0], s_from_ms(1)
    return MoveRatios(
        way_ratio,
        (ends_s - begins_s) / max(last_s - first_s, least_s),
        judged_deg / max(ends_s - begins_s, least_s),
        middle_s - half_s,
    )


def _crossing_s(times_s: Sequence[float], turned_deg: Sequence[float], angle_deg: float) -> float:
    """Return when the horn came to `angle_deg`, between two readings; it did."""
    before_s, before_deg = 0.0, 0.0
    for time_s, turn_deg in zip(times_s, turned_deg, strict=True):
        if turn_deg >= angle_deg:
            share = (angle_deg - before_deg) / max(turn_deg - before_deg, 1e-9)
            return before_s + share * (time_s - before_s)
        before_s, before_deg = time_s, turn_deg
    return before_s


MEANS: Final = {
    "SD": "its speed limit (SD)",
    "T": "the time of a move (T)",
    "AA": "its acceleration (AA)",
    "AD": "its deceleration (AD)",
    "D": "its angles (D)",
}
UNIT_REMEDY: Final = (
    "If nothing holds or pushes it and its supply is right, this servo has other units than its "
    "`model` in the robot file: compare that with the label on the servo, and update its firmware; "
    "for an LSS-PRO, `units` in the robot file can say what its servos count in"
)


def lag_scatter_s(leg: CarefulMove) -> float:
    """Return how much the scatter of the readings may change the lag of a leg."""
    return SCATTER_DEG / leg.course.peak_deg_s


def judgement(joint: Joint, leg: CarefulMove, found: MoveRatios, identify_command: str) -> str:
    """Return how the leg deviates from what is expected, and what to do; '' if it does not."""
    if found.way_ratio < ARRIVED_RATIO:
        turned_deg = found.way_ratio * leg.course.way_deg
        return (
            f"turned {turned_deg:.1f} deg where {leg.course.way_deg:.1f} deg were expected. It is "
            f"blocked, or too weak for its load: free it, and look at its supply. {UNIT_REMEDY}"
        )
    assumed_s = joint.response.lag_s
    allowed_s = LAG_MAX_S + lag_scatter_s(leg)
    if not leg.tests and found.lag_s - assumed_s > allowed_s:
        return (
            f"is {MS_PER_S * found.lag_s:.0f} ms later than its profile, "
            f"{MS_PER_S * assumed_s:.0f} ms are assumed (`response` of the joint), and "
            f"{MS_PER_S * LAG_MAX_S:.0f} ms more can be corrected. Lighten its load, or measure "
            f"it: {identify_command}"
        )
    if not 1.0 / RATIO_MAX <= found.speed_ratio <= RATIO_MAX:
        tested = MEANS.get(leg.tests, "its speed")
        return (
            f"turned at {found.speed_ratio * found.expected_deg_s:.1f} deg/s where "
            f"{found.expected_deg_s:.1f} deg/s were expected: {found.speed_ratio:.2g} times as "
            f"fast, in the move that tests {tested}. {UNIT_REMEDY}"
        )
    return ""
