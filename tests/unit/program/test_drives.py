"""The choice of drives for `drive: auto`, and robots with several drives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.model import Driving
from lss_motion.planning.program.verify import profiles, verify_program
from lss_motion.robot.model import Response
from lss_motion.robot.servo_models import SERVO_MODELS


def test_a_mixed_robot_shares_its_line_without_overlap_and_passes_the_verifier(kit):
    robot = kit.mixed()
    program, _ = kit.compiled(robot)
    assert program.line_use["main"].overlaps == 0
    assert program.drives == {"j1": Driving("streamed", 4), "j2": Driving("stepped")}
    assert max(len(move.data) for move in program.moves) <= 16
    verify_program(program, robot)
    jump = program.moves[-1]._replace(servo_id=209, target_wire=800, duration_ms=None)
    with pytest.raises(PlanningError, match="'j2' would jump faster than 180 deg/s"):
        verify_program(replace(program, moves=(*program.moves, jump)), robot)
    far = program.moves[-1]._replace(servo_id=2, target_wire=850, duration_ms=None)
    with pytest.raises(PlanningError, match=r"'j1' would reach .* allowed 180 deg/s"):
        verify_program(replace(program, moves=(*program.moves, far)), robot)


def test_a_repeated_pass_leaves_no_step_behind(kit):
    robot = kit.mixed()
    names = list(robot.joints)
    rows = [(at_s, dict.fromkeys(names, 37.4 * math.sin(at_s))) for at_s in (0.0, 0.7, 1.4, 2.2)]
    plan = kit.plan(kit.keys(*rows, (3.0, dict.fromkeys(names, 0.0)), loop=None), robot)
    program = compile_program(plan, robot)
    repeat = program.repeat
    period_us = repeat.to_us - repeat.from_us
    again = [m for m in program.moves if m.due_us >= repeat.from_us]
    passes = [m._replace(due_us=m.due_us + n * period_us) for n in range(1, 4) for m in again]
    longer = replace(program, moves=(*program.moves, *passes))
    late_s = repeat.from_us / 1e6 + np.arange(0.1, period_us / 1e6, 0.01)
    for name, curve in profiles(longer, robot).items():
        first = curve.sample(late_s)
        third = curve.sample(late_s + 2 * period_us / 1e6)
        allowed = {"j0": 0.6, "j1": 1.6, "j2": 1.01}[name]
        assert np.abs(third - first).max() < allowed, name


def test_auto_takes_the_drive_that_predicts_best_and_gives_the_reason(kit):
    auto = {"drive": "auto"}
    robot = kit.robot(
        kit.joint("plain", 1, **auto),
        kit.joint("jerky", 2, response=Response(retarget="from_rest"), **auto),
        kit.joint("hasty", 3, accel_max_deg_s2=1500.0, **auto),
        kit.joint("rc", 209, model=SERVO_MODELS["LSS-2IO"], **auto),
        kit.joint("pro", 5, model=SERVO_MODELS["LSS-P-S1"], **auto),
    )
    program, _ = kit.compiled(robot)
    chosen = {name: driving.drive for name, driving in program.drives.items()}
    assert chosen == {"jerky": "streamed", "hasty": "streamed", "rc": "stepped"}
    reasons = program.drive_reasons
    assert reasons["plain"].startswith("timed: timed predicts 0.")
    assert "1500 deg/s² is more than its ramps can express, 1000" in reasons["hasty"]
    assert "supports no other drive" in reasons["rc"]
    assert "supports no other drive" in reasons["pro"]


def test_auto_gives_up_streaming_where_the_line_has_no_room_for_it(kit):
    jerky = Response(retarget="from_rest")
    joints = [kit.joint(f"j{n}", n + 1, drive="auto", response=jerky) for n in range(6)]
    wide, _ = kit.compiled(kit.robot(*joints), tolerance_deg=0.5)
    assert len(wide.drives) == 6
    narrow, _ = kit.compiled(kit.robot(*joints, baud_bps=9600), tolerance_deg=0.5, swing_deg=12.0)
    given_up = [n for n in narrow.drive_reasons if n not in narrow.drives]
    assert given_up
    assert "the line has no room to stream it" in narrow.drive_reasons[given_up[0]]


def test_auto_never_streams_with_firmware_that_has_no_filter(kit):
    robot = kit.robot(kit.joint(drive="auto", response=Response(retarget="from_rest")))
    bus = replace(robot.buses["main"], firmware=367)
    program, _ = kit.compiled(replace(robot, buses={"main": bus}), tolerance_deg=1.0)
    assert not program.drives
    assert program.drive_reasons["j0"] == "timed: streaming needs firmware 368"
