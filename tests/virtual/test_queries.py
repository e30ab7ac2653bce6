"""Questions in the gaps of a show: how many fit, what they delay, and whether answers are right."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

import lss_motion as lss
from lss_motion.playing.player.estimators import DisturbanceEstimator
from lss_motion.playing.player.events import Faulted, MarkPassed, Warned
from lss_motion.playing.player.query_choice import BY_NEED
from lss_motion.playing.run import Observer, perform
from lss_motion.protocol.lss_pro import PRO_TABLE
from lss_motion.robot.on_fault import Cause
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics, Turnaround
from lss_motion.units import line_time_ns

BAUD_BPS = 115200


def slow(least_us):
    """Return a turnaround that varies by a tenth of a millisecond."""
    return Turnaround(single_min_ns=1000 * least_us, single_max_ns=1000 * least_us + 100_000)


EXACT = Physics(noise_deg=0.0)
COMMAND_US = line_time_ns(len(b"#12D-450T50\r"), BAUD_BPS) // 1000


@pytest.fixture
def believed(monkeypatch):
    """Collect what every joint believed: `(joint's Following, angle, instant)`."""
    taken = []
    take = DisturbanceEstimator.take

    def noted(self, measured_deg, read_s, **rest):
        is_believed = take(self, measured_deg, read_s, **rest)
        if is_believed:
            taken.append((self, measured_deg, read_s))
        return is_believed

    monkeypatch.setattr(DisturbanceEstimator, "take", noted)
    return taken


def reading_errors_deg(played, believed):
    """Return how far every believed angle was from the horn when its servo was asked."""
    errors = []
    tracks = played.result.player.show.joint_states.values()
    for column, track in enumerate(tracks):
        own = [(deg, read_s) for one, deg, read_s in believed if one is track.disturbance]
        horn_deg = played.bus.horn_deg([round(read_s * 1e9) for _, read_s in own])[:, column]
        errors.append(np.array([deg for deg, _ in own]) - horn_deg)
    return np.concatenate(errors)


def test_questions_fill_the_line_and_make_no_command_late(stage, kit):
    """Where every reading is wanted; a show asks by need."""
    played = stage.play(kit.robot(18, baud_bps=BAUD_BPS), kit.sequence(18, 5.0), pace=None)
    bus = played.report.buses["bus0"]
    assert bus.garbage == bus.timeouts == bus.rejected == 0
    full_hz = BAUD_BPS / 10 / len(b"*12QD-123\r")
    assert bus.query_rate_hz > 0.9 * full_hz
    assert played.report.timing.late_max_us <= COMMAND_US
    for joint in played.report.joints.values():
        assert joint.readings > 15 * played.report.played_s
        assert joint.temperature_max_c > 20.0
        assert joint.voltage_min_v > 11.0
        assert 0.05 < joint.current_max_a < 2.0


@pytest.mark.parametrize(
    "faults",
    [
        [],
        [Fault(kind=FaultKind.LOST_REPLY, ratio=0.03, at_s=0.3)],
        [Fault(kind=FaultKind.DOUBLE_REPLY, ratio=0.03, at_s=0.3)],
        [Fault(kind=FaultKind.LATE_REPLY, ratio=0.03, at_s=0.3, late_s=0.015)],
        [Fault(kind=FaultKind.LATE_REPLY, ratio=0.03, at_s=0.3, late_s=0.15)],
        [Fault(kind=FaultKind.LOST_COMMAND, ratio=0.03, at_s=1.0)],
    ],
    ids=["none", "lost", "double", "late", "very late", "unheard"],
)
@pytest.mark.parametrize("pace", [BY_NEED, None], ids=["by need", "full line"])
def test_an_accepted_reading_is_where_the_horn_was_at_the_query(stage, kit, believed, faults, pace):
    played = stage.play(kit.robot(6), kit.sequence(6, 4.0), faults=faults, physics=EXACT, pace=pace)
    errors = reading_errors_deg(played, believed)
    # Settings are read back three times a second, too.
    assert len(errors) > (250 if pace is None else 150)
    assert np.abs(errors).max() < 0.06, "the wire says tenths"


def test_servos_that_become_quicker_or_slower_are_never_mistaken(stage, kit, believed):
    """Their answers then meet on the line, until their new ways are learnt."""
    waits = [(2.5, slow(100)), (4.5, slow(4000))]
    made, garbage = [], []

    def change(event):
        if not isinstance(event, MarkPassed):
            return
        garbage.append((event.show_s, lines["bus0"].garbage))
        if waits and event.show_s > waits[0][0]:
            made[0]._answering._turnaround = waits.pop(0)[1]  # no fault changes it

    lines = {}
    played = stage.play(
        kit.robot(6),
        kit.sequence(6, 8.0),
        physics=replace(EXACT, turnaround=slow(1500)),
        on_bus=made.append,
        on_event=change,
        wishes=[(lambda player, _: True, lambda player, _: lines.update(player.lines))],
        pace=None,
    )
    assert not waits
    assert garbage[-1][1] > 0, "nothing ever met: this test shows nothing"
    assert garbage[-1][1] < 30
    assert np.abs(reading_errors_deg(played, believed)).max() < 0.06
    late = [read_s for _, _, read_s in believed if read_s > believed[-1][2] - 2.0]
    assert len(late) > 210


@pytest.mark.parametrize("latency_ms", [0, 16])
def test_an_adapter_that_holds_answers_back_is_named_with_its_remedy(stage, kit, latency_ms):
    def slow(bus):
        bus._adapter._latency_ns = latency_ms * 1_000_000

    robot = kit.robot(baud_bps=BAUD_BPS)
    played = stage.play(robot, kit.sequence(3, 3.0), on_bus=slow)
    warnings = [event.text for event in played.events if isinstance(event, Warned)]
    assert len(warnings) == bool(latency_ms)
    assert all("latency timer" in text and "ms late" in text for text in warnings)
    assert played.report.outcome == "finished"
    assert played.report.buses["bus0"].replies > (100 if latency_ms else 300)


def test_a_host_that_wakes_late_asks_less_and_still_reads_every_joint(stage, kit):
    """Questions cost a process the time that it is then short of when a move is due."""
    host = Fault(kind=FaultKind.OVERSLEEP, ratio=0.3, late_s=0.004)
    robot, show = kit.robot(6, baud_bps=BAUD_BPS), kit.sequence(6, 3.0)
    played, late = (stage.play(robot, show, faults=own, pace=None) for own in ([], [host]))
    rates_hz = [one.report.buses["bus0"].query_rate_hz for one in (played, late)]
    assert rates_hz[1] < 0.4 * rates_hz[0]
    assert late.report.outcome == "finished"
    assert not late.report.faults
    for joint in late.report.joints.values():
        assert joint.readings > 10 * late.report.played_s


def test_an_lss_pro_gets_only_queries_of_its_document_and_answers_all(stage, kit):
    robot = kit.robot(2, baud_bps=BAUD_BPS, model=SERVO_MODELS["LSS-P-S1"])
    played = stage.play(robot, kit.sequence(2, 3.0), seed=2)
    bus = played.report.buses["bus0"]
    assert bus.timeouts == bus.rejected == 0
    assert bus.replies > 150
    asked = {word for line in played.lines() if (word := line.decode()[2:-1]).startswith("Q")}
    assert {"Q", "QT", "QC", "QD"} <= asked <= set(PRO_TABLE.by_keyword)


@pytest.mark.parametrize(
    ("assumed", "own", "faults", "causes"),
    [
        (780, 779, [], set()),
        (779, 780, [Fault(kind=FaultKind.STUCK, servo_id=1, at_s=2.0)], {Cause.ERROR}),
    ],
)
def test_the_firmware_of_the_servo_tells_an_error_from_holding(
    stage, kit, assumed, own, faults, causes
):
    """Code 6 of an LSS-PRO is `holding` up to 779, `error` from 780 on, whatever the file has."""
    there = kit.robot(2, baud_bps=BAUD_BPS, model=SERVO_MODELS["LSS-P-S1"], following_deg=90.0)
    bus = there.buses["bus0"]
    robot, wired = (
        replace(there, buses={"bus0": replace(bus, pro_firmware=firmware)})
        for firmware in (assumed, own)
    )
    played = stage.play(robot, kit.sequence(2, 4.0), wired=wired, faults=faults)
    assert {event.kind for event in played.events if isinstance(event, Faulted)} == causes


class Until:
    """Ends the show at `end_s`; notes when it began."""

    def __init__(self, end_s):
        self.end_s, self.began_ns = end_s, None

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if player.show is not None:
            self.began_ns = self.began_ns or now_ns
            if player.show.show_s(now_ns) > self.end_s:
                player.stop(now_ns)


@pytest.mark.parametrize("late_s", [0.002, 0.016])
def test_a_host_that_is_always_late_still_asks_each_servo_how_it_is(late_s):
    """Moves are due at every turn; a show of 18 joints went on for minutes without one status."""
    show = Path(__file__).resolve().parents[2] / "sequences" / "hexapod_dance.yaml"
    sequence = lss.load_sequence(show)
    robot = lss.load_robot(sequence.robot_path)
    program = lss.compile(lss.plan(sequence, robot), robot)
    sleep, until = Fault(kind=FaultKind.OVERSLEEP, late_s=late_s), Until(6.0)
    observer = Observer(controls=until)
    result = perform(program, robot, is_virtual=True, faults=[sleep], observer=observer)
    received: dict[tuple[int, str], list[float]] = {}
    for at_ns, line in result.simulated["main"].lines:
        found = re.fullmatch(rb"#(\d+)(Q\w*)\r", line)
        if found and until.began_ns <= at_ns < until.began_ns + 6.0e9:
            query = (int(found[1]), found[2].decode())
            received.setdefault(query, []).append((at_ns - until.began_ns) / 1e9)
    for joint in robot.joints.values():
        for word, most_s in (("QD", 2.5), ("QSD", 1.5), ("Q", 3.5), ("QT", 6.0)):
            instants_s = [0.0, *received.get((joint.servo_id, word), []), 6.0]
            gap_s = max(b - a for a, b in pairwise(instants_s))
            assert gap_s < most_s, (joint.name, word)
