"""The open ports of a robot: the one way in which every command reaches its servos.

    with connect(robot.buses, robot=robot) as connection:
        answers = connection.ask([Item(bus="main", command=Command(5, "QV"))])

A bus whose port is `sim://` is simulated in this process, from the joints of `robot`; any other
port is opened with pyserial if it can be a serial line (`system.devices`), including the
pseudo-terminal of `lss-motion sim`.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Final, Self

from msgspec.structs import replace

from lss_motion.errors import BlockedPortError, BusError, InputError, LostPortError
from lss_motion.playing.discovery import SilentPause, limit_questions, robot_from_answers
from lss_motion.playing.player.checks import check_answers
from lss_motion.playing.player.handshake import Conversation
from lss_motion.playing.player.preflight import Examination
from lss_motion.playing.runner import D, run
from lss_motion.system.clock import MonotonicClock, VirtualClock
from lss_motion.system.devices import opened_name
from lss_motion.system.port import SerialPort
from lss_motion.system.signals import raising
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from lss_motion.playing.discovery import Unasked
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.handshake import Answers, Item
    from lss_motion.playing.runner import Controls
    from lss_motion.robot.model import Bus, Joint, Robot
    from lss_motion.sim.bus import SimBus
    from lss_motion.sim.deviation import Deviation
    from lss_motion.sim.faults import Fault
    from lss_motion.sim.hand import HandMotion
    from lss_motion.system.clock import Clock
    from lss_motion.system.port import Port

SIMULATED: Final = "sim://"

PORT_BACK_S: Final = 15.0
"""Longest wait for the port of an LSS-PRO that restarts; the maker's example waits 10 s
(FACTS.md P12)."""
PORT_TRY_S: Final = 0.5
"""Time between two attempts to open it."""


def with_port(robot: Robot, port: str | None) -> Robot:
    """Return the robot with `port` in place of the port of its bus.

    Raises `InputError` for an empty text, and if the robot has several buses: then the robot file
    must give the port of each.
    """
    if port is None:
        return robot
    if not port:
        raise InputError("--port is empty: give a device such as /dev/ttyUSB0, or sim://")
    if port != SIMULATED and len(robot.buses) > 1:
        raise InputError(
            f"robot {robot.name!r} has {len(robot.buses)} buses; --port names only one. Write the "
            f"ports into the robot file",
            path=robot.path,
        )
    buses = {name: replace(bus, port=port) for name, bus in robot.buses.items()}
    return replace(robot, buses=buses)


def is_simulated(robot: Robot) -> bool:
    """Return whether every bus is simulated in this process.

    Raises `InputError` for a mixture: the results of such a run would have no clear meaning.
    """
    simulated = [bus.is_simulated for bus in robot.buses.values()]
    if any(simulated) and not all(simulated):
        raise InputError(
            "some buses are sim:// and some are not; give all or none", path=robot.path
        )
    return all(simulated)


def connect(
    buses: Mapping[str, Bus],
    *,
    robot: Robot | None = None,
    clock: Clock | None = None,
    seed: int = 0,
    faults: Sequence[Fault] = (),
    hand: HandMotion | None = None,
    deviation: Deviation | None = None,
    is_recorded: bool = True,
) -> Connection:
    """Open the port of every bus; all or none.

    On `sim://` buses `robot` gives the servos, `seed` and `faults` the disturbances, `hand` the
    hand that moves limp joints, and `deviation` how the servos differ from what is assumed. Unless
    `is_recorded`, they keep neither lines nor horn angles, so a run of days needs no memory. Raises
    `BusError` for a port that cannot be opened and `InputError` for `sim://` without a robot.
    """
    robot = None if robot is None else robot.servo_robot
    for bus in buses.values():
        if not bus.is_simulated:
            opened_name(bus.port)  # All are judged before one is opened.
    connection = Connection(buses, clock or MonotonicClock())
    try:
        for bus in buses.values():
            if not bus.is_simulated:
                connection.ports[bus.name] = SerialPort(bus.port, bus.baud_bps)
                continue
            connection.simulate(
                bus,
                robot,
                seed=seed,
                faults=faults,
                hand=hand,
                deviation=deviation,
                is_recorded=is_recorded,
            )
    except BaseException:
        connection.close()
        raise
    return connection


def ask_limits(robot: Robot, *, port: str | None = None) -> Robot:
    """Return the robot with the limits that its file leaves to the servos, read from the servos.

    Nothing moves. Raises `BusError` when a servo does not answer.
    """
    if not robot.unread:
        return robot
    there = with_port(robot, port)
    clock = VirtualClock() if is_simulated(there) else MonotonicClock()
    with connect(there.buses, robot=there, clock=clock) as connection:
        return robot_from_answers(robot, connection.ask(limit_questions(robot)))


class Connection:
    """Open ports by the name of their bus, and the clock of their runs.

    `simulated` holds the buses behind `sim://`, which record what they receive. A context manager;
    on closing, it waits until everything has left.
    """

    def __init__(self, buses: Mapping[str, Bus], clock: Clock) -> None:
        self.buses = dict(buses)
        self.clock = clock
        self._raising = raising()
        self.ports: dict[str, Port] = {}
        self.simulated: dict[str, SimBus] = {}
        self.echoing: set[str] = set()
        """Buses whose port returns what is sent."""
        self.unasked: dict[tuple[str, int], Unasked] = {}
        """By bus and rate what arrived without a query, where that was observed (`survey`)."""

    def __enter__(self) -> Self:
        self._raising = raising()  # One that has been used cannot be entered again.
        self._raising.__enter__()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, *_: object) -> None:
        try:
            self.close()
        except BlockedPortError as blocked:
            # Servos without a reply are explained by a port from which no query left.
            if error is None or isinstance(error, BusError):
                raise blocked from None
        finally:
            self._raising.__exit__(None, None, None)

    def ask(self, items: Iterable[Item]) -> Mapping[tuple[str, int, str], int | str | None]:
        """Send queries and actions; return `(bus, servo id, keyword)` → value.

        A query without a reply is absent. Raises `BusError` when a port is lost.
        """
        return self.run(Conversation(items, self.buses)).answers

    def examined(self, joints: Iterable[Joint], robot: Robot) -> tuple[Answers, list[str]]:
        """Return the answers of a preflight of `joints`, and its warnings; nothing moves.

        Raises where these joints of `robot` may not be moved, as `checks.check_answers` does.
        """
        joints = list(joints)
        preflight = self.run(Examination(joints, robot)).preflight
        preflight.require_own_ids()
        warnings = check_answers(joints, preflight.answers, robot, stored=preflight.stored)
        return preflight.answers, warnings

    def run(
        self,
        driven: D,
        *,
        on_event: Callable[[Event], None] | None = None,
        on_turn: Callable[[D, int], None] | None = None,
        controls: Controls[D] | None = None,
    ) -> D:
        """Run the loop on `driven` until it is finished; return it."""
        run(driven, self.ports, self.clock, on_event=on_event, on_turn=on_turn, controls=controls)
        return driven

    def wait(self, seconds: float) -> None:
        """Let time pass; what arrives meanwhile is dropped."""
        self.run(SilentPause(self.clock.now_ns() + ns_from_s(seconds)))

    def restart(self, items: Iterable[Item], wait_s: float) -> None:
        """Send commands that restart servos, and let `wait_s` pass; what arrives is dropped.

        A port that an LSS-PRO drops when it restarts (FACTS.md P12) is opened again. Raises
        `BusError` if it stays away.
        """
        try:
            self.ask(items)
            self.wait(wait_s)
        except LostPortError:
            until_ns = self.clock.now_ns() + ns_from_s(PORT_BACK_S)
            for name in [name for name, port in self.ports.items() if _is_lost(port)]:
                with contextlib.suppress(BusError):
                    self.ports.pop(name).close()
                while not self._is_back(name):
                    if self.clock.now_ns() > until_ns:
                        raise
                    self.wait(PORT_TRY_S)
            self.wait(wait_s)

    def _is_back(self, bus_name: str) -> bool:
        """Open a lost port again if it is there; return whether it was."""
        try:
            self.reopen(bus_name)
        except BusError:
            return False
        return True

    def set_baud(self, bus_name: str, baud_bps: int) -> None:
        """Change the rate of one bus; raises `BusError` if the port does not accept it."""
        self.ports.pop(bus_name).close()
        self.buses[bus_name] = replace(self.buses[bus_name], baud_bps=baud_bps)
        if (sim_bus := self.simulated.get(bus_name)) is not None:
            sim_bus.set_host_rate(baud_bps, self.clock.now_ns())
        self.reopen(bus_name)

    def reopen(self, bus_name: str) -> Port:
        """Open the same device again; raises `BusError` while it is absent."""
        bus = self.buses[bus_name]
        sim_bus = self.simulated.get(bus_name)
        if sim_bus is None:
            self.ports[bus_name] = SerialPort(bus.port, bus.baud_bps)
        else:
            from lss_motion.sim.bus import SimPort

            self.ports[bus_name] = SimPort(sim_bus, self.clock)
        return self.ports[bus_name]

    def simulate(
        self,
        bus: Bus,
        robot: Robot | None,
        *,
        seed: int,
        faults: Sequence[Fault],
        hand: HandMotion | None = None,
        deviation: Deviation | None = None,
        is_recorded: bool = True,
    ) -> None:
        """Open a simulated bus with the servos of `robot`."""
        if robot is None:
            raise InputError("sim:// simulates the servos of a robot file; give one")
        from lss_motion.sim.bus import SimPort, bus_from_robot

        options: dict[str, Any] = {}
        if deviation is not None:
            faults = [*faults, *deviation.faults(robot)]
            options = deviation.bus_options(robot)
        if faults:
            options["faults"] = faults
        sim_bus = bus_from_robot(robot, bus.name, seed=seed, hand=hand, **options)
        if is_recorded:
            sim_bus.record()
        self.simulated[bus.name] = sim_bus
        self.ports[bus.name] = SimPort(sim_bus, self.clock)

    def close(self) -> None:
        """Close every port. Raises `BlockedPortError` if bytes did not leave one of them."""
        with contextlib.ExitStack() as stack:
            for port in self.ports.values():
                stack.callback(port.close)


def _is_lost(port: Port) -> bool:
    try:
        port.read()
    except LostPortError:
        return True
    return False
