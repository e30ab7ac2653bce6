"""Gives a process of the rig a monotonic clock of its own: offset, drift and jumps.

`LSS_RIG_CLOCK` is `OFFSET_NS,PPM,FILE`; the file has the sum of all jumps so far, in ns (int64).
"""

import os
import time

if text := os.environ.get("LSS_RIG_CLOCK"):
    import mmap
    import struct
    from pathlib import Path

    _offset_ns, _ppm, _path = text.split(",", 2)
    _offset, _drift = int(_offset_ns), float(_ppm) * 1e-6
    with Path(_path).open("rb") as _file:
        _jumps = mmap.mmap(_file.fileno(), 8, prot=mmap.PROT_READ)
    _read = struct.Struct("<q").unpack_from
    _real_ns = time.monotonic_ns

    def _monotonic_ns() -> int:
        real_ns = _real_ns()
        return real_ns + _offset + _read(_jumps)[0] + int(real_ns % 10**14 * _drift)

    time.monotonic_ns = _monotonic_ns
