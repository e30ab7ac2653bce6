"""What `trajectory.parameterize` requires of toppra's solver wrapper, which is private to toppra.

A release of toppra that changes it fails here, with the call that it changed, before a plan does.
"""

from __future__ import annotations

import importlib.metadata
import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from lss_motion.planning.trajectory.solver import Cells, _stage_solver, fastest_squares

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
CHANGED = (
    f"toppra {importlib.metadata.version('toppra')} changed the private solver wrapper that "
    f"lss_motion.planning.trajectory.solver uses; adapt `_stage_solver` or narrow toppra in "
    f"pyproject.toml"
)
STEP_S = 0.1
ACCEL_LIMIT = 5.0
CAP = 4.0
"""Largest squared rate at every grid point."""
CELLS = 8
GROW = np.array([0.0, -1.0])
"""The objective that asks for the largest squared rate."""
RISE = np.array([-1.0, 0.0])


@pytest.fixture
def solve():
    """Return the solver of one joint on a straight path: |slope| ≤ ACCEL_LIMIT, square ≤ CAP."""
    grid_s = STEP_S * np.arange(CELLS + 1)
    rows = np.full((CELLS, 1), 1.0 / ACCEL_LIMIT)
    try:
        return _stage_solver(grid_s, rows, np.zeros((CELLS, 1)), np.full(CELLS + 1, CAP))
    except (ImportError, AttributeError, TypeError) as error:
        pytest.fail(f"{CHANGED}: {error}")


def test_a_stage_takes_seven_arguments_and_returns_slope_and_square(solve):
    """Objective, bounds of the square here and of the one that follows, in this order."""
    found = solve(0, None, GROW, math.nan, math.nan, 0.0, 1.0)
    assert len(found) == 2, CHANGED
    slope, square = found
    assert slope == pytest.approx(-ACCEL_LIMIT, abs=1e-6), CHANGED
    assert square == pytest.approx(1.0 + 2.0 * STEP_S * ACCEL_LIMIT, abs=1e-6), CHANGED


def test_a_fixed_square_leaves_the_slope(solve):
    slope, square = solve(3, None, RISE, 1.0, 1.0, 0.0, CAP)
    assert square == pytest.approx(1.0, abs=1e-6), CHANGED
    assert slope == pytest.approx(ACCEL_LIMIT, abs=1e-6), CHANGED
    slope, _ = solve(3, None, RISE, 1.0, 1.0, 0.0, 1.2)
    assert slope == pytest.approx((1.2 - 1.0) / (2.0 * STEP_S), abs=1e-6), CHANGED


def test_a_stage_without_an_answer_returns_nan(solve):
    """A square of 4 cannot come down to 0 in one stage; no exception, no clipped value."""
    assert all(math.isnan(value) for value in solve(0, None, RISE, CAP, CAP, 0.0, 0.0)), CHANGED


def test_all_rows_of_a_stage_hold_and_the_cap_holds(solve):
    _, square = solve(0, None, GROW, math.nan, math.nan, 0.0, 10.0 * CAP)
    assert square == pytest.approx(CAP, abs=1e-6), CHANGED


def test_the_fastest_way_from_rest_to_rest_is_the_closed_form():
    """Through the solver and all that is around it: up at the limit, along the cap, down."""
    count = 100
    grid_s = np.linspace(0.0, 1.0, count + 1)
    row, zero = np.full((count, 1), 1.0 / ACCEL_LIMIT), np.zeros((count, 1))

    def cells_of(first: int, end: int) -> Cells:
        part = slice(first, end)
        return Cells(row[part], row[part], zero[part], zero[part])

    squares = fastest_squares(
        grid_s, cells_of, np.full(count + 1, CAP), joints=1, start_max=0.0, end_max=0.0
    )
    up, down = 2.0 * ACCEL_LIMIT * grid_s, 2.0 * ACCEL_LIMIT * (1.0 - grid_s)
    np.testing.assert_allclose(squares, np.minimum(np.minimum(up, down), CAP), atol=2e-5)


def test_the_releases_that_are_allowed_are_those_of_one_minor_version():
    """A new minor version of toppra is tried here first: the wrapper is not part of its API."""
    dependencies = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["dependencies"]
    assert "toppra>=0.6.3,<0.7" in dependencies


@pytest.mark.slow
def test_no_warning_is_printed_where_nothing_is_compiled_yet(tmp_path):
    """Without bytecode Python compiles toppra, and warns of escapes in its docstrings."""
    plan = "import lss_motion as lss; robot = lss.load_robot('robots/desk_arm.yaml'); "
    plan += "print(lss.plan(lss.load_sequence('fastest.yaml'), robot).duration_s > 0)"
    done = subprocess.run(
        [sys.executable, "-X", f"pycache_prefix={tmp_path}", "-W", "default", "-c", plan],
        cwd=PYPROJECT.parent / "sequences",
        env={**os.environ, "LSS_MOTION_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert (done.stdout, done.stderr) == ("True\n", "")
