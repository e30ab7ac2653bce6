import pytest

from lss_motion.protocol.codec import make_command, read_reply
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import Reply, ReplyParser, encode
from lss_motion.protocol.io2 import rc_zero_deg
from lss_motion.protocol.lss_pro import Units
from lss_motion.protocol.table import Suffix
from lss_motion.robot.servo_models import SERVO_MODELS, with_units
from lss_motion.sim.boards import SENSOR_FAR, SENSORS
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import ServoSpec

IO2 = SERVO_MODELS["LSS-2IO"]


def rc_servo(servo_id: int = 209) -> ServoSpec:
    return ServoSpec(servo_id=servo_id, model=IO2)


@pytest.fixture
def board(make_host):
    return make_host(rc_servo(209), rc_servo(210), rc_servo(211))


@pytest.mark.parametrize(
    ("pin_id", "name"),
    [(203, "A3"), (204, "A4"), (205, "A5"), (207, "LED"), (209, "D9"), (210, "D10"), (211, "D11")],
)
def test_every_pin_reports_its_kind(board, pin_id, name):
    assert board.ask(f"#{pin_id}QMS") == f"*{pin_id}QMSLSS-2IO-{name}|"


def test_a_timed_move_jumps_in_whole_degrees(board):
    board.say("#209D457T900")
    board.wait_s(0.4)
    assert board.horn_deg(0) == pytest.approx(45.0, abs=0.01)
    assert board.ask("#209QD") == "*209QD450|"


@pytest.mark.parametrize(("asked", "said", "deg"), [(1456, 900, 90.0), (-1456, -900, -90.0)])
def test_what_is_beyond_90_degrees_ends_there(board, asked, said, deg):
    board.say(f"#210D{asked}")
    board.wait_s(1.0)
    assert board.ask("#210QD") == f"*210QD{said}|"
    assert board.horn_deg(1) == pytest.approx(deg, abs=0.01)


def test_qd_answers_the_command_however_far_the_horn_is(make_host):
    host = make_host(rc_servo(), faults=[Fault(kind=FaultKind.STUCK)])
    host.say("#209D600")
    assert host.ask("#209QD") == "*209QD600|"
    host.wait_s(5.0)
    assert host.horn_deg() == 0.0
    assert host.ask("#209QD") == "*209QD600|"


def test_a_blocked_rc_servo_has_no_safe_mode(make_host):
    host = make_host(rc_servo(), faults=[Fault(kind=FaultKind.STUCK, until_s=5.0)])
    host.say("#209D600")
    host.wait_s(7.0)
    assert host.horn_deg() == pytest.approx(60.0, abs=0.1)


def test_pulses_are_clamped_and_remembered(board):
    board.say("#211P2334")
    assert board.ask("#211QP") == "*211QP2334|"
    board.wait_s(1.0)
    assert board.horn_deg(2) == pytest.approx((2334 - 1472) * 180 / 1856, abs=0.01)
    for asked, said in ((9000, 2400), (2500, 2400), (500, 544), (-5, 544)):
        board.say(f"#211P{asked}")
        assert board.ask("#211QP") == f"*211QP{said}|"


@pytest.mark.parametrize(
    ("asked", "pulse_us"),
    [(0, 1472), (900, 2400), (-900, 544), (457, 1936), (4539, 2400), (4540, 544), (5000, 590)],
)
def test_degrees_are_pulses_of_544_to_2400_us(board, asked, pulse_us):
    board.say(f"#209D{asked}")
    assert board.ask("#209QP") == f"*209QP{pulse_us}|"


def test_before_any_command_a_pin_reports_20_tenths_and_the_middle_pulse(board):
    assert [board.ask(f"#209{word}") for word in ("QD", "QP")] == ["*209QD20|", "*209QP1500|"]


def test_a_command_without_a_value_goes_to_0(board):
    for line, question, said in (
        ("#209D", "QD", "0"),
        ("#209P", "QP", "544"),
        ("#207LED", "QLED", "0"),
    ):
        board.say("#209D450")
        board.say("#207LED3")
        board.say(line)
        assert board.ask(f"#{line[1:4]}{question}") == f"*{line[1:4]}{question}{said}|"


def test_a_turned_gyre_mirrors_degrees_and_answers_nonsense(board):
    board.say("#209G-1")
    board.say("#209D450")
    board.wait_s(1.0)
    assert board.bus.motors.horns.deg[0] == pytest.approx(-45.0, abs=0.01)
    assert board.ask("#209QD") == "*209QD-1350|"
    board.say("#209P2334")
    board.wait_s(1.0)
    assert board.ask("#209QP") == "*209QP2334|"
    assert board.bus.motors.horns.deg[0] == pytest.approx((2334 - 1472) * 180 / 1856, abs=0.01)


def test_90_degrees_of_an_rc_servo_with_its_own_pulses_are_90_degrees(make_host):
    """D900 gives 2400 us, at which a servo of 500 to 2500 us stands at 81 degrees."""
    model = with_units(SERVO_MODELS["LSS-2IO"], Units(rc_pulse_us=(500, 2500)))
    host = make_host(ServoSpec(servo_id=209, model=model))
    host.say("#209D900")
    host.wait_s(1.0)
    assert host.horn_deg() + rc_zero_deg((500, 2500)) == pytest.approx(81.0, abs=0.01)
    for angle_deg in (80.0, 45.0, 0.0, -45.0, -85.0):
        turn_deg = angle_deg - rc_zero_deg((500, 2500))
        command = make_command(model.language, 209, "D", turn_deg)
        host.say(encode(command)[:-1].decode())
        host.wait_s(1.0)
        assert host.horn_deg() == pytest.approx(turn_deg, abs=0.5)


@pytest.mark.parametrize(
    "question", ["Q", "QV", "QT", "QC", "QDT", "QF", "QN", "QWD", "QSD", "QEM", "QO", "QLED"]
)
def test_what_the_board_has_not_got_is_silence(board, question):
    assert board.ask(f"#209{question}") == ""


@pytest.mark.parametrize("line", ["#209H", "#209MD100", "#209WD100", "#209RESET", "#209LED3"])
def test_commands_that_a_pin_has_not_got_do_nothing(board, line):
    board.say("#207LED2")
    board.say(line)
    board.wait_s(0.5)
    assert board.horn_deg(0) == 0.0
    assert board.ask("#207QLED") == "*207QLED2|"


def test_every_device_reports_its_id_and_gyre(board):
    for device in (203, 207, 209):
        assert board.ask(f"#{device}QID") == f"*{device}QID{device}|"
        assert board.ask(f"#{device}QG") == f"*{device}QG1|"


def test_a_model_query_to_all_is_answered_by_every_device(board):
    names = board.ask("#254QMS").split("|")
    assert sorted(names) == ["", *(f"*{n}QMSLSS-2IO-{name}" for n, name in (
        (203, "A3"), (204, "A4"), (205, "A5"), (207, "LED"), (209, "D9"), (210, "D10"), (211, "D11")
    ))]  # fmt: skip


def test_of_two_pins_with_one_id_only_the_first_acts_and_answers(board):
    for line in ("#210CID203", "#211CID203"):
        board.say(line)
    assert board.ask("#203QMS") == "*203QMSLSS-2IO-D10|"
    board.say("#203D450")
    board.wait_s(1.0)
    assert [board.horn_deg(index) for index in range(3)] == pytest.approx([0.0, 45.0, 0.0], abs=0.1)


def test_a_pin_with_id_0_acts_and_answers_its_model_only(board):
    board.say("#209CID0")
    board.say("#0D450")
    board.wait_s(1.0)
    assert board.horn_deg() == pytest.approx(45.0, abs=0.1)
    assert board.ask("#0QD") == board.ask("#0QID") == ""
    assert board.ask("#0QMS") == "*0QMSLSS-2IO-D9|"


@pytest.mark.parametrize("line", ["#254CG-1", "#254CLED5", "#254CB9600", "#254CID9", "#254CA4"])
def test_no_broadcast_changes_what_is_stored(board, line):
    board.say(line)
    board.say("#207RESET")
    board.wait_s(0.05)
    questions = ("#209QG", "#207QLED", "#207QB", "#209QID")
    answers = ["*209QG1|", "*207QLED0|", "*207QB115200|", "*209QID209|"]
    assert [board.ask(question) for question in questions] == answers


def test_other_broadcasts_are_obeyed_and_not_answered(board):
    board.say("#254D300")
    board.say("#254LED4")
    board.wait_s(1.0)
    assert [board.horn_deg(index) for index in range(3)] == pytest.approx([30.0] * 3, abs=0.1)
    assert board.ask("#207QLED") == "*207QLED4|"
    for question in ("QID", "QD", "QG", "QA", "QLED", "QB"):
        assert board.ask(f"#254{question}") == ""


def test_limp_lasts_until_the_next_position(board):
    board.say("#254L")
    board.wait_s(0.1)
    assert not board.bus.motors._drives.is_powered.any()
    board.say("#209D0")
    board.wait_s(0.1)
    assert board.bus.motors._drives.is_powered.tolist() == [True, False, False]


def test_a_baud_rate_counts_at_once(board):
    assert board.ask("#207QB") == "*207QB115200|"
    board.say("#207CB921600")
    assert board.ask("#207QB") == "*207QB115200|"
    board.say("#209CB9600")
    assert board.ask("#207QB") == "*207QB115200|"
    board.say("#207CB9600")
    assert board.ask("#207QB") == ""


def test_reset_keeps_what_was_configured_and_forgets_the_rest(board):
    for line in ("#207CLED5", "#207LED1", "#209CG-1", "#210G-1", "#203CID2", "#207RESET"):
        board.say(line)
    board.wait_s(0.05)
    questions = ("#207QLED", "#209QG", "#210QG", "#2QMS")
    answers = ["*207QLED5|", "*209QG-1|", "*210QG1|", "*2QMSLSS-2IO-A3|"]
    assert [board.ask(question) for question in questions] == answers


def test_default_acts_at_once_and_needs_no_confirm(board):
    for line in ("#207CLED5", "#209CG-1", "#203CID2", "#207DEFAULT"):
        board.say(line)
    board.wait_s(0.05)
    questions = ("#207QLED", "#209QG", "#203QMS", "#2QMS")
    answers = ["*207QLED0|", "*209QG1|", "*203QMSLSS-2IO-A3|", ""]
    assert [board.ask(question) for question in questions] == answers


def test_a_led_colour_that_does_not_exist_is_off(board):
    board.say("#207LED3")
    board.say("#207LED9")
    assert board.ask("#207QLED") == "*207QLED0|"


def test_analog_inputs_answer_what_they_see(board):
    board.bus.set_input(204, 500, board.now_ns)
    assert board.ask("#204QA") == "*204QA500|"
    board.say("#204G-1")
    assert board.ask("#204QA") == "*204QA524|"


def test_a_pin_with_nothing_connected_reads_random_values(board):
    values = [int(board.ask("#203QA")[6:-1]) for _ in range(30)]
    assert len(set(values)) > 20
    assert max(values) - min(values) > 400
    board.bus.set_input(203, 400, board.now_ns)
    assert {board.ask("#203QA") for _ in range(5)} == {"*203QA400|"}


def test_an_analog_pin_is_an_output_until_the_next_reset(board):
    for line, said in (("#203A200", 1023), ("#203A100", 0), ("#204A1", 1023), ("#203A", 0)):
        board.say(line)
        assert board.ask(f"{line[:4]}QA") == f"*{line[1:4]}QA{said}|"
    board.bus.set_input(203, 400, board.now_ns)
    board.say("#207RESET")
    board.wait_s(0.05)
    assert board.ask("#203QA") == "*203QA400|"


def test_a_receiver_reports_the_pulses_of_its_channels(board):
    board.say("#203CA4")
    reply = board.ask("#203QA")
    assert reply == "*203QA" + ",1500" * 8 + "|"
    (read,) = ReplyParser().feed(reply.replace("|", "\r").encode())
    assert read == Reply(203, "QA", ",1500" * 8)
    assert read_reply(Family.IO2, read).value == ",1500" * 8
    board.say("#207RESET")
    board.wait_s(0.05)
    assert board.ask("#203QA") == reply
    board.say("#203CA0")
    assert "," not in board.ask("#203QA")


@pytest.mark.parametrize(
    ("suffix", "raw", "distance_mm"),
    [(1, 426, 50), (1, 1023, 30), (1, 20, 310), (1, 3, 30), (1, 11, 30), (2, 500, 100),
     (2, 21, 810), (2, 0, 90), (3, 260, 389), (3, 1023, 190), (3, 17, 190), (3, 0, 190)],
)  # fmt: skip
def test_a_sensor_answers_its_formula_within_its_range(board, suffix, raw, distance_mm):
    board.bus.set_input(205, raw, board.now_ns)
    assert board.ask(f"#205QA{suffix}") == f"*205QA{distance_mm}|"


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda sensor: sensor.name)
def test_a_distance_and_back(sensor):
    maker = SENSORS[sensor]
    for distance_mm in range(maker.min_mm, maker.max_mm // 2, 7):
        again_mm = maker.distance_mm(maker.raw(distance_mm))
        assert again_mm == pytest.approx(distance_mm, abs=max(2.0, distance_mm**2 / maker.scale))


def test_a_scenario_moves_an_input(make_host):
    raw = SENSORS[Suffix.GP2Y0A41SK0F].raw(100)
    host = make_host(
        rc_servo(),
        faults=[Fault(kind=FaultKind.INPUT, servo_id=203, at_s=1.0, raw=raw)],
        inputs={203: SENSOR_FAR["GP2Y0A41SK0F"]},
    )
    assert host.ask("#203QA1") == "*203QA309|"
    host.wait_s(1.0)
    assert host.ask("#203QA1") == "*203QA99|"


def test_a_section_of_15_characters_fits_and_one_of_16_is_lost(board):
    board.say("#209D00000000450")
    board.wait_s(0.5)
    assert board.ask("#209QD") != "*209QD450|"
    board.say("#209D0000000450")
    assert board.ask("#209QD") == "*209QD450|"


def test_a_long_command_to_another_servo_may_move_an_output(make_host, make_servo):
    host = make_host(make_servo(5), rc_servo(209), rc_servo(210), rc_servo(211))
    moves = 0
    for _ in range(40):
        host.say("#254P1472")
        host.wait_s(0.3)
        host.say("#5D-1800T2500CH400")
        host.wait_s(0.3)
        moves += any(abs(host.horn_deg(index)) > 1.0 for index in (1, 2, 3))
    assert 10 <= moves <= 30


def test_a_group_line_of_short_sections_is_harmless_and_only_its_end_counts(make_host, make_servo):
    host = make_host(make_servo(5), rc_servo(209), rc_servo(210))
    host.say("#209D300#5D300T250#210D300")
    host.wait_s(1.0)
    assert [host.horn_deg(index) for index in range(3)] == pytest.approx([30, 0, 30], abs=0.1)


def test_a_smart_servo_and_a_board_share_a_line(make_host, make_servo):
    host = make_host(make_servo(5), rc_servo(209))
    host.say("#254D200")
    host.wait_s(1.0)
    assert [host.ask("#5QD"), host.ask("#209QD")] == ["*5QD200|", "*209QD200|"]


def test_horn_angles_are_in_the_order_of_the_specs(make_host, make_servo):
    host = make_host(rc_servo(209), make_servo(5))
    host.say("#209D300")
    host.say("#5D100")
    host.wait_s(1.0)
    assert host.bus.horn_deg([host.now_ns])[0] == pytest.approx([30.0, 10.0], abs=0.1)


def test_five_rc_servos_need_two_boards(make_host):
    ids = (209, 210, 211, 12, 13)
    host = make_host(*(rc_servo(servo_id) for servo_id in ids))
    for place, servo_id in enumerate(ids):
        host.say(f"#{servo_id}D{100 * place}")
    host.wait_s(1.0)
    angles_deg = [host.horn_deg(index) for index in range(5)]
    assert angles_deg == pytest.approx([0.0, 10.0, 20.0, 30.0, 40.0], abs=0.1)
    assert host.ask("#13QMS") == "*13QMSLSS-2IO-D10|"


def test_a_servo_with_an_id_of_its_own_takes_a_pin_that_is_left(make_host):
    host = make_host(rc_servo(9), rc_servo(209))
    assert host.ask("#9QMS") == "*9QMSLSS-2IO-D10|"
    assert host.ask("#209QMS") == "*209QMSLSS-2IO-D9|"


def test_a_deaf_pin_leaves_the_others_alone(make_host):
    host = make_host(
        rc_servo(209), rc_servo(210), faults=[Fault(kind=FaultKind.DEAF, servo_id=210)]
    )
    assert [host.ask("#209QG"), host.ask("#210QG")] == ["*209QG1|", ""]


def test_a_reset_of_one_pin_is_a_reset_of_its_board(make_host):
    host = make_host(rc_servo(209), faults=[Fault(kind=FaultKind.RESET, servo_id=209, at_s=1.0)])
    host.say("#207LED4")
    host.wait_s(1.1)
    assert host.ask("#207QLED") == "*207QLED0|"
