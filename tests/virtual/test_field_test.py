"""The field test on robots that are not as assumed: right, or not seen; never wrong and sure."""

from __future__ import annotations

import json
import math
import re
import zipfile
from random import Random

import pytest

from lss_motion.cli import field_test
from lss_motion.cli.main import main
from lss_motion.errors import LssMotionError, StoppedError
from lss_motion.maintenance.field import measure
from lss_motion.maintenance.field.archive import load
from lss_motion.maintenance.field.verdicts import facts, verdicts
from lss_motion.playing.connection import connect
from lss_motion.robot.load import load_robot
from lss_motion.sim.deviation import deviation_from_text
from lss_motion.system.clock import VirtualClock
from tests.tables import first_quick

ROBOTS = 30
ROBOT = """\
robot: one
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 1}
  tilt: {id: 2}
"""
STORING = re.compile(rb"#\d+(C[A-Z]|CONFIRM|DEFAULT)")
JUDGED = {"A10", "A11", "A13", "A16", "E7", "M14", "M32", "M6", "M7", "R3", "R4", "W14", "W17"}


def sim_of(seed: int) -> str:
    """Return how the robot of a seed differs; that of seed 0 does not."""
    random = Random(f"{seed}/field")
    if not seed:
        return ""
    words = {
        "retarget": "from_rest",
        "t_law": "exact",
        "lag": f"{random.choice((-11, 8, 15, 40, 70))}ms",
        "ramp": f"{random.choice((0.4, 0.6, 0.8, 1.25)):g}",
        "droop": f"{random.choice((-1, 1)) * random.uniform(0.5, 4.0):.1f}deg",
        "backlash": f"{random.uniform(0.2, 1.2):.1f}deg",
        "noise": f"{random.choice((0.15, 0.5)):g}deg",
        "motor": f"{random.uniform(30, 90):.0f}%",
        "usb": f"{random.uniform(1, 16):.0f}ms",
        "lost": f"{random.uniform(0.1, 1.0):.1f}%",
        "corrupt": f"{random.uniform(0.1, 1.0):.1f}%",
    }
    return ",".join(f"{key}={words[key]}" for key in random.sample(list(words), 4))


def true_of(sim: str) -> dict[str, str]:
    """Return the right verdict of each assumption that is judged."""
    differs = deviation_from_text(sim)
    wrong = {
        "A10": differs.retarget != "keep_speed",
        "A11": differs.t_law != "cruise",
        "M14": differs.t_law != "cruise",
        "A13": bool(differs.lag_s),
        "A16": differs.ramp_ratio != 1.0,
        "E7": (differs.noise_deg or 0.1) > 0.2,
    }
    return {fact: "refuted" if wrong.get(fact) else "confirmed" for fact in JUDGED}


def hour(folder, sim: str, seed: int) -> dict[str, measure.Figures]:
    """Return the figures of the steps on a robot; a step that fails has none."""
    (folder / "robot.yaml").write_text(ROBOT)
    robot = load_robot(folder / "robot.yaml")
    pan, joints = robot.joints["pan"], list(robot.joints.values())
    steps = {
        "scan": lambda c: measure.found_servos(c, robot, joints),
        "laws pan": lambda c: measure.laws(c, robot, pan, 20.0),
        "small pan": lambda c: measure.small_moves(c, robot, pan),
        "filter pan": lambda c: measure.filtered(c, robot, pan),
        "groups": lambda c: measure.group_replies(c, robot, joints),
        "restart pan": lambda c: measure.restart(c, pan),
    }
    figures = {}
    for name, step in steps.items():
        options = {"robot": robot, "clock": VirtualClock(), "seed": seed}
        with connect(robot.buses, **options, deviation=deviation_from_text(sim)) as connection:
            try:
                figures[name] = step(connection)
            except LssMotionError:
                figures[name] = {}
            lines = connection.simulated["main"].lines
            assert not [line for _, line in lines if STORING.match(line)]
    return figures


@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", first_quick(range(ROBOTS), 2))
def test_each_assumption_is_found_right_or_is_not_seen(seed, tmp_path) -> None:
    sim = sim_of(seed)
    true, told = true_of(sim), verdicts(hour(tmp_path, sim, seed))
    judged = {one.fact: one.verdict for one in told if one.verdict != "not seen"}
    for fact, verdict in judged.items():
        assert verdict.startswith(true[fact]), (sim, fact, verdict)
    if not seed:
        assert set(judged) == JUDGED


def test_every_assumed_fact_has_a_verdict() -> None:
    assumed = {fact for fact, (_, is_assumed) in facts().items() if is_assumed}
    assert assumed == {one.fact for one in verdicts({})}
    assert {one.verdict for one in verdicts({})} == {"not seen"}
    assert {"A10", "A11", "A13", "M32", "W14"} <= assumed


@pytest.fixture
def short_hour(tmp_path, monkeypatch):
    """A robot file, and an hour of four steps."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    plans = field_test.step_plans
    chosen = {"scan", "small pan", "groups", "unplug pan"}
    monkeypatch.setattr(
        field_test, "step_plans", lambda joints: [p for p in plans(joints) if p.name in chosen]
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_over_is_kept_and_the_same_command_goes_on(short_hour, monkeypatch, capsys) -> None:
    words = ["field-test", "robot.yaml", "-o", "a.zip", "--virtual"]
    small = measure.small_moves

    def stopped(*_: object) -> None:
        raise StoppedError("stopped at pan: it holds")

    monkeypatch.setattr(measure, "small_moves", stopped)
    assert main(words) == 130
    said = capsys.readouterr()
    assert "you are asked 4 times" in said.out
    assert "the same command goes on with this step" in said.err
    assert list(load(short_hour / "a.zip").steps) == ["scan"]
    monkeypatch.setattr(measure, "small_moves", small)
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "a.zip: goes on, 1 step over" in said
    assert "step 1 of 3: small pan" in said
    archive = load(short_hour / "a.zip")
    assert list(archive.steps) == ["scan", "small pan", "groups", "unplug pan"]
    unplugged = archive.steps["unplug pan"].figures
    assert unplugged["status"] == "LIMP"
    assert unplugged["away_s"] == pytest.approx(2.0, abs=0.6)
    assert archive.steps["small pan"].simulated["moves"]
    with zipfile.ZipFile(short_hour / "a.zip") as given:
        assert given.read("robot.yaml").decode() == ROBOT
        assert "R3   confirmed by pan" in given.read("verdicts.txt").decode()
        assert "simulated" in given.read("figures.txt").decode()
        assert json.loads(given.read("field.json"))["verdicts"]


def test_two_archives_are_compared(short_hour, capsys) -> None:
    for name, more in (("a.zip", []), ("b.zip", ["--sim", "usb=16ms"])):
        assert main(["field-test", "robot.yaml", "-o", name, "--virtual", *more]) == 0
    capsys.readouterr()
    assert main(["field-test", "--compare", "a.zip", "a.zip"]) == 0
    assert "confirmed" not in capsys.readouterr().out
    archive = load(short_hour / "a.zip")
    assert math.isfinite(archive.steps["unplug pan"].lasted_s)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["robot.yaml"], "give a robot file and -o F.zip"),
        (["--compare", "robot.yaml", "robot.yaml"], "is no archive of lss-motion field-test"),
        (["robot.yaml", "--compare", "a", "b"], "--compare goes without a robot"),
        (["robot.yaml", "-o", "a.zip", "--joints", "pann"], "unknown joint 'pann'"),
        (["robot.yaml", "-o", "robot.yaml", "--virtual"], "is no archive"),
        (["robot.yaml", "-o", "a.zip", "--port", "/dev/x"], "there is no terminal"),
        (["robot.yaml", "-o", "a.zip", "--port", "/dev/x", "--virtual"], "needs the simulated bus"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_moves(short_hour, capsys, words, text) -> None:
    assert main(["field-test", *words]) == 2
    assert text in capsys.readouterr().err
