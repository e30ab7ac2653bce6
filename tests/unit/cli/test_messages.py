"""What reaches the screen reaches every screen."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import unicodedata
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lss_motion.cli.commands import print_json
from lss_motion.cli.messages import Printer, say, shown
from lss_motion.errors import EXIT_INPUT

STEERING = "\x1b]0;taken\x07\x1b[2J\r\x9b31m\u202e\u2028"
"""Sets the title, clears the screen, overwrites the line, turns red and writes backwards."""


def steers(text):
    """Return what of a text a terminal would obey rather than show."""
    kinds = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return [c for c in text if unicodedata.category(c) in kinds and c not in "\n\t\u200c\u200d"]


@given(st.text())
def test_no_text_steers_the_terminal(text):
    out = StringIO()
    say(text, out)
    assert not steers(out.getvalue())
    assert not steers(shown(text).plain)
    if not steers(text):
        assert out.getvalue() == f"{text}\n"


@given(st.dictionaries(st.text(), st.text()))
def test_json_on_a_terminal_is_the_same_json_and_steers_nothing(value):
    out = StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", out)
        print_json(value)
    assert not steers(out.getvalue())
    assert json.loads(out.getvalue()) == value


@pytest.mark.parametrize("program", ["main", "play"])
@pytest.mark.parametrize("words", [["check"], ["check", "other"]])
def test_a_name_of_a_file_cannot_steer_the_terminal(program, words):
    name = f"{STEERING}.yaml"
    command = [sys.executable, "-m", f"lss_motion.cli.{program}", *words, name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == EXIT_INPUT
    assert not steers(done.stdout + done.stderr)
    assert r"\x1b]0;taken\x07" in done.stderr


OTHERS = f"""
import asyncio, logging, sys, threading, warnings
from lss_motion.system.signals import as_program
text = {STEERING!r}

def fails():
    raise ValueError(text)

def do():
    warnings.warn(text)
    logging.getLogger("asyncio").error(text)
    thread = threading.Thread(target=fails)
    thread.start()
    thread.join()
    print(text, file=sys.stderr)
    fails()

as_program("name", do)
"""


def test_what_others_print_to_standard_error_cannot_steer_the_terminal():
    done = subprocess.run(
        [sys.executable, "-c", OTHERS], capture_output=True, text=True, check=False
    )
    assert done.stderr.count(r"\x1b]0;taken\x07") >= 5
    assert not steers(done.stderr)


def test_what_a_helper_fails_with_cannot_steer_the_terminal(tmp_path):
    (tmp_path / "helper.py").write_text(f"def main(pipe):\n    raise ValueError({STEERING!r})\n")
    start = "from lss_motion.system.process import ChildProcess; ChildProcess('helper').end(20.0)"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", start]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert r"ValueError: \x1b]0;taken\x07" in done.stderr
    assert not steers(done.stderr)


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
            printer.print(line)
        got = b""
        while len(got) < sum(len(line) + 1 for line in lines):
            more = pipe.read()
            assert more, f"only {len(got)} bytes came"
            got += more
            printer.print("")
    assert got.decode().split() == lines


def test_what_was_held_back_is_printed_in_the_end(monkeypatch):
    printer, count = Printer(), 80
    with into_a_pipe(monkeypatch) as pipe:
        for _ in range(count):
            printer.print("." * 999)
        before = pipe.read()
        assert len(before) < 1000 * count
        printer.finish()
        assert len(before + pipe.read()) == 1000 * count


def test_a_pipe_whose_reader_has_gone_is_given_up_and_that_is_said_once(monkeypatch, capsys):
    printer = Printer()
    with into_a_pipe(monkeypatch) as pipe:
        pipe.close()
        for text in ("one", "two", "three"):
            printer.print(text)
    said = capsys.readouterr().err
    assert said.count("warning: standard output cannot be written") == 1
    assert "Broken pipe" in said


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize("arguments", [["schema", "robot"], ["reference", "LSS"]])
def test_a_full_disk_under_standard_output_is_one_line_that_names_it(arguments):
    command = [sys.executable, "-m", "lss_motion.cli.main", *arguments]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    said = "lss-motion: standard output cannot be used: No space left on device\n"
    assert (done.returncode, done.stderr.decode()) == (EXIT_INPUT, said)


def test_a_file_that_fails_loses_nothing_of_what_was_said_before():
    program = (
        "import sys; from lss_motion.cli.messages import guarded\n"
        "def do():\n    print('said before'); open('/no/such/file')\n"
        "sys.exit(guarded('lss-motion', do))"
    )
    command = [sys.executable, "-c", program]
    held = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(command, capture_output=True, text=True, env=held, check=False)
    assert (done.returncode, done.stdout) == (EXIT_INPUT, "said before\n")
    assert done.stderr == ("lss-motion: /no/such/file cannot be used: No such file or directory\n")


@pytest.mark.slow
def test_a_reader_that_has_seen_enough_is_no_error():
    command = [sys.executable, "-m", "lss_motion.cli.main", "schema", "robot"]
    read_fd, write_fd = os.pipe()
    os.close(read_fd)
    done = subprocess.run(command, stdout=write_fd, stderr=subprocess.PIPE, check=False)
    os.close(write_fd)
    assert (done.returncode, done.stderr) == (0, b"")
