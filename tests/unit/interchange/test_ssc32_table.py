"""SSC-32 tables: times of pins, and errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.reader import RefusedMotion
from lss_motion.interchange.step_tables import SSC32_TABLE


def ssc32(*rows: str) -> str:
    return "PROJECT;SEQUENCE;STEP;PIN0;PIN1;PIN2;T0;T1;T2;TMAX;INFO1\n" + "\n".join(rows) + "\n"


def test_ssc32_pins_have_their_own_times_and_wait_for_each_other(read_one) -> None:
    text = ssc32("Wave;1;1;0;10;-90;1000;500;1000;", "Wave;1;2;0;20,5;90;1000;1000;250;")
    motion = read_one(SSC32_TABLE, text)
    first, second = motion.channels
    assert (first.name, second.name) == ("PIN1", "PIN2")
    assert first.times_s.tolist() == [0.5, 1.0, 2.0]
    assert first.values.tolist() == [10.0, 10.0, 20.5]
    assert second.times_s.tolist() == [1.0, 1.25, 2.0]
    assert "Not carried over: PIN0, which stay at 0" in motion.comments


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (ssc32("Wave;1;1;0;10;-90;1000"), 2, "7 fields, at least 9 are needed"),
        (ssc32("Wave;1;1;0;x;-90;1000;500;1000"), None, ""),
        (ssc32(), 1, "has no step"),
        (ssc32("a").replace(";T2", ""), 1, "column T2 is missing"),
    ],
)
def test_a_wrong_ssc32_row_is_refused_with_its_line(text, line, reason) -> None:
    if reason:
        with pytest.raises(InputError) as caught:
            SSC32_TABLE.motions(Path("m"), text.encode())
        assert (caught.value.line, reason in caught.value.reason) == (line, True)
    else:
        (bad,) = SSC32_TABLE.motions(Path("m"), text.encode())
        assert isinstance(bad, RefusedMotion)
        assert str(bad.error) == "m:2: 'x' is not a number"


def test_a_table_without_names_is_named_after_its_file() -> None:
    motions = SSC32_TABLE.motions(Path("wave.csv"), ssc32(";;1;9;9;9;5;5;5").encode())
    assert [motion.name for motion in motions] == ["wave"]
    (bad,) = SSC32_TABLE.motions(Path("wave.csv"), ssc32(";;1;x;9;9;5;5;5").encode())
    assert (bad.name, isinstance(bad, RefusedMotion)) == ("wave", True)
