"""Some seeds of the campaign, and that its judge can tell good from bad."""

from __future__ import annotations

import pytest
from campaign import hands, judge, witness
from campaign.__main__ import again
from campaign.stale import lawless_ns
from campaign.three_shows import NAMES, show
from msgspec.structs import replace

from lss_motion.playing.player import checks, handshake, joint_state, streamer
from lss_motion.playing.player.servo_model import ServoSettings
from lss_motion.sim.faults import Fault, FaultKind
from tests.tables import first_quick

SEEDS, CHUNKS = range(80), 8
"""Each kind of fault comes at least three times; `tools/campaign shows` plays thousands."""
FOUND_BPS = 19_200
FOUND = (
    46,  # A servo that restarted on the way to the start was driven without its limits.
    85,  # The same, and half deaf besides.
    113,  # Two servos restarted at once; the second, not missed yet, was still told to brake.
    272,  # A trouble of the approach woke the player without end while it asked who had arrived.
    514,  # A host that overslept made up for it with more than the acceleration allowed in EM0.
    1310,  # A servo that did not receive its first query was not given its limits.
    1420,  # A late host made up for it, in EM0, with what the instants of a filter's steps allow,
    3076,  # if they are those assumed.
    1634,  # One still deaf from its restart at the end of the approach was not missed.
    2098,  # A garbled word put a horn out of its range, and it was led back from there.
)
FOUND_SLOW = (
    2213,  # A clog kept words for a servo until it had restarted: nobody's doing.
    10514,  # A show that braked was still owed the end of a catch-up, with no time left for it.
    2472,  # On a full line, silence was noticed with the next question, when the servo was back.
    15857,  # Silent since before the show: counted from the show's own first question, too late.
    20098,  # A lag was believed to be 60 ms at once: moves overtook earlier ones of their joint.
    32164,  # A host that overslept every time never asked anything: a restart went unnoticed.
)
FOUND_ANY = (
    293,  # Instants crept with a lag that was being learnt, past the steps of a joint in EM0.
    1370,  # The same.
    1444,  # A joint that turned round at the very end of a show was taken for one at rest.
    466,  # The last tick of a ramp and the moves after it crowded out a joint in EM0.
    40515,  # A joint was let go in full swing, as its ladder says: without power it stops at once.
    20125,  # A garbled word put a horn out of its range; what led it back was corrected meanwhile.
    21548,  # What the simulator's loop adds was counted on a part of what is allowed.
    545,  # As 2213; the move under way ended with the ramps with which it had begun.
)


MIXED = range(2, 12)
FOUND_MIXED = (
    12, 176,  # A servo with another gyre or origin than the file played mirrored.
    17,  # The same with the gyre of an RC servo.
    62, 409,  # It left its range.
    27,  # After a stall of 30 s a horn went at 202 deg/s of 180.
    37,  # After a stall an RC servo got 13 moves in 0.1 s.
    57,  # A bare D led a restarted servo over 54 degrees at its factory speed.
    162, 405,  # Replies lost or late: moves were held back, once without an end.
    270,  # A servo that read 1,500 deg was led back through four turns.
    307,  # Without feedback, with stored limits above those of the joint.
    1146,  # Queries for targets filled a slow line: a restart was not noticed for two seconds.
    1285,  # All servos restarted; the first that was noticed took the queries of the others.
    1305,  # A key that was pressed during a stall hid that moves were due.
    1598,  # The independent judge gave a host no time after a long restart.
    2893,  # A show that was slowed at its end hung while a joint had time left for its goal.
    6251,  # A servo restarted after it had its settings, while the player waited for another.
    3370,  # Another host restarted an LSS-PRO, which took its port along.
    2849,  # Jitter of a full line fell between two modelled instants of a filter's steps.
    2931,  # All servos fell silent; queries to the first left none for the others.
    2661,  # A guiding target used the tolerance of a full line: four times the acceleration.
    6117,  # Lines of a joint in EM0 waited at a blocked port for 50 ms.
    2093,  # A late host left the filter of a joint in EM0 without a target: it brakes by itself.
    575,  # A short restart that no query met: a few moves for a servo in full motion.
    1216, 1517,  # It took an unknown top speed for none, and an RC servo for one with O.
    355,  # What a step of the filter adds was counted as an acceleration.
    3923, 11121,  # Guiding targets left at other instants than the program's: a filter starved.
    6603,  # Garbled lines put a horn out of its range, and corrections led it out again.
    11473,  # A host that stood still for 30 s was to notice what happened meanwhile.
    20761,  # Garbled bytes changed gyre and origin of servos in mid-show.
    13248, 21025,  # A servo that counts in other units restarted: only its SD had bounded it.
    45651,  # Every joint was left out: the approach of no joint raised.
    41748,  # A move was on a line of 9600 bps when its servo restarted.
    20915,  # A joint in EM0 went 2 % too fast; by chance, with other instants.
    40059, 42065,  # Targets in EM0 came unevenly: a filter brakes.
    40565,  # The same while the rate of the show changed.
    45173,  # A joint in EM0 restarted, and was read too late.
    61022,  # Each answer came after it was given up, so joints were held back to the end.
    65799,  # All servos of a bus restarted while one that moved was not polled.
    68565,  # A servo restarted while it was asked for its gyre, which was never answered.
    64791,  # Targets in EM0 were held back, since answers came under another id: a filter brakes.
    69669,  # Late answers came behind the next query, and taught nothing: no angle was known.
    324,  # Another servo took the place of one while the settings were set.
    70464,  # The same while the servos were asked where they stand after the approach.
    60333,  # A lag turned out to be larger: three moves of a joint left at once.
    92583,  # Each approach sent a joint in EM0 out of its range by the noise of a reading.
    90543,  # Two queries to one overdue servo delayed a joint in EM0: its filter braked.
    803931,  # All servos restarted when they were set up for the second time.
    803371,  # A joint in EM0 stood at -118; it was believed to be at -11, which two answers said.
    830687,  # Without feedback, servos restarted while they were set up: the player spun.
    90345,  # Lines that arrived as one, and late, made a filter brake: nobody's doing.
)  # fmt: skip
"""Seeds with all kinds of faults, for both judges."""


@pytest.mark.parametrize("chunk", first_quick(range(CHUNKS), 3))
def test_whatever_goes_wrong_no_promise_is_broken(chunk):
    played = {seed: judge.judged(seed) for seed in SEEDS[chunk::CHUNKS]}
    assert {seed: result.broken for seed, result in played.items() if result.broken} == {}
    assert "finished" in {result.outcome for result in played.values()}


@pytest.mark.slow
@pytest.mark.parametrize("seed", FOUND)
def test_what_once_broke_a_promise_breaks_none(seed):
    assert judge.judged(seed, slow_bps=FOUND_BPS).broken == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", FOUND_SLOW)
def test_what_broke_a_promise_on_a_slow_line_breaks_none(seed):
    assert judge.judged(seed).broken == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", FOUND_ANY)
def test_what_broke_a_promise_of_any_robot_breaks_none(seed):
    assert judge.judged(seed, is_any=True).broken == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*MIXED, *FOUND_MIXED])
def test_faults_of_all_kinds_break_no_promise_for_either_judge(seed):
    run = judge.judged(seed, is_mixed=True, judges="both")
    assert (run.broken, run.objections) == ((), ())


def test_a_second_trouble_is_waited_for_as_long_as_the_first():
    assert judge.judged(768, slow_bps=FOUND_BPS).outcome == "finished"


S = 1_000_000_000
RESET = Fault(kind=FaultKind.RESET, at_s=1.0, servo_id=7)
CLOG = Fault(kind=FaultKind.CLOGGED, at_s=2.0, until_s=3.0)
WORD, NEXT = b"#7D100T50\r", b"#7D110T50\r"
HEARD = [(3 * S + 1, WORD), (3 * S + 2, b"#7AD60\r"), (3 * S + 3, b"#8D1\r"), (4 * S, NEXT)]


@pytest.mark.parametrize(
    ("faults", "written_s", "spans_ns"),
    [
        ((RESET, CLOG), 2.1, [(3 * S + 1, 4 * S)]),
        ((RESET, CLOG), 2.3, []),  # The servo was back: who wrote that should have known.
        ((RESET,), 2.1, []),
        ((CLOG,), 2.1, []),
        ((replace(RESET, servo_id=8), CLOG), 2.1, []),
        ((RESET, replace(CLOG, at_s=1.0, until_s=2.0)), 2.1, []),
    ],
)
def test_only_commands_that_a_clog_delayed_past_a_restart_are_excused(faults, written_s, spans_ns):
    writes = [(int(written_s * S), b"#8Q\r" + WORD), (4 * S - 9, NEXT)]
    assert lawless_ns(7, faults, writes, HEARD) == spans_ns


def broken(name):
    return " ".join(judge.judged_with(show(name), (), 1).broken)


def test_a_run_that_does_not_end_is_seen(monkeypatch):
    monkeypatch.setattr(witness, "RUN_MAX_S", 1.0)
    assert "it hangs" in broken("arm")


def test_a_crash_is_seen(monkeypatch):
    monkeypatch.setattr(checks, "check_latency", lambda *_: 1 / 0)
    assert "it crashed: ZeroDivisionError" in broken("arm")


def test_a_horn_beyond_its_limits_is_seen(monkeypatch):
    monkeypatch.setattr(handshake, "session_orders", lambda *_: [])
    monkeypatch.setattr(joint_state.JointState, "left_s", lambda *_: 0.01)
    monkeypatch.setattr(streamer, "ON_TIME_NS", -1)
    assert "acceleration" in broken("arm")


def test_a_command_that_was_moved_too_far_is_seen(monkeypatch):
    wire_for = joint_state.JointState.wire_for
    monkeypatch.setattr(
        joint_state.JointState,
        "wire_for",
        lambda self, target, at_ns: wire_for(self, target + 9.0, at_ns),
    )
    assert "moves of the plan were not sent" in broken("arm")


def test_a_missing_safe_state_is_seen(monkeypatch):
    monkeypatch.setattr(handshake, "safe_bytes", lambda *_, **__: {})
    assert "the last bytes on bus main" in broken("arm")


def test_a_horn_that_is_not_where_the_show_ends_is_seen(monkeypatch):
    arm = show("arm")
    monkeypatch.setattr(judge, "RESTS_WITHIN_DEG", -1.0)
    assert "nothing is said" in " ".join(judge.judged_with(arm, (), 1).broken)


def objections(name, faults=()):
    run = judge.judged_with(show(name), faults, 1, judges="independent")
    assert run.broken == ()
    return " ".join(run.objections)


@pytest.mark.parametrize("name", NAMES)
def test_the_independent_judge_has_no_objection_to_a_good_show(name):
    assert objections(name) == ""


@pytest.mark.parametrize("name", NAMES)
def test_the_independent_judge_objects_to_servos_without_limits(monkeypatch, name):
    monkeypatch.setattr(handshake, "session_orders", lambda *_: [])
    assert "driven without its limits" in objections(name)


def test_the_independent_judge_objects_to_a_missing_safe_state(monkeypatch):
    monkeypatch.setattr(handshake, "safe_bytes", lambda *_, **__: {})
    assert "neither H nor L follows" in objections("arm")


def test_the_independent_judge_objects_to_a_command_out_of_the_range(monkeypatch):
    wire_for = joint_state.JointState.wire_for
    monkeypatch.setattr(
        joint_state.JointState,
        "wire_for",
        lambda self, target, at_ns: wire_for(self, target, at_ns) + 900,
    )
    assert "is out of the range" in objections("arm")


def test_the_command_that_repeats_a_seed_names_no_other_seeds():
    words = ["shows", "--from", "3", "--any", "--seeds=9", "--judge", "both", "--jobs", "2"]
    assert again(7, words) == "shows --any --judge both --from 7 --seeds 1"


HANDS = range(12)


@pytest.mark.slow
def test_whatever_goes_wrong_in_the_hands_of_a_person_no_promise_is_broken():
    assert {seed: hands.play(seed, None).broken for seed in HANDS} == dict.fromkeys(HANDS, ())


def test_hands_that_ignore_restarts_are_objected_to(monkeypatch):
    monkeypatch.setattr(ServoSettings, "is_doubtful", property(lambda _: False))
    monkeypatch.setattr(ServoSettings, "take", lambda *_: None)
    monkeypatch.setattr(ServoSettings, "is_limp_again", lambda *_: False)
    assert any(hands.play(seed, None).broken for seed in HANDS)
