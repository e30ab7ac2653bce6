import math
import re

import pytest

from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import Family
from lss_motion.protocol.lss_pro import Units
from lss_motion.protocol.table import ReplyShape
from lss_motion.robot.model import ServoModel
from lss_motion.robot.servo_models import SERVO_MODELS, with_units
from lss_motion.sim.physics import Physics

SETTINGS = [
    ("O", -24, 100), ("AR", 1200, 3600), ("SD", 900, 1800), ("SR", 12, 30), ("LED", 3, 5),
    ("G", -1, 1), ("AS", -4, 2), ("AH", 3, -2), ("AA", 30, 60), ("AD", 40, 70), ("EM", 0, 1),
    ("FPC", 3, 10),
]  # fmt: skip


PRO = SERVO_MODELS["LSS-P-S1"]


@pytest.mark.parametrize(("name", "configured", "session"), SETTINGS)
def test_every_setting_is_kept_for_the_session_or_for_ever(host, name, configured, session):
    host.say(f"#5C{name}{configured}")
    assert host.ask(f"#5Q{name}") == f"*5Q{name}{configured}|"
    host.say(f"#5{name}{session}")
    assert host.ask(f"#5Q{name}") == f"*5Q{name}{session}|"
    assert host.ask(f"#5Q{name}1") == f"*5Q{name}{configured}|"
    host.say("#5RESET")
    host.wait_s(1.3)
    assert host.ask(f"#5Q{name}") == f"*5Q{name}{configured}|"


def test_rpm_and_degrees_are_the_same_speed(host):
    host.say("#5SR20")
    assert host.ask("#5QSD") == "*5QSD1200|"
    host.say("#5SD600")
    assert host.ask("#5QSR") == "*5QSR10|"


def test_no_speed_is_set_above_the_models(host):
    host.say("#5SD9999")
    assert host.ask("#5QSD") == "*5QSD3600|"


def test_the_speed_suffixes_answer_session_config_present_and_target(host):
    host.say("#5CSD1800")
    host.say("#5SD900")
    host.say("#5D3000T10000")
    host.wait_s(1.0)
    answers = [host.ask(f"#5QSD{suffix}") for suffix in ("", 0, 1, 2, 3)]
    assert answers == ["*5QSD900|", "*5QSD900|", "*5QSD1800|", "*5QSD300|", "*5QSD300|"]


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


def test_reset_forgets_the_turns(host):
    host.say("#5D4800")
    host.wait_s(3.0)
    assert host.ask("#5QD") == "*5QD4800|"
    host.say("#5RS")
    host.wait_s(1.3)
    assert host.ask("#5QD") == "*5QD1200|"


def test_an_id_takes_effect_after_reset(host):
    host.say("#5CID9")
    assert host.ask("#9QG") == ""
    host.say("#5RESET")
    host.wait_s(1.3)
    assert host.ask("#9QID") == "*9QID9|"
    assert host.ask("#5QID") == ""


def test_a_rate_is_answered_at_once_and_taken_after_reset(host):
    host.say("#5CB9600")
    assert host.ask("#5QB") == "*5QB9600|"
    host.say("#5RESET")
    host.wait_s(1.3)
    assert host.ask("#5QB") == ""


def test_a_rate_that_the_firmware_does_not_know_is_not_taken(make_host):
    host = make_host(firmware=368)
    host.say("#5CB921600")
    assert host.ask("#5QB") == "*5QB115200|"


def test_the_first_position_is_taken_after_reset(host):
    assert host.ask("#5QFD") == "*5QFDDIS|"
    host.say("#5CFD300")
    assert host.ask("#5QFD") == "*5QFD300|"
    host.say("#5RESET")
    host.wait_s(2.5)
    assert host.ask("#5QD") == "*5QD300|"
    assert host.ask("#5Q") == "*5Q6|"
    host.say("#5CFD")
    assert host.ask("#5QFD") == "*5QFDDIS|"


def test_the_two_first_positions_overwrite_each_other(host):
    host.say("#5CFD300")
    host.say("#5CFP1600")
    assert [host.ask("#5QFD"), host.ask("#5QFP")] == ["*5QFDDIS|", "*5QFP1600|"]
    host.say("#5RESET")
    host.wait_s(2.0)
    assert host.ask("#5Q") == "*5Q1|"


def test_a_new_maximum_speed_counts_from_the_next_move_on(host):
    for speed in (900, 300):
        host.say(f"#5SD{speed}")
        host.say("#5D3000")
        assert host.ask("#5QSD3") == f"*5QSD{speed}|"


def test_default_needs_confirm_at_once(host):
    host.say("#5CLED3")
    host.say("#5DEFAULT")
    assert host.ask("#5QG") == "*5QG1|"
    host.say("#5CONFIRM")
    assert host.ask("#5QLED1") == "*5QLED3|"
    host.say("#5DEFAULT")
    host.say("#5CONFIRM")
    assert host.ask("#0QG") == ""
    host.wait_s(1.3)
    assert host.ask("#5QG") == "", "all values are reset, and the id is one of them"
    assert host.ask("#0QLED1") == "*0QLED7|"


def test_rc_mode_is_deaf_after_reset(host):
    host.say("#5CRC1")
    assert host.ask("#5QG") == "*5QG1|"
    host.say("#5RESET")
    host.wait_s(25.0)
    assert host.ask("#5QG") == ""


def test_in_rc_mode_the_first_position_is_not_taken(host):
    for line in ("#5CFD300", "#5CRC1", "#5RESET"):
        host.say(line)
    host.wait_s(3.0)
    assert host.horn_deg() == 0.0


def test_crc_with_any_other_value_stays_in_smart_mode(host):
    host.say("#5CRC1")
    host.say("#5CRC*")
    host.say("#5RESET")
    host.wait_s(1.3)
    assert host.ask("#5QG") == "*5QG1|"


def test_a_relative_move_starts_from_where_the_horn_is(host):
    host.say("#5D300")
    host.wait_s(1.0)
    host.say("#5MD123")
    host.wait_s(1.0)
    assert host.ask("#5QD") == "*5QD423|"


def test_pulses_span_the_angular_range_and_are_clamped(host):
    host.say("#5P2334")
    host.wait_s(2.0)
    assert host.ask("#5QD") == "*5QD751|"
    assert host.ask("#5QP") == "*5QP2334|"
    host.say("#5P9999")
    host.wait_s(2.0)
    assert host.ask("#5QD") == "*5QD900|"
    for angle, answer in ((1200, "*5QP-2500|"), (-1200, "*5QP-500|")):
        host.say(f"#5D{angle}")
        host.wait_s(2.0)
        assert host.ask("#5QP") == answer


def test_the_speed_modifiers_set_the_travel_speed(host):
    host.say("#5D1800SD200")
    assert host.ask("#5QSD3") == "*5QSD200|"
    host.say("#5P500S100")
    assert host.ask("#5QSD3") == "*5QSD90|"  # 100 us/s of 2000 us over 180 degrees


def test_a_modifier_that_does_not_belong_does_nothing(host):
    host.say("#5D1800S100")
    assert host.ask("#5QSD3") == "*5QSD3600|"


def test_a_turned_gyre_turns_speeds_too(host):
    host.say("#5G-1")
    host.say("#5WD600")
    host.wait_s(1.0)
    assert host.horn_deg() < -50.0
    assert host.ask("#5QWD") == "*5QWD600|"


def test_gyre_and_origin_turn_and_shift_what_the_host_sees(host):
    host.say("#5D300")
    host.wait_s(1.0)
    host.say("#5G-1")
    assert host.ask("#5QD") == "*5QD-300|"
    host.say("#5O100")
    assert host.ask("#5QD") == "*5QD-200|"
    host.say("#5D0")
    host.wait_s(1.0)
    assert host.ask("#5QD") == "*5QD0|"
    host.say("#5G1")
    host.say("#5O0")
    assert host.ask("#5QD") == "*5QD100|"


def test_software_limits_bound_every_target(host):
    for line in ("#5CLP200", "#5CLN-100", "#5CLE1", "#5D900"):
        host.say(line)
    host.wait_s(1.0)
    assert host.ask("#5QD") == "*5QD200|"


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


def test_a_pro_counts_hundredths(pro_host):
    pro_host.say("#5D4567T500")
    pro_host.wait_s(2.0)
    assert pro_host.horn_deg() == pytest.approx(45.67, abs=1e-3)
    assert pro_host.ask("#5QD") == "*5QD4567|"


def test_a_pro_names_its_id_its_own_way(pro_host):
    assert pro_host.ask("#254QID") == "*254QID5|"
    assert pro_host.ask("#5QMS") == "*5QMSLSS-P-S1|"


def test_a_pro_without_a_target_answers_the_last_one(pro_host):
    assert pro_host.ask("#5QDT") == "*5QDT0|"
    pro_host.say("#5D3000")
    assert pro_host.ask("#5QDT") == "*5QDT3000|"
    pro_host.say("#5L")
    assert pro_host.ask("#5QDT") == "*5QDT3000|"


def test_a_newer_pro_has_fewer_states(make_host, make_servo, pro_host):
    assert pro_host.ask("#5Q") == "*5Q1|"
    pro_host.say("#5H")
    assert pro_host.ask("#5Q") == "*5Q5|"
    older = make_host(make_servo(model=PRO), firmware=779)
    older.say("#5H")
    assert older.ask("#5Q") == "*5Q6|"


def test_a_pro_measures_its_speed_in_hundredths(pro_host):
    pro_host.say("#5WD30")
    pro_host.wait_s(1.0)
    assert [pro_host.ask(f"#5{word}") for word in ("QCS", "QWD", "QSD2")] == [
        "*5QCS3000|",
        "*5QWD30|",
        "*5QSD3000|",
    ]
    pro_host.say("#5WD-30")
    pro_host.wait_s(1.0)
    assert pro_host.ask("#5QCS") == "*5QCS-3000|"


def test_a_pro_blinks_as_it_is_configured(pro_host):
    assert pro_host.ask("#5QLB") == "*5QLB0|"
    pro_host.say("#5CLB12")
    assert pro_host.ask("#5QLB") == "*5QLB12|"


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
