"""Random rows of faults, the same for the same seed, for campaigns of thousands of runs."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Final

from lss_motion.sim.faults import ABOUT_LINE, INSTANT, SCALED, STEADY, Fault, FaultKind

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.robot.model import Joint, Robot

ROWS_MAX = 4
"""Chosen: enough to overlap, few enough to find the cause of a failure."""

LATE_MAX_S = 0.05
"""Chosen: beyond every timeout of a host for one reply (FACTS.md H5: 5 to 100 ms)."""

DRIFT_MAX_PPM = 200.0
"""Chosen: twice the difference of two cheap crystals."""

RAW_MAX = 1023

KINDS: Final = (
    FaultKind.LOST_COMMAND,
    FaultKind.CORRUPT_COMMAND,
    FaultKind.SHORT_COMMAND,
    FaultKind.DOUBLE_COMMAND,
    FaultKind.MERGED_COMMAND,
    FaultKind.LOST_REPLY,
    FaultKind.CORRUPT_REPLY,
    FaultKind.SHORT_REPLY,
    FaultKind.DOUBLE_REPLY,
    FaultKind.MERGED_REPLY,
    FaultKind.LATE_REPLY,
    FaultKind.SPLIT_REPLY,
    FaultKind.CLOGGED,
    FaultKind.UNPLUGGED,
    FaultKind.OVERSLEEP,
    FaultKind.CLOCK_DRIFT,
    FaultKind.DEAF,
    FaultKind.WRONG_ID,
    FaultKind.RESET,
    FaultKind.STUCK,
    FaultKind.WEAK,
    FaultKind.HOT,
    FaultKind.INPUT,
)
"""What a seed draws from. It is named, kind by kind and in this order, so that a new kind of the
simulator does not change what the seeds in the tests draw."""


def random_faults(
    seed: int,
    *,
    servo_ids: Sequence[int],
    duration_s: float,
    kinds: Sequence[FaultKind] = KINDS,
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


# -- all kinds, mixed -----------------------------------------------------------------------------

LEAD_S: Final = 4.0
"""Connecting and the way to the start take less: faults come at these phases, too."""
MIXED_MAX: Final = 3
OLD_RATIO: Final = 0.3
"""Share of rows of the kinds above among those of a mixed seed."""
RESTARTS_S: Final = (0.02, 0.1, 0.3, 0.6, 1.25)
STALLS_S: Final = (0.05, 0.2, 1.0, 5.0, 30.0)
STALL_SPAN_S: Final = 0.3
"""A host waits at least this often, so one of its waits ends in such a span and is stretched."""
SCALES: Final = (0.01, 0.1, 10.0, 100.0)
BLOCKS_S: Final = (0.05, 0.5, 3.0, 20.0, float("inf"))
SUPPLIES_V: Final = (4.0, 11.0)


def mixed_faults(seed: int, robot: Robot, duration_s: float) -> tuple[Fault, ...]:
    """Return one to three rows of any kind, the same for the same arguments."""
    random = Random(f"{seed}/mixed")
    ids = [joint.servo_id for joint in robot.joints.values()]
    rows: list[Fault] = []
    for _ in range(random.randint(1, MIXED_MAX)):
        if random.random() < OLD_RATIO:
            rows.append(_row(random.choice(KINDS), random, ids, duration_s))
        else:
            draws = AWAY if seed % 10 == AWAY_REST else DRAWS
            draw = draws[random.choice(list(draws))]
            rows += draw(random, random.choice(list(robot.joints.values())), duration_s)
    return tuple(rows)


def _at_s(random: Random, duration_s: float) -> float:
    return random.uniform(0.0, LEAD_S + duration_s)


def _restart(random: Random, joint: Joint, duration_s: float) -> list[Fault]:
    """Restart one servo or all, once, or twice close to each other."""
    at_s = _at_s(random, duration_s)
    servo_id = joint.servo_id if random.random() < 0.7 else None
    instants_s = [at_s] if random.random() < 0.6 else [at_s, at_s + random.uniform(0.0, 2.5)]
    return [
        Fault(
            kind=FaultKind.RESET,
            at_s=one_s,
            servo_id=servo_id,
            deaf_s=random.choice((*RESTARTS_S, random.uniform(0.01, 3.0))),
        )
        for one_s in instants_s
    ]


def _host_stall(random: Random, _joint: Joint, duration_s: float) -> list[Fault]:
    at_s = _at_s(random, duration_s)
    late_s = random.choice(STALLS_S)
    until_s = at_s + STALL_SPAN_S
    return [Fault(kind=FaultKind.OVERSLEEP, at_s=at_s, until_s=until_s, late_s=late_s)]


def _wrong_frame(random: Random, joint: Joint, _duration_s: float) -> list[Fault]:
    """Let gyre, origin or angular range differ from the file."""
    settings = random.choice(
        ({"G": -1}, {"O": random.choice((-300, -50, 50, 300))}, {"AR": random.choice((900, 3600))})
    )
    return [Fault(kind=FaultKind.STORED, servo_id=joint.servo_id, settings=settings)]


def _stored_limits(random: Random, joint: Joint, duration_s: float) -> list[Fault]:
    """Set stored limits far above those of the joint, and restart its servo."""
    settings = {"SD": 10 * round(joint.model.speed_max_deg_s), "AA": 100, "AD": 100}
    stored = Fault(kind=FaultKind.STORED, servo_id=joint.servo_id, settings=settings)
    return [stored, *_restart(random, joint, duration_s)]


def _other_servo(random: Random, joint: Joint, duration_s: float) -> list[Fault]:
    """Let a servo come back from the factory, or another one in its place."""
    frame = random.choice(({}, {"G": -1}, {"O": random.choice((-900, -50, 50, 900))}))
    kind = random.choice((FaultKind.FACTORY, FaultKind.EXCHANGED))
    return [
        Fault(
            kind=kind,
            at_s=_at_s(random, duration_s),
            servo_id=joint.servo_id,
            deaf_s=random.choice((0.6, 1.25, 2.5)),
            settings=frame if kind is FaultKind.EXCHANGED else {},
        )
    ]


def _other_robot(random: Random, joint: Joint, duration_s: float) -> list[Fault]:
    """Let the port of a bus go, and come back with other servos behind it."""
    at_s = _at_s(random, duration_s)
    back_s = at_s + random.choice((0.3, 1.0, 2.0))
    settings = random.choice(({}, {"G": -1}, {"O": random.choice((-900, -50, 50, 900))}))
    return [
        Fault(kind=FaultKind.UNPLUGGED, bus=joint.bus, at_s=at_s, until_s=back_s),
        Fault(
            kind=FaultKind.EXCHANGED,
            bus=joint.bus,
            at_s=at_s,
            deaf_s=back_s - at_s,
            settings=settings,
        ),
    ]


def _twin(_random: Random, joint: Joint, _duration_s: float) -> list[Fault]:
    return [Fault(kind=FaultKind.TWIN, servo_id=joint.servo_id)]


def _blocked_port(random: Random, joint: Joint, duration_s: float) -> list[Fault]:
    at_s = _at_s(random, duration_s)
    until_s = at_s + random.choice(BLOCKS_S)
    return [Fault(kind=FaultKind.BLOCKED_PORT, bus=joint.bus, at_s=at_s, until_s=until_s)]


def _low_voltage(random: Random, _joint: Joint, duration_s: float) -> list[Fault]:
    at_s = random.choice((0.0, _at_s(random, duration_s)))
    until_s = random.choice((float("inf"), at_s + random.uniform(0.05, 3.0)))
    supply_v = random.uniform(*SUPPLIES_V)
    return [Fault(kind=FaultKind.LOW_VOLTAGE, at_s=at_s, until_s=until_s, supply_v=supply_v)]


def _wrong_scale(random: Random, joint: Joint, _duration_s: float) -> list[Fault]:
    setting, scale_ratio = random.choice(SCALED), random.choice(SCALES)
    return [
        Fault(
            kind=FaultKind.WRONG_SCALE,
            servo_id=joint.servo_id,
            setting=setting,
            scale_ratio=scale_ratio,
        )
    ]


def _second_master(random: Random, joint: Joint, duration_s: float) -> list[Fault]:
    """Let another host query, move a joint, change its settings, or let it go."""
    one = f"#{joint.servo_id}"
    angle_deg = random.uniform(joint.position_min_deg, joint.position_max_deg)
    target_wire = round(joint.servo_deg(angle_deg) * joint.model.wire_per_deg)
    text = random.choice(
        (
            f"{one}QD", f"{one}QV", "#254QD", "#250QD",
            f"{one}D{target_wire}T800", f"{one}SD3600", f"{one}L", "#254H", f"{one}RESET",
        )
    )  # fmt: skip
    at_s = random.choice((0.0, _at_s(random, duration_s)))
    until_s = random.choice((float("inf"), at_s + random.uniform(0.05, 2.0)))
    every_s = random.choice((0.02, 0.1, 0.5, 2.0))
    return [
        Fault(
            kind=FaultKind.SECOND_MASTER,
            bus=joint.bus,
            at_s=at_s,
            until_s=until_s,
            text=text,
            every_s=every_s,
        )
    ]


DRAWS: Final[dict[str, Callable[[Random, Joint, float], list[Fault]]]] = {
    "restart": _restart,
    "host stall": _host_stall,
    "wrong frame": _wrong_frame,
    "stored limits": _stored_limits,
    "twin": _twin,
    "blocked port": _blocked_port,
    "low voltage": _low_voltage,
    "wrong scale": _wrong_scale,
    "second master": _second_master,
}
"""The kinds that a mixed seed draws besides those above, by name."""

AWAY: Final[dict[str, Callable[[Random, Joint, float], list[Fault]]]] = {
    "other servo": _other_servo,
    "other robot": _other_robot,
}
"""The same for the seeds with the remainder `AWAY_REST`: other servos than those before."""
AWAY_REST: Final = 4
"""Of the mixed seeds, those with this remainder by ten draw from `AWAY`."""
