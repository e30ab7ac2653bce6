#!/usr/bin/env python3
"""Write `lss_motion/REFERENCE.md` and `lss_motion/schema`: keys of the files, options of commands.

    tools/run tools/make_reference.py

They are made from the classes by which files are read and from the parsers of the command line; a
test says when they are no longer what this makes.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lss_motion.cli import main, play
from lss_motion.cli.commands import COMMANDS
from lss_motion.robot.learnt import learnt_schema
from lss_motion.robot.load import robot_schema
from lss_motion.show.gait.load import gait_schema
from lss_motion.show.load import sequence_schema
from lss_motion.stage.load import stage_schema

if TYPE_CHECKING:
    from collections.abc import Iterator

PATH = Path(__file__).resolve().parent.parent / "lss_motion" / "REFERENCE.md"

SCHEMAS = {
    "robot": robot_schema,
    "sequence": sequence_schema,
    "gait": gait_schema,
    "learnt": learnt_schema,
    "stage": stage_schema,
}
"""By kind of file."""

HEAD = """\
# Reference

Every key of the files and every option of the commands. Made from the code by
`tools/run tools/make_reference.py`; the guides are in
[sequences/README.md](../sequences/README.md). `lss-motion reference` prints what the servos
themselves understand; what a faults file and `--sim` hold stands under [sim](#lss-motion-sim).
"""

PLAIN = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true, false"}


def schemas() -> dict[Path, str]:
    """Return the text of each file of a schema."""
    return {
        PATH.parent / "schema" / f"{kind}.schema.json": json.dumps(
            schema_of(), indent=2, ensure_ascii=False
        )
        + "\n"
        for kind, schema_of in SCHEMAS.items()
    }


def reference() -> str:
    """Return the whole page."""
    parts = [HEAD]
    told: dict[str, str] = {}
    for kind, schema_of in SCHEMAS.items():
        parts.append(f"## The {kind} file\n")
        parts += file_sections(kind, schema_of(), told)
    parts.append("## The commands\n")
    for parser in parsers():
        parts += command_section(parser)
    return "\n".join(parts)


# -- files ---------------------------------------------------------------------------------------


def file_sections(kind: str, schema: dict[str, Any], told: dict[str, str]) -> Iterator[str]:
    """Yield a table of the file's own keys and one of each kind of entry in it.

    `told` has the tables of earlier files: what is the same there is told once.
    """
    yield table_of(schema, schema)
    for entry in schema["$defs"].values():
        title, text = entry["title"], " ".join(entry.get("description", "").split())
        yield f"### {kind}: {title}\n"
        yield f"{text}\n"
        larger = larger_entry(entry, schema)
        if larger is not None:
            without = sorted(set(larger["properties"]) - set(entry["properties"]))
            yield f"The keys of {larger['title']}, without {', '.join(map(code, without))}.\n"
            continue
        table = table_of(entry, schema)
        if table in told:
            yield f"As in {told[table]}.\n"
            continue
        told[table] = f"{kind}: {title}"
        yield table


def larger_entry(entry: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any] | None:
    """Return the entry that has all keys of this one and more, if there is one."""
    for other in schema["$defs"].values():
        if entry["properties"].items() < other["properties"].items():
            return dict(other)
    return None


def table_of(entry: dict[str, Any], schema: dict[str, Any]) -> str:
    """Return the keys of an entry as a table."""
    needed = entry.get("required", [])
    rows = [
        (
            code(key) + (" (needed)" if key in needed else ""),
            value_text(value, schema),
            default_text(value),
            value.get("description", ""),
        )
        for key, value in entry["properties"].items()
    ]
    return table(("key", "value", "default", "meaning"), rows)


def value_text(value: dict[str, Any], schema: dict[str, Any]) -> str:
    """Return in words what stands under a key."""
    if "$ref" in value:
        return str(schema["$defs"][value["$ref"].rpartition("/")[2]]["title"])
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(value_text(each, schema) for each in value["anyOf"]))
    if "const" in value:
        return code(value["const"])
    if "enum" in value:
        return ", ".join(code(each) for each in value["enum"])
    if value["type"] == "array":
        return list_text(value, schema)
    if value["type"] == "object":
        return f"name: {value_text(value['additionalProperties'], schema)}, …"
    return PLAIN[value["type"]] + bounds_text(value)


def list_text(value: dict[str, Any], schema: dict[str, Any]) -> str:
    """Return what a list holds; a short one of fixed length is written out."""
    item = value_text(value["items"], schema)
    if value.get("minItems") == value.get("maxItems") and "minItems" in value:
        return f"[{value['minItems']} of: {item}]"
    return f"list of: {item}"


def bounds_text(value: dict[str, Any]) -> str:
    """Return the bounds of a number."""
    words = {
        "minimum": "from {:.10g}",
        "exclusiveMinimum": "above {:.10g}",
        "maximum": "to {:.10g}",
    }
    said = [text.format(value[key]) for key, text in words.items() if key in value]
    return f" {' '.join(said)}" if said else ""


def default_text(value: dict[str, Any]) -> str:
    """Return the default of a key; what is empty or off needs no word."""
    default = value.get("default")
    if default is None or default in ({}, []):
        return ""
    if isinstance(default, bool):
        return code(str(default).lower())
    return code(f"{default:g}" if isinstance(default, float) else str(default))


# -- commands ------------------------------------------------------------------------------------


def parsers() -> list[argparse.ArgumentParser]:
    """Return `lss-play` and each command of `lss-motion`."""
    motion = main.make_parser()
    chosen = next(
        action
        for action in motion._actions  # noqa: SLF001  argparse has no public list
        if isinstance(action, argparse._SubParsersAction)  # noqa: SLF001
    )
    return [play.make_parser(), *(chosen.choices[name] for name in COMMANDS)]


def command_section(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the description of a command, and its arguments as a table."""
    actions = [
        action
        for action in parser._actions  # noqa: SLF001
        if not isinstance(action, argparse._HelpAction)  # noqa: SLF001
    ]
    yield f"### {parser.prog}\n"
    yield description_text(parser.description or "")
    rows = [(words_of(action), action.help or "") for action in actions]
    if rows:
        yield table(("argument", "meaning"), rows)
    if parser.epilog:
        yield description_text(parser.epilog)


def description_text(text: str) -> str:
    """Return the description; lines that are set in are commands to be typed."""
    parts = []
    for block in re.split(r"\n{2,}", text.strip("\n")):
        is_code = all(line.startswith("  ") for line in block.split("\n"))
        parts.append(f"```\n{block}\n```" if is_code else block)
    return "\n\n".join(parts) + "\n"


def words_of(action: argparse.Action) -> str:
    """Return an argument as it is typed; in brackets what may be left out."""
    value = action.metavar or (
        "|".join(map(str, action.choices)) if action.choices else action.dest.upper()
    )
    shown = " ".join(value) if isinstance(value, tuple) else value
    if action.nargs == "+":
        shown = f"{shown} ..."
    if not action.option_strings:
        return code(f"[{shown}]" if action.nargs in ("?", "*") else shown)
    words = code(", ".join(action.option_strings) + ("" if action.nargs == 0 else f" {shown}"))
    return f"{words} (needed)" if action.required else words


# -- Markdown ------------------------------------------------------------------------------------


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table and an empty line."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(f"| {' | '.join(map(cell, line))} |" for line in lines) + "\n"


def cell(text: str) -> str:
    """Return text on one line that keeps its characters in a table."""
    joined = " ".join(text.split())
    return joined.replace("|", "\\|").replace("*", "\\*").replace("<", "\\<")


def code(text: object) -> str:
    return f"`{text}`"


if __name__ == "__main__":
    for path, text in {PATH: reference(), **schemas()}.items():
        path.write_text(text, encoding="utf-8")
        print(f"{path.name}: written")
