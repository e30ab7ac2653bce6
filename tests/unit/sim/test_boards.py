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
from tests.tables import titled

IO2 = SERVO_MODELS["LSS-2IO"]


def rc_servo(servo_id: int = 209) -> ServoSpec:
    return ServoSpec(servo_id=servo_id, model=IO2)


DIALOGUES = {
    "a timed move jumps in whole degrees": "#209D457T900 0.4s @45 #209QD=450",
    "degrees are pulses of 544 to 2400 us":
        "#209D0 #209QP=1472 #209D900 #209QP=2400 #209D-900 #209QP=544 #209D457 #209QP=1936 "
        "#209D4539 #209QP=2400 #209D4540 #209QP=544 #209D5000 #209QP=590",
    "a command without a value goes to 0":
        "#209D450 #209D #209QD=0 #209D450 #209P #209QP=544 #207LED3 #207LED #207QLED=0",
    "a turned gyre mirrors degrees and answers nonsense":
        "#209G-1 #209D450 1s @-45 #209QD=-1350 #209P2334 1s #209QP=2334 @83.60",
    "commands that a pin has not got do nothing":
        "#207LED2 #209H 0.5s @0 #207QLED=2 #209MD100 0.5s @0 #207QLED=2 #209WD100 0.5s @0 "
        "#207QLED=2 #209RESET 0.5s @0 #207QLED=2 #209LED3 0.5s @0 #207QLED=2",
    "of two pins with one id only the first acts and answers":
        "#210CID203 #211CID203 #203QMS=LSS-2IO-D10 #203D450 1s @0:0 @1:45 @2:0",
    "a pin with id 0 acts and answers its model only":
        "#209CID0 #0D450 1s @45 #0QD= #0QID= #0QMS=LSS-2IO-D9",
    "a broadcast changes what is stored of each pin that has the setting":
        "#254CLED6 #207QLED=6 #254CG-1 #209QG=-1 #203QG=-1 #207QG=-1 #207RESET 0.05s #207QLED=6 "
        "#210QG=-1 #204QG=-1 #207QB=115200",
    "a broadcast changes the rate": "#254CB9600 #207QB=",
    "a broadcast changes the mode of analog pins":
        "#254CA4 #203QA=,1500,1500,1500,1500,1500,1500,1500,1500 #209QA= #207RESET 0.05s "
        "#205QA=,1500,1500,1500,1500,1500,1500,1500,1500",
    "a broadcast gives all pins one id, and the first answers":
        "#254CID9 #9QMS=LSS-2IO-D9 #209QMS= #207QLED=",
    "an id beyond the page is taken": "#209CID251 #209QMS= #251QMS=LSS-2IO-D9",
    "a baud rate counts at once":
        "#207QB=115200 #207CB921600 #207QB=115200 #209CB9600 #207QB=115200 #207CB9600 #207QB=",
    "a reset keeps what was configured and forgets the rest":
        "#207CLED5 #207LED1 #209CG-1 #210G-1 #203CID2 #207RESET 0.05s #207QLED=5 #209QG=-1 "
        "#210QG=1 #2QMS=LSS-2IO-A3",
    "a default acts at once and needs no confirmation":
        "#207CLED5 #209CG-1 #203CID2 #207DEFAULT 0.05s #207QLED=0 #209QG=1 #203QMS=LSS-2IO-A3 "
        "#2QMS=",
    "an analog pin is an output until the next reset":
        "#203A200 #203QA=1023 #203A100 #203QA=0 #204A1 #204QA=1023 #203A #203QA=0 #207RESET 0.05s "
        "#203QA=400",
    "a section of 15 characters fits and one of 16 is lost":
        "#209D00000000450 0.5s #209QD=20 #209D0000000450 #209QD=450",
}  # fmt: skip


@pytest.fixture
def board(make_host):
    return make_host(rc_servo(209), rc_servo(210), rc_servo(211))


@titled("dialogue", DIALOGUES)
def test_a_board_answers(board, dialogue):
    board.bus.set_input(203, 400, board.now_ns)
    board.talk(dialogue)


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


def test_a_model_query_to_all_is_answered_by_every_device(board):
    names = board.ask("#254QMS").split("|")
    assert sorted(names) == ["", *(f"*{n}QMSLSS-2IO-{name}" for n, name in (
        (203, "A3"), (204, "A4"), (205, "A5"), (207, "LED"), (209, "D9"), (210, "D10"), (211, "D11")
    ))]  # fmt: skip


def test_limp_lasts_until_the_next_position(board):
    board.say("#254L")
    board.wait_s(0.1)
    assert not board.bus.motors._drives.is_powered.any()
    board.say("#209D0")
    board.wait_s(0.1)
    assert board.bus.motors._drives.is_powered.tolist() == [True, False, False]


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


SHARED = {
    "five RC servos need two boards": (
        (209, 210, 211, 12, 13),
        "#209D0 #210D100 #211D200 #12D300 #13D400 1s @0:0 @1:10 @2:20 @3:30 @4:40 "
        "#13QMS=LSS-2IO-D10",
    ),
    "an id of its own takes a pin that is left": (
        (9, 209), "#9QMS=LSS-2IO-D10 #209QMS=LSS-2IO-D9"
    ),
    "a smart servo and a board share a line": (
        (5, 209), "#254D200 1s #5QD=200 #209QD=200"
    ),
    "horn angles are in the order of the specs": (
        (209, 5), "#209D300 #5D100 1s @0:30 @1:10"
    ),
    "of a group line of short sections only the end counts": (
        (5, 209, 210), "#209D300#5D300T250#210D300 1s @0:30 @1:0 @2:30"
    ),
}  # fmt: skip


@titled(("ids", "dialogue"), SHARED)
def test_boards_and_servos_on_a_line(make_host, make_servo, ids, dialogue):
    make_host(*(make_servo(5) if number == 5 else rc_servo(number) for number in ids)).talk(
        dialogue
    )
