"""The command `doctor`: check whether this computer can play, and print what to do."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command, add_json, print_json
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands


DESCRIPTION = """\
Check this computer: Python, packages, permissions of the ports, USB latency, programs that occupy
ports, clock and timer. Each finding has its remedy. It takes a second, opens no port and changes
nothing.

Exit codes: 0 ready to play (hints may remain); 2 a package is missing or too old; 4 a port may not
be opened.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    add_json(
        add_command(
            commands, "doctor", _doctor, "check this computer; print what to do", DESCRIPTION
        )
    )


def _doctor(arguments: argparse.Namespace) -> int:
    from lss_motion.runtime.computer import Level, examine

    findings = examine()
    width = max(len(finding.subject) for finding in findings)
    if arguments.json:
        print_json({"findings": [dataclasses.asdict(finding) for finding in findings]})
    for finding in [] if arguments.json else findings:
        print(f"{finding.level:4}  {finding.subject:{width}}  {finding.said}")
        if finding.fix:
            print(f"{'':6}{'':{width}}  → {finding.fix}")
    bad = {finding.subject for finding in findings if finding.level is Level.BAD}
    if not bad:
        return EXIT_FINISHED
    return EXIT_INPUT if "packages" in bad else EXIT_UNREACHABLE
