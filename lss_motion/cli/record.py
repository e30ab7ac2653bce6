"""`lss-motion record`: show a motion by hand, get a sequence file.

The keys of `lss-motion record`, and what is seen meanwhile.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, add_force, refuse_overwriting, robot_at
from lss_motion.cli.exchange import fit_text, tolerance
from lss_motion.cli.hands import HandsControls, joint_lines
from lss_motion.cli.messages import ended_by
from lss_motion.errors import EXIT_FINISHED, BusError, InputError
from lss_motion.player.events import Phase
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.maintenance.take import Take
    from lss_motion.robot.model import Robot


SECONDS_MAX: Final = 3600.0

DESCRIPTION: Final = """\
Record a motion that a hand shows to the robot, as a sequence file that lss-play plays.

Keys: l let the joints go limp, or hold them again; r start or stop recording; p keep where the
joints are as a pose; u forget the last pose or stretch; q write the file and end.
A limp arm falls: hold it before you press l. With --feel soft the joints hold softly instead and
stay where they are pushed. However it ends (Ctrl-C too), the servos hold where they are, get their
settings back, and what was shown so far is written.
Recorded stretches keep their times; between poses the robot goes at its approach_speed_deg_s.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    record = add_command(
        commands, "record", _record, "show a motion by hand, get a sequence file", DESCRIPTION
    )
    record.add_argument("--robot", type=Path, required=True, metavar="FILE")
    record.add_argument("-o", "--output", type=Path, required=True, metavar="S.yaml")
    record.add_argument("--port", metavar="URL", help="serial device or URL; sim:// is simulated")
    record.add_argument(
        "--joints", nargs="+", metavar="NAME", help="joints or groups; the others are left alone"
    )
    record.add_argument(
        "--feel", choices=("limp", "soft"), default="limp", help="how joints feel that are let go"
    )
    record.add_argument(
        "--seconds",
        type=_seconds,
        metavar="N",
        help="no keys: let go at once and record for so long",
    )
    record.add_argument(
        "--tolerance-deg",
        type=tolerance,
        default=1.0,
        metavar="DEG",
        help="how far the keys may lead away from what was shown (default 1)",
    )
    add_force(record)
    record.add_argument(
        "--hand",
        metavar="FILE|SEED",
        help="simulated bus only: who leads the joints, a CSV t_s,<joint>,... or a seed",
    )
    record.add_argument(
        "--virtual", action="store_true", help="simulated bus in virtual time, with --seconds"
    )


def _record(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.hands import chosen_joints, perform
    from lss_motion.connection import ask_limits, is_simulated
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.maintenance.take import Take
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
    refuse_overwriting(arguments.output, is_forced=arguments.force)
    if not arguments.output.absolute().parent.is_dir():
        raise InputError("cannot be written: there is no such folder", path=arguments.output)
    if not simulated and (arguments.virtual or arguments.hand is not None):
        raise InputError("--virtual and --hand need the simulated bus: use --port sim://")
    if arguments.virtual and arguments.seconds is None:
        raise InputError("--virtual needs --seconds: nobody can press keys in virtual time")


def _write(arguments: argparse.Namespace, take: Take, robot: Robot) -> None:
    from lss_motion.cli.planning import plan_lines
    from lss_motion.maintenance.take import sequence_of
    from lss_motion.sequence.write import write_sequence
    from lss_motion.trajectory.planner import plan

    if not take.parts:
        print("nothing was shown, so no file was written")
        return
    shown = sequence_of(take, robot, arguments.output.stem, tolerance_deg=arguments.tolerance_deg)
    comments = [*shown.comments, *map(fit_text, shown.fits)]
    write_sequence(shown.sequence, arguments.output, comments=comments)
    print(f"{arguments.output}: {len(shown.sequence.keyframes)} keyframes")
    print("\n".join([*comments, *plan_lines(plan(shown.sequence, robot), robot)]))


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 < value <= SECONDS_MAX:
        raise argparse.ArgumentTypeError(f"{text} is not in 0 to {SECONDS_MAX:g} seconds")
    return value


KEYS: Final = "l limp/hold  r record  p pose  u undo  q write and end"
RATE_NS: Final = NS_PER_S
"""Readings are counted over so long for the rate that is shown."""


class RecordControls(HandsControls):
    """Fills `take` from what is read; with `seconds`, lets go and records by itself."""

    def __init__(self, take: Take, *, seconds: float | None = None) -> None:
        super().__init__()
        self._take_of_hand = take
        self._seconds = seconds
        self._end_ns: int | None = None
        self._count = 0
        self._rate_hz = 0.0
        self._counted_ns = 0

    def begin(self, hands_on: HandsOn) -> None:
        if self._seconds is not None:
            hands_on.let_go(j.name for j in hands_on.joints)
            self._take_of_hand.start(self.now_ns)
            self._end_ns = self.now_ns + ns_from_s(self._seconds)
        elif not self.has_keys:
            self.say("no terminal to press keys on: give --seconds")
            hands_on.stop()
        else:
            self.say(f"hold the robot, then press l to let it go. {KEYS}")

    def turn(self, hands_on: HandsOn) -> None:
        fresh = hands_on.take()
        self._take_of_hand.add(fresh)
        self._count += len(fresh)
        if self.now_ns - self._counted_ns >= RATE_NS:
            self._rate_hz = self._count * NS_PER_S / (self.now_ns - self._counted_ns)
            self._count, self._counted_ns = 0, self.now_ns
        if self._end_ns is not None and self.now_ns >= self._end_ns:
            self._end_ns = None
            self._take_of_hand.finish()
            hands_on.stop()

    def press(self, key: str, hands_on: HandsOn) -> None:
        take, names = self._take_of_hand, [joint.name for joint in hands_on.joints]
        match key:
            case "l":
                if hands_on.limp:
                    hands_on.hold(names)
                    self.say("holding")
                else:
                    hands_on.let_go(names)
                    self.say("let go")
            case "r" if take.running is None:
                take.start(self.now_ns)
                self.say("recording")
            case "r":
                take.finish()
                self.say(f"recorded, {take.recorded_s:.1f} s in all")
            case "p" if take.running is not None:
                self.say("recording; press r first to end it")
            case "p":
                take.drop({name: hands_on.readings[name].deg for name in names})
                self.say(f"pose {len(take.parts)}")
            case "u":
                self.say("forgotten" if take.undo() else "there is nothing to forget")
            case _:
                pass

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        if hands_on.phase is not Phase.SHOW:
            return []
        take = self._take_of_hand
        state = "RECORDING" if take.running is not None else f"{len(take.parts)} parts"
        per_joint_hz = self._rate_hz / len(hands_on.joints)
        head = f"{state}  {take.recorded_s:.1f} s  {per_joint_hz:.0f} readings/s a joint   {KEYS}"
        return [head, *joint_lines(hands_on, now_ns)]
