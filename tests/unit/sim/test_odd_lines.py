"""Lines that programs send and no document describes are named, and read as assumed."""

from __future__ import annotations

import pytest

from lss_motion.sim.odd_lines import DECIMAL, ID, OTHER, SPACE, VALUE, OddLines
from lss_motion.sim.physics import Physics

ODD = {
    b"#1 D500 SD600": ([SPACE], b"#1D500SD600"),
    b"# 1D500": ([SPACE], b"#1D500"),
    b"#1D100.0": ([DECIMAL], b"#1D100"),
    b"#1SR3.3333": ([DECIMAL], b"#1SR3"),
    b"#1D-12.5T300": ([DECIMAL], b"#1D-12T300"),
    b"#1D -12.5": ([SPACE, DECIMAL], b"#1D-12"),
    b"#254CO": ([VALUE], b"#254CO0"),
    b"#3CGM": ([VALUE], b"#3CGM0"),
    b"#3co#4QD#5 CO": ([SPACE, VALUE], b"#3co0#4QD#5CO0"),
    b"#1D500#2 D300": ([SPACE], b"#1D500#2D300"),
    b"#1D500#2D30.0T500": ([DECIMAL], b"#1D500#2D30T500"),
    b"#1D500#D300": ([OTHER], b"#1D500#D300"),
    b"#255D0": ([ID], b"#254D0"),
    b"#255QID": ([ID], b"#254QID"),
    b"D500": ([OTHER], b"D500"),
}
USUAL = (b"#1D500SD600", b"#254QID", b"#1QD", b"#5d-100t250", b"#1D100#2D200", b"", b"#1CFD", b"#")


@pytest.mark.parametrize("line", ODD)
@pytest.mark.parametrize("lines", ["strict", "lenient"])
def test_an_odd_line_is_counted_named_once_and_read_as_assumed(line, lines):
    kinds, meant = ODD[line]
    odd = OddLines(lines, is_grouped=True)
    assert [odd.read(line + b"\r") for _ in range(2)] == 2 * [
        (meant if lines == "lenient" else line) + b"\r"
    ]
    assert dict(odd.counts) == dict.fromkeys(kinds, 2)
    texts = odd.take_texts()
    assert len(texts) == len(kinds)
    assert all(line.decode() in text for text in texts)
    assert odd.take_texts() == []


@pytest.mark.parametrize("line", USUAL)
def test_a_line_that_documents_describe_is_not_odd(line):
    odd = OddLines("lenient", is_grouped=True)
    assert (odd.read(line + b"\r"), odd.summary()) == (line + b"\r", "")


@pytest.mark.parametrize(("lines", "target"), [("strict", 0), ("lenient", 500)])
def test_a_servo_obeys_an_odd_line_only_if_that_is_assumed(make_host, make_servo, lines, target):
    host = make_host(make_servo(1), physics=Physics(noise_deg=0.0, lines=lines))
    host.say("#1D0")
    host.say("#1 D500 SD600")
    assert host.ask("#1QDT") == f"*1QDT{target}|"
    assert host.bus.odd_lines.summary() == "1 with spaces"


@pytest.mark.parametrize(("lines", "origin"), [("strict", 30), ("lenient", 0)])
def test_a_setting_without_its_value_is_0_where_servos_are_lenient(
    make_host, make_servo, lines, origin
):
    host = make_host(make_servo(1), physics=Physics(noise_deg=0.0, lines=lines))
    host.say("#1CO30")
    host.say("#254CO")
    assert host.ask("#1QO") == f"*1QO{origin}|"
    host.say("#1CG")
    assert host.ask("#1QG") == "*1QG1|", "0 is no gyre"
    (text,) = host.bus.odd_lines.take_texts()
    assert ("is taken with 0" if lines == "lenient" else "is ignored") in text
