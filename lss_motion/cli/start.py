"""Entry points of `lss-play` and `lss-motion`: signals are handled before the program is imported.

Importing the program takes a fifth of a second, in which a person may press Ctrl-C. Before the
first line of this module runs, Python starts itself and imports 14 ms of ours and of its library
(`python -X importtime`); a Ctrl-C then ends in Python's own words, and nothing has been opened.
"""

from __future__ import annotations

import sys

from lss_motion.system.signals import as_program


def play() -> int:
    """Run `lss-play`; return its exit code."""
    return as_program("lss-play", _play)


def main() -> int:
    """Run `lss-motion`; return its exit code."""
    return as_program("lss-motion", _main)


def _play() -> int:
    from lss_motion.cli.play import main as play

    return play()


def _main() -> int:
    from lss_motion.cli.main import main

    return main()


if __name__ == "__main__":
    sys.exit(main())
