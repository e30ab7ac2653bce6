"""Signals at many instants of the programs, as their entry points run them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from lss_motion.errors import EXIT_INPUT, EXIT_INTERRUPTED
from lss_motion.system.signals import EndedBySignal, as_program, exit_code, raising
from tests.programs import ProgramBeside

pytestmark = pytest.mark.realtime

EXAMPLES = Path(__file__).parents[3] / "sequences"
PROGRAM = """
import sys
from lss_motion.cli import start
whole = start._{entry}
start._{entry} = lambda: print("begins", flush=True) or whole()
sys.exit(start.{entry}())
"""
"""What an installed program does; the line is printed when signals are handled."""
COMMANDS = {
    "wave": ("play", "wave.yaml", "--virtual", "--loop", "1"),
    "real time": ("play", "wave.yaml"),
    "dry": ("play", "show.yaml", "--dry-run"),
    "check": ("main", "check", "hexapod_dance.yaml"),
    "scan": ("main", "scan", "sim://", "--robot", "robots/hexapod.yaml"),
    "monitor": ("main", "monitor", "robots/hexapod.yaml"),
    "identify": ("main", "identify", "--robot", "robots/desk_arm.yaml", "--no-write", "elbow"),
    "walk": ("main", "walk", "hexapod_walk.yaml"),
    "sim": ("main", "sim", "robots/hexapod.yaml"),
    "help": ("main", "--help"),
}
DELAYS_S = (0.0, 0.05, 0.15, 0.3, 0.8, 2.0)


@contextmanager
def begun(tmp_path, entry, *words):
    """Start a program; yields it when its own code begins to run."""
    environment = {**os.environ, "LSS_MOTION_CACHE_DIR": str(tmp_path / "plans")}
    command = [sys.executable, "-c", PROGRAM.format(entry=entry), *words]
    options = {"cwd": EXAMPLES, "env": environment, "start_new_session": True}
    with ProgramBeside(command, merged=True, **options) as process:
        process.wait_for("^begins\n")
        yield process


@pytest.mark.slow
@pytest.mark.parametrize(("place", "name"), tuple(enumerate(COMMANDS)))
def test_ctrl_c_at_any_instant_ends_a_program_without_a_traceback(tmp_path, place, name):
    """All commands start with the same code, so each is interrupted at every second instant."""
    for delay_s in DELAYS_S[place % 2 :: 2]:
        with begun(tmp_path, *COMMANDS[name]) as process:
            time.sleep(delay_s)
            process.send_signal(signal.SIGINT)
            assert process.ended() in (0, EXIT_INTERRUPTED), (delay_s, process.said)
        assert "Traceback" not in process.said, (delay_s, process.said)
        assert "Exception ignored" not in process.said, (delay_s, process.said)
        if process.returncode == 0 and name != "real time":
            break  # It had ended before the signal came.


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
@pytest.mark.parametrize("name", ["real time", "monitor", "walk"])
def test_other_signals_end_a_program_the_same_way(tmp_path, name, number):
    for delay_s in DELAYS_S[1::4]:
        with begun(tmp_path, *COMMANDS[name]) as process:
            time.sleep(delay_s)
            process.send_signal(number)
            assert process.ended() == 128 + number, (delay_s, process.said)
        assert "Traceback" not in process.said, (delay_s, process.said)


@pytest.mark.slow
def test_many_signals_end_a_program_at_once_and_without_a_traceback(tmp_path):
    for pause_s in (0.0, 0.01, 0.1):
        with begun(tmp_path, *COMMANDS["real time"]) as process:
            time.sleep(1.0)
            for _ in range(10_000):
                if process.poll() is not None:
                    break
                process.send_signal(signal.SIGINT)
                time.sleep(pause_s)
            assert process.ended() == EXIT_INTERRUPTED
        assert "Traceback" not in process.said, process.said


def test_a_program_that_is_to_ignore_a_signal_ignores_it():
    """`nohup`, or a job in the background of a script."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        seen = []
        as_program("test", lambda: seen.append(signal.getsignal(signal.SIGHUP)) or 0)
        assert seen == [signal.SIG_IGN]
    finally:
        signal.signal(signal.SIGHUP, before)
        for number, handler in kept.items():
            signal.signal(number, handler)


@pytest.fixture
def as_test_program():
    """Run a function as a whole program; the signals are given back afterwards."""
    kept = {number: signal.getsignal(number) for number in signal.valid_signals()}
    yield lambda do: as_program("test", do)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, kept[number])


def test_a_signal_is_not_lost_in_a_destructor(as_test_program):
    """Python drops the exceptions of destructors, and of callbacks amid an import."""

    class Dying:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)

    steps = []

    def do():
        with raising():
            Dying()
            steps.append("goes on")
            time.sleep(20.0)
            steps.append("ignored the signal")
        return 0

    with pytest.raises(EndedBySignal) as caught:
        as_test_program(do)
    assert caught.value.number == signal.SIGTERM
    assert steps == ["goes on"]


def test_while_a_port_is_open_the_first_signal_raises_and_the_next_ones_do_not(as_test_program):
    steps = []

    def do():
        try:
            with raising():
                try:
                    signal.raise_signal(signal.SIGTERM)
                finally:
                    signal.raise_signal(signal.SIGINT)
                    steps.append("safe")
        except EndedBySignal as ended:
            return exit_code(ended)
        return 0

    assert as_test_program(do) == 143
    assert steps == ["safe"]


@pytest.mark.parametrize("words", [["--help"], ["check", "--help"], ["--version"], ["reference"]])
def test_an_output_without_a_reader_is_no_error(words):
    command = [sys.executable, "-m", "lss_motion.cli.main", *words]
    read_fd, write_fd = os.pipe()
    os.close(read_fd)
    done = subprocess.run(
        command, stdout=write_fd, stderr=subprocess.PIPE, text=True, check=False, timeout=60
    )
    os.close(write_fd)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("words", ["--help", "reference", "scan sim:// --robot ROBOT"])
def test_a_program_without_standard_streams_runs(words):
    words = words.replace("ROBOT", str(EXAMPLES / "robots" / "desk_arm.yaml"))
    command = f"{sys.executable} -m lss_motion.cli.main {words} <&- >&-"
    done = subprocess.run(
        ["sh", "-c", command], stderr=subprocess.PIPE, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("words", [["reference"], ["schema", "robot"]])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has this device")
def test_an_output_without_room_is_an_error_in_words(words):
    command = [sys.executable, "-m", "lss_motion.cli.main", *words]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60
        )
    assert done.returncode == EXIT_INPUT
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr
