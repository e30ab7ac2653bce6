"""`lss-motion doctor`: is this computer fit to play, and what to do where it is not."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command, add_json, print_json
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands


DESCRIPTION = """\
Check this computer: Python, packages, permissions for the ports, USB latency, programs that grab
ports, clock and timer, each with what to do. Takes a second, opens no port, changes nothing.

Exit code 0: fit to play (hints may be left) · 2: a package · 4: a port may not be opened.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    add_json(add_command(commands, "doctor", _doctor, "check this computer", DESCRIPTION))


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
