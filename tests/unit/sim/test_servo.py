import math
import re

import pytest

from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import Family
from lss_motion.protocol.lss_pro import Units
from lss_motion.protocol.table import ReplyShape
from lss_motion.robot.model import ServoModel
from lss_motion.robot.servo_models import SERVO_MODELS, with_units
from lss_motion.sim.physics import Physics, ServoSpec
from tests.tables import titled

DIALOGUES = {
    "no speed is set above the model's": "#5SD9999 #5QSD=3600",
    "the suffixes of speeds are session, session, stored, present, target":
        "#5CSD1800 #5SD900 #5D3000T10000 1s #5QSD=900 #5QSD0=900 #5QSD1=1800 #5QSD2=300 "
        "#5QSD3=300",
    "a reset forgets the turns": "#5D4800 3s #5QD=4800 #5RS 1.3s #5QD=1200",
    "a new maximum speed counts from the next move on":
        "#5SD900 #5D3000 #5QSD3=900 #5SD300 #5D3000 #5QSD3=300",
    "a default needs a confirmation at once, and resets the id, too":
        "#5CLED3 #5DEFAULT #5QG=1 #5CONFIRM #5QLED1=3 #5DEFAULT #5CONFIRM #0QG= 1.3s #5QG= "
        "#0QLED1=7",
    "CRC with any other value stays in smart mode": "#5CRC1 #5CRC* #5RESET 1.3s #5QG=1",
    "a modifier that does not belong does nothing": "#5D1800S100 #5QSD3=3600",
    "gyre and origin turn and shift what the host sees":
        "#5D300 1s #5G-1 #5QD=-300 #5O100 #5QD=-200 #5D0 1s #5QD=0 #5G1 #5O0 #5QD=100",
    "a turned gyre turns speeds, too": "#5G-1 #5WD600 1s #5QWD=600 @-57.28",
    "software limits bound every target": "#5CLP200 #5CLN-100 #5CLE1 #5D900 1s #5QD=200",
}  # fmt: skip
PRO_DIALOGUES = {
    "a PRO counts hundredths": "#5D4567T500 2s @45.67 #5QD=4567",
    "names its id its own way": "#254QID=*254QID5| #5QMS=LSS-P-S1",
    "without a target answers the last one": "#5QDT=0 #5D3000 #5QDT=3000 #5L #5QDT=3000",
    "measures its speed in hundredths":
        "#5WD30 1s #5QCS=3000 #5QWD=30 #5QSD2=3000 #5WD-30 1s #5QCS=-3000",
    "blinks as it is configured": "#5QLB=0 #5CLB12 #5QLB=12",
}  # fmt: skip
PRO = SERVO_MODELS["LSS-P-S1"]


@titled("dialogue", DIALOGUES)
def test_a_servo_answers(host, dialogue):
    host.talk(dialogue)


def test_reset_is_deaf_for_a_second_and_a_quarter_then_limp(host):
    host.say("#5D450")
    host.wait_s(0.5)
    host.say("#5RESET")
    reset_ns = host.now_ns - 5_000_000
    answers = []
    while not (answer := host.ask("#5Q")):
        answers.append(answer)
    assert answer == "*5Q1|"
    assert host.now_ns - reset_ns >= 1_250_000_000
    assert host.now_ns - reset_ns < 1_300_000_000


def test_reset_forgets_a_move_that_had_not_begun(make_host):
    host = make_host(baud_bps=921600)
    host.bus.write(b"#5D450\r#5RESET\r", 0)
    host.wait_s(3.0)
    assert host.horn_deg() == 0.0


def test_a_rate_that_the_firmware_does_not_know_is_not_taken(make_host):
    host = make_host(firmware=368)
    host.say("#5CB921600")
    assert host.ask("#5QB") == "*5QB115200|"


def test_identity_is_answered(make_host):
    host = make_host(firmware=368)
    assert host.ask("#5QMS") == "*5QMSLSS-ST1|"
    assert host.ask("#5QF") == "*5QF368|"
    assert host.ask("#5QN")[3:-1].removeprefix("N").isdigit()
    assert host.ask("#5qd") == "*5QD0|"


def test_readings_scatter_by_a_tenth_and_are_right_in_the_mean(make_host, make_servo):
    host = make_host(make_servo(start_deg=12.34), physics=Physics())
    readings = [int(host.ask("#5QD")[4:-1]) for _ in range(300)]
    assert min(readings) >= 122
    assert max(readings) <= 125
    assert len(set(readings)) >= 3
    assert sum(readings) / 3000 == pytest.approx(12.34, abs=0.02)


def test_voltage_sags_with_the_current_of_all(make_host, make_servo):
    resting = make_host(*(make_servo(number) for number in range(1, 11)))
    assert resting.ask("#1QV") == "*1QV11965|"  # 12 V - 10 * 70 mA * 50 mOhm
    resting.say("#254WD3000")
    resting.wait_s(1.0)
    assert resting.ask("#1QV") < "*1QV11920|"


def test_a_working_motor_warms_towards_what_its_current_makes_of_it(make_host, make_servo):
    host = make_host(make_servo(droop_deg=5.0))
    assert host.ask("#5QT") == "*5QT250|"
    host.say("#5D0")
    host.wait_s(300.0)
    tenths = int(host.ask("#5QT")[4:-1])
    assert tenths == pytest.approx(345, abs=1)  # 25 + 15 * 1 A² * (1 - 1/e)


@pytest.fixture
def pro_host(make_host, make_servo):
    """An LSS-PRO: positions in hundredths."""
    return make_host(make_servo(model=PRO), firmware=780)


@titled("dialogue", PRO_DIALOGUES)
def test_a_pro_answers(pro_host, dialogue):
    pro_host.talk(dialogue)


def test_a_newer_pro_has_fewer_states(make_host, make_servo, pro_host):
    assert pro_host.ask("#5Q") == "*5Q1|"
    pro_host.say("#5H")
    assert pro_host.ask("#5Q") == "*5Q5|"
    older = make_host(make_servo(model=PRO), firmware=779)
    older.say("#5H")
    assert older.ask("#5Q") == "*5Q6|"


@pytest.mark.parametrize(
    ("units", "speed_wire", "ramp_wire"),
    [(Units(), 9000, 5000), (Units(speed_deg_s=0.1, accel_deg_s2=10.0), 900, 5)],
)
def test_a_pro_keeps_the_speed_and_ramps_in_the_units_of_its_robot(
    make_host, make_servo, units, speed_wire, ramp_wire
):
    """90 deg in 90/90 s and 90/50 s of ramps, whatever the units are."""
    host = make_host(make_servo(model=with_units(SERVO_MODELS["LSS-P-S1"], units)), firmware=780)
    for line in (f"#5SD{speed_wire}", f"#5AA{ramp_wire}", f"#5AD{ramp_wire}", "#5H", "#5D36000"):
        host.say(line)
    host.wait_s(1.8)
    assert host.horn_deg() == pytest.approx(0.5 * 50 * 1.8**2, abs=2.5)
    host.wait_s(0.3)
    assert float(host.bus.motors.horn_deg_s(0, host.now_ns)) == pytest.approx(90.0, abs=0.1)


def test_the_readings_of_a_pro_scatter_by_hundredths(make_host, make_servo):
    def scatter(model, **line):
        host = make_host(make_servo(model=model), physics=Physics(), **line)
        values = [int(host.ask("#5QD")[4:-1]) / model.wire_per_deg for _ in range(40)]
        return max(values) - min(values)

    assert 0.01 <= scatter(PRO, firmware=780) <= 0.04
    assert scatter(SERVO_MODELS["LSS-ST1"]) == pytest.approx(0.2, abs=0.11)


def test_smaller_steps_leave_less_torque(make_host, make_servo):
    """A load of 5 deg at half steps pulls further at quarter steps, and less at full ones."""
    for mode, droop_deg in ((2, 5.0), (4, 5.0 / 0.8), (1, 5.0 * 0.8)):
        host = make_host(make_servo(model=PRO, droop_deg=5.0), firmware=780)
        host.say(f"#5SM{mode}")
        host.say("#5H")
        host.wait_s(2.0)
        level = math.cos(math.radians(host.horn_deg()))
        assert host.horn_deg() == pytest.approx(-droop_deg * level, abs=0.05)


@pytest.mark.parametrize("line", ["#5RESET", "#254RESET"])
def test_a_reset_of_the_pro_on_the_cable_drops_the_port(make_host, make_servo, line):
    host = make_host(make_servo(5, model=PRO), make_servo(6, model=PRO), firmware=780)
    host.say("#6RESET")
    assert host.bus.outages_ns() == []
    host.wait_s(2.0)
    host.say(line)
    host.wait_s(1.5)
    assert host.ask("#6QD") == ""
    host.wait_s(host.bus.motors.physics.usb_back_s)
    assert host.ask("#5Q") == "*5Q1|"


@pytest.mark.parametrize("family", [Family.LSS, Family.LSS_PRO])
def test_every_query_of_the_table_is_answered_in_its_shape(make_host, make_servo, family):
    model = ServoModel(name="LSS-X", family=family, speed_max_deg_s=180.0, wire_per_deg=10)
    host = make_host(make_servo(model=model), firmware=780)
    shapes = {
        ReplyShape.INTEGER: r"-?[0-9]+",
        ReplyShape.OPTIONAL: r"(-?[0-9]+)?",
        ReplyShape.DISABLED: r"DIS|-?[0-9]+",
        ReplyShape.VERSION: r"[0-9]+(\.[0-9]+)*",
        ReplyShape.TEXT: r".+",
    }
    asked = 0
    for row in FAMILY_TABLES[family].rows:
        for keyword in row.queries:
            reply = host.ask(f"#5{keyword}")
            assert re.fullmatch(rf"\*5{keyword}({shapes[row.reply_shape]})\|", reply), reply
            asked += 1
    assert asked > 30


def test_the_first_lss_pro_is_at_the_usb_cable_and_the_others_are_behind_it(make_host):
    pro = next(one for one in SERVO_MODELS.values() if one.family is Family.LSS_PRO)
    host = make_host(ServoSpec(servo_id=7, model=pro), ServoSpec(servo_id=8, model=pro))
    host.talk("#7QUC=1 #8QUC=0")
