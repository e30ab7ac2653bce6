from __future__ import annotations

import pytest
from msgspec.structs import replace

from lss_motion.playing.player.faults import RESUMES_MAX, SLOW_RATE_LEAST, FaultEscalation
from lss_motion.robot.on_fault import Cause, FaultStep

S = 1_000_000_000
ASTRAY = ("j0", Cause.ASTRAY)
SILENT = ("j0", Cause.SILENT)


def ladder(kit, show=None, **fields):
    return FaultEscalation(kit.robot(kit.joint(), patience_s=2.0, **fields), show or {})


def steps(taken):
    return [fault.step for fault in taken]


def test_the_next_step_is_taken_when_the_trouble_lasts(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.WARN, FaultStep.SLOW, FaultStep.HOLD)})
    active_faults = {ASTRAY: "is astray"}
    assert steps(climb.judge(active_faults, 0)) == [FaultStep.WARN]
    assert climb.rate_max == 1.0
    assert climb.wakeups_ns() == [2 * S]
    assert climb.judge(active_faults, 2 * S - 1) == []
    assert steps(climb.judge(active_faults, 2 * S)) == [FaultStep.SLOW]
    assert steps(climb.judge(active_faults, 4 * S)) == [FaultStep.HOLD]
    assert climb.judge(active_faults, 9 * S) == []
    assert [(f.kind, f.step) for f in climb.faults] == [(Cause.ASTRAY, FaultStep.HOLD)]


def test_the_show_gets_slower_until_the_joint_is_back_and_then_faster_again(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.SLOW,)})
    rates = []
    for tick in range(40):
        climb.judge({ASTRAY: "is astray"} if 2 <= tick < 20 else {}, tick * S // 4)
        rates.append(climb.rate_max)
    assert rates[:2] == [1.0, 1.0]
    assert rates[2:8:2] == [0.5, 0.25, 0.125]
    assert min(rates) == SLOW_RATE_LEAST
    assert rates[-1] == 1.0
    assert climb.wakeups_ns() == []


def test_a_trouble_that_is_over_begins_at_the_foot_again(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.WARN, FaultStep.HOLD)})
    for at_s in range(0, 20, 2):
        assert steps(climb.judge({ASTRAY: "is astray"}, at_s * S)) == [FaultStep.WARN]
        climb.judge({}, (at_s + 1) * S)
    assert len(climb.faults) == 1


@pytest.mark.parametrize(
    ("joint", "show", "robot", "taken"),
    [
        ({}, {}, {}, FaultStep.SLOW),
        ({}, {}, {Cause.ASTRAY: (FaultStep.HOLD,)}, FaultStep.HOLD),
        ({}, {Cause.ASTRAY: (FaultStep.WARN,)}, {Cause.ASTRAY: (FaultStep.HOLD,)}, FaultStep.WARN),
        ({Cause.ASTRAY: (FaultStep.LIMP,)}, {Cause.ASTRAY: (FaultStep.WARN,)}, {}, FaultStep.LIMP),
        ({Cause.STUCK: (FaultStep.LIMP,)}, {}, {Cause.ASTRAY: (FaultStep.HOLD,)}, FaultStep.HOLD),
    ],
)
def test_the_joint_wins_over_the_show_and_the_show_over_the_robot(kit, joint, show, robot, taken):
    one = replace(kit.joint(), on_fault=joint)
    climb = FaultEscalation(kit.robot(one, on_fault=robot), show)
    assert steps(climb.judge({ASTRAY: "is astray"}, 0)) == [taken]


def test_a_servo_that_comes_and_goes_is_waited_for_only_so_often(kit):
    climb = ladder(kit)
    taken = []
    for turn in range(RESUMES_MAX + 1):
        taken += steps(climb.judge({SILENT: "is silent"}, turn * S))
        climb.clear()
    assert taken == [FaultStep.RESUME] * RESUMES_MAX + [FaultStep.HOLD]


def test_what_does_not_come_back_ends_the_show_at_the_least(kit):
    assert ladder(kit).give_up("j0", Cause.SILENT, "is silent").step is FaultStep.HOLD
    only = ladder(kit, on_fault={Cause.SILENT: (FaultStep.RESUME,)})
    assert only.give_up("j0", Cause.SILENT, "is silent").step is FaultStep.HOLD
    limp = ladder(kit, on_fault={Cause.SILENT: (FaultStep.RESUME, FaultStep.LIMP)})
    assert limp.give_up("j0", Cause.SILENT, "is silent").step is FaultStep.LIMP


def test_it_is_idle_when_nothing_is_wrong_and_nothing_is_left_to_be_made_good(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.SLOW,)})
    assert climb.is_idle is True
    climb.judge({ASTRAY: "is astray"}, 0)
    assert climb.is_idle is False
    climb.judge({}, S)
    assert climb.is_idle is False, "the show is still slow"
    climb.judge({}, 2 * S)
    assert climb.rate_max == 1.0
    climb.judge({}, 3 * S)
    assert climb.is_idle is True


def test_it_wakes_up_for_the_next_change_of_the_rate_or_the_next_step_whichever_is_first(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.SLOW, FaultStep.HOLD)})
    climb.judge({ASTRAY: "is astray"}, S)
    assert min(climb.wakeups_ns()) == S + S // 2
    climb.judge({ASTRAY: "is astray"}, 5 * S // 2)
    assert min(climb.wakeups_ns()) == 3 * S
    climb.judge({ASTRAY: "is astray"}, 3 * S)
    assert min(climb.wakeups_ns()) == 7 * S // 2


def test_the_show_becomes_faster_as_it_became_slower(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.SLOW,)})
    rates = []
    for turn in range(7):
        climb.judge({ASTRAY: "is astray"} if turn < 3 else {}, turn * S)
        rates.append(climb.rate_max)
    assert rates == [0.5, 0.25, 0.125, 0.125, 0.25, 0.5, 1.0]


def test_what_was_put_right_is_forgotten(kit):
    climb = ladder(kit, on_fault={Cause.ASTRAY: (FaultStep.SLOW, FaultStep.HOLD)})
    climb.judge({ASTRAY: "is astray"}, 0)
    climb.clear()
    assert (climb.rate_max, climb.wakeups_ns(), climb.is_idle) == (1.0, [], True)
    assert steps(climb.judge({ASTRAY: "is astray"}, 2 * S)) == [FaultStep.SLOW]


def test_a_servo_waited_for_too_often_gets_the_other_steps_of_its_ladder(kit):
    climb = ladder(kit, on_fault={Cause.SILENT: (FaultStep.WARN, FaultStep.RESUME, FaultStep.LIMP)})
    for _ in range(RESUMES_MAX):
        climb.judge({SILENT: "is silent"}, 0)
        climb.clear()
    taken = [steps(climb.judge({SILENT: "is silent"}, at_s * S)) for at_s in (0, 2, 4)]
    assert taken == [[FaultStep.WARN], [FaultStep.LIMP], []]


def test_a_silent_servo_that_was_not_waited_for_is_resumed_when_it_answers_so_often(kit):
    climb = ladder(kit, on_fault={Cause.SILENT: (FaultStep.WARN,)})
    climb.judge({SILENT: "is silent"}, 0)
    assert climb.answering_again({SILENT}) == set(), "it is silent still"
    resumed = [climb.answering_again(()) for _ in range(RESUMES_MAX + 1)]
    assert resumed == [{"j0"}] * RESUMES_MAX + [set()]


def test_a_silent_servo_is_not_resumed_where_a_restart_ends_the_show(kit):
    climb = ladder(
        kit, on_fault={Cause.SILENT: (FaultStep.WARN,), Cause.RESTARTED: (FaultStep.HOLD,)}
    )
    climb.judge({SILENT: "is silent"}, 0)
    assert climb.answering_again(()) == set()


def test_of_each_trouble_the_farthest_step_is_kept_with_its_latest_words(kit):
    climb = ladder(kit)
    assert climb.note("j0", Cause.SILENT, "is silent", FaultStep.HOLD).step is FaultStep.HOLD
    climb.note("j0", Cause.SILENT, "is silent again", FaultStep.HOLD)
    climb.note("j0", Cause.SILENT, "is silent once more", FaultStep.WARN)
    climb.note("j0", Cause.ASTRAY, "is astray", FaultStep.WARN)
    assert [(fault.kind, fault.cause, fault.step) for fault in climb.faults] == [
        (Cause.SILENT, "is silent again", FaultStep.HOLD),
        (Cause.ASTRAY, "is astray", FaultStep.WARN),
    ]
