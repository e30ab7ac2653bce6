"""Plays shows with faults from seeds in virtual time, and judges at the servos.

tools/run tools/fuzz.py --seeds 100            seeds 0 to 99
tools/run tools/fuzz.py --seeds 10000          a night's work
tools/run tools/fuzz.py --seconds 120          as many as go into two minutes
tools/run tools/fuzz.py --from 4711 --seeds 1  one of them again
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion import api
from lss_motion.cli.shows import prepare
from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.sim.random_faults import random_faults

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.cli.shows import Show

SEQUENCES: Final = Path(__file__).resolve().parent.parent / "sequences"
SHOWS: Final = ("wave", "show", "quadruped_trot")
"""Three robots; `show` has the most joints."""
OVER_S: Final = 300.0
"""A show that takes so much longer than planned, with all its waits, hangs."""
MOVE: Final = re.compile(rb"#(\d+)D(-?\d+)(?:T\d+)?\r")
SAFE: Final = (b"#254H\r", b"#254L\r")


def main(argv: Sequence[str] | None = None) -> int:
    """Play the seeds; return 1 if one of them broke a promise."""
    parser = argparse.ArgumentParser(prog="tools/fuzz.py", description=__doc__)
    parser.add_argument("--seeds", type=int, default=1_000_000, metavar="N")
    parser.add_argument("--seconds", type=float, default=float("inf"), metavar="S")
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="SEED")
    arguments = parser.parse_args(argv)
    started_s = time.monotonic()
    outcomes: dict[str, int] = {}
    failed = 0
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        if time.monotonic() - started_s > arguments.seconds:
            break
        outcome, broken = judged(seed)
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
        for promise in broken:
            print(f"seed {seed}: {promise}\n  tools/run tools/fuzz.py --from {seed} --seeds 1")
        failed += bool(broken)
    said = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    print(f"{sum(outcomes.values())} seeds: {said}; {failed} broke a promise")
    return 1 if failed else 0


@cache
def _show(name: str) -> Show:
    return prepare(SEQUENCES / f"{name}.yaml", None)


class _Sent:
    """A tap that keeps what the host wrote, per bus."""

    def __init__(self) -> None:
        self.data: dict[str, bytearray] = {}

    def sent(self, bus: str, data: bytes, _: int) -> None:
        self.data.setdefault(bus, bytearray()).extend(data)

    def received(self, *_: object) -> None:
        """Say nothing: what the servos answer is their affair."""

    happened = turned = received


def judged(seed: int) -> tuple[str, list[str]]:
    """Play one seed; return what became of the show and which promises were broken."""
    show = _show(SHOWS[seed % len(SHOWS)])
    robot, sent, broken = show.robot, _Sent(), []
    servo_ids = [joint.servo_id for joint in robot.joints.values()]
    faults = random_faults(seed, servo_ids=servo_ids, duration_s=show.program.duration_s)
    observer = api.Observer(make_tap=lambda _: sent)
    try:
        result = api.perform(
            show.program, robot, is_virtual=True, seed=seed, faults=faults, observer=observer
        )
    except (BusError, InputError, PlaybackError):
        return "refused", []
    report = result.report
    if report["run_s"] > 100.0 * show.program.duration_s + OVER_S:
        broken.append(f"it took {report['run_s']:.0f} s")
    if report["outcome"] == "fault" and not report["faults"] and result.error is None:
        broken.append("it ended with a fault and names none")
    joints = {(joint.bus, joint.servo_id): joint for joint in robot.joints.values()}
    for bus, data in sent.data.items():
        moved = False
        for match in MOVE.finditer(bytes(data)):
            moved = True
            joint = joints[bus, int(match[1])]
            angle_deg = joint.joint_deg(int(match[2]) / joint.model.wire_per_deg)
            unit_deg = 1.0 / joint.model.wire_per_deg
            low_deg, high_deg = joint.position_min_deg, joint.position_max_deg
            if not low_deg - unit_deg <= angle_deg <= high_deg + unit_deg:
                broken.append(f"{joint.name} was sent to {angle_deg:.1f} deg")
        if moved and not bytes(data).endswith(SAFE) and report["outcome"] != "lost":
            broken.append(f"the last bytes on bus {bus} are {bytes(data[-20:])!r}")
    return report["outcome"], broken


if __name__ == "__main__":
    sys.exit(main())
