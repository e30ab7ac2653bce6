"""The run loop, with a player that counts and ports that record."""

from __future__ import annotations

import gc

import pytest

from lss_motion.errors import BusError
from lss_motion.playing.runner import DECISION_MAX_NS, DECISION_STEP_NS, run
from lss_motion.system.clock import VirtualClock

BUSES = ("a", "b", "c")
STEP_NS = 10_000_000


class ScriptedPort:
    """Records written bytes, and fails at a given time."""

    def __init__(self, clock, *, arrivals=(), fails_at=None, error=None):
        self.url = "test://"
        self.written = []
        self.arrivals = list(arrivals)
        self._clock = clock
        self._fails_at = fails_at
        self._error = error or BusError("lost port test://", url="test://")

    def write(self, data):
        if self._fails_at is not None and self._clock.now_ns() >= self._fails_at:
            raise self._error
        self.written.append((self._clock.now_ns(), data))

    def read(self):
        if self.arrivals and self.arrivals[0][0] <= self._clock.now_ns():
            return self.arrivals.pop(0)[1]
        return b""

    def fileno(self):
        return None

    def next_arrival_ns(self):
        return self.arrivals[0][0] if self.arrivals else None

    def close(self):
        pass


class ScriptedPlayer:
    """Sends a number on every bus every 10 ns, ten times."""

    def __init__(self):
        self.received = []
        self.events = ["first", "second"]
        self._now_ns = 0
        self._sent_count = 0

    def data_to_send(self, leaves_ns):
        assert gc.isenabled() is False, "the collector must not interrupt a show"
        self._now_ns = leaves_ns
        if self._sent_count > leaves_ns // 10:
            return {}
        self._sent_count += 1
        return dict.fromkeys(BUSES, b"%d" % self._sent_count)

    def receive_data(self, bus, data, now_ns):
        self.received.append((now_ns, bus, data))

    def next_wakeup_ns(self):
        return None if self._sent_count >= 10 else 10 * self._sent_count

    def safe_bytes(self):
        return dict.fromkeys(BUSES, b"#254H\r")

    def next_event(self):
        return self.events.pop(0) if self.events else None


class SlowPlayer(ScriptedPlayer):
    """Sends a number every 10 ms; each decision takes a given time."""

    def __init__(self, clock, takes_ns):
        super().__init__()
        self.leaves = []
        self._clock = clock
        self._takes_ns = takes_ns

    def data_to_send(self, leaves_ns):
        assert leaves_ns >= self._now_ns, "time does not go back"
        self._now_ns = leaves_ns
        if leaves_ns < self._sent_count * STEP_NS:
            return {}
        self._sent_count += 1
        self._clock.advance_to(self._clock.now_ns() + self._takes_ns)
        self.leaves.append(leaves_ns)
        return {"a": b"%d" % self._sent_count}

    def receive_data(self, bus, data, now_ns):
        assert now_ns >= self._now_ns, "time does not go back"
        super().receive_data(bus, data, now_ns)

    def next_wakeup_ns(self):
        return None if self._sent_count >= 400 else self._sent_count * STEP_NS


class ListTap:
    def __init__(self):
        self.seen = []

    def sent(self, bus, data, now_ns):
        self.seen.append((now_ns, bus, ">", data))

    def turned(self, now_ns):
        pass

    def happened(self, event, now_ns):
        pass

    def requested(self, request, now_ns):
        pass

    def noted(self, bus, state, now_ns, reason=""):
        pass

    def received(self, bus, data, now_ns):
        self.seen.append((now_ns, bus, "<", data))


def ports_for(clock, **fields):
    return {bus: ScriptedPort(clock, **fields.get(bus, {})) for bus in BUSES}


def test_bytes_are_written_and_arrivals_are_read_at_their_instants():
    clock, player, tap, events = VirtualClock(), ScriptedPlayer(), ListTap(), []
    ports = ports_for(clock, b={"arrivals": [(13, b"*1Q6\r"), (47, b"*2Q6\r")]})
    run(player, ports, clock, on_event=events.append, tap=tap)
    expected = [(10 * turn, b"%d" % (turn + 1)) for turn in range(10)]
    for port in ports.values():
        assert port.written == expected
    assert player.received == [(13, "b", b"*1Q6\r"), (47, "b", b"*2Q6\r")]
    assert events == ["first", "second"]
    assert (13, "b", "<", b"*1Q6\r") in tap.seen
    assert (10, "a", ">", b"2") in tap.seen
    assert len(tap.seen) == 32
    assert gc.isenabled()


class PatientPlayer(ScriptedPlayer):
    """Lets answers of bus "b" wait, until instant 45 at the longest."""

    def reads_ns(self, bus):
        return 45 if bus == "b" and self._now_ns < 45 else None

    def is_due(self, leaves_ns):
        return self.next_wakeup_ns() is not None and self.next_wakeup_ns() <= leaves_ns


def test_answers_that_may_wait_cost_no_turn_of_their_own():
    clock, player, tap = VirtualClock(), PatientPlayer(), ListTap()
    arrivals = {"b": [(13, b"*1Q6\r"), (42, b"*2Q6\r"), (57, b"*3Q6\r")], "c": [(33, b"*4Q6\r")]}
    ports = ports_for(clock, **{bus: {"arrivals": own} for bus, own in arrivals.items()})
    run(player, ports, clock, tap=tap)
    assert player.received == [
        (20, "b", b"*1Q6\r"), (33, "c", b"*4Q6\r"), (45, "b", b"*2Q6\r"), (57, "b", b"*3Q6\r"),
    ]  # fmt: skip
    assert ports["a"].written == [(10 * turn, b"%d" % (turn + 1)) for turn in range(10)]


def test_a_lost_port_leaves_the_others_in_the_safe_state():
    clock, tap = VirtualClock(), ListTap()
    ports = ports_for(clock, a={"fails_at": 50})
    with pytest.raises(BusError, match="lost port"):
        run(ScriptedPlayer(), ports, clock, tap=tap)
    assert ports["a"].written[-1] == (40, b"5")
    for bus in "bc":
        assert ports[bus].written[-1] == (50, b"#254H\r")
        assert tap.seen.count((50, bus, ">", b"#254H\r")) == 1
    assert gc.isenabled()


def test_a_port_that_raises_any_error_leaves_the_others_in_the_safe_state():
    clock = VirtualClock()
    ports = ports_for(clock, a={"fails_at": 50, "error": ValueError("closed")})
    with pytest.raises(ValueError, match="closed"):
        run(ScriptedPlayer(), ports, clock)
    assert [ports[bus].written[-1][1] for bus in "bc"] == [b"#254H\r"] * 2


@pytest.mark.parametrize("error", [RuntimeError("no"), KeyboardInterrupt(), SystemExit(3)])
def test_any_exception_of_an_observer_makes_every_bus_safe(error):
    clock = VirtualClock()
    ports = ports_for(clock)

    def fail(event):
        raise error

    with pytest.raises(type(error)):
        run(ScriptedPlayer(), ports, clock, on_event=fail)
    assert [port.written[-1][1] for port in ports.values()] == [b"#254H\r"] * 3
    assert gc.isenabled()


def test_controls_act_before_every_write():
    acts = []

    class StoppingControls:
        def filenos(self):
            return []

        def act(self, player, now_ns):
            acts.append((now_ns, player._sent_count))

    clock, player = VirtualClock(), ScriptedPlayer()
    run(player, ports_for(clock), clock, controls=StoppingControls())
    assert acts == [(10 * turn, turn) for turn in range(10)]


@pytest.mark.parametrize(
    ("takes_ns", "learnt_ns"), [(0, 0), (300_000, 300_000), (5 * DECISION_MAX_NS, DECISION_MAX_NS)]
)
def test_a_slow_decision_is_compensated(takes_ns, learnt_ns):
    """The loop passes the instant at which bytes leave, up to the longest decision it learns."""
    clock = VirtualClock()
    arrivals = [(at * STEP_NS - 50_000, b"!") for at in range(1, 400)]
    port, player = ScriptedPort(clock, arrivals=arrivals), SlowPlayer(clock, takes_ns)
    run(player, {"a": port}, clock)
    assert player.leaves[0] == 0
    settled = list(zip(player.leaves, port.written, strict=True))[250:]
    for number, (told_ns, (written_ns, _)) in enumerate(settled, start=250):
        assert told_ns == pytest.approx(number * STEP_NS, abs=2 * DECISION_STEP_NS)
        late_ns = takes_ns - learnt_ns
        assert written_ns == pytest.approx(told_ns + late_ns, abs=2 * DECISION_STEP_NS)
    assert len(player.received) > 390
