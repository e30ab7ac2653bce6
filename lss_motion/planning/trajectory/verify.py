"""The independent check of a trajectory: angles are sampled and differenced.

It shares no code with the planner. It reads angles only (`sample`, order 0), at 1 kHz and on both
sides of every knot, and derives speed, acceleration and, where it is limited, jerk itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import PlanningError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Pass, Trajectory
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Joint, Robot

    FloatArray = NDArray[np.float64]

SAMPLE_S: Final = 0.001
"""Sampling at 1 kHz (FACTS.md A19)."""

EXCESS_MAX_RATIO: Final = 1.001
"""A limit may be exceeded by 0.1 % (FACTS.md A19)."""

RANGE_SLACK_DEG: Final = 1e-6
"""A joint may be this far outside of its range: rounding, far below the unit on the bus."""

BLOCK: Final = 8192
"""Samples at a time. Chosen: the data of 18 joints fit the processor's cache (measured)."""

SIDE_BY_SIDE: Final = 64
"""Samples that are laid side by side to find the extreme. Chosen: the fastest of 8 to 256."""

SEAM_S: Final = 0.004
"""Time on both sides of a seam of two passes that is sampled: enough for second differences."""

SIDE_STEP_S: Final = 2.5e-4
"""Largest step of the one-sided differences at knots."""

SIDE_STEP_MIN_S: Final = 1e-5
"""Polynomials that need a shorter step are left out, because rounding exceeds their differences;
the samples at equal steps bound their effect."""

PASSES_MAX: Final = 4
"""The first, two middle passes and the last contain every pass and every kind of seam."""

ROUNDING: Final = 16.0 * np.finfo(np.float64).eps
"""Relative error of a sampled time or angle: rounding of a few operations."""


class Verification(Struct, frozen=True, kw_only=True):
    """How close a trajectory comes to the limits: the largest share used, and where."""

    samples: int
    speed_ratio: float
    speed_joint: str
    speed_at_s: float
    accel_ratio: float
    accel_joint: str
    accel_at_s: float
    jerk_ratio: float = 0.0
    """0 where no joint has a jerk limit."""
    jerk_joint: str = ""
    jerk_at_s: float = 0.0


@dataclass(slots=True)
class _Worst:
    """The largest share of a limit found so far."""

    ratio: float = 0.0
    column: int = 0
    at_s: float = 0.0

    def update(
        self, sizes: FloatArray, times_s: FloatArray, noise: FloatArray, limits: FloatArray
    ) -> None:
        """Keep the largest of `sizes`, (n, joints), less `noise`, divided by its joint's limit.

        Only the largest of each joint is divided, because there are millions of samples.
        """
        if not len(sizes):
            return
        ratios = (extreme(np.maximum, sizes) - noise) / limits
        column = int(ratios.argmax())
        if ratios[column] > self.ratio:
            at_s = float(times_s[int(sizes[:, column].argmax())])
            self.keep(float(ratios[column]), column, at_s)

    def keep(self, ratio: float, column: int, at_s: float) -> None:
        """Keep the share of a limit if it is the largest so far."""
        if ratio > self.ratio:
            self.ratio, self.column, self.at_s = ratio, column, at_s


def verify(
    trajectory: Trajectory,
    robot: Robot,
    *,
    has_parts: bool = True,
    is_from_rest: bool = True,
    is_to_rest: bool = True,
) -> Verification:
    """Return the largest shares of the limits that are used.

    Raises `PlanningError` with joint, time and limit if an angle is not a number or leaves its
    range, or if speed, acceleration or jerk exceed their limit by more than 0.1 %. Passes that
    repeat are sampled once, and so are their seams. Of a pass that is made of trajectories, these
    and the seams between them are checked; `has_parts` False checks the seams only, for parts that
    have been verified. `is_from_rest` and `is_to_rest` False take no samples before the start and
    after the end, for a motion that starts or ends with speed.
    """
    checks = _Checks(trajectory, robot)
    for motion in {id(part): part for _, part, _ in _passes(checks.trajectory)}.values():
        for part in {id(part): part for part in motion.parts if has_parts}.values():
            checks.include(verify(part, robot))
    for times_s in _blocks(checks.trajectory):
        from_s = -math.inf if is_from_rest else 0.0
        to_s = math.inf if is_to_rest else checks.trajectory.duration_s
        if (inside_s := times_s[(times_s >= from_s) & (times_s <= to_s)]).size > 2:
            checks.check_uniform(inside_s)
    for times_s, step_s in _one_sided_steps(checks.trajectory):
        checks.check_one_sided(times_s, step_s)
    return checks.verdict()


class _Checks:
    """The limits of the joints, and the largest shares of them found so far."""

    def __init__(self, trajectory: Trajectory, robot: Robot) -> None:
        self.servos = _servos(trajectory.joints, robot)
        joints = [robot.joints[name] for name in trajectory.joints]
        joints += [servo for mechanism in self.servos for servo in mechanism.servos]
        self.names = tuple(joint.name for joint in joints)
        self.trajectory = _shortened(trajectory)
        self.low_deg = np.array([joint.position_min_deg for joint in joints])
        self.high_deg = np.array([joint.position_max_deg for joint in joints])
        self.speed_deg_s = np.array([joint.speed_max_deg_s for joint in joints])
        self.accel_deg_s2 = np.array([joint.accel_max_deg_s2 for joint in joints])
        self.jerk_deg_s3 = np.full(len(joints), math.inf)
        for part in trajectory.smoothing:
            if part.jerk_max_deg_s3 > 0.0:
                column = trajectory.joints.index(part.joint)
                self.jerk_deg_s3[column] = part.jerk_max_deg_s3
        self.speed, self.accel, self.jerk = _Worst(), _Worst(), _Worst()
        self.samples = 0

    def include(self, found: Verification) -> None:
        """Merge the result of a part of the trajectory."""
        self.samples += found.samples
        names = self.names
        for worst, ratio, joint, at_s in (
            (self.speed, found.speed_ratio, found.speed_joint, found.speed_at_s),
            (self.accel, found.accel_ratio, found.accel_joint, found.accel_at_s),
            (self.jerk, found.jerk_ratio, found.jerk_joint, found.jerk_at_s),
        ):
            worst.keep(ratio, names.index(joint), at_s)

    def check_uniform(self, times_s: FloatArray) -> None:
        """Check samples at equal steps: of a legal motion, no mean over a step exceeds a limit."""
        moves = np.diff(self._sampled(times_s), axis=0)
        step_s = float(times_s[1] - times_s[0])
        bends = np.diff(moves, axis=0)
        noise_deg = self._noise_deg(times_s)
        if np.isfinite(self.jerk_deg_s3).any():
            self.jerk.update(
                np.abs(np.diff(bends, axis=0)),
                times_s,
                8.0 * noise_deg,
                self.jerk_deg_s3 * step_s**3,
            )
        self._compare(
            np.abs(moves, out=moves), np.abs(bends, out=bends), times_s, step_s, noise_deg
        )

    def check_one_sided(self, times_s: FloatArray, steps_s: FloatArray) -> None:
        """Check three equal steps into each polynomial from its ends, a step apart."""
        near, middle, far = (self._sampled(times_s + count * steps_s) for count in (0.0, 1.0, 2.0))
        width_s = np.abs(steps_s)[:, None]
        noise_deg = self._noise_deg(times_s)
        moves, bends = np.abs(middle - near), np.abs(far - 2.0 * middle + near)
        # Divided by their own steps, because steps differ; the remaining step is 1 s.
        moves, bends = (moves - noise_deg) / width_s, (bends - 4.0 * noise_deg) / width_s**2
        self._compare(moves, bends, times_s, 1.0, np.zeros(len(noise_deg)))

    def _compare(
        self,
        moves: FloatArray,
        bends: FloatArray,
        times_s: FloatArray,
        step_s: float,
        noise_deg: FloatArray,
    ) -> None:
        self.speed.update(moves, times_s, noise_deg, self.speed_deg_s * step_s)
        self.accel.update(bends, times_s, 4.0 * noise_deg, self.accel_deg_s2 * step_s**2)

    def verdict(self) -> Verification:
        for worst, limits, what, unit in (
            (self.speed, self.speed_deg_s, "speed", "deg/s"),
            (self.accel, self.accel_deg_s2, "acceleration", "deg/s²"),
            (self.jerk, self.jerk_deg_s3, "jerk", "deg/s³"),
        ):
            if worst.ratio > EXCESS_MAX_RATIO:
                limit = float(limits[worst.column])
                joint, owner = self._owner(worst.column, worst.at_s)
                raise PlanningError(
                    f"{owner} would reach {what} {worst.ratio * limit:.6g} {unit} "
                    f"at {worst.at_s:.3f} s, allowed {limit:g} {unit}",
                    joint=joint,
                    time_s=worst.at_s,
                )
        names = self.names
        return Verification(
            samples=self.samples,
            speed_ratio=self.speed.ratio,
            speed_joint=names[self.speed.column],
            speed_at_s=self.speed.at_s,
            accel_ratio=self.accel.ratio,
            accel_joint=names[self.accel.column],
            accel_at_s=self.accel.at_s,
            jerk_ratio=self.jerk.ratio,
            jerk_joint=names[self.jerk.column],
            jerk_at_s=self.jerk.at_s,
        )

    def _sampled(self, times_s: FloatArray) -> FloatArray:
        deg = self.trajectory.sample(times_s)
        if self.servos:
            deg = np.concatenate([deg, *(one.angles(deg) for one in self.servos)], axis=1)
        self.samples += len(times_s)
        low_deg, high_deg = self.low_deg - RANGE_SLACK_DEG, self.high_deg + RANGE_SLACK_DEG
        # With NaN both comparisons are false, so that NaN counts as outside.
        is_within = extreme(np.minimum, deg) >= low_deg
        is_within &= extreme(np.maximum, deg) <= high_deg
        if not is_within.all():
            is_inside = (deg >= low_deg) & (deg <= high_deg)
            row, column = divmod(int(np.argmin(is_inside)), deg.shape[1])
            at_s = float(times_s[row])
            joint, owner = self._owner(column, at_s)
            raise PlanningError(
                f"{owner} would be at {deg[row, column]:.3f} deg at {at_s:.3f} s, allowed "
                f"{self.low_deg[column]:g} to {self.high_deg[column]:g} deg",
                joint=joint,
                time_s=at_s,
            )
        return deg

    def _owner(self, column: int, at_s: float) -> tuple[str, str]:
        """Return a joint, and what has the limit of a column: it, or a servo at its place."""
        names = self.trajectory.joints
        if column < len(names):
            return names[column], f"joint {names[column]!r}"
        here = dict(zip(names, self.trajectory.sample(np.array([at_s]))[0].tolist(), strict=True))
        for one in self.servos:
            if self.names[column] in one.mechanism.servos:
                place = ", ".join(f"{name} {here[name]:.1f}" for name in one.mechanism.joints)
                label = one.mechanism.servo_label(self.names[column])
                return one.mechanism.joints[0], f"{label}, at {place} deg,"
        raise AssertionError("every further column is a servo of a mechanism")

    def _noise_deg(self, times_s: FloatArray) -> FloatArray:
        """Return the largest error of a difference of angles by rounding of times and angles."""
        latest_s = max(1.0, float(np.abs(times_s).max()))
        reach_deg = np.maximum(np.abs(self.low_deg), np.abs(self.high_deg))
        noise_deg = np.asarray(ROUNDING * (latest_s * self.speed_deg_s + reach_deg))
        for one in self.servos:  # They get the errors of their joints, too.
            first = self.names.index(one.mechanism.servos[0])
            noise_deg[first : first + len(one.servos)] += one.gain @ noise_deg[one.columns]
        return noise_deg


class _ServoAngles(Struct, frozen=True):
    """The servos of a mechanism, which follow from some columns of joints by angles alone."""

    mechanism: Mechanism
    servos: tuple[Joint, ...]
    columns: list[int]
    gain: FloatArray
    """The largest |g'| over the ranges, (servos, joints)."""

    def angles(self, joint_deg: FloatArray) -> FloatArray:
        return self.mechanism.transmission.servo_deg(joint_deg[:, self.columns])


def _servos(joints: Sequence[str], robot: Robot) -> list[_ServoAngles]:
    """Return the servos behind the mechanisms of these joints.

    Raises `PlanningError` where the trajectory moves only some joints of one: then nothing says
    where its servos are.
    """
    if not robot.servos:
        return []
    from lss_motion.robot.mechanisms import places_of

    found = []
    for mechanism in robot.mechanisms.values():
        moved = [name for name in mechanism.joints if name in joints]
        if moved and len(moved) < len(mechanism.joints):
            raise PlanningError(
                f"joint {moved[0]!r} moves without the other joints of mechanism "
                f"{mechanism.name!r}, {', '.join(mechanism.joints)}; they have the same servos",
                joint=moved[0],
            )
        if moved:
            own = [robot.joints[name] for name in mechanism.joints]
            gain = np.abs(mechanism.transmission.slopes(places_of(own))).max(axis=0)
            columns = [joints.index(name) for name in mechanism.joints]
            servos = tuple(robot.servos[name] for name in mechanism.servos)
            found.append(_ServoAngles(mechanism, servos, columns, gain))
    return found


def extreme(of: np.ufunc, samples: FloatArray) -> FloatArray:
    """Return the `np.maximum` or `np.minimum` of each column of `samples`, (n, joints).

    NaN in a column gives NaN. Rows are laid side by side first, because numpy takes a tenth of the
    time along long rows (measured).
    """
    count = len(samples) // SIDE_BY_SIDE * SIDE_BY_SIDE
    found = [samples[count:]]
    if count:
        rows = of.reduce(samples[:count].reshape(-1, SIDE_BY_SIDE * samples.shape[1]), axis=0)
        found.append(rows.reshape(SIDE_BY_SIDE, -1))
    return np.asarray(of.reduce(np.concatenate(found), axis=0))


def _shortened(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory with the fewest passes that contain every pass and kind of seam."""
    if trajectory.loop is None or trajectory.loop > PASSES_MAX:
        return replace(trajectory, loop=PASSES_MAX)
    return trajectory


def _passes(trajectory: Trajectory) -> Iterator[tuple[float, Pass, bool]]:
    """Yield start, motion and whether it is new, for every pass."""
    seen: list[Pass] = []
    for index in range(trajectory.loop or 1):
        motion = trajectory.motion_of(index)
        is_new = not any(motion is earlier for earlier in seen)
        yield trajectory.pass_start_s(index), motion, is_new
        seen.append(motion)


def _blocks(trajectory: Trajectory) -> Iterator[FloatArray]:
    """Yield blocks of instants at equal steps; they overlap by two, so that none is left out."""
    for from_s, to_s in _sampled_spans(trajectory):
        count = math.ceil((to_s - from_s + 2.0 * SEAM_S) / SAMPLE_S)
        for first in range(0, count, BLOCK):
            steps = np.arange(first, min(first + BLOCK, count) + 2, dtype=np.float64)
            yield from_s - SEAM_S + SAMPLE_S * steps


def _sampled_spans(trajectory: Trajectory) -> Iterator[tuple[float, float]]:
    """Yield the spans to sample: new passes, and the seams between passes and between parts."""
    for start_s, motion, is_new in _passes(trajectory):
        if is_new and not motion.parts:
            yield start_s, start_s + motion.duration_s
            continue
        yield start_s, start_s
        if is_new:
            for seam_s in motion.seams_s.tolist():
                yield start_s + seam_s, start_s + seam_s
    if not (trajectory.is_periodic and trajectory.last is trajectory.middle):
        # Else it has no end: tracks that flow from pass to pass for ever.
        yield trajectory.duration_s, trajectory.duration_s


def _one_sided_steps(trajectory: Trajectory) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield instants just inside both ends of every polynomial, and the steps into it."""
    for start_s, motion, is_new in _passes(trajectory):
        if not is_new or motion.parts:
            continue
        knots_s = motion.knots_s
        steps_s = np.minimum(SIDE_STEP_S, np.diff(knots_s) / 4.0)
        is_long = steps_s > SIDE_STEP_MIN_S
        steps_s = steps_s[is_long]
        # Slightly inside, because the knot itself may belong to the next polynomial.
        starts_s = knots_s[:-1][is_long] + 0.01 * steps_s
        ends_s = knots_s[1:][is_long] - 0.01 * steps_s
        times_s, both_s = np.append(starts_s, ends_s), np.append(steps_s, -steps_s)
        for first in range(0, len(times_s), BLOCK):
            block = slice(first, first + BLOCK)
            yield start_s + times_s[block], both_s[block]
