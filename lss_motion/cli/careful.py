"""The careful run before a show: one joint at a time, and what it teaches is kept.

`careful_run` asks, moves and reports; `Learning` knows whether it is to be offered, and writes what
was learnt beside the robot file (`robot.learnt`). A simulated robot teaches nothing about a real
one: nothing is kept of it.
"""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.cli.messages import agrees, ended_by, put
from lss_motion.errors import EXIT_FINISHED, EXIT_INTERRUPTED, InputError, PlaybackError
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Sequence

    from lss_motion.cli.terminal import Terminal
    from lss_motion.maintenance.careful import CarefulRun
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.learnt import Learnt
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.deviation import Deviation
    from lss_motion.sim.faults import Fault


CAREFUL_RATE: Final = 0.5
"""Rate of the show clock after a careful run: every speed is half of that of the plan, and every
acceleration a quarter. Chosen: slow enough for a person to see a mistake and press q, fast enough
for a show to look like itself; + raises it to full speed."""

PASSED: Final = (
    "All joints moved as expected. If one turned to another side than listed, answer n, and\n"
    "correct its `direction` (lss-motion calibrate). The {what} at {rate:.0%} of its "
    "speed; + raises it."
)
BEGIN: Final = (
    "Support the robot, keep clear of it, and watch that each joint turns as listed; q stops.\n"
    "Begin?"
)
OFFER: Final = (
    "No show has been played to its end with this robot file on a real port. Press c for a\n"
    "careful run first: one joint at a time, a few degrees, slowly.\n"
)


class Learning:
    """What is known about the joints of a show, and what is learnt in this run."""

    def __init__(self, robot: Robot, joints: Iterable[str], *, is_kept: bool) -> None:
        """Read the file beside the robot file, if there is one; warn if it is damaged."""
        self._robot = robot
        self._joints = [robot.joints[name] for name in joints]
        self._is_kept = is_kept and robot.path is not None
        if not self._is_kept:
            return
        from lss_motion.robot.learnt import Learnt, load_learnt

        self._learnt = Learnt(robot=robot.name)
        try:
            self._learnt = load_learnt(robot)
        except InputError as error:
            put(
                f"warning: what was learnt about this robot cannot be used: {error}\n"
                f"Mend or remove this file; otherwise the next completed show replaces it",
                sys.stderr,
            )

    @property
    def offer(self) -> str:
        """The text that offers a careful run; empty if the robot has completed a show."""
        is_new = self._is_kept and not self._learnt.has_completed(self._joints)
        return OFFER if is_new else ""

    def note_careful(self, run: CarefulRun, joint: Joint) -> None:
        """Keep the result of one joint; of one that deviated, nothing is kept."""
        if not self._is_kept:
            return
        if (found := run.found) is None:
            self._keep(self._learnt.without(joint))
            return
        self._keep(
            self._learnt.updated(
                joint,
                careful_run=_today(),
                direction_ok=True,
                scale_ok=True,
                lag_s=found.lag_s,
                speed_ratio=found.speed_ratio,
            )
        )

    def note_completed(self) -> None:
        """Keep that a show was played to its end."""
        if not self.offer:
            return
        learnt = self._learnt
        for joint in self._joints:
            if learnt.of(joint).completed_run is None:
                learnt = learnt.updated(joint, completed_run=_today())
        self._keep(learnt)

    def _keep(self, learnt: Learnt) -> None:
        """Write the file; a robot that cannot have one is played all the same."""
        from lss_motion.robot.learnt import save_learnt

        self._learnt = learnt
        try:
            save_learnt(learnt, self._robot)
        except InputError as error:
            self._is_kept = False
            put(f"warning: what was learnt about this robot is not kept: {error}", sys.stderr)


def _today() -> str:
    return datetime.now(tz=UTC).date().isoformat()


def run_carefully(
    arguments: argparse.Namespace,
    run: Callable[[float | None], int | None],
    careful: Callable[[], int],
) -> int:
    """Run, after a careful run if that is asked for; return the exit code.

    `run` gets the rate after a careful run, or None; it returns None where a person wants a careful
    run first, which it offers only without a rate.
    """
    code = None if arguments.careful else run(None)
    if code is None:
        code = careful() or run(CAREFUL_RATE)
    assert code is not None, "it is offered once"
    return code


def careful_run(
    arguments: argparse.Namespace,
    robot: Robot,
    joints: Iterable[str],
    learning: Learning,
    print_line: Callable[[str], None],
    *,
    what: str = "show plays",
    faults: Sequence[Fault] = (),
    deviation: Deviation | None = None,
) -> int:
    """Move one joint after the other; return 0 if all of them did what was expected.

    `what` follows at `CAREFUL_RATE`. Another code: a person has stopped it, or did not agree.
    Raises for a joint that deviates, and as a preflight does.
    """
    from lss_motion.cli.terminal import Terminal
    from lss_motion.playing.connection import connect, is_simulated
    from lss_motion.system.clock import MonotonicClock, VirtualClock

    is_asked = not (arguments.yes or is_simulated(robot))
    if is_asked:  # A person can only agree to moves that are listed.
        print_line = put
    tested = _tested(robot, joints, print_line)
    clock = VirtualClock() if arguments.virtual else MonotonicClock()
    options: dict[str, Any] = {"robot": robot, "clock": clock, "seed": arguments.seed}
    with connect(robot.buses, **options, faults=faults, deviation=deviation) as connection:
        moving = _announce(connection, robot, tested, print_line)
        if moving and is_asked and not agrees(BEGIN, sys.stderr):
            put("no: nothing was moved", sys.stderr)
            return EXIT_INTERRUPTED
        with Terminal() as terminal:
            for joint, standing_deg, way_deg in moving:
                run = _run_joint(connection, robot, joint, (standing_deg, way_deg), terminal)
                if run.is_stopped:
                    put(f"stopped at {joint.name}: it holds, and nothing was played", sys.stderr)
                    return ended_by(terminal.signal_number)
                learning.note_careful(run, joint)
                if run.error is not None:
                    raise run.error
                print_line(_result_line(run, joint))
    print_line(PASSED.format(what=what, rate=CAREFUL_RATE))
    return EXIT_FINISHED


def _tested(robot: Robot, names: Iterable[str], print_line: Callable[[str], None]) -> list[Joint]:
    """Return the joints that can be measured; print a line for each other."""
    joints = [robot.joints[name] for name in names]
    for joint in joints:
        if joint.drive == "stepped":
            print_line(
                f"{joint.name}: not tested, an RC servo on an LSS-2IO reports neither angle nor "
                f"speed. Watch it when the show begins"
            )
    return [joint for joint in joints if joint.drive != "stepped"]


def _announce(
    connection: Connection,
    robot: Robot,
    joints: Sequence[Joint],
    print_line: Callable[[str], None],
) -> list[tuple[Joint, float, float]]:
    """Query every servo, print the coming moves; return the joints that have room for them.

    With each where it stands and by how much it will turn, in servo degrees.
    """
    from lss_motion.maintenance.careful import top_deg_s, way_of

    if not joints:
        return []
    robot.require_turns(joints)
    answers, warnings = connection.examined(joints, robot)
    for text in warnings:
        print_line(f"warning: {text}")
    moving = []
    print_line("careful run, one joint at a time, out and back three times:")
    for joint in joints:
        standing_deg = _standing_deg(joint, answers)
        way_deg = way_of(joint, robot, standing_deg)
        here_deg, there_deg = map(joint.joint_deg, (standing_deg, standing_deg + way_deg))
        if not way_deg:
            print_line(f"  {joint.name}: not tested, its range leaves no room for a move")
            continue
        print_line(
            f"  {joint.name} (servo {joint.servo_id}): {here_deg:z.1f} to {there_deg:z.1f} "
            f"deg and back, at most {top_deg_s(joint, robot):.3g} deg/s"
        )
        moving.append((joint, standing_deg, way_deg))
    return moving


def _standing_deg(joint: Joint, answers: Answers) -> float:
    from lss_motion.playing.player import handshake

    standing_deg = handshake.reported(joint, answers, "QD")
    assert standing_deg is not None, "`examined` raises without it"
    return standing_deg


def _run_joint(
    connection: Connection,
    robot: Robot,
    joint: Joint,
    announced_deg: tuple[float, float],
    terminal: Terminal,
) -> CarefulRun:
    """Run the legs of one joint, which a person knows: from where it stood, by its way."""
    from lss_motion.maintenance.careful import NEAR_DEG, CarefulRun
    from lss_motion.playing.runner import run

    stood_deg, way_deg = announced_deg
    answers, _ = connection.examined([joint], robot)
    standing_deg = _standing_deg(joint, answers)
    if abs(standing_deg - stood_deg) > NEAR_DEG:
        raise PlaybackError(
            f"joint {joint.name!r} stood at {joint.joint_deg(stood_deg):z.1f} deg and is at "
            f"{joint.joint_deg(standing_deg):z.1f} deg, although it was not moved yet. Support it, "
            f"and begin anew; if nothing moved it, its servo counts other angles than its `model`",
            joint=joint.name,
        )
    timed = _timed(joint, answers)
    careful = CarefulRun(timed, robot, answers, standing_deg=stood_deg, way_deg=way_deg)
    run(careful, connection.ports, connection.clock, controls=terminal)
    return careful


def _timed(joint: Joint, answers: Answers) -> Joint:
    """Return the joint as a careful run moves it: by its ramps, also where a show streams it.

    The limit of a streamed joint may be above the ramps that its servo is set to.
    """
    if joint.drive == "timed":
        return joint
    from lss_motion.playing.player import handshake

    own = [handshake.reported(joint, answers, keyword) for keyword in ("QAA", "QAD")]
    ramps = [joint.response.ramp_ratio * ramp for ramp in own if ramp]
    return replace(joint, drive="timed", accel_max_deg_s2=min([joint.accel_max_deg_s2, *ramps]))


def _result_line(run: CarefulRun, joint: Joint) -> str:
    found = run.found
    assert found is not None, "it ended without an error"
    pulse = "" if found.has_witness else "; see that it was as far, its servo has no second measure"
    lag = "too slow to tell its lag"
    if found.lag_s is not None:
        assumed_ms = MS_PER_S * joint.response.lag_s
        lag = f"{MS_PER_S * found.lag_s:.0f} ms late ({assumed_ms:.0f} assumed)"
    return (
        f"  {joint.name}: turned {found.way_deg:+z.1f} deg and back as expected, {lag}, "
        f"{found.speed_ratio:.2f} of the speed{pulse}"
    )
