"""A simulated bus behind a pseudo-terminal, served by a thread of the test."""

from __future__ import annotations

import threading
from contextlib import contextmanager

from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics
from lss_motion.sim.pty import serve_buses


def recording_bus(*specs, baud_bps=115200, physics=None, faults=()):
    """Return a simulated bus with these servos, without noise, that keeps what it receives."""
    physics = physics or Physics(noise_deg=0.0)
    bus = SimBus(specs, baud_bps=baud_bps, firmware=370, physics=physics, faults=faults)
    bus.record()
    return bus


class ServedBus:
    """A bus behind the port `link`, until it is unplugged."""

    def __init__(self, bus, link):
        self.bus = bus
        self.path = str(link)
        self._stop, ready = threading.Event(), threading.Event()
        self._thread = threading.Thread(
            target=serve_buses,
            args=({"main": bus}, link),
            kwargs={"announce": lambda _: ready.set(), "should_stop": self._stop.is_set},
        )
        self._thread.start()
        if not ready.wait(5.0):
            self.unplug()
            raise TimeoutError(f"no port {link} after 5 s")

    def unplug(self):
        self._stop.set()
        self._thread.join(5.0)
        assert not self._thread.is_alive()


@contextmanager
def served_bus(bus, link):
    """Serve a bus; gives it, and what unplugs it before the end."""
    served = ServedBus(bus, link)
    try:
        yield served
    finally:
        served.unplug()
