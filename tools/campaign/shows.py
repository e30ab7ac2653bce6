"""Short shows with faults: robot, show, faults and keys from a seed.

Promised is: it ends, and without a crash; no command leads out of a joint's range, and no horn
breaks a limit by the player's doing; damaged answers move no command further than a correction may;
the last bytes are the safe state; a show that says that all went well has its horns where it ends,
and a servo that is gone is named.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict

from campaign import Told
from campaign.judge import judged
from campaign.three_shows import SLOW_BPS
from lss_motion.sim.faults import Fault

if TYPE_CHECKING:
    import argparse

SEEDS: Final = 10_000
"""A night's work."""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind."""
    parser.add_argument("--slow-bps", type=int, default=SLOW_BPS, metavar="BPS",
                        help="rate of the slowest line of the three robots")  # fmt: skip
    parser.add_argument("--any", action="store_true", help="any robot, any show, and somebody "
                        "who plays with the keys")  # fmt: skip
    parser.add_argument("--all-kinds", action="store_true", help="restarts, stalls, wrong robots, "
                        "low supply, a second host and all others, mixed")  # fmt: skip
    parser.add_argument("--judge", choices=("own", "independent", "both"), default="own",
                        help="the campaign's judge, the one of tools/judge, or both")  # fmt: skip


def play(seed: int, options: argparse.Namespace) -> Told:
    """Play one show."""
    result = judged(
        seed,
        is_any=options.any,
        slow_bps=options.slow_bps,
        is_mixed=options.all_kinds,
        judges=options.judge,
    )
    objections = [f"objection: {one}" for one in result.objections]
    rows = tuple(row_of(fault) for fault in result.faults)
    return Told(result.outcome, (*result.broken, *objections), rows)


def row_of(fault: Fault) -> str:
    """Return a fault as a row of a faults file: what differs from the defaults."""
    plain = asdict(Fault(kind=fault.kind, until_s=fault.until_s))
    row = {name: value for name, value in asdict(fault).items() if value != plain[name]}
    return f"{fault.kind} until {fault.until_s:g} s {row}"
