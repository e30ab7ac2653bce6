"""The command `field-test`: the hour with a real robot that judges what is assumed of servos."""

from __future__ import annotations

import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.cli.careful import Learning, careful_run
from lss_motion.cli.commands import (
    SIMULATED_NOTE,
    add_command,
    deviation_of,
    require_joint,
    robot_at,
)
from lss_motion.cli.messages import agrees, ended_by, put, say
from lss_motion.cli.options import add_options, number_from
from lss_motion.errors import (
    EXIT_FINISHED,
    InputError,
    PlaybackError,
    StoppedError,
)
from lss_motion.files.output import Output, OutputKind, require_outputs
from lss_motion.files.texts import counted
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.terminal import Terminal
    from lss_motion.maintenance.field.archive import Archive
    from lss_motion.maintenance.field.measure import Figures
    from lss_motion.playing.connection import Connection
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.deviation import Deviation
    from lss_motion.sim.faults import Fault

DESCRIPTION: Final = """\
Spend an hour with a real robot, and learn which assumptions about its servos are right.

  lss-motion field-test my_robot.yaml -o first.zip              begin, or go on with what is missing
  lss-motion field-test my_robot.yaml -o first.zip --joints elbow wrist
  lss-motion field-test my_robot.yaml -o try.zip --virtual --sim t_law=exact      practise it
  lss-motion field-test --compare first.zip second.zip

It leads through the steps: scan and stored limits; careful first moves; for each joint the laws of
its moves, without and with a second load, moves of 5, 2 and 0.5 degrees, the filter of EM0; replies
to a group; a restart and an unplugged servo; a show at three speeds, of which one is kept out of
the fit. Each is one question; a no leaves it out. The archive holds figures, logs, the same figures
of a simulated robot, and for each assumption of FACTS.md: confirmed, refuted by what, or not seen.

Nothing is stored in a servo without a question. q or Ctrl-C brakes and holds; the archive keeps the
steps that are over, and the same command goes on with the next one.

Exit codes: 0 all steps are over; 2 a file or an argument is wrong; 4 port or servo not reachable;
5 a step failed, and others may be over; 130 interrupted.
"""
SECOND_LOAD_DEG: Final = 1.5
"""What the second load of a simulated robot adds to its droop."""
HANDLING_S: Final = 60.0
"""Time for what a person does in a step: reading the question, fetching a weight. Chosen."""
BUSY_S: Final = {"scan": 1.0, "careful": 15.0, "laws": 27.0, "small": 12.0, "filter": 8.0,
                "groups": 1.0, "restart": 2.0, "unplug": 10.0, "show": 100.0}  # fmt: skip
"""How long each kind of step lasts, in virtual time; a careful run, for each joint."""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    added = add_command(commands, "field-test", _field_test, DESCRIPTION)
    added.add_argument("robot", nargs="?", type=Path, metavar="ROBOT", help="the robot file")
    added.add_argument(
        "--joints", nargs="+", metavar="NAME", help="only these joints (default: all)"
    )
    added.add_argument(
        "--compare", nargs=2, type=Path, metavar=("A.zip", "B.zip"), help="compare two archives"
    )
    added.add_argument(
        "--span-deg",
        type=number_from(-1e6, 1e6),
        default=20.0,
        metavar="DEG",
        help="largest motion to either side (default 20)",
    )
    add_options(added, "--output", metavar="F.zip", help="the archive: new, or to go on with")
    add_options(added, "--force", help="begin anew, and overwrite the archive")
    add_options(added, "--port", "--virtual", "--seed", "--sim")


class StepPlan(NamedTuple):
    """A step of the hour: its name in the archive, what a person is asked, and what it measures."""

    name: str
    question: str
    measure: Callable[[Place], Figures]
    joint: str = ""
    is_loaded: bool = False
    fault_s: float = 0.0
    """When, in virtual time, its servo restarts as one that is unplugged."""

    @property
    def kind(self) -> str:
        """What it measures."""
        return self.name.partition(" ")[0]


class Place(Struct, kw_only=True):
    """The robot on which a step runs: the one of the file, or a simulated one as assumed."""

    arguments: argparse.Namespace
    robot: Robot
    joints: list[Joint]
    terminal: Terminal | None
    is_virtual: bool
    deviation: Deviation | None = None
    faults: tuple[Fault, ...] = ()
    logs: dict[str, bytes] = field(default_factory=dict)
    lasted_s: float = 0.0

    def on(self, use: Callable[[Connection], Figures]) -> Figures:
        """Open the ports, let `use` measure, and note how long it took."""
        from lss_motion.playing.connection import connect
        from lss_motion.system.clock import MonotonicClock, VirtualClock

        clock = VirtualClock() if self.is_virtual else MonotonicClock()
        began_ns = clock.now_ns()
        names = {joint.bus for joint in self.joints}
        options: dict[str, Any] = {"robot": self.robot, "clock": clock}
        options |= {"seed": self.arguments.seed, "faults": self.faults}
        buses = {name: self.robot.buses[name] for name in names}
        with connect(buses, **options, deviation=self.deviation) as connection:
            figures = use(connection)
            self.lasted_s += s_from_ns(clock.now_ns() - began_ns)
            return figures


class Person:
    """Asks a person for each step. In virtual time every answer is yes, and is counted."""

    def __init__(self, *, is_virtual: bool) -> None:
        self._is_virtual = is_virtual
        self.asked = 0

    def agrees(self, question: str) -> bool:
        """Ask; return whether it was done."""
        self.asked += 1
        if self._is_virtual:
            say(f"{question} [y: simulated]")
            return True
        return agrees(question)

    def agrees_to_store(self, question: str) -> bool:
        """Ask whether servos may store something; never in virtual time."""
        self.asked += 1
        return not self._is_virtual and agrees(question)


def _field_test(arguments: argparse.Namespace) -> int:
    from lss_motion.maintenance.field import archive as archives

    if arguments.compare is not None:
        if arguments.robot is not None:
            raise InputError("--compare goes without a robot")
        one, other = map(archives.load, arguments.compare)
        for line in archives.comparison_lines(one, other):
            say(line)
        return EXIT_FINISHED
    if arguments.robot is None or arguments.output is None:
        raise InputError("give a robot file and -o F.zip, or --compare A.zip B.zip")
    place = _place(arguments)
    archive = _archive(arguments, place)
    code = _hour(arguments, place, archive)
    if code in {EXIT_FINISHED, PlaybackError.exit_code}:
        for line in archives.verdict_lines(archive):
            say(line)
    lasted_s = sum(step.lasted_s for step in archive.steps.values())
    say(
        f"{arguments.output}: {counted(archive.steps, 'step')}, the robot was busy for "
        f"{lasted_s / 60.0:.0f} min, a person was asked "
        f"{sum(step.asked for step in archive.steps.values())} times"
    )
    return code


def _hour(arguments: argparse.Namespace, place: Place, archive: Archive) -> int:
    """Go through the steps that are not over; return the exit code."""
    from lss_motion.maintenance.field.archive import save

    plans = [plan for plan in step_plans(place.joints) if plan.name not in archive.steps]
    for line in hour_lines(plans, len(place.joints)):
        say(line)
    person, code = Person(is_virtual=place.is_virtual), EXIT_FINISHED
    for number, plan in enumerate(plans, start=1):
        say(f"step {number} of {len(plans)}: {plan.name}")
        if not person.agrees(plan.question):
            say("  left out")
            continue
        try:
            _run_step(plan, place, archive, person)
        except PlaybackError as error:  # A joint that does not move as it should ends its step.
            say(f"  {error}", sys.stderr)
            code = error.exit_code
            continue
        except StoppedError as error:
            put(f"{error}; the same command goes on with this step", sys.stderr)
            return error.ended_code
        save(archive, arguments.output)
    save(archive, arguments.output)
    return code


def _place(arguments: argparse.Namespace) -> Place:
    """Return where the test runs; raise `InputError` for arguments that cannot work."""
    from lss_motion.playing.connection import ask_limits, is_simulated
    from lss_motion.protocol.constants import Family

    robot = ask_limits(robot_at(arguments.robot, arguments.port).servo_robot)
    simulated = is_simulated(robot)
    if arguments.virtual and not simulated:
        raise InputError("--virtual needs the simulated bus: use it with --port sim://")
    if not simulated and not sys.stdin.isatty():
        raise InputError("a field test asks a person at each step, and there is no terminal")
    names = dict.fromkeys(arguments.joints or robot.joints)
    for name in names:
        require_joint(robot, name)
    joints = [robot.joints[name] for name in names]
    joints = [joint for joint in joints if joint.model.family is not Family.IO2]
    if not joints:
        raise InputError("none of these joints reports its position", path=robot.path)
    if simulated:
        say(SIMULATED_NOTE)
    return Place(
        arguments=arguments,
        robot=robot,
        joints=joints,
        terminal=None,
        is_virtual=bool(arguments.virtual or simulated),
        deviation=deviation_of(arguments, robot),
    )


def _archive(arguments: argparse.Namespace, place: Place) -> Archive:
    """Return the archive to go on with, or a new one; raise `InputError` for another file."""
    from lss_motion.maintenance.field.archive import Archive, load

    path: Path = arguments.output
    names = tuple(joint.name for joint in place.joints)
    if path.exists() and not arguments.force:
        archive = load(path)
        if (archive.robot, archive.joints) != (place.robot.name, names):
            raise InputError(
                f"is the test of {archive.robot!r} with {', '.join(archive.joints)}; choose "
                f"another name, or add --force to begin anew",
                path=path,
            )
        say(f"{path}: goes on, {counted(archive.steps, 'step')} over")
        return archive
    output = Output(path, OutputKind.ARCHIVE)
    require_outputs([output], sources=[arguments.robot], is_forced=arguments.force)
    return Archive(
        robot=place.robot.name,
        joints=names,
        is_simulated=place.is_virtual,
        made=datetime.now(tz=UTC).isoformat(timespec="seconds"),
        files={"robot.yaml": Path(arguments.robot).read_bytes()},
    )


def step_plans(joints: list[Joint]) -> list[StepPlan]:
    """Return the steps of the hour for these joints, in their order."""
    from lss_motion.maintenance.field import measure

    first = joints[0].name
    plans = [
        StepPlan("scan", "Switch the robot on. Ask all servos? Nothing moves.", _scanned),
        StepPlan(
            "careful",
            "Support the robot and keep clear of it. Move one joint after the other, a few "
            "degrees, slowly? q stops.",
            _careful,
        ),
    ]
    for joint in joints:
        plans += [
            StepPlan(
                f"laws {joint.name}",
                f"Keep the range of {joint.name} clear. Measure it for half a minute?",
                _laws,
                joint.name,
            ),
            StepPlan(
                f"small {joint.name}", f"Move {joint.name} by 5, 2 and 0.5 deg?", _small, joint.name
            ),
            StepPlan(
                f"filter {joint.name}", f"Move {joint.name} by 5 deg in EM0?", _filter, joint.name
            ),
        ]
    plans += [
        StepPlan(
            f"laws {first} loaded",
            f"Fix a second load to {first}, half of what it can carry. Measure it again?",
            _laws,
            first,
            is_loaded=True,
        ),
        StepPlan(
            "groups",
            "Take the load off again. Ask several servos in one line?",
            lambda place: place.on(
                lambda connection: measure.group_replies(connection, place.robot, place.joints)
            ),
        ),
        StepPlan(
            f"restart {first}",
            f"Support {first}: it will go limp. Restart its servo?",
            lambda place: place.on(
                lambda connection: measure.restart(connection, _of(place, first))
            ),
            first,
        ),
        StepPlan(
            f"unplug {first}",
            f"Support {first}. After the y, unplug its servo for 2 s and plug it in. Ready?",
            lambda place: place.on(
                lambda connection: measure.unplugged(connection, _of(place, first))
            ),
            first,
            fault_s=2.0,
        ),
        StepPlan("show", "Keep the whole robot clear. Play a show at three speeds?", _show),
    ]
    return plans


def hour_lines(plans: list[StepPlan], count: int) -> list[str]:
    """Return what is to come for `count` joints: how long it lasts, and what a person has to do."""
    busy_s = sum(BUSY_S[plan.kind] * (count if plan.kind == "careful" else 1) for plan in plans)
    whole_s = busy_s + HANDLING_S * len(plans)
    return [
        f"{counted(plans, 'step')}: the robot is busy for about {busy_s / 60.0:.0f} min, with you "
        f"about {whole_s / 60.0:.0f} min; you are asked {len(plans)} times, and have to fix a "
        f"load, take it off, and unplug a servo"
    ]


def _of(place: Place, name: str) -> Joint:
    return place.robot.joints[name]


def _run_step(plan: StepPlan, place: Place, archive: Archive, person: Person) -> None:
    """Measure a step, then the same on a simulated robot that is as assumed; keep both."""
    from lss_motion.cli.terminal import Terminal
    from lss_motion.maintenance.field.archive import FieldStep

    asked_before = person.asked
    with Terminal(is_virtual=place.is_virtual) as terminal:
        own = _with(place, plan, deviation=place.deviation, terminal=terminal)
        try:
            figures = plan.measure(own)
        except StoppedError as error:
            raise StoppedError(str(error), ended_by(terminal.signal_number)) from error
    if plan.name == "scan" and figures.get("excesses"):
        _offer_limits(own, figures["excesses"], person)
    archive.files |= own.logs
    usual = _with(place, plan, deviation=None, terminal=None)
    simulated = _as_assumed(usual, plan)
    asked = 1 + person.asked - asked_before
    archive.steps[plan.name] = FieldStep(figures, simulated, own.lasted_s, asked)


def _with(
    place: Place, plan: StepPlan, *, deviation: Deviation | None, terminal: Terminal | None
) -> Place:
    """Return the place of one step: with its load and its fault, where these are simulated."""
    faults: tuple[Fault, ...] = ()
    if plan.is_loaded and place.is_virtual:
        deviation = _loaded(deviation)
    if plan.fault_s and place.is_virtual:
        from lss_motion.sim.faults import Fault, FaultKind

        joint = _of(place, plan.joint)
        faults = (
            Fault(
                kind=FaultKind.RESET,
                servo_id=joint.servo_id,
                bus=joint.bus,
                at_s=plan.fault_s,
                deaf_s=plan.fault_s,
            ),
        )
    joints = [_of(place, plan.joint)] if plan.joint else place.joints
    return Place(
        arguments=place.arguments,
        robot=place.robot,
        joints=joints,
        terminal=terminal,
        is_virtual=place.is_virtual,
        deviation=deviation,
        faults=faults,
    )


def _loaded(deviation: Deviation | None) -> Deviation:
    from lss_motion.sim.deviation import Deviation

    own = deviation or Deviation()
    return replace(own, droop_deg=own.droop_deg + SECOND_LOAD_DEG)


def _as_assumed(place: Place, plan: StepPlan) -> Figures:
    """Return the figures of a step on a simulated robot; {} where that has none."""
    from lss_motion.playing.connection import SIMULATED, with_port

    if plan.kind == "careful":
        return {}
    place.robot = with_port(place.robot, SIMULATED)
    simulated = _with(
        Place(
            arguments=place.arguments,
            robot=place.robot,
            joints=place.joints,
            terminal=None,
            is_virtual=True,
        ),
        plan,
        deviation=None,
        terminal=None,
    )
    try:
        return plan.measure(simulated)
    except PlaybackError:
        return {}


def _scanned(place: Place) -> Figures:
    from lss_motion.maintenance.field import measure

    figures = place.on(
        lambda connection: measure.found_servos(connection, place.robot, place.joints)
    )
    if place.terminal is not None:
        for text in figures["warnings"]:
            say(f"  warning: {text}")
    return figures


def _offer_limits(place: Place, excesses: list[str], person: Person) -> None:
    """Ask whether the servos shall store the limits of their joints; store them after a yes."""
    from lss_motion.maintenance.api import targets_at, write_settings
    from lss_motion.playing.player.checks import stored_limits

    for text in excesses:
        say(f"  {text}: with that it would restart")
    if not person.agrees_to_store("Store the limits of the robot file in the servos?"):
        return

    def store(connection: Connection) -> Figures:
        for bus in dict.fromkeys(joint.bus for joint in place.joints):
            own = [joint for joint in place.joints if joint.bus == bus]
            targets = targets_at(connection, bus, {one.servo_id: one.name for one in own})
            write_settings(connection, targets, {one.name: stored_limits(one) for one in own})
        return {}

    place.on(store)


def _careful(place: Place) -> Figures:
    from lss_motion.system.clock import MonotonicClock

    arguments = place.arguments
    arguments.yes = True  # The step itself was the question.
    learning = Learning(place.robot, [], is_kept=False)
    clock = MonotonicClock()
    began_ns = clock.now_ns()
    names = [joint.name for joint in place.joints]
    code = careful_run(
        arguments,
        place.robot,
        names,
        learning,
        lambda text: say(f"  {text}"),
        what="field test goes on",
        deviation=place.deviation,
    )
    if code != EXIT_FINISHED:
        raise StoppedError("stopped: it holds")
    if not place.is_virtual:
        place.lasted_s += s_from_ns(clock.now_ns() - began_ns)
    return {"joints": names}


def _laws(place: Place) -> Figures:
    from lss_motion.maintenance.field import measure

    (joint,) = place.joints
    return place.on(
        lambda connection: measure.laws(
            connection, place.robot, joint, place.arguments.span_deg, place.terminal
        )
    )


def _small(place: Place) -> Figures:
    from lss_motion.maintenance.field import measure

    (joint,) = place.joints
    return place.on(
        lambda connection: measure.small_moves(connection, place.robot, joint, place.terminal)
    )


def _filter(place: Place) -> Figures:
    from lss_motion.maintenance.field import measure

    (joint,) = place.joints
    return place.on(
        lambda connection: measure.filtered(connection, place.robot, joint, place.terminal)
    )


def _show(place: Place) -> Figures:
    """Play the reference show at each speed, through the player; keep the logs."""
    from lss_motion.maintenance.api import recordings_of
    from lss_motion.maintenance.field import show
    from lss_motion.playing.log import ByteLog, read_log
    from lss_motion.playing.player import handshake
    from lss_motion.playing.run import Observer, perform

    standing: dict[str, float] = {}

    def look(connection: Connection) -> Figures:
        answers, _ = connection.examined(place.joints, place.robot)
        standing.update(handshake.standing_deg(place.joints, answers))
        return {}

    place.on(look)
    logs = {}
    with tempfile.TemporaryDirectory() as folder:
        for speed in show.SPEEDS:
            path = Path(folder) / f"show_{speed:g}.log"
            program, trajectory = show.reference_show(
                place.robot, standing, place.arguments.span_deg, speed
            )
            with ByteLog(path, may_wait=place.is_virtual) as log:
                result = perform(
                    program,
                    place.robot,
                    is_virtual=place.is_virtual,
                    seed=place.arguments.seed,
                    trajectory=trajectory,
                    deviation=place.deviation,
                    observer=Observer(make_tap=log.started, controls=place.terminal),
                )
            if result.error is not None:
                raise result.error
            if result.report.outcome == "stopped":
                raise StoppedError("stopped: the robot holds")
            place.lasted_s += program.duration_s
            place.logs[f"logs/{path.name}"] = path.read_bytes()
            logs[speed] = recordings_of(read_log(path), place.robot)
    return show.judged(logs)
