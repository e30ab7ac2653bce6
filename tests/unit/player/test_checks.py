from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.playing.player import checks, handshake
from lss_motion.protocol.constants import Status
from lss_motion.protocol.framing import encode
from lss_motion.robot.model import Bus
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.robot.servo_models import SERVO_MODELS

ANSWERS = {
    "QMS": "LSS-ST1",
    "QF": 370,
    "Q": 1,
    "QSD": 3600,
    "QAA": 100,
    "QAD": 100,
    "QEM": 1,
    "QG": 1,
    "QO": 0,
    "QAR": 1800,
}


def answers(servo_id=1, **changed):
    values = {**ANSWERS, "QD": 0, **changed}
    return {("main", servo_id, key): value for key, value in values.items() if value != "silent"}


def sent(items):
    return [encode(item.command) for item in items]


def test_good_answers_raise_nothing_and_warn_of_nothing(kit):
    assert checks.check_answers([kit.joint()], answers(), kit.robot()) == []


@pytest.mark.parametrize("said", ["silent", None, "DIS"])
def test_a_servo_that_does_not_report_its_position_counts_as_silent(kit, said):
    with pytest.raises(BusError, match=r"j0 \(id 1 on bus 'main'\)"):
        checks.check_answers([kit.joint()], answers(QD=said), kit.robot())


def test_a_servo_that_answers_little_but_its_place_is_driven_and_given_its_limits(kit):
    known = answers(**dict.fromkeys(ANSWERS, "silent"))
    (warning,) = checks.check_answers([kit.joint()], known, kit.robot())
    assert "servo 1 does not report its G and O, so they were not compared" in warning
    assert handshake.session_orders([kit.joint()], known) == []
    limits = [b"#1EM1\r", b"#1AA60\r", b"#1AD60\r", b"#1SD1800\r"]
    assert sent(handshake.unconfirmed_orders([kit.joint()], known)) == limits
    assert handshake.unconfirmed_orders([kit.joint()], answers()) == []
    assert handshake.restoring_orders([kit.joint()], known) == []


def test_the_settings_of_the_file_are_queried_too(kit):
    one = kit.joint(settings={"AS": -2, "AH": 3})
    assert {b"#1QAS\r", b"#1QAH\r", b"#1QD\r"} <= set(sent(checks.queries([one])))


@pytest.mark.parametrize("drive", ["timed", "streamed", "stepped"])
def test_the_first_question_is_one_that_all_documents_have(kit, drive):
    """By it a servo counts as silent: QFPC is nothing that an old firmware knows."""
    model = SERVO_MODELS["LSS-2IO" if drive == "stepped" else "LSS-ST1"]
    asked = sent(checks.queries([kit.joint(model=model, drive=drive, settings={"AS": -2})]))
    assert asked[0] == b"#1QMS\r"
    assert asked[-1] == b"#1QAS\r"
    assert len(set(asked)) == len(asked) > 3


def test_a_servo_of_another_model_is_refused_at_the_line_that_names_the_model(kit):
    robot = replace(kit.robot(one := kit.joint(lines={"model": 7})), path=Path("arm.yaml"))
    with pytest.raises(InputError, match=r"^arm.yaml:7: joint 'j0': servo 1 is an LSS-HT1"):
        checks.check_answers([one], answers(QMS="LSS-HT1"), robot)


@pytest.mark.parametrize(("wire", "is_said"), [(-905, False), (905, False), (1201, True)])
def test_a_joint_outside_of_its_range_is_named_with_angle_and_range(kit, wire, is_said):
    one = kit.joint(position_min_deg=-90.0, position_max_deg=90.0, direction=-1)
    texts = checks.check_range([one], answers(QD=wire))
    assert [text.partition(", and")[0] for text in texts] == [
        "joint 'j0' stands at -120.1 deg, outside of its range of -90 to 90 deg"
    ] * is_said


def test_a_limp_servo_is_reported_before_it_moves(kit):
    one = kit.joint()
    said = [
        checks.found([one], answers(Q=code), {"j0": 0.0})[0].status for code in (1, 6, "silent")
    ]
    assert said == ["limp", "holding", None]


@pytest.mark.parametrize(
    ("said", "words", "mend"),
    [
        ({"QG": 1}, "has gyre (G) 1, the robot file says -1", "--set G=-1. If the servo"),
        ({"QO": 0}, "has origin (O) 0 deg, the robot file says 5 deg", "--set O=5. If"),
        ({"QAR": 3600}, "has angular range (AR) 360 deg, the robot file says 180", "--set AR=180"),
        ({"QG": 1, "QO": 0}, "1, the robot file says -1: it would", "`stored: {G: 1, O: 0}`"),
    ],
)
def test_a_servo_with_another_frame_than_the_file_states_is_refused(kit, said, words, mend):
    one = kit.joint(stored={"G": -1.0, "O": 5.0}, lines={"stored.G": 4, "stored.O": 4, "id": 3})
    robot = replace(kit.robot(one), path=Path("arm.yaml"))
    right = {"QG": -1, "QO": 50}
    assert checks.check_answers([one], answers(**right), robot) == []
    with pytest.raises(InputError) as refused:
        checks.check_answers([one], answers(**{**right, **said}), robot)
    assert str(refused.value).startswith("arm.yaml:")
    assert words in str(refused.value)
    assert "lss-motion configure arm.yaml --joint j0 --set " in str(refused.value)
    assert mend in str(refused.value)
    (warning,) = checks.check_answers([one], answers(**{**right, **said}), robot, needs_frame=False)
    assert words in warning


def test_a_frame_that_the_file_does_not_state_is_that_of_the_factory(kit):
    with pytest.raises(InputError, match=r"gyre .G. -1, the robot file says 1"):
        checks.check_answers([kit.joint()], answers(QG=-1), kit.robot())
    pro = kit.joint(model=SERVO_MODELS["LSS-P-S1"])
    with pytest.raises(InputError, match=r"origin .O. -30 deg, the robot file says 0 deg"):
        checks.check_answers([pro], answers(QMS="LSS-P-S1", QO=-300), kit.robot(pro))


@pytest.mark.parametrize("said", [{"QSD": 1800}, {"QAA": 100}, {"QAR": 18000}])
def test_an_lss_pro_that_may_count_in_other_units_is_not_to_be_configured(kit, said):
    right = {"QMS": "LSS-P-S1", "QSD": 18000, "QAA": 100_000, "QAD": 100_000, "QAR": 1800}
    pro = kit.joint(model=SERVO_MODELS["LSS-P-S1"])
    checks.check_answers([pro], answers(**right), kit.robot(pro))
    with pytest.raises(InputError, match="may count in other units: then leave it as it is, write"):
        checks.check_answers([pro], answers(**{**right, **said}), kit.robot(pro))
    with pytest.raises(InputError) as refused:
        checks.check_answers([kit.joint()], answers(QSD=900, QAR=3600), kit.robot())
    assert "units" not in str(refused.value)


def test_a_frame_that_lasts_until_a_restart_is_mended_by_one(kit):
    stored = {("main", 1, "QG"): 1}
    with pytest.raises(InputError, match=r"It has that until it restarts: .* --id 1 RESET"):
        checks.check_answers([kit.joint()], answers(QG=-1), kit.robot(), stored=stored)
    stored = {("main", 1, "QG"): -1}
    with pytest.raises(InputError, match="with which it would restart: gyre"):
        checks.check_answers([kit.joint()], answers(), kit.robot(), stored=stored)


def test_all_that_is_wrong_stands_in_one_error(kit):
    joints = [kit.joint(), kit.joint("j1", 2)]
    said = {**answers(1, QG=-1), **answers(2, QSD=900)}
    with pytest.raises(InputError) as refused:
        checks.check_answers(joints, said, kit.robot(*joints))
    assert "gyre" in str(refused.value)
    assert "requires 180 deg/s, but servo 2 is set to 90 deg/s" in str(refused.value)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"QV": 12000}, "has 12.0 V, needed are 13 V (voltage_min_v)"),
        ({"QT": 801}, "is hot: 80 C, allowed is 75 C (temperature_max_c)"),
    ],
)
def test_a_shown_value_beyond_its_limit_is_judged_by_on_fault(kit, said, words):
    one = kit.joint(voltage_min_v=13.0)
    assert words in " ".join(checks.check_answers([one], answers(**said), kit.robot(one)))
    hold = dict.fromkeys((Cause.LOW_VOLTAGE, Cause.HOT), (FaultStep.WARN, FaultStep.HOLD))
    with pytest.raises(PlaybackError) as refused:
        checks.check_answers([one], answers(**said), kit.robot(one), show=hold)
    assert words in str(refused.value)
    assert "Nothing moves" in str(refused.value)


@pytest.mark.parametrize(("code", "word"), [(8, "stuck"), (9, "blocked"), (10, "safe mode")])
def test_a_servo_that_cannot_move_is_refused(kit, code, word):
    with pytest.raises(PlaybackError, match=word):
        checks.check_answers([kit.joint()], answers(Q=code), kit.robot())


@pytest.mark.parametrize("code", [2, 3, 4, 5])
def test_a_servo_that_moves_already_is_refused(kit, code):
    with pytest.raises(PlaybackError, match=r"servo 1 moves already .* `lss-motion send --id 1 H`"):
        checks.check_answers([kit.joint()], answers(Q=code), kit.robot())


def test_the_status_of_a_servo_is_read_by_its_own_firmware(kit):
    """Code 5 of an LSS-PRO is `decelerating` in old firmware, and `holding` in a new one."""
    pro = kit.joint(model=SERVO_MODELS["LSS-P-S1"])
    said = answers(QMS="LSS-P-S1", QF=800, Q=5)
    assert checks.status_of(pro, said) is Status.HOLDING
    said = answers(QMS="LSS-P-S1", QF=700, Q=5)
    assert checks.status_of(pro, said) is Status.DECELERATING


def test_stored_settings_are_read_with_the_suffix_of_the_documents(kit):
    asked = set(sent(checks.stored_queries([kit.joint()])))
    assert asked == {b"#1QG1\r", b"#1QO1\r", b"#1QAR1\r", b"#1QSD1\r", b"#1QAA1\r",
                     b"#1QAD1\r", b"#1QEM1\r"}  # fmt: skip
    board = kit.joint(model=SERVO_MODELS["LSS-2IO"], drive="stepped")
    assert checks.stored_queries([board]) == []


FACTORY = {"QSD": 3600, "QAA": 100, "QAD": 100, "QEM": 1}
"""What a servo stores that was never configured."""


def stored(servo_id=1, **changed):
    return {("main", servo_id, key): value for key, value in {**FACTORY, **changed}.items()}


def test_limits_are_stored_as_the_joint_has_them(kit):
    assert checks.stored_limits(kit.joint()) == {"SD": 1800, "AA": 60, "AD": 60, "EM": 1}
    streamed = kit.joint(drive="streamed")
    assert checks.stored_limits(streamed) == {"SD": 1800, "AA": 60, "AD": 60}
    board = kit.joint(model=SERVO_MODELS["LSS-2IO"], drive="stepped")
    assert checks.stored_limits(board) == {}


def test_a_servo_that_stores_higher_limits_is_named_with_them(kit):
    one = kit.joint()
    (text,) = checks.stored_excesses([one], stored(QAA=40))
    assert text == (
        "j0 (servo 1): speed 360 deg/s (SD), the joint allows 180; "
        "deceleration 1000 deg/s² (AD), the joint allows 600"
    )
    assert checks.stored_excesses([one], stored(QSD=1800, QAA=60, QAD=9)) == []
    (text,) = checks.stored_excesses([one], stored(QSD=1800, QAA=60, QAD=9, QEM=0))
    assert "EM 0 (no ramps)" in text
    (text,) = checks.stored_excesses([one], {})
    assert "SD unknown" in text


def real(kit, *joints):
    return replace(kit.robot(*joints), buses={"main": replace(kit.bus, port="/dev/ttyUSB0")})


def test_without_feedback_a_robot_that_would_restart_too_fast_is_refused(kit):
    one = kit.joint()
    judge = partial(checks.check_stored_limits, [one], stored())
    with pytest.raises(InputError, match=r"nothing notices .* j0 .*--limits.*--force"):
        judge(real(kit, one), has_feedback=False, is_forced=False)
    (warning,), notes = judge(real(kit, one), has_feedback=False, is_forced=True)
    assert "--force: played all the same" in warning
    assert notes == []
    (warning,), _ = judge(kit.robot(one), has_feedback=False, is_forced=False)
    assert "simulated: played all the same" in warning
    warnings, (note,) = judge(real(kit, one), has_feedback=True, is_forced=False)
    assert warnings == []
    assert "until that is noticed" in note
    low = stored(QSD=1800, QAA=60, QAD=60)
    for has_feedback in (True, False):
        assert checks.check_stored_limits(
            [one], low, real(kit, one), has_feedback=has_feedback, is_forced=False
        ) == ([], [])


@pytest.mark.parametrize(("wire", "is_refused"), [(-2699, False), (-2700, True), (15000, True)])
def test_a_joint_half_a_turn_outside_of_its_range_is_not_driven_back(kit, wire, is_refused):
    one = kit.joint(position_min_deg=-90.0, position_max_deg=90.0)
    if not is_refused:
        assert len(checks.check_range([one], answers(QD=wire))) == 1
        return
    with pytest.raises(PlaybackError, match="half a turn or more outside of its range"):
        checks.check_range([one], answers(QD=wire))


@pytest.mark.parametrize(("port", "device"), [("/dev/ttyUSB3", "ttyUSB3"), ("sim://", "ttyUSB0")])
def test_an_adapter_that_holds_replies_back_is_told_with_a_path_that_can_be_typed(port, device):
    slow = SimpleNamespace(shortest_latency_ns=5_000_000)
    [warning] = checks.check_latency(
        {"main": Bus(name="main", port=port, baud_bps=115_200, firmware=370)}, {"main": slow}
    )
    assert f"port {port}: answers come 5 ms late" in warning
    assert f"/sys/bus/usb-serial/devices/{device}/latency_timer`" in warning
