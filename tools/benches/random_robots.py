"""Feedback does no harm: random shows on random robots that are not as assumed.

tools/run tools/benches/random_robots.py                 100 seeds
tools/run tools/benches/random_robots.py --from 40 --seeds 1
tools/run tools/benches/random_robots.py --bounds        robots as assumed, against their bound

Show, robot and deviation come from the seed. Each show is played with feedback and without, from
the same phase of the control loops (`in_phase`), and judged at the horns alone: no judgement is
shared with the estimators or with the bench `robust`, whose table knows its shows by name. With
`--bounds` each show is played without feedback on servos as assumed, and each horn is compared with
the bound that `check` predicts for it.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]

import numpy as np  # noqa: E402

from benches.in_phase import Beginning, bound_ratios, limit_ratios, named_joints, play_in_phase  # noqa: E402
from benches.shows import robot_of  # noqa: E402
from lss_motion.errors import InputError  # noqa: E402
from lss_motion.playing import api  # noqa: E402
from lss_motion.playing.run import perform  # noqa: E402
from lss_motion.robot.servo_models import SERVO_MODELS  # noqa: E402
from lss_motion.show.model import Keyframe, Sequence  # noqa: E402
from lss_motion.sim.deviation import deviation_from_text  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

HARM_RATIO: Final = 1.02
HARM_DEG: Final = 0.01
"""RMS may be larger by one of both: a tenth of the smallest unit of an LSS cannot be seen."""
STANDING_DEG: Final = 0.25
SETTLE_S: Final = 2.0
REST_S: Final = 3.0
"""A joint stands from `SETTLE_S` after its plan came to rest, in rests of `REST_S` and more."""
ARRIVED_DEG: Final = 0.3
"""A horn that comes nearer by this while it stands had not arrived: it cannot reach the plan."""
TURN_DEG: Final = 0.25
TURNS_MAX: Final = 2
LIMIT_RATIO: Final = 1.1
LIMIT_STREAMED: Final = 1.25
"""Setpoints have room for the steps of their units. Where gears have play, the shaft is hit, and no
acceleration is judged."""
STEP_S: Final = 0.01
SEEDS_LOST: Final = 3
"""Which commands are lost is luck, so several runs are judged together."""
KINDS: Final = ("slow", "fast", "jerky", "holds", "mixed", "breath")


@dataclass(frozen=True, slots=True)
class Run:
    """What the horns of one run did, by joint: (samples, joints)."""

    outcome: str
    horn_deg: FloatArray
    error_deg: FloatArray
    speed_ratio: float
    accel_ratio: float
    named: frozenset[str]


def deviation_of(random: Random) -> str:
    """Return up to four deviations, each as bad as it may come."""
    choices = {
        "lag": lambda: (
            f"{random.choice((-1, 1, 1, 1)) * random.uniform(3, 18):+.0f}ms"
            if random.random() < 0.5
            else f"{random.uniform(10, 80):+.0f}ms"
        ),
        "dead": lambda: f"{random.uniform(5, 80):.0f}ms",
        "ramp": lambda: f"{math.exp(random.uniform(math.log(0.1), math.log(3.0))):.2f}",
        "t_law": lambda: "exact",
        "retarget": lambda: "from_rest",
        "t_ignored": lambda: f"{random.uniform(30, 150):.0f}ms",
        "t_least": lambda: f"{random.uniform(30, 200):.0f}ms",
        "t_step": lambda: f"{random.uniform(4, 40):.0f}ms",
        "motor": lambda: f"{random.uniform(20, 80):.0f}%",
        "backlash": lambda: f"{random.uniform(0.3, 2.0):.1f}deg",
        "droop": lambda: f"{random.choice((-1, 1)) * random.uniform(0.5, 7.0):.1f}deg",
        "noise": lambda: f"{random.uniform(0.1, 0.8):.1f}deg",
        "usb": lambda: f"{random.uniform(2, 30):.0f}ms",
        "lost": lambda: f"{random.uniform(0.3, 3):.1f}%",
        "corrupt": lambda: f"{random.uniform(0.3, 3):.1f}%",
    }
    chosen = random.sample(list(choices), random.choice((0, 1, 1, 1, 2, 2, 3, 4)))
    return ",".join(f"{key}={choices[key]()}" for key in chosen)


def robot_from(random: Random) -> Robot:
    """Return a robot of one to eight joints, LSS or LSS-PRO, some of them streamed."""
    model = random.choice(("LSS-ST1", "LSS-HT1", "LSS-P-S1"))
    baud_bps = random.choice((38_400, 115_200, 115_200, 921_600))
    robot = robot_of(random.randint(1, 8), baud_bps=baud_bps)
    speed_deg_s, accel_deg_s2 = random.uniform(60, 350), random.uniform(200, 1000)
    speed_deg_s = min(speed_deg_s, SERVO_MODELS[model].speed_max_deg_s)
    is_streamed = model == "LSS-ST1" and baud_bps > 100_000 and random.random() < 0.2
    joints = {
        name: replace(
            joint,
            model=SERVO_MODELS[model],
            speed_max_deg_s=speed_deg_s,
            accel_max_deg_s2=accel_deg_s2,
            following_deg=90.0,
            drive="streamed" if is_streamed else "timed",
        )
        for name, joint in robot.joints.items()
    }
    return replace(robot, joints=joints)


def show_from(random: Random, robot: Robot, kind: str, lasts_s: float = 12.0) -> Sequence:
    """Return a show of about so many seconds; each joint has its own swing."""
    accel_deg_s2 = min(joint.accel_max_deg_s2 for joint in robot.joints.values())
    speed_deg_s = min(joint.speed_max_deg_s for joint in robot.joints.values())
    at_deg = dict.fromkeys(robot.joints, 0.0)
    swing = {name: random.uniform(0.2, 1.0) for name in at_deg}
    frames, now_s, count = [Keyframe(at_s=0.0, deg=dict(at_deg))], 0.0, 0
    while now_s < lasts_s:
        count += 1
        own = random.choice(KINDS[:4]) if kind == "mixed" else kind
        move_s, most_deg, hold_s = {
            "slow": (random.uniform(1.0, 3.0), 15.0, random.choice((0.0, 0.0, 1.0, 3.5))),
            "fast": (random.uniform(0.2, 0.6), 60.0, random.choice((0.0, 0.0, 0.0, 0.4))),
            "jerky": (random.uniform(0.08, 0.25), 12.0, random.choice((0.0, 0.0, 0.3))),
            "holds": (random.uniform(0.3, 2.0), 30.0, random.uniform(1.0, 5.0)),
            "breath": (random.uniform(0.7, 0.9), 4.0, 0.0),
        }[own]
        now_s = round(now_s + move_s, 3)
        free_deg = min(0.9 * speed_deg_s * move_s / 1.9, accel_deg_s2 * move_s**2 / 9.0, most_deg)
        for name in at_deg:
            if kind != "breath" and random.random() < 0.25:
                continue
            way = (-1) ** count if kind == "breath" else random.choice((-1, 1))
            aim_deg = at_deg[name] + way * swing[name] * random.uniform(0.4, 1.0) * free_deg
            aim_deg = aim_deg if abs(aim_deg) < 70.0 else 2.0 * at_deg[name] - aim_deg
            at_deg[name] = round(aim_deg, 1)
        frames.append(Keyframe(at_s=now_s, deg=dict(at_deg), hold_s=round(hold_s, 3)))
        now_s = round(now_s + hold_s, 3)
    return Sequence(name=kind, keyframes=tuple(frames))


@dataclass(frozen=True, slots=True)
class Case:
    """A seed's show, robot and deviation."""

    seed: int
    kind: str
    robot: Robot
    trajectory: Trajectory
    text: str

    @property
    def is_streamed(self) -> bool:
        """Return whether the servos are sent setpoints."""
        return any(joint.drive == "streamed" for joint in self.robot.joints.values())


def case_of(seed: int) -> Case | None:
    """Return the case of a seed; None: this robot cannot play such a show."""
    random = Random(f"{seed}/harm")  # noqa: S311
    kind = random.choice(KINDS)
    robot = robot_from(random)
    show, text = show_from(random, robot, kind), deviation_of(random)
    try:
        return Case(seed, kind, robot, api.plan(show, robot), text)
    except InputError:
        return None


def runs(case: Case) -> Iterator[tuple[Run, Run]]:
    """Yield pairs of runs, with feedback and without."""
    program = api.compile(case.trajectory, case.robot)
    for seed in range(SEEDS_LOST if "lost=" in case.text else 1):
        pair: list[Run] = []
        other_ns = None
        for has_feedback in (True, False):
            result, other_ns = play_in_phase(
                program,
                case.robot,
                case.trajectory,
                has_feedback=has_feedback,
                seed=case.seed + seed,
                deviation=deviation_from_text(case.text),
                beginning=Beginning(other_ns),
            )
            truth = result.truth
            assert truth is not None, "the show was not played"
            plan_deg = case.trajectory.sample(truth.times_s)
            columns = [case.trajectory.joints.index(name) for name in truth.joints]
            ratios = limit_ratios(case.robot, case.trajectory, result, other_ns)
            error_deg = truth.horn_deg - plan_deg[:, columns]
            named = named_joints(case.robot, result)
            pair.append(Run(result.report.outcome, truth.horn_deg, error_deg, *ratios, named))
        yield pair[0], pair[1]


def standing(case: Case, ours: Run, other: Run) -> tuple[float, float, int]:
    """Return the largest error of a standing joint, with and without, and how often it turned."""
    times_s = STEP_S * np.arange(len(ours.error_deg))
    plan_deg = case.trajectory.sample(times_s)
    worst, worst_other, turned = 0.0, 0.0, 0
    for column in range(ours.error_deg.shape[1]):
        is_still = np.append(np.abs(np.diff(plan_deg[:, column])) < 1e-6, False)
        begin = None
        for index, still in enumerate(is_still.tolist()):
            if still:
                begin = index if begin is None else begin
                continue
            if begin is not None and (index - begin) * STEP_S >= REST_S:
                a, b = begin + round(SETTLE_S / STEP_S), index - round(0.15 / STEP_S)
                without = np.abs(other.error_deg[a:b, column])
                has_arrived = without[0] - without[-1] < ARRIVED_DEG
                if has_arrived and without.max() < 6.8:
                    worst = max(worst, float(np.abs(ours.error_deg[a:b, column]).max()))
                    worst_other = max(worst_other, float(without.max()))
                turned = max(turned, turns(ours.horn_deg[a:b, column].tolist()))
            begin = None
    return worst, worst_other, turned


def turns(angles_deg: list[float]) -> int:
    """Return how often a horn that stands turned round by more than `TURN_DEG`."""
    count, ends, way = 0, angles_deg[0], 0
    for angle in angles_deg:
        if way == 0 and abs(angle - ends) > TURN_DEG:
            way, ends = (1 if angle > ends else -1), angle
        elif way * (angle - ends) > 0:
            ends = angle
        elif way and abs(angle - ends) > TURN_DEG:
            count, way, ends = count + 1, -way, angle
    return count


def judged(case: Case) -> tuple[str, list[str]]:
    """Return a line about a case, and what feedback made worse."""
    pairs = list(runs(case))
    rms = [math.sqrt(float(np.mean([np.mean(run.error_deg**2) for run in side])))
           for side in zip(*pairs, strict=True)]  # fmt: skip
    found: list[str] = []
    if rms[0] > HARM_RATIO * rms[1] + HARM_DEG:
        found.append(f"RMS x{rms[0] / rms[1]:.2f}")
    worst = 0.0, ""
    for column, name in enumerate(case.robot.joints):
        own, without = (
            math.sqrt(float(np.mean([np.mean(run.error_deg[:, column] ** 2) for run in side])))
            for side in zip(*pairs, strict=True)
        )
        worst = max(worst, (own / max(without, 0.05), name))
    for ours, other in pairs:
        if ours.outcome != "finished" or other.outcome != "finished":
            found.append(f"{ours.outcome}/{other.outcome}")
        stands, stood, turned = standing(case, ours, other)
        is_noisy = "noise" in case.text
        if stands > (max(STANDING_DEG, stood) if is_noisy else STANDING_DEG):
            found.append(f"stands {stands:.2f}/{stood:.2f}")
        if turned > TURNS_MAX:
            found.append(f"turns {turned}")
        if ours.speed_ratio > LIMIT_RATIO * max(1.0, other.speed_ratio):
            found.append(f"speed {ours.speed_ratio:.2f}/{other.speed_ratio:.2f}")
        most = LIMIT_STREAMED if case.is_streamed else LIMIT_RATIO
        if "backlash" not in case.text and ours.accel_ratio > most * max(1.0, other.accel_ratio):
            found.append(f"accel {ours.accel_ratio:.2f}/{other.accel_ratio:.2f}")
    joint = next(iter(case.robot.joints.values()))
    line = (
        f"{case.seed:5} {case.kind:7} {joint.model.name:8} {joint.drive[:6]:6} "
        f"x{len(case.robot.joints)} {case.robot.buses['main'].baud_bps:6} "
        f"{case.text or 'nominal':55} "
        f"{rms[0]:5.2f} {rms[1]:5.2f} joint x{worst[0]:.2f} named {len(pairs[0][0].named)}"
    )
    return line, found


def within_bounds(cases: Iterator[Case]) -> int:
    """Compare horns on servos as assumed with their predicted bounds; return 1 if one is beyond."""
    ratios: list[float] = []
    for case in cases:
        program = api.compile(case.trajectory, case.robot)
        result = perform(
            program,
            case.robot,
            is_virtual=True,
            has_feedback=False,
            seed=case.seed,
            trajectory=case.trajectory,
        )
        for name, ratio in bound_ratios(program, result).items():
            ratios.append(ratio)
            if ratio > 1.0:
                bound_deg = program.bound_deg[name]
                print(f"{case.seed} {name}: {ratio:.3f} of its bound {bound_deg:.3f} deg")
    beyond = sum(ratio > 1.0 for ratio in ratios)
    print(
        f"{beyond} of {len(ratios)} joints beyond their bound; horns at {np.median(ratios):.2f} of "
        f"it (median), at most {max(ratios):.2f}"
    )
    return 1 if beyond else 0


def main() -> int:
    """Play the seeds; return 1 if feedback did harm, or a horn was beyond its bound."""
    parser = argparse.ArgumentParser(
        prog="tools/benches/random_robots.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seeds", type=int, default=100, metavar="N")
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="SEED")
    parser.add_argument("--bounds", action="store_true", help="robots as assumed, no feedback")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    cases = filter(None, map(case_of, seeds))
    if arguments.bounds:
        return within_bounds(cases)
    failed = played = 0
    for case in cases:
        line, found = judged(case)
        played, failed = played + 1, failed + bool(found)
        print(f"{line} {'; '.join(found)}", flush=True)
    print(f"{failed} of {played} with harm")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
