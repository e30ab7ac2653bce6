"""Changes single values of a YAML text in place.

Comments, blank lines, order, quotes and styles are kept, because only the characters of the value
are replaced or one new entry is inserted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


def set_values(
    path: Path, text: str, location: Sequence[str], values: Mapping[str, float | str]
) -> str:
    """Return `text` with `values` set in the mapping at `location`; its other entries are kept.

    The parts of `location` that do not exist are made. Values are numbers or plain words. Raises
    `InputError` with the line, naming `path`, where the text cannot be changed without changing
    more: a mapping that is an alias, or that aliases repeat elsewhere.
    """
    for key, value in values.items():
        text = _set(path, text, (*location, key), _scalar(value))
    return text


def set_comment(text: str, location: Sequence[str], mark: str, lines: Sequence[str]) -> str:
    """Return `text` with comment `lines` above the entry at `location`, which exists.

    Each line begins with `mark`. Lines above the entry that begin with it are replaced. If the
    entry does not begin its line, the comment is put at the end of the text.
    """
    key, _ = _entry(_root(text), location)
    start = text.rfind("\n", 0, key.start_mark.index) + 1
    indent = text[start : key.start_mark.index]
    newline = "\r\n" if "\r\n" in text else "\n"
    if indent.strip():
        kept = [line for line in text.splitlines() if not line.startswith(f"# {mark}")]
        return newline.join([*kept, *(f"# {mark} {line}" for line in lines), ""])
    before = text[:start].splitlines(keepends=True)
    while before and before[-1].strip().startswith(f"# {mark}"):
        before.pop()
    comment = [f"{indent}# {mark} {line}{newline}" for line in lines]
    return "".join([*before, *comment]) + text[start:]


def _set(path: Path, text: str, location: Sequence[str], scalar: str) -> str:
    root = node = _root(text)
    for depth, part in enumerate(location):
        if type(node).__name__ != "MappingNode":
            raise _refused(path, node, location, "is no mapping")
        entry = next((pair for pair in node.value if pair[0].value == part), None)
        if entry is None:
            rest = location[depth + 1 :]
            entered = scalar
            for inner in reversed(rest):
                entered = f"{{{inner}: {entered}}}"
            return _inserted(text, node, f"{part}: {entered}")
        key, value = entry
        if value.start_mark.index < key.end_mark.index:
            raise _refused(path, key, location, "is an alias")
        if _is_shared(root, value):
            raise _refused(path, key, location, "is repeated elsewhere by an alias")
        node = value
    return text[: node.start_mark.index] + scalar + text[node.end_mark.index :]


def _scalar(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


def _inserted(text: str, mapping: Any, entry: str) -> str:  # noqa: ANN401  yaml seam
    """Return `text` with one more entry in `mapping`: behind its last one where that is simple."""
    start = mapping.start_mark.index
    last = _last_index(mapping)
    if mapping.flow_style:
        if last is not None:
            return f"{text[:last]}, {entry}{text[last:]}"
        comma = ", " if mapping.value else ""
        return f"{text[: start + 1]}{entry}{comma}{text[start + 1 :]}"
    newline = "\r\n" if "\r\n" in text else "\n"
    indent = " " * mapping.start_mark.column
    if last is None and not indent and mapping.value:  # The file itself: at its end.
        end = mapping.end_mark.index
        before = text[:end] if text[:end].endswith("\n") else text[:end] + newline
        return f"{before}{entry}{newline}{text[end:]}"
    if last is None:
        return f"{text[:start]}{entry}{newline}{indent}{text[start:]}"
    end = text.find("\n", last)
    if end < 0:
        return f"{text}{newline}{indent}{entry}{newline}"
    return f"{text[: end + 1]}{indent}{entry}{newline}{text[end + 1 :]}"


def _last_index(mapping: Any) -> int | None:  # noqa: ANN401  yaml seam
    """Return where the last value of a mapping ends; None if it does not end in its own line."""
    if not mapping.value:
        return None
    key, value = mapping.value[-1]
    if value.start_mark.index < key.end_mark.index or value.start_mark.line != value.end_mark.line:
        return None
    is_inline = type(value).__name__ == "ScalarNode" or value.flow_style
    return int(value.end_mark.index) if is_inline else None


def _root(text: str) -> Any:  # noqa: ANN401  yaml seam
    import yaml

    return yaml.compose(text, Loader=yaml.BaseLoader)


def _entry(root: Any, location: Sequence[str]) -> tuple[Any, Any]:  # noqa: ANN401  yaml seam
    key, node = None, root
    for part in location:
        key, node = next(pair for pair in node.value if pair[0].value == part)
    return key, node


def _is_shared(node: Any, wanted: Any) -> bool:  # noqa: ANN401  yaml seam
    """Return whether `wanted` stands in the tree of `node` more than once."""
    count, waiting = 0, [node]
    while waiting:
        one = waiting.pop()
        if one is wanted:
            count += 1
            continue
        match type(one).__name__:
            case "MappingNode":
                waiting += [value for _, value in one.value]
            case "SequenceNode":
                waiting += one.value
            case _:
                pass
    return count > 1


def _refused(path: Path, node: Any, location: Sequence[str], why: str) -> InputError:  # noqa: ANN401  yaml seam
    return InputError(
        f"{'.'.join(location[:-1])} {why}, which cannot be changed here alone; write it out first",
        path=path,
        line=node.start_mark.line + 1,
    )
