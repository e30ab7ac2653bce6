"""`calibrate --linkage`: a person steps a servo and types the angle of the joint; judged by horns.

The joint of the simulated robot hangs on a push rod that the file does not know: the test reads
the horn, and types what a protractor would show.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from lss_motion.cli.linkage import LinkageControls
from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.playing.connection import connect
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.runner import run
from lss_motion.robot.load import load_robot
from lss_motion.robot.mechanisms import require_measurable, table_report
from lss_motion.system.clock import VirtualClock

S = 1_000_000_000
ROBOT = """\
robot: skull
joints:
  # the push rod
  jaw: {id: 4, model: LSS-HS1, range_deg: [-10, 60], speed_max_deg_s: 200, accel_max_deg_s2: 1000}
  pan: {id: 1, model: LSS-HS1, range_deg: [-60, 60], speed_max_deg_s: 100, accel_max_deg_s2: 400}
"""
TRUE_JOINT = np.array([-4.0, 0.0, 4.0, 8.0, 12.0, 17.0, 22.0, 24.0])
TRUE_SERVO = np.array([-20.0, -8.0, 4.2, 16.6, 29.4, 46.0, 63.6, 71.0])
RIGHT, LEFT = "\x1b[C", "\x1b[D"


def opening_deg(servo_deg):
    fine = np.linspace(-4, 24, 28001)
    return float(np.interp(servo_deg, CubicSpline(TRUE_JOINT, TRUE_SERVO)(fine), fine))


class ScriptedPerson(LinkageControls):
    """Presses keys, a second apart; `?` stands for the angle that a protractor shows."""

    def __init__(self, robot, keys, horn_deg, error_deg=()):
        super().__init__(robot, "jaw")
        self.script, self.horn_deg, self.said = list(keys), horn_deg, []
        self.errors_deg, self.next_ns = list(error_deg), 0

    def take(self):
        return 0, ""

    def print(self, text, *, beeps=False):
        self.said.append(text)

    def act(self, driven, now_ns):
        super().act(driven, now_ns)
        if driven.phase == "playing" and now_ns >= self.next_ns and self.script:
            self.next_ns = now_ns + S
            key = self.script.pop(0)
            if key == "?":
                deg = opening_deg(self.horn_deg(now_ns))
                deg += self.errors_deg.pop(0) if self.errors_deg else 0.0
                for one in f"{deg:.1f}\r":
                    self.press(one, driven)
            elif key == "stop":
                driven.stop()
            else:
                self.press(key, driven)


def measured(path, keys, error_deg=()):
    robot = load_robot(path)
    clock = VirtualClock()
    hands_on = HandsOn(robot.servo_robot, ["jaw"], needs_frame=False)
    with connect(robot.buses, robot=robot, clock=clock) as connection:
        bus = connection.simulated["main"]
        column = list(robot.servo_robot.joints).index("jaw")
        person = ScriptedPerson(
            robot, keys, lambda now_ns: bus.horn_deg([now_ns])[0, column], error_deg
        )
        with person:
            run(hands_on, connection.ports, clock, controls=person)
    assert hands_on.error is None
    if person.error is not None:
        raise person.error
    return person.said, bus


POINT = ["\r", "?"]
WALK = [LEFT, LEFT, *POINT, *[key for _ in range(6) for key in (*[RIGHT] * 2, *POINT)]]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT, encoding="utf-8")
    return path


def test_a_push_rod_is_measured_and_then_the_joint_goes_where_it_is_sent(path):
    said, _ = measured(path, [*WALK, "w", "y"])
    text = path.read_text(encoding="utf-8")
    assert "# the push rod" in text
    robot = load_robot(path)
    assert robot.mechanisms["jaw"].kind == "linkage"
    assert any("range_deg of jaw is now" in line for line in said)
    assert any("deg for 1 deg" in line for line in said)
    assert main(["check", str(path)]) == 0
    # A servo angle that the table gives opens the jaw as far as it says.
    joint = robot.joints["jaw"]
    places = np.linspace(joint.position_min_deg, joint.position_max_deg, 30)
    for place in places:
        (servo_deg,) = robot.mechanisms["jaw"].transmission.servo_deg(np.array([[place]]))[0]
        assert opening_deg(servo_deg) == pytest.approx(place, abs=0.25)


def test_a_bad_reading_shows_and_can_be_measured_again(path):
    errors = [0.0, 0.0, 6.0, 0.0, 0.0, 0.0, 0.0]
    before = path.read_text(encoding="utf-8")
    said, bus = measured(path, [*WALK, "w", "n", "u", "stop"], errors)
    told = [line for line in said if line.startswith(("not yet:", "warning:"))]
    assert told, said
    assert path.read_text(encoding="utf-8") == before
    assert bus.lines[-1][1] == b"#254H\r"


def test_a_measured_table_is_measured_anew(path):
    measured(path, [*WALK, "w", "y"])
    first = load_robot(path)
    again = [LEFT, *POINT, *[key for _ in range(5) for key in (*[RIGHT] * 2, *POINT)], "w", "y"]
    said, bus = measured(path, again)
    second = load_robot(path)
    assert first.mechanisms["jaw"].transmission != second.mechanisms["jaw"].transmission
    assert second.joints["jaw"].position_max_deg <= first.joints["jaw"].position_max_deg
    assert any("linkage of jaw written" in line for line in said)
    column = list(first.servos).index("jaw")
    horns = bus.horn_deg(np.arange(0, 40 * S, S // 20).tolist())[:, column]
    servo = first.servos["jaw"]
    assert horns.max() < servo.position_max_deg + 0.3
    assert horns.min() > servo.position_min_deg - 0.3


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([], "nothing was measured"),
        ([(0, 0), (5, 10)], "3 points"),
        ([(0, 0), (5, 10), (10, 8)], "turns at joint angle 5"),
        ([(0, 0), (1, 0.2), (2, 40), (3, 40.2)], "turns or is flat"),
    ],
)
def test_what_is_no_table_is_said(path, points, said):
    report = table_report("jaw", points, load_robot(path))
    assert said in report.problems[0]


def test_what_cannot_be_measured_so_is_refused(path, capsys):
    assert main(["calibrate", str(path), "--linkage", "jow"]) == 2
    assert "jaw" in capsys.readouterr().err
    assert main(["calibrate", str(path), "--linkage", "jaw", "--to-servos"]) == 2
    assert "without the other options" in capsys.readouterr().err
    path.write_text(ROBOT.replace("jaw: {", "jaw: {ratio: 2, "), encoding="utf-8")
    with pytest.raises(InputError, match="has a ratio; remove it"):
        require_measurable(load_robot(path), "jaw")
