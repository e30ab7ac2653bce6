from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lss_motion.errors import InputError
from lss_motion.playing.log import (
    ByteLog,
    EndedLine,
    HappenedLine,
    PlayedShow,
    PortLine,
    ReceivedLine,
    RequestedLine,
    SentLine,
    SkippedLine,
    TurnedLine,
    log_schema,
    read_log,
)
from lss_motion.playing.player.events import MarkPassed, PlayerRequest


def read_back(path):
    """Parse a log by its docstring alone."""
    first, *lines = path.read_text("utf-8").split("\n")
    assert json.loads(first) == {"format": "lss_motion log", "version": 3}
    assert lines.pop() == ""
    *rows, (last, _) = map(json.loads, lines)
    assert last == "ended"
    return [(at_ns, bus, kind, text.encode("latin-1")) for kind, at_ns, bus, text in rows]


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=5, deadline=None
)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**13),
            st.sampled_from(["main", "left"]),
            st.sampled_from(["sent", "received"]),
            st.binary(min_size=1, max_size=40),
        )
    )
)
def test_a_log_gives_back_the_same_bytes(tmp_path, entries):
    path = tmp_path / "bytes.log"
    start_ns = 123_456_789_000
    with ByteLog(path).started(start_ns) as log:
        for at_ns, bus, way, data in entries:
            getattr(log, way)(bus, data, start_ns + at_ns)
    assert read_back(path) == entries
    made = {"sent": SentLine, "received": ReceivedLine}
    *lines, _ = read_log(path).lines
    assert lines == [made[way](at_ns, bus, data.decode("latin-1"))
                     for at_ns, bus, way, data in entries]  # fmt: skip
    assert [line.data for line in lines] == [data for *_, data in entries]


def test_lines_look_as_in_the_docstring_and_are_read_back_as_they_were(tmp_path):
    path, played = tmp_path / "bytes.log", PlayedShow(file="show.yaml", speed=0.5)
    with ByteLog(path, played=played) as log:
        log.sent("main", b"#5QD\r", 1_234_567)
        log.received("main", b"*5QD132\r\xff", 4_100_210)
        log.turned(4_180_007)
        log.requested(PlayerRequest("rate", (0.5,)), 1_203_004_100)
        log.happened(MarkPassed("up", np.float64(1.0)), 1_203_104_100)
        log.noted("main", "lost", 1_500_000_000, "/dev/ttyUSB0: the device is gone")
        log.noted("main", "found", 1_900_000_000)
    first, *texts = path.read_text("utf-8").splitlines()
    assert first.startswith(
        '{"format":"lss_motion log","version":3,"played":{"file":"show.yaml","robot":null,"speed":0'
    )
    assert texts == [
        r'["sent",1234567,"main","#5QD\r"]',
        r'["received",4100210,"main","*5QD132\rÿ"]',
        '["turned",4180007]',
        '["requested",1203004100,{"name":"rate","values":[0.5]}]',
        '["happened",1203104100,{"type":"MarkPassed","label":"up","show_s":1.0}]',
        '["port",1500000000,"main","lost","/dev/ttyUSB0: the device is gone"]',
        '["port",1900000000,"main","found",""]',
        '["ended",1900000000]',
    ]
    read = read_log(path)
    assert (read.played, read.is_whole) == (played, True)
    assert read.lines == [
        SentLine(1_234_567, "main", "#5QD\r"),
        ReceivedLine(4_100_210, "main", "*5QD132\r\xff"),
        TurnedLine(4_180_007),
        RequestedLine(1_203_004_100, PlayerRequest("rate", (0.5,))),
        HappenedLine(1_203_104_100, MarkPassed("up", 1.0)),
        PortLine(1_500_000_000, "main", "lost", "/dev/ttyUSB0: the device is gone"),
        PortLine(1_900_000_000, "main", "found"),
        EndedLine(1_900_000_000),
    ]
    valid = jsonschema.Draft202012Validator(log_schema())
    for text in (first, *texts):
        valid.validate(json.loads(text))
    assert not valid.is_valid(["sent", 1, "main"])
    assert not valid.is_valid(["noticed", 1])


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
    lines = read_log(path).lines
    [said] = [line for line in lines if isinstance(line, SkippedLine)]
    assert said.count > 0
    assert len(lines) == 2 + count + 20 - said.count


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
    assert not read_log(path).is_whole, "its end is missing"


def test_noted_lines_are_in_the_file_after_a_crash(tmp_path):
    path = tmp_path / "bytes.log"

    def crash():
        with ByteLog(path) as log:
            log.sent("main", b"#254H\r", 0)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        crash()
    assert read_back(path) == [(0, "main", "sent", b"#254H\r")]


def test_a_log_that_cannot_be_written_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot be written: No such"):
        ByteLog(tmp_path / "no" / "such" / "folder.log")
