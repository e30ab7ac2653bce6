"""Random shows on random simulated robots, with feedback and without: whether it does harm.

tools/run tools/benches/random_pairs.py 0 300      the pairs of 300 seeds; prints those with harm

A show is made of what excites servos differently: holds, slow moves, gestures, waves and lively
parts. Robot files keep their usual `following_deg`, so that faults slow a show down. The two runs
of a pair begin at the same phase of the control loops (`in_phase`), and a hand pushes at the same
show time.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]

import numpy as np  # noqa: E402

from benches.in_phase import Beginning, play_in_phase  # noqa: E402
from benches.shows import robot_of  # noqa: E402
from benches.table import Row  # noqa: E402
from lss_motion.playing import api  # noqa: E402
from lss_motion.robot.servo_models import SERVO_MODELS  # noqa: E402
from lss_motion.show.model import Keyframe, Sequence  # noqa: E402
from lss_motion.sim.deviation import deviation_from_text  # noqa: E402
from lss_motion.units import NS_PER_S  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.playing.run import Result
    from lss_motion.robot.model import Robot

HARM_RATIO: Final = 1.02
HARM_DEG: Final = 0.02
"""With feedback RMS may be larger by one of these."""
MOST_DEG: Final = 75.0
MOVES: Final = {
    "slow": ((1.2, 2.5), (3.0, 15.0), 1),
    "gesture": ((0.35, 0.9), (8.0, 40.0), 1),
    "lively": ((0.35, 0.65), (2.0, 30.0), 3),
}
"""By part of a show: time and way of a move, and how many there are."""
FIRST: Final = 2000
PAIRS: Final = 300
SHORT: Final = 20
"""The pairs of the bench."""
SEVERAL: Final = 5
"""Runs whose luck decides, as where commands are lost, are compared over so many seeds."""


class Pair(Struct, frozen=True, kw_only=True):
    """RMS of all horns with feedback and without; `outcome` is that with feedback."""

    seed: int
    text: str
    rms_deg: float
    other_deg: float
    outcome: str

    @property
    def does_harm(self) -> bool:
        """Return whether feedback made the horns worse."""
        most_deg = max(HARM_RATIO * self.other_deg, self.other_deg + HARM_DEG)
        return self.rms_deg > most_deg


def random_show(robot: Robot, random: np.random.Generator, duration_s: float) -> Sequence:
    """Return a show of random parts, at least as long as this, that ends where it began."""
    at_deg, now_s = dict.fromkeys(robot.joints, 0.0), 0.0
    frames = [Keyframe(at_s=0.0, deg=dict(at_deg))]
    while now_s < duration_s:
        part = str(random.choice(["hold", "wave", *MOVES]))
        if part == "hold" and len(frames) > 1:
            hold_s = round(float(random.uniform(0.3, 4.0)), 3)
            frames[-1] = replace(frames[-1], hold_s=frames[-1].hold_s + hold_s)
            now_s = round(now_s + hold_s, 3)
        elif part == "wave":
            now_s = _wave(frames, at_deg, now_s, random)
        elif part != "hold":
            (least_s, most_s), way_deg, count = MOVES[part]
            for _ in range(count):
                now_s = round(now_s + random.uniform(least_s, most_s), 3)
                for name in at_deg:
                    if random.random() < 0.75:
                        way = random.uniform(*way_deg) * random.choice((-1, 1))
                        is_far = abs(at_deg[name] + way) > MOST_DEG
                        at_deg[name] = round(at_deg[name] + (-way if is_far else way), 1)
                frames.append(Keyframe(at_s=now_s, deg=dict(at_deg)))
    home = Keyframe(at_s=round(now_s + 1.0, 3), deg=dict.fromkeys(at_deg, 0.0))
    return Sequence(name="random", keyframes=(*frames, home))


def _wave(
    frames: list[Keyframe], at_deg: dict[str, float], now_s: float, random: np.random.Generator
) -> float:
    """Let one joint swing around where it is; return when it is back there."""
    name, half_s = str(random.choice(list(at_deg))), random.uniform(0.25, 0.9)
    swing_deg = min(random.uniform(3.0, 40.0), MOST_DEG + 10.0 - abs(at_deg[name]))
    for turn in range(int(random.integers(2, 7))):
        now_s = round(now_s + half_s, 3)
        aim_deg = at_deg[name] + (swing_deg if turn % 2 else -swing_deg)
        frames.append(Keyframe(at_s=now_s, deg={name: round(aim_deg, 1)}))
    now_s = round(now_s + half_s, 3)
    frames.append(Keyframe(at_s=now_s, deg=dict(at_deg)))
    return now_s


KINDS: Final[dict[str, tuple[float, Callable[[np.random.Generator], str]]]] = {
    "retarget": (6, lambda _: "retarget=from_rest"),
    "push": (
        6,
        lambda r: (
            f"push={r.choice((-1, 1)) * r.uniform(3, 9):.1f}deg,"
            f"push_for={r.uniform(0.15, 1.2):.2f}s"
        ),
    ),
    "lag": (1, lambda r: f"lag={r.uniform(-10, 60):+.0f}ms"),
    "dead": (1, lambda r: f"dead={r.uniform(5, 60):.0f}ms"),
    "ramp": (1, lambda r: f"ramp={r.choice((r.uniform(0.1, 0.5), r.uniform(0.5, 2))):.2f}"),
    "t_law": (1, lambda _: "t_law=exact"),
    "t": (1, lambda r: str(r.choice(("t_ignored=100ms", "t_least=100ms", "t_step=10ms")))),
    "motor": (1, lambda r: f"motor={r.uniform(20, 60):.0f}%"),
    "backlash": (1, lambda r: f"backlash={r.uniform(0.3, 3):.1f}deg"),
    "droop": (1, lambda r: f"droop={r.choice((-1, 1)) * r.uniform(0.5, 7):.1f}deg"),
    "noise": (1, lambda r: f"noise={r.uniform(0.1, 0.6):.1f}deg"),
    "lost": (1, lambda _: "lost=1%"),
    "corrupt": (1, lambda _: "corrupt=1%"),
    "usb": (1, lambda _: "usb=16ms"),
    "nominal": (1, lambda _: ""),
}
"""Deviations of a robot: how often each is drawn, and how it is made."""


def random_deviation(random: np.random.Generator) -> str:
    """Return one deviation, or two at once."""
    weights = np.array([weight for weight, _ in KINDS.values()])
    count = int(random.choice((1, 1, 2)))
    drawn = random.choice(list(KINDS), size=count, p=weights / weights.sum(), replace=False)
    return ",".join(filter(None, (KINDS[name][1](random) for name in KINDS if name in drawn)))


def pair(seed: int) -> Pair:
    """Play the show of a seed with feedback, then without."""
    random = np.random.default_rng(seed)
    model = SERVO_MODELS[str(random.choice(("LSS-ST1", "LSS-P-S1")))]
    usual = robot_of(int(random.integers(2, 6)))
    most_deg_s = min(model.speed_max_deg_s, 200.0)
    joints = {
        name: replace(joint, model=model, speed_max_deg_s=most_deg_s)
        for name, joint in usual.joints.items()
    }
    robot = replace(usual, joints=joints)
    trajectory = api.plan(random_show(robot, random, random.uniform(6.0, 14.0)), robot)
    program = api.compile(trajectory, robot)
    text, push_ratio = random_deviation(random), random.uniform(0.05, 0.9)

    def played(other_ns: int | None, run: int, *, has_feedback: bool) -> tuple[Result, int]:
        def perform(words: str, beginning: Beginning) -> tuple[Result, int]:
            return play_in_phase(
                program,
                robot,
                trajectory,
                has_feedback=has_feedback,
                seed=run,
                deviation=deviation_from_text(words),
                beginning=beginning,
            )

        calm = ",".join(part for part in text.split(",") if not part.startswith("push"))
        if calm == text:
            return perform(text, Beginning(other_ns))
        marked = Beginning(other_ns, mark_s=push_ratio * trajectory.duration_s)
        perform(calm, marked)
        assert marked.mark_ns is not None, "the show ended before the push"
        push_at_s = marked.mark_ns / NS_PER_S
        return perform(f"{text},push_at={push_at_s:.9f}s", Beginning(other_ns))

    squares: list[tuple[float, float]] = []
    outcome = "finished"
    for run in range(seed, seed + (SEVERAL if "lost=" in text else 1)):
        (ours, begun_ns) = played(None, run, has_feedback=True)
        other, _ = played(begun_ns, run, has_feedback=False)
        outcome = ours.report.outcome if outcome == "finished" else outcome
        assert ours.truth is not None
        assert other.truth is not None
        count = min(len(ours.truth.times_s), len(other.truth.times_s))
        planned_deg = trajectory.sample(ours.truth.times_s[:count])
        squares.append(
            tuple(
                float(np.mean((one.horn_deg[:count] - planned_deg) ** 2))
                for one in (ours.truth, other.truth)
            )
        )
    rms_deg, other_deg = np.sqrt(np.mean(squares, axis=0))
    return Pair(
        seed=seed, text=text, rms_deg=float(rms_deg), other_deg=float(other_deg), outcome=outcome
    )


def measure_short() -> list[Row]:
    """Return the row of a few pairs."""
    return [_row(SHORT)]


def measure() -> list[Row]:
    """Return the row of all pairs."""
    return [_row(PAIRS)]


def _row(count: int) -> Row:
    pairs = [pair(seed) for seed in range(FIRST, FIRST + count)]
    harmed = [one for one in pairs if one.does_harm]
    gain_deg = float(np.mean([one.other_deg - one.rms_deg for one in pairs]))
    return Row(
        what="random shows on random robots: worse with feedback",
        ours=f"{len(harmed)} of {count}, {float(np.mean([one.rms_deg for one in pairs])):.2f} deg",
        reference=f"{float(np.mean([one.other_deg for one in pairs])):.2f} deg without feedback",
        ratio=max(one.rms_deg / one.other_deg for one in pairs),
        target=f"RMS <= {HARM_RATIO:g} x, or {HARM_DEG:g} deg more; smaller in the mean",
        is_met=not harmed and gain_deg > 0.0,
    )


def main(first: int, last: int) -> int:
    """Print the pairs with harm, and how many there are; return 1 if there are any."""
    harmed = 0
    for seed in range(first, last):
        found = pair(seed)
        harmed += found.does_harm
        if found.does_harm or found.outcome != "finished":
            print(
                f"seed {seed:4d}  {found.rms_deg:6.2f} / {found.other_deg:6.2f} deg  "
                f"x{found.rms_deg / found.other_deg:.2f}  {found.outcome}  {found.text}",
                flush=True,
            )
    print(f"{harmed} of {last - first} pairs with harm")
    return 1 if harmed else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
