import pytest

from lss_motion.errors import InputError
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.faults_file import load_faults


def test_a_lost_command_is_heard_by_nobody(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.LOST_COMMAND, at_s=1.0, until_s=2.0)])
    host.say("#5LED1")
    host.wait_s(1.0)
    host.say("#5LED2")
    assert host.bus.heard[-1][1] == b"#5LED1\r"
    host.wait_s(1.0)
    assert host.ask("#5QLED") == "*5QLED1|"


def test_a_corrupt_command_differs_in_one_byte(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.CORRUPT_COMMAND)])
    host.say("#5D1234T500")
    heard = host.bus.heard[0][1]
    assert len(heard) == 12
    assert sum(a != b for a, b in zip(heard, b"#5D1234T500\r", strict=True)) == 1


def test_a_lost_reply_never_comes_and_the_command_was_obeyed(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.LOST_REPLY, until_s=1.0)])
    host.say("#5LED3")
    assert host.ask("#5QLED") == ""
    host.wait_s(1.0)
    assert host.ask("#5QLED") == "*5QLED3|"


def test_a_ratio_strikes_that_share(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.LOST_REPLY, ratio=0.25)])
    lost = sum(host.ask("#5QG") == "" for _ in range(400))
    assert 70 <= lost <= 130


def test_a_corrupt_reply_differs_in_one_byte(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.CORRUPT_REPLY)])
    reply = host.ask("#5QSD").replace("|", "\r")
    assert sum(a != b for a, b in zip(reply, "*5QSD3600\r", strict=True)) == 1


def test_a_late_reply_may_come_after_its_servo_was_asked_again(make_host):
    late = Fault(kind=FaultKind.LATE_REPLY, until_s=0.01, late_s=0.1)
    host = make_host(faults=[late])
    host.bus.write(b"#5QLED\r", 0)
    host.wait_s(0.05)
    assert host.bus.read(host.now_ns) == b""
    host.bus.write(b"#5QG\r", host.now_ns)
    host.wait_s(0.1)
    assert host.bus.read(host.now_ns) == b"*5QLED7\r*5QG1\r"


def test_a_double_reply_comes_twice(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.DOUBLE_REPLY)])
    assert host.ask("#5QG") == "*5QG1|*5QG1|"


def test_only_the_named_servo_is_deaf(make_host, make_servo):
    deaf = Fault(kind=FaultKind.DEAF, servo_id=6)
    host = make_host(make_servo(5), make_servo(6), faults=[deaf])
    assert [host.ask("#5QG"), host.ask("#6QG")] == ["*5QG1|", ""]


def test_a_servo_may_answer_with_the_id_of_another(make_host, make_servo):
    wrong = Fault(kind=FaultKind.WRONG_ID, servo_id=6, as_id=5)
    host = make_host(make_servo(5), make_servo(6), faults=[wrong])
    assert host.ask("#6QG") == "*5QG1|"


def test_a_servo_that_resets_in_mid_move_stops_and_comes_back_limp(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.RESET, servo_id=5, at_s=1.0)])
    host.say("#5D900T3000")
    host.wait_s(1.5)
    stopped_deg = host.horn_deg()
    assert 20.0 < stopped_deg < 30.0
    assert host.ask("#5Q") == ""
    host.wait_s(1.0)
    assert host.ask("#5Q") == "*5Q1|"
    assert host.horn_deg() == stopped_deg


def test_a_stuck_horn_comes_free_again(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.STUCK, at_s=0.1, until_s=1.0)])
    host.wait_s(0.2)
    host.say("#5D450")
    host.wait_s(0.5)
    assert host.horn_deg() == 0.0
    assert host.ask("#5Q") in ("*5Q8|", "*5Q9|")
    host.wait_s(1.5)
    assert host.horn_deg() == pytest.approx(45.0, abs=0.01)


def test_a_weak_motor_is_slower_while_it_is_weak(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.WEAK, speed_ratio=0.1, until_s=1.0)])
    host.say("#5D900")
    host.wait_s(0.9)
    assert 20.0 < host.horn_deg() < 36.0
    host.wait_s(1.0)
    assert host.horn_deg() == pytest.approx(90.0, abs=0.01)


def test_a_hot_servo_trips(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.HOT, at_s=0.5, temperature_c=90.0)])
    host.say("#5D900")
    host.wait_s(0.6)
    assert [host.ask("#5Q"), host.ask("#5Q1"), host.ask("#5QT")] == ["*5Q10|", "*5Q3|", "*5QT900|"]


def test_faults_repeat_with_their_seed(make_host):
    def play(seed):
        faults = [Fault(kind=FaultKind.LOST_REPLY, ratio=0.5)]
        host = make_host(seed=seed, faults=faults)
        return [host.ask("#5QG") for _ in range(64)]

    assert play(3) == play(3)
    assert play(3) != play(4)


def test_a_faults_file_says_when_who_and_what(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "faults:\n"
        "  - {kind: lost_reply, ratio: 0.1}\n"
        "  - {kind: reset, servo: 5, at_s: 2.5}\n"
        "  - {kind: wrong_id, servo: 6, as_id: 7, at_s: 1, until_s: 2}\n"
    )
    assert load_faults(path) == (
        Fault(kind=FaultKind.LOST_REPLY, ratio=0.1),
        Fault(kind=FaultKind.RESET, servo_id=5, at_s=2.5),
        Fault(kind=FaultKind.WRONG_ID, servo_id=6, as_id=7, at_s=1.0, until_s=2.0),
    )


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("{kind: lost_rely}", "did you mean 'lost_reply'"),
        ("{kind: late_reply}", "late_reply needs 'late_s'"),
        ("{kind: wrong_id, as_id: 3}", "wrong_id needs 'servo'"),
        ("{kind: deaf, at_s: 2, until_s: 1}", "until_s 1 must be after 2"),
        ("{kind: reset, until_s: 1}", "happens once"),
        ("{kind: lost_command, servo: 5}", "for one servo use 'deaf'"),
        ("{kind: deaf, late_s: 1}", "'late_s' says nothing about deaf"),
        ("{kind: deaf, ratio: 1.5}", "must be 1 or less"),
    ],
)
def test_a_wrong_row_is_named_with_its_line(tmp_path, row, words):
    path = tmp_path / "faults.yaml"
    path.write_text(f"faults:\n  - {{kind: deaf}}\n  - {row}\n")
    with pytest.raises(InputError) as caught:
        load_faults(path)
    assert f"{path}:3:" in str(caught.value)
    assert words in str(caught.value)
