"""A log as MCAP, opened by the reader of the library: topics, times, angles and events."""

from __future__ import annotations

import builtins
import io
import json
import math
import struct
from pathlib import Path

import pytest

from lss_motion.cli.main import main
from lss_motion.cli.play import main as play
from lss_motion.errors import InputError
from lss_motion.playing.log import read_log
from lss_motion.playing.log_mcap import mcap_of_log
from lss_motion.robot.load import load_robot

reader = pytest.importorskip("mcap.reader")

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"

LOG = r"""{"format":"lss_motion log","version":3}
["sent",500000000,"main","#1D300T1000\r#2"]
["sent",500100000,"main","D-50T1000\r"]
["received",600000000,"main","*1QD"]
["received",700000000,"main","150\r*2QD-20\r*9QD5\r"]
["happened",750000000,{"type":"MarkPassed","label":"up","show_s":1.5}]
["happened",760000000,{"type":"PhaseEntered","phase":"playing"}]
["requested",770000000,{"name":"rate","values":[0.5]}]
["port",780000000,"main","lost","gone"]
["ended",800000000]
"""
ROBOT = """\
robot: two
defaults: {model: LSS-ST1, range_deg: [-170, 170], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 1}
  tilt: {id: 2, direction: -1, zero_deg: 5}
"""


def joint_state(data: bytes) -> tuple[int, list[str], list[float]]:
    """Decode a JointState as ROS 2 does: time in ns, names, positions in degrees."""
    assert data[:4] == b"\x00\x01\x00\x00"
    body, at = data[4:], 0

    def take(form: str):
        nonlocal at
        size = struct.calcsize(form)
        at += -at % size
        (value,) = struct.unpack_from("<" + form, body, at)
        at += size
        return value

    def text() -> str:
        nonlocal at
        size = take("I")
        at += size
        return body[at - size : at - 1].decode()

    at_ns = take("i") * 1_000_000_000 + take("I")
    assert text() == ""
    names = [text() for _ in range(take("I"))]
    angles = [math.degrees(take("d")) for _ in range(take("I"))]
    assert (take("I"), take("I"), at) == (0, 0, len(body))
    return at_ns, names, angles


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    (tmp_path / "run.log").write_text(LOG, encoding="ascii")
    return tmp_path


def test_readings_targets_and_events_have_their_times(folder: Path) -> None:
    lines = read_log(folder / "run.log").lines
    data = mcap_of_log(lines, load_robot(folder / "robot.yaml"))
    found = [
        (channel.topic, schema.name, message.log_time, message.data)
        for schema, channel, message in reader.make_reader(io.BytesIO(data)).iter_messages()
    ]
    states = {
        topic: [joint_state(data) for at, _, _, data in found if at == topic]
        for topic in ("/joint_states", "/joint_commands")
    }
    for topic, expected in {
        "/joint_commands": [(500_000_000, "pan", 30.0), (500_100_000, "tilt", 10.0)],
        "/joint_states": [(700_000_000, "pan", 15.0), (700_000_000, "tilt", 7.0)],
    }.items():
        assert [(at_ns, *names) for at_ns, names, _ in states[topic]] == [
            (at_ns, name) for at_ns, name, _ in expected
        ]
        angles = [angle for _, _, (angle,) in states[topic]]
        assert angles == pytest.approx([angle for _, _, angle in expected])
    assert {name for topic, name, _, _ in found if topic != "/events"} == {
        "sensor_msgs/msg/JointState"
    }
    events = [(at_ns, json.loads(data)) for topic, _, at_ns, data in found if topic == "/events"]
    assert events == [
        (750_000_000, {"type": "MarkPassed", "label": "up", "show_s": 1.5}),
        (760_000_000, {"type": "PhaseEntered", "phase": "playing"}),
        (770_000_000, {"type": "Request", "text": "rate 0.5"}),
        (780_000_000, {"type": "Port", "bus": "main", "text": "lost gone"}),
    ]


def test_a_messages_is_decoded_by_the_support_for_ros(folder: Path) -> None:
    support = pytest.importorskip("mcap_ros2.decoder", reason="install lss-motion[dev]")
    lines = read_log(folder / "run.log").lines
    data = mcap_of_log(lines, load_robot(folder / "robot.yaml"))
    opened = reader.make_reader(io.BytesIO(data), decoder_factories=[support.DecoderFactory()])
    decoded = [m for _, _, _, m in opened.iter_decoded_messages(topics=["/joint_states"])]
    assert [m.name for m in decoded] == [["pan"], ["tilt"]]
    assert math.degrees(decoded[1].position[0]) == pytest.approx(7.0)
    assert decoded[0].header.stamp.nanosec == 700_000_000


def test_the_log_of_a_show_is_exported_with_the_names_of_its_robot(tmp_path, capsys) -> None:
    log, output = tmp_path / "wave.log", tmp_path / "wave.mcap"
    show = str(EXAMPLES / "wave.yaml")
    assert play([show, "--virtual", "--loop", "1", "--log", str(log)]) == 0
    assert main(["export", str(log), "-o", str(output)]) == 0
    with output.open("rb") as stream:
        summary = reader.make_reader(stream).get_summary()
        messages = list(reader.make_reader(stream).iter_messages(topics=["/joint_states"]))
    assert {channel.topic for channel in summary.channels.values()} == {
        "/joint_states",
        "/joint_commands",
        "/events",
    }
    names = {name for _, _, message in messages for name in joint_state(message.data)[1]}
    assert names == set(load_robot(EXAMPLES / "robots/desk_arm.yaml").joints)
    assert main(["export", show, "--to", "mcap", "-o", str(output)]) == 2
    assert "not a log" in capsys.readouterr().err


def test_a_log_without_a_show_needs_a_robot(folder: Path, capsys) -> None:
    words = ["export", str(folder / "run.log"), "-o", str(folder / "run.mcap")]
    assert main(words) == 2
    assert "add --robot FILE" in capsys.readouterr().err
    assert main([*words, "--robot", str(folder / "robot.yaml")]) == 0


def test_without_the_library_the_message_tells_what_to_install(monkeypatch, folder: Path) -> None:
    found = builtins.__import__

    def without(name, *rest):
        if name.startswith("mcap"):
            raise ImportError(name)
        return found(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    lines = read_log(folder / "run.log").lines
    with pytest.raises(InputError, match=r"MCAP needs a library: .*mcap"):
        mcap_of_log(lines, load_robot(folder / "robot.yaml"))


def test_joints_behind_mechanisms_follow_from_their_servos(tmp_path) -> None:
    log, output = tmp_path / "head.log", tmp_path / "head.mcap"
    show = str(EXAMPLES / "head.yaml")
    assert play([show, "--virtual", "--log", str(log)]) == 0
    assert main(["export", str(log), "-o", str(output)]) == 0
    with output.open("rb") as stream:
        found = [m.data for _, _, m in reader.make_reader(stream).iter_messages(["/joint_states"])]
    last: dict[str, float] = {}
    widest: dict[str, float] = {}
    for _, (name,), (deg,) in map(joint_state, found):
        last[name], widest[name] = deg, max(widest.get(name, 0.0), abs(deg))
    assert {"tilt", "roll", "pan", "jaw", "servo:neck.left", "servo:jaw"} <= last.keys()
    assert "neck.left" not in last
    # At the end it stands: the rows of the matrix of the neck, solved by hand.
    left, right = last["servo:neck.left"], last["servo:neck.right"]
    assert last["tilt"] == pytest.approx((left + right) / 3.6, abs=0.1)
    assert last["roll"] == pytest.approx((left - right) / 2.4, abs=0.1)
    assert last["pan"] == pytest.approx(last["servo:pan"] / 2.0, abs=0.1)
    limits = load_robot(EXAMPLES / "robots" / "head.yaml").joints
    for name in ("tilt", "roll", "pan", "jaw"):
        joint = limits[name]
        assert 3.0 < widest[name] < 1.0 + max(-joint.position_min_deg, joint.position_max_deg)
