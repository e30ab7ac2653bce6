"""A host in virtual time that speaks plain lines, and the servos that it speaks to."""

from __future__ import annotations

import re

import pytest
from msgspec.structs import replace

from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics, ServoSpec

ST1 = SERVO_MODELS["LSS-ST1"]

QUIET = Physics(noise_deg=0.0)


class SimHost:
    """Owns a bus and the time. `say` waits for nothing, `ask` for one reply or for 20 ms."""

    def __init__(self, *specs: ServoSpec, faults=(), seed=1, physics=QUIET, **line):
        self.bus = SimBus(
            specs or (ServoSpec(servo_id=5, model=ST1),),
            seed=seed,
            physics=physics,
            faults=faults,
            **({"baud_bps": 115200, "firmware": 370} | line),
        )
        self.bus.record()
        self.bus.advance(0)
        self.now_ns = 0

    def say(self, line: str) -> None:
        """Write a line and wait until its CR has arrived and the next control loop has come."""
        self.bus.write(f"{line}\r".encode(), self.now_ns)
        self.wait_s(self.bus.backlog_ns(self.now_ns) / 1e9 + 0.005)

    def ask(self, line: str) -> str:
        """Return all that comes back, CR shown as `|`."""
        self.bus.write(f"{line}\r".encode(), self.now_ns)
        received = b""
        while (end_ns := self.bus.next_arrival_ns()) is not None:
            self.now_ns = max(self.now_ns, end_ns)
            received += self.bus.read(self.now_ns)
        if not received:
            self.wait_s(0.02)
        return received.decode("latin-1").replace("\r", "|")

    def talk(self, dialogue: str) -> None:
        """Say, ask and wait, word by word.

        `#5D300` is said; `#5QSD1=900` asks and expects `*5QSD900|`, `#5QG=` silence, and
        `#254QID=*QID5|` just that; `1.5s` waits; `@30` is where the first horn stands, `@1:30` the
        second.
        """
        for word in dialogue.split():
            if match := re.fullmatch(r"@(?:(\d):)?(.+)", word):
                assert self.horn_deg(int(match[1] or 0)) == pytest.approx(float(match[2]), abs=0.05)
            elif word.endswith("s") and word[0] != "#":
                self.wait_s(float(word[:-1]))
            elif "=" in word:
                line, said = word.split("=")
                if said and said[0] != "*":
                    said = f"*{line[1:].rstrip('0123456789')}{said}|"
                assert (word, self.ask(line)) == (word, said)
            else:
                self.say(word)

    def wait_s(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)
        self.bus.advance(self.now_ns)

    def horn_deg(self, index: int = 0) -> float:
        self.bus.advance(self.now_ns)
        return self.bus.motors.horn_deg(index, self.now_ns)


def servo(servo_id: int = 5, **fields) -> ServoSpec:
    return replace(ServoSpec(servo_id=servo_id, model=ST1), **fields)


@pytest.fixture(scope="session")
def make_host():
    return SimHost


@pytest.fixture(scope="session")
def make_servo():
    return servo


@pytest.fixture
def host() -> SimHost:
    return SimHost()
