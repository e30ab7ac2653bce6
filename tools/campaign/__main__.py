"""Plays what seeds say in virtual time, and judges it.

tools/run python tools/campaign shows            short shows with faults: a night's work
tools/run python tools/campaign shows --seconds 120 --jobs 2 --all-kinds --judge both
tools/run python tools/campaign walks            robots that are steered as they walk
tools/run python tools/campaign stages           a weekend of the haunted hall
tools/run python tools/campaign readers          damaged files of every foreign format
tools/run python tools/campaign shows --from 4711 --seeds 1

Each seed that broke a promise is printed with the command that plays it again.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shlex
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from campaign import anchors, hands, interrupts, live_edits, readers, shows, stages, walks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from campaign import Told

KINDS: Final = {
    "anchors": anchors,
    "shows": shows,
    "walks": walks,
    "stages": stages,
    "readers": readers,
    "hands": hands,
    "interrupts": interrupts,
    "live_edits": live_edits,
}
SAYS_EVERY_S: Final = 60.0
"""How often it says how far it has come."""
SHOWN: Final = 6
"""One fault of the player breaks a rule with every move that follows."""


def main(argv: Sequence[str] | None = None) -> int:
    """Play the seeds; return 1 if one of them broke a promise."""
    arguments = _parser().parse_args(argv)
    play = partial(KINDS[arguments.kind].play, options=arguments)
    started_s = said_s = time.monotonic()
    outcomes: Counter[str] = Counter()
    failed = 0
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with tempfile.TemporaryDirectory() as plans:
        os.environ["LSS_MOTION_CACHE_DIR"] = plans  # A million shows that are played once.
        for seed, told in _played(seeds, arguments.jobs, play):
            outcomes[told.outcome] += 1
            failed += bool(told.broken)
            _show(seed, told, sys.argv[1:] if argv is None else argv)
            now_s = time.monotonic()
            if now_s - said_s > SAYS_EVERY_S:
                said_s = now_s
                print(_summary(outcomes, failed, now_s - started_s), flush=True)
            if now_s - started_s > arguments.seconds:
                break
    print(_summary(outcomes, failed, time.monotonic() - started_s))
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tools/campaign",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    kinds = parser.add_subparsers(dest="kind", required=True)
    for name, module in KINDS.items():
        assert module.__doc__ is not None
        kind = kinds.add_parser(name, description=module.__doc__)
        kind.add_argument("--from", type=int, default=0, dest="first", metavar="SEED")
        kind.add_argument("--seeds", type=int, default=module.SEEDS, metavar="N")
        kind.add_argument("--seconds", type=float, default=float("inf"), metavar="S")
        kind.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
        module.add_to(kind)
    return parser


def _played(
    seeds: Sequence[int], jobs: int, play: Callable[[int], Told]
) -> Iterator[tuple[int, Told]]:
    """Yield what became of the seeds, in their order."""
    if jobs == 1:
        yield from zip(seeds, map(play, seeds), strict=True)
        return
    with multiprocessing.Pool(jobs) as pool:
        yield from zip(seeds, pool.imap(play, seeds), strict=True)


def _show(seed: int, told: Told, words: Sequence[str]) -> None:
    if told.line:
        print(f"seed {seed}: {told.line}", flush=True)
    if not told.broken:
        return
    for promise in told.broken[:SHOWN]:
        print(f"seed {seed}: FAILED: {promise}")
    for line in told.about:
        print(f"  {line}")
    print(f"  tools/run python tools/campaign {again(seed, words)}", flush=True)


def again(seed: int, words: Sequence[str]) -> str:
    """Return the words that play one seed as these do."""
    kept, rest = [], iter(words)
    for word in rest:
        name, _, value = word.partition("=")
        if name not in ("--from", "--seeds", "--seconds", "--jobs"):
            kept.append(word)
        elif not value:
            next(rest)
    return f"{shlex.join(kept)} --from {seed} --seeds 1"


def _summary(outcomes: Counter[str], failed: int, passed_s: float) -> str:
    said = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    return f"{outcomes.total()} seeds in {passed_s:.0f} s: {said}; {failed} broke a promise"


if __name__ == "__main__":
    sys.exit(main())
