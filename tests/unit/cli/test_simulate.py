"""`lss-motion sim` and `--faults`: what is refused, what is said, what happens."""

from __future__ import annotations

import json

import pytest

from lss_motion.cli import play
from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE
from lss_motion.sim.faults import FaultKind

ROBOT = """
robot: one
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
joints:
  arm: {id: 5, range_deg: [-90, 90], model: LSS-ST1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
"""

SEQUENCE = """
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0.0, deg: {arm: 0}}
  - {at_s: 1.0, deg: {arm: 30}}
  - {at_s: 2.0, deg: {arm: 0}}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "nod.yaml").write_text(SEQUENCE)
    return tmp_path


@pytest.fixture
def lss_play(folder, capsys):
    def run(*options, faults=None):
        words = [str(folder / "nod.yaml"), *options]
        if faults is not None:
            (folder / "faults.yaml").write_text(f"faults:\n  - {faults}\n")
            words += ["--faults", str(folder / "faults.yaml")]
        code = play.main(words)
        return code, capsys.readouterr().err

    return run


def test_help_names_every_fault_and_what_is_not_modelled(capsys):
    with pytest.raises(SystemExit):
        main(["sim", "--help"])
    out = capsys.readouterr().out
    for kind in FaultKind:
        assert f"  {kind} " in out
        assert kind.meaning in out
    assert "Not simulated: " in out


def test_a_show_meets_the_faults_of_the_file(lss_play, folder):
    report = folder / "report.json"
    code, _ = lss_play(
        "--virtual", "--report", str(report), faults="{kind: lost_reply, ratio: 0.5, at_s: 1}"
    )
    assert code == EXIT_FINISHED
    assert json.loads(report.read_text())["buses"]["main"]["timeouts"] > 5


def test_the_same_faults_and_seed_give_the_same_report(lss_play, folder):
    def report():
        path = folder / "report.json"
        fault = "{kind: oversleep, late_s: 0.004, ratio: 0.3}"
        assert lss_play("--virtual", "--report", str(path), faults=fault)[0] == EXIT_FINISHED
        return json.loads(path.read_text())

    first = report()
    assert first["timing"]["late_max_us"] >= 1500
    assert report() == first


def test_an_unplugged_port_ends_a_show_as_a_real_one_does(lss_play):
    code, errors = lss_play("--virtual", faults="{kind: unplugged, at_s: 2}")
    assert code == EXIT_UNREACHABLE
    assert "lost port sim://: it was unplugged" in errors


@pytest.mark.parametrize(
    ("options", "fault", "words"),
    [
        (["--port", "/dev/ttyUSB9"], "{kind: deaf}", "--faults needs the simulated bus"),
        ([], "{kind: oversleep, late_s: 1}", "oversleep needs --virtual"),
        (["--virtual"], "{kind: deaf, servo: 9}", "faults.yaml:2: robot 'one' has no servo 9"),
        (["--virtual"], "{kind: dead}", "did you mean 'deaf'"),
    ],
)
def test_faults_that_could_not_happen_are_refused(lss_play, options, fault, words):
    code, errors = lss_play(*options, faults=fault)
    assert code == EXIT_INPUT
    assert words in errors


def test_sim_refuses_what_concerns_the_host(folder, capsys):
    faults = folder / "faults.yaml"
    faults.write_text("faults: [{kind: oversleep, late_s: 1}]\n")
    assert main(["sim", str(folder / "robot.yaml"), "--faults", str(faults)]) == EXIT_INPUT
    assert "oversleep needs `lss-play --virtual`" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["-1", "1.5", "256", "x"])
def test_a_latency_that_no_adapter_has_is_refused(folder, text, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["sim", str(folder / "robot.yaml"), f"--usb-latency-ms={text}"])
    assert ended.value.code == EXIT_INPUT
    assert "is not a whole number from 0 to 255" in capsys.readouterr().err
