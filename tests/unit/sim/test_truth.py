import numpy as np
import pytest

from lss_motion.sim.truth import FIRST_ROWS, Truth


def test_angles_between_rows_lie_on_the_line_and_outside_at_the_ends():
    truth = Truth(2)
    truth.append(1_000, np.array([0.0, 5.0]))
    truth.append(2_000, np.array([1.0, 5.0]))
    expected = [[0.0, 5.0], [0.25, 5.0], [1.0, 5.0]]
    assert truth.horn_deg([0, 1_250, 9_000]).tolist() == expected


def test_a_table_that_grows_keeps_its_rows():
    truth = Truth(1)
    for row in range(3 * FIRST_ROWS):
        truth.append(row, np.array([float(row)]))
    instants = [0, FIRST_ROWS, 3 * FIRST_ROWS - 1]
    assert truth.horn_deg(instants)[:, 0].tolist() == instants


def test_a_row_must_be_later_than_the_last():
    truth = Truth(1)
    truth.append(5, np.array([0.0]))
    with pytest.raises(AssertionError, match="in order of time"):
        truth.append(5, np.array([0.0]))


def test_late_instants_keep_their_nanoseconds():
    origin_ns = 10**18
    truth = Truth(1)
    truth.append(origin_ns, np.array([0.0]))
    truth.append(origin_ns + 100, np.array([100.0]))
    assert truth.horn_deg([origin_ns + 37])[0, 0] == 37.0
