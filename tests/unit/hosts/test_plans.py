"""One show for two figures: planned together, split, stored, and verified where it is played."""

import os
import pickle
import signal
import socket
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

import lss_motion as lss
from lss_motion.errors import InputError, LssMotionError
from lss_motion.playing.remote.process import begin_process
from lss_motion.stage.hosts import plans
from lss_motion.stage.hosts.messages import hash_of, packed
from lss_motion.stage.hosts.player_link import PlayerLink
from lss_motion.system.messages import MessagePipe

SEQUENCES = Path(__file__).parents[3] / "sequences"
DUET = """\
sequence: duet
robot: {robot}
keyframes:
  - {{at_s: 0, deg: {{left.base: 0, left.elbow: 10, right.base: 0, right.elbow: 10}}}}
  - {{after_s: 0.2, label: turn, deg: {{left.base: 90, right.base: -20}}}}
  - {{after_s: 1.0, deg: {{left.base: 0, right.base: 0}}}}
events:
  - {{at_s: 0.1, say: both}}
  - {{at_s: 0.2, led: {{right.base: blue}}}}
"""


@pytest.fixture
def robots():
    robot = lss.load_robot(SEQUENCES / "robots" / "desk_arm.yaml")
    return {"left": robot, "right": replace(robot, name="other_arm")}


@pytest.fixture
def duet(tmp_path):
    path = tmp_path / "duet.yaml"
    path.write_text(DUET.format(robot=SEQUENCES / "robots" / "desk_arm.yaml"))
    return path


def test_what_one_figure_needs_more_time_for_all_wait_for(robots, duet):
    made = plans.planned_cast("duet", duet, robots, "left")
    cast, contents = made.cast, made.contents
    read = {
        name: plans.read_plan(contents[part.plan], robots[name])
        for name, part in cast.parts.items()
    }
    # The base of `left` cannot turn by 90 degrees in 0.2 s; the one of `right` could turn by 20.
    turns = [next(m for m in p.marks if m.label == "turn").planned_s for p in read.values()]
    assert turns[0] == turns[1] > 0.4
    assert read["left"].duration_s == read["right"].duration_s == cast.duration_s
    assert set(read["right"].start_deg) == {"base", "elbow"}
    assert {move.bus for move in read["right"].moves} == {"main"}
    assert [cue.say for cue in read["left"].cues if cue.say] == ["both"]
    assert [cue.led for cue in read["right"].cues] == [(("base", 3),)]
    assert cast.parts["left"].robot == plans.robot_hash(robots["left"])


def test_a_sequence_for_each_figure_needs_no_names(robots):
    wave = SEQUENCES / "wave.yaml"
    made = plans.planned_cast("wave", {"left": wave, "right": wave}, robots, "left")
    cast, contents = made.cast, made.contents
    assert set(cast.parts) == {"left", "right"}
    assert contents[hash_of(packed(cast))] == packed(cast)
    alone = lss.compile(lss.plan(lss.load_sequence(wave), robots["left"]), robots["left"])
    assert plans.read_plan(contents[cast.parts["left"].plan], robots["left"]).moves == alone.moves


def test_a_plan_that_breaks_a_limit_here_is_refused(robots, duet):
    made = plans.planned_cast("duet", duet, robots, "left")
    cast, contents = made.cast, made.contents
    robot = robots["left"]
    narrow = replace(robot.joints["base"], position_max_deg=45.0)
    other = replace(robot, joints={**robot.joints, "base": narrow})
    content = contents[cast.parts["left"].plan]
    assert plans.read_plan(content, robot).moves
    with pytest.raises(LssMotionError, match="joint 'base' would go to"):
        plans.read_plan(content, other)
    with pytest.raises(InputError, match="the plan is no text"):
        plans.read_plan(b"\xff", robot)


@pytest.mark.parametrize(
    ("change", "is_same"),
    [
        ({"port": "/dev/ttyUSB7"}, True),
        ({"baud_bps": 500000}, False),
        ({"firmware": 369}, False),
    ],
)
def test_robots_are_the_same_but_for_their_ports(robots, change, is_same):
    robot = robots["left"]
    buses = {name: replace(bus, **change) for name, bus in robot.buses.items()}
    other = replace(robot, buses=buses, path=None)
    assert (plans.robot_hash(other) == plans.robot_hash(robot)) is is_same


def test_a_joint_that_differs_is_another_robot(robots):
    robot = robots["left"]
    base = replace(robot.joints["base"], zero_deg=0.5)
    other = replace(robot, joints={**robot.joints, "base": base})
    assert plans.robot_hash(other) != plans.robot_hash(robot)


def test_the_store_gives_back_only_what_has_the_hash(tmp_path):
    store = plans.PlanStore(tmp_path / "plans")
    name = store.put(b"a plan")
    assert store.get(name) == b"a plan"
    (tmp_path / "plans" / name).write_bytes(b"another plan")
    assert store.get(name) is None
    assert store.put(b"a plan") == name
    assert store.get(name) == b"a plan"
    assert store.get("0" * 64) is None


def test_the_store_forgets_the_oldest(tmp_path, monkeypatch):
    monkeypatch.setattr(plans, "STORE_MAX_BYTES", 2500)
    store = plans.PlanStore(tmp_path)
    import os

    names = []
    for index in range(4):
        names.append(store.put(bytes([index]) * 1000))
        os.utime(tmp_path / names[-1], (index, index))
    store.put(b"x" * 1000)
    assert [store.get(name) is not None for name in names] == [False, False, False, True]


def test_a_wait_for_a_sensor_is_refused(robots, tmp_path, monkeypatch):
    program = replace(
        lss.compile(
            lss.plan(lss.load_sequence(SEQUENCES / "wave.yaml"), robots["left"]), robots["left"]
        ),
        waits=("eye",),
    )
    show = type("Show", (), {"program": program})
    monkeypatch.setattr("lss_motion.planning.shows.prepare", lambda *_, **_more: show)
    with pytest.raises(InputError, match="cannot wait for a sensor"):
        plans.planned_cast("wave", tmp_path / "wave.yaml", robots, "left")


def test_a_plan_is_read_before_the_start_and_not_at_it(robots, tmp_path, monkeypatch):
    wave = SEQUENCES / "wave.yaml"
    made = plans.planned_cast("wave", {"left": wave}, robots, "left")
    name = made.cast.parts["left"].plan
    link = PlayerLink(robots["left"])
    link.arm(name, 0.0)
    assert (link.report(0).outcome, link.report(0).text) == ("failed", "the plan is not prepared")
    assert link.prepare(b"\xff").startswith("the plan is no text")
    assert link.prepare(made.contents[name]) == ""
    begun, given = [], []

    def begin(_stop_end, _modules):
        own, other = socket.socketpair()
        own.setblocking(False)
        pipe = MessagePipe(own)
        begun.append((pipe, other))
        return SimpleNamespace(pipe=pipe, exit_code=lambda: None, wait=lambda _s: 0)

    module = "lss_motion.stage.hosts.player_link"
    monkeypatch.setattr(f"{module}.begin_process", begin)
    monkeypatch.setattr(
        f"{module}.give_job", lambda one, job, **changes: given.append((one, job, changes))
    )
    monkeypatch.setattr(f"{module}.read_plan", None)  # Not in the host's turn.
    link.report(0)
    assert (len(begun), given) == (1, [])  # It waits for its job.
    link.arm(name, 4.0)
    ((process, job, changes),) = given
    assert process.pipe is begun[0][0]
    assert len(pickle.loads(job).shows.moves) > 20
    assert changes == {"options": {"start_s": 4.0}}
    link.report(0)
    assert len(begun) == 1  # None while a player moves servos.
    link.stop()
    link.report(0)
    assert len(begun) == 2
    begun[0][1].close()  # It has ended.
    link.report(0)
    link.report(0)
    assert len(begun) == 2
    link.close()
    assert begun[1][0].fileno() == -1  # By which the one that waits ends, too.
    begun[1][1].close()


def test_a_process_that_waits_for_its_job_ends_with_its_link():
    process = begin_process()
    process.pipe.close()
    assert process.wait(60) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_that_waits_for_its_job_ends_by_a_signal_without_a_traceback(
    tmp_path, monkeypatch, capfd, number
):
    imported = tmp_path / "imported"
    (tmp_path / "tells_that_it_is_imported.py").write_text(f"open({str(imported)!r}, 'x').close()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    process = begin_process(modules=["tells_that_it_is_imported"])
    deadline_s = time.monotonic() + 60
    while not imported.exists() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    os.kill(process.pid, number)
    assert process.wait(60) == -number
    process.close()
    assert capfd.readouterr().err == ""
