"""Plays short shows with faults from seeds in virtual time, and judges what was sent, heard, done.

tools/run tools/fuzz.py --seeds 100            seeds 0 to 99
tools/run tools/fuzz.py --seeds 10000          a night's work
tools/run tools/fuzz.py --seconds 120          as many as go into two minutes
tools/run tools/fuzz.py --from 4711 --seeds 1  one of them again

Promised is: it ends, and without a crash; no command leads out of a joint's range, and no horn
breaks a limit by the player's doing; damaged answers move no command further than a correction may;
the last bytes are the safe state; a show that says that all went well has its horns where it ends,
and a servo that is gone is named.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))

from campaign.judge import judged

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Play the seeds; return 1 if one of them broke a promise."""
    parser = argparse.ArgumentParser(
        prog="tools/fuzz.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
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
        result = judged(seed)
        outcomes[result.outcome] = outcomes.get(result.outcome, 0) + 1
        for promise in result.broken:
            print(f"seed {seed}: {promise}", flush=True)
        if result.broken:
            failed += 1
            print("\n".join(f"  {fault}" for fault in result.faults))
            print(f"  tools/run tools/fuzz.py --from {seed} --seeds 1", flush=True)
    said = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    print(f"{sum(outcomes.values())} seeds: {said}; {failed} broke a promise")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
