"""How soon another host on the bus is noticed, in real time and by a host that is not ours.

tools/run tools/benches/two_hosts.py            every way of asking x scan, monitor, lss-play
tools/run tools/benches/two_hosts.py loop       only ways whose name has this word

A simulated robot stands behind a pseudo-terminal (`lss-motion sim`). `Wire` gives that bus two
ports, as two adapters on one bus have: what either host sends reaches the servos, and every reply
reaches both hosts. The other host is a program of its own (`OTHER`) that knows nothing of
`lss_motion`. The commands run as a person starts them, and their output is read.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import subprocess
import sys
import tempfile
import threading
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

ROBOT: Final = Path(__file__).resolve().parents[2] / "sequences" / "robots" / "desk_arm.yaml"
SHOW: Final = ROBOT.parents[1] / "wave.yaml"
WAIT_S: Final = 60.0
"""Longest wait for a command that notices nothing; a scan takes most."""

OTHER: Final = """
import os, sys, time
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
every_s, lines = float(sys.argv[2]), sys.argv[3:]
while True:
    for line in lines:
        os.write(port, line.encode() + b"\\r")
        time.sleep(every_s / len(lines))
        while True:
            os.set_blocking(port, False)
            try:
                if not os.read(port, 4096):
                    break
            except BlockingIOError:
                break
"""
"""Sends its lines in turn, all of them once in `every_s`, and drops what comes back."""

WAYS: Final = {
    "nothing": (1.0, []),
    "loop: QD of each servo every 20 ms": (0.02, [f"#{number}QD" for number in range(1, 6)]),
    "loop: QD of each servo every 100 ms": (0.1, [f"#{number}QD" for number in range(1, 6)]),
    "one servo: QV every 0.3 s": (0.3, ["#2QV"]),
    "one servo: QV every second": (1.0, ["#2QV"]),
    "all at once: 254QD every 0.1 s": (0.1, ["#254QD"]),
    "all at once: 254QV every 0.4 s": (0.4, ["#254QV"]),
    "commands only: LED every 20 ms": (0.02, ["#1LED2", "#1LED3"]),
    "noise: 8 unreadable bytes every 50 ms": (0.05, None),
}
"""Name: how often, and the lines; None: bytes that no servo sends, as of another baud rate."""
NOISE: Final = bytes((0, 128, 248, 254, 0, 128, 0, 254))
"""What a port makes of a reply at a lower baud rate, or a servo with a bad plug sends. Chosen."""
SAID: Final = ("did not ask for",)
COMMANDS: Final = {
    "scan": ["scan", "{port}", "--baud", "115200"],
    "monitor": ["monitor", "{robot}", "--port", "{port}", "--for", "12", "--every", "5"],
    "lss-play": ["play", "{show}", "--port", "{port}", "--yes"],
}


class Wire:
    """Two ports on one bus: `ours` and `other`."""

    def __init__(self, bus_port: str) -> None:
        self.noise_every_s: float | None = None
        self.asked_s: float | None = None
        """When the first byte came from our host."""
        self._bus = os.open(bus_port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._bus)
        pairs = [pty.openpty() for _ in range(2)]
        self._ends = [main for main, _ in pairs]
        self._slaves = [slave for _, slave in pairs]
        for slave in self._slaves:
            tty.setraw(slave)
        self.ours, self.other = map(os.ttyname, self._slaves)
        for fd in (self._bus, *self._ends):
            os.set_blocking(fd, False)
        self._is_closed = False
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def close(self) -> None:
        self._is_closed = True
        self._thread.join()
        for fd in (self._bus, *self._ends, *self._slaves):
            os.close(fd)

    def _carry(self) -> None:
        next_s = time.monotonic()
        while not self._is_closed:
            readable, _, _ = select.select([self._bus, *self._ends], [], [], 0.02)
            for fd in readable:
                with contextlib.suppress(BlockingIOError):
                    data = os.read(fd, 4096)
                    if fd == self._ends[0] and self.asked_s is None:
                        self.asked_s = time.monotonic()
                    for other in self._ends if fd == self._bus else [self._bus]:
                        with contextlib.suppress(BlockingIOError):
                            os.write(other, data)
            if self.noise_every_s is not None and time.monotonic() >= next_s:
                next_s = time.monotonic() + self.noise_every_s
                os.write(self._ends[0], NOISE)


@contextlib.contextmanager
def two_ports() -> Iterator[Wire]:
    """Yield a bus with two ports and the servos of `ROBOT`."""
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "port"
        words = [
            sys.executable,
            "-m",
            "lss_motion.cli.main",
            "sim",
            str(ROBOT),
            "--link",
            str(link),
        ]
        with subprocess.Popen(words, stdout=subprocess.DEVNULL) as sim:
            try:
                while not link.exists():
                    assert sim.poll() is None, "the simulated robot ended"
                    time.sleep(0.05)
                wire = Wire(str(link))
                try:
                    yield wire
                finally:
                    wire.close()
            finally:
                sim.terminate()


def noticed(words: list[str], wire: Wire) -> tuple[float | None, str]:
    """Return how long after its first query a command says it, and the line; None: it does not."""
    values = {"port": wire.ours, "robot": str(ROBOT), "show": str(SHOW)}
    command = [sys.executable, "-u", "-m", "lss_motion.cli.main"]
    command += [word.format(**values) for word in words]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
    ) as process:
        assert process.stdout is not None
        limit = threading.Timer(WAIT_S, process.kill)
        limit.start()
        try:
            for raw in process.stdout:
                line = raw.decode(errors="replace").strip()
                if any(said in line for said in SAID) and wire.asked_s is not None:
                    return time.monotonic() - wire.asked_s, line
            return None, ""
        finally:
            limit.cancel()
            process.terminate()


def main() -> None:
    wanted = sys.argv[1:]
    for name, (every_s, lines) in WAYS.items():
        if wanted and not any(word in name for word in wanted):
            continue
        for command, words in COMMANDS.items():
            with two_ports() as wire:
                wire.noise_every_s = every_s if lines is None else None
                other = [sys.executable, "-c", OTHER, wire.other, str(every_s), *(lines or ())]
                host = subprocess.Popen(other) if lines else None
                try:
                    after_s, line = noticed(words, wire)
                finally:
                    if host is not None:
                        host.terminate()
                        host.wait()
            found = "not noticed" if after_s is None else f"{after_s:5.1f} s  {line[:110]}"
            print(f"{name:38} {command:8} {found}", flush=True)


if __name__ == "__main__":
    main()
