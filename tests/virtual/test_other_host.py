"""Another host on the bus of a show: it is reported with its servos, and noise is not."""

from __future__ import annotations

import pytest

from lss_motion.playing import api
from lss_motion.playing.player.unasked import EXCESS_MIN
from lss_motion.playing.run import perform
from lss_motion.sim.faults import Fault, FaultKind

IDS = (1, 2, 3)


def master(text, every_s, at_s=0.0):
    return Fault(kind=FaultKind.SECOND_MASTER, text=text, every_s=every_s, at_s=at_s)


LOOP = [master(f"#{servo_id}QD", 0.02, 0.005 * servo_id) for servo_id in IDS]
"""What an Arduino sends that asks one servo after the other, fifty times a second."""


@pytest.fixture(scope="module")
def played():
    """Return what plays five seconds with faults: the report, and the warnings about the bus."""
    defaults = {"model": "LSS-ST1", "range_deg": [-90, 90]}
    limits = {"speed_max_deg_s": 90, "accel_max_deg_s2": 300}
    joints = {f"joint_{servo_id}": {"id": servo_id} for servo_id in IDS}
    robot = api.load_robot({"robot": "three", "defaults": defaults | limits, "joints": joints})
    still = dict.fromkeys(joints, 0)
    keyframes = [{"at_s": 0, "deg": still}, {"at_s": 5, "deg": {"joint_1": 30}}]
    sequence = api.load_sequence({"sequence": "short", "keyframes": keyframes}, robot)
    program = api.compile(api.plan(sequence, robot), robot)

    def play(*faults, **options):
        report = perform(program, robot, is_virtual=True, faults=faults, **options).report
        assert report.outcome == "finished"
        texts = [text for text in report.warnings if text.startswith("bus main: ")]
        return report.buses["main"], texts

    return play


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        (LOOP, "servos 1, 2, 3 sent"),
        ([master("#2QV", 0.3)], "servo 2 sent"),
        ([master("#254QD", 0.1)], "unreadable bytes come that this program did not ask for"),
    ],
    ids=["loop", "one servo", "all at once"],
)
def test_another_host_is_reported_once_with_what_it_asks(played, faults, said):
    bus, (text,) = played(*faults)
    assert said in text
    assert bus.unasked > EXCESS_MIN


def test_another_host_is_noticed_by_a_show_without_feedback(played):
    bus, (text,) = played(*LOOP, has_feedback=False, is_forced=True)
    assert "servos 1, 2, 3 sent" in text
    assert bus.unasked > 100


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "fault",
    [
        Fault(kind=FaultKind.CORRUPT_REPLY, ratio=0.1),
        Fault(kind=FaultKind.LOST_REPLY, ratio=0.1),
        Fault(kind=FaultKind.LATE_REPLY, ratio=0.03, late_s=0.08),
        Fault(kind=FaultKind.WRONG_ID, ratio=0.1, servo_id=1, as_id=2),
        Fault(kind=FaultKind.CORRUPT_COMMAND, ratio=0.05),
    ],
    ids=lambda fault: fault.kind.value,
)
def test_damaged_lost_late_and_mistaken_replies_are_no_other_host(played, fault, seed):
    bus, texts = played(fault, seed=seed)
    assert (texts, bus.unasked) == ([], 0)
    assert bus.timeouts > 0
