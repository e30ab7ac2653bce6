"""Two figures of a stage as real processes, steered together: judged at what both servos did."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from rig.robot import verdict_of
from served_bus import served_bus

from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot
from tests.network import free_port
from tests.programs import ProgramBeside, command
from tests.pty.test_studio import children, post
from tests.swing import ROBOT, WAIT_S, until

pytest.importorskip("zenoh", reason="needs the extra `network`")
pytestmark = [pytest.mark.realtime, pytest.mark.slow]

NS = 1_000_000_000
STAGE = """\
stage: pair
figures:
  left: {{robot: arm.yaml, address: "127.0.0.1:{port}"}}
  right: {{robot: arm.yaml, listen: {{osc: "127.0.0.1:{osc}"}}}}
conductor: left
shows: {{dance: dance.yaml}}
listen: {{http: "127.0.0.1:{http}"}}
log: {{ring_s: 0}}
"""
CUES = "cues:\n  - {cue: dance, on: {osc: /dance}, play: dance}\n"
SWING_S, SWINGS = 0.6, 40
STEP_NS = 2_000_000


def angle_deg(number):
    """Each swing ends at another angle, on the other side: so it is known by that."""
    return (8 + 5 * number % 13) * (-1) ** number


def turns_of(times_s, horn_deg):
    """Return when and where a horn turned back after more than 4 degrees."""
    found, best, way = [], 0, 0
    for index in range(len(horn_deg)):
        if way == 0:
            way = int(np.sign(horn_deg[index] - horn_deg[0])) * (
                abs(horn_deg[index] - horn_deg[0]) > 4.0
            )
        if way == 0 or way * (horn_deg[index] - horn_deg[best]) >= 0:
            best = index
        elif way * (horn_deg[best] - horn_deg[index]) > 4.0:
            found.append((times_s[best], horn_deg[best]))
            best, way = index, -way
    return found


class ServedPair:
    """Both computers of the stage, as processes; `ask` is the API of the conductor's pages."""

    def __init__(self, *options, more=""):
        self.http = free_port()
        Path("arm.yaml").write_text(ROBOT)
        keys = ""
        for n in range(SWINGS):
            deg = f"{{left.a: {angle_deg(n)}, right.a: {angle_deg(n)}}}"
            keys += f"  - {{at_s: {SWING_S * n:.1f}, deg: {deg}}}\n"
        Path("dance.yaml").write_text(f"sequence: dance\nrobot: arm.yaml\nkeyframes:\n{keys}")
        self.osc_port = free_port(socket.SOCK_DGRAM)
        stage = STAGE.format(port=free_port(), http=self.http, osc=self.osc_port)
        Path("pair.yaml").write_text(stage + more)
        self.processes = {}
        self._serve("left", "--json", *options)
        self._serve("right")
        self.token, self.stop = (self._told(name) for name in ("token", "stop"))

    def _serve(self, name, *options):
        words = ("serve", "pair.yaml", "--figure", name, "--port", f"./{name}", *options)
        self.processes[name] = ProgramBeside(
            command(*words),
            merged=True,
            stdin=subprocess.PIPE,
            env={**os.environ, "LSS_MOTION_STATE_DIR": str(Path.cwd() / "state")},
        )

    def _told(self, name):
        pattern = re.compile(rf'"{name}": "([^"]+)"')
        return until(lambda: pattern.search(self.processes["left"].said))[1]

    def ask(self, path, **fields):
        """Return the answer of the server; with fields, or an operation, it is asked to do."""
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.http}{path}",
            method="GET" if path == "/state" else "POST",
            headers={"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"},
            data=json.dumps(fields).encode() if fields else None,
        )
        with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
            return json.loads(answer.read())

    def hosts(self):
        return {one["name"]: one for one in self.ask("/state").get("hosts", ())}

    def osc(self, address):
        """Send a message to the other computer than that of the conductor."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            own.sendto(OscMessageBuilder(address).build().dgram, ("127.0.0.1", self.osc_port))

    def play(self):
        """Let a message at the other computer fire the cue, and wait until both play."""
        until(lambda: self.ask("/state").get("state") == "idle")
        self.osc("/dance")
        until(lambda: [one["state"] for one in self.hosts().values()] == ["playing"] * 2)

    def do(self, operation, **fields):
        """Ask for an operation; return when that was."""
        at_ns = time.monotonic_ns()
        assert self.ask(f"/op/{operation}", **fields) == {"accepted": operation}
        return at_ns

    def end(self):
        """End both by Ctrl-C, the conductor first; return their exit codes."""
        codes = {}
        for name, process in self.processes.items():
            process.send_signal(signal.SIGINT)
            codes[name] = process.ended()
        return codes


@contextlib.contextmanager
def pair(*options, more=""):
    """Yield both computers, and the buses of their robots."""
    Path("arm.yaml").write_text(ROBOT)
    robot = load_robot(Path("arm.yaml"))
    buses = [bus_from_robot(robot, "main", seed=1) for _ in range(2)]
    for bus in buses:
        bus.record()
    with served_bus(buses[0], Path("left")), served_bus(buses[1], Path("right")):
        own = ServedPair(*options, more=more)
        with own.processes["left"], own.processes["right"]:
            yield own, robot, buses


def objections_to(robot, bus, began_ns):
    """Return what the independent judge objects to in what a servo received and did."""
    return verdict_of(robot, {"main": bus}, began_ns, time.monotonic_ns() + NS)["objections"]


def test_a_cue_from_the_other_computer_pause_rate_and_seek_reach_both_servos_at_once(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    began_ns = time.monotonic_ns()
    with pair(more=CUES) as (own, robot, buses):
        own.play()
        slower_ns = own.do("rate", ratio=0.5)
        time.sleep(2.5)
        paused_ns = own.do("pause")
        time.sleep(2.0)
        sought_ns = own.do("seek", to=SWING_S * 20)
        until(lambda: {one["show_s"] for one in own.hosts().values()} == {SWING_S * 20})
        time.sleep(1.0)
        own.do("rate", ratio=1.0)
        resumed_ns = own.do("resume")
        time.sleep(2.7)
        assert own.end() == {"left": 0, "right": 0}
        assert [objections_to(robot, bus, began_ns) for bus in buses] == [[], []]
    times_ns = np.arange(slower_ns, resumed_ns + 5 * NS // 2, STEP_NS)
    horns = [bus.horn_deg(times_ns)[:, 0] for bus in buses]
    assert np.percentile(np.abs(horns[0] - horns[1]), 90) < 0.5, "at 80 deg/s, 6 ms"
    for horn_deg in horns:
        turns = turns_of(times_ns, horn_deg)
        before = [deg for at, deg in turns if at < sought_ns]
        first = next(n for n in range(26) if abs(angle_deg(n) - before[0]) < 0.6)
        assert len(before) >= 3
        assert before == pytest.approx([angle_deg(first + n) for n in range(len(before))], abs=0.9)
        slow_s = [at / NS for at, _ in turns if slower_ns + 1.3 * NS < at < paused_ns + NS]
        assert np.diff(slow_s) == pytest.approx([2 * SWING_S] * (len(slow_s) - 1), abs=0.1)
        # It stands while it is paused, and at the place that was sought until it goes on.
        for from_ns, to_ns in (
            (sought_ns - NS // 3, sought_ns),
            (resumed_ns, resumed_ns + NS // 2),
        ):
            stood_deg = horn_deg[(times_ns >= from_ns) & (times_ns < to_ns)]
            assert np.ptp(stood_deg) < 0.3
        assert stood_deg == pytest.approx(angle_deg(20), abs=0.5)
        after = [deg for at, deg in turns if at > resumed_ns + 1.2 * NS]
        assert after[:2] == pytest.approx([angle_deg(21), angle_deg(22)], abs=0.9)


@pytest.mark.parametrize("path", ["/stop", "/estop"])
def test_a_stop_needs_no_conductor_and_without_it_the_others_hold(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    began_ns = time.monotonic_ns()
    with pair(more=CUES) as (own, robot, buses):
        own.play()
        time.sleep(1.0)
        conductor = children(own.processes["left"].pid)["process"]
        os.kill(conductor, signal.SIGSTOP)
        pressed_ns = time.monotonic_ns()
        assert post({"stop": own.stop, "token": own.token}, path) == 204
        time.sleep(6.5)
        os.kill(conductor, signal.SIGCONT)
        assert own.end() == {"left": 0, "right": 0}
        assert [objections_to(robot, bus, began_ns) for bus in buses] == [[], []]
    for bus, rests_s in zip(buses, (1.2, 5.0), strict=True):  # A second, the freewheel, a brake.
        times_ns = np.arange(pressed_ns - NS, pressed_ns + 6 * NS, STEP_NS)
        horn_deg = bus.horn_deg(times_ns)[:, 0]
        assert np.ptp(horn_deg[times_ns < pressed_ns]) > 5.0
        assert np.ptp(horn_deg[times_ns > pressed_ns + rests_s * NS]) < 0.3
