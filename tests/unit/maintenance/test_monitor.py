"""Watching servos: the values read, their rate, and the alarms."""

from __future__ import annotations

import io

import pytest

from lss_motion.cli.main import main
from lss_motion.cli.monitor import rendered, sparkline
from lss_motion.maintenance.monitor import Alarms, Polling, ServoState, Thresholds
from lss_motion.maintenance.settings import Target
from lss_motion.playing import connection as connections
from lss_motion.playing.player.handshake import Item
from lss_motion.playing.runner import run
from lss_motion.protocol.constants import Family, Status
from lss_motion.protocol.framing import Command
from lss_motion.sim.faults import Fault, FaultKind

NS_PER_S = 1_000_000_000


def target(servo_id, model="LSS-ST1", family=Family.LSS):
    return Target(
        name=f"servo {servo_id}",
        bus="main",
        servo_id=servo_id,
        model=model,
        family=family,
        firmware=370,
    )


@pytest.fixture
def watched(connected):
    """Return a function that watches servos; it returns the watch and its readings."""

    def make(*specs, targets=None, for_s=2.0, on_turn=None, **options):
        connection = connected(*specs, **options)
        watch = Polling(targets or [target(spec.servo_id) for spec in specs], connection.buses)
        read = []

        def turn(watch, now_ns):
            read.extend((now_ns, reading.target.servo_id) for reading in watch.take_fresh())
            if on_turn is not None:
                on_turn(watch, now_ns)
            if now_ns >= for_s * NS_PER_S:
                watch.stop()

        run(watch, connection.ports, connection.clock, on_turn=turn)
        return watch, read, connection

    return make


def test_every_value_of_every_servo_is_read(watched, spec):
    targets = [
        target(1),
        target(2, "LSS-P-S1", Family.LSS_PRO),
        target(209, "LSS-2IO-D9", Family.IO2),
        target(203, "LSS-2IO-A3", Family.IO2),
    ]
    watch, _, _ = watched(
        spec(1, start_deg=12.0),
        spec(2, "LSS-P-S1", start_deg=-3.25),
        spec(209, "LSS-2IO"),
        targets=targets,
        faults=[Fault(kind=FaultKind.INPUT, servo_id=203, raw=426)],
    )
    servo, pro, pin, sensor = watch.readings
    assert (servo.position_deg, servo.speed_deg_s, servo.status) == (12.0, 0.0, Status.LIMP)
    assert servo.voltage_v == pytest.approx(12.0, abs=0.1)
    assert servo.temperature_c == pytest.approx(25.0, abs=1.0)
    assert servo.current_a == pytest.approx(0.07, abs=0.01)
    assert (pro.position_deg, pro.status) == (-3.25, Status.LIMP)
    assert (pin.position_deg, sensor.raw) == (2.0, 426.0)


def test_an_lss_pro_answers_every_query(watched, spec):
    """It has no query for its voltage."""
    one = target(2, "LSS-P-S1", Family.LSS_PRO)
    watch, _, connection = watched(spec(2, "LSS-P-S1"), targets=[one])
    asked = {line.decode()[2:-1] for _, line in connection.simulated["main"].lines}
    assert asked == {"QD", "QWD", "QC", "Q", "QT"}
    assert watch.readings[0].temperature_c == pytest.approx(25.0, abs=1.0)


def test_the_line_is_used_fully(watched, spec):
    """18 servos at 115200 bps: the time of 4 queries and answers a servo, and little more."""
    specs = [spec(number) for number in range(1, 19)]
    watch, read, _ = watched(*specs, for_s=3.0)
    late = [servo_id for now_ns, servo_id in read if now_ns > 2 * NS_PER_S]
    reply_bytes = len("*18QD100\r*18QWD0\r*18QC70\r*18QV11990\r")
    round_s = 18 * (reply_bytes * 10 / 115200 + 1e-3)
    assert len(late) / 18 >= 0.8 * 1.0 / round_s
    assert watch.rounds["main"] > 20


def test_a_missing_servo_does_not_delay_the_others(watched, spec):
    watch, read, _ = watched(spec(1), targets=[target(1), target(2)])
    assert not watch.readings[0].is_silent
    assert watch.readings[1].is_silent
    assert len(read) > 100
    assert {servo_id for _, servo_id in read} == {1}


def test_a_servo_that_comes_back_is_seen_again(watched, spec):
    gone = Fault(kind=FaultKind.DEAF, servo_id=2, at_s=0.5, until_s=1.6)
    seen = []

    def look(watch, now_ns):
        seen.append((now_ns / NS_PER_S, watch.readings[1].is_silent))

    watched(spec(1), spec(2), for_s=3.5, faults=[gone], on_turn=look)
    assert not any(is_silent for at_s, is_silent in seen if at_s < 0.5)
    assert all(is_silent for at_s, is_silent in seen if 1.2 < at_s < 1.6)
    assert not any(is_silent for at_s, is_silent in seen if at_s > 3.3)


def test_two_buses_do_not_wait_for_each_other(spec, connected):
    from msgspec.structs import replace

    from lss_motion.playing.connection import Connection
    from lss_motion.sim.bus import SimPort

    quick = connected(spec(1), baud_bps=500000)
    slow = connected(spec(2), baud_bps=9600)
    buses = {
        "quick": replace(quick.buses["main"], name="quick"),
        "slow": replace(slow.buses["main"], name="slow"),
    }
    both = Connection(buses, quick.clock)
    both.ports = {
        "quick": SimPort(quick.simulated["main"], quick.clock),
        "slow": SimPort(slow.simulated["main"], quick.clock),
    }
    targets = [replace(target(1), bus="quick"), replace(target(2), bus="slow")]
    watch = Polling(targets, buses)

    def turn(watch, now_ns):
        if now_ns >= NS_PER_S:
            watch.stop()

    run(watch, both.ports, both.clock, on_turn=turn)
    assert watch.rounds["quick"] > 5 * watch.rounds["slow"] > 20


def test_a_moving_horn_is_seen_moving(watched, spec, connected):
    connection = connected(spec(1))
    connection.ask([Item(bus="main", command=Command(1, "D", 900, (("T", 2000),)))])
    watch = Polling([target(1)], connection.buses)
    statuses, speeds = set(), []

    def turn(watch, now_ns):
        (reading,) = watch.readings
        statuses.add(reading.status)
        speeds.append(reading.speed_deg_s or 0.0)
        if now_ns > 3 * NS_PER_S:
            watch.stop()

    run(watch, connection.ports, connection.clock, on_turn=turn)
    assert {Status.TRAVELING, Status.HOLDING} <= statuses
    assert max(speeds) == pytest.approx(45.0, abs=3.0)
    assert watch.readings[0].position_deg == pytest.approx(90.0, abs=0.5)


def test_an_alarm_is_reported_once_until_it_ends():
    reading = ServoState(target=target(1), temperature_c=60.0, voltage_v=12.0, current_a=0.1)
    alarms = Alarms(Thresholds())
    assert alarms.update([reading]) == []
    reading.temperature_c = 70.0
    assert alarms.update([reading]) == ["servo 1: 70 °C, from 65 on it is too hot"]
    reading.temperature_c = 71.0
    assert alarms.update([reading]) == []
    assert list(alarms.active.values()) == ["servo 1: 71 °C, from 65 on it is too hot"]
    reading.temperature_c = 60.0
    assert (alarms.update([reading]), alarms.active) == ([], {})
    reading.temperature_c = 70.0
    assert len(alarms.update([reading])) == 1


@pytest.mark.parametrize(
    ("wrong", "kind"),
    [
        ({"status": Status.SAFE_MODE}, "status"),
        ({"status": Status.BLOCKED}, "status"),
        ({"current_a": 1.6}, "current"),
        ({"voltage_v": 5.9}, "voltage"),
        ({"voltage_v": 12.7}, "voltage"),
        ({"misses": 3}, "silent"),
    ],
)
def test_every_problem_raises_its_alarm(wrong, kind):
    reading = ServoState(target=target(1), **wrong)
    assert [found for found, _ in Thresholds().alarms(reading)] == [kind]


def test_a_terminal_shows_servos_alarms_and_rates(watched, spec):
    from rich.console import Console

    hot = Fault(kind=FaultKind.HOT, servo_id=2, temperature_c=70.0)
    watch, _, _ = watched(spec(1, start_deg=12.0), spec(2), faults=[hot], for_s=1.0)
    alarms = Alarms(Thresholds())
    assert len(alarms.update(watch.readings)) == 1
    out = io.StringIO()
    Console(file=out, width=100).print(rendered(watch, alarms, 1.0))
    assert "12.0 deg" in out.getvalue()
    assert "servo 2: 70 °C" in out.getvalue()
    assert "rounds/s" in out.getvalue()


def test_a_sparkline_goes_from_the_lowest_to_the_highest():
    assert sparkline([0, 35, 70]) == "▁▅█"
    assert sparkline([1.0, 1.1, 0.9]) == "▁▁▁"
    assert sparkline([]) == ""


@pytest.mark.parametrize("latency_ms", [0, 16])
@pytest.mark.parametrize("line", ["#1QD", "#1QFPC"])
def test_another_host_is_an_alarm_and_a_late_reply_is_not(connected, spec, line, latency_ms):
    def texts(faults):
        targets = [target(1), target(2)]
        options = {"faults": faults, "usb_latency_ns": latency_ms * 1_000_000}
        connection = connected(spec(1), spec(2), **options)
        watch = Polling(targets, connection.buses)
        until_ns = connection.clock.now_ns() + 2_000_000_000

        def on_turn(watch, now_ns):
            if now_ns >= until_ns:
                watch.stop()

        run(watch, connection.ports, connection.clock, on_turn=on_turn)
        return Alarms(Thresholds()).update(watch.readings, watch.disturbed)

    assert texts([]) == []
    (text,) = texts([Fault(kind=FaultKind.SECOND_MASTER, text=line, every_s=0.03)])
    assert "another program or computer asks on this bus" in text


@pytest.fixture
def alarms_of(connected, spec):
    """Watch three servos for two seconds; return the alarms of each half second together."""

    def texts(*faults):
        connection = connected(*map(spec, (1, 2, 3)), faults=list(faults), seed=5)
        watch, alarms = (
            Polling([target(1), target(2), target(3)], connection.buses),
            Alarms(Thresholds()),
        )
        began_ns, found = connection.clock.now_ns(), []

        def on_turn(watch, now_ns):
            found.extend(alarms.update(watch.readings, watch.disturbed))
            if now_ns >= began_ns + 2_000_000_000:
                watch.stop()

        run(watch, connection.ports, connection.clock, on_turn=on_turn)
        return found

    return texts


@pytest.mark.parametrize("line", ["#254QD", "#254QMS"])
def test_another_host_that_asks_all_servos_at_once_is_an_alarm(alarms_of, line):
    """Their replies damage each other, so that no servo is named by them."""
    texts = alarms_of(Fault(kind=FaultKind.SECOND_MASTER, text=line, every_s=0.05))
    assert any("main: unreadable bytes come" in text for text in texts)
    assert any("asks several servos at once on this bus" in text for text in texts)


@pytest.mark.parametrize(
    "fault",
    [
        Fault(kind=FaultKind.CORRUPT_REPLY, ratio=0.1),
        Fault(kind=FaultKind.LOST_REPLY, ratio=0.1),
        Fault(kind=FaultKind.DEAF, servo_id=2, at_s=1.0),
        Fault(kind=FaultKind.WRONG_ID, servo_id=2, as_id=3),
    ],
    ids=lambda fault: fault.kind.value,
)
def test_damaged_and_lost_replies_are_no_other_host(alarms_of, fault):
    assert not any(
        "unreadable bytes" in text or "did not ask for" in text for text in alarms_of(fault)
    )


def test_servos_that_share_an_id_are_no_other_host(watched, spec):
    """Each query brings two replies, but nothing comes while nothing is asked."""
    double = Fault(kind=FaultKind.DOUBLE_REPLY, servo_id=2)
    watch, _, _ = watched(spec(1), spec(2), faults=[double], for_s=4.0)
    (text,) = watch.disturbed.values()
    assert "queries to id 2 bring several replies" in text
    assert "several servos share an id" in text


@pytest.mark.parametrize("every_s", [0.3, 0.9])
def test_a_host_that_asks_seldom_is_noticed_between_the_rounds(watched, spec, every_s):
    """On a full line its replies damage others, and so bring no more than was asked for."""
    master = Fault(kind=FaultKind.SECOND_MASTER, text="#1QV", every_s=every_s, at_s=0.5)
    watch, _, _ = watched(spec(1), spec(2), faults=[master], for_s=5.0)
    (text,) = watch.disturbed.values()
    assert "bus main: servo 1 sent" in text


def test_an_alarm_about_another_host_ends_when_that_is_gone(watched, spec):
    master = Fault(kind=FaultKind.SECOND_MASTER, text="#1QV", every_s=0.02, until_s=2.0)
    seen = []
    watched(
        spec(1),
        spec(2),
        faults=[master],
        for_s=8.5,
        baud_bps=38400,
        on_turn=lambda watch, now_ns: seen.append((now_ns, bool(watch.disturbed))),
    )
    active_ns = [now_ns for now_ns, is_active in seen if is_active]
    assert active_ns[0] < 2.0 * NS_PER_S < active_ns[-1] < 8.0 * NS_PER_S


@pytest.mark.parametrize("firmware", [779, 780])
def test_a_status_is_interpreted_by_the_firmware_of_the_servo(
    connected, spec, tmp_path, monkeypatch, capsys, firmware
):
    """An LSS-PRO with newer firmware reports 5 for holding, with older firmware 6."""
    robot = tmp_path / "robot.yaml"
    robot.write_text("""
robot: one
joints:
  arm: {id: 2, model: LSS-P-S1, range_deg: [0, 9], speed_max_deg_s: 9, accel_max_deg_s2: 90}
""")
    connection = connected(spec(2, "LSS-P-S1"), firmware=firmware)
    connection.ask([Item(bus="main", command=Command(2, "H"))])
    monkeypatch.setattr(connections, "connect", lambda *_, **__: connection)
    assert main(["monitor", str(robot), "--for", "1"]) == 0
    assert "holding" in capsys.readouterr().out
