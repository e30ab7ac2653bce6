"""What the player keeps from turn to turn is what it would compute anew, whatever happens.

Instants that are due, ends of flights of queries and estimates are computed when something changes
them, since each turn needs them. One that is kept too long is a move, a query or a brake too late.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from random import Random

import pytest

from lss_motion.errors import InputError
from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.playing.player.events import Phase
from lss_motion.playing.player.query_tracker import GRACE_NS
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.units import NS_PER_S, US_PER_S, ns_from_s

SHOW_S = 3.0


def move_due_ns(streamer):
    """Return when the next move of the program is due; None: none is, or the show stands."""
    clock, leg = streamer.clock, streamer.clock.leg
    due = streamer._moves.first(US_PER_S * streamer.waiting.next_s)
    if due is None or not clock.target_rate:
        return None
    rate = leg.to_rate * (1.0 + leg.trim_ratio)
    after_s = due.at_us / US_PER_S - leg.show_s(leg.ramp_end_ns)
    return leg.ramp_end_ns + ns_from_s(after_s / rate)


def check_streamer(streamer, now_ns):
    assert streamer.show_s(now_ns) == streamer.clock.leg.show_s(now_ns)
    resends = {name: state.resend_ns for name, state in streamer.joint_states.items()}
    resends = {name: resend_ns for name, resend_ns in resends.items() if resend_ns is not None}
    assert streamer._resending == resends.keys()
    dues_ns = [*resends.values(), streamer._tick_ns]
    dues_ns += [move_due_ns(streamer)] if streamer._tick_ns is None else []
    dues_ns = [due_ns for due_ns in dues_ns if due_ns is not None]
    assert streamer.due_ns() == min(dues_ns, default=None)
    return len(resends)


def check_tracker(tracker):
    flights = tracker._flights
    assert tracker.give_up_ns == min((one.give_up_ns for one in flights.values()), default=None)
    assert tracker._last_end_ns == max((one.end_ns for one in flights.values()), default=0)
    is_patient = all(one.is_patient for one in flights.values())
    first_ns = min((one.end_ns for one in flights.values()), default=0) if is_patient else None
    assert tracker._first_end_ns == first_ns
    assert not flights or tracker._newest_id == list(flights)[-1]
    for servo_id, flight in flights.items():
        is_known = tracker.latency(servo_id).is_known
        assert flight.give_up_ns - flight.end_ns in ((GRACE_NS,) if is_known else (0, GRACE_NS))


def check_choice(choice):
    """Compare when each servo must be polled, but for those that are computed at the next look.

    One that is asked now, be it out of turn, is not polled whatever is kept.
    """
    for bus, every in choice._rounds.items():
        choice._look(bus, every)
        kept = [*every.dues_ns], [*every.targets_ns]
        for index, state in enumerate(every.states):
            is_asked = choice._trackers[bus].is_waiting(state.joint.servo_id)
            if index not in every.stale and not is_asked:
                choice._note_due(bus, every, index)
        assert (every.dues_ns, every.targets_ns) == kept


def check_state(state):
    lost_moves, horn = state.lost_moves, state.disturbance.horn
    last, due_ns = lost_moves.last, lost_moves.target_due_ns
    is_due = last is not None and last.queries_left > 0
    assert due_ns == (ns_from_s(lost_moves._reported_s(last)) if is_due else math.inf)
    assert horn.lag_s == min(max(horn._mean[-1], -LAG_MAX_S), LAG_MAX_S)
    kept = horn.lag_s, horn.early_s, horn.model_ratio, horn.worth_ratio
    horn._note_known()
    assert (horn.lag_s, horn.early_s, horn.model_ratio, horn.worth_ratio) == kept


def check(player, now_ns, seen):
    for tracker in player.trackers.values():
        check_tracker(tracker)
    streamer = player._machine.streamer
    if streamer is None or player._machine.dialogue is not None:
        return
    seen["resends"] += check_streamer(streamer, now_ns)
    seen["turns"] += 1
    seen["ramps"] += streamer._tick_ns is not None
    seen["trims"] += streamer.clock.trim_ratio != 0.0
    for state in streamer.joint_states.values():
        check_state(state)
    check_choice(streamer.scheduler._choice)
    agenda = player._present.agenda
    nexts_s = [due[0] for due in (agenda._mark, agenda._cue) if due is not None]
    assert agenda._next_s == min(nexts_s, default=math.inf)
    waiting = streamer.waiting
    assert waiting.next_s == (math.inf if waiting._next is None else waiting._next[0])


def trim(player, now_ns):
    if player.show is not None:
        player.follow(LeaderPosition(now_ns, player.show.show_s(now_ns) + 0.005, 1.0), now_ns)


def seek_to(show_s):
    def seek(player, now_ns):
        with contextlib.suppress(InputError):  # The run may recover, or end.
            player.seek(show_s, now_ns)

    return seek


def random_acts(random, kit):
    """Return `(run instant, act)`: pauses, rates, trims and seeks at random instants."""
    acts = [(kit.rate(0.0), 0.3), (kit.rate(0.5), 0.4), (seek_to(random.uniform(0.3, 1.5)), 1.0)]
    random.shuffle(acts)
    at_s, found = 1.9, [(1.8, trim)]
    for act, most_s in acts:
        at_s += random.uniform(0.3, 0.6)
        found.append((at_s, act))
        at_s += random.uniform(0.1, most_s)
        found += [(at_s, kit.rate(1.0)), (at_s + 0.4, trim)]
    return sorted(found, key=lambda due: due[0])


def random_faults(random):
    kinds = [FaultKind.LOST_COMMAND, FaultKind.LOST_REPLY, FaultKind.LATE_REPLY]
    kinds += [FaultKind.CORRUPT_REPLY, FaultKind.DOUBLE_REPLY]
    faults = [Fault(kind=kind, ratio=0.03, late_s=0.03) for kind in kinds]
    at_s = random.uniform(1.5, 3.0)
    clog = Fault(kind=FaultKind.CLOGGED, at_s=at_s, until_s=at_s + 0.08)
    return [*faults, clog, Fault(kind=FaultKind.OVERSLEEP, ratio=0.01, late_s=0.02)]


@pytest.mark.parametrize(
    ("drive", "seed"), [("timed", 2), ("timed", 4), ("streamed", 3), ("streamed", 5)]
)
def test_what_is_kept_is_what_would_be_computed_anew(stage, kit, drive, seed):
    random, seen = Random(seed), Counter()
    robot = kit.robot(3, buses=2, baud_bps=115200, drive=drive, resume_s=1.0)
    show = kit.sequence(3, SHOW_S, seed=seed, step_s=(0.4, 0.8))

    def after(at_s):
        def is_due(player, now_ns):
            check(player, now_ns, seen)
            return now_ns >= at_s * NS_PER_S

        return is_due

    def is_shown(at_s):
        is_due = after(at_s)
        return lambda player, now_ns: is_due(player, now_ns) and player.phase is Phase.SHOW

    acts = random_acts(random, kit)
    wishes = [((is_shown if act is trim else after)(at_s), act) for at_s, act in acts]
    stage.play(robot, show, wishes=[*wishes, (after(math.inf), None)], faults=random_faults(random))
    assert seen["turns"] > 300
    assert min(seen["ramps"], seen["trims"]) > 10
    assert drive == "timed" or seen["resends"] > 10
