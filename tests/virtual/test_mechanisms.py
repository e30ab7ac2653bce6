"""Shows on robots with mechanisms, played to the horns of the simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning import shows
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.job import Job, play
from lss_motion.playing.remote.stage_messages import Change
from lss_motion.playing.run import perform
from lss_motion.playing.targets import TargetRule
from lss_motion.robot.load import load_robot
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sim.faults import Fault, FaultKind
from tests.unit.robot.test_mechanisms import HEAD, eyes_csv
from tests.virtual.test_remote import S, SteeringClient, at, run, sends

if TYPE_CHECKING:
    from lss_motion.planning.shows import Show
    from lss_motion.playing.run import Result

ROOT = Path(__file__).resolve().parents[2]
JOINTS = ["turret", "jaw", "lid", "tilt", "roll", "arm", "yaw", "pitch"]
FRAMES = [
    {"at_s": 0, "deg": dict.fromkeys(JOINTS, 0)},
    {"at_s": 0.8, "deg": dict(zip(JOINTS, (30, 22, 50, 20, 10, 60, 25, -15), strict=True))},
    {"at_s": 1.9, "deg": dict(zip(JOINTS, (-30, 4, 10, -15, -5, -20, -20, 15), strict=True))},
    {"at_s": 3.0, "deg": dict.fromkeys(JOINTS, 0)},
]


def prepared(folder: Path, **more: Any) -> Show:
    (folder / "eyes.csv").write_text(eyes_csv(), encoding="utf-8")
    (folder / "head.yaml").write_text(HEAD, encoding="utf-8")
    show = {"sequence": "s", "robot": "head.yaml", "keyframes": FRAMES, **more}
    (folder / "show.yaml").write_text(json.dumps(show), encoding="utf-8")
    return shows.prepare(folder / "show.yaml", None)


def played(show: Show, **options: Any) -> Result[Any]:
    options = {"is_virtual": True, "seed": 5, "trajectory": show.trajectory, **options}
    return perform(show.program, show.robot, **options)


@pytest.fixture(scope="module")
def show(tmp_path_factory: pytest.TempPathFactory) -> Show:
    return prepared(tmp_path_factory.mktemp("head"))


def test_horns_and_joints_follow_the_plan(show: Show) -> None:
    result = played(show)
    assert result.error is None
    assert result.report.outcome == "finished"
    truth = result.truth
    assert truth is not None
    assert truth.joints[: len(JOINTS)] == tuple(JOINTS)
    assert "servo:neck.left" in truth.joints
    assert show.trajectory is not None
    planned = show.trajectory.sample(truth.times_s)
    off = truth.horn_deg[:, : len(JOINTS)] - planned
    rms = np.sqrt((off**2).mean(axis=0))
    # The tolerance of the moves is 0.2 deg of the joint; the control tick adds to it.
    assert rms.max() < 0.3, dict(zip(JOINTS, rms, strict=True))


def test_servos_of_one_joint_get_their_moves_together_and_hardly_fight(show: Show) -> None:
    front = [m for m in show.program.moves if m.servo_id == 7]
    back = [m for m in show.program.moves if m.servo_id == 8]
    assert len(front) == len(back) > 5
    for one, other in zip(front, back, strict=True):
        assert 0 < one.due_us - other.due_us < 2000
        assert one.duration_ms is not None
        assert other.duration_ms is not None
        ends_us = [m.due_us + 1000 * (m.duration_ms or 0) for m in (one, other)]
        assert abs(ends_us[0] - ends_us[1]) < 1500
        # The zero of the other is 0.4 deg, and it turns the other way.
        assert other.target_wire == 4 - one.target_wire
    bound = show.program.fight_deg["shoulder"]
    result = played(show)
    fight = result.report.fights["shoulder"]
    assert fight.measured_max_deg <= fight.bound_deg + 0.3
    assert not [text for text in result.report.warnings if "work against each other" in text]
    assert result.truth is not None
    names = list(result.truth.joints)
    both = [names.index(f"servo:shoulder.{name}") for name in ("front", "back")]
    apart = np.abs(np.diff(result.truth.horn_deg[:, both], axis=1)).max()
    assert apart <= bound + 0.1


def test_a_pair_under_different_loads_is_not_corrected_apart(show: Show) -> None:
    """One servo droops: corrections of its own would lift it against the other."""
    from lss_motion.sim.deviation import deviation_from_text

    result = played(show, deviation=deviation_from_text("droop=2deg"))
    assert result.report.outcome == "finished"
    servos = result.report.servos
    assert servos["shoulder.front"].offset_max_deg == 0.0
    assert servos["shoulder.back"].offset_max_deg == 0.0
    assert servos["neck.left"].offset_max_deg > 0.0


def lines_of(result: Result[Any]) -> list[bytes]:
    return [line.rstrip(b"\r") for _, line in result.simulated["main"].lines]


def test_a_silent_servo_of_a_mechanism_holds_all_of_it(show: Show) -> None:
    """Also where the show says to go on: one servo of a mechanism cannot go on alone."""
    lax = replace(show.program, on_fault={Cause.SILENT: (FaultStep.WARN,)})
    fault = Fault(kind=FaultKind.LOST_REPLY, at_s=4.0, servo_id=5)
    result = played(replace(show, program=lax), faults=(fault,))
    assert result.report.outcome == "fault"
    assert {one.joint for one in result.report.faults} == {"neck.left"}


def test_servos_of_a_mechanism_go_limp_together(tmp_path: Path) -> None:
    pair = "shoulder: {kind: pair, on_fault: {silent: limp},"
    show = prepared(tmp_path)
    text = (tmp_path / "head.yaml").read_text(encoding="utf-8")
    (tmp_path / "head.yaml").write_text(text.replace("shoulder: {kind: pair,", pair), "utf-8")
    robot = load_robot(tmp_path / "head.yaml")
    fault = Fault(kind=FaultKind.LOST_REPLY, at_s=4.0, servo_id=8)
    result = played(replace(show, robot=robot), faults=(fault,))
    assert result.report.outcome == "fault"
    lines = lines_of(result)
    first = min(lines.index(b"#7L"), lines.index(b"#8L"))
    assert {*lines[first : first + 2]} == {b"#7L", b"#8L"}
    moved = [line for line in lines[first:] if line.startswith((b"#7D", b"#8D"))]
    assert not moved


def test_a_program_file_is_that_of_the_servos(show: Show, tmp_path: Path) -> None:
    path = tmp_path / "show.lss"
    text = show.program.to_text()
    path.write_text(text, encoding="utf-8")
    read = shows.prepare(path, None)
    assert read.program.to_text() == text
    result = perform(read.program, read.robot, is_virtual=True, seed=5)
    assert result.report.outcome == "finished"


def test_without_feedback_too(show: Show) -> None:
    result = played(show, has_feedback=False)
    assert result.report.outcome == "finished"


def test_an_endless_show(tmp_path: Path) -> None:
    show = prepared(tmp_path, loop="forever")
    assert show.program.repeat is not None
    shows.recheck(show)


def test_the_head_of_the_examples_moves_rc_servos_through_four_bars() -> None:
    path = ROOT / "sequences/head.yaml"
    show = shows.prepare(path, None)
    result = perform(show.program, show.robot, is_virtual=True, seed=2, trajectory=show.trajectory)
    assert result.report.outcome == "finished"
    joints = result.report.joints
    assert list(joints) == list(show.robot.joints)
    for name in ("pan", "tilt", "roll", "jaw"):
        assert joints[name].horn_error_rms_deg is not None
        assert joints[name].horn_error_rms_deg < 0.2, name
    # Whole degrees of an RC servo are less than one of the lid.
    assert joints["left_lid"].horn_error_rms_deg is not None
    assert joints["left_lid"].horn_error_rms_deg < 0.5


def test_a_player_refuses_a_robot_of_joints_before_it_sends(tmp_path: Path) -> None:
    from lss_motion.errors import InputError
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.repertoire import Repertoire

    show = prepared(tmp_path)
    with pytest.raises(InputError, match="nothing was sent to a servo"):
        Player(Repertoire.single(show.program, show.robot.servo_robot), show.robot)


def test_worse_robots_are_tried_with_mechanisms_planned_and_compiled(tmp_path: Path) -> None:
    from lss_motion.playing.robustness import trials

    show = prepared(tmp_path)
    (tmp_path / "show.lss").write_text(show.program.to_text(), encoding="utf-8")
    compiled = shows.prepare(tmp_path / "show.lss", None)
    for one in (show, compiled):
        (found,) = trials(one, texts=())
        assert found.max_joint in JOINTS
        assert found.rms_deg < 0.3


def test_a_client_of_a_show_gets_joints(show: Show) -> None:
    """Its clients take the names of its events for joints, and draw angles of joints."""
    client = SteeringClient()
    result = run((show.robot, show.program, show.trajectory), client, seed=5)
    assert result.report.outcome == "finished"
    assert client.of(m.Started)[0].joints == tuple(JOINTS)
    assert show.trajectory is not None
    playing = [one for one in client.telemetry if one.rate == 1.0 and 0.1 < one.show_s < 2.9]
    assert len(playing) > 15
    planned = show.trajectory.sample(np.array([one.show_s for one in playing]))
    angles = np.array([one.angles_deg for one in playing])
    # The servos are told to the nearest tenth of a degree, and the moves are within 0.2 deg.
    assert np.abs(angles[:, :, 0] - planned).max() < 0.5
    assert np.abs(angles[:, :, 1] - planned).max() < 2.0
    is_read = np.isfinite(angles[-1, :, 2])
    assert is_read.all()
    health = [one for one in client.of(m.Health) if one.joints]
    assert {*health[-1].joints} == {*JOINTS}
    assert health[-1].joints["tilt"].allowed_deg == show.robot.joints["tilt"].following_deg
    errors = [one.joints["tilt"].error_deg for one in health]
    assert max(abs(e) for e in errors if e is not None) < 3.0
    ended = client.of(m.Ended)[0]
    assert ended.report is not None
    assert {*ended.report["joints"]} == {*JOINTS}


def test_a_fault_of_a_servo_is_told_as_one_of_its_joint(show: Show) -> None:
    client = SteeringClient()
    fault = Fault(kind=FaultKind.LOST_REPLY, at_s=4.0, servo_id=5)
    result = run((show.robot, show.program, show.trajectory), client, seed=5, faults=(fault,))
    assert result.report.outcome == "fault"
    found = client.of(m.FaultFound)
    assert {one.joint for one in found} == {"tilt"}
    assert all(one.cause.startswith("left servo of neck: ") for one in found)


def test_what_a_walk_cannot_do_is_refused_by_name(show: Show) -> None:
    job = Job(shows=show.program, robot=show.robot, targets=TargetRule())
    client = SteeringClient()
    outcome = play(job, client.steering)
    client.close()
    assert "targets" in str(outcome.error)
    assert "nothing was sent to a servo" in str(outcome.error)


def test_a_stage_plays_shows_of_such_a_robot(show: Show) -> None:
    """One show after the other, to the horns of one run."""
    script = [
        (at(1.0), sends(Change(id=1, show="other"))),
        (lambda _, now_ns: now_ns > 12 * S, sends(m.Stop(id=2))),
    ]
    client = SteeringClient(script=script)
    other = replace(show.program, name="other")
    programs = {"s": show.program, "other": other}
    job = Job(shows=programs, robot=show.robot, options={"is_virtual": True, "first": "s"})
    on_turn = client.steering.on_turn

    def turn(player: Any, now_ns: int) -> None:
        on_turn(player, now_ns)
        client.read()

    client.steering.on_turn = turn
    outcome = play(job, client.steering)
    client.read()
    client.close()
    assert outcome.error is None
    assert client.of(m.Started)[0].joints == tuple(JOINTS)
    assert [one.name for one in client.of(m.ShowStarted)][:2] == ["s", "other"]
    assert {len(one.angles_deg) for one in client.telemetry} == {len(JOINTS)}


def test_the_pages_show_where_the_bytes_take_joints(show: Show) -> None:
    from lss_motion.studio.view import view_of

    view = view_of(show, "plan")
    assert [one["name"] for one in view["joints"]] == JOINTS
    assert {*view["curves"]} == {*JOINTS}
    # The moves stay within the tolerance of 0.2 deg of the joint, and the steps of the servos.
    errors = {name: one["max_deg"] for name, one in view["error"].items()}
    assert max(errors.values()) < 0.5, errors
