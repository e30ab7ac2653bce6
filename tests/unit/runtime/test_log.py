from __future__ import annotations

import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lss_motion.errors import InputError
from lss_motion.runtime.log import FIRST_LINE, ByteLog

LINE = re.compile(r"(\d+\.\d{6}) (\S+) ([<>]) (.*)")


def read_back(path):
    """Parse a log with nothing but what its docstring says."""
    first, *lines = path.read_text("ascii").split("\n")
    assert first == FIRST_LINE
    assert lines.pop() == ""
    found = []
    for line in lines:
        instant_s, bus, way, text = LINE.fullmatch(line).groups()
        data = text.encode("ascii").decode("unicode_escape").encode("latin-1")
        found.append((round(float(instant_s) * 1e6), bus, way, data))
    return found


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**10),
            st.sampled_from(["main", "left"]),
            st.sampled_from("<>"),
            st.binary(min_size=1, max_size=40),
        )
    )
)
def test_a_log_gives_back_the_same_bytes(tmp_path, entries):
    path = tmp_path / "bytes.log"
    start_ns = 123_456_789_000
    with ByteLog(path).started(start_ns) as log:
        for at_us, bus, way, data in entries:
            note = log.sent if way == ">" else log.received
            note(bus, data, start_ns + 1000 * at_us)
    assert read_back(path) == entries


def test_lines_look_as_the_docstring_draws_them(tmp_path):
    path = tmp_path / "bytes.log"
    with ByteLog(path) as log:
        log.sent("main", b"#5QD\r", 1_234_000)
        log.received("main", b"*5QD132\r\xff", 4_100_000)
    assert path.read_text().splitlines()[1:] == [
        "0.001234 main > #5QD\\r",
        "0.004100 main < *5QD132\\r\\xff",
    ]


def test_what_was_noted_is_there_after_a_crash(tmp_path):
    path = tmp_path / "bytes.log"

    def crash():
        with ByteLog(path) as log:
            log.sent("main", b"#254H\r", 0)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        crash()
    assert read_back(path) == [(0, "main", ">", b"#254H\r")]


def test_a_log_that_cannot_be_written_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot write the log"):
        ByteLog(tmp_path / "no" / "such" / "folder.log")
