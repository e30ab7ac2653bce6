"""The only loop in the package that waits."""

from __future__ import annotations

import contextlib
import gc
import select
import sys
import time
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from lss_motion.runtime.clock import VirtualClock
from lss_motion.runtime.real_time import prompt_waits
from lss_motion.units import NS_PER_MS, NS_PER_S, NS_PER_US, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from lss_motion.player.events import Event
    from lss_motion.runtime.clock import Clock
    from lss_motion.runtime.port import Port

IDLE_NS: Final = NS_PER_S // 20
"""The loop turns at least this often, so that keys and the display are never starved."""


TAKES_STEP_NS: Final = 5 * NS_PER_US
TAKES_MAX_NS: Final = NS_PER_MS
"""A decision takes 0.1 to 0.5 ms here (measured). Chosen: a hundred of them settle what they take,
and a computer that is slow for a moment makes no command early by more than one unit of T."""


class Driven(Protocol):
    """What can be driven over ports: a `Player`, or a simpler conversation."""

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        """Return the bytes to write, per bus. They leave at `leaves_ns`, shortly after the call."""

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def next_wakeup_ns(self) -> int | None:
        """Return None when it is over."""

    def next_event(self) -> Event | None: ...

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return what must be the last bytes on each bus if it all ends here."""


D = TypeVar("D", bound=Driven)
D_contra = TypeVar("D_contra", bound=Driven, contravariant=True)


class Controls(Protocol[D_contra]):
    """What a person does meanwhile: keys and signals."""

    def filenos(self) -> Sequence[int]:
        """Return what to wait on besides the ports."""

    def act(self, driven: D_contra, now_ns: int) -> None:
        """Apply what was asked for since the last call."""


class Tap(Protocol):
    """Sees every byte both ways; must return at once."""

    def sent(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def received(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def turned(self, now_ns: int) -> None:
        """Note that what is driven was asked, and had nothing to send."""

    def happened(self, event: Event, now_ns: int) -> None: ...


def run(
    driven: D,
    ports: Mapping[str, Port],
    clock: Clock,
    *,
    on_event: Callable[[Event], None] | None = None,
    on_turn: Callable[[D, int], None] | None = None,
    controls: Controls[D] | None = None,
    tap: Tap | None = None,
) -> None:
    """Drive `driven` over `ports` until it is done.

    However this ends, the last bytes are the safe state: its own, or, when something raises,
    those sent here. Raises `BusError` when a port is lost.
    """
    try:
        with _undisturbed(is_real=not isinstance(clock, VirtualClock)):
            leaving = _Leaving(clock)
            while True:
                now_ns = leaving.next_ns()
                if controls is not None:
                    controls.act(driven, now_ns)
                if _write(driven, ports, leaving.next_ns(), tap):
                    leaving.has_left()
                while (event := driven.next_event()) is not None:
                    if tap is not None:
                        tap.happened(event, now_ns)
                    if on_event is not None:
                        on_event(event)
                wakeup_ns = driven.next_wakeup_ns()
                if wakeup_ns is None:
                    return
                if on_turn is not None:
                    on_turn(driven, now_ns)
                _wait(ports, clock, wakeup_ns - leaving.takes_ns, controls)
                _read(driven, ports, leaving, tap)
    except BaseException:
        _make_safe(driven, ports, clock, tap)
        raise


class _Leaving:
    """When what is decided now will leave: to decide takes time, which is learnt.

    As many decisions take longer as take less (a step up or down after each). On a virtual clock
    they take none.
    """

    def __init__(self, clock: Clock) -> None:
        self.takes_ns = 0
        self._clock = clock
        self._begun_ns = self._said_ns = clock.now_ns()

    def next_ns(self) -> int:
        """Return when what is decided from now on will leave."""
        self._begun_ns = self._clock.now_ns()
        self._said_ns = max(self._said_ns, self._begun_ns + self.takes_ns)
        return self._said_ns

    def has_left(self) -> None:
        took_ns = self._clock.now_ns() - self._begun_ns
        step_ns = TAKES_STEP_NS if took_ns > self.takes_ns else -TAKES_STEP_NS
        self.takes_ns = min(max(0, self.takes_ns + step_ns), TAKES_MAX_NS)

    def now_ns(self) -> int:
        """Return what time it is, or what `next_ns` has said: time does not go back."""
        return max(self._said_ns, self._clock.now_ns())


def _write(driven: Driven, ports: Mapping[str, Port], leaves_ns: int, tap: Tap | None) -> bool:
    """Write what `driven` decides to send, which leaves at `leaves_ns`; return whether it did."""
    sent = driven.data_to_send(leaves_ns)
    for bus, data in sent.items():
        ports[bus].write(data)
        if tap is not None:
            tap.sent(bus, data, leaves_ns)
    if tap is not None and not sent:
        tap.turned(leaves_ns)
    return bool(sent)


def _read(driven: Driven, ports: Mapping[str, Port], leaving: _Leaving, tap: Tap | None) -> None:
    for bus, port in ports.items():
        if data := port.read():
            now_ns = leaving.now_ns()
            driven.receive_data(bus, data, now_ns)
            if tap is not None:
                tap.received(bus, data, now_ns)


def _make_safe(driven: Driven, ports: Mapping[str, Port], clock: Clock, tap: Tap | None) -> None:
    """Send the safe state to every port that still takes it, whatever the others do."""
    for bus, data in driven.safe_bytes().items():
        with contextlib.suppress(Exception):
            ports[bus].write(data)
            if tap is not None:
                tap.sent(bus, data, clock.now_ns())


def _wait(
    ports: Mapping[str, Port], clock: Clock, wakeup_ns: int, controls: Controls[D] | None
) -> None:
    """Wait until `wakeup_ns`, or until a port or a control has something."""
    arrivals_ns = [a for port in ports.values() if (a := port.next_arrival_ns()) is not None]
    until_ns = min([wakeup_ns, *arrivals_ns])
    if isinstance(clock, VirtualClock):
        clock.advance_to(max(until_ns, clock.now_ns()))
        return
    filenos = [f for port in ports.values() if (f := port.fileno()) is not None]
    now_ns = clock.now_ns()
    until_ns = min(until_ns, now_ns + IDLE_NS)
    left_s = max(0.0, s_from_ns(until_ns - now_ns))
    if controls is not None:
        filenos += controls.filenos()
    if filenos or sys.platform != "win32":
        select.select(filenos, [], [], left_s)
    else:
        time.sleep(left_s)  # noqa: TID251 (the one place that waits)


@contextlib.contextmanager
def _undisturbed(*, is_real: bool) -> Iterator[None]:
    """Keep the garbage collector out while a show runs; in real time ask for fine timers too."""
    was_enabled = gc.isenabled()
    with contextlib.ExitStack() as stack:
        if is_real:
            gc.collect()
            gc.freeze()
            stack.callback(gc.unfreeze)
            stack.enter_context(prompt_waits())
        gc.disable()
        try:
            yield
        finally:
            if was_enabled:
                gc.enable()
