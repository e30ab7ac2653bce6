"""Robots with mechanisms and RC servos without a show: jog, poses, limp, by hand; judged at horns.

The judge finds joints by solving for them, with no code of the package.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import lss_motion as lss
from lss_motion.cli.main import main
from lss_motion.maintenance.guided import ServoTasks
from lss_motion.maintenance.take import Take
from lss_motion.playing.connection import connect
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.live_end import LiveSession
from lss_motion.playing.remote import schema as m
from lss_motion.playing.runner import run as run_loop
from lss_motion.robot.load import load_robot
from lss_motion.robot.write import write_frames
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.hand import HandMotion
from lss_motion.system.clock import VirtualClock
from tests.timed_moves import is_move
from tests.unit.robot.test_mechanisms import HEAD, eyes, eyes_csv
from tests.virtual.test_hand import HandPerson
from tests.virtual.test_remote_live import LiveClient, jogs

S = 1_000_000_000
EXAMPLE = Path(__file__).resolve().parents[2] / "sequences" / "robots" / "head.yaml"
SPEED_DEG_S = 30.0
"""The approach speed of a robot file that does not name one."""
SERVOS = [
    *("turret", "jaw", "lid", "neck.left", "neck.right", "shoulder.front", "shoulder.back"),
    *("eyes.a", "eyes.b"),
]


def written(folder: Path, text: str = HEAD) -> lss.Robot:
    (folder / "eyes.csv").write_text(eyes_csv(), encoding="utf-8")
    path = folder / "head.yaml"
    path.write_text(text, encoding="utf-8")
    return load_robot(path)


@pytest.fixture
def head(tmp_path):
    return written(tmp_path)


def joints_of(horn_deg):
    """Return turret, jaw, tilt, roll, arm (front), arm (back), yaw, pitch of rows of horns."""
    turret, jaw, _, left, right, front, back, a, b = horn_deg.T
    fine = np.linspace(-1, 23, 24001)
    table = CubicSpline([0, 5, 12, 22], [-8, 6, 30, 71])(fine)
    tilt, roll = np.linalg.solve([[1.8, 1.2], [1.8, -1.2]], [left, -right])
    yaw, pitch = np.zeros_like(a), np.zeros_like(a)
    for _ in range(100):  # A fixed point of the surfaces that the table was made of.
        now_a, now_b = eyes(yaw, pitch)
        total, apart = (a - now_a) + (b - now_b), (a - now_a) - (b - now_b)
        yaw, pitch = yaw + total / 2.4, pitch + apart / 1.6
    return {
        "turret": turret / 2.5,
        "jaw": np.interp(jaw, table, fine),
        "tilt": tilt,
        "roll": roll,
        "arm": front,
        "arm_back": -(back - 0.4),
        "yaw": yaw,
        "pitch": pitch,
    }


class Person:
    """Acts by hand, with the time since the robot could be moved first."""

    def __init__(self, act):
        self._act, self.began_ns = act, None

    def filenos(self):
        return []

    def act(self, driven, now_ns):
        if driven.phase != "playing":
            return
        if self.began_ns is None:
            self.began_ns = now_ns
        self._act(driven, now_ns - self.began_ns)


def session(robot, *script):
    """Return client, bus, times from the first state on, and the horns then."""
    client = LiveClient(script)
    with lss.connect(robot, is_virtual=True) as live:
        (bus,) = live._connection.simulated.values()
        LiveSession(live, client.operator, ServoTasks()).run()
        clock = live._connection.clock
    client.close()
    times_ns = np.arange(client.began_ns, clock.now_ns(), 5_000_000)
    return client, bus, (times_ns - client.began_ns) / S, bus.horn_deg(times_ns)


def test_a_robot_moves_to_angles_of_joints_and_reads_them(head):
    wanted = {"tilt": 15.0, "jaw": 12.0, "yaw": 20.0, "turret": -20.0, "arm": 40.0, "lid": 50.0}
    with lss.connect(head, is_virtual=True) as live:
        live.move_to(wanted, 2.0)
        read = live.read()
        assert {name: read[name] for name in wanted} == pytest.approx(wanted, abs=0.6)
        assert read["roll"] == pytest.approx(0.0, abs=0.6)
        assert read["pitch"] == pytest.approx(0.0, abs=0.6)
        (bus,) = live._connection.simulated.values()
        clock = live._connection.clock
        found = joints_of(bus.horn_deg(np.arange(0, clock.now_ns(), 1_000_000)))
        for name in ("tilt", "jaw", "yaw", "turret", "arm"):
            assert found[name][-1] == pytest.approx(wanted[name], abs=0.6), name
        # The others of a mechanism stay where they stood, on all of the way.
        assert np.abs(found["roll"]).max() < 0.6
        assert np.abs(found["arm"] - found["arm_back"]).max() < 0.5
        speeds = {name: np.abs(np.gradient(deg, 0.001)) for name, deg in found.items()}
        for name, joint in head.joints.items():
            if name in speeds:
                assert speeds[name].max() < 1.1 * joint.speed_max_deg_s, name
        live.limp("roll")
        live.read()
        lines = [line for _, line in bus.lines]
        first = lines.index(b"#5L\r")
        assert lines[first + 1] == b"#6L\r", "both servos of the neck go limp at once"
        live.move_to({"tilt": 0.0}, 2.0)
        with pytest.raises(lss.InputError, match="set_target"):
            live.latency_s("tilt")
        with pytest.raises(lss.InputError, match="range"):
            live.move_to({"jaw": 40.0})


@pytest.mark.parametrize("ratio", [0.5, -0.5])
def test_a_jog_turns_the_joint_at_its_speed_and_no_other(head, ratio):
    script = [*jogs("tilt", ratio, 0.1, 0.9), *jogs("arm", ratio, 0.1, 0.9), (2.0, m.Stop())]
    client, bus, times_s, horn_deg = session(head, *sorted(script, key=lambda step: step[0]))
    found = joints_of(horn_deg)
    steady = (times_s > 0.5) & (times_s < 0.85)
    for name in ("tilt", "arm"):
        speed = np.gradient(found[name], times_s)
        assert speed[steady].mean() == pytest.approx(ratio * SPEED_DEG_S, rel=0.15), name
        assert np.abs(speed).max() < abs(ratio) * SPEED_DEG_S * 1.6, name
    assert np.abs(found["roll"]).max() < 0.4
    assert np.abs(found["arm"] - found["arm_back"]).max() < 0.4
    assert np.abs(found["turret"]).max() < 0.2
    states = [one for one in client.of(m.RobotChanged) if one.joints["tilt"].deg is not None]
    assert {*states[-1].joints} == {*head.joints}
    assert states[-1].joints["tilt"].deg == pytest.approx(found["tilt"][-1], abs=0.4)
    health = [one for one in client.of(m.Health) if one.joints]
    assert {*health[-1].joints} == {*head.joints}
    # Moves of one mechanism leave one right after the other.
    moved = [(at_ns, line) for at_ns, line in bus.lines if is_move(line)]
    for one, other in ((b"#5D", b"#6D"), (b"#7D", b"#8D")):
        firsts = [at_ns for at_ns, line in moved if line.startswith(one)]
        seconds = [at_ns for at_ns, line in moved if line.startswith(other)]
        assert len(firsts) == len(seconds) > 5
        gaps_ns = np.abs(np.array(firsts) - np.array(seconds))
        assert gaps_ns.max() < 4_000_000


def test_two_joints_of_one_mechanism_jog_at_once(head):
    script = [*jogs("tilt", 0.5, 0.1, 0.9), *jogs("roll", -0.3, 0.15, 0.9), (2.0, m.Stop())]
    _, _, times_s, horn_deg = session(head, *sorted(script, key=lambda step: step[0]))
    found = joints_of(horn_deg)
    steady = (times_s > 0.5) & (times_s < 0.85)
    for name, ratio in (("tilt", 0.5), ("roll", -0.3)):
        speed = np.gradient(found[name], times_s)[steady].mean()
        assert speed == pytest.approx(ratio * SPEED_DEG_S, rel=0.25), name


def test_ranges_hold_at_the_joint_and_at_every_servo(tmp_path):
    narrow = HEAD.replace("left: {id: 5}", "left: {id: 5, range_deg: [-20, 20]}")
    robot = written(tmp_path, narrow)
    script = [*jogs("tilt", 1.0, 0.1, 2.5), *jogs("jaw", 1.0, 0.1, 2.5), (3.5, m.Stop())]
    _, _, _, horn_deg = session(robot, *sorted(script, key=lambda step: step[0]))
    found = joints_of(horn_deg)
    assert horn_deg[:, SERVOS.index("neck.left")].max() < 20.5
    assert found["tilt"][-1] == pytest.approx(20 / 1.8, abs=0.4)
    assert np.abs(found["roll"]).max() < 0.5, "what the servo cannot do, the other does not either"
    assert found["jaw"][-1] == pytest.approx(22.0, abs=0.3)
    assert found["jaw"].max() < 22.3


@pytest.mark.parametrize("accel", [100, 900])
def test_no_joint_leaves_its_range_while_others_of_its_mechanism_turn_back(tmp_path, accel):
    """Servos with other ramps, sent elsewhere on the way: each brakes in its own time."""
    text = HEAD.replace("left: {id: 5}", f"left: {{id: 5, accel_max_deg_s2: {accel}}}")
    robot = written(tmp_path, text)
    moves = iter(
        [("tilt", 25.0), ("roll", -15.0), ("tilt", -20.0), ("roll", 15.0), ("tilt", 25.0)] * 3
    )
    clock, sent, hands_on = VirtualClock(), [], HandsOn(robot, ["tilt"])

    def act(driven, passed_ns):
        if passed_ns > len(sent) * 0.45 * S and (move := next(moves, None)):
            sent.append(move)
            driven.move(*move, 0.4)
        if passed_ns > 12 * S:
            driven.stop()

    person = Person(act)
    with connect(robot.buses, robot=robot, clock=clock) as connection:
        run_loop(hands_on, connection.ports, clock, controls=person)
        bus = connection.simulated["main"]
    found = joints_of(bus.horn_deg(np.arange(person.began_ns, clock.now_ns(), 2_000_000).tolist()))
    assert len(sent) == 15
    for name in ("tilt", "roll"):
        joint = robot.joints[name]
        assert found[name].min() > joint.position_min_deg - 0.8, name
        assert found[name].max() < joint.position_max_deg + 0.8, name
    assert found["tilt"][-1] == pytest.approx(25.0, abs=0.5), "it comes there at the end"


def test_mechanisms_go_limp_and_hold_together(head):
    _, bus, _, _ = session(
        head, (0.2, m.Limp(joints=("arm",))), (0.8, m.Hold(joints=("arm",))), (1.5, m.Stop())
    )
    lines = [line for _, line in bus.lines]
    for word in (b"L", b"H"):
        first = lines.index(b"#7" + word + b"\r")
        assert b"#8" + word + b"\r" in lines[first : first + 2]


def test_a_silent_servo_stops_all_of_its_mechanism(head):
    """Nothing more is sent to its mate than that it holds."""
    clock, wanted = VirtualClock(), iter(np.arange(1.0, 12.0, 0.2))
    hands_on = HandsOn(head, ["tilt"])
    events, due_ns = [], [0]

    def act(driven, passed_ns):
        if passed_ns == 0 or passed_ns > due_ns[0]:
            due_ns[0] = passed_ns + S // 5
            if (deg := next(wanted, None)) is not None and passed_ns < 6 * S:
                driven.move("tilt", float(deg), 0.2)
        if passed_ns > 8 * S:
            driven.stop()

    fault = Fault(kind=FaultKind.LOST_REPLY, at_s=4.0, servo_id=5)
    with connect(head.buses, robot=head, clock=clock, faults=(fault,)) as connection:
        run_loop(hands_on, connection.ports, clock, controls=Person(act), on_event=events.append)
        bus = connection.simulated["main"]
    lines = [(at_ns / S, line) for at_ns, line in bus.lines]
    held = next(at_s for at_s, line in lines if line == b"#6H\r")
    assert held < 5.5
    assert not [line for at_s, line in lines if at_s > held and is_move(line)]
    assert any("left servo of neck: does not answer" in str(one) for one in events)


def test_a_servo_that_restarts_lets_its_mate_hold(head):
    clock, events, turns = VirtualClock(), [], itertools.count()
    hands_on = HandsOn(head, ["arm"])

    def act(driven, passed_ns):
        if next(turns) % 40 == 0:
            driven.move("arm", 20.0, 2.0)
        if passed_ns > 6 * S:
            driven.stop()

    fault = Fault(kind=FaultKind.RESET, at_s=3.5, servo_id=7)
    with connect(head.buses, robot=head, clock=clock, faults=(fault,)) as connection:
        run_loop(hands_on, connection.ports, clock, controls=Person(act), on_event=events.append)
        bus = connection.simulated["main"]
    assert hands_on.error is None
    told = [str(one) for one in events]
    assert any("front servo of shoulder: " in text and "It is limp" in text for text in told), told
    lines = [line for _, line in bus.lines]
    assert b"#8H\r" in lines


def test_what_a_hand_showed_is_recorded_in_joints(head):
    """The servos are read one after the other; the joints are those of one instant."""
    times_s = np.arange(0.0, 12.0, 0.01)
    tilt = 12.0 * np.sin(2.0 * times_s)
    roll = 8.0 * np.sin(1.3 * times_s + 0.5)
    hand = HandMotion(
        times_s,
        {"neck.left": 1.8 * tilt + 1.2 * roll, "neck.right": 1.8 * tilt - 1.2 * roll},
    )
    take, clock = Take(("tilt", "roll")), VirtualClock()
    hands_on = HandsOn(head, ["tilt"])
    assert [joint.name for joint in hands_on.joints] == ["tilt", "roll"]
    with connect(head.buses, robot=head, clock=clock, hand=hand) as connection:
        person = HandPerson(take, 5.0)
        run_loop(hands_on, connection.ports, clock, controls=person)
        bus = connection.simulated["main"]
    (part,) = take.parts
    assert {*part.times_s} == {"tilt", "roll"}
    for name in ("tilt", "roll"):
        at_ns = person.began_ns + np.array(part.times_s[name]) * S
        assert len(at_ns) > 300
        found = joints_of(bus.horn_deg(at_ns.astype(np.int64).tolist()))[name]
        off = np.array(part.angles_deg[name]) - found
        assert np.abs(off[20:]).max() < 0.15, name


def test_rc_servos_jog_and_stand_in_poses(tmp_path):
    """Their board reports what was sent last; they are led there, since they would jump."""
    path = tmp_path / "head.yaml"
    path.write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
    robot = load_robot(path)
    script = [
        *jogs("eye_yaw", 1.0, 0.1, 0.6),
        *jogs("left_lid", 1.0, 0.1, 0.9),
        (1.6, m.PoseSave(pose="looks", is_new=True)),
        (1.8, m.PoseGo(pose="awake")),
        (8.0, m.Stop()),
    ]
    client, bus, times_s, horn_deg = session(robot, *sorted(script, key=lambda step: step[0]))
    names = list(robot.servos)
    eye = horn_deg[:, names.index("eye_yaw")] / 1.3
    before = times_s < 1.7
    speed = np.gradient(eye[before], times_s[before])
    assert eye[before][-1] - eye[0] > 8.0
    assert np.abs(np.convolve(speed, np.ones(20) / 20, "valid")).max() < 1.5 * SPEED_DEG_S
    steps = [int(line[4:].lstrip(b"D")) for _, line in bus.lines if line.startswith(b"#211D")]
    assert steps
    assert all(wire % 10 == 0 for wire in steps), "whole degrees"
    first = [wire for wire in steps if wire > 30][:20]
    assert max(np.diff(first)) <= 20, "two degrees at most at once"
    saved = load_robot(path).poses["looks"]
    assert {*saved} == {*robot.joints}
    assert saved["eye_yaw"] == pytest.approx(eye[before][-1], abs=1.0)
    assert saved["left_lid"] > 10.0
    told = [one.text for one in client.of(m.WarningRaised)]
    assert not [text for text in told if "pose" in text], told
    lid = horn_deg[-1, names.index("left_lid")]
    awake = robot.mechanisms["left_lid"].transmission.servo_deg(np.array([[40.0]]))[0, 0]
    assert lid == pytest.approx(awake, abs=1.0)


def test_record_says_what_has_no_reading(tmp_path, capsys):
    path = tmp_path / "head.yaml"
    path.write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
    out = tmp_path / "shown.yaml"
    words = ["record", "--robot", str(path), "-o", str(out), "--virtual", "--seconds", "2"]
    assert main([*words, "--hand", "4"]) == 0
    said = capsys.readouterr().out
    assert "left_lid, right_lid, eye_yaw: RC servos do not say where they are" in said
    shown = lss.load_sequence(out)
    named = {*itertools.chain.from_iterable(frame.deg for frame in shown.keyframes)}
    assert named == {*load_robot(path).joints}
    assert main(["check", str(out)]) == 0


def test_calibrate_names_what_it_cannot_measure(tmp_path, capsys):
    path = tmp_path / "head.yaml"
    path.write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
    assert main(["calibrate", str(path), "--joints", "eye_yaw"]) == 2
    assert "leave them out with --joints" in capsys.readouterr().err
    assert main(["calibrate", str(path), "--joints", "tilt"]) == 2
    assert "tilt, roll: a ratio, a linkage or a mechanism" in capsys.readouterr().err


def test_identify_measures_the_servo_of_a_linkage_within_the_limits_of_the_joint(
    tmp_path, monkeypatch, capsys
):
    from lss_motion.playing import connection as module

    robot = written(tmp_path)
    opened, real = [], module.Connection.simulate

    def simulate(self, *arguments, **options):
        real(self, *arguments, **options)
        opened.append(self)

    monkeypatch.setattr(module.Connection, "simulate", simulate)
    path = tmp_path / "head.yaml"
    assert main(["identify", "jaw", "--robot", str(path), "--virtual", "--yes"]) == 0, (
        capsys.readouterr().err
    )
    written_text = path.read_text(encoding="utf-8")
    assert "response" in written_text
    assert load_robot(path).servos["jaw"].response.lag_s is not None
    bus = opened[0].simulated["main"]
    horn_deg = bus.horn_deg(np.arange(0, opened[0].clock.now_ns(), 1_000_000))
    jaw = joints_of(horn_deg)["jaw"]
    joint = robot.joints["jaw"]
    assert np.ptp(jaw) > 3.0
    assert jaw.min() > joint.position_min_deg - 0.3
    assert jaw.max() < joint.position_max_deg + 0.3
    assert np.abs(np.gradient(jaw, 0.001)).max() < 1.05 * joint.speed_max_deg_s
    for name in ("tilt", "arm", "turret"):
        assert np.abs(joints_of(horn_deg)[name]).max() < 0.2, name
    assert main(["identify", "tilt", "--robot", str(path), "--virtual", "--yes"]) == 2
    assert "neck.left, neck.right" in capsys.readouterr().err


def test_guided_tasks_refuse_what_has_no_zero_of_its_own(head):
    client, _, _, _ = session(
        head,
        (0.2, m.Maintain(id=1, what="calibrate", joint="jaw")),
        (0.6, m.Maintain(id=2, what="identify", joint="arm")),
        (6.0, m.Stop()),
    )
    assert "stands between joint 'jaw'" in client.of(m.Refused)[0].text
    failed = [one for one in client.of(m.MaintenanceChanged) if one.state == "failed"]
    assert "shoulder.front, shoulder.back" in failed[0].step


def test_a_joint_that_is_its_servo_is_calibrated_beside_mechanisms(tmp_path):
    """The zero and the direction of such a joint are written, and the file stays as it is."""
    text = HEAD.replace("  tilt: {", "  ear: {id: 20, range_deg: [-40, 40]}\n  tilt: {", 1)
    path = written(tmp_path, text).path
    write_frames(path, {"ear": (12.5, -1)}, {})
    servo = load_robot(path).servos["ear"]
    assert (servo.zero_deg, servo.direction) == (12.5, -1)
    assert path.read_text(encoding="utf-8").count("\n") == text.count("\n")
