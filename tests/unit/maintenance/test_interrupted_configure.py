"""`lss-motion configure` cut off after any byte: what servos are left with, and the next run."""

from __future__ import annotations

import re
from itertools import accumulate

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE
from lss_motion.playing import connection as connections
from lss_motion.playing.connection import connect
from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import SimPort
from lss_motion.system.clock import VirtualClock

ROBOT = """
robot: pair
buses: {main: {port: "sim://"}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints:
  pan:  {id: 1, stored: {O: 2.5, SD: 120, AS: -2}}
  tilt: {id: 2, stored: {G: -1, LED: 3}}
"""


class Killed(BaseException):
    """The program is gone: nothing of it runs any more."""


class CutPort:
    """A port that passes so many bytes on, and then nothing: its program was killed."""

    def __init__(self, port, left):
        self._port, self._left = port, left

    def write(self, data):
        data, is_cut = data[: self._left[0]], len(data) >= self._left[0]
        self._left[0] -= len(data)
        if data:
            self._port.write(data)
        if is_cut:
            raise Killed

    def __getattr__(self, name):
        return getattr(self._port, name)


class Bench:
    """Servos that outlive the commands that configure them."""

    def __init__(self, folder, monkeypatch, capsys):
        self.folder, self._capsys = folder, capsys
        self._monkeypatch = monkeypatch
        (folder / "robot.yaml").write_text(ROBOT)
        self.clock = VirtualClock()
        robot = load_robot(folder / "robot.yaml")
        with connect(robot.buses, robot=robot, clock=self.clock) as connection:
            self.bus = connection.simulated["main"]
        self.written = 0

    def run(self, *words, after_bytes=1 << 40, baud_bps=115_200):
        """Run a command; return its exit code, and what it printed; None: it was cut off."""
        left = [after_bytes]

        def opened(buses, **_):
            connection = connections.Connection(buses, self.clock)
            connection.simulated["main"] = self.bus
            if self.bus.baud_bps != baud_bps:
                self.bus.set_host_rate(baud_bps, self.clock.now_ns())
            reopen = connection.reopen

            def reopened(name):
                connection.ports[name] = CutPort(reopen(name), left)
                return connection.ports[name]

            connection.reopen = reopened
            reopened("main")
            connection.close = lambda: None
            return connection

        self._monkeypatch.setattr(connections, "connect", opened)
        self._capsys.readouterr()
        try:
            code = main(["configure", *map(str, words), "--yes"])
        except Killed:
            code = None
        self.written = after_bytes if code is None else (1 << 40) - left[0]
        SimPort(self.bus, self.clock)
        return code, "".join(self._capsys.readouterr())

    def stored(self):
        """Return what each servo stores, in the order of the file."""
        return [dict(servo.settings.eeprom) for servo in self.bus._servos]


@pytest.fixture
def make_bench(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return lambda: Bench(tmp_path, monkeypatch, capsys)


NEW_ID = ("robot.yaml", "--id", 1, "--new-id", 5)
NEW_BAUD = ("robot.yaml", "--new-baud", 57_600)
SET = ("robot.yaml", "--set", "SD=120", "--set", "O=12", "--set", "LED=5")
RESTORE = ("robot.yaml", "--restore", "backup.yaml")
WRITES = re.compile(rb"#\d+(C[A-Z]+-?\d+|RESET)\r")


def ready(make_bench, words):
    bench = make_bench()
    if words is RESTORE:
        assert bench.run("robot.yaml", "--backup", "backup.yaml", "--force")[0] == EXIT_FINISHED
        for servo in bench.bus._servos:
            servo.store({"SD": 700, "LED": 2, "AA": 33}, bench.clock.now_ns())
    return bench


def whole(make_bench, words):
    """Run a command to its end; return it, what was stored before, and after how many bytes."""
    bench = ready(make_bench, words)
    before, first = bench.stored(), len(bench.bus.lines)
    assert bench.run(*words)[0] == EXIT_FINISHED
    lines = [line for _, line in bench.bus.lines[first:]]
    ends = list(accumulate(map(len, lines)))
    begins = next(at for at, line in enumerate(lines) if WRITES.match(line))
    return bench, before, ends[begins - 1 :]


@pytest.mark.parametrize(
    ("words", "next_codes"),
    [
        pytest.param(NEW_ID, {EXIT_FINISHED, EXIT_UNREACHABLE}, id="new id"),
        pytest.param(SET, {EXIT_FINISHED}, id="set"),
        pytest.param(RESTORE, {EXIT_FINISHED}, id="restore"),
        pytest.param(
            NEW_BAUD,
            {EXIT_FINISHED, EXIT_UNREACHABLE, EXIT_INPUT},
            id="new baud",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_between_two_lines_servos_have_old_or_new_values_and_the_next_run_says_which(
    make_bench, words, next_codes
):
    done, before, ends = whole(make_bench, words)
    after = done.stored()
    for cut in ends[:12]:
        bench = ready(make_bench, words)
        bench.run(*words, after_bytes=cut)
        for old, new, now in zip(before, after, bench.stored(), strict=True):
            assert all(now[name] in (old[name], new[name]) for name in now), cut
        code, text = bench.run(*words)
        assert code in next_codes
        assert code == EXIT_FINISHED or "lss-motion scan sim://" in text
        if code != EXIT_INPUT:  # Some servos have the new rate: it says what to add.
            assert bench.stored() == after
            continue
        assert bench.run(*words, "--force")[0] == EXIT_FINISHED
        assert bench.stored() == after


@pytest.mark.slow
@pytest.mark.parametrize("words", [NEW_ID, SET, RESTORE], ids=["new id", "set", "restore"])
def test_a_line_that_was_cut_in_the_middle_is_mended_by_the_next_run(make_bench, words):
    """The next line ends it, with the digits that it has; no kill cuts a line, a plug may."""
    done, _, ends = whole(make_bench, words)
    for cut in range(ends[0] + 1, ends[min(6, len(ends) - 1)]):
        bench = ready(make_bench, words)
        bench.run(*words, after_bytes=cut)
        code, text = bench.run(*words)
        assert code == EXIT_FINISHED or "lss-motion scan sim://" in text
        assert bench.stored() == done.stored()
