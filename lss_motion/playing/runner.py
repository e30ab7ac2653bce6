"""The run loop: moves bytes between a state machine and ports; the only code of a run that waits.

One turn of the loop: controls act, the bytes that are due are written, events are passed on, then
the loop waits for the next instant or for data, and reads. What is driven (`Driven`: a player or a
simpler dialogue) decides everything and does no input or output; it gets the time as an argument.

Threads and processes. `run` uses one thread, that of its caller, and starts none. What may block
runs in a process of its own, which the loop never waits for: the log file (`playing.log`), the
functions and sounds of a show (`playing.performer`), the planner of a walk
(`playing.walking.planner`) and the display (`cli.display`). The loop writes to their pipes without
blocking; what does not fit is dropped, or written later. `lss-motion sim` is a program of its own,
with its own loop.

Who waits. `Clock.wait_until` waits here: for the next wakeup of what is driven, for a port, or for
a file number of the controls, 50 ms at most. Ports, controls, taps and callbacks must return at
once. Two calls outside the loop wait for a limited time: a `SerialPort` that closes flushes its
bytes, and the end of the log and of the performer waits for their processes.
"""

from __future__ import annotations

import contextlib
import gc
from typing import TYPE_CHECKING, Final, Protocol, TypeVar, runtime_checkable

from lss_motion.system.real_time import prompt_waits
from lss_motion.units import NS_PER_MS, NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from lss_motion.playing.log import PortState
    from lss_motion.playing.player.events import Event, PlayerRequest
    from lss_motion.system.clock import Clock
    from lss_motion.system.port import Port

DECISION_STEP_NS: Final = 5 * NS_PER_US
DECISION_MAX_NS: Final = NS_PER_MS
"""A decision takes 0.1 to 0.5 ms (measured). Chosen: the estimate settles within a hundred turns,
and a slow moment of the computer makes no command early by more than one unit of T."""


class Driven(Protocol):
    """What the loop can drive over ports: a `Player`, or a simpler dialogue."""

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        """Return the bytes to write, per bus. They leave at `leaves_ns`, shortly after the call."""

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take bytes that arrived on a bus. No byte raises."""

    def next_wakeup_ns(self) -> int | None:
        """Return when `data_to_send` must be called again; None: finished."""

    def next_event(self) -> Event | None:
        """Return the oldest event that was not returned yet."""

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the bytes that must be the last on each bus if the run ends now."""


@runtime_checkable
class Patient(Protocol):
    """What does not need every answer at once, besides `Driven`: this saves turns of the loop."""

    def reads_ns(self, bus: str) -> int | None:
        """Return until when bytes of a bus may wait to be handed over; None: they may not.

        They still are handed over after every wait, unless something is due.
        """

    def is_due(self, leaves_ns: int) -> bool:
        """Return whether bytes must leave by then, before those that have come are handed over."""


D = TypeVar("D", bound=Driven)
D_contra = TypeVar("D_contra", bound=Driven, contravariant=True)


class Controls(Protocol[D_contra]):
    """Input from a person during the run: keys and signals."""

    def filenos(self) -> Sequence[int]:
        """Return the file numbers that end a wait, besides those of the ports."""

    def act(self, driven: D_contra, now_ns: int) -> None:
        """Apply all input since the last call."""


class Tap(Protocol):
    """Receives a copy of every byte in both directions; must return at once."""

    def sent(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def received(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def turned(self, now_ns: int) -> None:
        """Note a turn of the loop in which nothing was sent."""

    def happened(self, event: Event, now_ns: int) -> None: ...

    def requested(self, request: PlayerRequest, now_ns: int) -> None:
        """Note an order from outside that decides: `follow` a leader, or a lost `sound`."""

    def noted(self, bus: str, state: PortState, now_ns: int, reason: str = "") -> None:
        """Note what else decides: a port is `lost`, with the reason, or `found`.

        `safe`: what follows on this bus are the safe bytes after an error.
        """


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
    """Drive `driven` over `ports` until it is finished.

    However this ends, the last bytes are the safe state: `driven` sends its own, and when
    something raises, its `safe_bytes` are sent here. Raises `BusError` when a port is lost.
    """
    try:
        with _without_interruptions(clock):
            leaving = _LeavingTime(clock)
            incoming = _Incoming(driven, ports, clock, leaving, tap)
            while True:
                now_ns = leaves_ns = leaving.next_ns()
                if controls is not None:
                    controls.act(driven, now_ns)
                    leaves_ns = leaving.next_ns()
                if _write(driven, ports, leaves_ns, tap):
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
                incoming.wait(wakeup_ns, controls)
                incoming.read()
    except BaseException:
        _make_safe(driven, ports, clock, tap)
        raise


class _LeavingTime:
    """Estimates when the bytes of the next decision leave: now, plus the time to decide.

    The estimate is the median of the decision times: it takes a step up after a longer one and a
    step down after a shorter one. On a virtual clock decisions take no time.
    """

    def __init__(self, clock: Clock) -> None:
        self.decision_ns = 0
        self._clock = clock
        self._began_ns = self._returned_ns = clock.now_ns()

    def next_ns(self) -> int:
        """Return when the bytes of a decision that begins now will leave."""
        self._began_ns = self._clock.now_ns()
        leaves_ns = self._began_ns + self.decision_ns
        if leaves_ns < self._returned_ns:
            return self._returned_ns
        self._returned_ns = leaves_ns
        return leaves_ns

    def has_left(self) -> None:
        took_ns = self._clock.now_ns() - self._began_ns
        if took_ns <= self.decision_ns:
            self.decision_ns -= DECISION_STEP_NS if self.decision_ns else 0
        elif self.decision_ns < DECISION_MAX_NS:
            self.decision_ns += DECISION_STEP_NS

    def now_ns(self) -> int:
        """Return the time, but not less than `next_ns` has returned."""
        now_ns = self._clock.now_ns()
        return max(self._returned_ns, now_ns)


class _Incoming:
    """Waits, and hands over the bytes that have come."""

    def __init__(
        self,
        driven: Driven,
        ports: Mapping[str, Port],
        clock: Clock,
        leaving: _LeavingTime,
        tap: Tap | None,
    ) -> None:
        self._driven = driven
        self._patient = driven if isinstance(driven, Patient) else None
        self._ports = [*ports.items()]
        self._clock = clock
        self._is_virtual = clock.is_virtual
        self._leaving = leaving
        self._tap = tap
        self._is_held = False
        """Whether the bytes were not read the last time, since something was due."""

    def wait(self, wakeup_ns: int, controls: Controls[D] | None) -> None:
        """Wait until `wakeup_ns`, or until data comes to a control, or to a port read at once.

        A port whose data may wait does not end the wait before its time. A file never ends a wait
        in virtual time.
        """
        wakeup_ns -= self._leaving.decision_ns
        filenos: list[int] = []
        if controls is not None and not self._is_virtual:
            filenos += controls.filenos()
        for bus, port in self._ports:
            due_ns = None if self._patient is None else self._patient.reads_ns(bus)
            if due_ns is None:
                due_ns = port.next_arrival_ns()
                if not self._is_virtual and (fileno := port.fileno()) is not None:
                    filenos.append(fileno)
            if due_ns is not None and due_ns < wakeup_ns:
                wakeup_ns = due_ns
        self._clock.wait_until(wakeup_ns, filenos)

    def read(self) -> None:
        """Hand over what has come; when something is due, only every other time."""
        if self._patient is not None and not self._is_held:
            leaves_ns = self._clock.now_ns() + self._leaving.decision_ns
            self._is_held = self._patient.is_due(leaves_ns)
            if self._is_held:
                return
        self._is_held = False
        for bus, port in self._ports:
            if data := port.read():
                now_ns = self._leaving.now_ns()
                self._driven.receive_data(bus, data, now_ns)
                if self._tap is not None:
                    self._tap.received(bus, data, now_ns)


def _write(driven: Driven, ports: Mapping[str, Port], leaves_ns: int, tap: Tap | None) -> bool:
    """Write what `driven` sends at `leaves_ns`; return whether there was anything."""
    sent = driven.data_to_send(leaves_ns)
    for bus, data in sent.items():
        ports[bus].write(data)
        if tap is not None:
            tap.sent(bus, data, leaves_ns)
    if tap is not None and not sent:
        tap.turned(leaves_ns)
    return bool(sent)


def _make_safe(driven: Driven, ports: Mapping[str, Port], clock: Clock, tap: Tap | None) -> None:
    """Send the safe state to every port that still takes it; a port that fails stops no other."""
    for bus, data in driven.safe_bytes().items():
        with contextlib.suppress(Exception):
            ports[bus].write(data)
            if tap is not None:
                tap.noted(bus, "safe", clock.now_ns())
                tap.sent(bus, data, clock.now_ns())


@contextlib.contextmanager
def _without_interruptions(clock: Clock) -> Iterator[None]:
    """Stop the garbage collector during a run; in real time request precise waits as well."""
    was_enabled = gc.isenabled()
    with contextlib.ExitStack() as stack:
        if not clock.is_virtual:
            stack.enter_context(prompt_waits())
        gc.disable()
        try:
            yield
        finally:
            if was_enabled:
                gc.enable()
