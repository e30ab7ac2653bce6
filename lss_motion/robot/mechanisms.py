"""The mechanisms of a robot file: transmissions of the entries, and what is wrong with them.

`robot.load` builds joints and servos; here is what stands between them.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import counted, known_names
from lss_motion.robot.mechanism import Mechanism
from lss_motion.robot.transmission import (
    POINTS_MIN,
    SLOPE_MIN,
    SMOOTH_POINTS_MIN,
    FourBar,
    Grid,
    Linear,
    LinkageCurve,
    smoothed,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.robot.file import JointEntry, MechanismEntry
    from lss_motion.robot.linkage_file import LinkageEntry
    from lss_motion.robot.model import Joint, Robot

    FloatArray = NDArray[np.float64]
    Note = Callable[[tuple[str, ...], str], None]
    """Notes a problem: the keys below the entry, and the reason."""

TABLE_POINTS_MIN: Final = 3
"""Two points are a ratio."""
GRID_POINTS_MIN: Final = 4
"""What a bicubic spline needs along each joint."""
GRID_JOINTS: Final = 2
TABLE_BYTES_MAX: Final = 1_000_000
"""Chosen: a hundred times a table that a person measures."""
COST_RATIO: Final = 0.5
"""A table is uneven if its bends take more than this share of the servo's acceleration, and a
smoothing within `NOISE_RATIO` makes it less than this share of that. Chosen."""
NOISE_RATIO: Final = 0.03
"""What a reading by eye may be off, as a share of the whole way of the servo. Chosen."""
OFFERS_DEG: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Values of smooth_deg that are tried for an offer."""
EDGE_DEG: Final = 1e-6
"""A table covers a range that is larger by less: rounding."""
TABLE_PLACES: Final = 33
"""Angles of a joint at which its limits are told. Chosen: three degrees apart in a quarter turn."""
LIMIT_PLACES: Final = 21
"""Places along each joint at which the largest slopes of a transmission are looked for."""


def joint_transmission(
    entry: JointEntry, range_deg: Sequence[float], note: Note
) -> tuple[Linear | LinkageCurve | None, tuple[tuple[float, float, float], ...]]:
    """Return the ratio or linkage of a joint (None: it is wrong), and the points it has moved."""
    if entry.linkage is None:
        return Linear(((float(entry.ratio or 1.0),),)), ()
    if entry.ratio is not None:
        note(("linkage",), "'ratio' and 'linkage' exclude each other; keep one")
        return None, ()
    linkage = entry.linkage
    if linkage.kind == "four_bar":
        return _four_bar(linkage, range_deg, note), ()
    return _table(linkage, range_deg, note)


_LENGTHS: Final = ("crank_mm", "rod_mm", "rocker_mm", "base_mm")
_OF_FOUR_BAR: Final = (*_LENGTHS, "offset_deg", "turns", "rod")
_OF_TABLE: Final = ("joint_deg", "servo_deg", "smooth_deg")


def _has_only(linkage: LinkageEntry, needed: Iterable[str], others: Iterable[str], n: Note) -> bool:
    """Return whether the linkage has all keys of its kind and none of the other."""
    missing = [key for key in needed if getattr(linkage, key) is None]
    wrong = [key for key in others if getattr(linkage, key) is not None]
    for key in missing:
        n(("linkage",), f"{key!r} is missing; a linkage of kind {linkage.kind} needs it")
    for key in wrong:
        n(("linkage", key), f"{key!r} has no meaning in a linkage of kind {linkage.kind}")
    return not missing and not wrong


def _four_bar(linkage: LinkageEntry, range_deg: Sequence[float], note: Note) -> LinkageCurve | None:
    if not _has_only(linkage, _LENGTHS, _OF_TABLE, note):
        return None
    bar = FourBar(
        crank_mm=linkage.crank_mm or 0.0,
        rod_mm=linkage.rod_mm or 0.0,
        rocker_mm=linkage.rocker_mm or 0.0,
        base_mm=linkage.base_mm or 0.0,
        offset_deg=linkage.offset_deg or 0.0,
        is_away=linkage.turns == "away",
        is_crossed=linkage.rod == "crossed",
    )
    try:
        return bar.curve(range_deg[0], range_deg[1])
    except ValueError as error:
        note(
            ("linkage",),
            f"the four-bar {error} of the joint, within range_deg {range_deg[0]:g} to "
            f"{range_deg[1]:g}; check the lengths, offset_deg, turns and rod, or reduce range_deg",
        )
        return None


def _table(
    linkage: LinkageEntry, range_deg: Sequence[float], note: Note
) -> tuple[LinkageCurve | None, tuple[tuple[float, float, float], ...]]:
    if not _has_only(linkage, ("joint_deg", "servo_deg"), _OF_FOUR_BAR, note):
        return None, ()
    joint_deg, servo_deg = linkage.joint_deg or [], linkage.servo_deg or []
    problems = list(_table_problems(joint_deg, servo_deg, range_deg))
    for key, reason in problems:
        note(("linkage", key), reason)
    if problems:
        return None, ()
    used = tuple(map(float, servo_deg))
    moved: tuple[tuple[float, float, float], ...] = ()
    if linkage.smooth_deg is not None:
        if len(joint_deg) < SMOOTH_POINTS_MIN:
            reason = f"smooth_deg needs {SMOOTH_POINTS_MIN} points or more; measure more"
            note(("linkage", "smooth_deg"), reason)
            return None, ()
        used = smoothed(joint_deg, servo_deg, linkage.smooth_deg)
        moved = tuple(zip(map(float, joint_deg), map(float, servo_deg), used, strict=True))
    curve = LinkageCurve(tuple(map(float, joint_deg)), used)
    if (turn_deg := curve.turn_deg()) is not None:
        note(("linkage", "servo_deg"), _turn_text(joint_deg, servo_deg, turn_deg))
        return None, ()
    return curve, moved


def _turn_text(joint_deg: Sequence[float], servo_deg: Sequence[float], turn_deg: float) -> str:
    before = max((x for x in joint_deg if x <= turn_deg), default=joint_deg[0])
    after = min((x for x in joint_deg if x > turn_deg), default=joint_deg[-1])
    reason = (
        f"the smooth curve through the points turns or is flat at joint angle {turn_deg:.1f} deg, "
        f"between the points {before:g} and {after:g}: their steps are too uneven. Measure another "
        f"point there"
    )
    if (offer := _offer(joint_deg, servo_deg, math.inf, 1.0)) is not None:
        reason += f", or allow the curve to miss the points: `smooth_deg: {offer[0]:g}`"
    return reason


def _table_problems(
    joint_deg: Sequence[float], servo_deg: Sequence[float], range_deg: Sequence[float]
) -> Iterator[tuple[str, str]]:
    if len(joint_deg) != len(servo_deg):
        yield (
            "servo_deg",
            f"servo_deg has {counted(servo_deg, 'angle')} and joint_deg has {len(joint_deg)}; "
            f"each point needs both",
        )
        return
    if len(joint_deg) < TABLE_POINTS_MIN:
        yield (
            "joint_deg",
            f"a table needs {TABLE_POINTS_MIN} points or more, and has {len(joint_deg)}; for two, "
            f"give `ratio`",
        )
        return
    for before, after in itertools.pairwise(joint_deg):
        if after <= before:
            yield "joint_deg", f"joint_deg must rise, but {after:g} follows {before:g}"
            return
    sign = 1.0 if servo_deg[-1] > servo_deg[0] else -1.0
    for (before, after), at_deg in zip(itertools.pairwise(servo_deg), joint_deg, strict=False):
        if sign * (after - before) <= 0.0:
            yield (
                "servo_deg",
                f"servo_deg must rise or fall all the way, but turns at joint angle {at_deg:g} "
                f"deg, where {after:g} follows {before:g}; beyond a dead point a servo angle has "
                f"two joint angles: reduce range_deg and leave out the points",
            )
            return
    yield from _cover_problems(range_deg, joint_deg, "joint_deg")


def _cover_problems(
    range_deg: Sequence[float], points_deg: Sequence[float], key: str, what: str = "the table"
) -> Iterator[tuple[str, str]]:
    if range_deg[0] < points_deg[0] - EDGE_DEG or range_deg[1] > points_deg[-1] + EDGE_DEG:
        yield (
            key,
            f"{what} goes from {points_deg[0]:g} to {points_deg[-1]:g} deg and must cover "
            f"range_deg, {range_deg[0]:g} to {range_deg[1]:g}; measure more, or reduce range_deg",
        )


def _offer(
    joint_deg: Sequence[float], servo_deg: Sequence[float], most: float, speed_deg_s: float
) -> tuple[float, float] | None:
    """Return the least smooth_deg whose bends need at most `most` acceleration, and how much."""
    if len(joint_deg) < SMOOTH_POINTS_MIN:
        return None
    span_deg = abs(servo_deg[-1] - servo_deg[0])
    for smooth_deg in (offer for offer in OFFERS_DEG if offer <= NOISE_RATIO * span_deg):
        curve = LinkageCurve(tuple(joint_deg), smoothed(joint_deg, servo_deg, smooth_deg))
        if curve.turn_deg() is not None:
            continue
        needed = curve.steepest(joint_deg[0], joint_deg[-1])[1] * speed_deg_s**2
        if needed <= most:
            return smooth_deg, needed
    return None


def unevenness(mechanism: Mechanism, joint: Joint, servo: Joint) -> str:
    """Return how much of the servo's acceleration noise in a table takes; empty: little."""
    curve = mechanism.transmission
    if not isinstance(curve, LinkageCurve) or len(curve.joint_points_deg) >= POINTS_MIN:
        return ""
    slope, bend, at_deg = curve.steepest(joint.position_min_deg, joint.position_max_deg)
    speed = min(joint.speed_max_deg_s, servo.speed_max_deg_s / slope)
    needed, allowed = bend * speed**2, servo.accel_max_deg_s2
    if needed <= COST_RATIO * allowed:
        return ""
    points = curve.joint_points_deg, curve.servo_points_deg
    offer = _offer(*points, COST_RATIO * needed, speed)
    if mechanism.moved_deg or offer is None:
        return ""
    return (
        f"{mechanism.name}: at joint angle {at_deg:.1f} deg the slope of the linkage changes by "
        f"{bend:.2g} per degree; at {speed:.0f} deg/s of the joint that alone takes "
        f"{needed:.0f} deg/s² of the servo, which has {allowed:.0f}, so the joint is slower "
        f"there. `smooth_deg: {offer[0]:g}` would make it {offer[1]:.0f} deg/s²"
    )


def require_measurable(robot: Robot, name: str) -> None:
    """Raise `InputError` unless one servo moves the joint, behind nothing or behind a table."""
    if name not in robot.joints:
        raise InputError(f"unknown joint {name!r}; {known_names(name, robot.joints)}")
    mechanism = next((one for one in robot.mechanisms.values() if name in one.joints), None)
    if mechanism is None:
        return
    if mechanism.servos != (name,):
        reason = f"is moved by mechanism {mechanism.name!r}, which is no table of one joint"
    elif mechanism.kind == "ratio":
        reason = "has a ratio; remove it to measure a table"
    elif len(getattr(mechanism.transmission, "joint_points_deg", ())) >= POINTS_MIN:
        reason = "has a four-bar, of which lengths are measured; remove it to measure a table"
    else:
        return
    raise InputError(f"joint {name!r} {reason}", path=robot.path)


class TableReport(Struct, frozen=True):
    """What is to be known of measured points: how smooth they are, and what is wrong with them."""

    lines: tuple[str, ...]
    problems: tuple[str, ...]


def table_report(name: str, points: Sequence[tuple[float, float]], robot: Robot) -> TableReport:
    """Return what measured points, joint and servo angles, are as the linkage of a joint."""
    joint_deg = tuple(joint for joint, _ in points)
    servo_deg = tuple(servo for _, servo in points)
    if not points:
        return TableReport((), ("nothing was measured",))
    lines = []
    for (low, from_deg), (high, to_deg) in itertools.pairwise(points):
        slope = (to_deg - from_deg) / (high - low)
        lines.append(
            f"{name} {low:zg} to {high:zg} deg: servo {from_deg:z.1f} to {to_deg:z.1f}, "
            f"{slope:.2f} deg for 1 deg"
        )
    ends = joint_deg[0], joint_deg[-1]
    problems = [reason for _, reason in _table_problems(joint_deg, servo_deg, ends)]
    if problems:
        return TableReport(tuple(lines), tuple(problems))
    curve = LinkageCurve(joint_deg, servo_deg)
    if (turn_deg := curve.turn_deg()) is not None:
        problems.append(_turn_text(joint_deg, servo_deg, turn_deg))
        return TableReport(tuple(lines), tuple(problems))
    mechanism = Mechanism(
        name=name, kind="linkage", joints=(name,), servos=(name,), transmission=curve
    )
    joint = replace(robot.joints[name], position_min_deg=ends[0], position_max_deg=ends[1])
    lines.append(f"{name}: {transmission_text(mechanism, {name: joint})}")
    uneven = unevenness(mechanism, joint, robot.servo_robot.joints[name])
    lines.append(f"warning: {uneven}" if uneven else "the table is smooth")
    return TableReport(tuple(lines), ())


def transmission_text(mechanism: Mechanism, joints: Mapping[str, Joint]) -> str:
    """Return what a mechanism is, and how far and fast its servos go for its joints."""
    own = [joints[name] for name in mechanism.joints]
    slopes = np.abs(mechanism.transmission.slopes(places_of(own)))
    least, most = slopes.min(axis=0), slopes.max(axis=0)
    parts = []
    for row, servo in enumerate(mechanism.servos):
        for column, joint in enumerate(own):
            low, high = float(least[row, column]), float(most[row, column])
            size = f"{low:.3g}" if high - low < EDGE_DEG else f"{low:.3g} to {high:.3g}"
            speed = high * joint.speed_max_deg_s
            parts.append(
                f"{size} deg of {'its servo' if servo == joint.name else servo} for 1 deg of "
                f"{joint.name} ({joint.speed_max_deg_s:g} deg/s takes up to {speed:.0f})"
            )
    return f"{mechanism.kind}, " + "; ".join(parts)


def mechanism_transmission(
    entry: MechanismEntry, joints: Sequence[Joint], folder: Path, note: Note
) -> Linear | Grid | None:
    """Return the transmission of a mechanism; None: it is wrong, and noted."""
    used = {"differential": "matrix", "pair": "ratio", "table": "file"}
    for kind, key in used.items():
        if entry.kind != kind and getattr(entry, key) is not None:
            note((key,), f"{key!r} has no meaning in a mechanism of kind {entry.kind}; remove it")
            return None
    if entry.kind == "pair":
        return _pair(entry, note)
    if entry.kind == "differential":
        return _differential(entry, note)
    return _grid(entry, joints, folder, note)


def _pair(entry: MechanismEntry, note: Note) -> Linear | None:
    if len(entry.servos) < 2:
        note(("servos",), "a pair needs two servos or more; give a single servo to the joint")
        return None
    return Linear(tuple((float(entry.ratio or 1.0),) for _ in entry.servos))


def _differential(entry: MechanismEntry, note: Note) -> Linear | None:
    joints, servos = entry.joints or [], entry.servos
    if entry.matrix is None:
        note(("matrix",), "'matrix' is missing; it has a row for each servo")
        return None
    shape = f"{counted(servos, 'row')} of {counted(joints, 'number')}"
    if len(entry.matrix) != len(servos) or any(len(row) != len(joints) for row in entry.matrix):
        note(
            ("matrix",), f"matrix must have {shape}: a row for each servo, a column for each joint"
        )
        return None
    if len(servos) < len(joints):
        note(
            ("servos",),
            f"{counted(servos, 'servo')} cannot move {counted(joints, 'joint')}; give a servo for "
            f"each joint",
        )
        return None
    matrix = np.array(entry.matrix, dtype=np.float64)
    weakest = float(np.linalg.svd(matrix, compute_uv=False)[-1])
    if weakest < SLOPE_MIN:
        note(
            ("matrix",),
            "matrix is singular: there is a motion of the joints that turns no servo, so the "
            "servos cannot make it. Check its signs: the rows of a differential differ in one",
        )
        return None
    return Linear(tuple(map(tuple, matrix.tolist())))


def _grid(entry: MechanismEntry, joints: Sequence[Joint], folder: Path, note: Note) -> Grid | None:
    if entry.file is None:
        note(("file",), "'file' is missing; a table of two joints stands in a CSV file")
        return None
    if len(joints) != GRID_JOINTS:
        note(("joints",), "a table of a mechanism has two joints; for one, give it a `linkage`")
        return None
    if len(entry.servos) < len(joints):
        note(("servos",), "a table of two joints needs two servos or more")
        return None
    file = PurePosixPath(entry.file.replace("\\", "/"))
    if file.is_absolute() or ".." in file.parts or ":" in entry.file:
        reason = f"file {entry.file!r} must be a path below the folder of the robot file"
        note(("file",), reason)
        return None
    names = [joint.name for joint in joints]
    try:
        grid = read_grid(folder / file, names, list(entry.servos))
    except InputError as error:
        note(("file",), str(error))
        return None
    problems = [
        reason
        for joint, points in zip(joints, (grid.first_deg, grid.second_deg), strict=True)
        for _, reason in _cover_problems(
            (joint.position_min_deg, joint.position_max_deg), points, "file", f"{joint.name} in it"
        )
    ]
    if not problems and (turn := grid.turn_deg()) is not None:
        place = ", ".join(f"{n} {deg:.1f}" for n, deg in zip(names, turn, strict=True))
        problems.append(
            f"the surface through the points of {entry.file} turns or is flat at {place} deg: "
            f"there the servos have two places for one pair of joint angles. Reduce range_deg, or "
            f"measure again there"
        )
    for reason in problems:
        note(("file",), reason)
    return None if problems else grid


def read_grid(path: Path, joints: Sequence[str], servos: Sequence[str]) -> Grid:
    """Return the measured grid of a CSV file; raise `InputError` with its line."""
    from lss_motion.files.source import read_text

    rows = list(csv.reader(io.StringIO(read_text(path, TABLE_BYTES_MAX))))
    header = [name.strip() for name in rows[0]] if rows else []
    wanted = [f"{name}_deg" for name in (*joints, *servos)]
    for name in wanted:
        if header.count(name) != 1:
            known = known_names(name, header) if header else "the file is empty"
            raise InputError(f"needs one column {name!r}; {known}", path=path, line=1)
    columns = [header.index(name) for name in wanted]
    measured: dict[tuple[float, float], tuple[float, ...]] = {}
    for line, row in enumerate(rows[1:], 2):
        if not "".join(row).strip():
            continue
        try:
            values = [float(row[column]) for column in columns]
        except (ValueError, IndexError):
            values = [math.nan]
        if not np.isfinite(values).all():
            raise InputError(f"must hold {counted(wanted, 'number')}", path=path, line=line)
        place = values[0], values[1]
        if place in measured:
            reason = f"measures {place[0]:g}, {place[1]:g} a second time; keep one"
            raise InputError(reason, path=path, line=line)
        measured[place] = tuple(values[GRID_JOINTS:])
    return _gridded(measured, path, joints, len(servos))


def _gridded(
    measured: Mapping[tuple[float, float], tuple[float, ...]],
    path: Path,
    joints: Sequence[str],
    servos: int,
) -> Grid:
    axes = [sorted({place[axis] for place in measured}) for axis in range(GRID_JOINTS)]
    for name, axis in zip(joints, axes, strict=True):
        if len(axis) < GRID_POINTS_MIN:
            raise InputError(
                f"has {counted(axis, 'angle')} of {name}; a smooth surface needs "
                f"{GRID_POINTS_MIN} or more",
                path=path,
            )
    missing = [place for place in itertools.product(*axes) if place not in measured]
    if missing:
        shown = ", ".join(f"{deg:g}" for deg in missing[0])
        raise InputError(
            f"lacks {counted(missing, 'place')} of the grid, such as {shown}: every angle of "
            f"{joints[0]} must stand beside every angle of {joints[1]}",
            path=path,
        )
    tables = tuple(
        tuple(tuple(measured[a, b][servo] for b in axes[1]) for a in axes[0])
        for servo in range(servos)
    )
    return Grid(tuple(axes[0]), tuple(axes[1]), tables)


def places_of(joints: Sequence[Joint], count: int = LIMIT_PLACES) -> FloatArray:
    """Return places all over the ranges of joints, corners included, (n, joints)."""
    axes = [np.linspace(j.position_min_deg, j.position_max_deg, count) for j in joints]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def limits_along(robot: Robot, name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return angles over the range of a joint, with the speed and acceleration it may have there.

    They are those of the joint, or less where a servo behind it allows less; of joints that share
    servos, while the others stand, wherever they do.
    """
    joint = robot.joints[name]
    mechanism = next((one for one in robot.mechanisms.values() if name in one.joints), None)
    is_even = mechanism is None or mechanism.is_scaled
    count = 2 if is_even else TABLE_PLACES
    deg = np.linspace(joint.position_min_deg, joint.position_max_deg, count)
    speed = np.full(count, float(joint.speed_max_deg_s))
    accel = np.full(count, float(joint.accel_max_deg_s2))
    if mechanism is None or is_even:
        return deg, speed, accel
    column = mechanism.joints.index(name)
    others = [robot.joints[one] for one in mechanism.joints if one != name]
    rest = places_of(others) if others else np.zeros((1, 0))
    places = np.insert(np.tile(rest, (count, 1)), column, np.repeat(deg, len(rest)), axis=1)
    gain = np.abs(mechanism.transmission.slopes(places)[:, :, column]).reshape(count, -1)
    gain = np.maximum(gain, SLOPE_MIN)
    servos = [robot.servos[one] for one in mechanism.servos]
    for limits, of in (
        (speed, [servo.speed_max_deg_s for servo in servos]),
        (accel, [servo.accel_max_deg_s2 for servo in servos]),
    ):
        allowed = np.tile(of, gain.shape[1] // len(servos)) / gain
        np.minimum(limits, allowed.min(axis=1), out=limits)
    return deg, speed, accel


def reach_deg(mechanism: Mechanism, joints: Sequence[Joint]) -> list[tuple[float, float]]:
    """Return least and largest angle of each ideal servo over the ranges of the joints."""
    servo_deg = mechanism.transmission.servo_deg(places_of(joints))
    return list(zip(servo_deg.min(axis=0).tolist(), servo_deg.max(axis=0).tolist(), strict=True))


def needed_limits(mechanism: Mechanism, joints: Sequence[Joint]) -> list[tuple[float, float]]:
    """Return the speed and acceleration that each servo needs at most: all joints at theirs."""
    places = places_of(joints)
    speed = np.array([joint.speed_max_deg_s for joint in joints])
    accel = np.array([joint.accel_max_deg_s2 for joint in joints])
    slopes = np.abs(mechanism.transmission.slopes(places))
    bends = np.zeros((len(places), len(mechanism.servos)))
    for signs in itertools.product((1.0, -1.0), repeat=len(joints)):
        first = np.broadcast_to(speed * np.array(signs), places.shape)
        bends = np.maximum(bends, np.abs(mechanism.transmission.bends(places, first)))
    speeds = (slopes @ speed).max(axis=0)
    accels = (slopes @ accel + bends).max(axis=0)
    return list(zip(speeds.tolist(), accels.tolist(), strict=True))


def careful_servo(mechanism: Mechanism, robot: Robot) -> Joint:
    """Return the only servo of a joint with limits that keep those of the joint everywhere."""
    joint, servo = robot.joints[mechanism.joints[0]], robot.servos[mechanism.servos[0]]
    places, g = places_of([joint]), mechanism.transmission
    slope = float(np.abs(g.slopes(places)).min())
    bend = float(np.abs(g.bends(places, np.full(places.shape, joint.speed_max_deg_s))).max())
    accel = slope * joint.accel_max_deg_s2
    # What the bends of a linkage take of the acceleration may be half of it.
    share = min(1.0, math.sqrt(0.5 * accel / bend)) if bend else 1.0
    ((low, high),) = reach_deg(mechanism, [joint])
    return replace(
        servo,
        position_min_deg=max(servo.position_min_deg, low),
        position_max_deg=min(servo.position_max_deg, high),
        speed_max_deg_s=min(servo.speed_max_deg_s, share * slope * joint.speed_max_deg_s),
        accel_max_deg_s2=min(servo.accel_max_deg_s2, accel - bend * share**2),
    )


def scaled_joint(mechanism: Mechanism, joint: Joint, servos: Iterable[Joint]) -> Joint:
    """Return the joint of fixed ratios with the limits that its servos leave it."""
    slopes = np.abs(mechanism.transmission.slopes(np.zeros((1, 1))))[0, :, 0].tolist()
    speed, accel = joint.speed_max_deg_s, joint.accel_max_deg_s2
    for slope, servo in zip(slopes, servos, strict=True):
        speed = min(speed, servo.speed_max_deg_s / slope)
        accel = min(accel, servo.accel_max_deg_s2 / slope)
    return replace(joint, speed_max_deg_s=speed, accel_max_deg_s2=accel)


def joint_shares(mechanism: Mechanism, joints: Sequence[Joint]) -> list[list[float]]:
    """Return by how much each joint is off for each degree of each servo, at most, by joint."""
    slopes = mechanism.transmission.slopes(places_of(joints))
    found: list[list[float]] = np.abs(np.linalg.pinv(slopes)).max(axis=0).tolist()
    return found


def tolerance_ratio(mechanism: Mechanism, joints: Sequence[Joint]) -> float:
    """Return how far servos may be off for each degree that the joints may, all at once."""
    slopes = mechanism.transmission.slopes(places_of(joints))
    shares = np.abs(np.linalg.pinv(slopes)).sum(axis=2)
    return float(1.0 / shares.max())


def tolerances_deg(mechanism: Mechanism, joints: Sequence[Joint]) -> list[tuple[float, float]]:
    """Return how far each servo may be off for each joint to stay in its path and goal tolerance.

    In the middle of the ranges; the share of a servo in the error of a joint is that of the
    inverse. Servos side by side all have to follow the joint.
    """
    middle = np.array([[0.5 * (j.position_min_deg + j.position_max_deg) for j in joints]])
    slopes = mechanism.transmission.slopes(middle)[0]
    inverse = np.abs(1.0 / slopes.T if len(joints) == 1 else np.linalg.pinv(slopes))
    path = np.array([[joint.following_deg] for joint in joints])
    goal = np.array([[joint.goal_deg] for joint in joints])
    with np.errstate(divide="ignore"):
        both = (path / inverse).min(axis=0), (goal / inverse).min(axis=0)
    return list(zip(both[0].tolist(), both[1].tolist(), strict=True))
