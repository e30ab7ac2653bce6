"""What `identify --from` makes of the logs of random shows, judged by the simulator's truth.

tools/run tools/benches/random_logs.py                       80 seeds
tools/run tools/benches/random_logs.py --from 40 --seeds 1
tools/run tools/benches/random_logs.py --fit                 without playing the found models

Show, robot, servos and seed of the simulator come from the seed; every fourth show is one of
`sequences`. For each number that is stated with a standard error, the distance from the truth in
units of that error is counted. Then the show is played again with what would be written, from the
same phase of the control loops (`in_phase`), and the horns are compared with the first time.

Measured: `tools/FIGURES.md`. A joint costs one to three seconds of computing.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]

import numpy as np  # noqa: E402

from benches.in_phase import Beginning, horn_rms_deg, play_in_phase  # noqa: E402
from benches.random_robots import show_from  # noqa: E402
from benches.shows import lively_show, robot_of  # noqa: E402
from lss_motion.errors import InputError, PlaybackError  # noqa: E402
from lss_motion.maintenance.identify.estimate import response_values  # noqa: E402
from lss_motion.maintenance.identify.show_fit import identify_from_show  # noqa: E402
from lss_motion.maintenance.identify.show_pieces import LoggedBytes, recordings  # noqa: E402
from lss_motion.playing import api  # noqa: E402
from lss_motion.robot.load import load_robot, within_ramps  # noqa: E402
from lss_motion.robot.servo_models import SERVO_MODELS  # noqa: E402
from lss_motion.sim.deviation import deviation_from_text  # noqa: E402
from lss_motion.sim.physics import TICK_NS  # noqa: E402
from lss_motion.units import s_from_ns  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lss_motion.maintenance.identify.estimate import Identified
    from lss_motion.maintenance.identify.show_pieces import ShowRecording
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.deviation import Deviation

ROOT: Final = Path(__file__).resolve().parents[2]
SHOWS: Final = {
    "wave": "desk_arm",
    "tracks": "figure",
    "owl": "owl",
}
"""Shows of `sequences`, with their robots."""
HARM_RATIO: Final = 1.02
HARM_DEG: Final = 0.02
"""RMS may be larger by one of both with the model that was found."""
WRITTEN: Final = ("delay", "ramp")
"""What is written into a robot file with an error; the rest is printed."""


class Tape:
    """A tap that keeps what a log holds about bytes."""

    def __init__(self) -> None:
        """Begin empty; `begun` is the `make_tap` of an observer."""
        self.logged: list[LoggedBytes] = []
        self._start_ns = 0

    def begun(self, start_ns: int) -> Tape:
        """Take the begin of a run."""
        self._start_ns = start_ns
        return self

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        """Keep what left."""
        self.logged.append(LoggedBytes(now_ns - self._start_ns, bus, is_sent=True, data=data))

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        """Keep what came."""
        self.logged.append(LoggedBytes(now_ns - self._start_ns, bus, is_sent=False, data=data))

    def turned(self, now_ns: int) -> None:
        """Keep nothing: turns, events and notes say nothing about a servo."""

    def happened(self, *_: object) -> None:
        """Keep nothing."""

    requested = noted = happened


@dataclass(frozen=True, slots=True)
class Case:
    """A seed's show, robot and servos."""

    seed: int
    kind: str
    robot: Robot
    trajectory: Trajectory
    text: str

    @property
    def deviation(self) -> Deviation:
        """How the servos differ from the robot file."""
        return deviation_from_text(self.text)


@dataclass(frozen=True, slots=True)
class Stated:
    """A number with its error, and the truth."""

    what: str
    value: float
    error: float
    true: float

    @property
    def sigmas(self) -> float:
        """How many errors it is off."""
        return (self.value - self.true) / self.error if self.error else 0.0


def deviation_of(random: Random) -> str:
    """Return how the servos of a case differ: up to three of the model, and disturbances."""
    model = {
        "lag": lambda: f"{random.uniform(-10, 80):+.0f}ms",
        "dead": lambda: f"{random.uniform(5, 60):.0f}ms",
        "ramp": lambda: f"{math.exp(random.uniform(math.log(0.1), math.log(1.5))):.2f}",
        "t_law": lambda: "exact",
        "retarget": lambda: "from_rest",
        "motor": lambda: f"{random.uniform(25, 90):.0f}%",
        "backlash": lambda: f"{random.uniform(0.3, 1.5):.1f}deg",
        "droop": lambda: f"{random.choice((-1, 1)) * random.uniform(0.5, 4.0):.1f}deg",
    }
    line = {
        "noise": lambda: f"{random.uniform(0.1, 0.5):.1f}deg",
        "usb": lambda: f"{random.uniform(2, 16):.0f}ms",
        "lost": lambda: f"{random.uniform(0.3, 1.5):.1f}%",
        "corrupt": lambda: f"{random.uniform(0.3, 1.5):.1f}%",
    }
    chosen = random.sample(list(model), random.choice((0, 1, 1, 2, 2, 3)))
    chosen += random.sample(list(line), random.choice((0, 0, 0, 1)))
    words: dict[str, Callable[[], str]] = {**model, **line}
    return ",".join(f"{key}={words[key]()}" for key in chosen)


def robot_from(random: Random) -> Robot:
    """Return a robot of one to three timed joints, LSS or LSS-PRO."""
    model = SERVO_MODELS[random.choice(("LSS-ST1", "LSS-HT1", "LSS-P-S1"))]
    robot = robot_of(random.randint(1, 3), baud_bps=random.choice((38_400, 115_200, 921_600)))
    speed_deg_s, accel_deg_s2 = random.uniform(100, 350), 10.0 * random.randint(40, 100)
    return replace(
        robot,
        joints={
            name: replace(
                joint,
                model=model,
                speed_max_deg_s=min(speed_deg_s, model.speed_max_deg_s),
                accel_max_deg_s2=accel_deg_s2,
                following_deg=90.0,
            )
            for name, joint in robot.joints.items()
        },
    )


def case_of(seed: int) -> Case | None:
    """Return the case of a seed; None: this robot cannot play such a show."""
    random = Random(f"{seed}/log")  # noqa: S311
    if seed % 4 == 3:
        kind = random.choice(list(SHOWS))
        robot = load_robot(ROOT / f"sequences/robots/{SHOWS[kind]}.yaml")
        robot = replace(
            robot,
            joints={name: replace(one, following_deg=90.0) for name, one in robot.joints.items()},
        )
        show = api.load_sequence(ROOT / f"sequences/{kind}.yaml", robot)
    else:
        kind = random.choice(("fast", "mixed", "holds", "lively", "lively", "lively"))
        robot, lasts_s = robot_from(random), random.choice((12.0, 24.0))
        if kind == "lively":
            show = lively_show(robot, lasts_s, seed=seed)
        else:
            show = show_from(random, robot, kind, lasts_s)
    text = deviation_of(random)
    try:
        return Case(seed, kind, robot, api.plan(show, robot), text)
    except InputError:
        return None


def recorded(case: Case) -> tuple[dict[str, ShowRecording], float, int, str]:
    """Play a case; return its log by joint, RMS of the horns, begin of the show, and outcome."""
    tape = Tape()
    result, begun_ns = play_in_phase(
        api.compile(case.trajectory, case.robot),
        case.robot,
        case.trajectory,
        has_feedback=True,
        seed=case.seed,
        deviation=case.deviation,
        make_tap=tape.begun,
    )
    rms_deg = horn_rms_deg(result, case.trajectory)
    return recordings(tape.logged, case.robot), rms_deg, begun_ns, result.report.outcome


def stated(found: Identified, joint: Joint, deviation: Deviation) -> Iterator[Stated]:
    """Yield what is stated of a joint as certain enough, and what is true."""
    physics = deviation.physics()
    steps = joint.settings.get("AS", 0.0)
    lag_s = physics.lag_s / physics.lag_per_stiffness_ratio**steps
    wait_s = physics.dead_s + 0.5 * s_from_ns(TICK_NS)
    if "lag_s" not in found.unsure:
        yield Stated("delay", *found.delay_s, wait_s + lag_s)
    if "ramp_ratio" not in found.unsure:
        ratio = physics.ramp_ratio * physics.ramp_per_stiffness_ratio**steps
        yield Stated("ramp", *found.accel_deg_s2, ratio * found.ramp_deg_s2)
    yield Stated("lag alone", *found.lag_s, lag_s)
    if found.is_top:
        top_deg_s = deviation.motor_ratio * joint.model.speed_max_deg_s
        yield Stated("top speed", *found.top_deg_s, top_deg_s)
    if not deviation.droop_deg:
        yield Stated("play", *found.play_deg, deviation.backlash_deg)
        yield Stated("load", found.droop_deg[1], found.droop_error_deg, 0.0)


def laws(found: Identified, deviation: Deviation) -> Iterator[tuple[str, str]]:
    """Yield for both laws whether they are open, right or wrong."""
    for law in ("retarget", "t_law"):
        value, is_sure = getattr(found, law)
        verdict = "right" if value == getattr(deviation, law) else "WRONG"
        yield law, verdict if is_sure else "open"


def identified(logs: dict[str, ShowRecording]) -> dict[str, Identified | PlaybackError]:
    """Return what each log tells, or why it tells nothing."""
    found: dict[str, Identified | PlaybackError] = {}
    for name, recording in logs.items():
        try:
            found[name] = identify_from_show(recording)
        except PlaybackError as error:
            found[name] = error
    return found


def played_again(case: Case, better: Robot, begun_ns: int) -> float:
    """Return the RMS of the horns with another model of the robot; NaN: it cannot be planned."""
    try:
        program = api.compile(case.trajectory, better)
    except InputError:
        return math.nan
    result, _ = play_in_phase(
        program,
        better,
        case.trajectory,
        has_feedback=True,
        seed=case.seed,
        deviation=case.deviation,
        beginning=Beginning(begun_ns),
    )
    return horn_rms_deg(result, case.trajectory)


def with_models(robot: Robot, found: dict[str, Identified | PlaybackError]) -> Robot:
    """Return the robot with what would be written into its file."""
    joints = dict(robot.joints)
    for name, one in found.items():
        if not isinstance(one, PlaybackError):
            values: dict[str, Any] = {**response_values(one, joints[name])}
            response = replace(joints[name].response, **values)
            joints[name] = within_ramps(replace(joints[name], response=response))
    return replace(robot, joints=joints)


class Tally:
    """Counts over all cases."""

    def __init__(self) -> None:
        """Begin with none."""
        self.numbers: dict[str, list[float]] = defaultdict(list)
        self.laws: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
        self.refused: dict[str, int] = defaultdict(int)
        self.joints = 0
        self.ratios: list[float] = []
        self.harmed = 0

    def take(self, case: Case, found: dict[str, Identified | PlaybackError]) -> Iterator[str]:
        """Count a case; yield a line for each of its joints."""
        for name, one in found.items():
            self.joints += 1
            if isinstance(one, PlaybackError):
                self.refused[type(one).__name__] += 1
                yield f"  {name}: {one}"
                continue
            told = list(stated(one, case.robot.joints[name], case.deviation))
            verdicts = dict(laws(one, case.deviation))
            for law, verdict in verdicts.items():
                self.laws[law][verdict] += 1
            for number in told:
                self.numbers[number.what].append(number.sigmas)
            text = ", ".join(
                f"{n.what} {n.value:.4g} ± {n.error:.2g} ({n.true:.4g}: {n.sigmas:+.1f})"
                for n in told
            )
            yield f"  {name}: {text}, {verdicts['retarget']} {verdicts['t_law']}"

    def lines(self) -> Iterator[str]:
        """Yield the table."""
        refused = ", ".join(f"{text} {count}" for text, count in self.refused.items())
        yield f"{self.joints} joints; not measured: {refused or 'none'}"
        measured = self.joints - sum(self.refused.values())
        for what, sigmas in self.numbers.items():
            off = np.abs(sigmas)
            shares = [f"{100 * float(np.mean(off <= most)):.1f} %" for most in (1, 2, 3)]
            yield (
                f"{what:10} stated {len(off):4} of {measured}, within 1, 2, 3 errors "
                f"{', '.join(shares)}, worst {float(off.max()):.1f}"
            )
        written = np.abs([s for what in WRITTEN for s in self.numbers[what]])
        shares = [f"{100 * float(np.mean(written <= most)):.1f} %" for most in (1, 2, 3)]
        yield f"written    {len(written)}, within 1, 2, 3 errors {', '.join(shares)}"
        for law, verdicts in self.laws.items():
            yield f"{law:10} " + ", ".join(f"{text} {n}" for text, n in sorted(verdicts.items()))
        if self.ratios:
            quantiles = np.percentile(self.ratios, (0, 10, 50, 90, 100))
            yield (
                f"horns with the found models, RMS over that with the file's: least, 10 %, median, "
                f"90 %, most {', '.join(f'{ratio:.2f}' for ratio in quantiles)}; worse in "
                f"{self.harmed} of {len(self.ratios)}"
            )


def main() -> int:
    """Play the seeds; return 1 if a found model did harm."""
    parser = argparse.ArgumentParser(prog="tools/benches/random_logs.py", description=__doc__)
    parser.add_argument("--seeds", type=int, default=80, metavar="N")
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="SEED")
    parser.add_argument("--fit", action="store_true", help="do not play the found models")
    arguments = parser.parse_args()
    tally = Tally()
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        if (case := case_of(seed)) is None:
            continue
        logs, before_deg, begun_ns, outcome = recorded(case)
        found = identified(logs)
        lines = list(tally.take(case, found))
        text = f"{before_deg:.2f}"
        if not arguments.fit and outcome == "finished":
            after_deg = played_again(case, with_models(case.robot, found), begun_ns)
            is_worse = after_deg > max(HARM_RATIO * before_deg, before_deg + HARM_DEG)
            if any(not isinstance(one, PlaybackError) for one in found.values()):
                tally.ratios.append(after_deg / before_deg)
            tally.harmed += is_worse
            text += f" {after_deg:.2f}{' WORSE' if is_worse else ''}"
        model = next(iter(case.robot.joints.values())).model.name
        print(f"{seed:5} {case.kind:7} {model:8} {case.text or 'nominal':40} {outcome} {text}")
        print("\n".join(lines), flush=True)
    print("\n".join(tally.lines()))
    return 1 if tally.harmed else 0


if __name__ == "__main__":
    sys.exit(main())
