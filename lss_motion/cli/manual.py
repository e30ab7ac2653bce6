"""The commands `reference` and `completion`: pages of servo commands, and a script for shells.

The pages come from the tables that the encoder, the parser and the simulator use.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.errors import EXIT_FINISHED

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.protocol.table import FamilyTable, Row


SOURCES: Final = """\
Sources: `LSS 8` is command 8 of the LSS communication protocol 106.1 of 2019-02-22, `PRO` names
a section of the LSS-PRO one of 2023-12-14, `2IO 3` a command of the 2RC mode of 2020-02-07.
`FACTS M5` is a row of lss_motion/FACTS.md. Since: the first firmware.""".replace("\n", " ")

FAMILIES: Final = ("LSS", "LSS-PRO", "LSS-2IO")

DESCRIPTION: Final = """\
Print the commands of the servos as a Markdown page: keyword, meaning, unit, range, default, source
and notes. The encoder, the parser and the simulator use the same tables.

  lss-motion reference LSS > lss.md
"""

HEAD: Final = (
    "Action",
    "Query",
    "Config",
    "Meaning",
    "Unit",
    "On the wire",
    "Allowed",
    "Default",
    "Since",
    "Source",
    "Note",
)


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_completion(commands)
    reference = add_command(commands, "reference", _reference, DESCRIPTION)
    reference.add_argument(
        "family", nargs="?", choices=FAMILIES, help="only this family (default: all three)"
    )


def _reference(arguments: argparse.Namespace) -> int:
    from lss_motion.protocol.codec import FAMILY_TABLES
    from lss_motion.protocol.constants import Family

    names = FAMILIES if arguments.family is None else (arguments.family,)
    say("\n\n".join(page(FAMILY_TABLES[Family(name)]) for name in names))
    return EXIT_FINISHED


def page(table: FamilyTable) -> str:
    """Return the reference page of a family: its commands, then its modifiers."""
    commands = [row for row in table.rows if not row.is_modifier]
    modifiers = [row for row in table.rows if row.is_modifier]
    parts = [
        f"# {table.family}",
        "Values are in the unit given; `value x scale` is the number on the wire. A number after"
        " a query selects: "
        + "; ".join(f"`{number}` {meaning}" for number, meaning in _suffixes(commands))
        + ". "
        + SOURCES,
        _table([_cells(row, table) for row in commands]),
    ]
    if modifiers:
        parts += ["## Modifiers", _table([_cells(row, table) for row in modifiers])]
    return "\n\n".join(parts)


def _suffixes(rows: Iterable[Row]) -> list[tuple[str, str]]:
    """Return the numbers after queries with their meanings, each once, in ascending order."""
    suffixes = {
        (number, f"{meaning} ({', '.join(_queries_with(rows, number, meaning))})")
        for row in rows
        for number, meaning in (row.suffixes or {}).items()
    }
    return [(str(number), text) for number, text in sorted(suffixes)]


def _queries_with(rows: Iterable[Row], number: int, meaning: str) -> list[str]:
    return [
        query
        for row in rows
        if (row.suffixes or {}).get(number) == meaning
        for query in row.queries
    ]


def _cells(row: Row, table: FamilyTable) -> tuple[str, ...]:
    from lss_motion.protocol.table import Value

    actions = (row.name,) if row.is_modifier else row.actions
    takes_value = row.is_modifier or bool(row.actions or row.configs)
    has_range = takes_value and row.value is not Value.NONE
    return (
        _code([*actions, *(f"{actions[0]}...{name}" for name in row.modifiers if actions)]),
        _code(row.queries),
        _code(row.configs),
        _safe(row.meaning),
        str(row.unit),
        "" if row.wire_per_unit == 1 else f"value x {float(row.wire_per_unit):g}",
        _allowed(row) if has_range else "",
        "" if row.default is None else f"{row.physical(row.default):g}",
        str(row.firmware) if row.firmware else "",
        row.source,
        _safe(_note(row, table)),
    )


def _allowed(row: Row) -> str:
    from lss_motion.protocol.table import WIRE_MAX, WIRE_MIN, Outside

    if row.choices is None and (row.minimum, row.maximum) == (WIRE_MIN, WIRE_MAX):
        return "any"
    bounded = row.allowed()
    if row.choices is None and row.maximum == WIRE_MAX:
        bounded = f"from {row.physical(row.minimum):g} {row.unit}".rstrip()
    return bounded if row.outside is Outside.IGNORED else f"{bounded}; beyond: {row.outside}"


def _note(row: Row, table: FamilyTable) -> str:
    devices = f"Of a board's {', '.join(row.devices)} only. " if row.devices else ""
    reset = "Acts after RESET. " if row.needs_reset else ""
    mirrors = ""
    if row.mirrors is not None:
        other = next(known for known in table.rows if known.name == row.mirrors and known.actions)
        mirrors = f"The same setting as {_code(other.actions)}. "
    return f"{devices}{reset}{mirrors}{row.note}".strip()


def _code(words: Sequence[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    lines = [HEAD, tuple("---" for _ in HEAD), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _safe(cell: str) -> str:
    """Return text that keeps its characters in a Markdown table."""
    return cell.replace("|", "\\|").replace("*", "\\*")


COMPLETION_TEXT: Final = """\
Print a script for your shell. With it, the Tab key completes the commands, options and files of
lss-motion and lss-play.

  eval "$(lss-motion completion bash)"      add this line to ~/.bashrc
  eval "$(lss-motion completion zsh)"       add this line to ~/.zshrc, after compinit
  lss-motion completion tcsh | source /dev/stdin
"""

SHELLS: Final = ("bash", "zsh", "tcsh")


def _add_completion(commands: Commands) -> None:
    completion = add_command(commands, "completion", _completion, COMPLETION_TEXT)
    completion.add_argument("shell", choices=SHELLS, help="the shell that you use")


def _completion(arguments: argparse.Namespace) -> int:
    import shtab

    from lss_motion.cli import main, play

    for parser in (main.make_parser(), play.make_parser()):
        _complete_files(parser)
        say(shtab.complete(parser, arguments.shell))
    return EXIT_FINISHED


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Complete every argument that is a path with files, in the parser and its commands."""
    import shtab

    for action in parser._actions:  # noqa: SLF001  (argparse has no public list of arguments)
        if action.type is Path or action.dest == "robot":
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # shtab reads it
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                _complete_files(inner)
