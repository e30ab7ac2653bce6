"""The sources of triggers of one stage, as its file has them: opened, kept open, changed on reload.

A source that cannot be opened now is tried again; meanwhile the others work. What it says goes to
`note`.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import threading
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.errors import InputError, install_command
from lss_motion.stage.model import TriggerKind
from lss_motion.stage.triggers import mqtt
from lss_motion.stage.triggers.devices import GpioPins, MidiPort
from lss_motion.stage.triggers.mqtt import MqttLink
from lss_motion.stage.triggers.osc import OscPort
from lss_motion.stage.triggers.sacn import RATE_HZ, Levels, SacnPort
from lss_motion.stage.triggers.sources import AllowList, Complaints, Crossings, Gate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from lss_motion.stage.model import Stage
    from lss_motion.stage.triggers.sources import Sink

AGAIN_S: Final = 5.0
"""After so long a source that could not be opened is tried again."""
ALWAYS: Final = ("127.0.0.0/8", "::1/128")
MODULES: Final[Mapping[str, tuple[str, str]]] = {
    "osc": ("pythonosc", "stage"),
    "midi": ("rtmidi", "midi"),
    "mqtt": ("paho", "stage"),
    "gpio": ("gpiozero", "gpio"),
}
"""What each source needs besides this package, and the extra that has it."""


def addresses(stage: Stage, kind: TriggerKind) -> frozenset[str]:
    """Return the addresses that cues of one kind wait for."""
    return frozenset(stage.addresses(kind))


def thresholds(stage: Stage, kind: TriggerKind) -> dict[str, tuple[float, ...]]:
    """Return the thresholds of cues of one kind, by address."""
    found: dict[str, tuple[float, ...]] = {}
    for cue in stage.cues:
        if cue.on.kind is kind and cue.on.side is not None:
            found[cue.on.address] = (*found.get(cue.on.address, ()), cue.on.threshold)
    return found


def require_packages(stage: Stage) -> None:
    """Raise `InputError` for a source whose package is not installed."""
    listen = stage.listen
    wanted = {
        "osc": listen.osc is not None,
        "midi": listen.midi is not None,
        "mqtt": listen.mqtt is not None,
        "gpio": bool(addresses(stage, TriggerKind.GPIO)),
    }
    for source, is_wanted in wanted.items():
        module, extra = MODULES[source]
        if is_wanted and importlib.util.find_spec(module) is None:
            raise InputError(
                f"{source} needs a package: {install_command(extra)}",
                path=stage.path,
                line=listen.line,
            )


class Inlets:
    """All sources of one stage. `state` returns what OSC and MQTT are told."""

    def __init__(
        self,
        sink: Sink,
        note: Callable[[str], None],
        state: Callable[[], Mapping[str, float | str]],
    ) -> None:
        self.osc: OscPort | None = None
        self.mqtt: MqttLink | None = None
        self._sacn: SacnPort | None = None
        self._midi: MidiPort | None = None
        self._gpio: GpioPins | None = None
        self._sink, self._note, self._state = sink, note, state
        self._stage: Stage | None = None
        self._complaints = Complaints("stage", note)
        self._task: asyncio.Task[None] | None = None
        self.gates: dict[str, Gate] = {}

    def use(self, stage: Stage) -> None:
        """Open what this stage listens to; a source that is the same as before stays open."""
        before, self._stage = self._stage, stage
        if before is None or _listening(before) != _listening(stage):
            self._close_all()
        self._watch(stage)
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._keep_open())

    async def close(self) -> None:
        """Close all sources."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        self._close_all()

    def _close_all(self) -> None:
        for source in (self.osc, self._sacn, self._midi, self._gpio, self.mqtt):
            if source is not None:
                source.close()
        self.osc = self._sacn = self._midi = self._gpio = self.mqtt = None

    def _watch(self, stage: Stage) -> None:
        """Let the open sources look for what the cues of this stage wait for."""
        if self.osc is not None:
            self.osc.cues = addresses(stage, TriggerKind.OSC)
            self.osc.levels = Crossings(thresholds(stage, TriggerKind.OSC))
        if self.mqtt is not None:
            levels = Crossings(thresholds(stage, TriggerKind.MQTT))
            self.mqtt.watch(addresses(stage, TriggerKind.MQTT), levels)
        if self._sacn is not None:
            self._sacn.watch(Levels(thresholds(stage, TriggerKind.SACN)))
        if self._gpio is not None:
            self._gpio.watch(addresses(stage, TriggerKind.GPIO))

    async def _keep_open(self) -> None:
        while True:
            stage = self._stage
            assert stage is not None
            for open_one in (self._open_osc, self._open_sacn, self._open_others):
                try:
                    await open_one(stage)
                except (InputError, OSError) as error:
                    text = f"{error}; it is tried again"
                    self._complaints.add(text, asyncio.get_running_loop().time())
            await asyncio.sleep(AGAIN_S)

    def _gate(self, name: str, stage: Stage, **options: Any) -> Gate:  # noqa: ANN401
        allow = AllowList((*ALWAYS, *stage.listen.allow))
        gate = self.gates[name] = Gate(name, allow, self._note, **options)
        return gate

    async def _open_osc(self, stage: Stage) -> None:
        listen = stage.listen
        if listen.osc is None or self.osc is not None:
            return
        port = OscPort(
            self._gate("OSC", stage), self._sink, state=self._state, always=listen.feedback
        )
        try:
            await port.open(listen.osc)
        except OSError as error:
            host, number = listen.osc
            raise InputError(f"OSC cannot listen at {host}:{number}: {error.strerror}") from None
        self.osc = port
        self._watch(stage)

    async def _open_sacn(self, stage: Stage) -> None:
        if stage.listen.sacn is None or self._sacn is not None:
            return
        port = SacnPort(stage.listen.sacn, self._gate("sACN", stage, rate_hz=RATE_HZ), self._sink)
        port.watch(Levels(thresholds(stage, TriggerKind.SACN)))
        try:
            await port.open()
        except OSError as error:
            raise InputError(
                f"sACN cannot be received at {stage.listen.sacn}: {error.strerror}"
            ) from None
        self._sacn = port

    async def _open_others(self, stage: Stage) -> None:
        """Open what opens itself again: MIDI, pins, the broker."""
        listen = stage.listen
        if listen.midi is not None and self._midi is None:
            gate = self._gate("MIDI", stage)
            midi = MidiPort(listen.midi, gate, self._sink, self._note)
            midi.open()
            self._midi = midi
        if self._gpio is None and (pins := addresses(stage, TriggerKind.GPIO)):
            gpio = GpioPins(self._gate("GPIO", stage), self._sink)
            gpio.watch(pins)
            self._gpio = gpio
        if listen.mqtt is not None and self.mqtt is None:
            gate = self._gate("MQTT", stage)
            broker = mqtt.broker_of(listen.mqtt)
            mqtt.require_trusted(broker, AllowList((*ALWAYS, *listen.allow)))
            link = MqttLink(broker, stage.name, gate, self._sink, self._note)
            link.open()
            self.mqtt = link
            self._watch(stage)


def _listening(stage: Stage) -> object:
    """Return what decides which sources are open."""
    return stage.name, replace(stage.listen, line=None)


@contextlib.contextmanager
def inlets_thread(stage: Stage, sink: Sink, note: Callable[[str], None]) -> Iterator[None]:
    """Open the sources of a figure whose computer has no server, inside the block.

    `sink` is called in a thread of their own.
    """
    loop = asyncio.new_event_loop()
    ending = asyncio.Event()

    async def serve() -> None:
        inlets = Inlets(sink, note, dict)
        inlets.use(stage)
        await ending.wait()
        await inlets.close()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    try:
        yield
    finally:
        loop.call_soon_threadsafe(ending.set)
        thread.join(5.0)
