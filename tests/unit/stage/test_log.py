"""The log of a stage: bounded, bytes at a fault, and a disk that is full."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from datetime import datetime

import pytest

from lss_motion.stage.log import (
    RING_MAX_BYTES,
    Ring,
    StageLog,
    Writer,
    last_written,
    why_not_writable,
)
from lss_motion.stage.model import LogRule

NS = 1_000_000_000


def record(number, day=1, **more):
    return {"t": f"2026-10-{day:02d}T20:00:00", "kind": "note", "text": f"{number:06d}", **more}


def texts(folder):
    files = sorted(folder.glob("stage-*.jsonl"))
    return [json.loads(line)["text"] for file in files for line in file.read_text().splitlines()]


def test_each_day_has_its_file_and_a_restart_goes_on_with_it(tmp_path):
    for number in range(3):
        Writer(tmp_path, 10_000_000).write(record(number))
    Writer(tmp_path, 10_000_000).write(record(3, day=2))
    names = [file.name for file in sorted(tmp_path.iterdir())]
    assert names == ["stage-2026-10-01-0000.jsonl", "stage-2026-10-02-0000.jsonl"]
    assert texts(tmp_path) == ["000000", "000001", "000002", "000003"]


def test_the_folder_never_exceeds_its_limit_and_keeps_the_newest(tmp_path):
    writer, limit = Writer(tmp_path, 80_000), 80_000
    for number in range(3000):
        writer.write(record(number, day=1 + number // 300))
        if number % 500 == 0:
            writer.write({"dump": f"night-{number}", "content": "x" * 5000})
        total = sum(file.stat().st_size for file in tmp_path.iterdir())
        assert total <= limit
    assert texts(tmp_path)[-1] == "002999"
    assert total > limit // 2


def test_a_full_disk_loses_lines_and_says_how_many(tmp_path, monkeypatch):
    writer = Writer(tmp_path, 1_000_000)
    writer.write(record(0))
    real_open, full = type(tmp_path).open, []

    class Full:
        def __init__(self, file):
            self.file = file

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.file.close()

        def write(self, data):
            return self.file.write(data[:7])  # The rest of the disk.

        def truncate(self, size):
            self.file.truncate(size)

    def opened(path, *args, **more):
        file = real_open(path, *args, **more)
        return Full(file) if full and "ab" in args else file

    monkeypatch.setattr(type(tmp_path), "open", opened)
    full.append(True)
    for number in (1, 2, 3):
        writer.write(record(number))
    full.clear()
    writer.write(record(4))
    assert texts(tmp_path) == ["000000", "3 lines were lost: the disk took none", "000004"]


def test_a_folder_that_cannot_be_written_stops_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    writer = Writer(tmp_path / "file" / "log", 1_000_000)
    writer.write(record(0))
    writer.write({"dump": "x", "content": "y"})
    assert writer.lost == 2


@pytest.mark.parametrize("is_virtual", [False, True])
def test_people_are_told_that_the_log_cannot_be_written_and_that_it_can(tmp_path, is_virtual):
    folder = tmp_path / "log"
    folder.write_text("not a folder")
    texts = []

    def written_until(count):
        end_s = time.monotonic() + 20.0
        while len(texts) < count and time.monotonic() < end_s:
            texts.extend(log.take_texts())

    with StageLog(LogRule(folder=folder, max_bytes=1_000_000), is_virtual=is_virtual) as log:
        log.write(record(0))
        written_until(1)
        log.write(record(1))
        assert texts == [f"the log cannot be written: {folder} is not a folder"]
        folder.unlink()
        log.write(record(2))
        written_until(2)
        assert texts[1:] in (["the log is written; 2 lines of it could not be"],
                             ["the log is written; 1 line of it could not be"])  # fmt: skip
    assert log.take_texts(is_last=True)[0].endswith("of the log could not be written")


def test_what_was_lost_until_the_end_is_said_at_the_end(tmp_path):
    (tmp_path / "log").write_text("not a folder")
    with StageLog(LogRule(folder=tmp_path / "log", max_bytes=1_000_000)) as log:
        for number in range(3):
            log.write(record(number))
    trouble = f"{tmp_path / 'log'} is not a folder"
    assert log.take_texts(is_last=True) == [f"3 lines of the log could not be written: {trouble}"]


def test_the_end_of_the_process_that_writes_is_said(tmp_path):
    with StageLog(LogRule(folder=tmp_path / "log", max_bytes=1_000_000)) as log:
        os.kill(log._child.pid, signal.SIGKILL)
        log._child.wait(10.0)
        texts, number = [], 0
        while not texts and number < 1000:
            log.write(record(number))
            texts, number = log.take_texts(), number + 1
        assert texts == ["the log cannot be written: the process that writes it has ended"]


@pytest.mark.parametrize("case", ["file", "below_a_file", "read_only", "read_only_file", "full"])
def test_a_log_that_could_not_be_written_is_known_before(tmp_path, monkeypatch, case):
    folder, name = tmp_path / "log", "log"
    assert why_not_writable(folder) is None
    refused = {"read_only": tmp_path, "read_only_file": folder / "stage-2026-10-01-0000.jsonl"}
    if case == "file":
        folder.write_text("")
    elif case == "below_a_file":
        folder.write_text("")
        name = "log/below"
    elif case == "full":
        usage = shutil.disk_usage(tmp_path)._replace(free=0)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    else:
        if case == "read_only_file":
            folder.mkdir()
            refused[case].write_text("")
        real = os.access
        monkeypatch.setattr(os, "access", lambda p, m: p != refused[case] and real(p, m))
    said = "full" if case == "full" else str(refused.get(case, folder))
    assert said in why_not_writable(tmp_path / name)


def test_the_process_writes_what_it_is_given_and_the_caller_never_waits(tmp_path):
    rule = LogRule(folder=tmp_path / "log", max_bytes=1_000_000)
    with StageLog(rule) as log:
        assert not os.get_blocking(log._child.fileno())
        for number in range(2000):
            log.write(record(number))
        log.write({"dump": "night", "content": "bytes\n"})
    assert texts(tmp_path / "log") == [f"{number:06d}" for number in range(2000)]
    assert (tmp_path / "log" / "fault-night.log").read_text() == "bytes\n"


def test_the_ring_keeps_the_last_seconds_as_a_log_within_its_bound():
    ring = Ring(10.0).started(5 * NS)
    for number in range(400):
        ring.sent("main", b"#1QD\r", (5 + number) * NS // 10)
        ring.received("main", b"*1QD%d\r" % number, (5 + number) * NS // 10)
    lines = ring.content().splitlines()
    assert json.loads(lines[0]) == {"format": "lss_motion log", "version": 3}
    assert len(lines) == 1 + 2 * 101
    assert lines[-1] == r'["received",35400000000,"main","*1QD399\r"]'
    for number in range(30):
        ring.sent("main", b"x" * 100_000, 45 * NS + number)
    assert len(ring.content()) < RING_MAX_BYTES + 100


@pytest.mark.parametrize("kept_s", [0.0])
def test_a_ring_without_time_keeps_the_present_instant_only(kept_s):
    ring = Ring(kept_s).started(0)
    ring.sent("main", b"a", 1)
    ring.sent("main", b"b", 2)
    assert ring.content().count("main") == 1


def test_when_the_last_line_was_written(tmp_path):
    assert last_written(tmp_path / "nothing") is None
    (tmp_path / "stage-2026-10-29-0000.jsonl").write_text('{"t": "2026-10-29T21:00:00+01:00"}\n')
    (tmp_path / "stage-2026-10-30-0000.jsonl").write_text('{"t": "2026-10-30T2')
    assert last_written(tmp_path) == datetime.fromisoformat("2026-10-29T21:00:00+01:00")
    long = '{"t": "2026-10-30T21:14:03.120+01:00", "text": "' + 90_000 * "x" + '"}\n'
    lines = long + '{"t": "2026-10-30T22:00:00+01:00"}\nno line\n'
    (tmp_path / "stage-2026-10-30-0001.jsonl").write_text(lines)
    assert last_written(tmp_path) == datetime.fromisoformat("2026-10-30T22:00:00+01:00")
