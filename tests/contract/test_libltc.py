"""Linear timecode against libltc (Debian: libltc11), an independent program: both ways."""

from __future__ import annotations

import ctypes
import ctypes.util
import os

import numpy as np
import pytest

from lss_motion.sync.ltc import LtcDecoder, sound_of
from lss_motion.sync.timecode import FPS_24, FPS_25, FPS_29_97_DROP, FPS_30, Timecode, timecode_of

STANDARDS = {FPS_24: 3, FPS_25: 1, FPS_29_97_DROP: 0, FPS_30: 0}


class Label(ctypes.Structure):
    _fields_ = [("zone", ctypes.c_char * 6)] + [
        (name, ctypes.c_ubyte)
        for name in ("years", "months", "days", "hours", "mins", "secs", "frame")
    ]


class FrameExt(ctypes.Structure):
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


def library():
    try:
        found = ctypes.CDLL("libltc.so.11")
    except OSError:
        if os.environ.get("CI") == "true" and os.environ.get("LSS_HAS_LIBLTC") == "1":
            raise
        pytest.skip("libltc: sudo apt install libltc11")
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


def made_by_libltc(lib, labels, rate, rate_hz):
    """Sound of these labels, -1 to 1."""
    encoder = lib.ltc_encoder_create(rate_hz, rate.frames_per_s, STANDARDS[rate], 0)
    sound = []
    for label in labels:
        value = Label(b"+0000", 0, 0, 0, *label)
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


def read_by_libltc(lib, sound, rate, rate_hz):
    decoder = lib.ltc_decoder_create(round(rate_hz / rate.frames_per_s), 400)
    samples = np.ascontiguousarray(sound, dtype=np.float32)
    lib.ltc_decoder_write_float(decoder, samples.ctypes.data, len(samples), 0)
    found, frame, value = [], FrameExt(), Label()
    lib.ltc_frame_to_time.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int]
    while lib.ltc_decoder_read(decoder, ctypes.byref(frame)):
        lib.ltc_frame_to_time(ctypes.byref(value), ctypes.byref(frame), 0)
        label = Timecode(value.hours, value.mins, value.secs, value.frame)
        found.append((label, bool(frame.ltc[1] & 4), bool(frame.reverse), frame.end))
    lib.ltc_decoder_free(decoder)
    return found


def noisy(sound, seed):
    """The sound as it may come: of some level, polarity and offset, and with noise."""
    luck = np.random.default_rng(seed)
    level = luck.choice([-1, 1]) * luck.uniform(0.2, 0.9)
    noise = luck.normal(0.0, 0.05, len(sound))
    return (level * sound + noise + luck.uniform(-0.05, 0.05)).astype(np.float32)


def decoded(sound, rate_hz, block=512):
    decoder = LtcDecoder(rate_hz)
    sound = np.concatenate([sound, np.zeros(rate_hz // 50)])
    return [
        frame
        for start in range(0, len(sound), block)
        for frame in decoder.take(sound[start : start + block])
    ]


@pytest.mark.parametrize("rate_hz", [44100, 48000])
@pytest.mark.parametrize("rate", STANDARDS, ids=lambda rate: rate.name)
def test_what_libltc_makes_is_read_with_noise_at_its_place(rate, rate_hz):
    lib = library()
    first = Timecode(0, 8, 59, 10).frame(rate)
    labels = [timecode_of(first + number, rate) for number in range(60)]
    sound = noisy(made_by_libltc(lib, labels, rate, rate_hz), seed=rate_hz + rate.labels)
    frames = decoded(sound, rate_hz)
    read = {frame.timecode: frame for frame in frames}
    assert len(frames) == len(read)
    assert set(read) <= set(labels)
    missing = [number for number, label in enumerate(labels) if label not in read]
    assert all(number == 0 or number > 57 for number in missing), missing
    assert {frame.is_drop for frame in frames} == {rate.is_drop}
    samples = rate_hz / rate.frames_per_s
    off = [read[label].at - (n + 1) * samples for n, label in enumerate(labels) if label in read]
    assert np.abs(off).max() < 0.0001 * rate_hz, "within 0.1 ms"
    measured = np.median([frame.frame_samples for frame in frames[2:]])
    assert rate_hz / measured == pytest.approx(rate.frames_per_s, rel=1e-3)


@pytest.mark.parametrize("rate", STANDARDS, ids=lambda rate: rate.name)
def test_libltc_reads_what_is_made_here_forward_and_backward(rate):
    lib, rate_hz = library(), 48000
    start = timecode_of(Timecode(9, 59, 59, 10).frame(rate), rate)
    sound = 0.5 * sound_of(start, rate, 50, rate_hz)
    labels = [timecode_of(start.frame(rate) + number, rate) for number in range(50)]
    for is_reverse, made in ((False, sound), (True, sound[::-1])):
        read = read_by_libltc(lib, made, rate, rate_hz)
        assert {label for label, *_ in read} <= set(labels)
        assert len(read) >= 47
        assert {is_drop for _, is_drop, _, _ in read} == {rate.is_drop}
        assert {way for _, _, way, _ in read} == {is_reverse}
        own = decoded(noisy(made, seed=4), rate_hz)
        assert len(own) >= 48
        assert {frame.timecode for frame in own} <= set(labels)
        assert {frame.is_reverse for frame in own} == {is_reverse}
