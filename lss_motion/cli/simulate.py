"""`lss-motion sim`: a simulated robot for this and any other program."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, add_robot
from lss_motion.cli.messages import ended_by
from lss_motion.errors import InputError

if TYPE_CHECKING:
    from lss_motion.cli.commands import Commands


USB_LATENCY_MAX_MS: Final = 255
"""What the latency timer of an adapter of the FTDI kind can be set to at most."""

DESCRIPTION: Final = """\
Simulate the buses of a robot behind pseudo-terminals: any program that opens a serial port can
talk to them. Prints each port and runs until Ctrl-C.

Modelled: the line (baud rate, ten bits a byte, turnaround, colliding replies, group lines and
slots of firmware 370), every command and query of the documents, ramps and the EM0 filter, lag,
load, backlash, top speed by voltage, currents, heat, stalls and safe mode.
Not modelled: inertia of what hangs on a horn, noise on the lines without a fault or a collision,
the LED's start-up sequence, RC pulses, EEPROM wear, the acceleration sensors of LSS-PRO (they
answer 0), LSS-2IO boards with other sketches than the 2RC one. Physical figures are those of the
documents where they give any, and marked assumptions in lss_motion.sim.physics where they do not.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    sim = add_command(
        commands, "sim", _sim, "simulate a robot behind a pseudo-terminal", DESCRIPTION
    )
    sim.epilog = _faults_text()
    add_robot(sim, is_required=True)
    sim.add_argument("--link", type=Path, metavar="PATH", help="symbolic link to the port")
    sim.add_argument("--seed", type=int, default=0, metavar="N", help="of all that is chance")
    sim.add_argument("--faults", type=Path, metavar="FILE", help="what goes wrong; see below")
    sim.add_argument(
        "--hand",
        metavar="FILE|SEED",
        help="who leads limp joints from power-up on: a CSV t_s,<joint>,... or a seed",
    )
    sim.add_argument(
        "--usb-latency-ms",
        type=_latency,
        default=0,
        metavar="N",
        help="an adapter that delivers replies every N ms (16 is usual; default: none)",
    )


def _faults_text() -> str:
    """Return what a faults file may hold."""
    from lss_motion.sim.faults import MEANINGS

    width = max(len(kind) for kind in MEANINGS)
    kinds = "\n".join(f"  {kind:{width}}  {meaning}" for kind, meaning in MEANINGS.items())
    return f"""\
A faults file has rows of when, who and what; times are seconds from power-up:

  faults:
    - {{kind: lost_reply, servo: 5, at_s: 2, until_s: 4, ratio: 0.1}}
    - {{kind: reset, servo: 7, at_s: 3}}

at_s, until_s, servo, bus and ratio may be left out: from the beginning, for ever, all of them,
every time. Kinds:

{kinds}
"""


def _sim(arguments: argparse.Namespace) -> int:
    from lss_motion.robot.load import load_robot
    from lss_motion.sim.faults import Fault, FaultKind
    from lss_motion.sim.hand import hand_of
    from lss_motion.sim.pty import serve
    from lss_motion.units import NS_PER_MS

    robot = load_robot(arguments.robot)
    faults: tuple[Fault, ...] = ()
    if arguments.faults is not None:
        from lss_motion.sim.faults_file import load_faults

        faults = load_faults(arguments.faults, robot)
        if any(fault.kind is FaultKind.OVERSLEEP for fault in faults):
            raise InputError(
                f"{FaultKind.OVERSLEEP} needs `lss-play --virtual`: here the host is another "
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
        announce=lambda text: print(text, flush=True),
    )
    return ended_by(number)


def _latency(text: str) -> int:
    if not text.isdigit() or int(text) > USB_LATENCY_MAX_MS:
        raise argparse.ArgumentTypeError(f"{text!r} is not in 0 to {USB_LATENCY_MAX_MS}")
    return int(text)
