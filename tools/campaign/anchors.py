"""Random shows with anchors a little above the least time: the planner meets what can be met.

`reach.Reach`, which shares no code with the planner, says when each key can be reached. A show is
scaled to 1.005 to 1.2 times the least duration with which all of its anchors can be met. With
`--layers` it has a layer, and show and layer alone are within the limits.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from campaign import Told
from campaign.reach import Reach, frames_of, is_legal
from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Interpolation, Keyframe, Layer, Sequence

if TYPE_CHECKING:
    import argparse

SEEDS: Final = 1_000
SCALES: Final = 12
"""Attempts to find the least scale; each comes from below."""
ENOUGH: Final = 1e-3
TOLERANCE_S: Final = 0.002
RATIOS: Final = (1.005, 1.2)


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind."""
    parser.add_argument(
        "--refused", action="store_true", help="0.7 to 0.99 times the least instead"
    )

    parser.add_argument("--layers", action="store_true", help="shows with a layer on top")


def robot_of(random: np.random.Generator, names: tuple[str, ...]) -> Robot:
    """Return a robot of joints with limits of their own."""
    joints = {
        name: Joint(
            name=name,
            servo_id=index + 1,
            bus="main",
            model=SERVO_MODELS["LSS-ST1"],
            position_min_deg=-179.0,
            position_max_deg=179.0,
            speed_max_deg_s=round(float(random.uniform(60.0, 360.0))),
            accel_max_deg_s2=round(float(random.uniform(200.0, 1000.0)), -1),
        )
        for index, name in enumerate(names)
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="arm", path=None, buses={"main": bus}, joints=joints)


def any_show(seed: int) -> tuple[Sequence, Robot]:
    """Return a show of one to four joints with one anchor or several, and its robot."""
    random = np.random.default_rng(seed)
    names = ("base", "shoulder", "elbow", "wrist")[: int(random.choice([1, 1, 2, 3, 4]))]
    robot = robot_of(random, names)
    ease = Interpolation(str(random.choice(["smooth", "smooth", "spline"])))
    may_hold = ease is Interpolation.SMOOTH and random.random() < 0.5
    frames = [Keyframe(at_s=0.0, deg=dict.fromkeys(names, 0.0))]
    at_s = 0.0
    free_s = dict.fromkeys(names, 0.0)
    for _ in range(int(random.integers(1, 7))):
        at_s += frames[-1].hold_s * random.random() + float(random.uniform(0.2, 1.2))
        is_held = may_hold and random.random() < 0.3 and at_s >= max(free_s.values())
        free = [n for n in names if free_s[n] <= at_s]
        chosen = [n for n in free if random.random() < 0.7] or free[:1]
        if not chosen:
            at_s = max(free_s.values())
            chosen = list(names)
        hold_s = float(random.uniform(0.1, 0.6)) if is_held else 0.0
        deg = {name: round(float(random.uniform(-60.0, 60.0)), 1) for name in chosen}
        free_s |= dict.fromkeys(chosen, at_s + hold_s + 0.1 * (hold_s > 0.0))
        frames.append(Keyframe(at_s=at_s, deg=deg, hold_s=hold_s, ease=ease))
    last = len(frames) - 1
    anchors = {last} if random.random() < 0.4 else {*random.integers(1, last + 1, 3).tolist()}
    if random.random() < 0.3:
        anchors = set(range(1, last + 1))
    frames = [replace(f, is_anchor=k in anchors) for k, f in enumerate(frames)]
    return Sequence(name=f"anchors {seed}", keyframes=tuple(frames)), robot


def layered(show: Sequence, robot: Robot, random: np.random.Generator) -> Sequence:
    """Return the show with a layer, slowed until both are within the limits alone."""
    names = [name for name in robot.joints if random.random() < 0.6] or [next(iter(robot.joints))]
    mode = str(random.choice(["add", "override"]))
    times = np.cumsum([0.0, *random.uniform(0.3, 1.0, int(random.integers(2, 5)))]).tolist()
    frames = tuple(
        Keyframe(
            at_s=at_s,
            deg={n: round(float(random.uniform(-40.0, 40.0)), 1) for n in names},
            is_anchor=random.random() < 0.3,
        )
        for at_s in times
    )
    layer = Layer(
        sequence=Sequence(name="top", keyframes=frames),
        joints=tuple(names),
        mode=mode,
        weight=round(float(random.uniform(0.5, 1.0)), 2),
        from_s=float(random.uniform(0.1, 1.0)),
        fade_s=0.4 * times[-1],
    )
    # All joints rest at the end of the show, so that nothing is left to be blended out.
    show = replace(show, layers=(layer,))
    while not is_legal(show, robot):
        show = scaled(show, 1.1)
    return show


def scaled(show: Sequence, ratio: float) -> Sequence:
    """Return the show with all times and holds multiplied: the curves stay the same."""
    return replace(
        show,
        keyframes=tuple(
            replace(f, at_s=(f.at_s or 0.0) * ratio, hold_s=f.hold_s * ratio)
            for f in show.keyframes
        ),
        layers=tuple(
            replace(
                layer,
                sequence=scaled(layer.sequence, ratio),
                from_s=layer.from_s * ratio,
                fade_s=layer.fade_s * ratio,
            )
            for layer in show.layers
        ),
    )


def least_scale(show: Sequence, robot: Robot) -> float:
    """Return the least scale with which all anchors are met, within a thousandth."""
    free = replace(show, keyframes=tuple(replace(f, is_anchor=False) for f in show.keyframes))
    anchors = [(k, f.at_s or 0.0) for k, f in enumerate(show.keyframes) if f.is_anchor]
    ratio = 0.05
    for _ in range(SCALES):
        late_s = Reach(scaled(free, ratio), robot).lateness()
        wanted = max(ratio + late_s[k] / at_s for k, at_s in anchors)
        if wanted <= ratio * (1.0 + ENOUGH):
            return wanted
        ratio = wanted
    return ratio


def _advice_fails(show: Sequence, robot: Robot, message: str) -> tuple[str, ...]:
    """Return why the advice of a refusal, followed once, does not suffice; nothing if it does."""
    if show.layers and "write `speed_ratio: " in message:
        (ratio,) = re.findall(r"speed_ratio: ([0-9.]+)`", message)
        try:
            plan(replace(show, speed_ratio=float(ratio)), robot)
        except PlanningError as error:
            return (f"{message}; followed: {error}",)
        return ()
    if "Give it" not in message:
        return () if "late" not in message else (f"no advice: {message}",)
    times = re.findall(r"(it|at ([0-9.]+) s) ([0-9.]+) s more", message.partition(". Give ")[2])
    (at_s,) = re.findall(r"anchor at ([0-9.]+) s", message)
    more_s = {other or at_s: float(by_s) for _, other, by_s in times}
    frames, later_s = [], 0.0
    for frame in show.keyframes:
        later_s += more_s.pop(f"{frame.at_s:g}", 0.0)
        frames.append(replace(frame, at_s=(frame.at_s or 0.0) + later_s))
    try:
        plan(replace(show, keyframes=tuple(frames)), robot)
    except PlanningError as error:
        return (f"{message}; followed: {error}",)
    return ()


def play(seed: int, options: argparse.Namespace) -> Told:
    """Plan one show with anchors that can be met, or with `--refused` one with too little time."""
    show, robot = any_show(seed)
    random = np.random.default_rng([seed, 1])
    ratio = float(random.uniform(*((0.7, 0.99) if options.refused else RATIOS)))
    if options.layers:
        show = layered(show, robot, random)
    else:
        show = scaled(show, least_scale(show, robot) * ratio)
    about = [f"{len(robot.joints)} joints, ratio {ratio:.4f}"]
    try:
        trajectory = plan(show, robot)
    except PlanningError as error:
        lateness = Reach(show, robot).lateness()
        frames = zip(lateness, frames_of(show), strict=True)
        is_possible = all(late_s <= 0.0 for late_s, frame in frames if frame.is_anchor)
        broken = _advice_fails(show, robot, str(error))
        return Told("refused", (str(error), *broken) if is_possible else broken, tuple(about))
    broken = []
    marks = sorted(trajectory.marks, key=lambda mark: mark.authored_s)
    for mark, frame in zip(marks, sorted(frames_of(show), key=lambda f: f.at_s), strict=True):
        late_s = mark.planned_s - (frame.at_s or 0.0)
        if late_s < -1e-6:
            broken.append(f"key at {frame.at_s:.3f} s is {-late_s:.4f} s early")
        if frame.is_anchor and late_s > 1e-3:
            broken.append(f"anchor at {frame.at_s:.3f} s is {late_s:.4f} s late")
        if mark.held_s < frame.hold_s - 1e-6:
            broken.append(f"hold at {frame.at_s:.3f} s lasts {mark.held_s:.4f}")
    return Told("met", tuple(broken), tuple(about))
