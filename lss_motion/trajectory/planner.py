"""The entry point: `plan` makes a verified trajectory of a sequence, or loads it from the cache.

The cache holds verified plans on disk, found by content. The name of an entry is a hash of
everything that the plan depends on (keys, times and limits), so that an entry never fits another
sequence or robot. Each entry holds a plan that has passed the verifier, and a hash of itself: what
is loaded equals what was verified, to the bit, and is not verified again.

The modules that make plans are imported only when a plan is made.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.sequence.keyframes import at_speed
from lss_motion.sequence.model import Timing
from lss_motion.trajectory.cues import planned_cues
from lss_motion.trajectory.model import (
    Mark,
    PathClock,
    PathMotion,
    SlowSpan,
    Trajectory,
    motions_of,
    with_looped_span,
)
from lss_motion.trajectory.path import Path as JointPath

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence


PLANNER_VERSION: Final = 3
"""Part of every name. Raise it whenever the plan of an unchanged sequence changes."""

DIRECTORY_VARIABLE: Final = "LSS_MOTION_CACHE_DIR"
"""Environment variable with the folder of the cache."""

BYTES_MAX: Final = 128 * 1024 * 1024
"""The oldest entries are removed beyond this size. Chosen: some fifty long shows."""

PIECES_MIN: Final = 64
"""Plans with fewer polynomials and clock pieces are not stored: they are made as fast as loaded."""

SUFFIX: Final = ".plan.npz"

_DIGEST_BYTES: Final = 32
"""Length of the SHA-256 hash before the content."""

_PARTS: Final = ("first", "middle", "last")
_PATH: Final = ("knots_s", "coefficients")
_CLOCK: Final = ("times_s", "path_s", "rates", "rate_slopes")


def plan(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the motion of `robot` that comes closest to `sequence` within all limits.

    The result has passed `verify`. Raises `InputError` for a sequence that does not fit this robot,
    and `PlanningError` where no motion fulfils it: a missed anchor, a duration that is too short,
    a spline that leaves a joint's range.
    """
    _check_limits(robot)
    trajectory = _planned(at_speed(sequence), robot)
    return replace(trajectory, on_fault=sequence.on_fault) if sequence.on_fault else trajectory


def _check_limits(robot: Robot) -> None:
    """Raise `InputError` where a limit is a setting of the servo that has not been read."""
    for joint in robot.unread:
        raise InputError(
            f"joint {joint.name!r}: its robot file leaves {' and '.join(sorted(joint.unread))} to "
            f"the servo, whose settings are not known. `lss-play` reads them; offline give "
            f"--robot-cache FILE, written by `lss-motion configure ROBOT --backup FILE`",
            path=robot.path,
        )


def _planned(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of a sequence to which `at_speed` was applied."""
    bare = replace(sequence, layers=(), events=())
    trajectory = base = _planned_base(bare, robot)
    if sequence.layers:
        from lss_motion.trajectory.layers import layered

        trajectory = layered(base, replace(sequence, events=()), robot, _planned)
        slower = trajectory.first.duration_s / max(base.first.duration_s, 1e-9)
        cues = [replace(cue, at_s=slower * cue.at_s) for cue in base.cues]
        for layer in sequence.layers:
            own = planned_cues(replace(layer.sequence, path=sequence.path), trajectory)
            cues += [replace(cue, at_s=layer.from_s + cue.at_s) for cue in own]
        trajectory = replace(trajectory, cues=tuple(cues))
    if sequence.events:
        cues = [*trajectory.cues, *planned_cues(sequence, trajectory)]
        trajectory = replace(trajectory, cues=tuple(cues))
    return trajectory


def _planned_base(sequence: Sequence, robot: Robot) -> Trajectory:
    if not sequence.play and not sequence.tracks:
        return _planned_track(sequence, robot)
    from lss_motion.trajectory.verify import verify

    if sequence.play:
        from lss_motion.trajectory.playlist import planned_play_list

        trajectory = planned_play_list(sequence, robot, _planned)
    else:
        if sequence.loop != 1 and not sequence.keyframes:
            raise InputError(
                "there is nothing to loop outside of the tracks; give each track its own loop",
                path=sequence.path,
            )
        from lss_motion.trajectory.tracks import planned_tracks

        own = [replace(sequence, tracks=())] if sequence.keyframes else []
        trajectory = planned_tracks(sequence, [*own, *sequence.tracks], robot, _planned_track)
    verify(trajectory, robot, has_parts=False)  # The parts have passed it already.
    return trajectory


def _planned_track(track: Sequence, robot: Robot) -> Trajectory:
    if track.tracks or track.layers or track.play:
        raise InputError("a track holds keyframes and nothing else", path=track.path)
    if track.loop_span_s is not None:
        from lss_motion.trajectory.verify import verify

        whole = _planned_track(replace(track, loop=1, loop_span_s=None), robot)
        trajectory = with_looped_span(track, whole)
        verify(trajectory, robot, has_parts=False)
        return trajectory
    ratio = track.speed_ratio
    trajectory = _keyframes(replace(track, speed_ratio=1.0), robot)
    if track.timing is Timing.FASTEST and ratio < 1.0:
        from lss_motion.trajectory.retime import at_ratio

        return at_ratio(trajectory, ratio)
    return trajectory


def _keyframes(track: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of the keyframes alone, made or from the cache."""

    def make() -> Trajectory:
        from lss_motion.trajectory.tracks import planned_track

        return planned_track(track, robot)

    return cached(cache_name(track, robot), make)


def cache_directory() -> Path:
    """Return the folder of the plans: `LSS_MOTION_CACHE_DIR`, else the user's cache folder."""
    if chosen := os.environ.get(DIRECTORY_VARIABLE):
        return Path(chosen)
    import platformdirs

    return Path(platformdirs.user_cache_dir("lss_motion", appauthor=False)) / "plans"


def cache_name(sequence: Sequence, robot: Robot) -> str:
    """Return the name of an entry: a hash of keys, times and limits."""
    digest = hashlib.sha256(repr(PLANNER_VERSION).encode())
    digest.update(
        repr(
            (
                sequence.name,
                str(sequence.timing),
                sequence.fit_duration_s,
                sequence.loop,
                [
                    (
                        joint.name,
                        joint.position_min_deg,
                        joint.position_max_deg,
                        joint.speed_max_deg_s,
                        joint.accel_max_deg_s2,
                    )
                    for joint in robot.joints.values()
                ],
            )
        ).encode()
    )
    for frame in sequence.keyframes:
        digest.update(
            repr(
                (
                    frame.at_s,
                    frame.hold_s,
                    frame.is_anchor,
                    str(frame.ease),
                    frame.label,
                    [(name, float(angle_deg)) for name, angle_deg in frame.deg.items()],
                )
            ).encode()
        )
    return digest.hexdigest()


def cached(name: str, make: Callable[[], Trajectory]) -> Trajectory:
    """Return the plan stored under `name`, else that of `make`, which must have been verified.

    A damaged entry is replaced. A cache that cannot be written is no error; the plan is then not
    stored.
    """
    path = cache_directory() / f"{name}{SUFFIX}"
    trajectory = _load(path)
    if trajectory is None:
        trajectory = make()
        motions = {id(part): part for part in motions_of(trajectory)}.values()
        if sum(len(m.path.knots_s) + len(m.clock.rates) for m in motions) >= PIECES_MIN:
            _store(path, trajectory)
    return trajectory


def _load(path: Path) -> Trajectory | None:
    try:
        whole = path.read_bytes()
    except OSError:
        return None
    digest, content = whole[:_DIGEST_BYTES], whole[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        facts: dict[str, Any] = json.loads(stored["facts"].tobytes())
        motions = [
            PathMotion(
                path=JointPath(**{key: stored[f"{number}.{key}"] for key in _PATH}),
                clock=PathClock(**{key: stored[f"{number}.{key}"] for key in _CLOCK}),
            )
            for number in range(max(facts["parts"]) + 1)
        ]
    parts = (motions[number] for number in facts["parts"])
    return Trajectory(
        name=facts["name"],
        joints=tuple(facts["joints"]),
        **dict(zip(_PARTS, parts, strict=True)),
        loop=facts["loop"],
        is_periodic=facts["is_periodic"],
        stretched=tuple(SlowSpan(**stretch) for stretch in facts["stretched"]),
        marks=tuple(Mark(**mark) for mark in facts["marks"]),
    )


def _store(path: Path, trajectory: Trajectory) -> None:
    motions: list[PathMotion] = []
    numbers = []
    for motion in motions_of(trajectory):
        if not any(motion is earlier for earlier in motions):
            motions.append(motion)
        numbers.append(next(n for n, earlier in enumerate(motions) if motion is earlier))
    facts = {
        "parts": numbers,
        "name": trajectory.name,
        "joints": trajectory.joints,
        "loop": trajectory.loop,
        "is_periodic": trajectory.is_periodic,
        "stretched": [asdict(stretch) for stretch in trajectory.stretched],
        "marks": [asdict(mark) for mark in trajectory.marks],
    }
    arrays = {"facts": np.frombuffer(json.dumps(facts).encode(), dtype=np.uint8)}
    for number, motion in enumerate(motions):
        arrays |= {f"{number}.{key}": getattr(motion.path, key) for key in _PATH}
        arrays |= {f"{number}.{key}": getattr(motion.clock, key) for key in _CLOCK}
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
            part.write(hashlib.sha256(content.getbuffer()).digest())
            part.write(content.getbuffer())
        # Renamed when complete, so that another process never reads a part of an entry.
        Path(part.name).replace(path)
        _trim(path.parent)
    except OSError:
        return


def _trim(folder: Path) -> None:
    """Remove the oldest entries beyond `BYTES_MAX`."""
    entries = sorted(
        ((entry.stat(), entry) for entry in folder.glob(f"*{SUFFIX}")),
        key=lambda pair: pair[0].st_mtime_ns,
        reverse=True,
    )
    total = 0
    for status, entry in entries:
        total += status.st_size
        if total > BYTES_MAX:
            entry.unlink(missing_ok=True)
