import pytest

from lss_motion.errors import BlockedPortError, BusError
from lss_motion.sim.bus import SimBus, SimPort
from lss_motion.sim.faults import Fault, FaultKind, SleepyClock
from lss_motion.system.clock import VirtualClock

S = 1_000_000_000


@pytest.fixture
def make_bus(make_servo):
    def make(*faults):
        return SimBus([make_servo(5)], baud_bps=115200, firmware=370, faults=faults)

    return make


BLOCKED = Fault(kind=FaultKind.BLOCKED_PORT, at_s=1.0, until_s=1.5)
UNPLUGGED = Fault(kind=FaultKind.UNPLUGGED, at_s=1.0, until_s=2.0)


def asked(port, clock):
    port.write(b"#5QG\r")
    clock.advance_to(clock.now_ns() + S // 100)
    return port.read()


def test_an_unplugged_port_is_lost_and_another_can_be_opened_when_it_is_back(make_bus):
    bus, clock = make_bus(UNPLUGGED), VirtualClock()
    port = SimPort(bus, clock)
    assert asked(port, clock) == b"*5QG1\r"
    clock.advance_to(S)
    for use in (port.read, lambda: port.write(b"#5D900\r")):
        with pytest.raises(BusError, match="lost port sim://: it was unplugged"):
            use()
    with pytest.raises(BusError, match="cannot open port sim://: it is unplugged"):
        SimPort(bus, clock)
    clock.advance_to(2 * S)
    with pytest.raises(BusError, match="lost port"):
        port.read()
    again = SimPort(bus, clock)
    assert asked(again, clock) == b"*5QG1\r"
    port.close()


def test_a_port_that_nobody_used_in_the_outage_is_lost_too(make_bus):
    clock = VirtualClock()
    port = SimPort(make_bus(UNPLUGGED), clock)
    clock.advance_to(3 * S)
    with pytest.raises(BusError, match="lost port"):
        port.write(b"#5H\r")


def test_servos_go_on_while_unplugged_and_what_was_on_its_way_is_lost(make_bus):
    bus, clock = make_bus(UNPLUGGED), VirtualClock()
    bus.record()
    port = SimPort(bus, clock)
    port.write(b"#5D900T1800\r")
    clock.advance_to(S - 100_000)
    port.write(b"#5D0\r")
    clock.advance_to(3 * S)
    again = SimPort(bus, clock)
    clock.advance_to(3 * S + S // 10)
    again.read()
    assert bus.horn_deg([clock.now_ns()])[0, 0] == pytest.approx(90.0, abs=0.01)


def test_a_blocked_port_holds_what_is_written_until_it_takes_bytes_again(make_bus):
    bus, clock = make_bus(BLOCKED), VirtualClock()
    port = SimPort(bus, clock)
    clock.advance_to(S + S // 10)
    port.write(b"#5QG\r")
    assert not port.has_sent_all()
    assert port.next_arrival_ns() == 3 * S // 2
    clock.advance_to(3 * S // 2)
    assert (port.read(), port.has_sent_all()) == (b"", True)
    clock.advance_to(2 * S)
    assert port.read() == b"*5QG1\r"


def test_a_port_that_stays_blocked_is_lost_and_closing_it_does_not_hang(make_bus):
    for_ever = Fault(kind=FaultKind.BLOCKED_PORT, at_s=1.0)
    clock = VirtualClock()
    port = SimPort(make_bus(for_ever), clock)
    clock.advance_to(2 * S)
    port.write(b"#5QG\r")
    clock.advance_to(port.next_arrival_ns())
    with pytest.raises(BlockedPortError, match="lost port sim://: it takes no bytes"):
        port.read()
    assert 5 * S <= 2 * clock.now_ns() < 5 * S + S // 10
    port.close()
    assert 2 * clock.now_ns() < 5 * S + S // 10
    again = SimPort(port.bus, clock)
    again.write(b"#254H\r")
    with pytest.raises(BlockedPortError):
        again.close()
    assert clock.now_ns() < 3 * S + S // 10


def test_what_a_blocked_port_holds_at_its_end_still_leaves(make_bus):
    bus, clock = make_bus(BLOCKED), VirtualClock()
    bus.record()
    port = SimPort(bus, clock)
    clock.advance_to(S)
    port.write(b"#254H\r")
    port.close()
    assert [line for _, line in bus.lines] == [b"#254H\r"]


def test_a_host_that_oversleeps_wakes_that_much_later_in_its_time():
    late = Fault(kind=FaultKind.OVERSLEEP, at_s=1.0, until_s=2.0, late_s=0.25)
    clock = SleepyClock([late], seed=1)
    instants = []
    for instant_ns in (S // 2, S, 3 * S):
        clock.advance_to(instant_ns)
        instants.append(clock.now_ns() / S)
    assert instants == [0.5, 1.25, 3.0]


def test_looking_at_the_clock_is_no_sleep():
    clock = SleepyClock([Fault(kind=FaultKind.OVERSLEEP, late_s=0.25)], seed=1)
    clock.advance_to(0)
    assert clock.now_ns() == 0


def test_a_share_of_the_sleeps_is_late_and_repeats_with_the_seed():
    def lates(seed):
        clock = SleepyClock([Fault(kind=FaultKind.OVERSLEEP, late_s=0.001, ratio=0.25)], seed=seed)
        late = 0
        for _ in range(400):
            wanted_ns = clock.now_ns() + S // 100
            clock.advance_to(wanted_ns)
            late += clock.now_ns() > wanted_ns
        return late, clock.now_ns()

    assert 70 <= lates(1)[0] <= 130
    assert lates(1) == lates(1)
    assert lates(1) != lates(2)
