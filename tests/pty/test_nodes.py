"""The example nodes: what they take from a network leads joints, and what is wrong is refused."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import math
import sys
import types
from pathlib import Path

import pytest

import lss_motion as lss

pytestmark = pytest.mark.realtime

NODES = Path(__file__).resolve().parents[2] / "sequences" / "nodes"
ARM = NODES.parent / "robots" / "desk_arm.yaml"


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, NODES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_lines_of_json_lead_joints(capfd):
    node = loaded("targets_asyncio")

    async def talk(live):
        serving = asyncio.create_task(node.serve(live, 0))
        while not (printed := capfd.readouterr().out):
            await asyncio.sleep(0.01)
        tcp_port = int(printed.split(";")[0].rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", tcp_port)

        async def ask(line):
            writer.write(line + b"\n")
            return json.loads(await asyncio.wait_for(reader.readline(), 30.0))

        refused = [
            await ask(line)
            for line in (b"elbow 3", b"[3]", b'{"elbo": 3}', b'{"elbow": "x"}', b'{"elbow": NaN}')
        ]
        for _ in range(3000):
            found = await ask(b'{"elbow": 30}')
            if abs(found["deg"]["elbow"] - 30.0) < 0.5:
                break
            await asyncio.sleep(0.01)
        writer.write(b"x" * 10_000)  # A line without end costs the client its connection only.
        assert await asyncio.wait_for(reader.read(), 30.0) == b""
        writer.close()
        serving.cancel()
        return refused, found

    with lss.connect(lss.load_robot(ARM)) as live:
        live.set_target({})
        refused, found = asyncio.run(talk(live))
    assert [list(one) for one in refused] == [["refused"]] * 5
    assert "did you mean 'elbow'" in refused[2]["refused"]
    assert found["deg"]["elbow"] == pytest.approx(30.0, abs=0.5)


def test_the_node_of_ros_is_imported_without_ros():
    node = loaded("targets_ros2")
    assert "rclpy" not in sys.modules
    assert node.targets_deg(["a"], [math.pi]) == pytest.approx({"a": 180.0})
    assert node.states_rad({"a": 180.0, "b": 0.0}) == (["a", "b"], [math.pi, 0.0])
    with pytest.raises(lss.InputError, match="2 names and 1 positions"):
        node.targets_deg(["a", "b"], [0.0])


class StandInNode:
    """What the node uses of rclpy; `spin` gives it messages, then a Ctrl-C."""

    def __init__(self, name):
        self.name, self.published, self.warned = name, [], []

    def create_publisher(self, kind, topic, depth):
        assert topic == "joint_states"
        return types.SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind, topic, follow, depth):
        assert topic == "joint_targets"
        self.follow = follow

    def create_timer(self, period_s, report):
        self.report = report

    def get_logger(self):
        return types.SimpleNamespace(warning=self.warned.append)

    def get_clock(self):
        return types.SimpleNamespace(now=lambda: types.SimpleNamespace(to_msg=lambda: "now"))

    def destroy_node(self):
        self.name = "destroyed"


def test_the_node_of_ros_follows_and_reports_with_a_stand_in(monkeypatch):
    nodes = []

    def spin(node):
        nodes.append(node)
        node.follow(types.SimpleNamespace(name=["elbo"], position=[0.1]))
        node.follow(types.SimpleNamespace(name=["elbow"], position=[]))
        for _ in range(3000):
            node.follow(types.SimpleNamespace(name=["elbow"], position=[0.5]))
            node.report()
            last = node.published[-1]
            if abs(dict(zip(last.name, last.position, strict=True)).get("elbow", 0) - 0.5) < 0.01:
                raise KeyboardInterrupt
            asyncio.run(asyncio.sleep(0.01))

    rclpy = types.ModuleType("rclpy")
    rclpy.init, rclpy.spin, rclpy.ok, rclpy.shutdown = lambda args: None, spin, lambda: False, None
    state = lambda: types.SimpleNamespace(header=types.SimpleNamespace())  # noqa: E731
    for name, module in {
        "rclpy": rclpy,
        "rclpy.node": types.SimpleNamespace(Node=StandInNode),
        "sensor_msgs": types.ModuleType("sensor_msgs"),
        "sensor_msgs.msg": types.SimpleNamespace(JointState=state),
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    loaded("targets_ros2").main([str(ARM)])
    [node] = nodes
    assert node.name == "destroyed"
    assert len(node.warned) == 2
    assert "did you mean 'elbow'" in node.warned[0]
    last = node.published[-1]
    assert last.header.stamp == "now"
    assert len(last.name) == len(last.position) == 5
