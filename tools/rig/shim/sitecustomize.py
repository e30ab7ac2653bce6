"""Gives a process of the rig a monotonic clock of its own: offset, drift and one jump.

`LSS_RIG_CLOCK` is `OFFSET_NS,PPM,JUMP_AT,JUMP_NS`; `JUMP_AT` is an instant of the computer's clock.
"""

import os
import time

if text := os.environ.get("LSS_RIG_CLOCK"):
    _offset_ns, _ppm, _jump_at_ns, _jump_ns = (float(part) for part in text.split(","))
    _real_ns = time.monotonic_ns

    def _monotonic_ns() -> int:
        real_ns = _real_ns()
        jumped_ns = _jump_ns if _jump_at_ns and real_ns >= _jump_at_ns else 0.0
        return real_ns + int(_offset_ns + jumped_ns) + int(real_ns % 10**14 * _ppm * 1e-6)

    time.monotonic_ns = _monotonic_ns
