"""Judged against closed forms written here, never against the simulator's own profile."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.sim.physics import TICK_NS, Physics
from tests.tables import titled

CRISP = Physics(noise_deg=0.0, lag_s=1e-5, supply_ohm=0.0)
DIALOGUES = {
    "without IPE the filter steps once a command":
        ({}, "#5EM0 #5FPC2 #5IPE0 #5D800 0.2s #5QDT=400 #5D800 #5QDT=600"),
    "in EM0 nothing is timed and the status stays holding":
        ({}, "#5EM0 #5FPC0 #5D900T5000 0.1s #5Q=6 0.3s #5QD=900"),
    "45 degrees are reached within 800 ms": ({}, "#5D450 0.8s @45"),
    "a wheel has its speed after half a second":
        ({}, "#5WD900 0.5s @39.37 1s @129.37 #5QWD=900 #5QDT=*5QDT|"),
    "so it has backwards": ({}, "#5WR-20 0.5s @-50.70 1s @-170.70 #5QWD=-1200 #5QDT=*5QDT|"),
    "raw duty is free moving": ({}, "#5RDM500 #5Q=2 #5H 0.5s #5Q=6"),
    "a horn that rests outside of its software limits is reported":
        ({}, "#5D300 1s #5CLP200 #5Q=6 #5CLE1 #5Q=7"),
    "a load pulls a held horn down where it has a lever, and costs 200 mA a degree":
        ({"droop_deg": 2.0}, "#5QC=70 #5D0 1s @-2 #5QC=470 #5D900 2s @90"),
    "two steps of a firmer hold droop less": ({"droop_deg": 2.0}, "#5AH6 #5D0 1s @-1.653"),
    "backlash is lost motion where the direction turns":
        ({"backlash_deg": 1.0}, "#5D300 2s @29.5 #5D295 1s @29.5 #5D280 1s @28.5"),
    "a load keeps the horn at its end of the backlash": (
        {"backlash_deg": 1.0, "droop_deg": 1.0, "level_deg": 30.0},
        "#5D400 2s #5D300 2s @28.5",
    ),
    "a reset forgets the turns of a horn with backlash, too":
        ({"backlash_deg": 1.0}, "#5D4800 3s #5RESET 1.3s @119.5"),
}  # fmt: skip


@titled(("servo", "dialogue"), DIALOGUES)
def test_a_motor_does(make_host, make_servo, servo, dialogue):
    make_host(make_servo(**servo), physics=Physics(noise_deg=0.0)).talk(dialogue)


def trapezoid_deg(time_s, distance_deg, travel_deg_s, accel_deg_s2, decel_deg_s2):
    """Position over time of one move from rest; the textbook's three parabolas."""
    reach_deg_s = math.sqrt(
        2 * distance_deg * accel_deg_s2 * decel_deg_s2 / (accel_deg_s2 + decel_deg_s2)
    )
    top = min(travel_deg_s, reach_deg_s)
    up_s, down_s = top / accel_deg_s2, top / decel_deg_s2
    even_s = (distance_deg - top * (up_s + down_s) / 2) / top
    if time_s < up_s:
        return accel_deg_s2 * max(time_s, 0.0) ** 2 / 2
    if time_s < up_s + even_s:
        return top * (time_s - up_s / 2)
    rest_s = max(up_s + even_s + down_s - time_s, 0.0)
    return distance_deg - decel_deg_s2 * rest_s**2 / 2


def taken_up_s(host, start_ns):
    """Find when the horn began to move, to a tenth of a millisecond."""
    times_ns = np.arange(start_ns, start_ns + 20_000_000, 100_000)
    moved = host.bus.horn_deg(times_ns)[:, 0] != host.bus.horn_deg([start_ns])[0, 0]
    return times_ns[np.argmax(moved)]


@pytest.mark.parametrize(
    ("command", "travel_deg_s"),
    [("D450", 360.0), ("D450T500", 90.0), ("D1800T600", 300.0), ("D90T20", 360.0)],
)
def test_a_timed_move_is_a_trapezoid_within_a_tenth_of_a_degree(make_host, command, travel_deg_s):
    host = make_host(physics=CRISP)
    host.ask("#5AA30")
    host.ask("#5AD60")
    host.bus.write(f"#5{command}\r".encode(), host.now_ns)
    received_ns = host.now_ns + host.bus.backlog_ns(host.now_ns)
    distance_deg = int(command[1:].split("T")[0]) / 10
    host.wait_s(3.0)
    start_ns = host.bus.motors.loop_ns(0, received_ns)
    times_ns = [start_ns + step * 1_000_000 for step in range(2000)]
    expected_deg = [
        trapezoid_deg((time_ns - start_ns) / 1e9, distance_deg, travel_deg_s, 300.0, 600.0)
        for time_ns in times_ns
    ]
    error_deg = np.abs(host.bus.horn_deg(times_ns)[:, 0] - expected_deg)
    assert error_deg.max() < 0.1
    assert host.horn_deg() == pytest.approx(distance_deg, abs=1e-6)


def test_the_horn_trails_a_steady_speed_by_the_lag(make_host):
    host = make_host(physics=replace(CRISP, lag_s=0.03))
    host.say("#5D3000T3000")
    host.wait_s(1.0)
    first_deg = host.horn_deg()
    host.wait_s(0.5)
    assert host.horn_deg() - first_deg == pytest.approx(50.0, abs=1e-6)
    profile_deg = host.bus.motors.horns.profile_at(0, host.now_ns)[0]
    assert profile_deg - host.horn_deg() == pytest.approx(100.0 * 0.03, abs=1e-6)


def test_a_step_of_the_horns_equals_many_small_ones(make_host):
    """The lag against its definition, dh/dt = (x - h) / lag, integrated here at 20 µs."""
    host = make_host(physics=replace(CRISP, lag_s=0.02))
    host.bus.write(b"#5D450T400\r", 0)
    received_ns = host.bus.backlog_ns(0)
    start_ns = host.bus.motors.loop_ns(0, received_ns)
    host.wait_s(1.0)
    horn_deg, worst_deg, step_s = 0.0, 0.0, 20e-6
    for step in range(40_000):
        profile_deg = trapezoid_deg((step + 0.5) * step_s, 45.0, 112.5, 1000.0, 1000.0)
        horn_deg += (profile_deg - horn_deg) * step_s / 0.02
        if step % 500 == 499:
            truth_deg = host.bus.horn_deg([start_ns + round((step + 1) * step_s * 1e9)])[0, 0]
            worst_deg = max(worst_deg, abs(truth_deg - horn_deg))
    assert worst_deg < 0.02


def test_a_new_target_in_mid_move_keeps_the_speed(make_host):
    host = make_host(physics=CRISP)
    host.say("#5D3600T3600")
    host.wait_s(1.0)
    host.say("#5D3000T2000")
    first_deg = host.horn_deg()
    host.wait_s(0.001)
    assert (host.horn_deg() - first_deg) / 0.001 == pytest.approx(100.0, rel=0.05)


def test_from_rest_a_new_target_begins_with_no_speed(make_host):
    host = make_host(physics=replace(CRISP, retarget="from_rest"))
    host.say("#5D3600T3600")
    host.wait_s(1.0)
    host.bus.write(b"#5D3000T2000\r", host.now_ns)
    host.wait_s(0.007)
    first_deg = host.horn_deg()
    host.wait_s(0.001)
    assert (host.horn_deg() - first_deg) / 0.001 < 20.0


def test_the_filter_follows_its_law_every_20_ms(make_host):
    host = make_host(physics=CRISP)
    host.say("#5EM0")
    host.say("#5FPC5")
    host.say("#5D900")
    seen = []
    for _ in range(400):
        reply = host.ask("#5QDT")
        if not seen or seen[-1] != reply:
            seen.append(reply)
    seen_targets = [int(reply.removeprefix("*5QDT").removesuffix("|")) for reply in seen]
    expected, value = [0], 0.0
    while abs(value - 90.0) >= 0.05:
        value = (value * 4 + 90.0) / 5
        expected.append(900 if abs(value - 90.0) < 0.05 else round(value * 10))
    assert seen_targets == list(dict.fromkeys(expected))
    assert seen_targets[1:3] == [180, 324]  # the maker's own example


def test_no_horn_is_faster_than_its_model(make_host):
    host = make_host()
    for line in ("#5EM0", "#5FPC0", "#5D1800"):
        host.say(line)
    host.wait_s(1.0)
    angles_deg = host.bus.horn_deg(range(0, host.now_ns, TICK_NS))[:, 0]
    speed_deg_s = np.diff(angles_deg).max() / (TICK_NS / 1e9)
    assert 340.0 < speed_deg_s <= 360.0


def test_halt_holds_where_the_profile_is_and_limp_where_the_horn_is(make_host):
    host = make_host()
    host.say("#5D1800T2000")
    host.wait_s(1.0)
    before_deg = host.horn_deg()
    host.say("#5H")
    host.wait_s(1.0)
    assert before_deg < host.horn_deg() < before_deg + 90.0 * (0.02 + 0.006)
    assert host.ask("#5Q") == "*5Q6|"
    host.say("#5L")
    rest_deg = host.horn_deg()
    host.wait_s(1.0)
    assert host.horn_deg() == rest_deg
    assert host.ask("#5Q") == "*5Q1|"


def test_the_status_follows_the_profile(make_host):
    host = make_host()
    assert host.ask("#5Q") == "*5Q1|"
    host.say("#5D900T1000")
    seen = []
    for _ in range(120):
        status = int(host.ask("#5Q")[3:-1])
        if not seen or seen[-1] != status:
            seen.append(status)
        host.wait_s(0.01)
    assert seen == [3, 4, 5, 6]


def test_a_stiffer_servo_trails_less(make_host):
    def behind_deg(stiffness):
        host = make_host(physics=replace(CRISP, lag_s=0.03))
        host.say(f"#5AS{stiffness}")
        host.say("#5WD1000")
        host.wait_s(1.0)
        return host.bus.motors.horns.profile_at(0, host.now_ns)[0] - host.horn_deg()

    assert behind_deg(0) == pytest.approx(3.0, abs=1e-3)
    assert behind_deg(2) == pytest.approx(3.0 / 1.1**2, abs=1e-3)
    assert behind_deg(-2) == pytest.approx(3.0 * 1.1**2, abs=1e-3)


def test_a_limited_duty_makes_em0_slower(make_host):
    host = make_host()
    for line in ("#5MMD256", "#5EM0", "#5FPC0", "#5D1800"):
        host.say(line)
    host.wait_s(1.0)
    assert host.horn_deg() == pytest.approx(90.0, abs=4.0)  # a quarter of 360 deg/s


def test_a_jammed_servo_is_stuck_then_blocked_then_in_safe_mode_until_reset(make_host):
    host = make_host()
    host.bus.motors.jam(0, host.now_ns, is_jammed=True)
    host.say("#5D900")
    seen = []
    for _ in range(400):
        status = int(host.ask("#5Q")[3:-1])
        if not seen or seen[-1] != status:
            seen.append(status)
        host.wait_s(0.01)
    assert seen[-3:] == [8, 9, 10]
    assert host.ask("#5Q1") == "*5Q1|"
    host.bus.motors.jam(0, host.now_ns, is_jammed=False)
    host.say("#5D450")
    host.wait_s(1.0)
    assert host.horn_deg() == 0.0
    host.say("#5RESET")
    host.wait_s(1.3)
    host.say("#5D450")
    host.wait_s(1.0)
    assert host.horn_deg() == pytest.approx(45.0, abs=0.1)


@pytest.mark.parametrize(("modifier", "status"), [("CH400", 6), ("CL400", 1)])
def test_a_current_limit_ends_a_stall_without_safe_mode(make_host, modifier, status):
    host = make_host()
    host.bus.motors.jam(0, host.now_ns, is_jammed=True)
    host.say(f"#5D900{modifier}")
    host.wait_s(4.0)
    assert host.ask("#5Q") == f"*5Q{status}|"


def test_a_servo_above_85_degrees_goes_limp_and_reports_the_cause(make_host):
    host = make_host()
    host.say("#5D900")
    host.bus.motors.power.set_temperature(0, 86.0)
    host.wait_s(0.05)
    assert host.ask("#5Q") == "*5Q10|"
    assert host.ask("#5Q1") == "*5Q3|"


@given(
    st.lists(
        st.tuples(
            st.integers(0, 300),
            st.sampled_from(
                ["#5D450T300", "#5D-900", "#6D1800T400", "#6WD300", "#5QD", "#6Q", "#254H", "#5L",
                 "#5EM0", "#5EM1", "#6RESET", "#254QD", "#5AS-4"]
            ),
        ),
        max_size=12,
    ),
    st.lists(st.integers(1, 700), max_size=40),
)  # fmt: skip
def test_what_happens_does_not_depend_on_how_often_time_is_told(
    make_host, make_servo, script, pauses_ms
):

    def play(extra_ns):
        host = make_host(make_servo(5), make_servo(6), physics=Physics())
        writes = sorted((at_ms * 1_000_000, f"{line}\r".encode()) for at_ms, line in script)
        received = b""
        for now_ns, data in sorted([*writes, *((at_ns, b"") for at_ns in extra_ns)]):
            received += host.bus.read(now_ns)
            host.bus.write(data, now_ns)
            if now_ns % 3 == 0:
                host.bus.next_arrival_ns()
        received += host.bus.read(2_000_000_000)
        return received, host.bus.horn_deg(range(0, 2_000_000_000, 7_000_000)).tolist()

    lonely = play([])
    watched = play([pause_ms * 1_000_003 for pause_ms in pauses_ms])
    assert watched == lonely


def test_asking_changes_nothing_of_where_backlash_leaves_the_horn(make_host, make_servo):
    def angles(ask_s):
        host = make_host(make_servo(backlash_deg=0.6))
        host.say("#5D200T300")
        host.wait_s(0.25)
        host.bus.write(b"#5D0T300\r", host.now_ns)
        for _ in range(round(0.3 / ask_s)):
            host.wait_s(ask_s)
            host.horn_deg()
        host.wait_s(1.0)
        return host.bus.horn_deg(range(0, 1_500_000_000, 5_000_000))

    assert np.abs(angles(0.1) - angles(0.0007)).max() < 1e-6


@pytest.mark.parametrize("supply_v", [5.5, 13.5])
def test_a_voltage_outside_the_range_is_safe_mode_with_its_cause(make_host, supply_v):
    host = make_host(physics=Physics(noise_deg=0.0, supply_v=supply_v))
    host.say("#5D900")
    host.wait_s(1.0)
    assert abs(host.horn_deg()) < 5.0
    assert [host.ask("#5Q"), host.ask("#5Q1")] == ["*5Q10|", "*5Q2|"]
