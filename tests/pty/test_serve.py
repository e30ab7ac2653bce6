"""A stage as real processes, with a servo behind a pseudo-terminal: cues, new files, ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("prometheus_client", reason="pip install 'lss-motion[stage,studio]'")
pytest.importorskip("pythonosc", reason="pip install 'lss-motion[stage,studio]'")

from pythonosc.osc_message_builder import OscMessageBuilder

from tests.network import free_port, web_hook
from tests.programs import ProgramBeside, command
from tests.swing import ROBOT, WAIT_S, until

pytestmark = pytest.mark.realtime
HOLD = b"#254H\r"
SHOW = """\
sequence: {name}
robot: arm.yaml
keyframes:
  - {{at_s: 0, deg: {{a: 0}}}}
  - {{at_s: {to_s}, deg: {{a: {deg}}}}}
  - {{at_s: {end_s}, deg: {{a: 0}}}}
"""
STAGE = """\
stage: hall
robot: arm.yaml
shows: {{idle: idle.yaml, scare: scare.yaml}}
idle: idle
cues:
  - {{cue: door, on: {{osc: /hall/door}}, play: scare, start: terminate}}
  - {{cue: web, on: {{http: web}}, play: scare, start: terminate}}
listen: {{http: "127.0.0.1:{http}", osc: "127.0.0.1:{osc}"}}
alerts: {{webhook: "http://127.0.0.1:{hook}/"}}
log: {{ring_s: 0}}
"""


class Hall:
    """A stage that runs, as an operator and other programs see it."""

    def __init__(self, hook, *options, stage=STAGE):
        self.osc_port, self.http = free_port(socket.SOCK_DGRAM), free_port()
        Path("arm.yaml").write_text(ROBOT)
        self.write("idle", deg=2, to_s=2, end_s=4)
        self.write("scare", deg=30, to_s=1, end_s=2)
        Path("hall.yaml").write_text(stage.format(http=self.http, osc=self.osc_port, hook=hook))
        self.process = ProgramBeside(
            command("serve", "hall.yaml", "--json", *options),
            env={**os.environ, "LSS_MOTION_STATE_DIR": str(Path.cwd() / "state")},
        )
        self.token = json.loads(self.process.wait_for(r"}\n"))["token"]

    @staticmethod
    def write(name, **fields):
        Path(f"{name}.yaml").write_text(SHOW.format(name=name, **fields))

    def ask(self, path, *, method="GET", token=None):
        """Return the answer of the server: JSON, or text."""
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.http}{path}",
            method=method,
            headers={"Authorization": f"Bearer {token or self.token}"},
        )
        with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
            text = answer.read().decode()
        return json.loads(text) if text.startswith("{") else text

    def osc(self, address):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            data = OscMessageBuilder(address).build().dgram
            own.sendto(data, ("127.0.0.1", self.osc_port))

    def waits_for(self, **fields):
        until(lambda: fields.items() <= self.ask("/state").items())

    def said(self, words):
        return words in self.process.errors

    def end(self, number):
        self.process.send_signal(number)
        return self.process.ended()


@contextlib.contextmanager
def halls():
    """Yield what starts a stage; end those that still run."""
    with contextlib.ExitStack() as running:

        def start(*options, hook=9, stage=STAGE):
            own = Hall(hook, *options, stage=stage)
            running.enter_context(own.process)
            return own

        yield start


@pytest.fixture
def hall():
    with halls() as start:
        yield start


@pytest.fixture
def hook():
    with web_hook() as (port, got):
        yield port, got


def far(bus):
    """Whether the servo was sent further than the idle show goes."""
    targets = [int(line[3:].split(b"T")[0]) for _, line in bus.lines if line.startswith(b"#1D")]
    return any(abs(target) > 100 for target in targets)


def test_cues_new_files_and_the_end_of_a_stage(on_terminal, servo, hall):
    with on_terminal(servo(1)) as bus:
        own = hall()
        own.waits_for(state="idle")
        assert not far(bus)
        own.osc("/hall/door")
        own.waits_for(state="plays", show="scare")
        until(lambda: far(bus))
        # A file with an error changes nothing, and is said; one without is taken after the show.
        Path("scare.yaml").write_text("sequence: scare\nkeyframes: nonsense\n")
        until(lambda: own.said("scare.yaml:2:"))
        assert own.said("goes on with the last good files")
        assert own.ask("/trigger/web", method="POST") == {"accepted": "trigger"}
        own.waits_for(state="plays", show="scare")
        own.write("scare", deg=-30, to_s=1, end_s=2)
        until(lambda: own.said("they are played when this show has ended"))
        own.waits_for(state="idle", has_new_files=False)
        assert own.said("new files are played from now on; changed: scare")
        assert "lss_player_starts_total 1.0" in own.ask("/metrics"), "it goes on"
        own.osc("/hall/door")
        until(lambda: any(line.startswith(b"#1D-2") for _, line in bus.lines))
        for path, token, code in (("/trigger/nix", None, 404), ("/cue/door", "wrong", 401)):
            with pytest.raises(urllib.error.HTTPError) as refused:
                own.ask(path, method="POST", token=token)
            assert refused.value.code == code
            refused.value.close()
        # A storm of cues, and what is no OSC.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as storm:
            for _ in range(2000):
                storm.sendto(b"/hall/door\0\0", ("127.0.0.1", own.osc_port))
                storm.sendto(b"#bundle\0\xff\xff\xff", ("127.0.0.1", own.osc_port))
        until(lambda: own.said("messages a second"))
        own.waits_for(state="idle")
        assert own.end(signal.SIGTERM) == 0
        assert bus.lines[-1][1] == HOLD
        assert any(b"EM1" in line for _, line in bus.lines[-10:]), "settings are given back"
        assert own.process.errors.count("\n") < 100, "a storm fills no log"


@pytest.mark.slow
def test_a_port_is_waited_for_and_a_stop_is_kept(on_terminal, servo, hall, hook, tmp_path):
    number, got = hook
    port = Path(tmp_path, "port")
    os.chdir(tmp_path)
    own = hall("--wait-port", hook=number)
    own.waits_for(state="waits_for_port")
    with on_terminal(servo(1)) as bus:
        own.waits_for(state="idle")
        # The process that plays is killed: it is started again, and people are told.
        children = Path(f"/proc/{own.process.pid}/task/{own.process.pid}/children").read_text()
        for pid in map(int, children.split()):
            with contextlib.suppress(OSError):
                if b"remote.process" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    os.kill(pid, signal.SIGKILL)
        until(lambda: got)
        assert got[0]["stage"] == "hall"
        assert "begins again in 5 s" in got[0]["text"]
        own.waits_for(state="idle")
        own.osc("/lss/stop")
        own.waits_for(state="off", is_latched=True)
        assert bus.lines[-1][1] == HOLD
        count = len(bus.lines)
        with pytest.raises(urllib.error.HTTPError) as refused:
            own.ask("/trigger/web", method="POST")
        with refused.value:
            assert "does not run" in refused.value.read().decode()
        assert own.ask("/op/rearm", method="POST") == {"accepted": "rearm"}
        time.sleep(1.5)
        assert len(bus.lines) == count, "armed again, it waits for a person to start it"
        assert own.ask("/op/play", method="POST") == {"accepted": "play"}
        own.waits_for(state="idle")
        # A server that is killed takes its player with it: that stops, and no other could start.
        own.end(signal.SIGKILL)
        until(lambda: bus.lines[-1][1] == HOLD)
        assert any(b"EM1" in line for _, line in bus.lines[-10:]), "settings are given back"
    assert not port.exists()


@pytest.mark.slow
def test_what_cannot_begin_ends_with_its_code(hall, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = hall()
    assert own.process.ended() == 4
    assert own.said("port")
    words = command("serve", "hall.yaml")
    with ProgramBeside([*words, "--tls-certificate", "nothing.pem"]) as half:
        assert half.ended() == 2
    assert half.errors == "lss-motion: --tls-certificate and --tls-key belong together\n"
    Path("hall.yaml").write_text(Path("hall.yaml").read_text().replace("osc: /hall", "ocs: /hall"))
    with ProgramBeside(words) as wrong:
        assert wrong.ended() == 2
    assert wrong.errors.startswith("hall.yaml:6:")


@pytest.mark.slow
def test_a_log_that_cannot_be_written_is_said_and_ends_with_2(on_terminal, servo, hall):
    Path("log").write_text("not a folder")
    with on_terminal(servo(1)):
        own = hall()
        own.waits_for(state="idle")
        until(lambda: own.said("the log cannot be written: "))
        assert "is not a folder" in own.ask("/state")["log"]
        assert own.end(signal.SIGINT) == 2
    assert "of the log could not be written: " in own.process.errors.splitlines()[-1]
