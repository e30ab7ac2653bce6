import pytest
from campaign.random_faults import KINDS, mixed_faults, random_faults
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.robot.model import Bus, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import bus_from_robot
from lss_motion.sim.faults import Fault, FaultKind, load_faults
from lss_motion.sim.physics import Physics
from tests.joints import joint
from tests.tables import titled


@pytest.fixture
def two_buses():
    model = SERVO_MODELS["LSS-ST1"]
    joints = {
        bus: joint(bus, servo_id, bus=bus, model=model)
        for servo_id, bus in ((1, "left"), (2, "right"))
    }
    buses = {name: Bus(name=name, port="sim://", baud_bps=115200, firmware=370) for name in joints}
    return Robot(name="two", path=None, buses=buses, joints=joints)


def row(kind, **fields):
    return Fault(kind=FaultKind(kind), **fields)


DIALOGUES = {
    "a lost reply never comes, and its command is obeyed":
        ([row("lost_reply", until_s=1.0)], "#5LED3 #5QLED= 1s #5QLED=3"),
    "a double reply comes twice": ([row("double_reply")], "#5QG=*5QG1|*5QG1|"),
    "a restarted servo is deaf for as long as the row says": (
        [row("reset", at_s=1.0, deaf_s=0.3)],
        "#5SD100 1s #5QSD= 0.2s #5QSD= 0.09s #5QSD=3600",
    ),
    "only the named servo is deaf": ([row("deaf", servo_id=6)], "#5QG=1 #6QG="),
    "a servo may answer with the id of another":
        ([row("wrong_id", servo_id=6, as_id=5)], "#6QG=*5QG1|"),
    "a hot servo trips": (
        [row("hot", servo_id=5, at_s=0.5, temperature_c=90.0)],
        "#5D900 0.6s #5Q=10 #5Q1=3 #5QT=900",
    ),
    "stored settings act at once, and after a restart again": (
        [row("stored", servo_id=5, settings={"G": -1, "O": 50, "SD": 900})],
        "#5QG=-1 #5QO=50 #5QSD1=900 #5QD=50 #6QG=1 #5G1 #5RESET 1.5s #5QG=-1 #5QD=50",
    ),
    "servos may have exchanged their ids": (
        [
            row("stored", servo_id=5, settings={"ID": 6}),
            row("stored", servo_id=6, settings={"ID": 5}),
        ],
        "#5D200 1s @0:0 @1:20",
    ),
    "a stuck horn comes free again":
        ([row("stuck", at_s=0.1, until_s=1.0)], "0.2s #5D450 0.5s @0 #5Q=8 1.5s @45"),
    "a weak motor is slower while it is weak":
        ([row("weak", speed_ratio=0.1, until_s=1.0)], "#5D900 0.9s @31.28 1s @90"),
    "a supply below the least of the servos stops them": (
        [row("low_voltage", at_s=0.2, supply_v=5.0)],
        "#5D900T2000 1s #5Q=10 #5Q1=2 @7.17",
    ),
}  # fmt: skip
SCALES = {
    "D, finer": ("D", 0.1, "#5D300 0.7s @3 #5QD=300"),
    "D, coarser": ("D", 10.0, "#5D30 0.7s @30 #5QD=30"),
    "SD": ("SD", 10.0, "#5SD100 #5D300 0.7s @30 #5QSD=100"),
    "T": ("T", 0.01, "#5D300T20000 0.7s @30 #5QT=250"),
}


@titled(("faults", "dialogue"), DIALOGUES)
def test_a_row_does(make_host, make_servo, faults, dialogue):
    make_host(make_servo(5), make_servo(6), faults=faults).talk(dialogue)


@titled(("setting", "scale_ratio", "dialogue"), SCALES)
def test_a_servo_with_another_scale_takes_and_answers_its_own(
    make_host, setting, scale_ratio, dialogue
):
    """The time is too short for 30 deg at 10 deg/s, and long enough at 100 deg/s."""
    fault = row("wrong_scale", setting=setting, scale_ratio=scale_ratio)
    make_host(faults=[fault]).talk(dialogue)


def test_a_lost_command_reaches_no_servo(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.LOST_COMMAND, at_s=1.0, until_s=2.0)])
    host.say("#5LED1")
    host.wait_s(1.0)
    host.say("#5LED2")
    assert host.bus.lines[-1][1] == b"#5LED1\r"
    host.wait_s(1.0)
    assert host.ask("#5QLED") == "*5QLED1|"


def test_a_corrupt_command_differs_in_one_byte(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.CORRUPT_COMMAND)])
    host.say("#5D1234T500")
    received = host.bus.lines[0][1]
    assert len(received) == 12
    assert sum(a != b for a, b in zip(received, b"#5D1234T500\r", strict=True)) == 1


def test_ramps_in_another_scale_are_as_much_steeper(make_host):
    at_deg = {}
    for ratio in (1.0, 4.0):
        rows = [
            Fault(kind=FaultKind.WRONG_SCALE, setting=setting, scale_ratio=ratio)
            for setting in ("AA", "AD")
        ]
        host = make_host(faults=rows, physics=Physics(noise_deg=0.0, lag_s=0.001))
        host.say("#5AA10")
        host.say("#5AD10")
        host.say("#5D3000")
        host.wait_s(0.5)
        at_deg[ratio] = host.horn_deg()
    assert at_deg[4.0] == pytest.approx(4.0 * at_deg[1.0], rel=0.05)


def test_another_host_is_heard_and_so_are_the_replies_to_it(make_host):
    row = Fault(
        kind=FaultKind.SECOND_MASTER, text="#5QG", every_s=0.5, at_s=1.0, until_s=2.2, bus=None
    )
    host = make_host(faults=[row])
    host.say("#5LED1")
    host.wait_s(3.0)
    assert [line for _, line in host.bus.lines] == [b"#5LED1\r", *[b"#5QG\r"] * 3]
    assert [at_ns / 1e9 for at_ns, _ in host.bus.lines[1:]] == [1.0, 1.5, 2.0]
    assert host.bus.read(host.now_ns) == b"*5QG1\r" * 3


def test_a_reply_is_expected_although_another_host_sends_later(make_host):
    row = Fault(kind=FaultKind.SECOND_MASTER, text="#5LED2", every_s=0.5, at_s=1.0, until_s=2.2)
    host = make_host(faults=[row])
    host.bus.write(b"#5QLED\r", 0)
    assert host.bus.next_arrival_ns() < 10**7
    host.wait_s(0.1)
    assert host.bus.read(host.now_ns) == b"*5QLED7\r"
    assert host.bus.next_arrival_ns() == 10**9
    host.wait_s(2.5)
    assert host.ask("#5QLED") == "*5QLED2|"


def test_lines_of_two_hosts_arrive_in_the_order_of_time(make_host):
    row = Fault(kind=FaultKind.SECOND_MASTER, text="#5LED2", every_s=0.1, at_s=1.0, until_s=1.25)
    host = make_host(faults=[row])
    for _ in range(30):
        host.say("#5LED1")
        host.wait_s(0.045)
    at_ns = [ns for ns, _ in host.bus.lines]
    assert at_ns == sorted(at_ns)
    assert [line for _, line in host.bus.lines].count(b"#5LED2\r") == 3


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


def test_a_servo_back_from_the_factory_keeps_its_id_only(make_host, make_servo):
    row = Fault(kind=FaultKind.FACTORY, servo_id=5, at_s=0.5, deaf_s=0.2)
    host = make_host(make_servo(5, start_deg=20.0, eeprom={"G": -1, "O": 50}), faults=[row])
    serial = host.ask("#5QN")
    assert [host.ask("#5QG"), host.ask("#5QD")] == ["*5QG-1|", "*5QD-150|"]
    host.wait_s(0.6)
    assert host.ask("#5QG") == ""
    host.wait_s(0.2)
    answers = [host.ask(line) for line in ("#5QG", "#5QG1", "#5QD", "#5QN")]
    assert answers == ["*5QG1|", "*5QG1|", "*5QD200|", serial]


def test_an_exchanged_servo_has_its_own_number_and_settings(make_host, make_servo):
    row = Fault(kind=FaultKind.EXCHANGED, servo_id=5, at_s=0.5, settings={"O": 30})
    host = make_host(make_servo(5, start_deg=20.0, eeprom={"SD": 900}), faults=[row])
    serial = host.ask("#5QN")
    host.wait_s(2.0)
    assert [host.ask("#5QO1"), host.ask("#5QD")] == ["*5QO30|", "*5QD170|"]
    assert host.ask("#5QSD1") != "*5QSD900|"
    assert host.ask("#5QN") not in ("", serial)


def test_two_servos_with_one_id_answer_together(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.TWIN, servo_id=5)], baud_bps=921600)
    said = {host.ask("#5QD") for _ in range(20)}
    assert "*5QD0|*5QD200|" in said or "*5QD200|*5QD0|" in said
    assert any(text not in ("*5QD0|*5QD200|", "*5QD200|*5QD0|") for text in said)
    host.say("#5D100T500")
    host.wait_s(1.0)
    assert host.bus.horn_deg([host.now_ns]).tolist() == [[pytest.approx(10.0, abs=0.01)]]


def test_the_supply_falls_and_comes_back(make_host):
    low = Fault(kind=FaultKind.LOW_VOLTAGE, at_s=1.0, until_s=2.0, supply_v=7.0)
    host = make_host(faults=[low])
    volts = []
    for _ in range(3):
        host.wait_s(0.5)
        volts.append(round(int(host.ask("#5QV")[4:-1]) / 1000.0, 1))
        host.wait_s(0.5)
    assert volts == [12.0, 7.0, 12.0]


def test_a_simulated_servo_has_the_settings_of_its_robot_file(two_buses):
    one = replace(two_buses.joints["left"], stored={"G": -1.0, "O": 5.0, "FD": 20.0}, zero_deg=3.0)
    robot = replace(two_buses, joints={**two_buses.joints, "left": one})
    quiet = Physics(noise_deg=0.0)
    bus = bus_from_robot(robot, "left", start_deg={"left": 10.0}, physics=quiet)
    bus.record()
    bus.write(b"#1QG\r#1QO\r#1QFD\r", 0)
    bus.advance(50_000_000)
    bus.write(b"#1QD\r", 50_000_000)
    assert bus.read(100_000_000) == b"*1QG-1\r*1QO50\r*1QFDDIS\r*1QD130\r"
    assert bus.horn_deg([0]).tolist() == [[13.0]]


def test_faults_repeat_with_their_seed(make_host):
    def play(seed):
        faults = [Fault(kind=FaultKind.LOST_REPLY, ratio=0.5)]
        host = make_host(seed=seed, faults=faults)
        return [host.ask("#5QG") for _ in range(64)]

    assert play(3) == play(3)
    assert play(3) != play(4)


def test_a_faults_file_has_rows_with_time_servo_and_kind(tmp_path):
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
        ("{kind: clogged, at_s: 1}", "clogged needs 'until_s'"),
        ("{kind: oversleep}", "oversleep needs 'late_s'"),
        (
            "{kind: clock_drift, drift_ppm: 10, ratio: 0.5}",
            "'ratio' says nothing about clock_drift",
        ),
        ("{kind: wrong_scale, setting: SD}", "wrong_scale needs 'scale_ratio'"),
        ("{kind: second_master, text: '#5QD'}", "second_master needs 'every_s'"),
        ("{kind: second_master, text: '#5QD', every_s: 1, servo: 5}", "befalls the line"),
        ("{kind: deaf, deaf_s: 0.1}", "'deaf_s' says nothing about deaf"),
        ("{kind: unplugged, servo: 5}", "befalls the line"),
        ("{kind: stored, servo: 5}", "stored needs 'settings'"),
        ("{kind: stored, servo: 5, settings: {GG: 1}}", "'GG' is no setting that LSS stores"),
        ("{kind: stored, servo: 5, settings: {G: 2}}", "G"),
        ("{kind: reset, settings: {G: -1}}", "'settings' says nothing about reset"),
        ("{kind: twin}", "twin needs 'servo'"),
        ("{kind: twin, servo: 5, at_s: 1}", "'at_s' says nothing about twin"),
        ("{kind: low_voltage}", "low_voltage needs 'supply_v'"),
        ("{kind: low_voltage, supply_v: 9, servo: 5}", "befalls the line"),
        ("{kind: input, servo: 203}", "input needs 'raw', or 'distance_mm' with 'sensor'"),
        ("{kind: input, servo: 203, raw: 1, distance_mm: 5}", "input needs 'raw', or"),
        ("{kind: input, servo: 203, distance_mm: 5}", "'distance_mm' and 'sensor' together"),
        (
            "{kind: input, servo: 203, distance_mm: 5, sensor: GP2Y0A41SK}",
            "did you mean 'GP2Y0A41SK0F'",
        ),
        ("{kind: input, servo: 203, raw: 1024}", "must be 1023 or less"),
    ],
)
def test_a_wrong_row_is_named_with_its_line(tmp_path, row, words):
    path = tmp_path / "faults.yaml"
    path.write_text(f"faults:\n  - {{kind: deaf}}\n  - {row}\n")
    with pytest.raises(InputError) as caught:
        load_faults(path)
    assert f"{path}:3:" in str(caught.value)
    assert words in str(caught.value)


def test_a_short_command_lacks_one_byte(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.SHORT_COMMAND)])
    host.say("#5D1234T500")
    assert len(host.bus.lines[0][1]) == 11


def test_a_double_command_is_received_twice(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.DOUBLE_COMMAND)])
    assert host.ask("#5QG") == "*5QG1|*5QG1|"
    assert [line for _, line in host.bus.lines] == [b"#5QG\r"] * 2


@pytest.mark.parametrize(("firmware", "led"), [(370, 2), (368, 7)])
def test_a_merged_command_runs_into_the_next_one(make_host, firmware, led):
    host = make_host(firmware=firmware, faults=[Fault(kind=FaultKind.MERGED_COMMAND, until_s=0.01)])
    host.bus.write(b"#5LED2\r", 0)
    host.wait_s(0.05)
    host.say("#5G-1")
    assert host.bus.lines[0][1] == b"#5LED2#5G-1\r"
    assert [host.ask("#5QLED"), host.ask("#5QG")] == [f"*5QLED{led}|", "*5QG-1|"]
    assert [line for _, line in host.bus.lines[1:]] == [b"#5QLED\r", b"#5QG\r"]


def test_a_short_reply_lacks_one_byte(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.SHORT_REPLY)])
    assert len(host.ask("#5QSD")) == len("*5QSD3600|") - 1


def test_a_merged_reply_runs_into_the_next_one(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.MERGED_REPLY, until_s=0.05)])
    first = host.ask("#5QG")
    host.wait_s(0.1)
    assert first + host.ask("#5QLED") == "*5QG1*5QLED7|"


def test_a_split_reply_comes_in_two_pieces(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.SPLIT_REPLY, late_s=0.03)])
    host.bus.write(b"#5QSD\r", 0)
    host.wait_s(0.02)
    assert host.bus.read(host.now_ns) == b"*5QSD"
    host.wait_s(0.03)
    assert host.bus.read(host.now_ns) == b"3600\r"


def test_a_clogged_line_holds_bytes_back_and_then_lets_them_go(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.CLOGGED, at_s=0.5, until_s=1.5)])
    host.wait_s(0.6)
    host.bus.write(b"#5LED1\r#5LED2\r", host.now_ns)
    assert host.bus.backlog_ns(host.now_ns) == pytest.approx(0.9e9 + 14 * 86_806, abs=1e4)
    host.wait_s(0.9)
    assert host.bus.lines == []
    host.wait_s(0.1)
    assert [line for _, line in host.bus.lines] == [b"#5LED1\r", b"#5LED2\r"]
    assert host.bus.lines[0][0] == pytest.approx(1.5e9 + 7 * 86_806, abs=1e4)


def test_a_clog_in_the_middle_of_a_line_delays_its_end_only(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.CLOGGED, at_s=0.001, until_s=0.101)])
    host.bus.write(b"#5LED1\r" * 3, 0)
    host.wait_s(0.2)
    arrivals_ms = [round(received_ns / 1e6, 2) for received_ns, _ in host.bus.lines]
    assert arrivals_ms == [0.61, 101.22, 101.82]


def test_a_clog_needs_an_end():
    with pytest.raises(ValueError, match="until_s"):
        Fault(kind=FaultKind.CLOGGED)


def test_old_firmware_damages_replies_now_and_then_and_serial_numbers_oftener(make_host):
    physics = Physics(noise_deg=0.0)

    def damaged(firmware, question, count):
        host = make_host(firmware=firmware, physics=physics)
        good = host.ask(question)
        return sum(host.ask(question) != good for _ in range(count))

    assert damaged(369, "#5QG", 3000) == 0
    assert 1 <= damaged(368, "#5QG", 3000) <= 9
    assert 15 <= damaged(368, "#5QN", 3000) <= 50


def test_random_faults_are_the_same_for_a_seed_and_cover_every_kind():
    rows = [random_faults(seed, servo_ids=(3, 5), duration_s=10.0) for seed in range(300)]
    assert rows == [random_faults(seed, servo_ids=(3, 5), duration_s=10.0) for seed in range(300)]
    assert {fault.kind for some in rows for fault in some} == set(KINDS)
    assert {fault.servo_id for some in rows for fault in some} == {None, 3, 5}


def test_mixed_rows_are_the_same_for_a_seed_and_cover_every_kind(two_buses):
    rows = [mixed_faults(seed, two_buses, 5.0) for seed in range(400)]
    assert rows == [mixed_faults(seed, two_buses, 5.0) for seed in range(400)]
    assert {fault.kind for some in rows for fault in some} >= {
        *KINDS,
        FaultKind.STORED,
        FaultKind.FACTORY,
        FaultKind.EXCHANGED,
        FaultKind.TWIN,
        FaultKind.BLOCKED_PORT,
        FaultKind.LOW_VOLTAGE,
        FaultKind.WRONG_SCALE,
        FaultKind.SECOND_MASTER,
    }


@pytest.mark.parametrize("seed", range(60))
def test_a_bus_survives_random_faults_and_answers_when_they_are_over(make_host, make_servo, seed):
    faults = [
        replace(fault, until_s=min(fault.until_s, 2.0), at_s=min(fault.at_s, 1.9))
        for fault in random_faults(seed, servo_ids=(5, 6), duration_s=2.0)
    ]
    host = make_host(make_servo(5), make_servo(6), faults=faults, seed=seed)
    for turn in range(40):
        host.bus.write(b"#5D%dT100\r#6D%dT100\r" % (turn * 20, -turn * 20), host.now_ns)
        host.ask("#5QD")
    host.wait_s(4.0)
    host.bus.read(host.now_ns)
    host.say("")  # ends a command that was merged
    host.say("#254RESET")
    host.wait_s(1.5)
    assert [host.ask("#5QG"), host.ask("#6QG")] == ["*5QG1|", "*6QG1|"]


def test_a_distance_before_a_sensor_is_its_raw_value(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "faults: [{kind: input, servo: 203, distance_mm: 50, sensor: GP2Y0A41SK0F, at_s: 2}]\n"
    )
    assert load_faults(path) == (Fault(kind=FaultKind.INPUT, servo_id=203, at_s=2.0, raw=426),)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("{kind: deaf, servo: 99}", "robot 'two' has no servo 99 there; known ids are 1, 2"),
        ("{kind: deaf, bus: lft}", "robot 'two' has no bus 'lft'; did you mean 'left'"),
        ("{kind: deaf, bus: left, servo: 2}", "no servo 2 there; known ids are 1"),
        ("{kind: input, servo: 203, raw: 5}", "has no LSS-2IO there"),
    ],
)
def test_a_row_about_what_the_robot_has_not_got_is_a_mistake(tmp_path, two_buses, row, words):
    path = tmp_path / "faults.yaml"
    path.write_text(f"faults:\n  - {row}\n")
    with pytest.raises(InputError) as caught:
        load_faults(path, two_buses)
    assert words in str(caught.value)


def test_a_row_may_be_about_one_bus(two_buses):
    fault = Fault(kind=FaultKind.LOST_COMMAND, bus="left")
    received = {}
    for name in two_buses.buses:
        bus = bus_from_robot(two_buses, name, faults=[fault])
        bus.record()
        bus.write(b"#254LED1\r", 0)
        bus.advance(10**9)
        received[name] = [line for _, line in bus.lines]
    assert received == {"left": [], "right": [b"#254LED1\r"]}


def test_an_adapter_that_echoes_returns_each_line_before_its_reply_and_the_reply_whole(
    make_host, make_servo
):
    row = Fault(kind=FaultKind.ECHO, at_s=1.0, until_s=2.0)
    host = make_host(make_servo(5), faults=[row])
    assert host.ask("#5QG") == "*5QG1|"
    host.wait_s(1.1)
    assert host.ask("#5QG") == "#5QG|*5QG1|"
    host.say("#5LED3")
    assert host.bus.read(host.now_ns) == b"#5LED3\r"
    host.bus.write(b"#7QD\r#5QLED\r", host.now_ns)
    host.wait_s(0.05)
    assert host.bus.read(host.now_ns) == b"#7QD\r#5QLED\r*5QLED3\r"
    host.wait_s(1.0)
    assert host.ask("#5QG") == "*5QG1|"


@pytest.mark.parametrize("usb_latency_ns", [0, 16_000_000])
def test_an_echo_wakes_the_host_as_a_reply_does(make_host, make_servo, usb_latency_ns):
    row = Fault(kind=FaultKind.ECHO)
    host = make_host(make_servo(5), faults=[row], usb_latency_ns=usb_latency_ns)
    assert host.ask("#9QD") == "#9QD|"
