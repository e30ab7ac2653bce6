"""The command `send`: one command or query to one servo, from the shell."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.cli.commands import add_command, robot_at
from lss_motion.cli.messages import agrees, put, say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, EXIT_INTERRUPTED, BusError, InputError
from lss_motion.files.texts import comma_text

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.single_command import CommandVerdict, Standing
    from lss_motion.playing.connection import Connection
    from lss_motion.protocol.codec import Decoded, Language
    from lss_motion.protocol.framing import Command
    from lss_motion.robot.model import Joint, Robot


DESCRIPTION: Final = """\
Send one command to one servo and print its reply. Values have the units of the reference page
(`lss-motion reference`), not those on the wire.

  lss-motion send --port /dev/ttyUSB0 --id 5 QD            prints *5QD132   13.2 deg
  lss-motion send --port /dev/ttyUSB0 --id 5 D 90 T 500    moves to 90 deg in 500 ms
  lss-motion send --port /dev/ttyUSB0 --id 5 --raw D900T500    the same, as on the wire
  lss-motion send --port /dev/ttyUSB0 --id 5 QSD1          the stored value, as QSD 1
  lss-motion send --robot my_robot.yaml --id 5 QV          port and family from the robot file

Without a robot file the servo is asked for its model and its firmware first (QMS, QF).

A query without a reply ends with exit code 4. Servos never reply to an action.

Queries, H, L and LED are sent at once. Before anything else is sent to a real servo you see what it
does, and are asked; --yes skips the question. With --robot a move keeps the range and the speed of
its joint: T is made longer, and a target outside is refused. --force sends it all the same, and a
command to every servo (id 254). On sim:// nothing is asked, but the same is refused.
"""


WITH_VALUE: Final = re.compile(r"([A-Za-z]+)(-?[0-9]+)")
"""`D900` and `QSR1`, as the documents write them. A query has no unit in that place."""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    send = add_command(commands, "send", _send, DESCRIPTION)
    add_options(send, "--port")
    add_options(
        send, "--robot", help="the robot file; its servos are simulated if the port is sim://"
    )
    add_options(send, "--baud", default=115200)
    send.add_argument(
        "--firmware",
        type=int,
        metavar="N",
        help="firmware of the servo, such as 370 (default: what the servo replies)",
    )
    send.add_argument(
        "--family",
        choices=("LSS", "LSS-PRO", "LSS-2IO"),
        help="family of the servo (default: that of the robot file, or what the servo replies)",
    )
    send.add_argument(
        "--id", type=int, required=True, metavar="N", dest="servo_id", help="id of the servo"
    )
    send.add_argument("--raw", action="store_true", help="send the words unchanged")
    add_options(send, "--yes", help="send without the question")
    add_options(
        send,
        "--force",
        help="also send what leaves the limits of the joint, or changes every servo",
    )
    send.add_argument(
        "words", nargs="+", metavar="WORD", help="KEYWORD [VALUE [MODIFIER VALUE]...]"
    )


def _send(arguments: argparse.Namespace) -> int:
    from lss_motion.maintenance.single_command import judge
    from lss_motion.playing.connection import SIMULATED, connect
    from lss_motion.playing.player.handshake import Item
    from lss_motion.robot.model import Bus

    robot, joint = _robot(arguments), None
    bus = Bus(name="main", port=arguments.port or "", baud_bps=arguments.baud, firmware=0)
    if robot is not None:
        joint = next((j for j in robot.joints.values() if j.servo_id == arguments.servo_id), None)
        bus = next(iter(robot.buses.values())) if joint is None else robot.buses[joint.bus]
    with connect({bus.name: bus}, robot=robot) as connection:
        servo = _servo(connection, bus.name, arguments, joint)
        command = _command(arguments, servo)
        item = Item(bus=bus.name, command=command)
        if not item.is_query:
            standing = None if joint is None else _standing(connection, joint, command)
            verdict = judge(command, servo.language, joint, standing)
            if not _is_agreed(arguments, verdict, is_simulated=bus.port.startswith(SIMULATED)):
                put("no: nothing was sent", sys.stderr)
                return EXIT_INTERRUPTED
            command = verdict.command
            item = Item(bus=bus.name, command=command)
        answers = connection.ask([item])
    if not item.is_query:
        return EXIT_FINISHED
    address = (bus.name, command.servo_id, command.keyword)
    if address not in answers:
        raise BusError(
            f"no reply to {command.keyword} from servo {command.servo_id} on {bus.port} at "
            f"{bus.baud_bps} bps",
            url=bus.port,
        )
    say(_reply_text(servo, command, answers[address]))
    return EXIT_FINISHED


class _AskedServo(NamedTuple):
    """The language of the servo, and what it answers to QF; None: unknown."""

    language: Language
    firmware: int | None


def _servo(
    connection: Connection, bus: str, arguments: argparse.Namespace, joint: Joint | None
) -> _AskedServo:
    """Return what the options, the robot file and the servo itself state about it.

    The servo is asked for what the options leave open. A command that stops it (H, L) or that all
    servos receive is sent without such questions.
    """
    from lss_motion.maintenance.single_command import HARMLESS
    from lss_motion.playing.discovery import family_of
    from lss_motion.playing.player.handshake import Item
    from lss_motion.protocol.codec import Language
    from lss_motion.protocol.constants import BROADCAST_ID, Family
    from lss_motion.protocol.framing import Command

    servo_id, firmware = arguments.servo_id, arguments.firmware
    family = None if arguments.family is None else Family(arguments.family)
    if joint is not None and family in (None, joint.model.family):
        language = joint.model.language
    else:
        language = Language(family or Family.LSS)
    is_known = family is not None or joint is not None
    keyword = arguments.words[0].upper().rstrip("-0123456789")
    if servo_id == BROADCAST_ID or keyword in HARMLESS:
        return _AskedServo(language, firmware)
    keywords = ([] if is_known else ["QMS"]) + (["QF"] if firmware is None else [])
    answers = connection.ask(
        Item(bus=bus, command=Command(servo_id, keyword), tries=2)
        for keyword in keywords
        if keyword != "QF" or language.family is not Family.IO2
    )
    model, version = (answers.get((bus, servo_id, keyword)) for keyword in ("QMS", "QF"))
    if model is not None:
        language = Language(family_of(str(model)))
    return _AskedServo(language, firmware or (version if isinstance(version, int) else None))


def _standing(connection: Connection, joint: Joint, command: Command) -> Standing | None:
    """Return where the servo of a joint stands, if the command is a move to an angle."""
    from lss_motion.maintenance.single_command import TO_ANGLE, read_standing, standing_queries
    from lss_motion.playing.player.handshake import Item
    from lss_motion.protocol.framing import Command

    if command.keyword not in TO_ANGLE:
        return None
    # Each number must come twice: a corrupted one would give a move that is too fast.
    items = [
        Item(
            bus=joint.bus,
            command=Command(joint.servo_id, keyword),
            agree_within=round(joint.model.wire_per_deg) if keyword == "QD" else 0,
        )
        for keyword in standing_queries(joint)
    ]
    answers = connection.ask(items)
    return read_standing(
        joint,
        {
            keyword: value
            for (_, servo_id, keyword), value in answers.items()
            if servo_id == joint.servo_id
        },
    )


def _is_agreed(
    arguments: argparse.Namespace, verdict: CommandVerdict, *, is_simulated: bool
) -> bool:
    """Show what a command does; return whether it may be sent. Raises `InputError` if it may not.

    A simulated robot is not asked about, but keeps the same limits, so that what works on `sim://`
    works on a robot.
    """
    from lss_motion.cli.terminal import is_at_keyboard
    from lss_motion.maintenance.single_command import Consent

    if verdict.consent is Consent.FORCE and not arguments.force:
        raise InputError(
            f"{verdict.text}: {'; '.join(verdict.notes)}. Nothing was sent; --force sends it"
        )
    for line in (verdict.text, *verdict.notes):
        put(line, sys.stderr)
    if verdict.consent is Consent.NONE or is_simulated or arguments.yes:
        return True
    if not is_at_keyboard():
        raise InputError(
            "there is no terminal to agree on: nothing was sent. Run it in a terminal, or add "
            "--yes to send it without the question"
        )
    return agrees("send it?", sys.stderr)


def _robot(arguments: argparse.Namespace) -> Robot | None:
    if arguments.robot is None:
        if arguments.port is None or arguments.port.startswith("sim://"):
            raise InputError("give --port, or --robot with the servos that are simulated")
        return None
    return robot_at(arguments.robot, arguments.port).servo_robot


def _command(arguments: argparse.Namespace, servo: _AskedServo) -> Command:
    """Return the command of the words: raw, or with values in physical units."""
    from lss_motion.protocol.codec import make_command
    from lss_motion.protocol.framing import Command, CommandParser

    words: list[str] = arguments.words
    if arguments.raw:
        line = f"#{arguments.servo_id}{''.join(words)}\r".encode("ascii", "replace")
        parsed = CommandParser().feed(line)
        if len(parsed) != 1 or not isinstance(parsed[0], Command):
            raise InputError(f"{line!r} is not one command of the form #<id><KEYWORD><value>")
        return parsed[0]
    if joined := WITH_VALUE.fullmatch(words[0]):
        if not joined[1].upper().startswith("Q") or len(words) > 1:
            raise InputError(
                f"{words[0]!r} is a keyword with a value: give {joined[1]} and the value as two "
                f"words, in the units of `lss-motion reference`; or --raw sends it unchanged"
            )
        words = [joined[1], joined[2]]
    numbers = [_number(word) for word in words[1::2]]
    if len(words) % 2 == 1 and len(words) > 1:
        raise InputError("a keyword is followed by a value, then by pairs of modifier and value")
    modifiers = dict(zip([word.upper() for word in words[2::2]], numbers[1:], strict=True))
    return make_command(
        servo.language,
        arguments.servo_id,
        words[0],
        numbers[0] if numbers else None,
        modifiers,
        firmware=servo.firmware,
    )


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(f"{word!r} is not a number{comma_text(word)}") from None


def _reply_text(servo: _AskedServo, command: Command, value: int | str | None) -> str:
    from lss_motion.protocol.codec import read_reply
    from lss_motion.protocol.framing import Reply, encode

    reply = Reply(command.servo_id, command.keyword, value)
    line = encode(reply)[:-1].decode("ascii")
    suffix = command.value if isinstance(command.value, int) else None
    statement = read_reply(servo.language, reply, suffix=suffix)
    if statement is None:
        return line
    return f"{line}   {_meaning(servo, command, statement)}".rstrip()


def _meaning(servo: _AskedServo, command: Command, statement: Decoded) -> str:
    """Return the value with its unit; a code as its name."""
    from lss_motion.protocol.constants import Led, SafeModeCause, status_from

    if statement.value is None:
        return "no value"
    if isinstance(statement.value, int):
        try:
            match command.keyword, command.value:
                case "Q", 1:
                    return SafeModeCause(statement.value).name.lower().replace("_", " ")
                case "Q", _:
                    family = servo.language.family
                    return status_from(statement.value, family, servo.firmware).value
                case "QLED", _:
                    return Led(statement.value).name.lower()
                case _:
                    pass
        except ValueError:  # No document names this code: print the number.
            pass
    text = f"{statement.value:g}" if isinstance(statement.value, float) else str(statement.value)
    return f"{text} {statement.unit.value}"
