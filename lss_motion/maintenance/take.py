"""A take: poses and sections recorded by hand, and the sequence that they make.

`Take` collects readings while a person moves the joints. `sequence_of` turns them into keyframes;
each section becomes a smooth recording at even times first (`cleaned`, `at_rest`, `within`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.interchange.importing import imported
from lss_motion.interchange.reader import Channel, ForeignMotion, Measure
from lss_motion.show.model import Interpolation, Keyframe, Sequence
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from lss_motion.interchange.reduce import KeyFit
    from lss_motion.playing.hands_mapping import JointReading
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]


STEP_S: Final = 0.01
"""Recordings are kept at 100 Hz, faster than any hand moves; all joints share these times."""

WINDOW_S: Final = 0.1
"""The motion of a hand is the centre of a parabola through the readings of this time. Chosen: a
hand's motion ends at 10 Hz, and at 50 readings a second this averages five of them."""

OUTLIER_DEG: Final = 0.7
"""A reading this far from the line between its neighbours, and further than a hand could bend it
(`HAND_DEG_S2`), was damaged on the line: replies carry no checksum. Chosen: above the noise."""

HAND_DEG_S2: Final = 4000.0
"""The largest acceleration of a joint by a hand. Assumed: a shake of 20 deg at 3 Hz."""

AVERAGED_S: Final = 0.02
"""Readings within this time are averaged. Chosen: a hand moves a joint evenly for longer."""

OUTLIER_ROUNDS: Final = 10
"""Of adjacent damaged readings, each round removes one."""


SOFT_DEG: Final = 2.0
"""Over this range a motion beyond a limit is bent back: at 90 deg/s this takes 1000 deg/s²."""

TRIFLE_DEG: Final = 0.5
"""A motion less far beyond a limit is noise and is clipped."""

STANDING_DEG_S: Final = 5.0
"""A slower joint stands still: the noise of readings is 2 deg/s over `WINDOW_S`."""

POSE_LEAST_S: Final = 0.5
"""The shortest motion between two poses. Chosen: what a person expects."""

BRAKING_RATIO: Final = 0.5
"""A section that ends in motion is braked at this share of the joint's limit. Chosen."""

JOIN_HOLD_S: Final = 0.1
"""The robot rests for so long where a section meets another part. Chosen."""

RECORDED_MAX_S: Final = 3600.0
"""An hour: 20 joints at 50 Hz give 3.6 million readings, the limit of an imported file."""


@dataclass(slots=True)
class RecordedSection:
    """The readings of a span of time, by joint; `start_ns` is its beginning."""

    start_ns: int
    times_s: dict[str, list[float]]
    angles_deg: dict[str, list[float]]

    @property
    def duration_s(self) -> float:
        return max((times[-1] for times in self.times_s.values() if times), default=0.0)


Pose = dict[str, float]


@dataclass(slots=True)
class Take:
    """Poses and recorded sections in the order of recording, as they were read."""

    joints: tuple[str, ...]
    parts: list[Pose | RecordedSection] = field(default_factory=list)
    running: RecordedSection | None = None

    def start(self, now_ns: int) -> None:
        """Record from now on."""
        names = self.joints
        self.running = RecordedSection(now_ns, {n: [] for n in names}, {n: [] for n in names})

    def finish(self) -> None:
        """Stop recording; a section without any reading is dropped."""
        if self.running is not None and any(self.running.times_s.values()):
            self.parts.append(self.running)
        self.running = None

    def add(self, readings: Iterable[JointReading]) -> None:
        """Take readings; they are dropped unless a section is being recorded."""
        section = self.running
        if section is None:
            return
        for reading in readings:
            at_s = s_from_ns(reading.at_ns - section.start_ns)
            times_s = section.times_s[reading.joint]
            if at_s >= 0.0 and (not times_s or at_s > times_s[-1]):
                times_s.append(at_s)
                section.angles_deg[reading.joint].append(reading.deg)
        if section.duration_s > RECORDED_MAX_S:
            self.finish()

    def drop(self, angles_deg: Mapping[str, float]) -> None:
        """Record the present angles of the joints as a pose."""
        self.parts.append({name: round(angles_deg[name], 1) for name in self.joints})

    def undo(self) -> bool:
        """Remove the last part; return whether there was one."""
        if self.running is not None:
            self.running = None
            return True
        return bool(self.parts) and self.parts.pop() is not None

    @property
    def recorded_s(self) -> float:
        running_s = 0.0 if self.running is None else self.running.duration_s
        return running_s + sum(p.duration_s for p in self.parts if isinstance(p, RecordedSection))


class TakeResult(Struct, frozen=True, kw_only=True):
    """A take as a sequence, comments for its file, and how well each section was reduced."""

    sequence: Sequence
    comments: tuple[str, ...]
    fits: tuple[KeyFit, ...]


def sequence_of(
    take: Take,
    robot: Robot,
    name: str,
    *,
    tolerance_deg: float,
    ease: Interpolation = Interpolation.SPLINE,
) -> TakeResult:
    """Return the sequence of a take with at least one part, in the order of recording.

    Sections keep their times. A motion to or between poses takes as long as the robot needs at its
    `approach_speed_deg_s`. Angles beyond the range of a joint are cut off, which a comment states.
    """
    assert take.parts, "an empty take"
    builder = _SequenceBuilder(robot, name, tolerance_deg, ease)
    for number, part in enumerate(take.parts, start=1):
        if isinstance(part, RecordedSection):
            builder.add_section(part)
        else:
            builder.add_pose(part, f"pose {number}")
    return builder.result()


@dataclass(slots=True)
class _SequenceBuilder:
    """Appends poses and sections to a list of keyframes."""

    robot: Robot
    name: str
    tolerance_deg: float
    ease: Interpolation
    keyframes: list[Keyframe] = field(default_factory=list)
    here_deg: dict[str, float] = field(default_factory=dict)
    end_s: float = 0.0
    excess_deg: dict[str, float] = field(default_factory=dict)
    noise_deg: float = 0.0
    lead_in_s: float = 0.0
    lead_out_s: float = 0.0
    notes: list[str] = field(default_factory=list)
    fits: list[KeyFit] = field(default_factory=list)

    def add_pose(self, pose: Pose, label: str) -> None:
        angles_deg = {
            n: round(self._within(n, np.array([deg])).item(), 4) for n, deg in pose.items()
        }
        at_s = self._next_start_s(angles_deg)
        self.keyframes.append(
            Keyframe(at_s=at_s, deg=angles_deg, label=label, ease=Interpolation.SMOOTH)
        )
        self._arrived(at_s, angles_deg)

    def add_section(self, section: RecordedSection) -> None:
        channels: list[Channel] = []
        lead_in_s = 0.0
        for name, times_s in section.times_s.items():
            if not times_s:
                continue
            joint = self.robot.joints[name]
            clean = cleaned(np.array(times_s), np.array(section.angles_deg[name]))
            self.noise_deg = max(self.noise_deg, clean.noise_deg)
            even = at_rest(clean.times_s, clean.angles_deg, BRAKING_RATIO * joint.accel_max_deg_s2)
            self.lead_out_s = max(self.lead_out_s, float(even[0][-1] - clean.times_s[-1]))
            lead_in_s = min(lead_in_s, float(even[0][0]))
            values = np.round(self._within(name, even[1]), 4)
            channels.append(Channel(name=name, unit=Measure.DEG, times_s=even[0], values=values))
        self.lead_in_s = max(self.lead_in_s, -lead_in_s)
        channels = [replace(c, times_s=np.round(c.times_s - lead_in_s, 6)) for c in channels]
        motion = ForeignMotion(
            path=Path(self.name),
            name=self.name,
            channels=tuple(channels),
            notes={},
            is_recording=True,
        )
        made = imported(
            motion, self.robot, tolerance_deg=self.tolerance_deg, ease=self.ease, is_unwrapped=True
        )
        self.notes += made.comments
        if made.fit is not None:
            self.fits.append(made.fit)
        first_deg: dict[str, float] = {}
        for keyframe in made.sequence.keyframes:
            first_deg = {**keyframe.deg, **first_deg}
        start_s = self._next_start_s(first_deg)
        own = [
            replace(keyframe, at_s=round(start_s + (keyframe.at_s or 0.0), 6))
            for keyframe in made.sequence.keyframes
        ]
        if self.keyframes:  # The robot comes from another pose, and rests before it starts.
            rest = Keyframe(at_s=round(start_s - JOIN_HOLD_S, 6), deg=first_deg, hold_s=JOIN_HOLD_S)
            self.keyframes.append(rest)
            own = [keyframe for keyframe in own if keyframe.at_s != start_s]
        self.keyframes += own
        last_deg = {**first_deg, **{n: d for k in own for n, d in k.deg.items()}}
        self._arrived(self.keyframes[-1].at_s or 0.0, last_deg)

    def _next_start_s(self, to_deg: Mapping[str, float]) -> float:
        """Return when the next part can begin; the part before ends with a rest."""
        if not self.keyframes:
            return 0.0
        self.keyframes[-1] = replace(self.keyframes[-1], hold_s=JOIN_HOLD_S)
        way_s = max(
            abs(deg - self.here_deg.get(name, deg))
            / self.robot.approach_deg_s(self.robot.joints[name])
            for name, deg in to_deg.items()
        )
        return round(self.end_s + 2 * JOIN_HOLD_S + max(way_s, POSE_LEAST_S), 2)

    def _arrived(self, at_s: float, angles_deg: Mapping[str, float]) -> None:
        self.end_s = at_s
        self.here_deg.update(angles_deg)

    def _within(self, name: str, angles_deg: np.ndarray) -> np.ndarray:
        joint = self.robot.joints[name]
        kept = within(angles_deg, joint.position_min_deg, joint.position_max_deg)
        low, high = float(angles_deg.min()), float(angles_deg.max())
        excess_deg = max(joint.position_min_deg - low, high - joint.position_max_deg)
        if excess_deg > 0.0:
            self.excess_deg[name] = max(self.excess_deg.get(name, 0.0), excess_deg)
        return kept

    def result(self) -> TakeResult:
        return TakeResult(
            sequence=Sequence(
                name=self.name, keyframes=tuple(self.keyframes), robot_path=self.robot.path
            ),
            comments=tuple(self._comments()),
            fits=tuple(self.fits),
        )

    def _comments(self) -> Iterator[str]:
        yield f"Shown by hand on {self.robot.name}."
        if self.fits:
            yield f"Noise of the readings removed: {self.noise_deg:.2f} deg RMS at most."
        if self.lead_in_s > 0.0:
            yield f"The recording begins in motion; {self.lead_in_s:.2f} s are added before it."
        if self.lead_out_s > 0.0:
            yield f"The recording ends in motion; it is braked in {self.lead_out_s:.2f} s more."
        for name, excess_deg in self.excess_deg.items():
            yield f"Joint {name} was up to {excess_deg:.1f} deg beyond its range; cut off there."
        yield from dict.fromkeys(self.notes)


class Clean(Struct, frozen=True):
    """Angles at even times from the first reading on; `noise_deg` is the RMS that was removed."""

    times_s: FloatArray
    angles_deg: FloatArray
    noise_deg: float


def cleaned(times_s: FloatArray, angles_deg: FloatArray) -> Clean:
    """Return a recording without damaged readings and noise. Times increase; at least one."""
    for _ in range(OUTLIER_ROUNDS):
        is_outlier = _outliers(times_s, angles_deg)
        if not is_outlier.any():
            break
        times_s, angles_deg = times_s[~is_outlier], angles_deg[~is_outlier]
    first, last = int(np.floor(times_s[0] / STEP_S)), int(np.ceil(times_s[-1] / STEP_S))
    even_s = np.round(STEP_S * np.arange(first, last + 1), 6)
    even_deg = _between(*_averaged(times_s, angles_deg), even_s)
    rate_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else STEP_S
    width = int(max(WINDOW_S, 5.0 * rate_s) / STEP_S) | 1
    if len(even_s) > width:
        from scipy.signal import savgol_filter

        even_deg = savgol_filter(even_deg, width, polyorder=2, mode="interp")
    noise_deg = float(np.sqrt(np.mean((np.interp(times_s, even_s, even_deg) - angles_deg) ** 2)))
    return Clean(even_s, even_deg, noise_deg)


def _averaged(times_s: FloatArray, angles_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return one reading for each `AVERAGED_S` that has any: closer ones only add noise."""
    bins = np.floor(times_s / AVERAGED_S).astype(np.intp)
    _, places, counts = np.unique(bins, return_inverse=True, return_counts=True)
    return np.bincount(places, times_s) / counts, np.bincount(places, angles_deg) / counts


def _between(times_s: FloatArray, angles_deg: FloatArray, at_s: FloatArray) -> FloatArray:
    """Return angles at any times: a curve that does not overshoot the readings around a gap."""
    if len(times_s) < 3:
        return np.interp(at_s, times_s, angles_deg)
    from scipy.interpolate import PchipInterpolator

    inside_s = np.clip(at_s, times_s[0], times_s[-1])
    return np.asarray(PchipInterpolator(times_s, angles_deg)(inside_s), dtype=np.float64)


def _outliers(times_s: FloatArray, angles_deg: FloatArray) -> NDArray[np.bool_]:
    """Return the readings that no hand could have made; of neighbours, only the worst.

    A damaged reading makes its neighbours look wrong too, but by fewer degrees: they are a part of
    its own way off the line. How far each may be off depends on the gaps beside it, so that share
    does not show which of them is damaged.
    """
    if len(times_s) < 4:
        return np.zeros(len(times_s), dtype=np.bool_)
    off_deg, bend_deg = np.zeros(len(times_s)), np.zeros(len(times_s))
    before_s, after_s = np.diff(times_s)[:-1], np.diff(times_s)[1:]
    share = before_s / (before_s + after_s)
    expected = angles_deg[:-2] + share * (angles_deg[2:] - angles_deg[:-2])
    bend_deg[1:-1] = OUTLIER_DEG + 0.5 * HAND_DEG_S2 * before_s * after_s
    off_deg[1:-1] = np.abs(angles_deg[1:-1] - expected)
    # The ends, from the line through the two readings next to them.
    for end, near, far in ((0, 1, 2), (-1, -2, -3)):
        near_s, far_s = abs(times_s[end] - times_s[near]), abs(times_s[end] - times_s[far])
        slope = (angles_deg[near] - angles_deg[far]) / (far_s - near_s)
        bend_deg[end] = OUTLIER_DEG + 0.5 * HAND_DEG_S2 * near_s * far_s
        off_deg[end] = abs(angles_deg[end] - angles_deg[near] - slope * near_s)
    off_deg[off_deg <= bend_deg] = 0.0
    # If the reading next to an end is damaged, then the one behind it looks wrong as well.
    for end, far in ((0, 2), (-1, -3)):
        if off_deg[far]:
            off_deg[end] = 0.0
    is_off = off_deg > 0.0
    first, second, share = off_deg[:-1], off_deg[1:], off_deg / bend_deg
    is_second_worse = np.where(
        np.abs(first - second) > OUTLIER_DEG, second > first, share[1:] > share[:-1]
    )
    is_off[1:] &= is_second_worse
    is_off[:-1] &= ~is_second_worse
    return is_off


def at_rest(
    times_s: FloatArray, angles_deg: FloatArray, braking_deg_s2: float
) -> tuple[FloatArray, FloatArray]:
    """Return even samples, extended where a joint moves at the start or at the end.

    The extension accelerates the joint from rest before the start, at times below the first, and
    brakes it after the end.
    """
    if len(times_s) < 3:
        return times_s, angles_deg
    after_s, after_deg = _braked(float(angles_deg[-1]), float(angles_deg[-3]), braking_deg_s2)
    before_s, before_deg = _braked(float(angles_deg[0]), float(angles_deg[2]), braking_deg_s2)
    return (
        np.round(np.concatenate([times_s[0] - before_s[::-1], times_s, times_s[-1] + after_s]), 6),
        np.concatenate([before_deg[::-1], angles_deg, after_deg]),
    )


def _braked(
    end_deg: float, before_deg: float, braking_deg_s2: float
) -> tuple[FloatArray, FloatArray]:
    """Return times after an end, and angles, of a joint that brakes to rest."""
    speed_deg_s = (end_deg - before_deg) / (2.0 * STEP_S)
    if abs(speed_deg_s) < STANDING_DEG_S:
        return np.empty(0), np.empty(0)
    braking_s = abs(speed_deg_s) / braking_deg_s2
    after_s = STEP_S * np.arange(1.0, np.ceil(braking_s / STEP_S) + 1.0)
    until_s = np.minimum(after_s, braking_s)
    return after_s, end_deg + speed_deg_s * until_s * (1.0 - 0.5 * until_s / braking_s)


def within(angles_deg: FloatArray, low_deg: float, high_deg: float) -> FloatArray:
    """Return angles in a range; a motion far beyond it is bent back without a corner."""
    soft_deg = min(SOFT_DEG, 0.1 * (high_deg - low_deg))
    if angles_deg.max() > high_deg + TRIFLE_DEG:
        angles_deg = high_deg - soft_deg * np.logaddexp(0.0, (high_deg - angles_deg) / soft_deg)
    if angles_deg.min() < low_deg - TRIFLE_DEG:
        angles_deg = low_deg + soft_deg * np.logaddexp(0.0, (angles_deg - low_deg) / soft_deg)
    return np.clip(angles_deg, low_deg, high_deg)
