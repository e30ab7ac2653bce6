"""`lss-motion configure` in virtual time, judged by what the simulated servos store."""

from __future__ import annotations

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import (
    EXIT_FINISHED,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    EXIT_UNREACHABLE,
    BusError,
)
from lss_motion.maintenance import api
from lss_motion.maintenance.api import read_settings, read_whole, targets_at, write_settings
from lss_motion.playing import connection as connections
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.framing import Command
from lss_motion.protocol.io2 import PIN_IDS
from lss_motion.sim.faults import Fault, FaultKind

ROBOT = """
robot: pair
buses: {main: {port: "/dev/ttyX"}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints:
  pan:  {id: 1, stored: {O: 2.5, LED: 3, FD: 10, SD: 120, AS: -2}, settings: {AH: 2}}
  tilt: {id: 2, stored: {G: -1, LED: 3}}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path


@pytest.fixture
def configure(folder, monkeypatch, capsys):
    """Return a function that runs the command on an open connection, in its virtual time."""

    def run(connection, *words):
        monkeypatch.setattr(connections, "connect", lambda *_, **__: connection)
        monkeypatch.setattr(connection, "close", lambda: None)
        capsys.readouterr()
        return main(["configure", *map(str, words)]), *capsys.readouterr()

    return run


def servos(connection):
    return {servo.servo_id: servo.settings for servo in connection.simulated["main"]._servos}


def received(connection):
    return [line for _, line in connection.simulated["main"].lines]


def targets_by(connection, ids):
    return targets_at(connection, "main", {servo_id: f"servo {servo_id}" for servo_id in ids})


def order(connection, servo_id, keyword, value=None):
    command = Command(servo_id, keyword, value)
    connection.ask([Item(bus="main", command=command)])


def test_a_robot_file_is_compared_written_and_kept_over_a_restart(connected, spec, configure):
    connection = connected(spec(1), spec(2))
    code, out, _ = configure(connection, "robot.yaml", "--dry-run")
    assert code == EXIT_FINISHED
    assert "pan: origin offset from the factory zero (O) 0 deg → 2.5 deg" in out
    assert "tilt: gyre, the direction of positive angles (G) 1 → -1" in out
    assert not any(b"#1C" in line or b"#2C" in line for line in received(connection))
    code, out, _ = configure(connection, "robot.yaml", "--yes")
    assert code == EXIT_FINISHED
    assert "written and read back: 7 settings" in out
    eeprom = {servo_id: kept.eeprom for servo_id, kept in servos(connection).items()}
    wanted = {"O": 25, "LED": 3, "FD": 100, "SD": 1200, "AS": -2}
    assert {name: eeprom[1][name] for name in wanted} == wanted
    assert (eeprom[2]["G"], eeprom[2]["LED"]) == (-1, 3)
    assert b"#1RESET\r" in received(connection)
    assert b"#2RESET\r" not in received(connection)
    lines = received(connection)
    assert lines.index(b"#2L\r") < lines.index(b"#2CG-1\r")
    code, out, _ = configure(connection, "robot.yaml", "--yes")
    assert "nothing to write: 2 servos have these settings already" in out


def test_session_settings_leave_the_eeprom_alone(connected, spec, configure):
    connection = connected(spec(1), spec(2))
    assert configure(connection, "robot.yaml", "--session", "--yes")[0] == EXIT_FINISHED
    pan = servos(connection)[1]
    assert (pan.session["O"], pan.session["AH"], pan.session["AS"]) == (25, 2, -2)
    assert (pan.eeprom["O"], pan.eeprom["AH"], pan.eeprom["AS"]) == (0, 4, 0)
    assert pan.eeprom["FD"] is None


def test_one_setting_of_one_servo_needs_no_file(connected, spec, configure):
    connection = connected(spec(1), spec(9, "LSS-P-S1"))
    words = ("--port", "P", "--id", 9, "--set", "O=1.5", "--yes")
    assert configure(connection, *words)[0] == EXIT_FINISHED
    assert {n: kept.eeprom["O"] for n, kept in servos(connection).items()} == {1: 0, 9: 15}
    code, out, _ = configure(connection, "--port", "P", "--id", 9)
    assert code == EXIT_FINISHED
    assert "O          1.5 deg" in out


def test_a_change_that_makes_a_servo_unreachable_needs_force(connected, spec, configure):
    connection = connected(spec(1), spec(2))
    for setting, said in (
        ("CRC=1", "receives nothing from the bus"),
        ("B=9600", "would not receive this line"),
    ):
        words = ("--port", "P", "--id", 1, "--set", setting, "--yes")
        code, _, errors = configure(connection, *words)
        assert code == EXIT_INPUT
        assert said in errors
        assert "--force" in errors
    assert not any(b"#1C" in line for line in received(connection))
    code, _, _ = configure(connection, *words[:-2], "CRC=1", "--yes", "--force")
    assert code == EXIT_FINISHED
    assert servos(connection)[1].eeprom["CRC"] == 1


def test_a_value_that_the_servo_does_not_keep_is_reported(connected, spec, configure):
    connection = connected(spec(1))
    words = ("--port", "P", "--id", 1, "--set", "SD=500", "--yes")
    code, _, errors = configure(connection, *words)
    assert code == EXIT_UNREACHABLE
    assert "servo 1: SD is 360 deg/s, not 500 deg/s" in errors


@pytest.mark.parametrize("at_s", [0.30, 0.36, 0.42, 0.50, 0.70, 1.0])
def test_a_servo_that_restarts_meanwhile_gets_all_of_it(connected, spec, at_s):
    reset = Fault(kind=FaultKind.RESET, servo_id=1, at_s=at_s)
    connection = connected(spec(1), spec(2), faults=[reset])
    targets = targets_by(connection, [1, 2])
    wanted = {"servo 1": {"O": 25, "LED": 3, "AS": -2, "FD": 50}, "servo 2": {"LED": 4}}
    write_settings(connection, targets, wanted)
    eeprom = servos(connection)[1].eeprom
    assert {name: eeprom[name] for name in wanted["servo 1"]} == wanted["servo 1"]
    assert servos(connection)[2].eeprom["LED"] == 4


@pytest.mark.parametrize("seed", range(5))
def test_a_line_that_loses_commands_and_answers_loses_no_setting(connected, spec, seed):
    faults = [
        Fault(kind=FaultKind.LOST_COMMAND, ratio=0.15),
        Fault(kind=FaultKind.LOST_REPLY, ratio=0.15),
    ]
    connection = connected(spec(1), faults=faults, seed=seed)
    (target,) = targets_by(connection, [1])
    wanted = {"O": 25, "LED": 3, "AS": -2, "AH": 1, "AA": 50, "AD": 60, "SD": 900}
    write_settings(connection, [target], {target.name: wanted})
    eeprom = servos(connection)[1].eeprom
    assert {name: eeprom[name] for name in wanted} == wanted


def test_a_servo_that_stops_answering_is_reported(connected, spec):
    gone = Fault(kind=FaultKind.DEAF, servo_id=1, at_s=1.0)
    connection = connected(spec(1), faults=[gone])
    (target,) = targets_by(connection, [1])
    connection.wait(1.0)
    with pytest.raises(BusError, match=r"servo 1 .* no longer replies"):
        write_settings(connection, [target], {target.name: {"LED": 3}})


def test_an_unplugged_port_ends_it_with_its_reason(connected, spec, configure):
    pulled = Fault(kind=FaultKind.UNPLUGGED, at_s=0.5)
    connection = connected(spec(1), spec(2), faults=[pulled])
    code, _, errors = configure(connection, "robot.yaml", "--yes")
    assert (code, "lost port sim://" in errors) == (EXIT_UNREACHABLE, True)


def test_a_servo_forced_to_another_rate_goes_there_with_all_its_settings(
    connected, spec, configure
):
    connection = connected(spec(1), spec(2))
    words = ("--port", "P", "--id", 1, "--set", "B=250000", "--set", "LED=3", "--yes", "--force")
    code, _, errors = configure(connection, *words)
    assert (code, errors) == (EXIT_FINISHED, "")
    (servo, _) = connection.simulated["main"]._servos
    assert (servo.baud_bps, servo.settings.eeprom["LED"]) == (250000, 3)


def test_stored_values_are_read_whatever_the_session_is(connected, spec):
    connection = connected(spec(1, eeprom={"O": 25}))
    order(connection, 1, "O", 99)
    (target,) = targets_by(connection, [1])
    assert read_settings(connection, [target])[target.name]["O"] == 25
    assert read_settings(connection, [target], is_session=True)[target.name]["O"] == 99


def test_the_wanted_first_position_is_written_last(connected, spec):
    """Writing one erases the other, also when it is switched off."""
    connection = connected(spec(1, eeprom={"FD": 50}))
    (target,) = targets_by(connection, [1])
    write_settings(connection, [target], {target.name: {"FP": 1300, "FD": None}})
    assert servos(connection)[1].eeprom["FP"] == 1300
    lines = received(connection)
    assert lines.index(b"#1CFD\r") < lines.index(b"#1CFP1300\r")
    assert lines.count(b"#1CFP1300\r") == 1


def test_every_setting_of_all_three_families_survives_the_factory_values(
    connected, spec, configure, folder
):
    own = {"G": -1, "O": 25, "AR": 1500, "SD": 1200, "LED": 3, "FD": 100, "AS": -2, "AH": 2}
    later = {"AA": 40, "AD": 50, "EM": 0, "LB": 5, "FPC": 3, "HD": 20, "LE": 1, "LP": 900}
    pro = {"G": -1, "O": 15, "SD": 600, "LED": 2, "AA": 20, "SM": 4, "ET": 1, "FD": -300}
    connection = connected(
        spec(5, eeprom={**own, **later}),
        spec(6, eeprom={"FP": 1300}),
        spec(7, "LSS-P-S1", eeprom=pro),
        spec(40, "LSS-2IO"),
    )
    for servo_id, keyword, value in ((40, "CG", -1), (207, "CLED", 5), (203, "CG", -1)):
        order(connection, servo_id, keyword, value)
    ids = [5, 6, 7, 40, 207, 203]
    before = stored_by(connection, ids)
    assert configure(connection, "--port", "P", "--backup", "b.yaml")[0] == EXIT_FINISHED
    order(connection, 5, "DEFAULT")
    order(connection, 5, "CONFIRM")
    for servo_id, keyword, value in ((6, "CFP", None), (7, "CG", 1), (7, "CO", 0), (7, "CSM", 2)):
        order(connection, servo_id, keyword, value)
    order(connection, 207, "DEFAULT")
    connection.wait(1.6)
    changed = stored_by(connection, [0, 6, 7, PIN_IDS["D9"], 207, 203])
    assert changed != before
    assert changed["servo 0"]["O"] == 0
    code, out, errors = configure(connection, "--port", "P", "--restore", "b.yaml", "--yes")
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "LSS-2IO-D9: id 209 → 40" in out
    assert stored_by(connection, ids) == before


def stored_by(connection, ids):
    return read_whole(connection, targets_by(connection, ids))


def test_a_servo_with_its_factory_id_again_gets_its_own_back(connected, spec, configure):
    connection = connected(spec(5, eeprom={"O": 33}), spec(6))
    assert configure(connection, "--port", "P", "--backup", "b.yaml")[0] == EXIT_FINISHED
    for keyword, value in (("CID", 0), ("CO", 0), ("RESET", None)):
        order(connection, 5, keyword, value)
    connection.wait(1.6)
    assert sorted(servos(connection)) == [0, 6]
    code, _, _ = configure(connection, "--port", "P", "--restore", "b.yaml", "--yes")
    assert code == EXIT_FINISHED
    assert sorted(servos(connection)) == [5, 6]
    assert servos(connection)[5].eeprom["O"] == 33


def test_a_backup_is_not_written_into_another_servo_unless_forced(connected, spec, configure):
    first = connected(spec(5, eeprom={"O": 33}), seed=1)
    assert configure(first, "--port", "P", "--backup", "b.yaml")[0] == EXIT_FINISHED
    other = connected(spec(5), seed=2)
    words = ("--port", "P", "--restore", "b.yaml", "--yes")
    code, _, errors = configure(other, *words)
    assert code == EXIT_INPUT
    assert "the backup is of" in errors
    assert servos(other)[5].eeprom["O"] == 0
    assert configure(other, *words, "--force")[0] == EXIT_FINISHED
    assert servos(other)[5].eeprom["O"] == 33
    pro = connected(spec(5, "LSS-P-S1"))
    code, _, errors = configure(pro, *words, "--force")
    assert (code, "the backup is of an LSS-ST1" in errors) == (EXIT_INPUT, True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("backup: 2\nservos: []\n", "backup"),
        ("backup: 1\nservos: 3\n", "servos"),
        ("servos: []\n", "backup"),
        (
            "backup: 1\nservos:\n  - {bus: main, id: 5, model: LSS-ST1, settings: {OO: 3}}\n",
            "b.yaml:3: unknown setting 'OO'",
        ),
        (
            "backup: 1\nservos:\n  - {bus: main, id: 500, model: LSS-ST1, settings: {O: 3}}\n",
            "b.yaml:3: ",
        ),
        (
            "backup: 1\nservos:\n  - {bus: left, id: 5, model: LSS-ST1, settings: {O: 3}}\n",
            "unknown bus 'left'",
        ),
    ],
)
def test_a_spoilt_backup_writes_nothing(connected, spec, configure, folder, text, said):
    (folder / "b.yaml").write_text(text)
    connection = connected(spec(5))
    code, _, errors = configure(connection, "--port", "P", "--restore", "b.yaml", "--yes")
    assert code == EXIT_INPUT
    assert said in errors
    assert not any(b"#5C" in line for line in received(connection))


@pytest.mark.parametrize("model", ["LSS-ST1", "LSS-P-S1"])
def test_new_servos_with_id_0_are_numbered_one_by_one(connected, spec, configure, model):
    connection = connected(spec(0, model), spec(3))
    words = ("--port", "P", "--id", 0, "--new-id")
    code, _, errors = configure(connection, *words, 3, "--yes")
    assert (code, "id 3 is used" in errors) == (EXIT_INPUT, True)
    code, out, _ = configure(connection, *words, 7, "--dry-run")
    assert (code, "id 0 → 7" in out) == (EXIT_FINISHED, True)
    assert sorted(servos(connection)) == [0, 3]
    code, out, _ = configure(connection, *words, 7, "--yes")
    assert code == EXIT_FINISHED
    assert f"the {model}, serial number" in out
    assert "now has id 7" in out
    assert sorted(servos(connection)) == [3, 7]
    code, _, errors = configure(connection, *words, 8, "--yes")
    assert (code, "no servo replies at id 0" in errors) == (EXIT_UNREACHABLE, True)


def test_two_servos_with_one_id_are_not_renumbered_together(connected, spec, configure):
    connection = connected(spec(0), spec(0))
    code, _, errors = configure(connection, "--port", "P", "--id", 0, "--new-id", 7, "--yes")
    assert code == EXIT_UNREACHABLE
    assert "connect one of them alone" in errors
    assert not any(b"CID" in line for line in received(connection))


def test_a_pin_of_a_board_gets_another_id(connected, spec, configure):
    connection = connected(spec(209, "LSS-2IO"))
    code, _, _ = configure(connection, "--port", "P", "--id", 209, "--new-id", 30, "--yes")
    assert code == EXIT_FINISHED
    assert connection.simulated["main"]._boards[0].pin(30).name == "D9"


def test_all_servos_of_a_line_change_their_rate_together(connected, spec, configure):
    connection = connected(spec(1), spec(2), spec(209, "LSS-2IO"))
    code, out, errors = configure(connection, "--port", "P", "--new-baud", 500000, "--yes")
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "all servos reply at 500000 bps" in out
    bus = connection.simulated["main"]
    assert {servo.baud_bps for servo in bus._servos} == {500000}
    assert bus._boards[0].baud_bps == 500000
    code, _, errors = configure(connection, "--port", "P", "--new-baud", 921600, "--yes")
    assert code == EXIT_INPUT
    assert "CB 921600: allowed are" in errors
    assert {servo.baud_bps for servo in bus._servos} == {500000}


def test_a_rate_that_some_servo_does_not_support_changes_nothing(connected, spec, configure):
    connection = connected(spec(1), spec(2, "LSS-P-S1"))
    code, _, errors = configure(connection, "--port", "P", "--new-baud", 500000, "--yes")
    assert (code, "LSS-PRO servos have no baud rate" in errors) == (EXIT_INPUT, True)
    old = connected(spec(1), firmware=368)
    code, _, errors = configure(old, "--port", "P", "--new-baud", 921600, "--yes")
    assert (code, "needs firmware 369" in errors) == (EXIT_INPUT, True)
    assert not any(b"CB" in line for line in received(connection) + received(old))


def test_a_part_of_a_line_changes_its_rate_only_when_forced(connected, spec, configure):
    connection = connected(spec(1), spec(2))
    words = ("--port", "P", "--id", 1, "--new-baud", 9600, "--yes")
    code, _, errors = configure(connection, *words)
    assert (code, "servo 2 would stay at 115200 bps" in errors) == (EXIT_INPUT, True)
    code, _, errors = configure(connected(spec(1)), "robot.yaml", *words[-3:])
    assert (code, "servo 2 does not reply and would stay" in errors) == (EXIT_INPUT, True)
    assert configure(connection, *words, "--force")[0] == EXIT_FINISHED
    rates = {servo.servo_id: servo.baud_bps for servo in connection.simulated["main"]._servos}
    assert rates == {1: 9600, 2: 115200}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give a ROBOT file, or --port"),
        (("--port", "P", "--joint", "pan"), "--joint needs a ROBOT file"),
        (("robot.yaml", "--joint", "pam"), "unknown joint 'pam'; did you mean 'pan'"),
        (("robot.yaml", "--set", "O:3"), "there is no ="),
        (("robot.yaml", "--set", "O=x"), "'x' is not a number"),
        (("robot.yaml", "--set", "OX=3"), "'OX' is no setting that LSS stores"),
        (("robot.yaml", "--set", "AS=11"), "allowed are -10 to 10"),
        (("robot.yaml", "--set", "AS=DIS"), "AS has no DIS"),
        (("robot.yaml", "--new-id", "7"), "give its present id with --id"),
        (("--port", "P", "--id", "1", "--new-id", "251"), "an id is from 0 to 250"),
        (("--port", "P", "--new-baud", "1000"), "servos support 9600"),
        (("robot.yaml", "--backup", "b.yaml", "--set", "O=1"), "cannot be used with"),
        (("robot.yaml", "--restore", "b.yaml", "--session"), "cannot be used with"),
        (("robot.yaml", "--set", "LED=1"), "there is no terminal to agree on; add --yes"),
    ],
)
def test_invalid_words_are_refused_with_the_valid_ones(connected, spec, configure, words, said):
    connection = connected(spec(1), spec(2))
    code, _, errors = configure(connection, *words)
    assert code == EXIT_INPUT
    assert said in errors
    assert not any(b"#1C" in line for line in received(connection))


def test_a_model_that_is_not_the_joints_is_not_written_to(connected, spec, configure):
    connection = connected(spec(1), spec(2, "LSS-P-S1"))
    code, _, errors = configure(connection, "robot.yaml", "--yes")
    assert code == EXIT_INPUT
    assert "joint 'tilt': servo 2 is an LSS-P-S1" in errors


def test_the_answer_no_writes_nothing(connected, spec, configure, monkeypatch):
    import io

    class TypedAnswers(io.StringIO):
        def isatty(self):
            return True

    connection = connected(spec(1), spec(2))
    monkeypatch.setattr("sys.stdin", TypedAnswers("n\n"))
    code, out, _ = configure(connection, "robot.yaml")
    assert (code, out.endswith("nothing was written\n")) == (EXIT_FINISHED, True)
    assert servos(connection)[1].eeprom["O"] == 0
    monkeypatch.setattr("sys.stdin", TypedAnswers("y\n"))
    assert configure(connection, "robot.yaml")[0] == EXIT_FINISHED
    assert servos(connection)[1].eeprom["O"] == 25


def test_reading_reports_missing_answers(connected, spec):
    connection = connected(spec(1), firmware=367)
    (target,) = targets_by(connection, [1])
    assert "FPC" not in target.rows(is_session=False)  # Firmware 367 does not know it.
    found = read_settings(connection, [target])[target.name]
    assert found["AS"] == 0
    assert set(found) == set(target.rows(is_session=False))


@pytest.mark.parametrize(
    ("words", "writer", "said"),
    [
        (("--set", "LED=3"), "write_settings", "some may have their new settings, others not"),
        (("--new-id", 9), "change_id", "may have id 5 or 9"),
        (("--new-baud", 500000), "change_baud", "some servos may be at 115200 bps, others at"),
    ],
)
def test_an_interrupt_while_servos_are_written_says_what_may_be(
    command, spec, monkeypatch, words, writer, said
):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(api, writer, interrupt)
    asked = ("configure", "--port", "P", "--id", 5, "--yes", *words)
    code, _, errors, _ = command(*asked, servos=[spec(5)])
    assert (code, "interrupted while servos were written" in errors) == (EXIT_INTERRUPTED, True)
    assert said in errors
