"""Physical values ⇄ commands and replies."""

from __future__ import annotations

import math

import pytest

from lss_motion.errors import ProtocolError
from lss_motion.protocol.codec import (
    identify_reply,
    make_command,
    make_reply,
    read_command,
    read_reply,
    reply_number,
)
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import Command, CommandParser, Reply, encode
from lss_motion.protocol.table import Suffix, Unit

LSS, PRO, IO2 = Family.LSS, Family.LSS_PRO, Family.IO2


def test_each_family_has_its_own_unit_on_the_wire() -> None:
    assert make_command(LSS, 5, "D", 130.04) == Command(5, "D", 1300)
    assert make_command(PRO, 5, "D", 130.04) == Command(5, "D", 13004)
    assert make_command(LSS, 5, "WD", 90) == Command(5, "WD", 900)
    assert make_command(PRO, 5, "WD", 90) == Command(5, "WD", 90)
    assert make_command(LSS, 5, "AA", 300) == Command(5, "AA", 30)


def test_a_2io_receives_whole_degrees_and_replies_in_tenths() -> None:
    assert make_command(IO2, 209, "D", 44.6) == Command(209, "D", 450)
    assert make_reply(IO2, 209, "QD", 13.2) == Reply(209, "QD", 132)


def test_positions_are_rounded_and_not_cut() -> None:
    assert make_command(LSS, 5, "D", -0.06).value == -1
    assert make_command(LSS, 5, "D", 0.29).value == 3


def test_modifiers_follow_in_the_order_of_the_row() -> None:
    command = make_command(LSS, 5, "d", 180, {"CH": 0.4, "T": 2500})
    assert encode(command) == b"#5D1800T2500CH400\r"
    decoded = read_command(LSS, command)
    assert decoded is not None
    assert decoded.modifiers == {"T": 2500, "CH": 0.4}


@pytest.mark.parametrize(
    ("family", "keyword", "value", "modifiers", "message"),
    [
        (LSS, "D", None, {}, "D needs a value"),
        (LSS, "D", math.nan, {}, "D nan: allowed are"),
        (LSS, "D", math.inf, {}, "D inf: allowed are"),
        (LSS, "D", 1e12, {}, "214748364.7 deg"),
        (LSS, "D", 1, {"T": 0}, "T 0: allowed are 1 to"),
        (LSS, "D", 1, {"S": 5}, "allowed modifiers are T, SD, CH, CL"),
        (LSS, "L", 3, {}, "L takes no value, not 3"),
        (LSS, "L", None, {"T": 3}, "allowed modifiers are none"),
        (LSS, "QD", None, {"T": 3}, "QD takes no modifier"),
        (LSS, "CSD", 10, {"T": 3}, "CSD takes no modifier"),
        (LSS, "P", 499, {}, "P 499: allowed are 500 to 2500 us"),
        (LSS, "LED", 8, {}, "LED 8: allowed are 0 to 7"),
        (LSS, "LED", 1.5, {}, "LED 1.5: allowed are 0 to 7"),
        (LSS, "G", 0, {}, "G 0: allowed are -1, 1"),
        (LSS, "CB", 1234, {}, "CB 1234: allowed are 9600, .*921600 bps"),
        (LSS, "CID", 251, {}, "CID 251: allowed are 0 to 250"),
        (LSS, "AA", 1010, {}, "AA 1010: allowed are 10 to 1000 deg/s²"),
        (LSS, "QSD", 4, {}, "QSD with suffix 4: allowed are 0 .session value"),
        (LSS, "QD", math.nan, {}, "QD with suffix nan: allowed are none"),
        (LSS, "QDD", None, {}, "'QDD' is no LSS keyword; did you mean QD"),
        (LSS, "QID", 0.5, {}, "QID with suffix 0.5"),
        (PRO, "P", 1500, {}, "'P' is no LSS-PRO keyword"),
        (PRO, "CFD", 179.1, {}, "CFD 179.1: allowed are -179 to 179 deg"),
        (PRO, "SM", 3, {}, "SM 3: allowed are 1, 2, 4"),
        (IO2, "D", 90.6, {}, "D 90.6: allowed are -90 to 90 deg"),
        (IO2, "D", 10, {"T": 500}, "allowed modifiers are none"),
        (IO2, "CB", 921600, {}, "CB 921600: allowed are .*500000 bps"),
        (IO2, "CONFIRM", None, {}, "'CONFIRM' is no LSS-2IO keyword"),
    ],
)
def test_a_command_outside_the_table_is_refused_with_the_allowed_values(
    family: Family, keyword: str, value: float | None, modifiers: dict[str, float], message: str
) -> None:
    with pytest.raises(ProtocolError, match=message):
        make_command(family, 5, keyword, value, modifiers)


@pytest.mark.parametrize("servo_id", [-1, 256])
def test_an_id_outside_0_to_255_is_refused(servo_id: int) -> None:
    with pytest.raises(ProtocolError, match="allowed are 0 to 255"):
        make_command(LSS, servo_id, "L")


@pytest.mark.parametrize(
    ("keyword", "value", "modifiers", "since"),
    [
        ("D", 1, {"CH": 0.4}, 365),
        ("FPC", 3, {}, 368),
        ("CB", 921600, {}, 369),
        ("SLOT", 3, {}, 370),
        ("QID", 120, {}, 370),
    ],
)
def test_a_command_of_newer_firmware_is_refused_for_older_firmware(
    keyword: str, value: float, modifiers: dict[str, float], since: int
) -> None:
    command = make_command(LSS, 5, keyword, value, modifiers, firmware=since)
    assert command.keyword == keyword
    with pytest.raises(ProtocolError, match=f"needs firmware {since} or newer"):
        make_command(LSS, 5, keyword, value, modifiers, firmware=since - 1)


def test_a_query_keeps_its_suffix_and_its_meaning() -> None:
    decoded = read_command(LSS, make_command(LSS, 5, "QSD", 2))
    assert decoded is not None
    assert (decoded.value, decoded.suffix) == (2, Suffix.INSTANTANEOUS)


def test_keywords_of_another_family_are_read_as_none() -> None:
    assert read_command(LSS, Command(5, "PD", 1443)) is None
    assert read_command(LSS, Command(5, "D", 1443, (("ZZ", 1),))) is None
    assert read_command(PRO, Command(5, "P", 1500)) is None
    assert read_reply(PRO, Reply(5, "QV", 11200)) is None
    assert read_reply(LSS, Reply(5, "AR", 1800)) is None
    assert read_reply(LSS, Reply(5, "D", 1800)) is None
    assert reply_number(PRO, Reply(5, "QV", 11200)) is None
    assert reply_number(LSS, Reply(5, "D", 1800)) is None


def test_a_2io_ignores_modifiers() -> None:
    decoded = read_command(IO2, Command(209, "D", 450, (("T", 500),)))
    assert decoded is not None
    assert (decoded.value, decoded.modifiers) == (45.0, {})


def test_a_first_position_that_is_not_set_is_none() -> None:
    assert make_reply(LSS, 5, "QFD") == Reply(5, "QFD", "DIS")
    decoded = read_reply(LSS, Reply(5, "QFD", "DIS"))
    assert decoded is not None
    assert decoded.value is None
    assert encode(make_command(LSS, 5, "CFD")) == b"#5CFD\r"


def test_an_empty_target_is_a_valid_reply_of_lss_but_not_of_lss_pro() -> None:
    decoded = read_reply(LSS, Reply(5, "QDT"))
    assert decoded is not None
    assert decoded.value is None
    assert read_reply(PRO, Reply(5, "QDT")) is None
    with pytest.raises(ProtocolError, match="QDT answers integer"):
        make_reply(PRO, 5, "QDT")


@pytest.mark.parametrize(
    ("reply", "value"),
    [
        (Reply(5, "QF", 368), 368),
        (Reply(5, "QF", "368.29.14"), "368.29.14"),
        (Reply(5, "QN", "0012"), "0012"),
        (Reply(5, "QMS", "LSS-ST1"), "LSS-ST1"),
        (Reply(5, "QV", 11200), 11.2),
        (Reply(5, "QP", -2500), -2500),
    ],
)
def test_replies_have_the_shape_of_their_row(reply: Reply, value: float | str) -> None:
    decoded = read_reply(LSS, reply)
    assert decoded is not None
    assert decoded.value == value
    assert make_reply(LSS, 5, reply.keyword, value) == reply


@pytest.mark.parametrize(
    "reply",
    [
        Reply(5, "QD"),
        Reply(5, "QD", "14x"),
        Reply(5, "QDT", "DIS"),
        Reply(5, "QFD", "DI"),
        Reply(5, "QF", "36a"),
        Reply(5, "QMS"),
    ],
)
def test_a_reply_of_another_shape_is_neither_read_nor_made(reply: Reply) -> None:
    assert read_reply(LSS, reply) is None
    if reply.keyword != "QFD":
        with pytest.raises(ProtocolError, match=f"{reply.keyword} answers"):
            make_reply(LSS, 5, reply.keyword, reply.value)


def test_only_queries_have_replies() -> None:
    with pytest.raises(ProtocolError, match="D is no query of LSS"):
        make_reply(LSS, 5, "D", 10.0)


def test_the_suffix_of_the_query_gives_a_distance_its_unit() -> None:
    raw = read_reply(IO2, Reply(203, "QA", 50))
    distance = read_reply(IO2, Reply(203, "QA", 50), suffix=1)
    assert raw is not None
    assert distance is not None
    assert (raw.unit, raw.suffix) == (Unit.NONE, None)
    assert (distance.unit, distance.suffix) == (Unit.MM, Suffix.GP2Y0A41SK0F)


@pytest.mark.parametrize("reply", [Reply(None, "QID", 5), Reply(254, "QID", 5), Reply(5, "QID", 5)])
@pytest.mark.parametrize("family", [LSS, PRO])
def test_the_id_of_every_reply_to_qid_is_its_value(family: Family, reply: Reply) -> None:
    decoded = read_reply(family, reply)
    assert decoded is not None
    assert decoded.servo_id == 5


def test_the_reply_to_a_broadcast_qid_depends_on_family_and_firmware() -> None:
    assert identify_reply(LSS, 5, 254, firmware=368) == Reply(None, "QID", 5)
    assert identify_reply(LSS, 5, 254, firmware=370) == Reply(5, "QID", 5)
    assert identify_reply(PRO, 5, 254, firmware=780) == Reply(254, "QID", 5)
    assert identify_reply(LSS, 5, 5, firmware=368) == Reply(5, "QID", 5)
    with pytest.raises(ProtocolError, match="2IO"):
        identify_reply(IO2, 207, 254, firmware=0)


def test_text_after_crc_is_read_as_text() -> None:
    (command,) = CommandParser().feed(b"#5CRC*\r")
    assert isinstance(command, Command)
    decoded = read_command(LSS, command)
    assert decoded is not None
    assert decoded.value == "*"


def test_the_highest_id_is_allowed() -> None:
    assert make_command(LSS, 255, "H") == Command(255, "H")


@pytest.mark.parametrize("delay_us", [0, 1, 250])
def test_the_reply_delay_is_any_whole_number_from_0(delay_us: int) -> None:
    assert make_command(LSS, 254, "QID", delay_us, firmware=370) == Command(254, "QID", delay_us)


def test_an_unknown_suffix_is_refused_with_the_known_ones() -> None:
    assert make_command(LSS, 5, "QSD", 1) == Command(5, "QSD", 1)
    with pytest.raises(ProtocolError, match=r"are 0 \(session value\), 1 \(configured value\), "):
        make_command(LSS, 5, "QSD", 9)


def test_a_query_has_no_unit_and_an_action_has_the_unit_of_its_row() -> None:
    query, action = (read_command(LSS, Command(5, keyword, 1)) for keyword in ("QSD", "SD"))
    assert query is not None
    assert action is not None
    assert (query.unit, query.value) == (Unit.NONE, 1)
    assert action.unit is action.row.unit is not Unit.NONE
