import pytest
from hypothesis import given
from hypothesis import strategies as st

from lss_motion.sim.faults import Drift, Fault, FaultKind

S = 1_000_000_000


def drift(*rows):
    made = Drift(
        Fault(kind=FaultKind.CLOCK_DRIFT, at_s=at_s, until_s=until_s, drift_ppm=ppm)
        for at_s, until_s, ppm in rows
    )
    made.start(0)
    return made


def test_the_servos_time_runs_ahead_in_its_time_only():
    clocks = drift((1.0, 3.0, 1000.0))
    assert [clocks.bus_ns(n * S) - n * S for n in (1, 2, 3, 9)] == [
        0,
        S // 1000,
        S // 500,
        S // 500,
    ]


def test_without_rows_both_clocks_are_one():
    assert drift().bus_ns(123) == drift().host_ns(123) == 123


@given(
    st.lists(
        st.tuples(st.floats(0, 5), st.floats(5, 20), st.floats(-5000, 5000)), min_size=1, max_size=3
    ),
    st.integers(0, 30 * S),
)
def test_there_and_back_is_the_first_instant_of_the_host(rows, bus_ns):
    clocks = drift(*rows)
    host_ns = clocks.host_ns(bus_ns)
    assert clocks.bus_ns(host_ns) >= bus_ns
    assert host_ns == 0 or clocks.bus_ns(host_ns - 1) < bus_ns


def test_a_horn_of_a_fast_clock_is_early(make_host):
    host = make_host(faults=[Fault(kind=FaultKind.CLOCK_DRIFT, drift_ppm=50_000.0)])
    host.say("#5D900T1000")
    host.wait_s(0.5)
    fast_deg = host.horn_deg()
    true = make_host()
    true.say("#5D900T1000")
    true.wait_s(0.5)
    assert fast_deg - true.horn_deg() == pytest.approx(0.05 * 0.5 * 90.0, rel=0.3)
    assert host.ask("#5QG") == "*5QG1|"
    assert host.bus.horn_deg([round(0.5e9)])[0, 0] > true.bus.horn_deg([round(0.5e9)])[0, 0] + 2.0
