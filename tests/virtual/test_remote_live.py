"""A robot without a show that a client moves: judged by horns, bytes and what it is told."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

import lss_motion as lss
from lss_motion.maintenance.guided import ServoTasks
from lss_motion.playing.live_end import LiveSession
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.operator_end import Operator
from lss_motion.system.messages import Kind, MessagePipe, PipeClosedError
from tests.timed_moves import is_move

S = 1_000_000_000
SPEED_DEG_S = 40.0


class LiveClient:
    """Sends at instants of virtual time; its link is read on each turn."""

    def __init__(self, script):
        self.end, other = socket.socketpair()
        for one in (self.end, other):
            one.setblocking(False)
        self.link, self.events = MessagePipe(self.end), []
        self.operator = Operator(MessagePipe(other))
        self.script, self.began_ns = sorted(script, key=lambda step: step[0]), None
        take = self.operator.take

        def act(now_ns):
            self.read()
            if self.began_ns is None and any(
                e.event == "robot" and e.state == "live" for e in self.events
            ):
                self.began_ns = now_ns
            while (
                self.script
                and self.began_ns is not None
                and now_ns - self.began_ns >= self.script[0][0] * S
            ):
                step = self.script.pop(0)[1]
                step(self) if callable(step) else self.send(step)
            return take(now_ns)

        self.operator.take = act

    def send(self, operation):
        self.link.send(Kind.OPERATION, operation.to_json())

    def read(self):
        with contextlib.suppress(PipeClosedError, OSError):
            while got := self.link.receive():
                self.events += [m.parse_event(content) for _, content in got]

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]

    def close(self):
        self.read()
        self.link.close()
        self.operator.link.close()


@pytest.fixture
def robot(tmp_path):
    path = Path(tmp_path, "arm.yaml")
    path.write_text(
        "robot: arm\n"
        "buses: {main: {port: 'sim://', baud_bps: 115200, firmware: 370}}\n"
        f"approach_speed_deg_s: {SPEED_DEG_S:g}\n"
        "joints:\n"
        "  a: {id: 1, model: LSS-ST1, range_deg: [-30, 30], speed_max_deg_s: 180,"
        " accel_max_deg_s2: 600}\n"
        "  b: {id: 2, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180,"
        " accel_max_deg_s2: 600}\n"
        "poses:\n"
        "  up: {a: 20}  # as high as it goes\n"
    )
    return lss.load_robot(path)


def run(robot, *script):
    """Return client, bus, times from the first state on, and the horns then."""
    client = LiveClient(script)
    with lss.connect(robot, is_virtual=True) as live:
        LiveSession(live, client.operator, ServoTasks()).run()
        (bus,) = live._connection.simulated.values()
        clock = live._connection.clock
    client.close()
    times_ns = np.arange(client.began_ns, clock.now_ns(), 5_000_000)
    return client, bus, (times_ns - client.began_ns) / S, bus.horn_deg(times_ns)


def jogs(joint, ratio, from_s, to_s, every_s=0.1):
    times_s = np.arange(from_s, to_s, every_s)
    return [(at_s, m.Jog(joint=joint, speed_ratio=ratio)) for at_s in times_s]


def test_a_joint_turns_while_the_client_says_so_and_stops_when_it_is_silent(robot):
    _, bus, times_s, horn_deg = run(robot, *jogs("b", 0.5, 0.1, 1.1), (2.0, m.Stop()))
    b = horn_deg[:, 1]
    speed = np.gradient(b, times_s)
    steady = (times_s > 0.5) & (times_s < 1.0)
    assert speed[steady].mean() == pytest.approx(0.5 * SPEED_DEG_S, rel=0.1)
    # Without steps: the speed never falls back between two targets.
    assert speed[steady].min() > 0.3 * SPEED_DEG_S
    assert np.abs(speed).max() < 0.75 * SPEED_DEG_S
    assert np.diff(b).min() > -0.01, "it never goes back"
    rest_s = times_s[np.abs(b - b[-1]) > 0.5][-1]
    assert rest_s < 1.0 + 0.25 + 0.05 + 0.2, "250 ms, a step, and the way to brake"
    assert np.abs(horn_deg[:, 0]).max() < 0.5
    assert bus.lines[-1][1] == b"#254H\r"


def test_a_zero_stops_it_at_once_and_targets_lie_close_ahead(robot):
    _, bus, times_s, horn_deg = run(
        robot,
        *jogs("b", 1.0, 0.1, 0.9),
        (0.9, m.Jog(joint="b", speed_ratio=0.0)),
        (2.0, m.Stop()),
    )
    b = horn_deg[:, 1]
    assert b[-1] == pytest.approx(SPEED_DEG_S * 0.8, rel=0.15)
    assert times_s[np.abs(b - b[-1]) > 0.5][-1] < 1.1
    assert np.diff(b).min() > -0.01, "it never goes back"
    # If this process were killed, the servo would stop by itself near where it is.
    for at_ns, line in bus.lines:
        if is_move(line) and line.startswith(b"#2D"):
            target_deg = int(line[3 : line.index(b"T")]) / 10
            ahead_deg = target_deg - bus.horn_deg(np.array([at_ns]))[0, 1]
            assert ahead_deg < SPEED_DEG_S * 0.4


def test_a_joint_stays_in_its_range_and_the_limits_hold(robot):
    _, _, times_s, horn_deg = run(
        robot, *jogs("a", 1.0, 0.1, 2.5), *jogs("b", -1.0, 0.1, 2.5), (3.5, m.Stop())
    )
    assert horn_deg[:, 0].max() == pytest.approx(30.0, abs=0.5)
    speed = np.abs(np.gradient(horn_deg, times_s, axis=0))
    assert speed.max() < 1.3 * SPEED_DEG_S
    assert horn_deg[-1, 1] == pytest.approx(-SPEED_DEG_S * 2.6, rel=0.15)


def drags(joint, to_deg, from_s, to_s):
    return [(at_s, replace(jog, to_deg=to_deg)) for at_s, jog in jogs(joint, 1.0, from_s, to_s)]


def test_a_joint_that_is_dragged_turns_to_the_angle_and_not_beyond(robot):
    _, _, times_s, horn_deg = run(
        robot,
        *drags("b", 25.0, 0.1, 1.5),
        *drags("b", -10.0, 1.5, 3.5),
        *drags("a", 500.0, 0.1, 2.0),
        (4.5, m.Stop()),
    )
    b = horn_deg[:, 1]
    assert b.max() == pytest.approx(25.0, abs=0.5)
    assert b[-1] == pytest.approx(-10.0, abs=0.5)
    assert b.min() > -10.6, "it does not swing beyond"
    assert horn_deg[:, 0].max() == pytest.approx(30.0, abs=0.5), "the end of its range"
    speed = np.abs(np.gradient(horn_deg, times_s, axis=0))
    assert speed.max() < 1.5 * SPEED_DEG_S, "where it turns back it makes up for its lag"


def test_a_joint_that_is_dragged_stops_when_the_client_is_silent(robot):
    _, _, times_s, horn_deg = run(robot, *drags("b", 85.0, 0.1, 0.6), (2.5, m.Stop()))
    b = horn_deg[:, 1]
    assert 10.0 < b[-1] < 40.0
    assert times_s[np.abs(b - b[-1]) > 0.5][-1] < 0.6 + 0.25 + 0.05 + 0.2


def test_a_pose_is_planned_and_limp_joints_stay_limp(robot):
    client, bus, _, horn_deg = run(
        robot,
        (0.1, m.Limp(id=1, joints=("b",))),
        (0.5, m.PoseGo(id=2, pose="up", duration_s=2.0)),
        (0.6, m.PoseGo(id=3, pose="up")),
        (4.5, m.PoseGo(id=4, pose="nowhere")),
        (5.0, m.Jog(id=5, joint="c", speed_ratio=1.0)),
        (6.0, m.Disconnect(id=6)),
    )
    assert [event.id for event in client.of(m.Accepted)] == [1, 2, 6]
    texts = {event.id: event.text for event in client.of(m.Refused)}
    assert "moves to a pose" in texts[3] or "being asked" in texts[3]
    assert "unknown pose 'nowhere'" in texts[4]
    assert "unknown joint 'c'" in texts[5]
    assert horn_deg[-1, 0] == pytest.approx(20.0, abs=0.5)
    last = client.of(m.RobotChanged)[-1]
    assert last.joints["b"].is_limp
    assert last.joints["a"].deg == pytest.approx(20.0, abs=0.5)
    orders = [line for _, line in bus.lines if line in (b"#2L\r", b"#254H\r")]
    assert orders[-3:] == [b"#2L\r", b"#254H\r", b"#254H\r"]


@pytest.mark.parametrize(
    ("end", "order", "last"),
    [
        ("limp", m.Disconnect(), b"#254L\r"),
        ("limp", m.Stop(), b"#254H\r"),
        ("hold", m.Disconnect(), b"#254H\r"),
    ],
)
def test_the_end_of_the_robot_file_comes_where_nothing_was_stopped(robot, end, order, last):
    robot = replace(robot, end=end)
    _, bus, _, _ = run(robot, *jogs("a", 1.0, 0.1, 0.5), (0.5, order))
    assert bus.lines[-1][1] == last


@pytest.mark.parametrize("in_pose", [False, True])
@pytest.mark.parametrize("how", ["estop", "gone"])
def test_an_emergency_and_a_client_that_is_gone_leave_a_robot_that_holds(robot, in_pose, how):
    leave = m.Estop() if how == "estop" else lambda client: client.end.close()
    begin = [(0.1, m.PoseGo(pose="up", duration_s=5.0))] if in_pose else jogs("b", 1.0, 0.1, 9.0)
    client, bus, times_s, _ = run(robot, *begin, (2.0, leave))
    assert times_s[-1] < 4.0
    assert bus.lines[-1][1] == b"#254H\r"
    moves = [at_ns for at_ns, line in bus.lines if is_move(line)]
    assert (moves[-1] - client.began_ns) / S < 2.5


def test_a_pose_is_saved_into_the_robot_file_and_known_at_once(robot):
    before = robot.path.read_text()
    client, _, _, horn_deg = run(
        robot,
        *jogs("b", 1.0, 0.1, 0.5),
        (0.3, m.PoseSave(id=1, pose="mine", is_new=True)),
        (1.5, m.PoseSave(id=2, pose="mine", is_new=True)),
        (1.6, m.PoseSave(id=3, pose="mine", is_new=True)),
        (1.7, m.PoseSave(id=4, pose="up", is_new=False)),
        (1.8, m.PoseSave(id=5, pose="none", is_new=False)),
        (1.9, m.PoseGo(id=6, pose="mine")),
        (4.0, m.Stop(id=7)),
    )
    accepted = [event.id for event in client.of(m.Accepted) if event.id and event.op != "jog"]
    assert accepted == [2, 4, 6, 7]
    texts = {event.id: event.text for event in client.of(m.Refused)}
    assert "let it stop" in texts[1]
    assert "exists" in texts[3]
    assert "unknown pose 'none'" in texts[5]
    poses = lss.load_robot(robot.path).poses
    assert poses["mine"] == pytest.approx({"a": 0.0, "b": horn_deg[-1, 1]}, abs=0.5)
    assert poses["up"] == pytest.approx({"a": 0.0}, abs=0.3), "only the joints that it has"
    assert robot.path.read_text().startswith(before.split("  up:")[0])
    assert "# as high as it goes" in robot.path.read_text()


def answers(*texts, then):
    """Return a step that answers each question when it comes, then sends the last operation."""
    waiting = list(texts)

    def step_at(at_s):
        def step(client):
            asked = client.of(m.MaintenanceChanged)
            if asked and asked[-1].state in ("done", "failed", "stopped"):
                client.send(then)
                return
            if (
                waiting
                and asked
                and asked[-1].question
                and waiting[0] in asked[-1].question.answers
            ):
                client.send(m.MaintenanceAnswer(id=7, answer=waiting.pop(0)))
            client.script.append((at_s + 0.2, step_at(at_s + 0.2)))

        return step

    return (0.3, step_at(0.3))


def test_a_joint_is_identified_and_what_was_found_is_written_when_agreed(robot):
    client, bus, _, horn_deg = run(
        robot,
        (0.1, m.Maintain(id=5, what="identify", joint="b")),
        answers("Write it to the robot file", then=m.Stop()),
    )
    told = client.of(m.MaintenanceChanged)
    assert [one.state for one in told if one.state != "running"] == ["asking", "done"]
    shares = [one.progress for one in told if one.progress is not None]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    step, _ = told[-1].result.plots
    read, model = step.series
    assert np.ptp(read.y) > 10.0
    off = np.interp(read.x, model.x, model.y) - np.array(read.y)
    assert np.abs(off).max() < 1.0, "the model of the step is what was read"
    response = lss.load_robot(robot.path).joints["b"].response
    assert 0.005 < response.lag_s < 0.05
    assert np.ptp(horn_deg[:, 1]) > 20.0
    assert np.abs(horn_deg[:, 0]).max() < 0.5, "the other joint holds"
    assert "# as high as it goes" in robot.path.read_text()
    assert "# b identified" in robot.path.read_text()
    assert bus.lines[-1][1] == b"#254H\r"


def test_a_calibration_that_is_left_holds_the_joint_and_writes_nothing(robot):
    text = robot.path.read_text()
    client, bus, _, _ = run(
        robot,
        (0.1, m.MaintenanceAnswer(id=3, answer="Cancel")),
        (0.2, m.Maintain(id=4, what="calibrate", joint="b")),
        (0.5, m.MaintenanceAnswer(id=5, answer="I hold it: make it limp")),
        (1.0, m.MaintenanceAnswer(id=6, answer="It is at zero")),
        (1.2, m.MaintenanceAnswer(id=7, answer="Yes")),
        (1.5, m.Maintain(id=8, what="calibrate", joint="nobody")),
        (2.0, m.Stop()),
    )
    refused = {one.id: one.text for one in client.of(m.Refused)}
    assert list(refused) == [3, 7, 8]
    assert "nothing is asked" in refused[3]
    assert "Keep its direction" in refused[7]
    told = client.of(m.MaintenanceChanged)
    assert [one.state for one in told] == ["asking", "asking", "asking", "stopped"]
    assert any(state.joints["b"].is_limp for state in client.of(m.RobotChanged))
    assert robot.path.read_text() == text
    orders = [line for _, line in bus.lines if line in (b"#2L\r", b"#2H\r", b"#254H\r")]
    assert orders[0] == b"#2L\r"
    assert orders[-1] == b"#254H\r"


def test_the_health_of_every_servo_is_told(robot):
    client, bus, _, _ = run(robot, *jogs("b", 0.5, 0.5, 0.8), (3.0, m.Stop()))
    states = [state.joints for state in client.of(m.RobotChanged) if state.state == "live"]
    assert [joint.is_limp for joint in states[0].values()] == [True, True], "as after power-up"
    assert [joint.is_limp for joint in states[-1].values()] == [True, False], "b was moved"
    health = client.of(m.Health)
    assert health[-1].phase == "live"
    for name in ("a", "b"):
        joint = health[-1].joints[name]
        assert 15.0 < joint.temperature_c < 60.0
        assert 6.0 < joint.voltage_v < 13.0
        assert joint.current_a is not None
        assert joint.status
    words = [line[2:-1] for _, line in bus.lines]
    assert words.count(b"QD") > 8 * words.count(b"QT"), "angles come first"
