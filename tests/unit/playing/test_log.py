from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lss_motion.errors import InputError
from lss_motion.playing.log import FIRST_LINE, ByteLog
from lss_motion.playing.player.events import MarkPassed

LINE = re.compile(r"(\d+)\.(\d{9}) (\S+) ([<>]) (.*)")


def read_back(path):
    """Parse a log by its docstring alone."""
    first, *lines = path.read_text("ascii").split("\n")
    assert first == FIRST_LINE
    assert lines.pop() == ""
    assert lines.pop().endswith(" - #")
    found = []
    for line in lines:
        whole_s, left_ns, bus, way, text = LINE.fullmatch(line).groups()
        data = text.encode("ascii").decode("unicode_escape").encode("latin-1")
        found.append((int(whole_s) * 10**9 + int(left_ns), bus, way, data))
    return found


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=5, deadline=None
)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**13),
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
        for at_ns, bus, way, data in entries:
            note = log.sent if way == ">" else log.received
            note(bus, data, start_ns + at_ns)
    assert read_back(path) == entries


def test_lines_look_as_in_the_docstring(tmp_path):
    path = tmp_path / "bytes.log"
    with ByteLog(path, played={"file": "show.yaml"}) as log:
        log.sent("main", b"#5QD\r", 1_234_567)
        log.received("main", b"*5QD132\r\xff", 4_100_210)
        log.turned(4_180_007)
        log.requested("rate 0.5", 1_203_004_100)
        log.happened(MarkPassed("up", 1.0), 1_203_104_100)
    assert path.read_text().splitlines()[1:] == [
        '# played: {"file": "show.yaml"}',
        "0.001234567 main > #5QD\\r",
        "0.004100210 main < *5QD132\\r\\xff",
        "0.004180007 - .",
        "1.203004100 - = rate 0.5",
        "1.203104100 - ! MarkPassed(label='up', show_s=1.0)",
        "1.203104100 - #",
    ]


def test_a_slow_disk_delays_no_command_and_lost_lines_are_counted(tmp_path, monkeypatch):
    """The writing process is stopped: the pipe fills, then the buffer, then lines are lost."""
    monkeypatch.setattr("lss_motion.playing.log.HELD_MAX_BYTES", 100_000)
    path, count = tmp_path / "bytes.log", 40_000
    with ByteLog(path) as log:
        os.kill(log._child.pid, signal.SIGSTOP)
        for number in range(count):
            log.sent("main", b"#5QD\r", number)
        os.kill(log._child.pid, signal.SIGCONT)
        for number in range(20):
            time.sleep(0.05)
            log.sent("main", b"#5QD\r", (number + 1) * 10**9)
    lines = path.read_text().splitlines()
    [said] = [line for line in lines if " ? " in line]
    lost = int(said.split()[3])
    assert lost > 0
    assert len(lines) == 3 + count + 20 - lost


def test_a_log_is_whole_when_the_player_is_killed(tmp_path):
    path = tmp_path / "bytes.log"
    code = (
        "import os, sys; from pathlib import Path; from lss_motion.playing.log import ByteLog\n"
        "log = ByteLog(Path(sys.argv[1]))\n"
        "[log.sent('main', b'#5QD\\r', n * 10**6) for n in range(1000)]\n"
        "os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    for _ in range(200):
        if path.exists() and len(path.read_text().splitlines()) > 800:
            break
        time.sleep(0.05)
    assert len(path.read_text().splitlines()) > 800, "all but the last tenth of a second"
    assert "#\n" not in path.read_text(), "its end is missing"


def test_noted_lines_are_in_the_file_after_a_crash(tmp_path):
    path = tmp_path / "bytes.log"

    def crash():
        with ByteLog(path) as log:
            log.sent("main", b"#254H\r", 0)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        crash()
    assert read_back(path) == [(0, "main", ">", b"#254H\r")]


def test_a_log_that_cannot_be_written_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot be written: No such"):
        ByteLog(tmp_path / "no" / "such" / "folder.log")
