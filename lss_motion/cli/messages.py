"""Errors for people: one line each on standard error, an exit code, never a traceback."""

from __future__ import annotations

import io
import os
import re
import sys
from typing import TYPE_CHECKING

from lss_motion.errors import EXIT_INTERRUPTED, InputError, LssMotionError

if TYPE_CHECKING:
    from collections.abc import Callable

_PLACE = re.compile(r"\S+:\d+: ")
"""`file:line: ` at the start of a message says more than the name of the command."""


def guarded(program: str, do: Callable[[], int]) -> int:
    """Run a command; turn what it raises on purpose into messages and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # "deg/s²" on a terminal that has no "²".
            stream.reconfigure(errors="replace")
    try:
        code = do()
        sys.stdout.flush()
    except LssMotionError as error:
        sys.stdout.flush()
        is_of_file = isinstance(error, InputError) and error.path is not None
        has_place = is_of_file or _PLACE.match(str(error)) is not None
        print(error if has_place else f"{program}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # `lss-motion schema | head`: the reader has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return code
