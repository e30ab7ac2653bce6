"""The conductor's computer plans beside the network, and obeys lines."""

import io
import subprocess
import sys
import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import pytest

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.stage.hosts.serving import Commands, settings_of
from lss_motion.stage.load import load_stage

SEQUENCES = Path(__file__).parents[3] / "sequences"


@pytest.fixture
def stage():
    return load_stage(SEQUENCES / "stages" / "duet.yaml")


class Host:
    """Notes what it is asked for."""

    def __init__(self):
        self.conductor = SimpleNamespace(
            wanted="nothing", pause=self._pause, set_rate=self._note, seek=self._note
        )
        self.cues, self.done = deque(), []

    def load(self, cast, contents):
        self.done.append(("load", cast.show, len(contents)))

    def go(self):
        raise InputError("the show plays, or is about to")

    def stop(self):
        self.done.append("stop")

    def _pause(self, _now_ns):
        self.done.append("pause")

    def _note(self, number, _now_ns):
        self.done.append(number)
        return number


def test_a_show_is_planned_in_another_process_and_lines_are_obeyed(stage, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    log, host = [], Host()
    robot = load_robot(stage.figures["left"].robot_path)
    commands = Commands(host, stage, {"left": robot, "right": robot}, log.append)
    longest_s, end = 0.0, time.monotonic() + 120.0
    while not host.done and time.monotonic() < end:
        began = time.process_time()
        commands.turn()
        longest_s = max(longest_s, time.process_time() - began)
        time.sleep(0.01)
    assert host.done == [("load", "bow", 3)]  # Two plans and their cast.
    assert longest_s < 0.1  # Planning itself takes a second of processor time.
    wrong = ("v", "v fast", "v 0.5 1", "v nan", "j", "j 1:30")
    for line in ("g", "s", "p", "l nothing", *wrong, "v 0.5", "j 2", "x"):
        commands.put(line)
    commands.turn()
    assert host.done[1:] == ["stop", "pause", 0.5, 2.0]
    assert log[2:6] == ["refused: v needs a share of the speed of the plan: v 0.5"] * 4
    assert log[6:8] == ["refused: j needs a show time in seconds: j 12.5"] * 2
    assert log[0] == "refused: the show plays, or is about to"
    assert log[1] == "no show 'nothing'; there are bow"
    commands.put("q")
    commands.turn()
    assert commands.has_ended
    commands.close()


def test_the_settings_are_those_of_the_stage(stage):
    settings = settings_of(stage, "right", is_trusted=False)
    assert (settings.conductor, settings.address, settings.is_conductor) == (
        "left",
        "127.0.0.1:7447",
        False,
    )
    with pytest.raises(InputError, match="there are left, right"):
        settings_of(stage, "middle", is_trusted=False)


KILLED = """
import multiprocessing, sys
from concurrent.futures import ProcessPoolExecutor
from lss_motion.stage.hosts.serving import begin_planner

if __name__ == "__main__":
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(1, spawn, begin_planner)
    print(pool.submit(abs, -1).result(), flush=True)
    sys.stdin.read()
"""


def test_a_planner_ends_with_a_conductor_that_is_killed(tmp_path):
    path = tmp_path / "killed.py"
    path.write_text(KILLED)
    command = [sys.executable, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"1\n"
        process.kill()
        # Its output ends when nobody holds that any more.
        assert process.communicate(timeout=60.0)[0] == b""
