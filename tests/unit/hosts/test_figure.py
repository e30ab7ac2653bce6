"""Every place of a figure's table, executed: what is wanted of it, and what its player does."""

import re
from typing import get_args

import pytest
from msgspec.structs import replace

from benches.stage_model import reported
from lss_motion.stage.hosts import figure as module
from lss_motion.stage.hosts.clocks import ClockEstimate
from lss_motion.stage.hosts.figure import (
    TABLE,
    ArmPlayer,
    Deed,
    Does,
    FollowingFigure,
    FollowLeg,
    StopPlayer,
    Wants,
)
from lss_motion.stage.hosts.messages import Cast, ConductorBeat, NetworkLeg, Part, hash_of, packed
from lss_motion.units import NS_PER_S

ROBOT = hash_of(b"robot")
PLAN = b"a plan"
CAST = Cast(show="x", duration_s=60.0, parts={"f1": Part(plan=hash_of(PLAN), robot=ROBOT)})
NOW_NS = 100 * NS_PER_S
CONDUCTOR = "c" * 16
CLOCK = ClockEstimate(offset_ns=0, bound_ns=1000, rate_ratio=0.0, at_ns=0)
STARTED = ("starting", "standing", "playing")
PLACES = [(wants, does) for wants in get_args(Wants) for does in get_args(Does)]


def beat(count, wanted, **fields):
    return ConductorBeat(
        conductor="f0",
        epoch=1,
        instance=CONDUCTOR,
        count=count,
        wanted=wanted,
        run=1,
        cast=hash_of(packed(CAST)),
        **fields,
    )


def placed(wants, does, *, is_prepared=True):
    """A figure of which this is wanted and whose player does this; its last turn is over."""
    figure = FollowingFigure(name="f1", conductor="f0", robot=ROBOT, instance="a" * 16, version="x")
    start_ns = NOW_NS - NS_PER_S // 10
    if wants != "unknown":
        leg = NetworkLeg(number=1, instant_ns=NOW_NS - NS_PER_S, show_s=0.0, rate=1.0)
        is_led = wants in ("lost", "the run", "armed")
        figure.take_beat(beat(1, "ready"), start_ns)
        if is_prepared:
            figure.take_content(packed(CAST))
            figure.take_content(PLAN)
            figure.take_verified(hash_of(PLAN), "")
            figure.take_clock(CLOCK, 0)
        wanted = {"lost": "armed", "the run": "armed"}.get(wants, wants)
        figure.take_beat(beat(2, wanted, leg=leg if is_led else None), start_ns)
        if wants in ("lost", "the run"):
            figure._armed_run = (1, 1)
        if wants == "lost":
            figure.take_lost()
    figure.take_player(reported(does, 0.9, text="stuck" if does == "failed" else ""))
    figure._first_ns = start_ns if does == "playing" else None
    return figure


def kinds(actions):
    return [type(action) for action in actions]


def test_the_table_of_the_docstring_is_the_one_of_the_code():
    rows = {}
    for line in module.__doc__.splitlines():
        cells = re.split(r" {2,}", line.strip())
        if len(cells) == 7 and cells[0] in TABLE:
            rows[cells[0]] = cells[1:]
    assert list(rows) == list(get_args(Wants)) == list(TABLE)
    for wants, (without, *others) in rows.items():
        found = TABLE[wants]
        assert set(found) == set(get_args(Does))
        names = {deed: deed.name for deed in Deed}
        words = {does: names.get(one, one) for does, one in found.items()}
        told = [words["starting"], words["standing"], words["playing"], words["stopping"]]
        assert [*told, words["failed"]] == others
        ended = [words["none"], words["ended"]]
        assert without == (ended[0] if ended[0] == ended[1] else f"{ended[0]}; or {ended[1]}")


@pytest.mark.parametrize(("wants", "does"), PLACES)
def test_each_place_of_the_table(wants, does):
    figure, found = placed(wants, does), TABLE[wants][does]
    assert figure._wants(NOW_NS) == wants
    assert figure.player.does(figure._first_ns, NOW_NS) == does
    actions = figure.tick(NOW_NS)
    expected = {
        Deed.STOP: ("stopping", [StopPlayer]),
        Deed.PREPARE: ("ready", []),
        Deed.ARM: ("arming", [ArmPlayer]),
        Deed.FOLLOW: ("playing" if does == "playing" else "armed", [FollowLeg]),
        Deed.FREEWHEEL: ("freewheeling", []),
    }.get(found, (found, []))
    assert (figure.state, kinds(actions)) == expected
    assert kinds(figure.tick(NOW_NS + 1)) == []
    status = figure.status(NOW_NS)
    assert status.state == figure.state
    assert (status.show_s is not None) == (does in ("standing", "playing"))
    if (wants, does) == ("the run", "failed"):
        assert status.text == "stuck"


@pytest.mark.parametrize("wants", ["ready", "armed"])
def test_what_is_not_prepared_is_not_armed(wants):
    figure = placed(wants, "none", is_prepared=False)
    assert kinds(figure.tick(NOW_NS)) == [module.Fetch]
    assert figure.state == "fetching"
    figure.take_content(packed(CAST))
    figure.take_content(PLAN)
    figure.take_verified(hash_of(PLAN), "too fast")
    figure.tick(NOW_NS)
    assert (figure.state, figure.text) == ("out", "the plan does not fit this robot: too fast")


@pytest.mark.parametrize(("wants", "does"), PLACES)
def test_silence_ends_every_place_in_a_state_of_its_own(wants, does):
    """No beat comes any more: no player is started, and one that moves holds or ends."""
    figure = placed(wants, does)
    seen, now_ns = [], NOW_NS + 2 * NS_PER_S
    for _ in range(20):
        now_ns += NS_PER_S // 2
        seen += kinds(figure.tick(now_ns))
    is_led = wants in ("lost", "the run") and does == "playing"
    if is_led:
        assert figure.state == "freewheeling"
        figure.take_player(reported("playing", 1.0, stands=True))
        figure.tick(now_ns)
        assert figure.state == "holding"
        assert seen.count(StopPlayer) == 0
    elif does in STARTED:
        assert figure.state == "stopping"
        assert seen.count(StopPlayer) > 5
        figure.take_player(reported("none"))
        figure.tick(now_ns)
        assert figure.state in ("alone", "idle", "stopped")
    else:
        resting = {"nothing": "idle", "stopped": "stopped"}.get(wants, "alone")
        assert figure.state == ("stopping" if does == "stopping" else resting)
    assert ArmPlayer not in seen


@pytest.mark.parametrize(("wants", "does"), PLACES)
def test_every_place_is_left_when_the_conductor_begins_another_run(wants, does):
    figure = placed(wants, does)
    figure.tick(NOW_NS)
    now_ns = NOW_NS + NS_PER_S
    later = replace(beat(50, "armed"), run=2)
    for count in range(4):
        figure.take_beat(replace(later, count=50 + count), now_ns)
        if wants == "unknown":
            figure.take_content(packed(CAST))
            figure.take_content(PLAN)
            figure.take_verified(hash_of(PLAN), "")
        figure.take_clock(CLOCK, 0)
        actions = figure.tick(now_ns)
        if StopPlayer in kinds(actions) or does == "stopping":
            figure.take_player(reported("none"))
            does = "none"
        if ArmPlayer in kinds(actions):
            break
        now_ns += NS_PER_S // 4
    assert figure.state == "arming"
