"""What a plan, a program and a robot amount to, as text for people.

`check` prints all of it; `plan`, `import` and `record` print `plan_lines`; `compile` and
`lss-play --dry-run` print `program_lines`.
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError, install_command
from lss_motion.files.texts import counted
from lss_motion.robot.model import NO_SERVO
from lss_motion.show.functions import call_lines
from lss_motion.system.clock_leg import RATE_BAND
from lss_motion.units import SPEED_RATIO_MAX

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.interchange.reduce import KeyFit
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.shows import Show
    from lss_motion.planning.trajectory.eases import EaseAdvice
    from lss_motion.planning.trajectory.model import (
        Mark,
        MissedKey,
        Smoothing,
        Trajectory,
    )
    from lss_motion.robot.model import Joint, Robot


SAMPLE_S: Final = 0.001
"""The largest values are found by sampling at 1 kHz, as the verifier does."""

BLOCK_SAMPLES: Final = 8192
"""Samples are taken in blocks, so that a long show needs no more memory than a short one."""

HOLD_SLACK_S: Final = 1e-5
"""Holds that are shorter by less are not listed: a hundredth of a millisecond."""

LATE_MIN_S: Final = 0.001
"""Keyframes that are late by less are on time: the finest that a command can express."""

KEY_ERROR_DEG: Final = 0.005
"""Keys of a smoothed motion that are this close are met: far below the unit of a servo."""

WORST_COUNT: Final = 10
"""Slow spans and late keyframes that are listed. Chosen: both fit on a screen."""

MISSED_COUNT: Final = 3
"""Missed keys of a joint that are listed. Chosen: with all joints they fit on a screen."""

FULL_RATIO: Final = 0.995
"""From this share on, a limit counts as fully used: planning leaves about a thousandth free."""


class LimitUse(Struct, frozen=True):
    """The largest speed and acceleration of a joint, and their times."""

    joint: Joint
    speed_deg_s: float
    speed_at_s: float
    accel_deg_s2: float
    accel_at_s: float

    @property
    def speed_ratio(self) -> float:
        return self.speed_deg_s / self.joint.speed_max_deg_s

    @property
    def accel_ratio(self) -> float:
        return self.accel_deg_s2 / self.joint.accel_max_deg_s2

    @property
    def faster_ratio(self) -> float:
        """The factor by which the joint could be faster; acceleration grows with its square."""
        return 1.0 / max(self.speed_ratio, math.sqrt(self.accel_ratio), 1e-9)


def plan_lines(trajectory: Trajectory, robot: Robot, *, is_whole: bool = False) -> list[str]:
    """Return the length of the plan, what was slowed and why, and the use of each limit.

    `is_whole`: all slow spans and late keyframes, not only the worst ten.
    """
    length = "forever" if trajectory.loop is None else f"{trajectory.duration_s:.3f} s"
    passes = "" if trajectory.loop == 1 else f", one pass {trajectory.middle.duration_s:.3f} s"
    lines = [f"{trajectory.name}: {length}{passes}, {counted(trajectory.joints, 'joint')} moved"]
    lines += [
        *_slow_lines(trajectory, is_whole=is_whole),
        *_late_lines(trajectory, is_whole=is_whole),
    ]
    lines += _given_up_lines(trajectory, is_whole=is_whole)
    lines += [f"shorter: {hold_text(mark)}" for mark in shortened_holds(trajectory)]
    lines += _rest_lines(trajectory, is_whole=is_whole)
    lines += _beyond_lines(trajectory, is_whole=is_whole)
    lines += _smooth_lines(trajectory, is_whole=is_whole)
    uses = limit_uses(trajectory, robot)
    width = max(len(name) for name in (*trajectory.joints, "joint"))
    lines.append(f"{'joint':{width}}  fastest deg/s (limit)   hardest deg/s² (limit)")
    for use in uses:
        lines.append(
            f"{use.joint.name:{width}}  {use.speed_deg_s:7.1f} ({use.joint.speed_max_deg_s:g}) "
            f"{use.speed_ratio:6.0%}   {use.accel_deg_s2:7.1f} "
            f"({use.joint.accel_max_deg_s2:g}) {use.accel_ratio:6.0%}"
        )
    return [*lines, *_margin_lines(trajectory, uses), *_figure_lines(trajectory, robot)]


def _figure_lines(trajectory: Trajectory, robot: Robot) -> list[str]:
    """Return which links touch, and what the plan asks of servos that carry known masses.

    A wrong URDF file is a line.
    """
    if robot.figure is None and robot.urdf is None:
        return []
    from lss_motion.planning.trajectory.torques import load_lines, plan_load
    from lss_motion.planning.trajectory.touches import touch_lines, touches

    lines = touch_lines(touches(trajectory, robot))
    try:
        load = plan_load(trajectory, robot)
    except InputError as error:
        return [f"warning: torques are not known: {error}"]
    return [*lines, *([] if load is None else load_lines(load))]


def _slow_lines(trajectory: Trajectory, *, is_whole: bool) -> list[str]:
    """Return how many spans are slowed, by how much and by which joint, then the worst."""
    spans = sorted(trajectory.stretched, key=lambda span: -span.by_s)
    if not spans:
        return []
    by_s: dict[str, float] = {}
    for span in spans:
        by_s[span.joint] = by_s.get(span.joint, 0.0) + span.by_s
    joint = max(by_s, key=lambda name: by_s[name])
    total = f"{counted(spans, 'span')} slowed, "
    if (lost_s := sum(by_s.values())) < LATE_MIN_S:
        total += f"by less than {LATE_MIN_S:g} s in all"
    else:
        total += f"{lost_s:.3f} s in all, most by {joint!r} ({by_s[joint]:.3f} s)"
    texts = [f"slower: {span.text}" for span in spans]
    return [total, *_worst(texts, "more span", "slowed less", is_whole=is_whole)]


def _worst(texts: Sequence[str], one: str, less: str, *, is_whole: bool) -> list[str]:
    """Return the first texts, which are about the worst, and how many others there are."""
    shown = list(texts if is_whole else texts[:WORST_COUNT])
    rest = len(texts) - len(shown)
    more = f"and {counted(rest, one)} {less} (check --all lists them)"
    return [*shown, *([more] if rest else [])]


def _given_up_lines(trajectory: Trajectory, *, is_whole: bool) -> list[str]:
    """Return how much angle is given up to keep the time, the worst spans, and missed keys."""
    spans = sorted(trajectory.given_up, key=lambda span: -span.by_deg)
    if not spans:
        return []
    whole_s = sum(span.to_s - span.from_s for span in spans)
    lines = [
        f"angle given up to keep the time: {counted(spans, 'span')}, {whole_s:.3f} s in all, at "
        f"most {spans[0].by_deg:.1f} deg by {spans[0].joint!r}"
    ]
    texts = [f"less far: {span.text}" for span in spans]
    lines += _worst(texts, "more span", "less far off", is_whole=is_whole)
    for name in trajectory.joints:
        missed = [key for span in spans if span.joint == name for key in span.missed]
        if missed:
            lines += _missed_lines(name, missed, is_whole=is_whole)
    if any(span.missed for span in spans):
        lines.append("exact: true or a weight at a keyframe makes its joints get there")
    return lines


def _missed_lines(joint: str, missed: Sequence[MissedKey], *, is_whole: bool) -> Iterator[str]:
    """Yield the texts about keys at which a joint should turn or stay, on either side.

    A mouth that never closes must show beside openings that miss more degrees.
    """
    sides = {
        "does not get as high as": [key for key in missed if key.given_deg < key.asked_deg],
        "does not get as low as": [key for key in missed if key.given_deg >= key.asked_deg],
    }
    for what, keys in sides.items():
        if keys:
            yield f"not reached: joint {joint!r} {what} {_keys_text(keys, is_whole=is_whole)}"


def _keys_text(keys: Sequence[MissedKey], *, is_whole: bool) -> str:
    """Return how many keys are missed, and by how much, the worst first."""
    worst = sorted(keys, key=lambda key: -abs(key.given_deg - key.asked_deg))
    shown = worst if is_whole else worst[:MISSED_COUNT]
    texts = [
        f"{key.asked_deg:g} deg at {key.at_s:.3f} s"
        + (f" ({key.label})" if key.label else "")
        + f" becomes {key.given_deg:.1f}"
        for key in shown
    ]
    more = f", and {len(worst) - len(shown)} more" if len(worst) > len(shown) else ""
    return f"{counted(worst, 'turn')}: {', '.join(texts)}{more}"


def _late_lines(trajectory: Trajectory, *, is_whole: bool) -> list[str]:
    """Return how many keyframes are late, then the latest."""
    if not _has_times(trajectory):
        return ["the file gives no times"] if not trajectory.stretched else []
    found = late_marks(trajectory)
    if not found:
        return ["every keyframe is on time"]
    timed = [mark for mark in trajectory.marks if mark.authored_s is not None]
    lines = [f"{len(found)} of {counted(timed, 'keyframe')} late, at most {found[0][1]:.3f} s"]
    texts = [f"late: keyframe {mark_name(mark)} is {late_s:.3f} s late" for mark, late_s in found]
    return [*lines, *_worst(texts, "more keyframe", "less late", is_whole=is_whole)]


def _rest_lines(trajectory: Trajectory, *, is_whole: bool) -> list[str]:
    """Return which rests without a hold became shorter, those that lost most first."""
    texts = [
        f"shorter: the rest after keyframe {mark_name(mark)} lasts {mark.rested_s:.3f} s instead "
        f"of {mark.rest_s:g} s, because the motion is late; hold_s at that keyframe keeps a rest"
        for mark in shortened_rests(trajectory)
    ]
    return _worst(texts, "more rest", "shortened less", is_whole=is_whole)


def _beyond_lines(trajectory: Trajectory, *, is_whole: bool) -> list[str]:
    """Return which joints go beyond their keys by a slope that the author gives, most first."""
    found = [
        (deg, name, mark) for mark in trajectory.marks for name, deg in mark.beyond_deg.items()
    ]
    texts = [
        f"beyond: joint {name!r} goes {deg:.1f} deg beyond its keys around keyframe "
        f"{mark_name(mark)}, by its slope_deg_s"
        for deg, name, mark in sorted(found, key=lambda one: -one[0])
    ]
    return _worst(texts, "more key", "passed less far", is_whole=is_whole)


def smoothings(trajectory: Trajectory) -> list[Smoothing]:
    """Return how joints are smoothed, those of the parts of a play list too, the worst first."""
    found = list(trajectory.smoothing)
    if not found:
        parts = {id(part): part for part in trajectory.first.parts if part is not trajectory}
        found = [own for part in parts.values() for own in smoothings(part)]
    return sorted(found, key=lambda own: (-own.key_error_deg, -own.window_s))


def _smooth_lines(trajectory: Trajectory, *, is_whole: bool) -> list[str]:
    """Return what it costs that the acceleration does not jump: time, angle at and between keys."""
    every = smoothings(trajectory)
    joints = {own.joint for own in every if own.jerk_max_deg_s3 > 0.0}
    found = [own for own in every if own.joint in joints or own.key_error_deg > KEY_ERROR_DEG]
    if not joints:
        return []
    by_s = max(own.by_s for own in found)
    cost = f"{by_s:.3f} s longer than without" if by_s > LATE_MIN_S else "no longer than without"
    texts = [f"smooth: {smooth_text(own)}" for own in found]
    head = f"no jump of acceleration: {counted(joints, 'joint')}, {cost}"
    return [head, *_worst(texts, "more joint", "smooth", is_whole=is_whole)]


def smooth_text(own: Smoothing) -> str:
    """Return the text about one joint whose acceleration does not jump."""
    text = f"joint {own.joint!r}"
    if own.jerk_max_deg_s3 > 0.0:
        text += f", jerk at most {own.jerk_max_deg_s3:.0f} deg/s³"
    if own.window_s > 0.0:
        text += f", averaged over {own.window_s:.3f} s"
    if own.key_error_deg > KEY_ERROR_DEG:
        text += f", up to {own.key_error_deg:.2f} deg off a key"
    if own.away_deg is not None:
        text += f", between keys up to {own.away_deg:.1f} deg from the motion without"
    return text


def late_marks(trajectory: Trajectory) -> list[tuple[Mark, float]]:
    """Return the keyframes that are reached late and by how many seconds, the latest first."""
    from lss_motion.planning.trajectory.model import LoopedSpan

    after_s, skipped_s = math.inf, 0.0
    if isinstance(trajectory.middle, LoopedSpan) and trajectory.loop is not None:
        # Marks behind a looped span are planned after all passes, but authored after one.
        after_s = trajectory.first.duration_s
        skipped_s = (trajectory.loop - 1) * trajectory.middle.duration_s
    found = [
        (mark, mark.planned_s - mark.authored_s - (skipped_s if mark.planned_s > after_s else 0.0))
        for mark in trajectory.marks
        if mark.authored_s is not None
    ]
    late = [(mark, late_s) for mark, late_s in found if late_s > LATE_MIN_S]
    return sorted(late, key=lambda pair: -pair[1])


def limit_uses(trajectory: Trajectory, robot: Robot) -> list[LimitUse]:
    """Return the use of its limits by each joint, over the first pass and one more."""
    import numpy as np

    end_s = trajectory.first.duration_s
    if trajectory.loop != 1:
        end_s += trajectory.middle.duration_s
    steps = math.ceil(end_s / SAMPLE_S) + 1
    worst = np.zeros((2, len(trajectory.joints)))
    worst_at_s = np.zeros_like(worst)
    for first in range(0, steps, BLOCK_SAMPLES):
        times_s = np.minimum(np.arange(first, min(first + BLOCK_SAMPLES, steps)) * SAMPLE_S, end_s)
        for row, order in enumerate((1, 2)):
            sizes = np.abs(trajectory.sample(times_s, order))
            tops = sizes.max(axis=0)
            worst_at_s[row] = np.where(
                tops > worst[row], times_s[sizes.argmax(axis=0)], worst_at_s[row]
            )
            worst[row] = np.maximum(worst[row], tops)
    return [
        LimitUse(robot.joints[name], *(float(value) for value in values))
        for name, *values in zip(
            trajectory.joints, worst[0], worst_at_s[0], worst[1], worst_at_s[1], strict=True
        )
    ]


def _margin_lines(trajectory: Trajectory, uses: Sequence[LimitUse]) -> list[str]:
    """Return the joint that is nearest to a limit, and the possible gain in speed."""
    tightest = min(uses, key=lambda use: use.faster_ratio)
    if tightest.speed_ratio >= math.sqrt(tightest.accel_ratio):
        quantity, unit, at_s = "speed", "deg/s", tightest.speed_at_s
        value, allowed = tightest.speed_deg_s, tightest.joint.speed_max_deg_s
    else:
        quantity, unit, at_s = "acceleration", "deg/s²", tightest.accel_at_s
        value, allowed = tightest.accel_deg_s2, tightest.joint.accel_max_deg_s2
    if value == 0.0:
        return ["nothing moves"]
    lines = [
        f"tightest: joint {tightest.joint.name!r}, {quantity} {value:.0f} of {allowed:g} {unit} at "
        f"{at_s:.3f} s, {max(0.0, 1.0 - value / allowed):.0%} to spare"
    ]
    # Rounded down, so that the printed factor is possible.
    ratio = min(math.floor(100.0 * tightest.faster_ratio) / 100.0, SPEED_RATIO_MAX)
    is_fastest = any(mark.authored_s is None for mark in trajectory.marks)
    if value >= FULL_RATIO * allowed or ratio <= 1.0 or trajectory.given_up or is_fastest:
        cost = "give up more angle" if trajectory.given_up else "slow more of it down"
        return [*lines, f"the show runs as fast as it can; faster would {cost}"]
    pass_s = trajectory.middle.duration_s / ratio
    return [
        *lines,
        f"the show could run {ratio:.2f} times as fast, a pass in {pass_s:.3f} s, before anything "
        f"must be slowed (--speed {ratio:.2f})",
    ]


def shortened_holds(trajectory: Trajectory) -> list[Mark]:
    """Return the keyframes of the first pass that are held shorter than the file sets."""
    return [mark for mark in trajectory.marks if mark.hold_s - mark.held_s > HOLD_SLACK_S]


def shortened_rests(trajectory: Trajectory) -> list[Mark]:
    """Return the keyframes of the first pass behind which a rest becomes shorter, most first."""
    found = [mark for mark in trajectory.marks if mark.rest_s - mark.rested_s > HOLD_SLACK_S]
    return sorted(found, key=lambda mark: mark.rested_s - mark.rest_s)


def hold_text(mark: Mark) -> str:
    """Return the text about one hold that the plan shortens."""
    return (
        f"keyframe {mark_name(mark)} is held {mark.held_s:.3f} s instead of {mark.hold_s:g} s, "
        f"because the motion is late and its hold_may_shrink is true"
    )


def mark_name(mark: Mark) -> str:
    """Return label, authored time and place of a keyframe."""
    name = f"at {mark.authored_s:g} s" if mark.authored_s is not None else "without time"
    if mark.label:
        name = f"{mark.label!r} {name}"
    return f"{name} ({mark.place})" if mark.place else name


def _has_times(trajectory: Trajectory) -> bool:
    return any(mark.authored_s is not None for mark in trajectory.marks)


def program_lines(show: Show, *, is_whole: bool = False) -> list[str]:
    """Return the lines of `plan_lines`, the load of each bus, and the predicted accuracy."""
    lines = []
    if show.trajectory is not None:
        lines = plan_lines(show.trajectory, show.robot, is_whole=is_whole)
    if show.is_following:
        from lss_motion.planning.shows import HEADROOM_RATIO

        lines.append(
            f"planned with {100.0 * HEADROOM_RATIO:g} % headroom in speed and acceleration, so "
            f"that a leader may trim it by 0.5 % within the limits"
        )
    program = show.program
    for use in program.line_use.values():
        lines.append(
            f"bus {use.bus}: {counted(use.commands, 'command')}, {use.utilisation_ratio:.1%} of "
            f"{use.baud_bps} bps, {use.worst_100_ms_ratio:.0%} in the worst 100 ms, "
            f"{counted(use.overlaps, 'overlap')}, at most {use.late_max_us} us late"
        )
        if math.isfinite(use.reading_rate_hz):
            least_hz = show.robot.buses[use.bus].reading_rate_min_hz
            lines.append(
                f"bus {use.bus}: {1.0 - use.utilisation_ratio:.1%} free for queries; in the "
                f"worst second each joint can be read {use.reading_rate_hz:.1f} times "
                f"(at least {least_hz:g})"
            )
    lines += [*drive_lines(program), *call_lines(program.cues), *sound_lines(program)]
    servos = show.robot.servo_robot.joints
    bounds_deg = {n: e for n, e in program.bound_deg.items() if n not in _stepped(program)}
    if bounds_deg:
        name = max(bounds_deg, key=lambda joint: bounds_deg[joint])
        moves_deg = max(program.error_max_deg[joint] for joint in bounds_deg)
        lines.append(
            f"predicted horns stay within {bounds_deg[name]:.2f} deg of the plan ({name}), by "
            f"their moves alone within {moves_deg:.2f} (tolerance {program.tolerance_deg:g} deg)"
        )
    if show.robot.servos and bounds_deg:
        lines += _mechanism_errors(program, show.robot)
    lines += [
        f"falls behind: joint {name!r} by up to {bound_deg:.1f} deg, which is a fault "
        f"(following_deg {most_deg:g}): at its limit without a break, a servo makes up for "
        f"nothing; let it keep time (keep: time), or give its keys more time"
        for name, bound_deg in bounds_deg.items()
        if bound_deg > (most_deg := servos[name].following_deg)
    ]
    return lines


def joint_errors(servo_deg: Mapping[str, float], robot: Robot) -> dict[str, float]:
    """Return how far joints may be off if each servo may be off by so much, anywhere."""
    from lss_motion.robot.mechanisms import joint_shares

    found = {name: off for name, off in servo_deg.items() if name in robot.joints}
    for mechanism in robot.mechanisms.values():
        if {*mechanism.servos} <= servo_deg.keys():
            own = [servo_deg[servo] for servo in mechanism.servos]
            joints = [robot.joints[name] for name in mechanism.joints]
            for name, shares in zip(mechanism.joints, joint_shares(mechanism, joints), strict=True):
                found[name] = sum(s * off for s, off in zip(shares, own, strict=True))
    return {name: found[name] for name in robot.joints if name in found}


def _mechanism_errors(program: Program, robot: Robot) -> list[str]:
    """Return how far joints behind mechanisms may be off, and how far servos fight."""
    behind = {name for mechanism in robot.mechanisms.values() for name in mechanism.joints}
    bounds_deg = joint_errors(program.bound_deg, robot)
    own = ", ".join(f"{name} {deg:.2f}" for name, deg in bounds_deg.items() if name in behind)
    lines = [f"so joints behind mechanisms stay within (deg): {own}"] if own else []
    lines += [
        f"{name}: its servos are at most {deg:.2f} deg apart on the way, as they take up moves at "
        f"different instants"
        for name, deg in program.fight_deg.items()
    ]
    return lines


def _stepped(program: Program) -> set[str]:
    """Return the joints without a tolerance: they move in whole degrees."""
    return {name for name, driving in program.drives.items() if driving.drive == "stepped"}


def advice_of(show: Show) -> tuple[EaseAdvice, ...]:
    """Return where another ease would make the show less late; it plans again to find that."""
    if show.sequence is None:
        return ()
    from lss_motion.planning.trajectory.eases import ease_advice

    return ease_advice(show.sequence, show.robot)


def advice_lines(show: Show, *, is_whole: bool) -> list[str]:
    """Return the lines of `advice_of`; `is_whole`: with all keyframes, not only the first ten."""
    from lss_motion.planning.trajectory.eases import OTHER
    from lss_motion.planning.trajectory.keys import named

    lines = []
    for advice in advice_of(show):
        frames = advice.keyframes
        shown = frames if is_whole else frames[:WORST_COUNT]
        names = ", ".join(map(named, shown))
        rest = f" and {len(frames) - len(shown)} more (--all)" if len(frames) > len(shown) else ""
        place = f"{counted(frames, 'keyframe')} ({names}{rest})"
        late, would_be = advice.late, advice.would_be
        lines.append(
            f"{OTHER[advice.ease]} costs time in {advice.name!r}: its keyframes are "
            f"{late.total_s:.3f} s late in all, at most {late.most_s:.3f} s; with ease: "
            f"{advice.ease} at {'every keyframe' if advice.is_whole else place} it would be "
            f"{would_be.total_s:.3f} s, at most {would_be.most_s:.3f} s"
        )
    return lines


def drive_lines(program: Program) -> list[str]:
    """Return a line for every joint with another drive than the usual one: drive and reason."""
    lines = []
    for name in program.start_deg:
        driving = program.drives.get(name)
        if driving is None and name not in program.drive_reasons:
            continue
        how = "timed (D…T… in EM1)"
        if driving is not None and driving.drive == "streamed":
            how = f"streamed (bare D in EM0, FPC {driving.filter_count})"
        elif driving is not None:
            how = "stepped (whole degrees to an RC servo, no feedback)"
        error_deg = program.bound_deg.get(name)
        within = "" if error_deg is None else f", predicted within {error_deg:.2f} deg"
        why = program.drive_reasons.get(name, "set by the robot file").partition(": ")
        lines.append(f"joint {name}: {how}{within}; {why[2] or why[0]}")
    return lines


def robot_lines(robot: Robot) -> list[str]:
    """Return the buses of a robot and the limits of each joint; `servo`: read from the servo.

    Raises `InputError` if the URDF file of its figure is wrong.
    """
    from lss_motion.show.gait.kinematics import figure_of

    counts = [counted(robot.joints, "joint"), counted(robot.poses, "pose")]
    lines = [f"{robot.name}: {', '.join(counts)}, {counted(robot.buses, 'bus', 'buses')}"]
    lines += [f"bus {b.name}: {b.port} at {b.baud_bps} bps" for b in robot.buses.values()]
    width = max(len(name) for name in (*robot.joints, "joint"))
    lines.append(f"{'joint':{width}}   id  model          range deg        deg/s   deg/s²")
    lines += map(partial(_limits_line, width=width), robot.joints.values())
    if robot.servos:
        lines += mechanism_lines(robot)
    if (figure := figure_of(robot)) is not None:
        lines.append(f"figure: {counted(figure.links, 'link')}")
        lines += [f"  {note}" for note in figure.notes]
    return lines


def _limits_line(joint: Joint, width: int) -> str:
    """Return a row of the table of limits; `servo`: read from the servo."""
    reach = f"{joint.position_min_deg:.6g} to {joint.position_max_deg:.6g}"
    speed, accel = (
        "servo" if limit in joint.unread else f"{value:g}"
        for limit, value in (
            ("speed_max_deg_s", joint.speed_max_deg_s),
            ("accel_max_deg_s2", joint.accel_max_deg_s2),
        )
    )
    servo_id = "  -" if joint.servo_id == NO_SERVO else f"{joint.servo_id:3d}"
    return (
        f"{joint.name:{width}}  {servo_id}  {joint.model.name:13}  {reach:15}  "
        f"{speed:>5}  {accel:>7}"
    )


def mechanism_lines(robot: Robot) -> list[str]:
    """Return the servos of a robot with mechanisms, and what stands between them and the joints."""
    from lss_motion.robot.mechanisms import transmission_text, unevenness

    names = [name for mechanism in robot.mechanisms.values() for name in mechanism.servos]
    width = max(len(name) for name in (*names, "servo"))
    lines = [f"{'servo':{width}}   id  model          range deg        deg/s   deg/s²"]
    lines += [_limits_line(robot.servos[name], width) for name in names]
    for mechanism in robot.mechanisms.values():
        lines.append(f"{mechanism.name}: {transmission_text(mechanism, robot.joints)}")
        lines += [
            f"  at joint angle {at:g} deg the servo was measured at {was:g} deg; smoothed, it is "
            f"taken to be at {now:.2f} deg"
            for at, was, now in mechanism.moved_deg
        ]
        joint, servo = robot.joints[mechanism.joints[0]], robot.servos[mechanism.servos[0]]
        if text := unevenness(mechanism, joint, servo):
            lines.append(f"warning: {text}")
    return lines


def fit_text(fit: KeyFit) -> str:
    """Return the text about the reduction of a recording to keys."""
    counts = ((fit.samples_count, "sample"), (fit.keys_count, "key"))
    samples, keys = (counted(count, one, mark=",") for count, one in counts)
    return (
        f"Reduced from {samples} to {keys} in "
        f"{counted(fit.keyframes_count, 'keyframe', mark=',')}: at most "
        f"{fit.error_max_deg:.2f} deg off (joint "
        f"{fit.joint} at {fit.at_s:.2f} s), {fit.error_rms_deg:.2f} deg RMS."
    )


SOUND_SLACK_S: Final = 0.05


def sound_lines(program: Program) -> list[str]:
    """Return a line for every sound of a show: its length, and what does not fit."""
    from lss_motion.sound.files import has_soundfile, sound_info

    cues = {(cue.sound, cue.style): cue for cue in reversed(program.cues) if cue.sound}
    lines = []
    for cue in reversed(cues.values()):
        style, path = cue.style, Path(cue.sound)
        line = f"sound {path.name}, " + ("with the show" if style.is_bed else f"at {cue.at_s:g} s")
        try:
            info = sound_info(path) if has_soundfile() else None
        except InputError as error:
            lines.append(f"warning: sound {path.name} {error.reason}")
            continue
        if info is None:
            lines.append(f"{line} (not examined: {install_command('sound')})")
            continue
        length_s = info.duration_s / style.speed_ratio
        line += f": {length_s:.2f} s, {info.rate_hz} Hz, {counted(info.channels, 'channel')}"
        if info.channels > 2:
            line += ", mixed to 2"
        if abs(style.speed_ratio - 1.0) > RATE_BAND:
            line += f"; not played: at {style.speed_ratio:g} of its speed it would not sound right"
        elif style.is_looped:
            line += ", repeated"
        elif style.lasts_s is not None and length_s < style.lasts_s - SOUND_SLACK_S:
            line += f"; the last {style.lasts_s - length_s:.2f} s of the show are without it"
        elif style.lasts_s is not None and length_s > style.lasts_s + SOUND_SLACK_S:
            line += f"; its last {length_s - style.lasts_s:.2f} s are cut"
        elif style.lasts_s is None and cue.at_s + length_s > program.duration_s + SOUND_SLACK_S:
            line += f"; its last {cue.at_s + length_s - program.duration_s:.2f} s are cut"
        lines.append(line)
    return lines
