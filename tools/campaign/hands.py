"""Joints in the hands of a person (`jog`, the Robot page) with faults, in virtual time.

A person turns joints to and fro, faster and further than they may. Restarts, other servos and
robots, stalls and lost ports come from the seed. The independent judge (`tools/judge`) looks at
bytes and horns: no move without the settings, none out of a range, none faster than the limit, and
the last bytes are safe.
"""

from __future__ import annotations

from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

from judge.verdict import objections
from msgspec.structs import replace

from campaign import Told
from campaign.outside import record_of, recording_of, robot_of
from campaign.random_faults import AWAY, DRAWS
from campaign.shows import row_of
from campaign.three_shows import NAMES, show
from campaign.witness import Witness
from lss_motion.errors import LssMotionError
from lss_motion.playing.connection import connect
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.player.events import Phase
from lss_motion.playing.runner import run
from lss_motion.sim.faults import Fault, FaultKind, SleepyClock
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    import argparse

SEEDS: Final = 1_000
LASTS_S: Final = 6.0
STEP_NS: Final = NS_PER_S // 20
BPS: Final = 57_600
KINDS: Final = ("restart", "host stall", "stored limits", "low voltage")
TOLERANCE_DEG: Final = 0.2


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind: there are none."""
    del parser


class _Person(Witness):
    """Turns joints to and fro, and records all."""

    def __init__(self, random: Random, names: list[str]) -> None:
        super().__init__()
        self._random, self._names = random, names
        self._sent_ns = 0

    def act(self, driven: Any, now_ns: int) -> None:  # noqa: ANN401  (`HandsOn`)
        self.end_ns = now_ns
        if driven.phase is not Phase.SHOW or now_ns < NS_PER_S:
            return
        if now_ns > LASTS_S * NS_PER_S:
            driven.stop()
            return
        if now_ns < self._sent_ns + STEP_NS:
            return
        self._sent_ns = now_ns
        name = self._random.choice(self._names)
        driven.take()
        if name in driven.readings:
            way_deg = self._random.uniform(-40.0, 40.0)
            target_deg = driven.readings[name].deg + way_deg
            driven.move(name, target_deg, self._random.uniform(0.05, 0.5))


def play(seed: int, options: argparse.Namespace) -> Told:
    """Play one seed."""
    del options
    random = Random(f"{seed}/hands")
    robot = show(NAMES[seed % len(NAMES)], BPS).robot
    joints = [one for one in robot.joints.values() if one.drive == "timed"]
    draws = [*(DRAWS[name] for name in KINDS), *AWAY.values()]
    faults: list[Fault] = []
    for _ in range(random.randint(1, 2)):
        faults += random.choice(draws)(random, random.choice(joints), 3.0)
    person = _Person(random, [one.name for one in joints])
    robot = replace(robot, joints={one.name: one for one in joints})
    rows = tuple(map(row_of, faults))
    hands = HandsOn(robot, [one.name for one in joints])
    clock = SleepyClock(faults, seed=seed)
    try:
        kept = [one for one in faults if one.kind is not FaultKind.OVERSLEEP]
        with connect(robot.buses, robot=robot, clock=clock, seed=seed, faults=kept) as connection:
            run(hands, connection.ports, clock, controls=person, tap=person)
    except LssMotionError as error:
        return Told(type(error).__name__)
    except Exception as error:  # noqa: BLE001  (a crash of any kind is what is looked for)
        return Told("crashed", (f"it crashed: {error!r}",), rows)
    for bus in connection.simulated.values():
        bus.advance(person.end_ns + NS_PER_S)
    result: Any = SimpleNamespace(simulated=connection.simulated)
    record = record_of(robot, faults, person, result)
    broken = [str(one) for one in objections(recording_of(robot_of(robot, TOLERANCE_DEG), record))]
    return Told("ended" if hands.error is None else "refused", tuple(broken), rows)
