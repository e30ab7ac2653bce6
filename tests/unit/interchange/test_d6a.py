"""Action groups as the sqlite3 program writes them: positions, times, and errors."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from lss_motion.interchange.d6a import D6A
from lss_motion.interchange.reader import Measure

if TYPE_CHECKING:
    from pathlib import Path

COLUMNS = "[Index] INT, Time INT, Servo1 INT, Servo2 INT"
ROWS = ((2, 250, 0, 1000), (1, 1000, 500, 480))


def group(columns: str = COLUMNS, rows=ROWS, table: str = "ActionGroup") -> bytes:
    with closing(sqlite3.connect(":memory:")) as base:
        base.execute(f"CREATE TABLE {table}({columns})")
        marks = ", ".join("?" * len(columns.split(",")))
        base.executemany(f"INSERT INTO {table} VALUES ({marks})", rows)
        base.commit()
        return base.serialize()


def test_rows_follow_each_other_by_their_index(read_one) -> None:
    one, two = read_one(D6A, group()).channels
    assert (one.name, two.name, one.unit) == ("ID1", "ID2", Measure.DEG)
    assert one.times_s.tolist() == [1.0, 1.25]
    assert one.values.tolist() == [0.0, -120.0]
    assert two.values.tolist() == pytest.approx([-4.8, 120.0])


def test_pulses_of_rc_servos_stay_pulses(read_one) -> None:
    motion = read_one(D6A, group(rows=[(1, 500, 1500, 500), (2, 500, 2500, 1000)]))
    assert motion.channels[0].unit is Measure.US
    assert motion.channels[0].values.tolist() == [1500.0, 2500.0]


@pytest.mark.skipif(shutil.which("sqlite3") is None, reason="the program sqlite3 is not here")
@pytest.mark.parametrize("journal", ["DELETE", "WAL"])
def test_a_file_of_the_sqlite3_program_is_read(tmp_path: Path, read_one, journal: str) -> None:
    path = tmp_path / "wave.d6a"
    script = (
        f"PRAGMA journal_mode={journal}; CREATE TABLE ActionGroup([Index] INTEGER PRIMARY KEY "
        "AUTOINCREMENT NOT NULL UNIQUE DEFAULT 1, Time INT, Servo1 INT, Servo2 INT);"
        "INSERT INTO ActionGroup(Time, Servo1, Servo2) VALUES(800, 500, 750);"
        "INSERT INTO ActionGroup(Time, Servo1, Servo2) VALUES(400, 250, 750);"
    )
    subprocess.run(["sqlite3", str(path), script], check=True, capture_output=True)
    motion = read_one(D6A, path.read_bytes())
    assert motion.channels[0].times_s.tolist() == pytest.approx([0.8, 1.2])
    assert motion.channels[0].values.tolist() == [0.0, -60.0]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (group(table="Other"), "has no table ActionGroup"),
        (group(columns="[Index] INT, Time INT, Angle INT, B INT"), "needs the columns"),
        (group(rows=[]), "has no row"),
        (group(rows=[(1, 500, None, 2)]), "row 1: None is not a whole number from 0 to 2600"),
        (group(rows=[(1, 500, 0, 0), (2, 0, 0, 0)]), "row 2: times must increase"),
        (group(rows=[(1, 70000, 0, 0)]), "70000 is not a whole number from 0 to 65535"),
        (group(rows=[(1, 500, 2000, 100)]), "others are below 400 us"),
        (group()[:700], "has 700 of its 8192 bytes: it was cut off"),
        (group()[:90], "cannot be read as SQLite"),
        (b"PK", "is not an SQLite file"),
    ],
)
def test_what_is_no_action_group_is_refused(refusal, data: bytes, reason: str) -> None:
    assert reason in refusal(D6A, data).reason


def test_a_view_is_not_run(refusal) -> None:
    """A view could compute without end."""
    with closing(sqlite3.connect(":memory:")) as base:
        base.execute(
            "CREATE VIEW ActionGroup AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 "
            "FROM n) SELECT i AS 'Index', 500 AS Time, 1 AS Servo1 FROM n"
        )
        data = base.serialize()
    assert "has no table ActionGroup" in refusal(D6A, data).reason
