"""A random robot and show: joints, families, drives, buses and moves, all from a seed."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Any, Final

from campaign.three_shows import RESUME_S, Show
from lss_motion.errors import LssMotionError
from lss_motion.playing import api
from lss_motion.protocol.constants import Family
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.on_fault import Cause, FaultStep, escalation_problem
from lss_motion.robot.servo_models import FAMILIES, SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence

if TYPE_CHECKING:
    from lss_motion.robot.model import ServoModel
    from lss_motion.robot.on_fault import Escalations

JOINTS_MAX: Final = 8
BAUDS_BPS: Final = (19_200, 38_400, 57_600, 115_200)
"""A free line is filled with queries, which make up the cost of a run."""
KEYS: Final = (2, 5)
STEPS_S: Final = (0.3, 0.9)
TRIES_MAX: Final = 40
"""Of what is drawn, most can be planned and carried; one of a million seeds cannot 40 times."""
MODELS: Final = ("LSS-ST1", "LSS-ST1", "LSS-HT1", "LSS-HS1", "LSS-P-S1", "LSS-2IO")
LADDERS_EVERY: Final = 3
RC_IDS: Final = (209, 210, 211)


def any_show(seed: int) -> Show:
    """Return a show of one to eight joints on one or two buses, the same for the same seed."""
    random = Random(f"{seed}/show")
    for _ in range(TRIES_MAX):
        robot = _robot(random, seed)
        try:
            return Show(robot, api.compile(api.plan(_sequence(random, robot), robot), robot))
        except LssMotionError:
            continue  # Legal, but too much for its lines or its limits.
    raise AssertionError(f"seed {seed}: nothing that was drawn can be played")


def _robot(random: Random, seed: int) -> Robot:
    buses = {
        name: Bus(
            name=name,
            port="sim://",
            baud_bps=random.choice(BAUDS_BPS),
            firmware=random.choice((368, 370, 370)),
        )
        for name in ("main", "other")[: random.choice((1, 1, 2))]
    }
    joints = {}
    free = {bus: (list(range(1, 60)), list(RC_IDS)) for bus in buses}
    for index in range(random.randint(1, JOINTS_MAX)):
        bus = list(buses)[index % len(buses)] if index < len(buses) else random.choice(list(buses))
        model = SERVO_MODELS[random.choice(MODELS)]
        ids = free[bus][model.family is Family.IO2]
        if not ids:
            model, ids = SERVO_MODELS["LSS-ST1"], free[bus][0]
        servo_id = ids.pop(random.randrange(len(ids)))
        joints[f"j{index}"] = _joint(random, f"j{index}", bus, servo_id, model)
    return Robot(
        name=f"any{seed}",
        path=None,
        buses={
            name: bus for name, bus in buses.items() if any(j.bus == name for j in joints.values())
        },
        joints=joints,
        resume_s=RESUME_S,
        on_fault=_ladders(seed) if seed % LADDERS_EVERY == 0 else {},
        end=random.choice(("hold", "hold", "limp")),
    )


def _ladders(seed: int) -> Escalations:
    """Return what is done about some of what may be wrong: any ladder that makes sense."""
    random = Random(f"{seed}/ladders")
    drawn = {cause: tuple(random.sample(list(FaultStep), random.randint(1, 3))) for cause in Cause}
    return {cause: steps for cause, steps in drawn.items() if not escalation_problem(cause, steps)}


def _joint(random: Random, name: str, bus: str, servo_id: int, model: ServoModel) -> Joint:
    drive = random.choice(FAMILIES[model.family].drives)
    fields: dict[str, Any] = {
        "timed": {"accel_max_deg_s2": random.uniform(200.0, 900.0)},
        "streamed": {
            "accel_max_deg_s2": random.uniform(800.0, 2000.0),
            "filter_count": random.choice((3, 4, 5)),
        },
        "stepped": {"accel_max_deg_s2": random.uniform(1000.0, 4000.0)},
    }[drive]
    return Joint(
        name=name,
        servo_id=servo_id,
        bus=bus,
        model=model,
        drive=drive,
        position_min_deg=random.uniform(-75.0, -20.0),
        position_max_deg=random.uniform(20.0, 75.0),
        speed_max_deg_s=random.uniform(60.0, min(model.speed_max_deg_s, 300.0)),
        direction=random.choice((1, -1)),
        zero_deg=random.choice((0.0, round(random.uniform(-15.0, 15.0), 1))),
        **fields,
    )


def _sequence(random: Random, robot: Robot) -> Sequence:
    """Return keyframes of some joints each, none further from the last than its joint may go."""
    deg = {name: random.uniform(-15.0, 15.0) for name in robot.joints}
    frames, at_s = [Keyframe(deg=dict(deg), at_s=0.0)], 0.0
    keyed_s = dict.fromkeys(deg, 0.0)
    for _ in range(random.randint(*KEYS)):
        at_s = round(at_s + random.uniform(*STEPS_S), 3)
        names = [name for name in deg if random.random() < 0.7] or [random.choice(list(deg))]
        for name in names:
            joint = robot.joints[name]
            most_deg = joint.speed_max_deg_s * (at_s - keyed_s[name])
            angle = deg[name] + random.uniform(-most_deg, most_deg)
            deg[name] = min(max(angle, joint.position_min_deg), joint.position_max_deg)
            keyed_s[name] = at_s
        frames.append(Keyframe(deg={name: deg[name] for name in names}, at_s=at_s))
    return Sequence(name=robot.name, keyframes=tuple(frames))
