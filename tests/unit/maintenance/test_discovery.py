"""Servos on a bus: every id, every rate, shared ids; the report to a person."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE
from lss_motion.maintenance import survey as report
from lss_motion.maintenance.survey import observed, roll_call, starter_file, survey
from lss_motion.playing.discovery import (
    is_doubtful,
    judge_answers,
    own_answers,
    read_roll_call,
)
from lss_motion.protocol.constants import SafeModeCause, Status
from lss_motion.robot.load import load_robot
from lss_motion.sim.faults import Fault, FaultKind


def ids(found):
    return [present.servo_id for present in found]


@pytest.mark.parametrize("baud_bps", [9600, 115200, 921600])
@pytest.mark.parametrize("usb_latency_ms", [0, 16])
def test_a_roll_call_finds_every_servo_whatever_the_rate_and_the_adapter(
    connected, spec, baud_bps, usb_latency_ms
):
    there = [0, 1, 2, 77, 250]
    connection = connected(
        *map(spec, there), baud_bps=baud_bps, usb_latency_ns=usb_latency_ms * 1_000_000
    )
    found = roll_call(connection, "main")
    assert ids(found) == there
    assert [present.model for present in found] == ["LSS-ST1"] * 5
    assert len({present.serial_number for present in found}) == 5
    assert not any(present.is_shared for present in found)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [2, 3])
def test_a_shared_id_is_found(connected, spec, seed, count):
    connection = connected(*[spec(0)] * count, spec(3), seed=seed)
    found = roll_call(connection, "main")
    assert [(p.servo_id, p.is_shared) for p in found] == [(0, True), (3, False)]


@pytest.mark.parametrize("seed", range(5))
def test_a_shared_id_is_found_behind_an_adapter_that_holds_answers_back(connected, spec, seed):
    bag = [spec(3), *[spec(20)] * 6]
    connection = connected(*bag, seed=seed, usb_latency_ns=16_000_000)
    found = roll_call(connection, "main")
    assert [(p.servo_id, p.is_shared) for p in found] == [(3, False), (20, True)]


def test_damage_held_back_for_16_ms_makes_every_id_queried_meanwhile_doubtful():
    received = [b""] * 251
    received[24] = b"*2\x80QM"
    received[30] = b"*30QMSLSS-ST1\r"
    models, doubtful = read_roll_call(115200, range(251), received)
    assert models == {30: "LSS-ST1"}
    gap_s = 2e-3 + 24 * 10 / 115200 + 6 * 10 / 115200
    assert set(range(24 - int(16e-3 / gap_s), 25)) <= doubtful
    assert max(doubtful) == 24


@pytest.mark.parametrize("seed", range(3))
def test_noise_on_a_line_is_not_taken_for_a_shared_id(connected, spec, seed):
    noise = Fault(kind=FaultKind.CORRUPT_REPLY, ratio=0.1)
    connection = connected(*map(spec, range(1, 13)), seed=seed, faults=[noise])
    found = roll_call(connection, "main")
    assert ids(found) == list(range(1, 13))
    assert not any(present.is_shared for present in found)


def test_servos_are_found_at_their_own_rates(connected, spec):
    connection = connected(spec(1), spec(2), spec(7, baud_bps=57600))
    looks = survey(connection, connection.buses["main"], None)
    assert [(look.servo_id, look.baud_bps) for look in looks] == [
        (1, 115200),
        (2, 115200),
        (7, 57600),
    ]
    assert connection.buses["main"].baud_bps == 115200
    (said,) = report.unreachable(connection.buses["main"], looks)
    assert "servo 7 listens at 57600 bps, the others at 115200" in said
    assert "--baud 57600 --id 7 --new-baud 115200 --force" in said


@pytest.mark.parametrize("servo_id", [209, 40])
def test_a_board_is_found_with_all_its_pins(connected, spec, servo_id):
    connection = connected(spec(servo_id, "LSS-2IO"))
    looks = survey(connection, connection.buses["main"], None)
    assert len(looks) == 7
    assert {"LSS-2IO-LED", "LSS-2IO-A3", "LSS-2IO-D9"} <= {look.identity.model for look in looks}
    servo = next(look for look in looks if look.servo_id == servo_id)
    assert (servo.identity.model, servo.position_deg) == ("LSS-2IO-D9", 2.0)


def test_the_condition_of_all_three_families_is_read(connected, spec):
    connection = connected(
        spec(1, start_deg=12.0), spec(2, "LSS-P-S1", start_deg=-3.25), spec(209, "LSS-2IO")
    )
    looks = {look.servo_id: look for look in survey(connection, connection.buses["main"], 115200)}
    assert (looks[1].position_deg, looks[2].position_deg) == (12.0, -3.25)
    assert looks[1].firmware == 370
    assert looks[1].voltage_v == pytest.approx(12.0, abs=0.1)
    assert looks[1].status is Status.LIMP
    assert looks[209].status is None


def test_the_status_of_a_pro_is_read_by_its_own_firmware(connected, spec):
    """Holding is code 6 up to firmware 779, and 5 from 780 on."""
    connection = connected(
        spec(1, "LSS-P-S1", firmware=779, eeprom={"FD": 0}),
        spec(2, "LSS-P-S1", firmware=780, eeprom={"FD": 0}),
    )
    looks = survey(connection, connection.buses["main"], 115200)
    assert {look.firmware: look.status for look in looks} == dict.fromkeys(
        (779, 780), Status.HOLDING
    )


@pytest.mark.parametrize(
    ("line", "every_s"), [("#5QD", 0.05), ("#5QD", 0.1), ("#5QMS", 0.1), ("#5QV", 0.37)]
)
def test_another_host_is_noticed_by_the_replies_that_it_causes(connected, spec, line, every_s):
    master = Fault(kind=FaultKind.SECOND_MASTER, text=line, every_s=every_s)
    connection = connected(spec(5), spec(6), faults=[master])
    looks = {look.servo_id: look for look in survey(connection, connection.buses["main"], 115200)}
    assert set(looks) == {5, 6}, "its replies are no servos at other ids"
    assert looks[5].unasked > 0
    assert looks[6].unasked == 0
    assert not looks[5].identity.is_shared
    (text,) = report.warnings(list(looks.values()), "--port P")
    assert "servo 5 sent" in text
    assert "another program or computer asks on this bus, or the servo sends by itself" in text


@pytest.mark.parametrize("line", ["#254QD", "#254QMS", "#254QV"])
@pytest.mark.parametrize("seed", range(3))
def test_another_host_that_asks_all_servos_at_once_is_noticed(connected, spec, line, seed):
    """Its replies damage each other; the servos are found all the same, and no others."""
    master = Fault(kind=FaultKind.SECOND_MASTER, text=line, every_s=0.1)
    connection = connected(*map(spec, (5, 6, 9)), faults=[master], seed=seed)
    looks = survey(connection, connection.buses["main"], 115200)
    assert observed(connection, "main").unreadable_bytes > 0
    assert [look.servo_id for look in looks] == [5, 6, 9]
    assert not any(look.identity.is_shared for look in looks)


@pytest.mark.parametrize("seed", range(3))
def test_a_shared_id_on_a_bus_that_another_host_disturbs_is_doubtful(connected, spec, seed):
    """Its replies always damage each other, as those that the other host asks for do."""
    master = Fault(kind=FaultKind.SECOND_MASTER, text="#254QD", every_s=0.1)
    connection = connected(*map(spec, (5, 6, 9, 9, 12)), faults=[master], seed=seed)
    looks = survey(connection, connection.buses["main"], 115200)
    doubtful = [look.servo_id for look in looks if look.identity.is_doubtful]
    assert ([look.servo_id for look in looks], doubtful) == ([5, 6, 9, 12], [9])
    (text,) = report.unreachable(connection.buses["main"], looks)
    assert "id 9: its queries are regularly answered by unreadable bytes" in text
    assert "Stop the other host, then scan again" in text


def test_scan_prints_an_id_that_is_doubtful_and_what_to_do(command, spec):
    master = Fault(kind=FaultKind.SECOND_MASTER, text="#254QD", every_s=0.1)
    asked = ("scan", "P", "--baud", 115200)
    servos = [*map(spec, (5, 6, 9, 9))]
    code, out, errors, _ = command(*asked, servos=servos, faults=[master])
    assert (code, errors) == (EXIT_UNREACHABLE, "")
    assert "note: P: unreadable bytes come that this program did not ask for" in out
    assert "problem: id 9: its queries are regularly answered by unreadable bytes" in out
    assert "Stop the other host, then scan again" in out


def test_configure_notes_another_host_and_writes_no_doubtful_id(command, spec):
    master = Fault(kind=FaultKind.SECOND_MASTER, text="#5QD", every_s=0.1)
    servos, faults = [*map(spec, (5, 9, 9))], [master]
    asked = ("configure", "--port", "P", "--yes", "--set", "LED=3", "--id")
    code, out, errors, lines = command(*asked, 5, servos=servos, faults=faults)
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "note: servo 5 sent" in out
    assert any(line.startswith(b"#5CLED3") for line in lines)
    code, out, errors, lines = command(*asked, 9, servos=servos, faults=faults)
    assert code == EXIT_UNREACHABLE
    assert "id 9: its queries are regularly answered by unreadable bytes" in errors
    assert not any(line.startswith(b"#9C") for line in lines)
    _, out, _, _ = command(*asked, 5, servos=servos)
    assert "note" not in out


def test_whole_answers_of_other_ids_are_left_out_wherever_they_are_cut():
    asked = [5, 6, None, 6]
    received = [b"*5QMSA\r*9Q", b"MSB\r*6QM", b"*7QD1\r", b"SC\r"]
    assert own_answers(asked, received) == [b"*5QMSA\r", b"*6QM", b"", b"SC\r"]


@pytest.mark.parametrize(
    ("asked", "received"),
    [
        ([5, 6], [b"*5QM", b"SA\r*6QMSB\r"]),
        ([6, 5, 6], [b"", b"*6QM", b"SB\r"]),
    ],
)
def test_an_answer_that_another_query_cuts_is_kept(asked, received):
    assert own_answers(asked, received) == received


def test_unreadable_bytes_of_an_id_are_kept():
    received = [b"*5Q\x80S", b"\x00*6\xffMSB\r"]
    assert own_answers([5, 6], received) == received


@pytest.mark.parametrize("line", ["", "#5QD"])
def test_readable_replies_are_no_unreadable_bytes(connected, spec, line):
    masters = [Fault(kind=FaultKind.SECOND_MASTER, text=line, every_s=0.05)] if line else []
    connection = connected(*map(spec, (5, 6, 9)), faults=masters)
    survey(connection, connection.buses["main"], 115200)
    unasked = observed(connection, "main")
    assert (unasked.unreadable_bytes, unasked.replies[5] > 0) == (0, bool(line))


def test_a_quiet_bus_has_no_reply_that_nothing_asked_for(connected, spec):
    connection = connected(spec(5), spec(6), spec(209, "LSS-2IO"), usb_latency_ns=16_000_000)
    looks = survey(connection, connection.buses["main"], 115200)
    assert [look.unasked for look in looks] == [0] * len(looks)


def test_an_empty_bus_is_reported_as_such(connected):
    connection = connected()
    assert survey(connection, connection.buses["main"], None) == []


def test_safe_mode_is_reported_with_its_cause_and_remedy(connected, spec):
    hot = Fault(kind=FaultKind.HOT, servo_id=5, temperature_c=90.0)
    connection = connected(spec(5), spec(6), faults=[hot])
    connection.ask([])
    connection.wait(0.1)
    looks = survey(connection, connection.buses["main"], 115200)
    assert looks[0].status is Status.SAFE_MODE
    assert looks[0].cause is SafeModeCause.TEMPERATURE
    safe, heat = report.warnings(looks, "--port P")
    assert "servo 5 is in safe mode (temperature): let it cool" in safe
    assert "lss-motion send --port P --id 5 RESET" in safe
    assert "servo 5 is hot" in heat


def test_a_robot_file_is_compared_with_the_bus(connected, spec, tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text("""
robot: three
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {arm: {id: 1}, hand: {id: 2}, foot: {id: 3, model: LSS-HT1}}
""")
    robot = load_robot(path)
    connection = connected(spec(1), spec(3), spec(9))
    bus = connection.buses["main"]
    looks = survey(connection, bus, 115200)
    missing, other = report.differences(robot, bus, looks)
    assert "joint 'hand': servo 2 does not answer" in missing
    assert "joint 'foot': servo 3 is an LSS-ST1, the robot file says LSS-HT1" in other
    assert list(report.unnamed(robot, bus, looks)) == ["servo 9 (LSS-ST1) is not in the robot file"]


def test_the_starter_is_a_robot_file_that_loads(connected, spec, tmp_path):
    connection = connected(
        spec(1),
        spec(2),
        spec(4, "LSS-P-S1"),
        spec(6),
        spec(6),
        spec(8, baud_bps=9600),
        spec(209, "LSS-2IO"),
    )
    bus = replace(connection.buses["main"], port="/dev/ttyUSB7")
    looks = survey(connection, connection.buses["main"], None)
    text = starter_file("bag", bus, looks)
    path = tmp_path / "bag.yaml"
    path.write_text(text)
    robot = load_robot(path)
    assert {name: joint.servo_id for name, joint in robot.joints.items()} == {
        "joint_1": 1,
        "joint_2": 2,
        "joint_4": 4,
        "joint_209": 209,
        "joint_210": 210,
        "joint_211": 211,
    }
    assert robot.joints["joint_4"].model.name == "LSS-P-S1"
    assert robot.buses["main"].port == "/dev/ttyUSB7"
    assert "# not used: id 6, which several servos share" in text
    assert "# not used: id 8, LSS-ST1 at 9600 bps" in text
    assert "# not used: id 203, LSS-2IO-A3, which no joint of a robot file can be" in text


def test_without_a_servo_of_its_own_id_there_is_no_starter(connected, spec):
    connection = connected(spec(0), spec(0))
    bus = connection.buses["main"]
    assert starter_file("bag", bus, survey(connection, bus, 115200)) is None


def test_two_serial_numbers_behind_one_id_are_two_servos():
    received = [b"*5QMSLSS-ST1\r", *[b"*5QN123\r", b"*5QN124\r"] * 2]
    assert is_doubtful(5, received)
    assert judge_answers(5, "LSS-ST1", received).is_shared


def test_a_serial_number_that_came_once_was_damaged():
    received = [b"*5QMSLSS-ST1\r", b"*5QN124\r", *[b"*5QN123\r"] * 2]
    assert is_doubtful(5, received)
    assert judge_answers(5, "LSS-ST1", received).serial_number == "123"


def test_silence_means_no_device():
    assert judge_answers(5, "", [b"", b""]) is None
