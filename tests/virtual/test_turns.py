"""Joints whose servo turns further than half a turn: they are never driven in a wrong turn."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing import api
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.sim.faults import Fault, FaultKind
from tests.timed_moves import is_move

S = 1_000_000_000


def wide_robot(kit, **fields):
    return kit.robot(1, baud_bps=57600, position_min_deg=-90.0, position_max_deg=400.0, **fields)


def up_to(deg):
    frames = [(0.0, 0.0), (3.0, deg), (4.5, deg), (7.0, 0.0)]
    return Sequence(
        name="turn", keyframes=tuple(Keyframe(deg={"j0": d}, at_s=at) for at, d in frames)
    )


@pytest.mark.parametrize(
    ("low_deg", "high_deg", "zero_deg", "direction", "far_deg"),
    [(-90, 400, 0, 1, "400"), (-60, 90, 150, 1, "240"), (-60, 90, -150, -1, "-240")],
)
def test_a_range_beyond_half_a_turn_is_refused_unless_the_turn_is_known(
    stage, kit, low_deg, high_deg, zero_deg, direction, far_deg
):
    robot = kit.robot(
        1, position_min_deg=float(low_deg), position_max_deg=float(high_deg),
        zero_deg=float(zero_deg), direction=direction,
    )  # fmt: skip
    sequence = kit.sequence(1, 3.0)
    with pytest.raises(InputError, match=f"takes the servo to {far_deg} deg.*turns: by_hand"):
        api.plan(sequence, robot)
    known = replace(robot, joints={"j0": replace(robot.joints["j0"], turns="by_hand")})
    program = api.compile(api.plan(sequence, known), known)
    played = stage.play(robot, program=program)
    assert isinstance(played.result.error, InputError)
    assert not played.moves()
    assert stage.play(known, program=program).report.outcome == "finished"


def test_a_range_within_half_a_turn_needs_nothing(kit):
    whole = kit.robot(1, position_min_deg=-180.0, position_max_deg=180.0)
    api.plan(kit.sequence(1, 3.0), whole)


@pytest.mark.parametrize("deaf_s", [0.02, 0.3, 1.25])
@pytest.mark.parametrize("has_own_limits", [False, True])
def test_a_servo_that_restarted_in_another_turn_is_not_driven(stage, kit, deaf_s, has_own_limits):
    """With limits of its own a restart changes no setting of it."""

    def store(bus):
        stored = bus._servos[0].settings
        for name, value in {"SD": 1800, "AA": 60, "AD": 60, "EM": 1}.items():
            stored.eeprom[name] = stored.session[name] = value

    restart = Fault(kind=FaultKind.RESET, servo_id=1, at_s=5.0, deaf_s=deaf_s)
    played = stage.play(
        wide_robot(kit, turns="by_hand"), up_to(268.0), faults=[restart],
        on_bus=store if has_own_limits else None,
    )  # fmt: skip
    assert played.report.outcome == "fault"
    last = played.report.faults[-1]
    assert (last.joint, last.kind, last.step) == ("j0", Cause.LOST_TURN, FaultStep.HOLD)
    assert "reports -9" in last.cause
    back_ns = int((5.0 + deaf_s) * S)
    late = [ns - back_ns for ns, line in played.bus.lines if is_move(line) and ns > back_ns]
    assert max(late, default=0) < 0.1 * S
    horns = played.bus.horn_deg(np.arange(back_ns, played.bus.lines[-1][0], 5_000_000))
    assert np.ptp(horns) < 5.0, "it stays where it is"
    assert played.lines()[-1] == b"#254H\r"


def test_a_port_that_was_lost_in_a_large_move_loses_no_turn(stage, kit):
    gone = Fault(kind=FaultKind.UNPLUGGED, at_s=2.0, until_s=3.0)
    played = stage.play(wide_robot(kit, turns="powered"), up_to(390.0), faults=[gone])
    assert played.report.outcome == "finished"
    assert [fault.kind for fault in played.report.faults] == [Cause.LOST_PORT]
