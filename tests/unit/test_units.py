from __future__ import annotations

import pytest

from lss_motion.units import significant


@pytest.mark.parametrize(
    ("value", "said"),
    [(54000.0, "54000"), (54321.0, "54320"), (1e9, "1000000000"), (0.12345, "0.1235"), (0.0, "0")],
)
def test_a_number_for_people_has_no_exponent(value, said):
    assert significant(value) == said
