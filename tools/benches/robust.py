"""What feedback is worth, and that it does no harm, on simulated robots that are not as assumed.

tools/run tools/benches/robust.py              all deviations x 3 shows x LSS and LSS-PRO, a table
tools/run tools/benches/robust.py lag droop    only deviations whose text has one of these words
tools/run tools/benches/robust.py --write      the table into tools/FIGURES.md

Each show is played in virtual time with feedback and without, on the same simulated robot and from
the same phase of its control loops (`in_phase`), and judged at the horns. The bench `robust` of
`tools/bench.py` plays a part of it.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]

import numpy as np  # noqa: E402

from benches.in_phase import Beginning, limit_ratios, named_joints, play_in_phase  # noqa: E402
from benches.shows import lively_show, robot_of  # noqa: E402
from benches.table import Row  # noqa: E402
from lss_motion.playing import api  # noqa: E402
from lss_motion.playing.robustness import (  # noqa: E402
    AFTER_PUSH_S,
    ASSUMED,
    LEAD_S,
    PUSH_S,
    SETTLED_S,
    WORSE,
    rests,
    still,
)
from lss_motion.playing.truth import TRUTH_STEP_S  # noqa: E402
from lss_motion.robot.servo_models import SERVO_MODELS  # noqa: E402
from lss_motion.show.model import Keyframe, Sequence  # noqa: E402
from lss_motion.sim.deviation import deviation_from_text  # noqa: E402
from lss_motion.units import NS_PER_S  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.run import Result
    from lss_motion.playing.truth import Truth
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

DEVIATIONS: Final = (ASSUMED, *WORSE)
OF_MODEL: Final = (
    "lag_s", "dead_s", "ramp_ratio", "retarget", "t_law", "t_ignored_s", "t_least_s", "t_step_s",
    "motor_ratio",
)  # fmt: skip
"""Fields of a `Deviation` that are the response of a servo; a robot file has it wrong then."""
QUICK: Final = ("", "dead=60ms", "retarget=from_rest", "droop=6deg", "push=6deg")
MODELS: Final = ("LSS-ST1", "LSS-P-S1")
JOINTS: Final = 4
FOLLOWING_DEG: Final = 90.0
"""So no fault slows a show down, and it is the corrections that are judged."""
SHOW_S: Final = 12.0
HARM_RATIO: Final = 1.02
"""With feedback the RMS may be this much larger."""
SEEDS: Final = (1, 2, 3)
"""Where commands are lost it is luck which: with feedback others are than without, and RMS over
several runs is compared."""
STANDING_DEG: Final = 0.25
LATE_DEG: Final = 1.0
"""A horn that comes nearer to its plan by this in a hold had not arrived, without feedback: the
servo could not reach the plan."""
SWING_DEG: Final = 0.2
SWINGS_MAX: Final = 2
"""A horn in a hold that turns round by more than `SWING_DEG` more often than this oscillates."""
NAMED_S: Final = 5.0
"""After so long a wrong model must have been named: what was off until then only teaches it."""
MOTION_DEG_S: Final = 1.0
MOTION_MORE_S: Final = 0.25
"""A joint is in motion where its plan is faster than this, and so long afterwards: a horn that is
late arrives then."""
OFF_DEG: Final = 0.5
OFF_S: Final = 0.03
"""A joint must be named whose horn is off by more than both in motion, as RMS and over its RMS
speed. Chosen: more than the error from which on the player names a joint (0.0165 s), since 12 s of
show have no more than 50 to 120 readings in motion."""
LIMIT_RATIO: Final = 1.1
"""Horn speed and acceleration, by differences, over the limit or over that without feedback."""


@dataclass(frozen=True, slots=True)
class Case:
    """A show on a robot, compiled once."""

    name: str
    model: str
    robot: Robot
    trajectory: Trajectory
    program: Program


class Outcome(Struct, frozen=True, kw_only=True):
    """What the horns of one run did; the worst of all joints, but for `rms_deg`."""

    rms_deg: float
    max_deg: float
    standing_deg: float
    """In holds, after they have settled."""
    is_late: bool
    """Whether a horn was still on its way then."""
    swings: int
    """How often a horn turned round in a hold."""
    speed_ratio: float
    accel_ratio: float
    """Of the limits."""
    outcome: str
    origin_ns: int
    """Instant of show time 0."""
    findings: frozenset[str] = frozenset()
    """Joints whose model was named as wrong."""
    observable: frozenset[str] = frozenset()
    """Joints that must be: their model is wrong, and so are their horns, also where no command is
    lost."""
    is_model_right: bool = False
    """Whether none may be named: what deviates is the load, the line, or nothing."""

    @property
    def unnamed(self) -> frozenset[str]:
        """Return the joints that must be named and were not."""
        return self.observable - self.findings


def gestures(robot: Robot, seed: int) -> Sequence:
    """Return a show of quick gestures with holds of one to two seconds, and one of four."""
    return _with_holds(robot, seed, move_s=(0.35, 0.9), swing_deg=(8.0, 40.0))


def slow(robot: Robot, seed: int) -> Sequence:
    """Return a show of slow moves with holds."""
    return _with_holds(robot, seed, move_s=(1.2, 2.5), swing_deg=(3.0, 15.0))


def _with_holds(
    robot: Robot, seed: int, *, move_s: tuple[float, float], swing_deg: tuple[float, float]
) -> Sequence:
    random = np.random.default_rng(seed)
    at_deg = dict.fromkeys(robot.joints, 0.0)
    frames, now_s = [Keyframe(at_s=0.0, deg=dict(at_deg))], 0.0
    for hold_s in (0.4, 2.2, 0.0, 4.5, 0.3, 2.5):
        now_s = round(now_s + random.uniform(*move_s), 3)
        for name in at_deg:
            way_deg = random.uniform(*swing_deg) * random.choice((-1.0, 1.0))
            aim_deg = at_deg[name] + way_deg
            at_deg[name] = round(aim_deg if abs(aim_deg) < 60.0 else at_deg[name] - way_deg, 1)
        frames.append(Keyframe(at_s=now_s, deg=dict(at_deg), hold_s=hold_s))
        now_s = round(now_s + hold_s, 3)
    return Sequence(name="gestures", keyframes=tuple(frames))


MARKS: Final = "<!-- robust -->\n", "<!-- end of robust -->\n"
HEAD: Final = (
    "| simulated robot | RMS of horns, deg | worst ratio | standing error in holds, deg "
    "| named as wrong | short |",
    "|---|---|---|---|---|---|",
)

SHOWS: Final[dict[str, Callable[[Robot], Sequence]]] = {
    "lively": lambda robot: lively_show(robot, SHOW_S, seed=3),
    "gestures": lambda robot: gestures(robot, 5),
    "slow": lambda robot: slow(robot, 7),
}


def cases(models: tuple[str, ...] = MODELS, shows: tuple[str, ...] = tuple(SHOWS)) -> list[Case]:
    """Return the shows on the robots."""
    made = []
    for model in models:
        usual = robot_of(JOINTS)
        most_deg_s = min(SERVO_MODELS[model].speed_max_deg_s, 200.0)
        joints = {
            name: replace(
                joint,
                model=SERVO_MODELS[model],
                speed_max_deg_s=most_deg_s,
                following_deg=FOLLOWING_DEG,
            )
            for name, joint in usual.joints.items()
        }
        robot = replace(usual, joints=joints)
        for name in shows:
            trajectory = api.plan(SHOWS[name](robot), robot)
            made.append(Case(name, model, robot, trajectory, api.compile(trajectory, robot)))
    return made


def played(
    case: Case, text: str, *, has_feedback: bool, seed: int = 1, after: Outcome | None = None
) -> Outcome:
    """Play a case on the robot of a deviation; return what its horns did.

    `after`: begin at the phase of the control loops at which that run began.
    """
    other_ns = None if after is None else after.origin_ns
    if "push=" in text:
        _, begun_ns = _perform(case, "", other_ns, has_feedback=has_feedback, seed=seed)
        begin_s = begun_ns / NS_PER_S + _longest_hold_s(case) + PUSH_S
        text = f"{text},push_at={begin_s:.2f}s"
    result, begun_ns = _perform(case, text, other_ns, has_feedback=has_feedback, seed=seed)
    outcome = _judged(case, text, result, begun_ns)
    if outcome.observable and "lost=" in text:
        calm = ",".join(part for part in text.split(",") if not part.startswith("lost="))
        result, _ = _perform(case, calm, other_ns, has_feedback=has_feedback, seed=seed)
        assert result.truth is not None, "the show was not played"
        by_model = outcome.observable & _strayed(case, result.truth)
        outcome = replace(outcome, observable=by_model)
    return outcome


def _perform(
    case: Case, text: str, other_ns: int | None, *, has_feedback: bool, seed: int
) -> tuple[Result, int]:
    """Return the result, and the instant of show time 0."""
    return play_in_phase(
        case.program,
        case.robot,
        case.trajectory,
        has_feedback=has_feedback,
        seed=seed,
        deviation=deviation_from_text(text),
        beginning=Beginning(other_ns),
    )


def _rests(case: Case) -> list[tuple[float, float]]:
    """Return when all joints of the plan rest together, as long as a hold; in show time."""
    times_s = TRUTH_STEP_S * np.arange(round(case.trajectory.duration_s / TRUTH_STEP_S))
    return list(rests(still(case.trajectory.sample(times_s)).all(axis=1)))


def _longest_hold_s(case: Case) -> float:
    """Return when the longest hold begins, or the middle of a show without one."""
    spans = _rests(case)
    return max(spans, key=lambda span: span[1] - span[0])[0] if spans else 0.5 * SHOW_S


def _judged(case: Case, text: str, result: Result, begun_ns: int) -> Outcome:
    truth = result.truth
    assert truth is not None, "the show was not played"
    error_deg = truth.horn_deg - case.trajectory.sample(truth.times_s)
    standing_deg, swings, is_late = 0.0, 0, False
    for from_s, until_s in _rests(case):
        for a, b in _judged_spans(from_s + SETTLED_S, until_s - LEAD_S, text, begun_ns):
            chosen = (truth.times_s >= a) & (truth.times_s <= b)
            if chosen.sum() > 5:
                standing_deg = max(standing_deg, float(np.abs(error_deg[chosen]).max()))
                late_deg = np.abs(error_deg[chosen][0]) - np.abs(error_deg[chosen][-1])
                is_late |= bool(late_deg.max() > LATE_DEG)
                swings = max(swings, *map(_swings, truth.horn_deg[chosen].T))
    speed_ratio, accel_ratio = limit_ratios(case.robot, case.trajectory, result, begun_ns)
    is_model_right = has_right_model(text)
    return Outcome(
        rms_deg=float(np.sqrt(np.mean(error_deg**2))),
        max_deg=float(np.abs(error_deg).max()),
        standing_deg=standing_deg,
        is_late=is_late,
        swings=swings,
        speed_ratio=speed_ratio,
        accel_ratio=accel_ratio,
        outcome=result.report.outcome,
        origin_ns=begun_ns,
        findings=named_joints(case.robot, result),
        observable=frozenset() if is_model_right else _strayed(case, truth),
        is_model_right=is_model_right,
    )


def has_right_model(text: str) -> bool:
    """Return whether the servos of a deviation move as the robot file says."""
    deviation, usual = deviation_from_text(text), deviation_from_text("")
    return all(getattr(deviation, name) == getattr(usual, name) for name in OF_MODEL)


def _strayed(case: Case, truth: Truth) -> frozenset[str]:
    """Return the joints whose horns, whatever was corrected, were off their plan in motion."""
    planned_deg = case.trajectory.sample(truth.times_s)
    error_deg = truth.horn_deg - planned_deg
    speed_deg_s = np.gradient(planned_deg, TRUTH_STEP_S, axis=0)
    more = np.ones(1 + round(MOTION_MORE_S / TRUTH_STEP_S))
    found = set()
    for column, name in enumerate(truth.joints):
        is_fast = np.abs(speed_deg_s[:, column]) > MOTION_DEG_S
        moves = np.convolve(is_fast, more)[: len(is_fast)] > 0.5
        moves &= truth.times_s > NAMED_S
        off_deg, fast_deg_s = (
            math.sqrt(float(np.mean(values[moves, column] ** 2))) if moves.any() else 0.0
            for values in (error_deg, speed_deg_s)
        )
        if off_deg > max(OFF_DEG, OFF_S * fast_deg_s):
            found.add(name)
    return frozenset(found)


def compared(case: Case, text: str) -> tuple[Outcome, Outcome]:
    """Play a case with feedback, then without from the same phase of the control loops."""
    pairs = []
    for seed in SEEDS if deviation_from_text(text).lost_ratio else SEEDS[:1]:
        ours = played(case, text, has_feedback=True, seed=seed)
        pairs.append((ours, played(case, text, has_feedback=False, seed=seed, after=ours)))
    ours, others = zip(*pairs, strict=True)
    return _in_all(ours), _in_all(others)


def _in_all(runs: tuple[Outcome, ...]) -> Outcome:
    """Return what the horns of several runs did: RMS over all, the worst of the others."""
    if len(runs) == 1:
        return runs[0]
    return Outcome(
        rms_deg=_rms([one.rms_deg for one in runs]),
        max_deg=max(one.max_deg for one in runs),
        standing_deg=max(one.standing_deg for one in runs),
        is_late=any(one.is_late for one in runs),
        swings=max(one.swings for one in runs),
        speed_ratio=max(one.speed_ratio for one in runs),
        accel_ratio=max(one.accel_ratio for one in runs),
        outcome=next((one.outcome for one in runs if one.outcome != "finished"), "finished"),
        origin_ns=runs[0].origin_ns,
        findings=_of_runs([one.findings for one in runs]),
        observable=_of_runs([one.observable for one in runs]),
        is_model_right=runs[0].is_model_right,
    )


def _of_runs(names: list[frozenset[str]]) -> frozenset[str]:
    """Return names of joints, each with the number of its run."""
    return frozenset(f"{name} in run {n}" for n, own in enumerate(names, 1) for name in own)


def _judged_spans(
    from_s: float, until_s: float, text: str, begun_ns: int
) -> Iterator[tuple[float, float]]:
    """Yield the parts of a hold in which no hand pushes, and has not just done so."""
    deviation = deviation_from_text(text)
    pushed_s = deviation.push_at_s - begun_ns / NS_PER_S
    if not deviation.push_deg or not from_s < pushed_s < until_s:
        yield from_s, until_s
        return
    yield from_s, pushed_s - 0.05
    yield pushed_s + deviation.push_for_s + AFTER_PUSH_S, until_s


def _swings(horn_deg: FloatArray) -> int:
    """Return how often a horn turned round by more than `SWING_DEG`."""
    turns, low, high, way = 0, float(horn_deg[0]), float(horn_deg[0]), 0
    for angle in horn_deg.tolist():
        low, high = min(low, angle), max(high, angle)
        if way >= 0 and angle < high - SWING_DEG:
            turns, way, low = turns + (way > 0), -1, angle
        elif way <= 0 and angle > low + SWING_DEG:
            turns, way, high = turns + (way < 0), 1, angle
        low = angle if way > 0 and angle > high - SWING_DEG else low
        high = angle if way < 0 and angle < low + SWING_DEG else high
    return turns


def problems(ours: Outcome, other: Outcome) -> list[str]:
    """Return what feedback made worse than it may be; `other` is without it."""
    found = []
    if ours.outcome != "finished":
        found.append(ours.outcome)
    if ours.standing_deg > STANDING_DEG and not other.is_late:
        found.append(f"stands {ours.standing_deg:.2f}")
    if ours.swings > SWINGS_MAX:
        found.append(f"swings {ours.swings}")
    if ours.unnamed:
        found.append(f"unnamed {', '.join(sorted(ours.unnamed))}")
    if ours.is_model_right and ours.findings:
        found.append(f"misnamed {', '.join(sorted(ours.findings))}")
    if ours.rms_deg > HARM_RATIO * other.rms_deg:
        found.append(f"RMS x{ours.rms_deg / other.rms_deg:.2f}")
    for what, own, theirs in (
        ("speed", ours.speed_ratio, other.speed_ratio),
        ("accel", ours.accel_ratio, other.accel_ratio),
    ):
        if own > LIMIT_RATIO * max(1.0, theirs):
            found.append(f"{what} x{own:.2f}, {theirs:.2f}")
    return found


def main(words: list[str]) -> int:
    """Print all deviations, or those with one of `words`; return 1 if feedback does harm."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", metavar="WORD", help="part of a deviation's text")
    parser.add_argument("--write", action="store_true", help="write the table into FIGURES.md")
    arguments = parser.parse_args(words)
    chosen = arguments.words
    texts = [text for text in DEVIATIONS if not chosen or any(word in text for word in chosen)]
    if not texts:
        parser.error(f"no deviation has {' or '.join(chosen)} in its text")
    if arguments.write and chosen:
        parser.error("--write needs all deviations: leave the words out")
    made, lines, failures = cases(), [], 0
    print(
        f"{'deviation':40.40} {'show':9} {'model':9} RMS with/without  max            stands  "
        "     named"
    )
    for text in texts:
        pairs = []
        for case in made:
            ours, other = compared(case, text)
            bad = problems(ours, other)
            failures += bool(bad)
            pairs.append((ours, other))
            print(
                f"{text or 'nominal':40.40} {case.name:9} {case.model:9} {ours.rms_deg:5.2f} "
                f"{other.rms_deg:5.2f}  {ours.max_deg:6.2f} {other.max_deg:6.2f}  "
                f"{ours.standing_deg:5.2f} {other.standing_deg:5.2f}  {_named([ours]):12} "
                f"{'; '.join(bad)}",
                flush=True,
            )
        lines.append(_line(text, pairs))
    print(f"{failures} of {len(texts) * len(made)} with harm")
    if arguments.write:
        _write(lines)
    return 1 if failures else 0


def _line(text: str, pairs: list[tuple[Outcome, Outcome]]) -> str:
    """Return a line of the table of figures."""
    ours, others = zip(*pairs, strict=True)
    worst = max(a.rms_deg / b.rms_deg for a, b in pairs)
    found = sorted({problem.split()[0] for a, b in pairs for problem in problems(a, b)})
    return (
        f"| {text or 'nominal'} | {_rms([one.rms_deg for one in ours]):.2f} / "
        f"{_rms([one.rms_deg for one in others]):.2f} | {worst:.2f} | "
        f"{max(one.standing_deg for one in ours):.2f} / "
        f"{max(one.standing_deg for one in others):.2f} | "
        f"{_named(ours)} | {', '.join(found)} |"
    )


def _named(outcomes: Iterable[Outcome]) -> str:
    """Return how many joints were named, of those that must be, and of the others."""
    must, named, others = 0, 0, 0
    for one in outcomes:
        must += len(one.observable)
        named += len(one.observable & one.findings)
        others += len(one.findings - one.observable)
    return f"{named} of {must}" + (f" and {others}" if others else "")


def _write(lines: list[str]) -> None:
    """Put the table into the page of figures."""
    page = Path(__file__).resolve().parents[1] / "FIGURES.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(MARKS[0])
    table = "\n".join([*HEAD, *lines])
    page.write_text(f"{before}{MARKS[0]}{table}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}", "utf-8")


def measure() -> list[Row]:
    """Return a row for each of a few deviations, the worst of all shows and models."""
    made = cases()
    return [_row(text, made) for text in QUICK]


def measure_full() -> list[Row]:
    """Return a row for each deviation."""
    made = cases()
    return [_row(text, made) for text in DEVIATIONS]


def _row(text: str, made: list[Case]) -> Row:
    pairs = [compared(case, text) for case in made]
    bad = [problem for ours, other in pairs for problem in problems(ours, other)]
    ratio = max(ours.rms_deg / other.rms_deg for ours, other in pairs)
    return Row(
        what=text or "nominal",
        ours=f"{_rms([o.rms_deg for o, _ in pairs]):.2f} deg, "
        f"stands {max(o.standing_deg for o, _ in pairs):.2f}, "
        f"named {_named(o for o, _ in pairs)} that must be",
        reference=f"{_rms([o.rms_deg for _, o in pairs]):.2f} deg, "
        f"stands {max(o.standing_deg for _, o in pairs):.2f} without feedback",
        ratio=ratio,
        target=f"RMS <= {HARM_RATIO:g} x, stands <= {STANDING_DEG:g} deg, limits kept, all named",
        is_met=not bad,
    )


def _rms(values: list[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
