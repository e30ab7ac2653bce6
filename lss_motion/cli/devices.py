"""The command `devices`: the sound devices of this computer."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command, add_json, print_json
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

DESCRIPTION = """\
List the sound devices of this computer that can play, each with its driver and the latency that
this driver states. The default device is marked.

Sounds on time need: pip install 'lss-motion[sound]'; on Linux also: sudo apt install libportaudio2
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    add_json(add_command(commands, "devices", _devices, DESCRIPTION))


def _devices(arguments: argparse.Namespace) -> int:
    from lss_motion.sound.device import NoDeviceError, devices

    try:
        found = devices()
    except NoDeviceError as error:
        raise InputError(str(error)) from error
    if arguments.json:
        print_json({"devices": [dataclasses.asdict(device) for device in found]})
        return EXIT_FINISHED
    width = max((len(device.name) for device in found), default=0)
    for device in found:
        mark = "*" if device.is_default else " "
        print(
            f"{mark} {device.name:{width}}  {device.channels:2} channels  {device.rate_hz:6} Hz  "
            f"{1000.0 * device.latency_s:5.1f} ms  {device.driver}"
        )
    if not found:
        print("this computer has no sound device; connect one, or start its sound server")
    return EXIT_FINISHED
