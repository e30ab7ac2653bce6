"""Values as a person writes them in YAML: numbers, words, mappings in one line where they fit."""

from __future__ import annotations

import math
import re
import textwrap
from typing import Final

from msgspec import Struct

from lss_motion.errors import InputError

FLOW_MAX_CHARS: Final = 96
"""A mapping or list that is longer is written in lines. Chosen: with its indent it fits a line."""

ROW_NUMBERS: Final = 12
"""More numbers than these are a table. Chosen: beats of a few bars stand in one line."""
_PLAIN: Final = re.compile(r"[^\W\d_](?:[\w./+-]| (?=[\w./+-]))*", re.UNICODE)
"""Texts that need no quotes, in a flow mapping either."""
_WORDS: Final = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})
"""Words that this package (`null`, `true`, `false`) or another reader of YAML takes for values."""
_ESCAPES: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}


class WrittenValue(Struct, frozen=True):
    """A value as it is to be written, in YAML of one line or more."""

    text: str
    value: object


def in_rows(value: object) -> object:
    """Return a value whose long lists of numbers are written in rows, as a person does."""
    match value:
        case dict():
            parts: dict[str, object] = {key: in_rows(one) for key, one in value.items()}
            if not any(isinstance(one, WrittenValue) for one in parts.values()):
                return value
            shown = ", ".join(f"{_word(key)}: {flow_text(one)}" for key, one in parts.items())
            return WrittenValue(f"{{{shown}}}", value)
        case list() if len(value) > ROW_NUMBERS and all(type(one) in (int, float) for one in value):
            listed = ", ".join(map(flow_text, value))
            rows = textwrap.wrap(listed, FLOW_MAX_CHARS, break_long_words=False)
            return WrittenValue("[\n    " + "\n    ".join(rows) + "\n  ]", value)
        case _:
            return value


def flow_text(value: object) -> str:
    """Return a value in one line; raises `InputError` for what no file holds."""
    match value:
        case WrittenValue():
            return value.text
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case float():
            return _number(value)
        case str():
            return _word(value)
        case dict():
            parts = (f"{_word(key)}: {flow_text(one)}" for key, one in value.items())
            return f"{{{', '.join(parts)}}}"
        case list() | tuple():
            return f"[{', '.join(map(flow_text, value))}]"
        case _:
            raise InputError(
                f"{value!r} is no value of a file; give a number, a text, or remove it"
            )


def entry_text(key: str, value: object, indent: str, newline: str) -> str:
    """Return a key with its value for a mapping in lines, whose keys stand behind `indent`."""
    if not _needs_lines(value):
        shown = flow_text(value).replace("\n", newline)  # Of rows of numbers.
        return f"{_word(key)}: {shown}"
    inner = f"{indent}  "
    lines = _lines(value, inner, newline)
    return f"{_word(key)}:{newline}{inner}{lines}"


def item_text(value: object, indent: str, newline: str, *, in_lines: bool) -> str:
    """Return an item behind its dash, for a list in lines whose dashes stand behind `indent`."""
    inner = f"{indent}  "
    if value and isinstance(value, dict) and (in_lines or _needs_lines(value)):
        return f"- {_lines(value, inner, newline)}"
    return f"- {flow_text(value)}"


def _lines(value: object, indent: str, newline: str) -> str:
    """Return a mapping or list in lines, without the indent of its first."""
    if isinstance(value, dict):
        parts = [entry_text(key, one, indent, newline) for key, one in value.items()]
    else:
        assert isinstance(value, list)
        parts = [item_text(one, indent, newline, in_lines=False) for one in value]
    return f"{newline}{indent}".join(parts)


def _needs_lines(value: object) -> bool:
    """Return whether a value is written in lines: it holds mappings of mappings, or is long."""
    if not isinstance(value, dict | list) or not value:
        return False
    inside = list(value.values()) if isinstance(value, dict) else value
    if isinstance(value, list):
        return any(isinstance(one, dict | list) for one in inside)
    is_deep = any(isinstance(one, list) and _needs_lines(one) for one in inside) or any(
        isinstance(one, dict) and any(isinstance(more, dict | list) for more in one.values())
        for one in inside
    )
    return is_deep or len(flow_text(value)) > FLOW_MAX_CHARS


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise InputError(f"{value} is no number of a file")
    short = f"{value:.10g}"
    return short if float(short) == value else repr(value)


def _word(text: str) -> str:
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    return '"' + "".join(_escaped(char) for char in text) + '"'


def _escaped(char: str) -> str:
    if char in _ESCAPES:
        return _ESCAPES[char]
    if char.isprintable():
        return char
    code = ord(char)
    if 0xD800 <= code <= 0xDFFF:
        raise InputError("half of a character is no text of a file")
    return (
        f"\\U{code:08x}" if code > 0xFFFF else f"\\u{code:04x}" if code > 0xFF else f"\\x{code:02x}"
    )
