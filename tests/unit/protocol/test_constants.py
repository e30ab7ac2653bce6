"""Codes of the bus."""

from __future__ import annotations

import pytest

from lss_motion.protocol.constants import Blink, Family, Led, SafeModeCause, Status, status_from


def test_the_documented_status_codes_are_0_to_10() -> None:
    for family, firmware in ((Family.LSS, 370), (Family.LSS_PRO, 779)):
        assert status_from(1, family, firmware) is Status.LIMP
        assert status_from(4, family, firmware) is Status.TRAVELING
        assert status_from(6, family, firmware) is Status.HOLDING
        assert status_from(10, family, firmware) is Status.SAFE_MODE


def test_newer_lss_pro_firmware_has_other_status_numbers() -> None:
    newer = [status_from(code, Family.LSS_PRO, 780) for code in range(7)]
    assert newer == [
        Status.UNKNOWN,
        Status.LIMP,
        Status.ACCELERATING,
        Status.TRAVELING,
        Status.DECELERATING,
        Status.HOLDING,
        Status.ERROR,
    ]


def test_an_lss_pro_without_an_answer_to_qf_is_taken_for_a_newer_one() -> None:
    """So one that holds with older firmware is shown as in error, and not the reverse."""
    assert status_from(5, Family.LSS_PRO, None) is Status.HOLDING
    assert status_from(6, Family.LSS_PRO, None) is Status.ERROR
    assert status_from(6, Family.LSS, None) is Status.HOLDING


@pytest.mark.parametrize("code", [-1, 11, 1000])
def test_a_status_code_that_does_not_exist_is_unknown(code: int) -> None:
    assert status_from(code, Family.LSS, 370) is Status.UNKNOWN


def test_colours_causes_and_blinking_match_the_documents() -> None:
    assert [led.name for led in Led] == [
        "OFF", "RED", "GREEN", "BLUE", "YELLOW", "CYAN", "MAGENTA", "WHITE",
    ]  # fmt: skip
    assert [led.value for led in Led] == list(range(8))
    assert [cause.value for cause in SafeModeCause] == [0, 1, 2, 3]
    assert Blink.ACCELERATING | Blink.DECELERATING == 12
    assert Blink.FREE | Blink.TRAVELING == 48
    assert sum(Blink) == 63
