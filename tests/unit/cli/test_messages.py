"""What reaches the screen reaches every screen."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager

from lss_motion.cli.messages import Printer


def test_a_terminal_without_superscripts_gets_a_question_mark_and_no_traceback():
    command = [sys.executable, "-m", "lss_motion.cli.main", "reference", "LSS"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "deg/s?" in done.stdout


@contextmanager
def into_a_pipe(monkeypatch):
    """Standard output is a pipe, in which a write that would wait fails; gives its other end."""
    read_fd, write_fd = os.pipe()
    os.set_blocking(read_fd, False)
    os.set_blocking(write_fd, False)
    with (
        os.fdopen(read_fd, "rb", buffering=0) as reader,
        os.fdopen(write_fd, "w") as writer,
        monkeypatch.context() as patch,
    ):
        patch.setattr(sys, "stdout", writer)
        yield reader


def test_a_reader_that_does_not_read_makes_nobody_wait_and_misses_nothing(monkeypatch):
    printer, lines = Printer(), [f"{number:04d}" + "." * 995 for number in range(200)]
    with into_a_pipe(monkeypatch) as pipe:
        for line in lines:
            printer.say(line)
        got = b""
        while len(got) < sum(len(line) + 1 for line in lines):
            more = pipe.read()
            assert more, f"only {len(got)} bytes came"
            got += more
            printer.say("")
    assert got.decode().split() == lines


def test_what_was_held_back_is_printed_in_the_end(monkeypatch):
    printer, count = Printer(), 80
    with into_a_pipe(monkeypatch) as pipe:
        for _ in range(count):
            printer.say("." * 999)
        before = pipe.read()
        assert len(before) < 1000 * count
        printer.finish()
        assert len(before + pipe.read()) == 1000 * count


def test_a_pipe_whose_reader_has_gone_is_given_up_and_that_is_said_once(monkeypatch, capsys):
    printer = Printer()
    with into_a_pipe(monkeypatch) as pipe:
        pipe.close()
        for text in ("one", "two", "three"):
            printer.say(text)
    said = capsys.readouterr().err
    assert said.count("warning: standard output cannot be written to") == 1
    assert "Broken pipe" in said
