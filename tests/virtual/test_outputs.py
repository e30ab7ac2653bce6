"""Outputs that fail while a show plays: the show goes on, and what is not complete is stated."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lss_motion.errors import EXIT_INPUT
from lss_motion.playing.log import ByteLog

resource = pytest.importorskip("resource")

WAVE = Path(__file__).parents[2] / "sequences" / "wave.yaml"
FULL = Path("/dev/full")


def played(tmp_path, *options, bytes_max=None):
    """Play a show whose files may have at most `bytes_max`, as on a full disk."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_max, bytes_max))

    command = [sys.executable, "-m", "lss_motion.cli.play", str(WAVE), "--virtual", "--loop", "1"]
    return subprocess.run(
        [*command, *map(str, options)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "LSS_MOTION_CACHE_DIR": str(tmp_path / "plans")},
        preexec_fn=None if bytes_max is None else limit,
    )


@pytest.mark.slow
def test_a_log_that_grows_beyond_its_disk_ends_no_show_and_is_stated(tmp_path):
    done = played(tmp_path, "--log", "a.log", "--report", "r.json", bytes_max=4_000)
    assert done.returncode == EXIT_INPUT
    assert done.stderr.splitlines() == [
        "lss-play: a.log: the log is not complete: File too large",
        "lss-play: r.json: cannot be written: File too large",
    ]
    assert "wave: finished" in done.stdout
    assert 0 < (tmp_path / "a.log").stat().st_size <= 4_000


@pytest.mark.slow
@pytest.mark.skipif(not FULL.exists(), reason="Linux has this device")
def test_every_result_is_tried_though_one_fails(tmp_path):
    done = played(tmp_path, "--report", FULL, "--truth", "t.csv")
    assert done.returncode == EXIT_INPUT
    assert done.stderr.startswith(f"lss-play: {FULL}: ")
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "t.csv").read_text().startswith("t_s,")
    assert "wave: finished" in done.stdout


def test_a_log_whose_writing_process_was_killed_is_not_complete(tmp_path):
    with ByteLog(tmp_path / "a.log") as log:
        os.kill(log._child.pid, signal.SIGKILL)
        assert log._child.receive_within(5.0) == []
        log.sent("main", b"#5QD\r", 1_000_000_000)
    assert "the log is not complete: the process that writes it has ended" in log.problem
