from __future__ import annotations

import json
import math

import pytest
from msgspec.structs import replace

from lss_motion.planning.program.model import Move, Program, Repeat
from lss_motion.planning.trajectory.model import SlowSpan
from lss_motion.playing.player.events import Faulted
from lss_motion.playing.player.player import Player
from lss_motion.playing.player.repertoire import Repertoire
from lss_motion.playing.report import JointReport, Report, TraceReport, make_report
from lss_motion.robot.model import Bus, Robot
from lss_motion.robot.on_fault import Cause, FaultStep
from tests.joints import joint

JOINT = joint()
BUS = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
ROBOT = Robot(name="bench", path=None, buses={"main": BUS}, joints={"j0": JOINT})
STRETCH = SlowSpan(
    from_s=3.0, to_s=3.4, by_s=0.12, joint="j0", limit="speed", authored=300.0, allowed=180.0
)


def player(**fields) -> Player:
    move = Move(due_us=0, bus="main", servo_id=1, target_wire=100, duration_ms=500)
    base = {"duration_s": 1.5, "start_deg": {"j0": 0.0}, "stretched": (STRETCH,), **fields}
    program = Program(name="wave", robot="bench", moves=(move,), tolerance_deg=0.2, **base)
    return Player(Repertoire.single(program, ROBOT), ROBOT)


def report(playing, **fields):
    base = {"run_s": 2.0, "is_simulated": True, "outcome": "finished"}
    return make_report(playing, **{**base, **fields})


def test_a_run_without_a_show_still_has_every_field_of_the_report():
    found = report(player()).to_dict()
    json.dumps(found, allow_nan=False)
    only_with_mechanisms = {"servos", "fights"}
    assert list(found) == [n for n in Report.__struct_fields__ if n not in only_with_mechanisms]
    assert found["schema"] == 1
    assert (found["sequence"], found["robot"], found["simulated"]) == ("wave", "bench", True)
    assert (found["planned_s"], found["played_s"], found["run_s"]) == (1.5, 0.0, 2.0)
    assert found["timing"]["commands"] == 0
    assert found["joints"] == {}
    (stretch,) = found["stretched"]
    assert (stretch["joint"], stretch["limit"], stretch["by_s"]) == ("j0", "speed", 0.12)


def test_a_report_prints_as_one_short_line():
    found = repr(report(player()))
    assert (
        found == "Report('wave': finished after 0.00 s, 0 joints, 0 commands, 0 missed, 0 faults)"
    )


def test_the_json_names_the_error_of_the_horns_only_where_it_is_known():
    values = dict.fromkeys(JointReport.__struct_fields__, 0)
    values |= {"trace": TraceReport(at_s=(), planned_deg=(), measured_deg=())}
    known = JointReport(**values)
    unknown = replace(known, horn_error_rms_deg=None, horn_error_max_deg=None)
    found = replace(report(player()), joints={"a": known, "b": unknown}).to_dict()
    assert set(found["joints"]["a"]) - set(found["joints"]["b"]) == {
        "horn_error_rms_deg",
        "horn_error_max_deg",
    }
    assert found["joints"]["b"] | found["joints"]["a"] == found["joints"]["a"]


def test_use_of_a_bus_is_its_bytes_over_the_run():
    playing = player()
    playing.lines["main"].send(b"#" * 1152, 0)
    bus = report(playing).buses["main"]
    assert bus.tx_utilisation_ratio == pytest.approx(0.05)
    assert (bus.queries, bus.replies, bus.timeouts, bus.garbage) == (0, 0, 0, 0)


def test_a_run_that_took_no_time_divides_by_nothing():
    bus = report(player(), run_s=0.0).buses["main"]
    assert (bus.tx_utilisation_ratio, bus.query_rate_hz) == (0.0, 0.0)


def test_an_endless_show_has_no_planned_duration():
    endless = player(duration_s=math.inf, repeat=Repeat(from_us=0, to_us=1_000_000))
    assert report(endless).planned_s is None


def test_faults_are_named():
    playing = player()
    playing.faults.append(Faulted("j0", "is stuck", Cause.STUCK, FaultStep.SLOW))
    fault = {"joint": "j0", "cause": "is stuck", "kind": "stuck", "step": "slow"}
    assert json.loads(json.dumps(report(playing).to_dict()))["faults"] == [fault]


def test_warnings_are_kept():
    assert report(player(), warnings=["it was late"]).warnings == ("it was late",)
