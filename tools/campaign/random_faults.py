"""Random rows of faults, the same for the same seed, for campaigns of thousands of runs."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from lss_motion.sim.faults import ABOUT_LINE, INSTANT, STEADY, Fault, FaultKind

if TYPE_CHECKING:
    from collections.abc import Sequence

ROWS_MAX = 4
"""Chosen: enough to overlap, few enough to find the cause of a failure."""

LATE_MAX_S = 0.05
"""Chosen: beyond every timeout of a host for one reply (FACTS.md H5: 5 to 100 ms)."""

DRIFT_MAX_PPM = 200.0
"""Chosen: twice the difference of two cheap crystals."""

RAW_MAX = 1023


def random_faults(
    seed: int,
    *,
    servo_ids: Sequence[int],
    duration_s: float,
    kinds: Sequence[FaultKind] = tuple(FaultKind),
) -> tuple[Fault, ...]:
    """Return one to four rows of these kinds, the same for the same arguments."""
    random = Random(f"{seed}/rows")
    return tuple(
        _row(random.choice(kinds), random, servo_ids, duration_s)
        for _ in range(random.randint(1, ROWS_MAX))
    )


def _row(kind: FaultKind, random: Random, servo_ids: Sequence[int], duration_s: float) -> Fault:
    at_s = random.uniform(0.0, duration_s)
    lasts_s = random.uniform(0.0, duration_s / 2.0)
    needs_end = kind is FaultKind.CLOGGED or random.random() < 0.75
    is_about_one = kind not in ABOUT_LINE and (kind is FaultKind.WRONG_ID or random.random() < 0.75)
    return Fault(
        kind=kind,
        at_s=at_s,
        until_s=at_s + lasts_s if needs_end and kind not in INSTANT else float("inf"),
        servo_id=random.choice(servo_ids) if is_about_one else None,
        ratio=1.0 if kind in STEADY else random.choice((0.01, 0.1, 0.5, 1.0)),
        late_s=random.uniform(0.0, LATE_MAX_S),
        as_id=random.choice(servo_ids),
        speed_ratio=random.uniform(0.05, 0.9),
        temperature_c=random.uniform(40.0, 100.0),
        drift_ppm=random.uniform(-DRIFT_MAX_PPM, DRIFT_MAX_PPM),
        raw=random.randint(0, RAW_MAX),
    )
