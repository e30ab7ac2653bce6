import numpy as np
import pytest

from lss_motion.sim.horns import FIRST_ROWS, HornHistory


def test_angles_between_rows_lie_on_the_line_and_outside_at_the_ends():
    history = HornHistory(2)
    history.append(1_000, np.array([0.0, 5.0]))
    history.append(2_000, np.array([1.0, 5.0]))
    expected = [[0.0, 5.0], [0.25, 5.0], [1.0, 5.0]]
    assert history.horn_deg([0, 1_250, 9_000]).tolist() == expected


def test_a_table_that_grows_keeps_its_rows():
    history = HornHistory(1)
    for row in range(3 * FIRST_ROWS):
        history.append(row, np.array([float(row)]))
    instants = [0, FIRST_ROWS, 3 * FIRST_ROWS - 1]
    assert history.horn_deg(instants)[:, 0].tolist() == instants


def test_a_row_must_be_later_than_the_last():
    history = HornHistory(1)
    history.append(5, np.array([0.0]))
    with pytest.raises(AssertionError, match="in order of time"):
        history.append(5, np.array([0.0]))


def test_late_instants_keep_their_nanoseconds():
    origin_ns = 10**18
    history = HornHistory(1)
    history.append(origin_ns, np.array([0.0]))
    history.append(origin_ns + 100, np.array([100.0]))
    assert history.horn_deg([origin_ns + 37])[0, 0] == 37.0
