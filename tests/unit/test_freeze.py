"""Two frozen folders: what counts as other behaviour, and what people only read."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from freezing.capture import numbers
from freezing.folders import (
    BLOCK_LINES,
    Item,
    compare_folders,
    summary,
    write_items,
    write_manifest,
)

LOG = "".join(f"{n}.000000000 main > #1D{n}T500\\r\n" for n in range(5 * BLOCK_LINES))
ITEMS = (
    Item("play.log.bytes", "data", LOG),
    Item("check", "numbers", "exit code 0\n"),
    Item("check.out", "numbers", numbers("fastest −14.1 (180) of LSS-ST1, 1,234 samples")),
    Item("check.out", "text", "fastest −14.1 (180) of LSS-ST1, 1,234 samples\n"),
    Item("wrong.err", "errors", "robot.yaml:3: id 300: must be 250 or less\n"),
)


def frozen(folder: Path, items=ITEMS, *, is_full=False, cases="all, *") -> Path:
    write_items(folder, "case", items, is_full=is_full)
    write_manifest(folder, {"cases": cases})
    return folder


def changed(kind: str, old: str, new: str) -> tuple[Item, ...]:
    made = tuple(
        Item(i.name, i.kind, i.content.replace(old, new) if i.kind == kind else i.content)
        for i in ITEMS
    )
    assert made != ITEMS
    return made


@pytest.mark.parametrize("is_full", [True, False])
def test_the_same_is_the_same_in_short_and_whole(tmp_path: Path, is_full) -> None:
    a, b = frozen(tmp_path / "a"), frozen(tmp_path / "b", is_full=is_full)
    found = compare_folders(a, b)
    assert (found.failures, found.texts, found.files_count) == ([], [], len(ITEMS))


@pytest.mark.parametrize("is_full", [True, False])
def test_a_changed_byte_far_behind_the_first_lines_fails_at_its_place(tmp_path, is_full) -> None:
    a = frozen(tmp_path / "a", is_full=is_full)
    b = frozen(tmp_path / "b", changed("data", "#1D1234T", "#1D1235T"), is_full=is_full)
    (failure,) = compare_folders(a, b).failures
    start = 2 * BLOCK_LINES + 1
    place = "line 1235" if is_full else f"within {BLOCK_LINES} lines from line {start}"
    assert failure.startswith(f"case/play.log.bytes.data: {place}")


@pytest.mark.parametrize(
    ("old", "new"), [("exit code 0", "exit code 3"), ("-14.1", "14.1"), ("180\n", "181\n")]
)
def test_a_changed_number_fails(tmp_path: Path, old, new) -> None:
    a, b = frozen(tmp_path / "a"), frozen(tmp_path / "b", changed("numbers", old, new))
    assert len(compare_folders(a, b).failures) == 1


def test_a_changed_text_is_shown_and_does_not_fail(tmp_path: Path) -> None:
    a, b = frozen(tmp_path / "a"), frozen(tmp_path / "b", changed("text", "fastest", "top"))
    found = compare_folders(a, b)
    assert found.failures == []
    assert found.texts == [
        "case/check.out.text: line 1\n    - fastest −14.1 (180) of LSS-ST1, 1,234 samples"
        "\n    + top −14.1 (180) of LSS-ST1, 1,234 samples"
    ]


def test_another_error_text_fails_unless_words_are_new_on_purpose(tmp_path: Path) -> None:
    a = frozen(tmp_path / "a")
    b = frozen(tmp_path / "b", changed("errors", "must be", "at most"))
    assert len(compare_folders(a, b).failures) == 1
    found = compare_folders(a, b, has_new_words=True)
    assert (len(found.failures), len(found.texts)) == (0, 1)


def test_what_is_only_in_one_folder_fails(tmp_path: Path) -> None:
    a, b = frozen(tmp_path / "a"), frozen(tmp_path / "b", ITEMS[1:])
    for first, second in ((a, b), (b, a)):
        (failure,) = compare_folders(first, second).failures
        assert failure == f"case/play.log.bytes.data: only in {a}"


def test_folders_of_other_cases_or_unfinished_ones_are_not_compared(tmp_path: Path) -> None:
    a, b = frozen(tmp_path / "a"), frozen(tmp_path / "b", cases="quick, *")
    with pytest.raises(ValueError, match="cases is all, \\* and quick, \\*"):
        compare_folders(a, b)
    with pytest.raises(ValueError, match="cases is all and quick"):
        compare_folders(a, b, "case")
    part = frozen(tmp_path / "part", cases="all, ca*")
    assert compare_folders(a, part, "ca*").failures == []
    (b / "manifest.json").unlink()
    with pytest.raises(ValueError, match="no complete write"):
        compare_folders(a, b)


def test_numbers_are_taken_from_texts_and_names_are_no_numbers() -> None:
    text = "LSS-2IO EM0 ID5: +3, −0.5 deg/s² 12% 1,234 (4.000 s) 1e-05"
    assert numbers(text).split() == ["3", "-0.5", "12", "1234", "4.000", "1e-05"]


def test_a_summary_tells_every_line_apart_and_stays_small() -> None:
    assert len(summary(LOG)) < len(LOG) / 10
    assert summary(LOG) != summary(LOG.replace("#1D77T", "#1D78T"))
    assert summary(summary(LOG)) == summary(LOG)


PRESSED = """
import os, select, sys, time
from freezing.capture import TIME
TIME.install()
with TIME.terminal(((0.5, "a"), (2.0, "b"), (3.0, "y\\n"))) as stdin, TIME.active():
    began = time.monotonic()
    import tty
    tty.setcbreak(stdin.fileno())
    for _ in range(3):
        if select.select([stdin], [], [], 1.0)[0]:
            print(os.read(stdin.fileno(), 9), time.monotonic() - began)
    print(stdin.isatty(), stdin.readline(), time.monotonic() - began)
"""


def test_keys_are_pressed_at_their_instants_and_no_time_passes() -> None:
    tools = str(Path(__file__).resolve().parents[2] / "tools")
    ran = subprocess.run(
        [sys.executable, "-c", PRESSED], env={**os.environ, "PYTHONPATH": tools},
        check=True, capture_output=True, text=True, timeout=30.0,
    )  # fmt: skip
    assert ran.stdout.splitlines() == ["b'a' 0.5", "b'b' 2.0", "True y", " 3.0"]
