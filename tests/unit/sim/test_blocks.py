"""Loops that are computed many at once give what they give one by one."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.horns import BLOCK_NS
from lss_motion.sim.physics import TICK_NS

S = 1_000_000_000
ORDERS = (
    "D{far}T{ms}", "D{far}", "D{near}T{ms}", "D{near}T{ms}", "D{near}T{ms}", "D{near}T{ms}",
    "WD{speed}", "MD{near}", "H", "L", "EM0", "EM1", "MMD600", "MMD1023", "AS3", "RESET", "RDM300",
)  # fmt: skip
QUERIES = ("QD", "QD", "QC", "QT", "QV", "QWD", "Q", "QDT")
FAULTS = (
    Fault(kind=FaultKind.STUCK, servo_id=1, at_s=3.0, until_s=4.5),
    Fault(kind=FaultKind.WEAK, servo_id=2, at_s=5.0, until_s=8.0, speed_ratio=0.1),
    Fault(kind=FaultKind.LOW_VOLTAGE, at_s=9.0, until_s=9.5, supply_v=6.1),
    Fault(kind=FaultKind.HOT, servo_id=3, at_s=10.0, temperature_c=84.9),
)


def lines(seed: int, end_ns: int) -> list[tuple[int, bytes]]:
    """Return random orders and queries to three servos, with times of rest, and their instants."""
    random, now_ns, made = Random(seed), S // 10, []
    while now_ns < end_ns:
        text = random.choice(ORDERS if random.random() < 0.4 else QUERIES)
        values = {
            "far": random.randint(-900, 900),
            "near": random.randint(-100, 100),
            "ms": random.randint(100, 900),
            "speed": random.randint(-400, 400),
        }
        made.append((now_ns, f"#{random.randint(1, 3)}{text.format(**values)}\r".encode()))
        now_ns += random.choice((3, 8, 8, 8, 20, 20, 90, 700)) * S // 1000 + random.randrange(1000)
    return made


def received(host, sent, step_ns: int | None):
    """Return all replies, and the horns; with `step_ns` no loop is owed for longer than that."""
    bus, data = host.bus, b""
    for at_ns, line in sent:
        while step_ns is not None and host.now_ns < at_ns:
            host.now_ns = min(host.now_ns + step_ns, at_ns)
            bus.advance(host.now_ns)
        host.now_ns = at_ns
        data += bus.read(at_ns)
        bus.write(line, at_ns)
        bus.next_arrival_ns()
    end_ns = host.now_ns + S
    return data + bus.read(end_ns), bus.horn_deg(range(0, end_ns, TICK_NS))


@pytest.mark.parametrize("faults", [(), FAULTS], ids=["no fault", "faults"])
@pytest.mark.parametrize("seed", [6, 8])
def test_loops_at_once_are_the_loops_one_by_one(make_host, make_servo, faults, seed):
    servos = [make_servo(servo_id) for servo_id in (1, 2, 3)]
    sent = lines(seed, 12 * S)
    together, horn_deg = received(make_host(*servos, faults=faults), sent, None)
    stepped, stepped_deg = received(make_host(*servos, faults=faults), sent, TICK_NS // 3)
    assert together == stepped
    assert together.count(b"\r") > 40
    assert np.abs(horn_deg - stepped_deg).max() < 1e-9  # Only the order of sums differs.
    assert np.ptp(horn_deg, axis=0).min() > 10.0, "a horn hardly moved: this test shows little"


def test_the_loops_of_a_motion_are_owed_and_of_a_loaded_motion_not(make_host, make_servo):
    free, loaded = make_host(), make_host(make_servo(droop_deg=2.0))
    for host in (free, loaded):
        host.say("#5D900T3000")
        host.bus.write(b"#5QD\r", host.now_ns + S)
        host.bus.next_arrival_ns()
    assert free.bus.motors.horns.block is not None
    assert loaded.bus.motors.horns.block is None


def test_a_long_motion_that_is_not_read_owes_no_more_than_a_block(make_host):
    host = make_host()
    host.say("#5WD100")
    host.bus.write(b"#5QD\r", host.now_ns + 100 * S)
    host.bus.next_arrival_ns()
    block = host.bus.motors.horns.block
    assert block is not None
    assert block.ns > host.now_ns + 100 * S - BLOCK_NS


@pytest.mark.parametrize("seed", range(4))
def test_to_look_at_the_horns_of_a_bus_that_is_ahead_changes_nothing(make_host, make_servo, seed):
    """A port asks when the next reply comes: the bus is then simulated up to that instant."""

    def horns_deg(*, is_watched):
        servos = [make_servo(one) for one in (1, 2, 3)]
        host, random = make_host(*servos, baud_bps=19200), Random(seed)
        for _ in range(80):
            host.bus.read(host.now_ns)
            texts = [f"#{one}D{random.randint(-100, 100)}T300\r" for one in (1, 2, 3)]
            host.bus.write("".join([*texts, "#1QD\r"]).encode(), host.now_ns)
            host.bus.next_arrival_ns()
            if is_watched:
                host.bus.horn_deg([host.now_ns])
            host.now_ns += random.randrange(S // 30, S // 5)
        host.wait_s(1.0)
        return host.bus.horn_deg(range(0, host.now_ns, TICK_NS))

    assert np.abs(horns_deg(is_watched=True) - horns_deg(is_watched=False)).max() < 1e-9
