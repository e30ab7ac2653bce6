"""Any show at all: up to 40 joints and 200 keyframes with every option a file can have.

The gate tries few; `pytest tests/property/test_any_show.py --hypothesis-profile=search` tries five
hundred others.
"""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Family, Joint, Robot, ServoModel
from lss_motion.show.check import loop_problem
from lss_motion.show.model import Interpolation, Keyframe, Layer, PlaylistStep, Sequence, Timing

MODEL = ServoModel(name="LSS-ST1", family=Family.LSS, speed_max_deg_s=600.0, wire_per_deg=10)
STEPS_S = (0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 1.0)
SWINGS_RATIO = (0.0, 1e-5, 1e-3, 0.05, 0.2, 0.6)
EXCESS_MAX_RATIO = 1.001
EASES = ("smooth", "linear", "hold") * 3 + ("spline",)
SAMPLE_S = 0.001
WINDOW = 3000
REASONS = (
    "anchor",
    "allowed",  # Beyond the range, as a spline may swing.
    "cannot be done in",
    "nothing moves",
    "nothing to fit",
    "do not meet again",
    "layer",
)
"""What may be said instead of a plan; everything else is a fault of ours."""


def robot_of(random: np.random.Generator, count: int) -> Robot:
    """Joints whose limits differ a hundredfold, some with many turns."""
    joints = {}
    for index in range(count):
        reach_deg = float(random.choice([10.0, 90.0, 180.0, 3600.0]))
        joints[f"joint{index}"] = Joint(
            name=f"joint{index}",
            servo_id=index,
            bus="main",
            model=MODEL,
            position_min_deg=-reach_deg,
            position_max_deg=reach_deg,
            turns="by_hand" if reach_deg > 180.0 else None,
            speed_max_deg_s=float(600.0 * 10.0 ** random.uniform(-2.0, 0.0)),
            accel_max_deg_s2=float(1000.0 * 10.0 ** random.uniform(-2.0, 0.0)),
        )
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="any", path=None, buses={"main": bus}, joints=joints)


def _reach_deg(joint: Joint) -> float:
    """How far keys lie from 0: so near that a slow joint does not take an hour."""
    return min(joint.position_max_deg, joint.speed_max_deg_s)


def frames_of(
    random: np.random.Generator, robot: Robot, count: int, *, is_timed: bool, has_anchors: bool
) -> list[Keyframe]:
    """Keyframes that name some joints each, with repeats, holds and every ease."""
    frames: list[Keyframe] = []
    at_s = 0.0
    names = list(robot.joints)
    for index in range(count):
        some = random.permutation(names)[: int(random.integers(1, len(names) + 1))]
        deg = {
            str(name): float(
                random.choice(SWINGS_RATIO)
                * random.uniform(-1.0, 1.0)
                * _reach_deg(robot.joints[str(name)])
            )
            for name in some
        }
        if frames and random.random() < 0.1:
            deg = dict(frames[-1].deg)
        hold_s = float(random.choice([0.0, 0.0, 0.0, 0.05, 1.0]))
        frames.append(
            Keyframe(
                deg=deg,
                at_s=at_s if is_timed else None,
                hold_s=hold_s,
                is_anchor=has_anchors and is_timed and random.random() < 0.05,
                ease=Interpolation(random.choice(EASES)),
                label=f"frame {index}",
            )
        )
        at_s += hold_s + max(float(random.choice(STEPS_S)), 0.001)
    return frames


def returning(frames: list[Keyframe]) -> list[Keyframe]:
    """The keyframes and one more, at which every joint is where it started."""
    start: dict[str, float] = {}
    for frame in reversed(frames):
        start.update(frame.deg)
    last = frames[-1]
    at_s = None if last.at_s is None else last.at_s + last.hold_s + 1.0
    return [*frames, Keyframe(deg=start, at_s=at_s, label="back")]


def sequence_of(random: np.random.Generator, robot: Robot, count: int, timing: Timing) -> Sequence:
    is_timed = timing is Timing.AUTHORED or random.random() < 0.5
    if timing is Timing.FASTEST:
        is_timed = False
    frames = frames_of(random, robot, count, is_timed=is_timed, has_anchors=random.random() < 0.1)
    loop = (1, 1, 2, 5, None)[int(random.integers(5))] if timing is not Timing.FIT else 1
    if loop != 1:
        frames = returning(frames)
        if loop_problem(frames):
            loop = 1
    moves_s = sum(frame.hold_s for frame in frames) + len(frames)
    return Sequence(
        name="any",
        keyframes=tuple(frames),
        timing=timing,
        fit_duration_s=float(moves_s * random.uniform(2.0, 20.0)) if timing is Timing.FIT else None,
        loop=loop,
        speed_ratio=float(
            random.choice([0.3, 1.0, 1.0] if timing is Timing.FASTEST else [0.3, 1.0, 3.0])
        ),
    )


def parted(robot: Robot) -> list[Robot]:
    """The robot's joints in two halves, each as a robot of its own."""
    names = list(robot.joints)
    halves = (names[::2], names[1::2])
    return [replace(robot, joints={n: robot.joints[n] for n in half}) for half in halves if half]


def show_of(random: np.random.Generator, robot: Robot, count: int, form: str) -> Sequence:
    timing = Timing(random.choice(list(Timing)))
    match form:
        case "tracks":
            tracks = [sequence_of(random, half, count, timing) for half in parted(robot)]
            return Sequence(name="tracks", tracks=tuple(tracks))
        case "play":
            parts = [sequence_of(random, half, count, timing) for half in parted(robot)]
            finite = [replace(part, loop=part.loop or 2) for part in parts]
            steps = [
                PlaylistStep(sequence=part, times=int(random.integers(1, 3))) for part in finite
            ]
            pause = PlaylistStep(pause_s=float(random.choice([0.0, 0.5])))
            return Sequence(name="play", play=(*steps, pause, steps[0]), loop=1)
        case "layers":
            base = replace(sequence_of(random, robot, count, timing), loop=1)
            keyed = {name for frame in base.keyframes for name in frame.deg}
            top = replace(sequence_of(random, robot, 8, Timing.AUTHORED), loop=1)
            layer = Layer(
                sequence=top,
                joints=tuple(name for name in robot.joints if name in keyed),
                mode="add" if random.random() < 0.5 else "override",
                weight=float(random.uniform(0.0, 1.0)),
                from_s=float(random.uniform(0.0, 2.0)),
                to_s=float(random.uniform(2.5, 9.0)),
                fade_s=float(random.choice([0.05, 0.5, 3.0])),
            )
            return replace(base, layers=(layer,))
        case _:
            return sequence_of(random, robot, count, timing)


@settings(max_examples=settings().max_examples // 4, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 2**32 - 1),
    joints=st.sampled_from([1, 1, 2, 3, 5, 8, 12, 20, 40]),
    count=st.sampled_from([1, 2, 2, 3, 5, 8, 12, 20, 40, 200]),
    form=st.sampled_from(["keyframes", "keyframes", "tracks", "play", "layers"]),
)
def test_any_show_keeps_every_limit_or_says_why_it_cannot(
    seed: int, joints: int, count: int, form: str
) -> None:
    random = np.random.default_rng(seed)
    robot = robot_of(random, joints)
    show = show_of(random, robot, count, form)
    try:
        trajectory = plan(show, robot)
    except (InputError, PlanningError) as error:
        if not any(reason in str(error) for reason in REASONS):
            raise
        event("refused")
        return
    event("planned")
    limits = [robot.joints[name] for name in trajectory.joints]
    speed = np.array([joint.speed_max_deg_s for joint in limits])
    accel = np.array([joint.accel_max_deg_s2 for joint in limits])
    shown_s = trajectory.first.duration_s + trajectory.middle.duration_s
    for from_s in (-0.1, shown_s * random.random(), trajectory.first.duration_s - 0.1):
        deg = trajectory.sample(from_s + SAMPLE_S * np.arange(WINDOW))
        assert np.isfinite(deg).all()
        assert (deg >= [joint.position_min_deg - 1e-6 for joint in limits]).all()
        assert (deg <= [joint.position_max_deg + 1e-6 for joint in limits]).all()
        moves, bends = np.diff(deg, axis=0), np.diff(deg, 2, axis=0)
        noise_deg = 1e-9 * np.maximum(1.0, np.abs(deg).max(axis=0))
        assert (np.abs(moves) <= EXCESS_MAX_RATIO * speed * SAMPLE_S + noise_deg).all()
        assert (np.abs(bends) <= EXCESS_MAX_RATIO * accel * SAMPLE_S**2 + noise_deg).all()
