"""MIDI inputs that vanish, pins of buttons, and what a broker of messages brings."""

from __future__ import annotations

import asyncio
import json

import msgspec
import pytest

from lss_motion.errors import InputError
from lss_motion.stage.timecode import midi as sync_midi
from lss_motion.stage.triggers import devices, mqtt
from lss_motion.stage.triggers.devices import GpioPins, MidiPort, trigger_of
from lss_motion.stage.triggers.sources import AllowList, Crossings, Gate


def gate(said):
    return Gate("test", AllowList(["127.0.0.0/8"]), said.append)


@pytest.mark.parametrize(
    ("message", "found"),
    [
        ((0x90, 60, 100), ("note", "60", 100.0, 1)),
        ((0x9F, 0, 1), ("note", "0", 1.0, 16)),
        ((0xC1, 5), ("program", "5", None, 2)),
        ((0x90, 60, 0), None),
        ((0x80, 60, 64), None),
        ((0xB0, 7, 127), None),
        ((0xF8,), None),
        ((0x90, 60), None),
        ((0x90, 200, 1), None),
        ((), None),
    ],
)
def test_notes_and_programs_are_triggers(message, found):
    trigger = trigger_of(message)
    assert found == (trigger and (trigger.kind, trigger.address, trigger.value, trigger.channel))


class MidiInputs:
    """A MIDI system whose devices come and go."""

    def __init__(self):
        self.names, self.callback = (), None

    def open_port(self, kind, wanted):
        for name in self.names:
            if wanted in name:
                return self, name
        raise sync_midi.NoPortError(f"MIDI input {wanted!r} is not there")

    def is_there(self, device, port):
        return port in self.names

    def close(self, device):
        self.callback = None

    def set_callback(self, call):
        self.callback = call

    def cancel_callback(self):
        self.callback = None


def test_a_device_that_vanishes_is_said_and_opened_again(monkeypatch):
    monkeypatch.setattr(devices, "LOOK_S", 0.01)
    monkeypatch.setattr(devices, "MISSING_S", 0.01)
    said, done = [], []

    async def run():
        system = MidiInputs()
        sink = lambda *found: done.append(found)  # noqa: E731
        port = MidiPort("pad", gate(said), sink, said.append, system=system)
        for names in (("Through",), ("Through", "pad 20:0"), ("Through",), ("pad 24:0",)):
            system.names = names
            if names[0] == "Through" and len(names) == 1 and not said:
                port.open()
            await asyncio.sleep(0.03)
            if len(names) == 2:
                system.callback(([0x90, 36, 90], 0.0), None)
                await asyncio.sleep(0.01)
        assert port.open_name == "pad 24:0"
        port.close()

    asyncio.run(run())
    assert [text for text in said if text.startswith("MIDI:")] == [
        "MIDI: pad 20:0 is open",
        "MIDI: pad 20:0 has vanished; it is opened when it is back",
        "MIDI: pad 24:0 is open",
    ]
    assert said[0] == "MIDI input 'pad' is not there; it is opened when it is there"
    assert len(said) <= 5
    ((trigger, origin),) = done
    assert (trigger.address, origin) == ("36", "MIDI pad 20:0")


def test_a_button_is_a_trigger_when_it_is_pressed():
    gpiozero = pytest.importorskip("gpiozero", reason="pip install gpiozero")
    from gpiozero.pins.mock import MockFactory

    factory, done, said = MockFactory(), [], []
    gpiozero.Device.pin_factory = factory

    async def run():
        pins = GpioPins(gate(said), lambda *found: done.append(found))
        pins.watch(["17", "4"])
        factory.pin(17).drive_low()
        await asyncio.sleep(0.05)
        factory.pin(17).drive_high()
        await asyncio.sleep(0.05)
        pins.watch(["4"])
        factory.pin(4).drive_low()
        await asyncio.sleep(0.05)
        with pytest.raises(InputError, match="GPIO99"):
            pins.watch(["99"])
        pins.close()

    asyncio.run(run())
    assert [(one.kind, one.address, origin) for one, origin in done] == [
        ("gpio", "17", "pin GPIO17"),
        ("gpio", "4", "pin GPIO4"),
    ]
    gpiozero.Device.pin_factory = None


def test_a_broker_is_read_and_trusted_only_with_a_password_or_on_the_list():
    own = mqtt.broker_of("mqtt://hub@127.0.0.1", {"LSS_MQTT_PASSWORD": "secret"})
    assert (own.host, own.port, own.user, own.password) == ("127.0.0.1", 1883, "hub", "secret")
    assert mqtt.broker_of("mqtts://a:b%40@hub:99").password == "b@"
    assert "secret" not in repr(own)
    for wrong in ("hub:1883", "http://hub", "mqtt://", "mqtt://hub:x", "mqtt://u:geheim@h/t"):
        with pytest.raises(InputError, match="mqtt://USER@HOST:PORT") as caught:
            mqtt.broker_of(wrong)
        assert "geheim" not in str(caught.value)
    here = AllowList(["127.0.0.0/8"])
    mqtt.require_trusted(own, here)
    mqtt.require_trusted(mqtt.broker_of("mqtt://127.0.0.1", {}), here)
    with pytest.raises(InputError, match="no password"):
        mqtt.require_trusted(mqtt.broker_of("mqtt://192.0.2.1", {}), here)


def test_topics_are_operations():
    levels = Crossings({"hall/mm": (800.0,)})
    cues = frozenset({"hall/door", "hall/mm"})

    def asked(topic, text):
        found = mqtt.operation_of(topic, text.encode(), "lss/hall", cues, levels)
        if not found:
            return found
        values = msgspec.to_builtins(found)
        left_out = ("id", "source", "kind")
        return {key: one for key, one in values.items() if key not in left_out and one is not None}

    assert asked("hall/door", "ON") == {"op": "trigger", "address": "hall/door"}
    assert asked("hall/door", "OFF") is asked("hall/door", "0") is None
    assert [asked("hall/mm", text) and text for text in ("700", "900", "950", "x")] == [
        None,
        "900",
        None,
        None,
    ]
    assert asked("lss/hall/cue/scare", "fire") == {"op": "cue", "label": "scare"}
    assert asked("lss/hall/enable/scare", "OFF")["is_enabled"] is False
    assert asked("lss/hall/do", "go") == {"op": "go"}
    for topic, text in (("lss/hall/do", "rearm"), ("other", "1"), ("lss/hall/cue/a", "x" * 300)):
        with pytest.raises(InputError):
            asked(topic, text)


def test_home_assistant_gets_buttons_and_switches_with_unique_names():
    topic, text = mqtt.discovery("Haunted hall", ["scare", "hello"], "1.0")
    found = json.loads(text)
    assert topic == "homeassistant/device/lss_Haunted_hall/config"
    parts = found["components"]
    assert {one["platform"] for one in parts.values()} == {"sensor", "button", "switch"}
    assert len({one["unique_id"] for one in parts.values()}) == len(parts) == 8
    assert parts["cue_scare"]["command_topic"] == "lss/Haunted_hall/cue/scare"
    assert parts["enable_scare"]["state_topic"] == "lss/Haunted_hall/enabled/scare"
    assert found["availability_topic"] == "lss/Haunted_hall/online"


CONNACK = b"\x20\x02\x00\x00"


def publish(topic, payload):
    """Return a message as a broker sends it."""
    content = len(topic).to_bytes(2, "big") + topic + payload
    return bytes([0x30, len(content)]) + content


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        ([CONNACK + publish(b"\xff\xfe", b"x") + publish(b"lss/hall/do", b"go")],
         "test: a topic that is not UTF-8 is ignored"),
        ([CONNACK + b"\x30\x01\x00", CONNACK + publish(b"lss/hall/do", b"go")],
         "is gone; it is tried again"),
    ],
)  # fmt: skip
def test_nothing_that_a_broker_sends_ends_the_link_for_good(sent, said):
    """The broker sends this to one connection after the other."""
    notes, operations = [], []

    async def run():
        left, done = list(sent), asyncio.Event()

        async def serve(reader, writer):
            await reader.read(1000)
            writer.write(left.pop(0) if left else CONNACK)
            await reader.read()  # Until the link is closed.
            writer.close()

        def obey(operation, _where):
            operations.append(operation)
            done.set()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        broker = mqtt.Broker(host="127.0.0.1", port=port)
        link = mqtt.MqttLink(broker, "hall", gate(notes), obey, notes.append)
        link.open()
        await asyncio.wait_for(done.wait(), 30.0)
        await asyncio.to_thread(link.close)
        server.close()

    asyncio.run(run())
    assert len(operations) == 1
    assert any(said in note for note in notes)
