"""A simulated bus behind a pseudo-terminal, served by a thread: for tests, campaign and scenes."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics, ServoSpec
from lss_motion.sim.pty import serve_buses

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from lss_motion.sim.faults import Fault

WAIT_S: Final = 30.0
"""The longest time that its start and its end may take on a busy machine."""


def recording_bus(
    *specs: ServoSpec,
    baud_bps: int = 115200,
    physics: Physics | None = None,
    faults: Sequence[Fault] = (),
) -> SimBus:
    """Return a simulated bus with these servos, without noise, that keeps what it receives."""
    physics = physics or Physics(noise_deg=0.0)
    bus = SimBus(specs, baud_bps=baud_bps, firmware=370, physics=physics, faults=faults)
    bus.record()
    return bus


class ServedBus:
    """A bus behind the port `link`, until it is unplugged."""

    def __init__(self, bus: SimBus, link: Path) -> None:
        """Serve it; raises `TimeoutError` where the port does not come."""
        self.bus = bus
        self.path = str(link)
        self._stop, ready = threading.Event(), threading.Event()
        self._thread = threading.Thread(
            target=serve_buses,
            args=({"main": bus}, link),
            kwargs={"announce": lambda _: ready.set(), "should_stop": self._stop.is_set},
            daemon=True,
        )
        self._thread.start()
        if not ready.wait(WAIT_S):
            self.unplug()
            raise TimeoutError(f"no port {link} after {WAIT_S:g} s")

    def unplug(self) -> None:
        """Pull the port; once more changes nothing."""
        self._stop.set()
        self._thread.join(WAIT_S)
        assert not self._thread.is_alive(), f"{self.path} is still served"


@contextmanager
def served_bus(bus: SimBus, link: Path) -> Iterator[ServedBus]:
    """Serve a bus; gives it, and what unplugs it before the end."""
    served = ServedBus(bus, link)
    try:
        yield served
    finally:
        served.unplug()
