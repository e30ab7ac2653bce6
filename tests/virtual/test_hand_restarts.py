"""A servo that restarts in the hands of a person moves only with its settings, and in its turn."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlaybackError
from lss_motion.playing.connection import connect
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.player.events import Faulted, Phase
from lss_motion.playing.runner import run
from lss_motion.robot.on_fault import Cause
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.system.clock import VirtualClock

S = 1_000_000_000
SPEED_DEG_S = 60.0
STEP_NS = S // 20


class Turning:
    """Turns j1 to and fro at `speed_deg_s`, as `jog` does, from 1 s on. A `Controls`."""

    def __init__(self, speed_deg_s=40.0, seconds=6.0, low_deg=-60.0, high_deg=60.0):
        self._speed_deg_s, self._seconds = speed_deg_s, seconds
        self._low_deg, self._high_deg = low_deg, high_deg
        self._sent_ns = 0
        self.events, self.errors = [], []

    def filenos(self):
        return []

    def act(self, hands_on, now_ns):
        if hands_on.phase is not Phase.SHOW or now_ns < S:
            return
        hands_on.take()
        if now_ns >= self._seconds * S:
            hands_on.stop()
        elif now_ns >= self._sent_ns + STEP_NS:
            self._sent_ns = now_ns
            here_deg = hands_on.readings["j1"].deg
            if here_deg < self._low_deg or here_deg > self._high_deg:
                way = 1.0 if here_deg < self._low_deg else -1.0
                self._speed_deg_s = np.copysign(self._speed_deg_s, way)
            way_deg = self._speed_deg_s * 0.3
            target_deg = min(max(here_deg + way_deg, self._low_deg - 10), self._high_deg + 10)
            # Half the time that it takes: the servo must keep the limit.
            hands_on.move("j1", target_deg, 0.15)


def turned(kit, faults, *, stored=None, person=None, **fields):
    fields = {"baud_bps": 115200, **fields}
    robot = kit.robot(2, speed_max_deg_s=SPEED_DEG_S, **fields)
    joints = {n: replace(one, stored=stored or {}) for n, one in robot.joints.items()}
    robot = replace(robot, joints=joints)
    clock, person, events = VirtualClock(), person or Turning(), []
    hands_on = HandsOn(robot, list(robot.joints))
    with connect(robot.buses, robot=robot, clock=clock, faults=faults) as connection:
        run(hands_on, connection.ports, clock, controls=person, on_event=events.append)
    bus = connection.simulated["bus0"]
    end_ns = bus.lines[-1][0]
    bus.advance(end_ns + S)
    horn_deg = bus.horn_deg(range(0, end_ns, 5_000_000))[:, 1]
    speed_deg_s = np.abs(np.diff(horn_deg)) / 0.005
    return hands_on, bus, [e for e in events if isinstance(e, Faulted)], horn_deg, speed_deg_s


@pytest.mark.parametrize("at_s", [1.93, 2.511, 2.97, 4.04])
@pytest.mark.parametrize("deaf_s", [0.02, 0.1, 0.6])
def test_no_move_leaves_before_the_settings(kit, at_s, deaf_s):
    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=at_s, deaf_s=deaf_s)
    hands_on, bus, faults, horn_deg, speed_deg_s = turned(kit, [reset])
    assert hands_on.error is None
    assert speed_deg_s.max() <= 1.1 * SPEED_DEG_S
    assert np.ptp(horn_deg[int(5.0 / 0.005) :]) > 20.0, "it goes on"
    (fault,) = [fault for fault in faults if fault.kind is Cause.RESTARTED]
    assert (fault.joint, "servo 2" in fault.cause) == ("j1", True)
    back_ns = int((at_s + deaf_s) * S)
    later = [line for at_ns, line in bus.lines if at_ns > back_ns and line.startswith(b"#2")]
    first = next(n for n, line in enumerate(later) if line.startswith(b"#2D"))
    assert b"#2SD600\r" in later[:first]


def test_a_servo_that_takes_another_gyre_with_a_restart_ends_it(kit):
    faults = [
        Fault(kind=FaultKind.FACTORY, servo_id=2, at_s=2.5, deaf_s=0.02),
    ]
    hands_on, bus, _, _, speed_deg_s = turned(kit, faults, stored={"G": -1.0})
    assert isinstance(hands_on.error, PlaybackError)
    assert "gyre (G) 1" in str(hands_on.error)
    assert speed_deg_s.max() <= 1.1 * SPEED_DEG_S
    late = [at_ns for at_ns, line in bus.lines if at_ns > 2.6 * S and line.startswith(b"#2D")]
    assert not late
    assert bus.lines[-1][1] == b"#254H\r"


def test_a_lost_turn_is_noticed_before_any_further_move(kit):
    person = Turning(seconds=9.0, low_deg=200.0, high_deg=230.0)
    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=7.0, deaf_s=0.02)
    hands_on, bus, faults, horn_deg, _ = turned(
        kit, [reset], person=person,
        position_min_deg=0.0, position_max_deg=250.0, turns="by_hand",
    )  # fmt: skip
    assert hands_on.error is None
    assert Cause.LOST_TURN in [fault.kind for fault in faults]
    late = [line for at_ns, line in bus.lines if at_ns > 7.05 * S and line.startswith(b"#2D")]
    assert not late
    assert horn_deg.max() <= 250.5


def test_a_held_servo_that_is_limp_is_named(kit):
    class Holding(Turning):
        def act(self, hands_on, now_ns):
            if hands_on.phase is Phase.SHOW and not self._sent_ns:
                self._sent_ns = now_ns
                hands_on.hold(["j1"])
            if now_ns >= 6 * S:
                hands_on.stop()

    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=2.5, deaf_s=0.02)
    _, _, faults, _, _ = turned(kit, [reset], person=Holding())
    assert [(fault.joint, fault.kind) for fault in faults] == [("j1", Cause.RESTARTED)]


@pytest.mark.parametrize("baud_bps", [115_200, 1_000_000])
@pytest.mark.parametrize("at_s", [2.0, 2.33, 3.0, 3.71, 4.05])
def test_two_servos_with_one_id_are_not_moved(kit, baud_bps, at_s):
    other = Fault(kind=FaultKind.STORED, servo_id=1, at_s=at_s, settings={"ID": 2})
    hands_on, bus, faults, _, _ = turned(kit, [other], baud_bps=baud_bps)
    is_named = "several servos (serial numbers" in str(hands_on.error)
    assert is_named or ("j1", Cause.SILENT) in [(one.joint, one.kind) for one in faults]
    late_ns = int((at_s + 0.2) * S)
    assert not [line for at_ns, line in bus.lines if at_ns > late_ns and line.startswith(b"#2D")]


def test_damaged_answers_are_no_restart(kit):
    bad = Fault(kind=FaultKind.CORRUPT_REPLY, ratio=0.1, at_s=1.0)
    hands_on, _, faults, horn_deg, _ = turned(kit, [bad])
    assert hands_on.error is None
    assert not [fault for fault in faults if fault.kind in (Cause.RESTARTED, Cause.LOST_TURN)]
    assert np.ptp(horn_deg) > 100.0
