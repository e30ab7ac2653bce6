"""One computer of a stage, between its network and its player."""

import json
import time
from types import SimpleNamespace

import pytest

from lss_motion.playing.remote import stage_messages as s
from lss_motion.robot.load import load_robot
from lss_motion.stage.hosts.host import Host
from lss_motion.stage.hosts.messages import Ask, packed
from lss_motion.stage.hosts.peer import NetworkArrival, NetworkSettings

ROBOT = """\
robot: arm
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
defaults: {model: LSS-ST1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {j: {id: 1, range_deg: [-90, 90]}}
"""
FIGURES = ("left", "right")


class PeerStub:
    """A network that delivers what the test gives it."""

    def __init__(self):
        self.arrivals, self.sent = [], []

    def take(self, _timeout_s):
        taken, self.arrivals = self.arrivals, []
        return taken

    def send(self, key, content):
        self.sent.append((key, content))

    def __getattr__(self, _name):
        return lambda *_: None


@pytest.fixture
def conductor(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    player = SimpleNamespace(stop=lambda: None, report=lambda _: None)
    peer = PeerStub()
    settings = NetworkSettings(
        stage="hall", figure="left", conductor="left", figures=FIGURES, address="127.0.0.1:7447"
    )
    robot = load_robot(tmp_path / "robot.yaml")
    store = SimpleNamespace(get=lambda _: None)
    host = Host(settings, robot, player, store, lambda _: peer, version="test")
    host.player.report = lambda _: host.figure.player
    return host, peer


def asked(host, peer, figure, number):
    ask = Ask(operation=s.FireCue(label="x"), number=number, instance="0" * 16)
    peer.arrivals.append(NetworkArrival("message", f"figure/{figure}/ask", packed(ask), 0))
    host.turn()
    return len(host.cues)


def test_a_wish_that_is_repeated_counts_once_and_a_forged_number_silences_nobody(conductor):
    host, peer = conductor
    assert asked(host, peer, "right", 1) == 1
    assert asked(host, peer, "right", 1) == 1
    assert asked(host, peer, "right", 10**9) == 2
    assert asked(host, peer, "right", 2) == 3
    assert asked(host, peer, "right", 1) == 3
    assert asked(host, peer, "nobody", 5) == 3


def test_a_computer_of_another_version_is_named_whatever_its_messages_have(conductor):
    host, peer = conductor
    beat = {**json.loads(packed(host.conductor.beat())), "protocol": 9, "moon": "full"}
    status = {**json.loads(packed(host.figure.status(0))), "protocol": 2, "figure": "right"}
    del status["leg"]
    for key, message in (("beat", beat), ("figure/right/status", status), ("beat", [1, 2])):
        now_ns = time.monotonic_ns()
        peer.arrivals.append(NetworkArrival("message", key, json.dumps(message).encode(), now_ns))
        host.turn()
    told = " ".join(host.figure._refused)
    assert "the conductor has protocol 9, this figure" in told
    problems = host.conductor.problems(time.monotonic_ns())
    assert any(one.startswith("right: it has protocol 2, the conductor") for one in problems)
