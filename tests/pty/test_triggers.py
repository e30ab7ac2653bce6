"""Triggers from other programs: liblo, OLA, JACK and mosquitto, none of them our own encoder."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import ctypes.util
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rig.stage import may_make_namespaces

from benches import sound_recorder
from lss_motion.stage.triggers.devices import MidiPort
from lss_motion.stage.triggers.mqtt import MqttLink, broker_of
from lss_motion.stage.triggers.osc import OscPort
from lss_motion.stage.triggers.sources import AllowList, Gate
from tests.network import free_port
from tests.programs import ProgramBeside

pytestmark = [pytest.mark.realtime, pytest.mark.slow]
WAIT_S = 30.0


def needs(*programs, install):
    """Skip the test where a program is missing; fail in the gate, which installs them."""
    missing = [name for name in programs if shutil.which(name) is None]
    if missing and os.environ.get("CI"):
        pytest.fail(f"{', '.join(missing)} must be there with CI=true: {install}")
    if missing:
        pytest.skip(f"{', '.join(missing)}: {install}")


def gate(said, *allowed):
    return Gate("test", AllowList(["127.0.0.0/8", *allowed]), said.append)


async def until(condition):
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s, "waited too long"
        await asyncio.sleep(0.02)


async def ended(program):
    """Wait until a program has ended; return its exit code."""
    return await asyncio.wait_for(program.wait(), WAIT_S)


class TimeTag(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_uint32), ("frac", ctypes.c_uint32))


def send_bundle(port, ahead_s, address):
    """Send a bundle with a time tag by liblo; the time is its own, too."""
    lo = ctypes.CDLL(ctypes.util.find_library("lo"))
    for name in ("lo_address_new", "lo_message_new", "lo_bundle_new"):
        getattr(lo, name).restype = ctypes.c_void_p
    lo.lo_bundle_new.argtypes = (TimeTag,)
    lo.lo_bundle_add_message.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    lo.lo_send_bundle.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
    tag = TimeTag()
    lo.lo_timetag_now(ctypes.byref(tag))
    frac = tag.frac + int(ahead_s * 2**32)
    bundle = lo.lo_bundle_new(TimeTag(tag.sec + (frac >> 32), frac & 0xFFFFFFFF))
    lo.lo_bundle_add_message(bundle, address.encode(), lo.lo_message_new())
    assert lo.lo_send_bundle(lo.lo_address_new(b"127.0.0.1", str(port).encode()), bundle) > 0


def test_liblo_sends_and_receives():
    needs("oscsend", "oscdump", install="sudo apt install liblo-tools")
    done, said = [], []

    async def run():
        loop = asyncio.get_running_loop()
        port = OscPort(
            gate(said),
            lambda operation, origin: done.append((operation, loop.time())),
            cues={"/hall/door"},
            state=lambda: {"state": "plays", "show": "scare"},
        )
        await port.open(("127.0.0.1", 0))
        to, back = str(port.place[1]), free_port(socket.SOCK_DGRAM)
        with ProgramBeside(["oscdump", "-L", str(back)]) as dump:
            await asyncio.sleep(0.2)
            for words in (
                ("/hall/door", "i", "1"),
                ("/hall/door", "f", "0"),
                ("/lss/cue", "s", "scare"),
                ("/lss/subscribe", "i", str(back)),
            ):
                one = await asyncio.create_subprocess_exec("oscsend", "localhost", to, *words)
                await ended(one)
            sent_s = loop.time()
            send_bundle(port.place[1], 0.5, "/lss/go")
            await until(lambda: len(done) == 3)
            port.send_joints({"jaw": 12.5, "neck": -3.0})
            await until(lambda: dump.said.count("\n") == 4)
        port.close()
        return done[2][1] - sent_s, [line.split(" ", 1)[1] for line in dump.said.splitlines()]

    waited_s, lines = asyncio.run(run())
    assert [one.op for one, _ in done] == ["trigger", "cue", "go"]
    assert (done[0][0].address, done[0][0].value) == ("/hall/door", 1.0)
    assert waited_s >= 0.49, "executed at the time of its tag, not before"
    assert [line.strip() for line in lines] == [
        '/lss/state s "plays"',
        '/lss/show s "scare"',
        "/lss/joint/jaw f 12.500000",
        "/lss/joint/neck f -3.000000",
    ]
    assert said == []


OLA = """
set -e
ip link set lo up
ip link add d0 type veth peer name d1
ip addr add 10.77.0.1/24 dev d0
ip link set d0 up
ip link set d1 up
ip route add 224.0.0.0/4 dev d0
mkdir conf
for name in artnet dummy espnet kinet nanoleaf openpixelcontrol osc pathport sandnet shownet spi \\
    stageprofi usbserial opendmx renard gpio uartdmx usbdmx karate milinst; do
    echo 'enabled = false' > conf/ola-$name.conf
done
printf 'enabled = true\\nip = 10.77.0.1\\noutput_ports = 1\\ninput_ports = 1\\n' \\
    > conf/ola-e131.conf
chmod -R a+rwX . conf
setpriv --reuid daemon --regid daemon --clear-groups \\
    olad -c "$PWD/conf" --no-http -l 0 > olad.log 2>&1 &
desk=$!
trap 'kill $desk; wait $desk' EXIT
"$1" "$2" &
receiver=$!
for _ in $(seq 50); do ola_patch -d 1 -p 0 -u 1 > /dev/null 2>&1 && break; sleep 0.1; done
for level in 0 200 0; do ola_set_dmx -u 1 -d 0,0,0,0,$level; sleep 0.4; done
wait $receiver
"""
RECEIVER = """
import asyncio
from lss_motion.stage.triggers.sacn import Levels
from lss_motion.stage.triggers.sacn import SacnPort
from lss_motion.stage.triggers.sources import AllowList, Gate


async def run():
    done = asyncio.get_running_loop().create_future()
    found = []

    def take(operation, origin):
        found.append((operation.address, operation.value, origin))
        if len(found) == 2:
            done.set_result(None)

    port = SacnPort("10.77.0.1", Gate("sACN", AllowList(["10.77.0.0/24"]), print), take)
    port.watch(Levels({"1/5": (127.0,)}))
    await port.open()
    await asyncio.wait({done}, timeout=10.0)
    port.close()
    print(found)


asyncio.run(run())
"""


def test_ola_crosses_a_level_in_a_network_of_its_own(tmp_path):
    """Multicast stays in a network namespace that this test makes."""
    needs("olad", "ola_set_dmx", "ip", "unshare", install="sudo apt install ola iproute2")
    if not may_make_namespaces():
        pytest.skip("a network namespace with interfaces needs root with its rights")
    tmp_path.chmod(0o777)
    for folder in tmp_path.parents:
        with contextlib.suppress(OSError):
            folder.chmod(folder.stat().st_mode | 0o011)  # `daemon` passes through.
    receiver = tmp_path / "receive.py"
    receiver.write_text(RECEIVER)
    done = subprocess.run(
        ["unshare", "-n", "bash", "-c", OLA, "ola", sys.executable, str(receiver)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        check=False,
    )
    log = (tmp_path / "olad.log").read_text()
    assert "[('1/5', 200.0, 'sACN 1/5 from 10.77.0.1'), ('1/5', 0.0," in done.stdout, (done, log)


def test_a_note_of_another_program_comes_through_jack():
    needs("jackd", "jack_midiseq", install="sudo apt install jackd2")
    pytest.importorskip("rtmidi", reason="pip install 'lss-motion[midi]'")
    done, said = [], []

    async def run():
        port = MidiPort("sequence", gate(said), lambda *found: done.append(found), said.append)

        def has_opened():
            port.open()
            if port.open_name is None:
                port.close()  # What is missing is looked for in some seconds only.
            return port.open_name is not None

        with ProgramBeside(["jack_midiseq", "sequence", "4000", "0", "60", "2000"]):
            await until(has_opened)
            await until(lambda: done)
        await until(lambda: port.open_name is None)
        port.close()

    with sound_recorder.sound_server():
        asyncio.run(run())
    trigger, origin = done[0]
    assert (trigger.kind, trigger.address, trigger.channel) == ("note", "60", 1)
    assert origin.startswith("MIDI sequence")
    assert any("has vanished" in text for text in said)


def test_mosquitto_brings_cues_and_keeps_the_state(tmp_path):
    needs("mosquitto", "mosquitto_pub", install="sudo apt install mosquitto mosquitto-clients")
    pytest.importorskip("paho.mqtt", reason="pip install 'lss-motion[stage]'")
    number = free_port()
    config = tmp_path / "broker.conf"
    config.write_text(f"listener {number} 127.0.0.1\nallow_anonymous true\n")
    done, said = [], []

    async def publish(topic, text, *more):
        words = ("-p", str(number), "-t", topic, "-m", text, *more)
        one = await asyncio.create_subprocess_exec("mosquitto_pub", *words)
        assert await ended(one) == 0

    async def run():
        with contextlib.ExitStack() as brokers:
            return await served_by(brokers)

    async def served_by(brokers):
        first = brokers.enter_context(ProgramBeside(["mosquitto", "-c", str(config)]))
        await until(lambda: "running" in first.errors)
        await publish("hall/door", "early", "-r")  # Kept from before: it fires nothing.
        own = broker_of(f"mqtt://127.0.0.1:{number}", {})
        link = MqttLink(own, "hall", gate(said), lambda *found: done.append(found), said.append)
        link.watch(frozenset({"hall/door"}), None)
        link.keep("lss/hall/state", json.dumps({"state": "idle"}))
        link.open()
        await until(lambda: any("connected" in text for text in said))
        await asyncio.sleep(0.2)
        await publish("hall/door", "open")
        await publish("lss/hall/cue/scare", "fire")
        await publish("lss/hall/do", "nonsense")
        await until(lambda: len(done) == 2)
        first.terminate()  # The broker is started anew, and has forgotten everything.
        first.ended()
        brokers.enter_context(ProgramBeside(["mosquitto", "-c", str(config)]))
        await until(lambda: sum("connected" in text for text in said) == 2)
        read = await asyncio.create_subprocess_exec(
            *("mosquitto_sub", "-p", str(number), "-t", "lss/hall/#", "-C", "2", "-W", "5", "-v"),
            stdout=subprocess.PIPE,
        )
        kept, _ = await asyncio.wait_for(read.communicate(), WAIT_S)
        link.close()
        return kept.decode()

    kept = asyncio.run(run())
    assert [(one.op, origin) for one, origin in done] == [
        ("trigger", "MQTT hall/door"),
        ("cue", "MQTT lss/hall/cue/scare"),
    ]
    assert set(kept.splitlines()) == {
        "lss/hall/online online",
        'lss/hall/state {"state": "idle"}',
    }
    assert any("is gone" in text for text in said)
