"""libltc (Debian: libltc11), an independent program that makes and reads linear timecode."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from lss_motion.stage.timecode.timecode import FPS_24, FPS_25, FPS_29_97_DROP, FPS_30, Timecode

if TYPE_CHECKING:
    from lss_motion.stage.timecode.timecode import FrameRate

INSTALL = "sudo apt install libltc11"

STANDARDS = {FPS_24: 3, FPS_25: 1, FPS_29_97_DROP: 0, FPS_30: 0}


class _Label(ctypes.Structure):
    _fields_ = [("zone", ctypes.c_char * 6)] + [
        (name, ctypes.c_ubyte)
        for name in ("years", "months", "days", "hours", "mins", "secs", "frame")
    ]


class _Frame(ctypes.Structure):
    _fields_ = [
        ("ltc", ctypes.c_ubyte * 10),
        ("start", ctypes.c_longlong),
        ("end", ctypes.c_longlong),
        ("reverse", ctypes.c_int),
        ("tics", ctypes.c_float * 80),
        ("low", ctypes.c_ubyte),
        ("high", ctypes.c_ubyte),
        ("volume", ctypes.c_double),
    ]


def missing() -> str:
    """Return why libltc cannot be used; empty if it can."""
    try:
        ctypes.CDLL("libltc.so.11")
    except OSError:
        return f"no libltc: {INSTALL}"
    return ""


@lru_cache
def _library() -> Any:  # noqa: ANN401  (functions of C)
    found = ctypes.CDLL("libltc.so.11")
    found.ltc_encoder_create.restype = ctypes.c_void_p
    found.ltc_encoder_create.argtypes = [
        ctypes.c_double,
        ctypes.c_double,
        ctypes.c_int,
        ctypes.c_int,
    ]
    found.ltc_decoder_create.restype = ctypes.c_void_p
    for name in [
        "ltc_encoder_set_timecode",
        "ltc_encoder_encode_frame",
        "ltc_encoder_inc_timecode",
        "ltc_encoder_free",
        "ltc_decoder_free",
        "ltc_encoder_get_frame",
        "ltc_encoder_set_frame",
    ]:
        function = getattr(found, name)
        function.argtypes = [ctypes.c_void_p] + [ctypes.c_void_p] * (
            name.endswith(("set_timecode", "get_frame", "set_frame"))
        )
    found.ltc_encoder_get_bufferptr.argtypes = [
        ctypes.c_void_p,
        ctypes.POINTER(ctypes.POINTER(ctypes.c_ubyte)),
        ctypes.c_int,
    ]
    found.ltc_decoder_write_float.argtypes = [
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_size_t,
        ctypes.c_longlong,
    ]
    found.ltc_decoder_read.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    return found


def made_by_libltc(labels: list[Timecode], rate: FrameRate, rate_hz: int) -> np.ndarray:
    """Return the sound of these labels, -1 to 1."""
    lib = _library()
    encoder = lib.ltc_encoder_create(rate_hz, rate.frames_per_s, STANDARDS[rate], 0)
    sound = []
    for label in labels:
        value = _Label(b"+0000", 0, 0, 0, *label)
        lib.ltc_encoder_set_timecode(encoder, ctypes.byref(value))
        if rate.is_drop:
            bits = (ctypes.c_ubyte * 10)()
            lib.ltc_encoder_get_frame(encoder, bits)
            bits[1] |= 0x04
            bits[3] ^= 0x08  # The parity bit, for the bit that was set.
            lib.ltc_encoder_set_frame(encoder, bits)
        lib.ltc_encoder_encode_frame(encoder)
        buffer = ctypes.POINTER(ctypes.c_ubyte)()
        size = lib.ltc_encoder_get_bufferptr(encoder, ctypes.byref(buffer), 1)
        sound.append(np.ctypeslib.as_array(buffer, (size,)).astype(np.float64))
    lib.ltc_encoder_free(encoder)
    return (np.concatenate(sound) - 128.0) / 127.0


def read_by_libltc(
    sound: np.ndarray, rate: FrameRate, rate_hz: int
) -> list[tuple[Timecode, bool, bool, int]]:
    """Return the label, drop-frame, reverse and last sample of each frame that is read."""
    lib = _library()
    decoder = lib.ltc_decoder_create(round(rate_hz / rate.frames_per_s), 400)
    samples = np.ascontiguousarray(sound, dtype=np.float32)
    lib.ltc_decoder_write_float(decoder, samples.ctypes.data, len(samples), 0)
    found, frame, value = [], _Frame(), _Label()
    lib.ltc_frame_to_time.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int]
    while lib.ltc_decoder_read(decoder, ctypes.byref(frame)):
        lib.ltc_frame_to_time(ctypes.byref(value), ctypes.byref(frame), 0)
        label = Timecode(value.hours, value.mins, value.secs, value.frame)
        found.append((label, bool(frame.ltc[1] & 4), bool(frame.reverse), frame.end))
    lib.ltc_decoder_free(decoder)
    return found
