"""Every state of the conductor with every input: the table of its module, executed."""

import pytest
from msgspec.structs import replace

from benches.stage_model import World, reported
from lss_motion.errors import InputError
from lss_motion.stage.hosts.conductor import (
    ARM_S,
    AWAY_S,
    CONNECT_S,
    FALLEN_S,
    LEAVE_S,
    OVER_S,
    READY_S,
    ConductorState,
)
from lss_motion.stage.hosts.messages import hash_of
from lss_motion.units import NS_PER_S

C, S, L, R, A, P = (
    ConductorState.CONNECTING,
    ConductorState.STANDING,
    ConductorState.LEAVING,
    ConductorState.READYING,
    ConductorState.ARMING,
    ConductorState.PLAYING,
)
SHOW_S = 20.0


def never(_now_ns):
    """A player that does not end, whatever it is told."""
    return reported("playing", 1.0)


def connecting():
    world = World(3, seed=1, show_s=SHOW_S)
    world.hosts["f1"].is_cut = True
    world.run(1.0)
    return world


def standing():
    world = World(3, seed=1, show_s=SHOW_S)
    world.wait(S)
    return world


def leaving():
    world = playing()
    world.conductor.leave(world.now_ns)
    return world


def readying():
    world = World(3, seed=1, show_s=SHOW_S)
    world.verify_ns = 5 * NS_PER_S
    world.wait(S)
    world.play()
    world.wait(R)
    return world


def arming():
    world = standing()
    world.play()
    world.wait(A)
    return world


def playing():
    world = standing()
    world.go()
    world.run(2.0)
    return world


MAKE = {C: connecting, S: standing, L: leaving, R: readying, A: arming, P: playing}
TABLE = {
    # state: (play, leave, connect, stop)
    C: (L, C, C, C),
    S: (L, S, C, S),
    L: (L, L, L, L),
    R: (L, L, L, S),
    A: (L, L, L, S),
    P: (L, L, L, S),
}
INPUTS = ("play", "leave", "connect", "stop")


def put(world, name):
    if name == "play":
        world.play()
    else:
        getattr(world.conductor, name)(world.now_ns)


@pytest.mark.parametrize("state", list(ConductorState))
@pytest.mark.parametrize("name", INPUTS)
def test_each_input_in_each_state_leads_where_the_table_says(state, name):
    world = MAKE[state]()
    assert world.conductor.state is state
    running = world.conductor._wish
    world.told.clear()
    put(world, name)
    assert world.conductor.state is TABLE[state][INPUTS.index(name)]
    answered = [one[1] for one in world.told]
    changes = name in ("play", "stop") or state in (R, A, P)
    is_over = running is not None and changes
    assert answered == ([running.number] if is_over else [])
    assert world.conductor.legs.newest is None
    assert world.conductor.wanted != "armed"
    if state in (A, P):
        assert world.conductor.wanted == "stopped"


@pytest.mark.parametrize("state", list(ConductorState))
def test_a_show_can_be_played_from_every_state(state):
    world = MAKE[state]()
    world.hosts["f1"].is_cut = False
    world.play()
    number = world._number
    world.wait(P, seconds=60.0)
    assert world.run(3.0, lambda: world.states() == {"playing"})
    assert number not in [one[1] for one in world.told if one[0] in ("refused", "left")]


@pytest.mark.parametrize("state", list(ConductorState))
def test_silence_ends_every_state_but_the_two_that_wait_for_it(state):
    """All lines are cut: whatever the conductor did, it then stands or waits for its figures."""
    world = MAKE[state]()
    for host in world.hosts.values():
        host.is_cut = True
    longest_s = max(LEAVE_S, READY_S, ARM_S, SHOW_S + OVER_S, AWAY_S + 5.0)
    world.run(longest_s + 5.0)
    assert world.conductor.state is (C if state is C else S)
    if state in (R, A, P):
        assert len([one for one in world.told if one[0] != "connected"]) == 1
    for host in world.hosts.values():
        host.is_cut = False
    world.go()


@pytest.mark.parametrize("state", list(ConductorState))
@pytest.mark.parametrize("name", ["pause", "set_rate", "seek"])
def test_a_show_is_steered_only_while_it_plays(state, name):
    world = MAKE[state]()
    conductor, now_ns = world.conductor, world.now_ns
    calls = {
        "pause": lambda: conductor.pause(now_ns),
        "set_rate": lambda: conductor.set_rate(0.5, now_ns),
        "seek": lambda: conductor.seek(3.0, now_ns),
    }
    if state is P:
        calls[name]()
        assert conductor.legs.newest.number == 2
    else:
        with pytest.raises(InputError, match="no show plays"):
            calls[name]()
    assert conductor.state is state


@pytest.mark.parametrize("state", [A, P])
def test_figures_that_follow_another_conductor_end_a_show(state):
    world = MAKE[state]()
    host = world.hosts["f1"]
    world.told.clear()

    def report():
        status = host.figure.status(host.now_ns())
        elsewhere = {"epoch": world.conductor.epoch + 3, "follows": "e" * 16}
        world.conductor.take_status(replace(status, **elsewhere), world.now_ns)

    host.is_cut = True
    for _ in range(12):
        report()
        world.run(0.1)
    assert world.conductor.state is S
    assert [one[0] for one in world.told] == ["left"]
    world.play()
    world.run(LEAVE_S + 5.0)
    assert "conducts no more" in world.told[-1][2]


def test_the_ends_of_each_state_that_figures_cause():
    world = connecting()
    world.conductor.others = "go_on"
    world.run(CONNECT_S + 1.0)
    assert (world.conductor.state, world.told[-1]) == (S, ("connected", "begins without f1"))

    world = playing()
    world.hosts["f1"].player.tick = never
    world.play()
    assert world.run(LEAVE_S + 1.0, lambda: world.conductor.state is S)
    assert world.told[-1] == ("refused", 2, "f1 does not stop")

    world = World(2, seed=2, robots={"f1": hash_of(b"another robot")})
    world.play()
    assert world.run(READY_S + 2.0, lambda: world.conductor.state is S)
    assert "f1: out: its robot file differs" in world.told[-1][2]

    for report, is_fault in (
        (reported("failed", text="stuck", cause="stuck"), True),
        (reported("failed", text="the port is gone"), False),
    ):
        world = arming()
        world.hosts["f1"].player.tick = lambda _, report=report: report
        world.wait(L, S, seconds=5.0)
        assert world.told[-1][0] == ("faulted" if is_fault else "refused")
        assert report.text in world.told[-1][2]

    world = arming()
    world.hosts["f1"].player.tick = lambda _: reported("starting")
    assert world.run(ARM_S + 1.0, lambda: world.conductor.state is S)
    assert world.told[-1][:2] == ("refused", 1)

    world = playing()
    assert world.run(SHOW_S + 2.0, lambda: world.conductor.state is S)
    assert (world.told[-1], world.conductor.wanted) == (("finished", 1, None), "ready")

    world = playing()
    world.hosts["f1"].player.becomes("failed", text="stuck", cause="stuck")
    assert world.run(FALLEN_S + 3.0, lambda: world.conductor.state is L)
    assert world.told[-1][0] == "faulted"
    assert world.run(3.0, lambda: world.conductor.state is S)
    world.conductor.connect(world.now_ns)
    assert world.run(3.0, lambda: world.conductor.state is S)
    assert world.told[-1] == ("connected", "all figures are there")


def test_a_stage_that_fell_connects_again_when_all_have_stopped():
    world = playing()
    world.conductor.connect(world.now_ns)
    assert world.conductor.state is L
    assert world.told[-1][0] == "left"
    seen = []
    assert world.run(5.0, lambda: seen.append(world.conductor.state) or seen[-1] is S)
    assert list(dict.fromkeys(seen)) == [L, C, S]
