"""Every change of the phase is a row of the table, and every row is a change that a run makes."""

from __future__ import annotations

from msgspec.structs import replace

from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.playing.player.phases import TRANSITIONS
from lss_motion.playing.run import Observer, perform
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sim.faults import Fault, FaultKind
from tests.virtual.test_stage import add, change, figure, repertoire, shows, stop

S = 1_000_000_000
made: set[tuple[Phase, Phase]] = set()
"""The changes of all runs of this file."""


class Script:
    """Does one act after the other, each as soon as its condition holds."""

    def __init__(self, acts):
        self.acts, self.phases = list(acts), []

    def filenos(self):
        return []

    def act(self, player, now_ns):
        assert now_ns < 20 * S, f"{len(self.acts)} acts were not done; {self.phases}"
        while self.acts and self.acts[0][0](player, now_ns):
            self.acts.pop(0)[1](player, now_ns)

    def on_event(self, event):
        if isinstance(event, PhaseEntered):
            self.phases.append(event.phase)


def played(acts, *, what=None, robot=None, **options):
    """Play the repertoire of the stage, or `what`; return the changes of the phase."""
    script, first = Script(acts), {} if what is not None else {"first": None}
    perform(
        what or repertoire(), robot or figure(), is_virtual=True, is_recorded=what is not None,
        observer=Observer(controls=script, on_event=script.on_event), **first, **options,
    )  # fmt: skip
    assert not script.acts, f"{len(script.acts)} acts were not done; {script.phases}"
    changes = list(zip(script.phases, script.phases[1:], strict=False))
    assert [one for one in changes if one[1] not in TRANSITIONS[one[0]]] == []
    made.update(changes)
    return changes


def on(phase, after_s=0.0):
    """Return the condition that the player has been in a phase for so long."""
    since = []

    def holds(player, now_ns):
        if player.phase is not phase:
            since.clear()
            return False
        since.append(now_ns)
        return now_ns - since[0] >= after_s * S

    return holds


def asked(phase):
    """Return the condition that the servos are asked in a phase, and no joint moves."""
    return lambda player, _: player.phase is phase and player.moving is None


def abort(player, now_ns):
    player.abort(now_ns)


def seek(player, now_ns):
    player.seek(1.5, now_ns)


def both(*acts):
    def act(player, now_ns):
        for one in acts:
            one(player, now_ns)

    return act


def reset(at_s, servo_id=2):
    return [Fault(kind=FaultKind.RESET, at_s=at_s, servo_id=servo_id)]


def way_to(phase):
    """Return the acts, faults and options that lead to a phase, of one show or of many."""
    many = {"acts": [(on(Phase.STANDING, 0.1), change("hello"))]}
    return {
        Phase.CONNECT: {},
        Phase.READY: {"must_ask": True},
        Phase.PREPARE: {},
        Phase.APPROACH: {},
        Phase.STANDING: {},
        Phase.SHOW: many,
        Phase.SEEK: {"acts": [*many["acts"], (on(Phase.SHOW, 1.0), change("wave"))]},
        Phase.RECOVER: {"faults": reset(1.5)},
        Phase.STOP: {"acts": [*many["acts"], (on(Phase.SHOW, 1.0), stop)]},
        Phase.RESTORE: {"acts": [(on(Phase.STANDING, 0.1), stop)]},
        Phase.DONE: {"acts": [(on(Phase.STANDING, 0.1), abort)]},
    }[phase]


def an_abort_ends_each_phase_at_once(phase):
    given = way_to(phase)
    changes = played([*given.pop("acts", []), (on(phase), abort)], **given)
    assert changes[-1] == (phase, Phase.DONE)


def an_abort_after_an_abort_sends_the_last_bytes_once_more():
    assert played([(on(Phase.STANDING), both(abort, abort))])[-1] == (Phase.DONE, Phase.DONE)


def a_stop_brakes_what_moves_and_gives_the_settings_back(phase):
    given = way_to(phase)
    after_s = 0.05 if phase in (Phase.SEEK, Phase.SHOW) else 0.0
    changes = played([*given.pop("acts", []), (on(phase, after_s), stop)], **given)
    assert changes[-1] == (Phase.RESTORE, Phase.DONE)
    moves = phase in (Phase.APPROACH, Phase.STANDING, Phase.SHOW, Phase.SEEK, Phase.RECOVER)
    assert ((phase, Phase.STOP) in changes) == moves


def a_stop_while_servos_are_asked_needs_no_brake():
    hello = shows()["hello"]
    assert (Phase.APPROACH, Phase.RESTORE) in played([(asked(Phase.APPROACH), stop)], what=hello)
    changes = played([(asked(Phase.APPROACH), both(seek, stop))], what=hello)
    assert changes[-2:] == [(Phase.SEEK, Phase.RESTORE), (Phase.RESTORE, Phase.DONE)]
    lost = [(on(Phase.APPROACH, 0.05), lose_port), (on(Phase.RECOVER, 0.2), find_port)]
    changes = played([*lost, (asked(Phase.RECOVER), stop)], what=hello)
    assert (Phase.RECOVER, Phase.RESTORE) in changes


def one_show_is_begun_by_a_person_and_sent_to_another_place():
    acts = [
        (on(Phase.READY), lambda player, _: player.go()),
        (on(Phase.APPROACH, 0.1), seek),
        (on(Phase.SHOW, 0.5), seek),
    ]
    changes = played(acts, what=shows()["hello"], must_ask=True)
    assert changes[-1] == (Phase.RESTORE, Phase.DONE)
    assert (Phase.SHOW, Phase.RESTORE) in changes


def many_shows_follow_each_other():
    changes = played([
        (on(Phase.STANDING, 1.0), change(None)),
        (on(Phase.STANDING, 0.5), change("hello")),
        (on(Phase.APPROACH, 0.2), change("wave")),
        (on(Phase.SHOW, 0.0), change("hello")),  # Its joints rest yet.
        (on(Phase.SHOW, 1.0), change(None)),
        (on(Phase.STANDING, 0.5), change("wave")),
        (on(Phase.STANDING, 0.5), add("eyes")),
        (on(Phase.STANDING, 2.0), change("eyes")),  # First it ends beside.
        (on(Phase.SHOW, 0.5), stop),
    ])  # fmt: skip
    assert (Phase.STANDING, Phase.STANDING) in changes
    assert (Phase.SEEK, Phase.STANDING) in changes
    assert (Phase.SHOW, Phase.STANDING) in changes


def lose_port(player, now_ns):
    player.port_lost("main", "unplugged", now_ns)


def find_port(player, _):
    player.port_found("main")


def a_port_that_comes_back_leads_on_from_each_phase(phase):
    given = way_to(phase)
    changes = played([
        *given.pop("acts", []),
        (on(phase, 0.05), lose_port),
        (on(Phase.RECOVER, 0.2), lose_port),
        (on(Phase.RECOVER, 0.2), find_port),
        (on(Phase.PREPARE), lose_port),
        (on(Phase.RECOVER, 0.2), find_port),
        (on(Phase.SHOW if phase in (Phase.SHOW, Phase.SEEK) else Phase.STANDING, 0.5), stop),
    ])  # fmt: skip
    assert (phase, Phase.RECOVER) in changes
    assert (Phase.RECOVER, Phase.RECOVER) in changes
    assert (Phase.PREPARE, Phase.RECOVER) in changes


def a_port_for_which_nothing_waits_ends_the_run_from_each_phase(phase):
    robot, given = replace(figure(), on_fault={Cause.LOST_PORT: (FaultStep.HOLD,)}), way_to(phase)
    changes = played([*given.pop("acts", []), (on(phase, 0.05), lose_port)], robot=robot)
    assert (phase, Phase.STOP) in changes


def after_a_long_wait_for_a_person_servos_are_compared_before_they_are_set():
    acts = [(on(Phase.READY, 1.0), lambda player, _: player.go()), (on(Phase.STANDING, 0.1), stop)]
    assert (Phase.PREPARE, Phase.PREPARE) in played(acts, must_ask=True)


def test_each_change_is_a_row_of_the_table_and_each_row_is_a_change():
    for phase in [one for one in Phase if one is not Phase.DONE]:
        an_abort_ends_each_phase_at_once(phase)
    an_abort_after_an_abort_sends_the_last_bytes_once_more()
    for phase in [one for one in Phase if one not in (Phase.STOP, Phase.RESTORE, Phase.DONE)]:
        a_stop_brakes_what_moves_and_gives_the_settings_back(phase)
    a_stop_while_servos_are_asked_needs_no_brake()
    one_show_is_begun_by_a_person_and_sent_to_another_place()
    many_shows_follow_each_other()
    for phase in [Phase.APPROACH, Phase.SHOW, Phase.STANDING, Phase.SEEK]:
        a_port_that_comes_back_leads_on_from_each_phase(phase)
    for phase in [Phase.APPROACH, Phase.SHOW, Phase.STANDING, Phase.SEEK]:
        a_port_for_which_nothing_waits_ends_the_run_from_each_phase(phase)
    after_a_long_wait_for_a_person_servos_are_compared_before_they_are_set()
    rows = {(phase, then) for phase, rows in TRANSITIONS.items() for then in rows}
    assert rows - made == set()
