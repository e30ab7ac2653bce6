"""The command `sim`: a simulated robot for this and any other program."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import ended_by, say
from lss_motion.cli.options import add_options, add_robot
from lss_motion.errors import InputError

if TYPE_CHECKING:
    from lss_motion.cli.commands import Commands


USB_LATENCY_MAX_MS: Final = 255
"""The largest value of the latency timer of an FTDI adapter."""

DESCRIPTION: Final = """\
Simulate the buses of a robot behind pseudo-terminals. Any program that opens a serial port can talk
to them. Prints the path of each port and runs until Ctrl-C.

  lss-motion sim my_robot.yaml --link /tmp/robot
  lss-play show.yaml --port /tmp/robot             in another terminal

Simulated: the bus (baud rate, ten bits a byte, turnaround, colliding replies, group lines and
slots of firmware 370, replies that firmware up to 368 damages now and then), every documented
command and query, ramps and the EM0 filter, lag, load, backlash, top speed by voltage, currents,
heat, stalls and safe mode. A servo in RC mode gets no pulses; 30 s without a byte end that mode.
Not simulated: inertia of the load, the start-up sequence of the LED, EEPROM wear, the acceleration
sensors of LSS-PRO (they report 0), LSS-2IO boards with other sketches than 2RC. Physical values are
those of the documents; where these give none, lss_motion.sim.physics marks an assumption.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    sim = add_command(commands, "sim", _sim, DESCRIPTION)
    sim.epilog = f"{_faults_text()}\n{_deviation_text()}"
    add_robot(sim, is_required=True)
    sim.add_argument(
        "--link", type=Path, metavar="PATH", help="make a symbolic link with this path to the port"
    )
    add_options(sim, "--seed")
    add_options(sim, "--faults", help="faults to simulate; see below")
    add_options(
        sim,
        "--hand",
        help="a simulated hand moves the limp joints from power-up on: a CSV file t_s,<joint>,... "
        "or a seed",
    )
    sim.add_argument(
        "--lines",
        choices=("strict", "lenient"),
        default="strict",
        help="what servos do with lines that no document describes, such as '#1 D500' or "
        "'#1D100.0': strict, they ignore them (default), or lenient, they take them as they seem "
        "to be meant; both are named and counted",
    )
    sim.add_argument(
        "--usb-latency-ms",
        type=_latency,
        default=0,
        metavar="N",
        help="simulate an adapter that delivers replies every N ms (16 is usual; default 0: none)",
    )


def _faults_text() -> str:
    """Return the description of a faults file."""
    from lss_motion.sim.faults import FaultKind

    width = max(len(kind) for kind in FaultKind)
    kinds = "\n".join(f"  {kind:{width}}  {kind.meaning}" for kind in FaultKind)
    return f"""\
A faults file has one row per fault; times are seconds from power-up:

  faults:
    - {{kind: lost_reply, servo: 5, at_s: 2, until_s: 4, ratio: 0.1}}
    - {{kind: reset, servo: 7, at_s: 3}}

Without at_s a fault begins at power-up, without until_s it lasts for ever, without servo or bus it
applies to all of them, without ratio it happens every time. Kinds:

{kinds}
"""


def _deviation_text() -> str:
    """Return the description of `lss-play --sim`."""
    from lss_motion.sim.deviation import OWN, words_text

    return f"""\
`lss-play --sim` takes servos that differ from what is assumed:

  lss-play show.yaml --virtual --sim lag=+30ms,droop=3deg
  lss-play show.yaml --virtual --sim worse.yaml

The file has the same keys, as `lag: +30ms`; under `joints:` single joints may have their own
{", ".join(OWN[:-1])} and {OWN[-1]}. Keys:

{words_text()}
"""


def _sim(arguments: argparse.Namespace) -> int:
    from lss_motion.robot.load import load_robot
    from lss_motion.sim.faults import Fault, FaultKind
    from lss_motion.sim.hand import hand_of
    from lss_motion.sim.pty import serve
    from lss_motion.units import NS_PER_MS

    robot = load_robot(arguments.robot).servo_robot
    faults: tuple[Fault, ...] = ()
    if arguments.faults is not None:
        from lss_motion.sim.faults import load_faults

        faults = load_faults(arguments.faults, robot)
        if any(fault.kind is FaultKind.OVERSLEEP for fault in faults):
            raise InputError(
                f"{FaultKind.OVERSLEEP} needs `lss-play --virtual`: sim cannot delay another "
                f"program",
                path=arguments.faults,
            )
    number = serve(
        robot,
        arguments.link,
        seed=arguments.seed,
        faults=faults,
        usb_latency_ns=arguments.usb_latency_ms * NS_PER_MS,
        hand=None if arguments.hand is None else hand_of(arguments.hand, robot),
        lines=arguments.lines,
        announce=say,
    )
    return ended_by(number)


def _latency(text: str) -> int:
    if not text.isdigit() or int(text) > USB_LATENCY_MAX_MS:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a whole number from 0 to {USB_LATENCY_MAX_MS}"
        )
    return int(text)
