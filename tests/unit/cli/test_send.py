"""`lss-motion send` in all its forms, on simulated servos."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from msgspec.structs import replace
from served_bus import recording_bus, served_bus

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_UNREACHABLE
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import ServoSpec

pytestmark = pytest.mark.realtime

ROBOT = """
robot: two
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
joints:
  arm:  {id: 5, range_deg: [-90, 90], model: LSS-ST1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
  hand: {id: 6, range_deg: [-90, 90], model: LSS-P-S1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
"""


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return path


@pytest.fixture
def send(capsys):
    def run(*words):
        code = main(["send", *map(str, words)])
        out, errors = capsys.readouterr()
        return code, out.rstrip("\n"), errors

    return run


LSS = SERVO_MODELS["LSS-ST1"]
FIRST_ASKED = (b"QMS\r", b"QF\r")
"""What a servo is asked before anything else, if no robot file states it."""


@contextmanager
def served(link, *specs, faults=()):
    bus = recording_bus(*specs, faults=faults)
    with served_bus(bus, link):
        yield bus


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (["QMS"], "*5QMSLSS-ST1   LSS-ST1"),
        (["qg"], "*5QG1   1"),
        (["QAA"], "*5QAA100   1000 deg/s²"),
        (["QSD"], "*5QSD3600   360 deg/s"),
        (["QSD", "1"], "*5QSD3600   360 deg/s"),
        (["QSR1"], "*5QSR60   60 rpm"),
        (["qf3"], "*5QF370.0.0   370.0.0"),
        (["QB"], "*5QB115200   115200 bps"),
        (["Q"], "*5Q1   limp"),
        (["Q", "1"], "*5Q0   none"),
        (["QLED"], "*5QLED7   white"),
        (["QFD"], "*5QFDDIS   no value"),
        (["QDT"], "*5QDT   no value"),
        (["QF", "3"], "*5QF370.0.0   370.0.0"),
        (["QID"], "*5QID5   5"),
    ],
)
def test_a_question_is_answered_with_its_unit(send, robot, words, shown):
    assert send("--robot", robot, "--id", 5, *words) == (EXIT_FINISHED, shown, "")


def test_the_family_comes_from_the_joint(send, robot):
    code, out, _ = send("--robot", robot, "--id", 6, "QAR")
    assert (code, out) == (EXIT_FINISHED, "*6QAR1800   180 deg")
    code, _, errors = send("--robot", robot, "--id", 6, "QFPC")
    assert code == EXIT_INPUT
    assert "'QFPC' is no LSS-PRO keyword" in errors


def test_without_a_robot_file_the_servo_states_its_family_and_firmware(send, tmp_path):
    """5 is holding for an LSS-PRO of firmware 780, 6 for an older one."""
    pro = ServoSpec(servo_id=6, model=SERVO_MODELS["LSS-P-S1"], start_deg=12.34, firmware=780)
    old = replace(pro, servo_id=7, firmware=700)
    lss = ServoSpec(servo_id=5, model=LSS, firmware=367)
    with served(tmp_path / "port", pro, old, lss):
        to = ("--port", tmp_path / "port", "--id")
        assert send(*to, 6, "QD")[1] == "*6QD1234   12.34 deg"
        for servo_id, code in ((6, 5), (7, 6)):
            send(*to, servo_id, "H")
            assert send(*to, servo_id, "Q")[1] == f"*{servo_id}Q{code}   holding"
        assert "QFPC needs firmware 368 or newer, not 367" in send(*to, 5, "QFPC")[2]


def test_values_are_in_units_and_reach_the_servo_in_its_own(send, tmp_path):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        assert send("--port", link, "--id", 5, "--yes", "D", 45, "T", 300)[:2] == (0, "")
        assert send("--port", link, "--id", 5, "--yes", "sd", 90)[:2] == (0, "")
        assert send("--port", link, "--id", 5, "--raw", "LED3") == (
            EXIT_FINISHED,
            "",
            "#5LED3: servo 5, LED colour 3\n",
        )
        code, out, _ = send("--port", link, "--id", 5, "QLED")
        received = [line for _, line in bus.lines if line[2:] not in FIRST_ASKED]
    assert received == [b"#5D450T300\r", b"#5SD900\r", b"#5LED3\r", b"#5QLED\r"]
    assert (code, out) == (EXIT_FINISHED, "*5QLED3   blue")


def test_a_restart_that_takes_the_port_away_is_announced(send, tmp_path):
    link = tmp_path / "port"
    to = ("--port", link, "--id", 5, "RESET", "--yes")
    with served(link, ServoSpec(servo_id=5, model=SERVO_MODELS["LSS-P-S1"])):
        code, _, errors = send(*to)
        assert code == EXIT_FINISHED
        assert "its port is gone for up to 10 s if the USB cable is at this servo" in errors
    with served(link, ServoSpec(servo_id=5, model=LSS)):
        assert "port" not in send(*to)[2]


def test_a_board_obeys_and_answers(send, tmp_path):
    link = tmp_path / "port"
    asked = ("--port", link, "--family", "LSS-2IO")
    seen = Fault(kind=FaultKind.INPUT, servo_id=203, raw=426)
    with served(link, ServoSpec(servo_id=209, model=SERVO_MODELS["LSS-2IO"]), faults=[seen]):
        assert send(*asked, "--id", 209, "--yes", "D", 45)[:2] == (EXIT_FINISHED, "")
        assert send(*asked, "--id", 209, "QD")[:2] == (EXIT_FINISHED, "*209QD450   45 deg")
        assert send(*asked, "--id", 203, "QA")[:2] == (EXIT_FINISHED, "*203QA426   426")
        assert send(*asked, "--id", 203, "QA", 1)[:2] == (EXIT_FINISHED, "*203QA50   50 mm")
        code, out, errors = send(*asked, "--id", 254, "QMS")
    assert (code, out) == (EXIT_UNREACHABLE, "")
    assert "no reply to QMS from servo 254" in errors


def test_a_servo_that_is_not_there_ends_with_its_exit_code(send, robot):
    code, out, errors = send("--robot", robot, "--id", 77, "QD")
    assert (code, out) == (EXIT_UNREACHABLE, "")
    assert "no reply to QD from servo 77 on sim:// at 115200 bps" in errors


def test_a_port_that_does_not_exist_is_named(send):
    code, _, errors = send("--port", "/dev/no-such-port", "--id", 5, "QD")
    assert code == EXIT_UNREACHABLE
    assert "cannot open port /dev/no-such-port: there is no such device" in errors


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["QDD"], "'QDD' is no LSS keyword; did you mean QD"),
        (["QSR9"], "QSR with suffix 9: allowed are 0 (session value), 1"),
        (["D450"], "'D450' is a keyword with a value: give D and the value as two words"),
        (["D", "fast"], "'fast' is not a number"),
        (["D", "90", "T"], "then by pairs of modifier and value"),
        (["LED", "9"], "LED 9: allowed are 0 to 7"),
        (["D", "90", "X", "1"], "allowed modifiers are T, SD, CH, CL"),
        (["D"], "D needs a value"),
        (["--raw", "D9#6L"], "is not one command"),
        (["--raw", "D9;"], "is not one command"),
    ],
)
def test_what_no_servo_would_understand_is_refused_with_what_is_allowed(send, robot, words, said):
    code, out, errors = send("--robot", robot, "--id", 5, *words)
    assert (code, out) == (EXIT_INPUT, "")
    assert said in errors


def test_newer_commands_are_refused_for_older_firmware(send, robot):
    code, _, errors = send("--robot", robot, "--id", 5, "--firmware", 367, "QFPC")
    assert code == EXIT_INPUT
    assert "QFPC needs firmware 368 or newer, not 367" in errors


@pytest.mark.parametrize("port", [[], ["--port", "sim://"]])
def test_without_a_port_or_a_robot_nothing_is_sent(send, port):
    code, _, errors = send(*port, "--id", 5, "QD")
    assert code == EXIT_INPUT
    assert "give --port, or --robot with the servos that are simulated" in errors


def test_negative_values_are_values(send, tmp_path):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        assert send("--port", link, "--id", 5, "--yes", "D", "-12.3")[0] == EXIT_FINISHED
        send("--port", link, "--id", 5, "QG")
        assert moves(bus) == [b"#5D-123\r"]


ASKED = [
    (["D", 45, "T", 2000], "#5D450T2000: servo 5, position 45 deg, T 2000 ms"),
    (["MD", 5], "move relative to the present position 5 deg"),
    (["P", 1500], "position in pulse width, within the angular range 1500 us"),
    (["M", 10], "#5M10: servo 5, move relative to the present position, in pulse width 10 us"),
    (["WD", 90], "speed in wheel mode 90 deg/s"),
    (["WR", 10], "speed in wheel mode 10 rpm"),
    (["RDM", 200], "raw motor duty"),
    (["--raw", "D450T10"], "position 45 deg, T 10 ms"),
    (["--raw", "d450t10t9000"], "no document of LSS describes this command"),
    (["--raw", "ZAP7"], "no document of LSS describes this command"),
    (["SD", 360], "maximum speed 360 deg/s"),
    (["EM", 0], "motion profile on (1) or off (0) 0"),
    (["G", -1], "the servo keeps it until its power is off"),
    (["CSD", 360], "maximum speed 360 deg/s (stored)"),
    (["CID", 9], "identification number 9 (stored)"),
    (["CRC", 1], "the servo stores it"),
    (["RESET"], "the servo restarts with its stored settings"),
    (["DEFAULT"], "#5DEFAULT: servo 5, restore the factory values, after CONFIRM"),
    (["UPDATE"], "enter the firmware update mode"),
    (["CONFIRM"], "carry out the DEFAULT or UPDATE"),
]


def moves(bus):
    """Return the lines to servo 5, or to all, that are no query."""
    return [line for _, line in bus.lines if not line.startswith(b"#5Q")]


@pytest.mark.parametrize(("words", "shown"), ASKED)
def test_what_moves_or_changes_a_real_servo_is_shown_and_asked(
    send, tmp_path, at_keyboard, words, shown
):
    link = tmp_path / "port"
    to = ("--port", link, "--id", 5)
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        code, out, errors = send(*to, *words)
        assert (code, out) == (EXIT_INPUT, "")
        assert shown in errors
        assert "no terminal to agree on: nothing was sent" in errors
        at_keyboard("n\n")
        code, out, errors = send(*to, *words)
        assert (code, out) == (EXIT_INTERRUPTED, "")
        assert "send it? [y/N] no: nothing was sent" in errors
        assert moves(bus) == []
        at_keyboard("y\n")
        assert send(*to, *words)[0] == EXIT_FINISHED
        send(*to, "QID")
        assert len(moves(bus)) == 1


@pytest.mark.parametrize("words", [["H"], ["L"], ["LED", 3], ["QD"], ["--raw", "h"]])
@pytest.mark.parametrize("servo_id", [5, 254])
def test_what_stops_or_asks_a_servo_is_sent_at_once(send, tmp_path, words, servo_id):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        send("--port", link, "--id", servo_id, *words)
        send("--port", link, "--id", 5, "QID")
        assert bus.lines[0][1].startswith(b"#%d" % servo_id)


@pytest.mark.parametrize(
    "words",
    [
        *(["CID", 9], ["DEFAULT"], ["UPDATE"], ["CRC", 1], ["CB", 9600], ["RESET"], ["CONFIRM"]),
        *(["CSD", 90], ["SD", 90], ["D", 0, "T", 5000], ["MD", 1], ["WD", 1], ["--raw", "ZAP"]),
    ],
)
def test_a_command_to_every_servo_needs_force_and_is_asked_all_the_same(
    send, tmp_path, at_keyboard, robot, words
):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        for to in (("--port", link), ("--port", link, "--robot", robot)):
            at_keyboard("y\n")
            code, _, errors = send(*to, "--id", 254, "--yes", *words)
            assert code == EXIT_INPUT
            assert "every servo on the bus would obey at once. Nothing was sent; --force" in errors
            at_keyboard("n\n")
            assert send(*to, "--id", 254, "--force", *words)[0] == EXIT_INTERRUPTED
        assert bus.lines == []
        assert send(*to, "--id", 254, "--force", "--yes", *words)[0] == EXIT_FINISHED
        send("--port", link, "--id", 5, "QID")
        assert len(moves(bus)) == 1


@pytest.mark.parametrize(
    ("words", "sent", "said"),
    [
        (["D", 45], b"#5D450T500\r", "the command had no T and no SD"),
        (["D", 45, "T", 100], b"#5D450T500\r", "keeps 90 deg/s: the command had more speed"),
        (["D", 45, "T", 800], b"#5D450T800\r", "position 45 deg, T 800 ms"),
        (["D", -45, "SD", 300], b"#5D-450SD900\r", "the command had more speed"),
        (["D", 45, "SD", 30], b"#5D450SD300\r", "SD 30 deg/s"),
        (["D", 45, "T", 1, "SD", 999], b"#5D450T500SD900\r", "the command had more speed"),
        (["MD", -90, "T", 1], b"#5MD-900T1000\r", "it is sent as #5MD-900T1000"),
        (["--raw", "d450t1"], b"#5D450T500\r", "the command had more speed"),
        (["D", 90, "CH", 0.4], b"#5D900CH400T1000\r", "CH 0.4 A"),
    ],
)
def test_a_move_keeps_the_speed_of_its_joint_and_needs_no_question(
    send, tmp_path, robot, words, sent, said
):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        code, out, errors = send("--robot", robot, "--port", link, "--id", 5, *words)
        assert (code, out) == (EXIT_FINISHED, "")
        assert said in errors
        send("--port", link, "--id", 5, "QID")
        assert moves(bus) == [sent]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["D", 90.2, "T", 9000], "would go to 90.2 deg, its range is -90 to 90 deg"),
        (["D", -170], "would go to -170 deg"),
        (["MD", 91], "would go to 91 deg"),
        (["--raw", "D901"], "would go to 90.1 deg"),
        (["P", 1500], "cannot be compared with the range of joint 'arm'; use D"),
        (["M", 5], "cannot be compared with the range of joint 'arm'; use D"),
        (["WD", 1], "WD turns joint 'arm' without an end"),
        (["WR", 1], "WR turns joint 'arm' without an end"),
        (["RDM", 1], "RDM turns joint 'arm' without an end"),
        (["--raw", "D10X5"], "its effect is not known"),
    ],
)
@pytest.mark.parametrize("is_simulated", [True, False])
def test_what_leaves_the_limits_of_a_joint_needs_force(
    send, tmp_path, robot, words, why, is_simulated
):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        port = () if is_simulated else ("--port", link)
        code, out, errors = send("--robot", robot, *port, "--id", 5, "--yes", *words)
        assert (code, out) == (EXIT_INPUT, "")
        assert why in errors
        assert "Nothing was sent; --force sends it" in errors
        assert moves(bus) == []
        words = ["--force", "--yes", *words]
        assert send("--robot", robot, *port, "--id", 5, *words)[0] == EXIT_FINISHED
        send("--port", link, "--id", 5, "QID")
        assert len(moves(bus)) == (0 if is_simulated else 1)


def test_a_move_whose_speed_nothing_limits_is_asked_about(send, tmp_path, robot):
    """Without its motion profile a servo ignores T and SD (EM0); it may also not reply."""
    link = tmp_path / "port"
    to = ("--robot", robot, "--port", link, "--id", 5)
    with served(link, ServoSpec(servo_id=5, model=LSS)) as bus:
        assert send(*to, "--yes", "EM", 0)[0] == EXIT_FINISHED
        code, _, errors = send(*to, "D", 45, "T", 9000)
        assert code == EXIT_INPUT
        assert "the speed of joint 'arm' cannot be limited" in errors
        assert moves(bus) == [b"#5EM0\r"]
    with served(link, ServoSpec(servo_id=7, model=LSS)) as bus:
        code, _, errors = send(*to, "MD", 5)
        assert code == EXIT_INPUT
        assert "joint 'arm' does not report where it stands" in errors
        assert send(*to, "D", 45)[0] == EXIT_INPUT
        assert moves(bus) == []


def test_on_simulated_servos_nothing_is_asked(send, robot):
    for words in (["D", 45], ["SD", 300], ["CID", 9], ["RESET"]):
        code, out, errors = send("--robot", robot, "--id", 5, *words)
        assert (code, out) == (EXIT_FINISHED, "")
        assert errors.startswith(f"#5{words[0]}")
