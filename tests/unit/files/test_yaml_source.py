"""YAML as values with lines: what is read, what is refused, and where it says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from lss_motion.errors import InputError
from lss_motion.files.source import FILE_MAX_BYTES
from lss_motion.files.yaml_source import NODES_MAX, PROBLEMS_MAX, Mistake, YamlSource, read_yaml

if TYPE_CHECKING:
    from pathlib import Path


def read(folder: Path, content: str | bytes) -> YamlSource:
    path = folder / "file.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_yaml(path)


def refusal(folder: Path, content: str | bytes) -> InputError:
    with pytest.raises(InputError) as caught:
        read(folder, content)
    return caught.value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("-3", -3),
        ("010", 10),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("-1.5E-2", -0.015),
        ("true", True),
        ("yes", "yes"),
        ("1:30", "1:30"),
        ("0x1F", "0x1F"),
        ("'3'", "3"),
        ('"true"', "true"),
        ("2024-01-01", "2024-01-01"),
        ("9" * 5000, "9" * 5000),
        (".inf", float("inf")),
    ],
)
def test_scalars_follow_the_core_schema_of_yaml_1_2(
    tmp_path: Path, text: str, value: object
) -> None:
    read_value = read(tmp_path, f"key: {text}\n").value["key"]
    assert read_value == value
    assert type(read_value) is type(value)


def test_every_place_knows_its_line_whatever_the_style(tmp_path: Path) -> None:
    source = read(
        tmp_path,
        "# comment\n"
        "joints:\n"
        "  base: {id: 1,\n"
        "    range_deg: [-10,\n"
        "      10]}\n"
        "keyframes:\n"
        "  - {at_s: 0}\n"
        "\n"
        "  -\n"
        "    at_s: 1\n",
    )
    assert source.line(("joints",)) == 2
    assert source.line(("joints", "base")) == 3
    assert source.line(("joints", "base", "range_deg")) == 4
    assert source.line(("joints", "base", "range_deg", 1)) == 5
    assert source.line(("keyframes", 0, "at_s")) == 7
    assert source.line(("keyframes", 1)) == 10
    assert source.line(("keyframes", 1, "missing", "deeper")) == 10


def test_an_alias_repeats_its_anchor_and_keeps_the_lines_of_both(tmp_path: Path) -> None:
    source = read(tmp_path, "a: &same\n  x: 1\nb: *same\n")
    assert source.value == {"a": {"x": 1}, "b": {"x": 1}}
    assert source.line(("b",)) == 3
    assert source.line(("b", "x")) == 2


def test_a_byte_order_mark_and_windows_line_ends_are_accepted(tmp_path: Path) -> None:
    source = read(tmp_path, b"\xef\xbb\xbfa: 1\r\nb: 2\r\n")
    assert source.value == {"a": 1, "b": 2}
    assert source.line(("b",)) == 2


def test_a_repeated_key_is_a_problem_that_names_both_lines(tmp_path: Path) -> None:
    source = read(tmp_path, "a: 1\nb: 2\na: 3\n")
    assert source.problems == (Mistake(("a",), "'a' is given twice, first in line 1"),)
    assert source.line(("a",)) == 3


@pytest.mark.parametrize("nothing", ["", "~", "null"])
def test_a_key_without_a_value_is_a_problem(tmp_path: Path, nothing: str) -> None:
    (problem,) = read(tmp_path, f"a: {nothing}\n").problems
    assert problem == Mistake(("a",), "'a' has no value; give one or remove it")


@pytest.mark.parametrize(
    ("content", "line", "reason"),
    [
        ("", None, "is empty"),
        ("# only a comment\n", None, "is empty"),
        ("- 1\n- 2\n", 1, "must hold keys and values"),
        ("just text\n", 1, "must hold keys and values"),
        ("a: 1\n---\nb: 2\n", 2, "second document"),
        ("a: 1\nb:\n\t- 2\n", 3, "with spaces, not with tabs"),
        ("a: 1\nb: c: d\n", 2, "not YAML"),
        ("a: [1, 2\nb: 3\n", 2, "not YAML"),
        ("a: 1\nb: !!python/object/apply:os.system [ls]\n", 2, "is not accepted"),
        ("a: 1\nb: !!int '3'\n", 2, "is not accepted"),
        ("a: &x 1\n<<: *x\n", 2, "merge keys"),
        ("? [a, b]\n: 1\n", 1, "a key must be plain text"),
        ("a: *nowhere\n", 1, "anchor"),
        ("a: &x [*x]\n", 1, "inside its own anchor"),
        ("a: 1\nb: \x07\n", 2, "not YAML"),
        (b"a: 1\nb: \xff\n", 2, "byte 0xff is not UTF-8"),
        (b"\x7fELF\x00\x00", None, "is a binary file"),
        ("a: 1\n".encode("utf-16"), None, "UTF-16"),
    ],
)
def test_what_is_no_plain_yaml_is_refused_with_its_line(
    tmp_path: Path, content: str | bytes, line: int | None, reason: str
) -> None:
    error = refusal(tmp_path, content)
    assert reason in str(error)
    assert error.line == line
    assert error.path == tmp_path / "file.yaml"


def test_a_hundred_thousand_brackets_are_refused_and_not_followed(tmp_path: Path) -> None:
    assert "deep" in refusal(tmp_path, "a: " + "[" * 100_000).reason
    assert "deep" in refusal(tmp_path, "a: " + "{a: " * 100_000).reason


@pytest.mark.parametrize("kind", ["list", "mapping"])
def test_aliases_cannot_multiply_beyond_the_bound(tmp_path: Path, kind: str) -> None:
    lines = ["a0: &a0 x"]
    for n in range(1, 10):
        ten = [f"*a{n - 1}"] * 10
        if kind == "list":
            lines.append(f"a{n}: &a{n} [{', '.join(ten)}]")
        else:
            entries = [f"k{index}: {alias}" for index, alias in enumerate(ten)]
            lines.append(f"a{n}: &a{n} {{{', '.join(entries)}}}")
    error = refusal(tmp_path, "\n".join(lines))
    assert f"more than {NODES_MAX:,}" in error.reason


def test_a_file_beyond_the_bound_is_refused_and_one_at_the_bound_is_read(tmp_path: Path) -> None:
    start = b"a: 1\n#"
    assert read(tmp_path, start.ljust(FILE_MAX_BYTES, b"x")).value == {"a": 1}
    assert "larger than 16 MB" in refusal(tmp_path, start.ljust(FILE_MAX_BYTES + 1, b"x")).reason


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.yaml: file not found"):
        read_yaml(tmp_path / "nothing.yaml")
    with pytest.raises(InputError, match="is a folder"):
        read_yaml(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_yaml(tmp_path / "a\0b")


def test_one_error_holds_all_problems_in_the_order_of_the_lines(tmp_path: Path) -> None:
    source = read(tmp_path, "a: 1\nb: 2\nc: 3\n")
    problems = [
        Mistake(("c",), "third"),
        Mistake(("a",), "first"),
        Mistake(("c",), "again"),
    ]
    error = source.error(problems)
    path = tmp_path / "file.yaml"
    assert str(error) == f"{path}:1: first\n{path}:3: third"


def test_more_problems_than_anybody_reads_are_counted(tmp_path: Path) -> None:
    source = read(tmp_path, "\n".join(f"k{n}: 1" for n in range(PROBLEMS_MAX + 7)))
    error = source.error([Mistake((key,), "wrong") for key in source.value])
    assert len(error.more) == PROBLEMS_MAX
    assert error.more[-1].reason == "and 7 more problems"
