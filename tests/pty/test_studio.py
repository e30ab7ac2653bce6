"""The studio as real processes, with servos behind a pseudo-terminal: every way of a stop."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import socket
import ssl
import time
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from lss_motion.studio.web import FRAME_MAX_BYTES
from tests.programs import ProgramBeside, command
from tests.swing import SHOW, WAIT_S, until, write_show

pytestmark = pytest.mark.realtime

CERTIFICATE = """\
-----BEGIN CERTIFICATE-----
MIIBlTCCATqgAwIBAgIUPw+u/Y5U3IX5tLwTzmLCgPvvgs8wCgYIKoZIzj0EAwIw
FjEUMBIGA1UEAwwLc3R1ZGlvIHRlc3QwIBcNMjYxMTIzMTExNDUwWhgPMjEyNjEw
MzAxMTE0NTBaMBYxFDASBgNVBAMMC3N0dWRpbyB0ZXN0MFkwEwYHKoZIzj0CAQYI
KoZIzj0DAQcDQgAEBnWiXbegFUcatj4UkcG/iKTqm1aKaEaEqO85zUA1Z1jTZ1Lv
I7HsUUB26T2vx2AOqVCehV+CUWGZuoz8rJcxuqNkMGIwHQYDVR0OBBYEFMvx278y
kBenTANbW+nxx50GG2SDMB8GA1UdIwQYMBaAFMvx278ykBenTANbW+nxx50GG2SD
MA8GA1UdEwEB/wQFMAMBAf8wDwYDVR0RBAgwBocEfwAAAjAKBggqhkjOPQQDAgNJ
ADBGAiEA/R6dhyd2hde74bR9tPumahcokLdouAAtVICeIWvkbKECIQD4u8wOJMkn
UFTRtljokqMuM/uth+Bqa5asNzbZ6BW8mg==
-----END CERTIFICATE-----
"""
KEY = """\
-----BEGIN PRIVATE KEY-----
MIGHAgEAMBMGByqGSM49AgEGCCqGSM49AwEHBG0wawIBAQQg2r/i6Xg0cX6Tij1k
//8KDbDDVM2+DvhFXLGb2f/4bHWhRANCAAQGdaJdt6AVRxq2PhSRwb+IpOqbVopo
RoSo7znNQDVnWNNnUu8jsexRQHbpPa/HYA6pUJ6FX4JRYZm6jPyslzG6
-----END PRIVATE KEY-----
"""
"""Of 127.0.0.2, for these tests alone; made by openssl for a hundred years."""
HOLD = b"#254H\r"


def state_of(pid):
    """Return the state of a process by /proc; Z for one that is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


def children(pid):
    """Return the processes that a process has started, by the module that they run."""
    found = {}
    for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        with contextlib.suppress(OSError, ValueError):  # It may just begin, or end.
            words = Path(f"/proc/{one}/cmdline").read_bytes().decode().split("\0")
            found[words[words.index("-c") + 3].rpartition(".")[2]] = int(one)
    return found


class SocketBrowser:
    """A client with a websocket; `events` are all that it got."""

    def __init__(self, studio, place=0, tls=None):
        self.context = connect(
            studio["addresses"][place].replace("http", "ws") + "/ws",
            ssl=tls,
            additional_headers={"Authorization": f"Bearer {studio['token']}"},
            compression=None,
            ping_interval=None,  # The server stands still for a while.
        )
        self.link = self.context.__enter__()
        self.events, self.frames, self.next_id = [], 0, 1

    def send(self, op, **fields):
        self.next_id += 1
        self.link.send(json.dumps({"op": op, "id": self.next_id, **fields}))
        return self.next_id

    def read(self):
        """Take what has arrived."""
        with contextlib.suppress(TimeoutError):
            while True:
                message = self.link.recv(timeout=0)
                if isinstance(message, bytes):
                    self.frames += 1
                else:
                    self.events.append(json.loads(message))

    def last(self, kind):
        self.read()
        return next((e for e in reversed(self.events) if e["event"] == kind), {})

    def wait(self, kind, **fields):
        """Wait for an event with these values; forget those before it."""

        def found():
            self.read()
            for place, event in enumerate(self.events):
                if event["event"] == kind and fields.items() <= event.items():
                    del self.events[: place + 1]
                    return event
            return None

        return until(found)

    def play(self):
        """Play from `idle` until the show moves; the robot is real, so it waits for `go`."""
        self.send("play")
        self.wait("player", state="ready")
        self.send("go")
        self.wait("player", state="playing")
        self.frames = 0
        until(lambda: (self.read(), self.frames > 3)[1])


@pytest.fixture
def studio(tmp_path):
    """Return what starts a studio on the show in this folder; its processes end with the test."""
    write_show(tmp_path)
    running = []

    def start(*options):
        server = ProgramBeside(command("studio", "swing.yaml", *options, "--json"))
        running.append(server)
        return server, json.loads(server.wait_for(r"}\n"))

    yield start
    for server in running:
        started = children(server.pid) if server.poll() is None else {}
        with server:
            server.send_signal(signal.SIGCONT)
        for pid in started.values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def post(studio, path, origin=None, tls=None):
    """Send a stop to the process that only stops."""
    request = urllib.request.Request(
        (origin or studio["stop"]) + path,
        method="POST",
        headers={"Authorization": f"Bearer {studio['token']}"},
    )
    with urllib.request.urlopen(request, timeout=WAIT_S, context=tls) as answer:
        return answer.status


def test_a_stop_arrives_where_planner_and_server_stand_still(on_terminal, servo, studio):
    with on_terminal(servo(1)) as bus:
        server, info = studio()
        one, other = SocketBrowser(info), SocketBrowser(info)
        one.wait("document", is_planning=False)
        # A wrong file stands at its line; the last good plan stays, and can be played.
        Path("swing.yaml").write_text(SHOW.replace("at_s: 1", "at_z: 1"))
        wrong = one.wait("document", is_planning=False)
        assert [(e["path"], e["line"]) for e in wrong["errors"]] == [("swing.yaml", 6)]
        assert wrong["plan"]
        assert not wrong["is_current"]
        one.play()
        assert other.last("lease")["is_mine"] is False
        planner, player = children(server.pid)["planner"], children(server.pid)["process"]
        os.kill(planner, signal.SIGSTOP)
        Path("swing.yaml").write_text(SHOW)
        one.wait("document", is_planning=True)
        # From a second client, while the planner stands still.
        other.send("estop")
        other.wait("player", state="ended", latch="estop")
        assert bus.lines[-1][1] == HOLD
        one.send("play")
        assert "rearm" in one.wait("refused")["text"]
        one.send("rearm")
        os.kill(planner, signal.SIGCONT)
        one.wait("document", is_planning=False, is_current=True)
        one.play()
        # While the server stands still: by the process that only stops.
        player = children(server.pid)["process"]
        os.kill(server.pid, signal.SIGSTOP)
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(info["stop"] + "/stop", data=b"", timeout=WAIT_S)
        assert state_of(player) != "Z"
        assert post(info, "/stop") == 204
        until(lambda: state_of(player) == "Z")
        assert bus.lines[-1][1] == HOLD
        assert any(b"EM1" in line for _, line in bus.lines[-10:]), "settings are given back"
        os.kill(server.pid, signal.SIGCONT)
        assert one.wait("player", state="ended", latch="stop")
        server.send_signal(signal.SIGINT)
        assert (server.ended(), server.errors) == (0, "")


@pytest.mark.slow
def test_a_server_that_is_silent_or_killed_is_a_lost_operator(on_terminal, servo, studio):
    with on_terminal(servo(1)) as bus:
        server, info = studio("--on-operator-lost", "hold")
        one = SocketBrowser(info)
        one.wait("document", is_planning=False)
        one.play()
        floods = SocketBrowser(info)
        with pytest.raises(ConnectionClosed):
            _flood(floods)
        assert one.last("links"), "the others are served"
        os.kill(server.pid, signal.SIGSTOP)
        until(lambda: _rests(bus))
        os.kill(server.pid, signal.SIGCONT)
        one.wait("player", state="paused")
        one.send("resume")
        one.wait("player", state="playing")
        pids = children(server.pid)
        server.kill()
        until(lambda: all(state_of(pid) == "Z" for pid in pids.values()))
        assert bus.lines[-1][1] == HOLD
        assert any(b"EM1" in line for _, line in bus.lines[-10:])


def _flood(browser):
    """Send what is no message, then one that is too long; read until the server closes."""
    for _ in range(20):
        browser.link.send("x" * 5000)
    browser.link.send("x" * (FRAME_MAX_BYTES + 1))
    until(lambda: (browser.read(), False)[1])


def _rests(bus):
    """Whether no move was received for a second of real time."""
    count = sum(line.startswith(b"#1D") for _, line in bus.lines)
    time.sleep(1.0)
    return sum(line.startswith(b"#1D") for _, line in bus.lines) == count


@pytest.mark.slow
def test_a_robot_that_is_not_there_is_said(studio, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own.pem").write_text(CERTIFICATE)
    Path("own.key").write_text(KEY)
    server, info = studio(
        *("--listen", "127.0.0.2", "--tls-certificate", "own.pem", "--tls-key", "own.key")
    )
    tls = ssl.create_default_context(cafile="own.pem")
    # A client on the network, with TLS; its stop goes to an address that it can reach.
    browsers = [SocketBrowser(info, place=1, tls=tls), *(SocketBrowser(info) for _ in range(9))]
    one = browsers[0]
    welcome = one.wait("welcome")
    assert welcome["stop_origin"] == info["stops"][1]
    assert info["stops"][1].startswith("https://127.0.0.2:")
    assert not welcome["is_network_readable"]
    one.send("pair", role="view")
    assert one.wait("pairing")["urls"] == [info["addresses"][1] + "/"]
    assert post(info, "/stop", info["stops"][1], tls) == 204
    one.wait("player", latch="stop")
    one.send("rearm")
    one.wait("document", is_planning=False)
    one.send("play")
    assert "port" in one.wait("player", state="ended")["text"]
    one.send("connect")
    until(lambda: "port" in one.last("robot")["text"])
    for browser in browsers[1:]:
        browser.wait("player", state="ended")
        browser.context.__exit__(None, None, None)
    server.send_signal(signal.SIGTERM)
    assert server.ended() == 0


@pytest.mark.slow
def test_a_port_that_is_lost_in_the_middle_of_a_show_is_said(on_terminal, servo, studio):
    with on_terminal(servo(1)):
        server, info = studio()
        one = SocketBrowser(info)
        one.wait("document", is_planning=False)
        one.play()
        stop = children(server.pid)["stop"]
        os.kill(stop, signal.SIGKILL)
    fault = one.wait("fault")
    assert "port" in fault["cause"]
    one.wait("phase", phase="recovering")
    # The stop process was killed and is there again; its stop reaches the player.
    until(lambda: children(server.pid).get("stop", stop) != stop)
    assert post(info, "/stop") == 204
    assert one.wait("player", latch="stop")["state"] == "stopping"
    assert one.wait("player", state="ended")["latch"] == "stop"
    assert one.last("robot")["state"] == "off"


def test_strangers_of_the_network_leave_a_stop_what_it_needs(studio, tmp_path, monkeypatch):
    """More of them than both processes have file numbers; nothing is a traceback, to the end."""
    monkeypatch.chdir(tmp_path)
    server, told = studio()
    with contextlib.ExitStack() as stack:
        for pid in (server.pid, children(server.pid)["stop"]):
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (128, 128))
        browser = SocketBrowser(told)
        for origin in (told["stop"], told["addresses"][0]):
            where = (urlsplit(origin).hostname, urlsplit(origin).port)
            for number in range(200):
                own = stack.enter_context(socket.create_connection(where, timeout=WAIT_S))
                if number % 50 == 0:
                    own.sendall(b"POST /session HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n{")
            assert post(told, "/estop", origin) == 204
        browser.wait("player", latch="estop")
        server.send_signal(signal.SIGTERM)  # The browser's websocket is open.
        server.ended()
    assert "Traceback" not in server.errors
    assert len(server.errors.splitlines()) < 10, server.errors


def test_edits_outlive_a_server_that_is_killed(studio, tmp_path, monkeypatch):
    """What a client was told is accepted comes back, and is written when it is saved."""
    monkeypatch.chdir(tmp_path)
    server, addresses = studio()
    browser = SocketBrowser(addresses)
    revision = browser.wait("document", is_current=True)["revision"]
    key = {"file": "swing.yaml", "place": ["keyframes", 1]}
    browser.send("key.move", revision=revision, keys=[key], by_s=0.25)
    event = browser.wait("document", revision=revision + 1)
    assert event["editing"]["unsaved"] == ["swing.yaml"]
    plan = browser.wait("document", is_current=True)["plan"]
    kept = tmp_path / ".swing.yaml.unsaved"
    until(kept.exists)
    os.kill(server.pid, signal.SIGKILL)
    server.wait()
    assert (tmp_path / "swing.yaml").read_text() == SHOW
    server, addresses = studio()
    browser = SocketBrowser(addresses)
    event = browser.wait("document", is_current=True)
    assert event["editing"]["recovered"] == ["swing.yaml"]
    assert event["plan"] == plan
    trial = {"op": "key.set", "revision": event["revision"], "keys": [key], "deg": {"a": 40}}
    number = browser.send("edit.try", revision=event["revision"], edit=trial)
    assert browser.wait("tried")["id"] == number
    browser.send("save", revision=event["revision"])
    browser.wait("accepted", op="save")
    assert (tmp_path / "swing.yaml").read_text() == SHOW.replace("at_s: 1,", "at_s: 1.25,")
    assert not kept.exists()
