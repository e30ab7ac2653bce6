"""Changes between shows: from the trigger to the first byte, how long they take, and memory.

    tools/run python tools/stage_changes.py              400 changes in virtual time
    tools/run python tools/stage_changes.py --real       20 changes in real time
    tools/run python tools/stage_changes.py --changes N

Two endless shows of six timed joints take turns, at random instants of them.
"""

from __future__ import annotations

import argparse
import gc
import resource
import sys
from random import Random
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.playing import api
from lss_motion.playing.perform import Observer
from lss_motion.playing.player.events import ShowBegan
from lss_motion.playing.stage_run import perform_stage
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence

if TYPE_CHECKING:
    from collections.abc import Sequence as Rows

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.player import Player

JOINTS: Final = tuple(f"j{index}" for index in range(6))
NS_PER_MS: Final = 1_000_000


def robot() -> Robot:
    """Return a robot of timed joints on one line."""
    joints = {
        name: Joint(
            name=name,
            servo_id=index + 1,
            bus="main",
            model=SERVO_MODELS["LSS-ST1"],
            position_min_deg=-90.0,
            position_max_deg=90.0,
            speed_max_deg_s=180.0,
            accel_max_deg_s2=800.0,
        )
        for index, name in enumerate(JOINTS)
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="changing", path=None, buses={"main": bus}, joints=joints)


def program(on: Robot, seed: int) -> Program:
    """Return an endless show of all joints."""
    random = Random(seed)  # noqa: S311  (no secret)
    frames = [Keyframe(deg=dict.fromkeys(JOINTS, 0.0), at_s=0.0)]
    for number in range(1, 5):
        deg = {name: random.uniform(-40.0, 40.0) for name in JOINTS}
        frames.append(Keyframe(deg=deg, at_s=0.8 * number))
    frames.append(Keyframe(deg=dict.fromkeys(JOINTS, 0.0), at_s=4.0))
    sequence = Sequence(name="swing", keyframes=tuple(frames), loop=None)
    return api.compile(api.plan(sequence, on), on)


class Changer:
    """Triggers changes at random instants of the shows, as controls and as a tap."""

    def __init__(self, changes: int) -> None:
        self.first_byte_ns: list[int] = []
        self.took_ns: list[int] = []
        self.memory_kb: list[int] = []
        self._random = Random(1)  # noqa: S311  (no secret)
        self._left = changes
        self._triggered_ns: int | None = None
        self._is_sent = True
        self._next_ns: int | None = None
        self._began = False

    def filenos(self) -> Rows[int]:
        return []

    def on_event(self, event: object) -> None:
        self._began = self._began or isinstance(event, ShowBegan)

    def act(self, player: Player, now_ns: int) -> None:
        if self._began:
            self._began = False
            if self._triggered_ns is not None:
                self.took_ns.append(now_ns - self._triggered_ns)
            self._next_ns = now_ns + round(self._random.uniform(0.2, 1.5) * 1e9)
            if self._left % 50 == 0:
                self.memory_kb.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
        if self._next_ns is None or now_ns < self._next_ns:
            return
        self._next_ns, self._left = None, self._left - 1
        if self._left < 0:
            player.stop(now_ns)
            return
        self._triggered_ns, self._is_sent = now_ns, False
        name = ("a", "b")[self._left % 2]
        player.change_to(player.repertoire.programs[name], now_ns)

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        if not self._is_sent and self._triggered_ns is not None and b"T" in data:
            self._is_sent = True
            self.first_byte_ns.append(now_ns - self._triggered_ns)

    def received(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def turned(self, now_ns: int) -> None: ...

    def happened(self, event: object, now_ns: int) -> None: ...

    def requested(self, request: object, now_ns: int) -> None: ...

    def noted(self, bus: str, state: str, now_ns: int, reason: str = "") -> None: ...


def main(words: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--changes", type=int)
    given = parser.parse_args(words)
    on = robot()
    programs = {"a": program(on, 1), "b": program(on, 2)}
    changer = Changer(given.changes or (20 if given.real else 400))
    result = perform_stage(
        programs,
        on,
        first="a",
        is_virtual=not given.real,
        is_recorded=False,
        observer=Observer(
            on_event=changer.on_event, controls=changer, make_tap=lambda _start_ns: changer
        ),
    )
    for title, values in (("first byte", changer.first_byte_ns), ("change-over", changer.took_ns)):
        ms = np.array(values) / NS_PER_MS
        low, middle, high = np.percentile(ms, (50, 99, 100)).round(2)
        print(f"{title}: {len(ms)} times, p50 {low} ms, p99 {middle} ms, max {high} ms")
    plays = {name: one.plays for name, one in result.report.totals.items()}
    print(f"plays {plays}, outcome {result.report.outcome}, missed moves "
          f"{sum(one.missed for one in result.report.totals.values())}")  # fmt: skip
    print(f"largest resident size, every 50 changes: {changer.memory_kb} kB")
    print(f"objects that the collector tracks after the run: {len(gc.get_objects())}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
