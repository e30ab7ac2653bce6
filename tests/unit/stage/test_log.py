"""The log of a stage: bounded, bytes at a fault, and a disk that is full."""

from __future__ import annotations

import json
import os

import pytest

from lss_motion.stage.log import RING_MAX_BYTES, Ring, StageLog, Writer
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
