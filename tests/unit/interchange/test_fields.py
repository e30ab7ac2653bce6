"""Values from JSON."""

from __future__ import annotations

import math

from lss_motion.interchange.fields import parsed_json


def test_json_numbers_are_read_exactly(tmp_path) -> None:
    assert parsed_json(tmp_path, b'{"a": [1, -2.5e1, true, null]}') == {"a": [1, -25.0, True, None]}
    assert math.isinf(parsed_json(tmp_path, b"[1e999]")[0])  # Refused where it is used.
