"""A hand shows a motion to limp servos; what was recorded is reduced, planned and played again."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from lss_motion.cli.main import main
from lss_motion.maintenance.take import Take, sequence_of
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.connection import connect
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import perform as play
from lss_motion.playing.runner import run
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.hand import HandMotion, hand_from_seed
from lss_motion.system.clock import VirtualClock
from lss_motion.units import NS_PER_S, ns_from_s
from tests.tables import first_quick

ARM = Path(__file__).resolve().parents[2] / "sequences" / "robots" / "desk_arm.yaml"


class HandPerson:
    """Lets go, records for some seconds, ends; keeps what was said. A `Controls` of the runner."""

    def __init__(self, take: Take, seconds: float) -> None:
        self.take = take
        self.seconds = seconds
        self.began_ns = 0

    def filenos(self):
        return []

    def act(self, driven: HandsOn, now_ns: int) -> None:
        if driven.phase is not Phase.SHOW:
            return
        if self.take.running is None and not self.take.parts:
            self.began_ns = now_ns
            driven.let_go(self.take.joints)
            self.take.start(now_ns)
        self.take.add(driven.take())
        if now_ns >= self.began_ns + ns_from_s(self.seconds):
            self.take.finish()
            driven.stop()


def shown(robot, hand, *, seconds=6.0, faults=(), seed=0, is_soft=False):
    """Return what was recorded, the simulated bus, and when recording began."""
    take = Take(tuple(robot.joints))
    person = HandPerson(take, seconds)
    hands_on = HandsOn(robot, list(robot.joints), is_soft=is_soft)
    clock = VirtualClock()
    with connect(
        robot.buses, robot=robot, clock=clock, hand=hand, faults=faults, seed=seed
    ) as connection:
        run(hands_on, connection.ports, clock, controls=person)
    assert hands_on.error is None
    return take, connection.simulated["main"], person.began_ns


def truth_deg(robot, bus, instants_ns):
    servo_deg = bus.horn_deg(instants_ns.tolist())
    joints = list(robot.joints.values())
    return np.stack([j.direction * (servo_deg[:, n] - j.zero_deg) for n, j in enumerate(joints)], 1)


def lines(bus):
    return [line.rstrip(b"\r") for _, line in bus.lines]


@pytest.mark.parametrize("seed", first_quick([1, 3]))
def test_what_a_hand_showed_is_played_again_within_the_tolerance(seed: int) -> None:
    robot = load_robot(ARM)
    take, bus, began_ns = shown(robot, hand_from_seed(seed, robot), seconds=4.0)
    tolerance_deg = 1.0
    made = sequence_of(take, robot, "shown", tolerance_deg=tolerance_deg)
    assert len(made.sequence.keyframes) < 140  # Of 2000 readings.
    trajectory = plan(made.sequence, robot)
    assert not trajectory.stretched
    result = play(compile_program(trajectory, robot), robot, is_virtual=True, seed=seed + 10)
    assert result.truth is not None
    times_s = result.truth.times_s[result.truth.times_s <= 4.0]
    replayed_deg = result.truth.horn_deg[: len(times_s)]
    original_deg = truth_deg(robot, bus, began_ns + (times_s * NS_PER_S).astype(np.int64))
    columns = [result.truth.joints.index(name) for name in robot.joints]
    assert np.ptp(original_deg, axis=0).min() > 10.0  # They all moved.
    assert np.abs(replayed_deg[:, columns] - original_deg).max() <= tolerance_deg + 0.5


def test_a_recording_reads_as_often_as_one_question_after_the_other_can() -> None:
    robot = load_robot(ARM)
    take, _, _ = shown(robot, hand_from_seed(4, robot), seconds=3.0)
    counts = {name: len(times) for name, times in take.parts[0].times_s.items()}
    # Question, turnaround and answer take 2 ms of the line at 115200 bps.
    assert min(counts.values()) > 3.0 / len(counts) / 0.0025
    assert max(counts.values()) - min(counts.values()) <= 2


def test_every_turn_of_the_loop_waits_until_something_is_due() -> None:
    robot = load_robot(ARM)
    hands_on = HandsOn(robot, list(robot.joints))
    clock, take, waits_ns = VirtualClock(), Take(tuple(robot.joints)), []

    def note_wait(driven: HandsOn, now_ns: int) -> None:
        waits_ns.append(driven.next_wakeup_ns() - now_ns)
        assert len(waits_ns) < 10_000, "time stands still"

    with connect(robot.buses, robot=robot, clock=clock) as connection:
        run(hands_on, connection.ports, clock, controls=HandPerson(take, 1.0), on_turn=note_wait)
    count = sum(len(times) for times in take.parts[0].times_s.values())
    # A query that is sent, its answer, and the instant at which the line is free again.
    assert count < len(waits_ns) < 4 * count


def test_servos_hold_and_have_their_settings_back_afterwards() -> None:
    robot = load_robot(ARM)
    _, bus, _ = shown(robot, hand_from_seed(5, robot), seconds=1.0, is_soft=True)
    received = lines(bus)
    assert received[-1] == b"#254H"
    asked = {b"#2AH-10", b"#2AS-4", b"#2L", b"#2H"}
    assert asked <= set(received)
    last = {line[: len(b"#2AH")]: line for line in received if line.startswith((b"#2AH", b"#2AS"))}
    assert last == {b"#2AH": b"#2AH4", b"#2AS": b"#2AS0"}
    first_hold = received.index(b"#2H")
    assert received.index(b"#2AH4") > first_hold  # It holds before it becomes stiff again.


@pytest.mark.parametrize(
    ("seed", "kind"),
    [(6, FaultKind.CORRUPT_REPLY), (7, FaultKind.CORRUPT_REPLY), (8, FaultKind.SHORT_REPLY)],
)
def test_damaged_and_missing_readings_are_no_motion(seed: int, kind: FaultKind) -> None:
    """A hand that moves already when recording begins: the plan starts from rest before that."""
    robot = load_robot(ARM)
    faults = [Fault(kind=kind, ratio=0.05), Fault(kind=FaultKind.LOST_REPLY, ratio=0.1)]
    hand = hand_from_seed(seed, robot)
    take, bus, began_ns = shown(robot, hand, seconds=4.0, faults=faults, seed=seed)
    made = sequence_of(take, robot, "shown", tolerance_deg=1.0)
    added = re.search(r"begins in motion; ([0-9.]+) s are added", "\n".join(made.comments))
    trajectory = plan(made.sequence, robot)
    times_s = np.arange(2, 40) / 10.0
    original_deg = truth_deg(robot, bus, began_ns + (times_s * NS_PER_S).astype(np.int64))
    planned_deg = trajectory.sample(times_s + (float(added[1]) if added else 0.0))
    columns = [trajectory.joints.index(name) for name in robot.joints]
    # The tolerance, and gaps of up to 0.5 s between readings: 0.9, 2.0 and 1.5 deg.
    assert np.abs(planned_deg[:, columns] - original_deg).max() < 2.2


def test_a_soft_joint_stays_where_it_was_pushed(tmp_path) -> None:
    """It holds all the time, and is told to hold anew where it is."""
    robot = load_robot(ARM)
    times_s = np.array([0.0, 1.0, 3.0, 10.0])
    hand = HandMotion(times_s, {"base": np.array([0.0, 0.0, 40.0, 40.0])})
    take = Take(("base",))
    hands_on = HandsOn(robot, ["base"], is_soft=True)

    class Pushing(HandPerson):
        def act(self, driven, now_ns):
            if driven.phase is Phase.SHOW and not self.began_ns:
                self.began_ns = now_ns
                driven.hold(["base"])
            driven.take()
            if self.began_ns and now_ns > self.began_ns + 6 * NS_PER_S:
                driven.stop()

    clock = VirtualClock()
    with connect(robot.buses, robot=robot, clock=clock, hand=hand) as connection:
        run(hands_on, connection.ports, clock, controls=Pushing(take, 6.0))
    received = lines(connection.simulated["main"])
    assert b"#1L" not in received
    assert sum(line.startswith(b"#1D") for line in received) > 5
    end_deg = truth_deg(robot, connection.simulated["main"], np.array([clock.now_ns()]))[0, 0]
    assert 20.0 < end_deg < 41.0


def test_the_command_writes_a_file_that_plays(tmp_path, capsys) -> None:
    out = tmp_path / "shown.yaml"
    options = ["--robot", str(ARM), "-o", str(out), "--seconds", "3", "--virtual", "--hand", "7"]
    assert main(["record", *options]) == 0
    said = capsys.readouterr().out
    assert "Reduced from" in said
    assert "every keyframe is on time" in said
    robot = load_robot(ARM)
    assert 3.0 <= plan(load_sequence(out, robot), robot).duration_s < 4.5
    assert main(["record", *options]) == 2  # It exists already.
    assert "--force" in capsys.readouterr().err
