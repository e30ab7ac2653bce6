"""Plays short shows with faults from seeds in virtual time, and judges bytes, horns and reports.

tools/run tools/fuzz.py                        10,000 seeds: a night's work
tools/run tools/fuzz.py --seconds 120 --jobs 2 as many as go into two minutes on two cores
tools/run tools/fuzz.py --any                  robot, show and keys from the seed, too
tools/run tools/fuzz.py --all-kinds            every kind of fault, mixed
tools/run tools/fuzz.py --from 4711 --seeds 1  one of them again
tools/run tools/fuzz.py --judge both           asks the independent judge (tools/judge), too

Promised is: it ends, and without a crash; no command leads out of a joint's range, and no horn
breaks a limit by the player's doing; damaged answers move no command further than a correction may;
the last bytes are the safe state; a show that says that all went well has its horns where it ends,
and a servo that is gone is named.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict

sys.path.insert(0, str(Path(__file__).resolve().parent))

from campaign.judge import judged
from campaign.shows import SLOW_BPS

from lss_motion.sim.faults import Fault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from campaign.judge import Judged

NIGHT_SEEDS: Final = 10_000
SAYS_EVERY_S: Final = 60.0
"""How often it says how far it has come."""
OBJECTIONS_SHOWN: Final = 4
"""One fault of the player breaks a rule with every move that follows."""


def main(argv: Sequence[str] | None = None) -> int:
    """Play the seeds; return 1 if one of them broke a promise."""
    parser = argparse.ArgumentParser(
        prog="tools/fuzz.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seeds", type=int, default=NIGHT_SEEDS, metavar="N")
    parser.add_argument("--seconds", type=float, default=float("inf"), metavar="S")
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="SEED")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--slow-bps", type=int, default=SLOW_BPS, metavar="BPS",
                        help="rate of the slowest line of the three robots")  # fmt: skip
    parser.add_argument("--any", action="store_true", help="any robot, any show, and somebody "
                        "who plays with the keys")  # fmt: skip
    parser.add_argument("--all-kinds", action="store_true", help="restarts, stalls, wrong robots, "
                        "low supply, a second host and all others, mixed")  # fmt: skip
    parser.add_argument("--judge", choices=("own", "independent", "both"), default="own",
                        help="the campaign's judge, the one of tools/judge, or both")  # fmt: skip
    arguments = parser.parse_args(argv)
    again = "tools/run tools/fuzz.py"
    again += " --any" if arguments.any else f" --slow-bps {arguments.slow_bps}"
    again += " --all-kinds" if arguments.all_kinds else ""
    again += "" if arguments.judge == "own" else f" --judge {arguments.judge}"
    started_s = said_s = time.monotonic()
    outcomes: Counter[str] = Counter()
    failed = 0
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with tempfile.TemporaryDirectory() as plans:
        os.environ["LSS_MOTION_CACHE_DIR"] = plans  # A million shows that are played once.
        play = partial(
            judged,
            is_any=arguments.any,
            slow_bps=arguments.slow_bps,
            is_mixed=arguments.all_kinds,
            judges=arguments.judge,
        )
        for seed, result in _played(seeds, arguments.jobs, play):
            outcomes[result.outcome] += 1
            failed += bool(result.broken or result.objections)
            _tell(seed, result, again)
            now_s = time.monotonic()
            if now_s - said_s > SAYS_EVERY_S:
                said_s = now_s
                print(_summary(outcomes, failed, now_s - started_s), flush=True)
            if now_s - started_s > arguments.seconds:
                break
    print(_summary(outcomes, failed, time.monotonic() - started_s))
    return 1 if failed else 0


def _played(
    seeds: Sequence[int], jobs: int, play: Callable[[int], Judged]
) -> Iterator[tuple[int, Judged]]:
    """Yield what became of the seeds, in their order."""
    if jobs == 1:
        yield from zip(seeds, map(play, seeds), strict=True)
        return
    with multiprocessing.Pool(jobs) as pool:
        yield from zip(seeds, pool.imap(play, seeds), strict=True)


def _tell(seed: int, result: Judged, again: str) -> None:
    if not result.broken and not result.objections:
        return
    for promise in result.broken:
        print(f"seed {seed}: {promise}")
    for objection in result.objections[:OBJECTIONS_SHOWN]:
        print(f"seed {seed}: objection: {objection}")
    for fault in result.faults:
        print(f"  {_row(fault)}")
    print(f"  {again} --from {seed} --seeds 1", flush=True)


def _row(fault: Fault) -> str:
    """Return a fault as a row of a faults file: what differs from the defaults."""
    plain = asdict(Fault(kind=fault.kind, until_s=fault.until_s))
    row = {name: value for name, value in asdict(fault).items() if value != plain[name]}
    return f"{fault.kind} until {fault.until_s:g} s {row}"


def _summary(outcomes: Counter[str], failed: int, passed_s: float) -> str:
    said = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    return f"{outcomes.total()} seeds in {passed_s:.0f} s: {said}; {failed} broke a promise"


if __name__ == "__main__":
    sys.exit(main())
