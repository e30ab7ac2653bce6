"""The command `record`: a motion that a person shows by hand becomes a sequence file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import TOLERANCE_MAX_DEG, add_command, robot_at
from lss_motion.cli.hands import HandsControls, chosen_joints, joint_lines, perform
from lss_motion.cli.messages import ended_by, say
from lss_motion.cli.options import add_options, number_from
from lss_motion.errors import EXIT_FINISHED, BusError, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs
from lss_motion.files.texts import counted
from lss_motion.playing.player.events import Phase
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.take import Take
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.robot.model import Robot


SECONDS_MAX: Final = 3600.0

DESCRIPTION: Final = """\
Record a motion that you show by hand, and write it as a sequence file for lss-play.

  lss-motion record --robot my_robot.yaml -o wave.yaml
  lss-motion record --robot my_robot.yaml -o wave.yaml --seconds 10      without keys

Keys: l makes the joints limp, or holds them again; r starts and stops a recording; p keeps the
angles of the joints as a pose; u removes the last pose or recording; q writes the file and ends.
A limp arm falls: hold it before you press l. With --feel soft the joints hold softly instead, and
stay where you push them. However it ends (also with Ctrl-C), the servos hold their angles and get
their settings back, and everything recorded so far is written.
Recordings keep their times. Between poses the robot moves at its approach_speed_deg_s.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    record = add_command(commands, "record", _record, DESCRIPTION)
    add_options(record, "--robot", required=True, help="the robot file")
    add_options(record, "--output", required=True, metavar="S.yaml", help="the sequence to write")
    add_options(record, "--port")
    record.add_argument(
        "--joints",
        nargs="+",
        metavar="NAME",
        help="only these joints or groups; the others get no commands (default all)",
    )
    record.add_argument(
        "--feel", choices=("limp", "soft"), default="limp", help="limp (default), or hold softly"
    )
    record.add_argument(
        "--seconds",
        type=number_from(0.0, SECONDS_MAX, "seconds", is_above=True),
        metavar="N",
        help="no keys: make the joints limp at once and record for N seconds",
    )
    record.add_argument(
        "--tolerance-deg",
        type=number_from(0.0, TOLERANCE_MAX_DEG, "degrees"),
        default=1.0,
        metavar="DEG",
        help="largest deviation of the sequence from the recording (default 1)",
    )
    add_options(record, "--force", "--hand")
    add_options(record, "--virtual", help="simulate in virtual time; needs --seconds")


def _record(arguments: argparse.Namespace) -> int:
    from lss_motion.maintenance.take import Take
    from lss_motion.playing.connection import ask_limits, is_simulated
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.sim.hand import hand_of

    robot = ask_limits(robot_at(arguments.robot, arguments.port))
    joints = chosen_joints(robot, arguments.joints)
    _check(arguments, simulated=is_simulated(robot))
    take = Take(tuple(joints))
    hands_on = HandsOn(robot, joints, is_soft=arguments.feel == "soft")
    lost: BusError | None = None
    with RecordControls(take, seconds=arguments.seconds) as controls:
        try:
            perform(
                hands_on,
                controls,
                is_virtual=arguments.virtual,
                hand=None if arguments.hand is None else hand_of(arguments.hand, robot),
            )
        except BusError as error:
            lost = error
        take.add(hands_on.take())
        take.finish()
    if hands_on.error is not None:
        raise hands_on.error
    _write(arguments, take, robot)
    if lost is not None:
        raise lost
    if controls.signal_number is not None:
        return ended_by(controls.signal_number)
    return EXIT_FINISHED


def _check(arguments: argparse.Namespace, *, simulated: bool) -> None:
    output = Output(arguments.output, OutputKind.YAML)
    require_outputs([output], sources=[arguments.robot], is_forced=arguments.force)
    if not simulated and (arguments.virtual or arguments.hand is not None):
        raise InputError("--virtual and --hand need the simulated bus: use --port sim://")
    if arguments.virtual and arguments.seconds is None:
        raise InputError("--virtual needs --seconds: there are no keys in virtual time")


def _write(arguments: argparse.Namespace, take: Take, robot: Robot) -> None:
    from lss_motion.maintenance.take import sequence_of
    from lss_motion.planning.summaries import fit_text, plan_lines
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.write import write_sequence

    if not take.parts:
        say("nothing was recorded, so no file was written")
        return
    shown = sequence_of(take, robot, arguments.output.stem, tolerance_deg=arguments.tolerance_deg)
    comments = [*shown.comments, *map(fit_text, shown.fits)]
    write_sequence(shown.sequence, arguments.output, comments=comments)
    say(f"{arguments.output}: {counted(shown.sequence.keyframes, 'keyframe')}")
    say("\n".join([*comments, *plan_lines(plan(shown.sequence, robot), robot)]))


KEYS: Final = "l limp/hold  r record  p pose  u undo  q write and end"
RATE_NS: Final = NS_PER_S
"""The shown rate of readings is counted over this time."""


class RecordControls(HandsControls):
    """Fills `take` from the readings. With `seconds`, makes the joints limp and records at once."""

    def __init__(self, take: Take, *, seconds: float | None = None) -> None:
        super().__init__()
        self._take_shown = take
        self._seconds = seconds
        self._end_ns: int | None = None
        self._count = 0
        self._rate_hz = 0.0
        self._counted_ns = 0

    def begin(self, hands_on: HandsOn) -> None:
        if self._seconds is not None:
            hands_on.let_go(j.name for j in hands_on.joints)
            self._take_shown.start(self.now_ns)
            self._end_ns = self.now_ns + ns_from_s(self._seconds)
        elif not self.has_keys:
            self.print("there is no terminal for keys: give --seconds")
            hands_on.stop()
        else:
            self.print(f"hold the robot, then press l to make it limp. {KEYS}")

    def turn(self, hands_on: HandsOn) -> None:
        fresh = hands_on.take()
        self._take_shown.add(fresh)
        self._count += len(fresh)
        if self.now_ns - self._counted_ns >= RATE_NS:
            self._rate_hz = self._count * NS_PER_S / (self.now_ns - self._counted_ns)
            self._count, self._counted_ns = 0, self.now_ns
        if self._end_ns is not None and self.now_ns >= self._end_ns:
            self._end_ns = None
            self._take_shown.finish()
            hands_on.stop()

    def press(self, key: str, hands_on: HandsOn) -> None:
        take, names = self._take_shown, [joint.name for joint in hands_on.joints]
        match key:
            case "l":
                if hands_on.limp:
                    hands_on.hold(names)
                    self.print("holding")
                else:
                    hands_on.let_go(names)
                    self.print("let go: the joints are limp")
            case "r" if take.running is None:
                take.start(self.now_ns)
                self.print("recording")
            case "r":
                take.finish()
                self.print(f"recorded, {take.recorded_s:.1f} s in all")
            case "p" if take.running is not None:
                self.print("recording; press r to end it first")
            case "p":
                take.drop({name: hands_on.readings[name].deg for name in names})
                self.print(f"pose {len(take.parts)}")
            case "u":
                self.print("removed the last part" if take.undo() else "there is nothing to remove")
            case _:
                pass

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        if hands_on.phase is not Phase.SHOW:
            return []
        take = self._take_shown
        state = "RECORDING" if take.running is not None else f"{counted(take.parts, 'part')}"
        per_joint_hz = self._rate_hz / len(hands_on.joints)
        head = f"{state}  {take.recorded_s:.1f} s  {per_joint_hz:.0f} readings/s a joint   {KEYS}"
        return [head, *joint_lines(hands_on, now_ns)]
