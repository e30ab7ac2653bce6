"""Arrays of NumPy with names, as `np.savez` and `np.save` write them, and errors."""

from __future__ import annotations

import io

import numpy as np
import pytest

from lss_motion.interchange.numpy_files import NUMPY
from lss_motion.interchange.reader import Measure

T = np.arange(20) / 50


def npz(**arrays) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def npy(array) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def test_an_array_for_each_column(read_one) -> None:
    data = npz(time_ms=1000 * T, elbow_rad=T + 1, wrist_deg=np.arange(20), wrist_vel=T)
    motion = read_one(NUMPY, data)
    elbow, wrist = motion.channels
    assert (elbow.name, elbow.unit, wrist.name, wrist.unit) == (
        "elbow", Measure.RAD, "wrist", Measure.DEG,
    )  # fmt: skip
    assert elbow.times_s.tolist() == pytest.approx(T.tolist())
    assert wrist.values.tolist() == list(range(20))
    assert motion.is_recording
    assert "Not carried over: array wrist_vel" in motion.comments


@pytest.mark.parametrize("rate", [{"fps": 50}, {"dt": 0.02}, {"time_ns": (T * 1e9).astype(int)}])
def test_rows_of_joints_with_names_or_numbers(read_one, rate) -> None:
    rows = np.stack([T, T + 1], axis=1)
    named = read_one(NUMPY, npz(q_rad=rows, names=np.array(["a", "b"]), **rate))
    numbered = read_one(NUMPY, npz(q_rad=rows, **rate))
    assert [channel.name for channel in named.channels] == ["a", "b"]
    assert [channel.name for channel in numbered.channels] == ["J1", "J2"]
    for motion in (named, numbered):
        assert motion.channels[1].values.tolist() == pytest.approx((T + 1).tolist())
        assert motion.channels[1].times_s.tolist() == pytest.approx(T.tolist())


def test_fields_of_a_structured_array_and_missing_values(read_one) -> None:
    fields = [("t", "f8"), ("a_deg", "f4"), ("b_rad", "f4")]
    a, b = read_one(NUMPY, npy(np.array([(0, 1, 2), (1, np.nan, 4)], dtype=fields))).channels
    assert (a.times_s.tolist(), a.values.tolist()) == ([0.0], [1.0])
    assert (b.times_s.tolist(), b.values.tolist()) == ([0.0, 1.0], [2.0, 4.0])


HEADER = b"{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }"


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (npy(np.zeros((5, 2))), "is a plain array of 5x2 numbers, without times, joints and units"),
        (npz(time_s=T, q=T), "array 'q' has no unit: name it q_rad or _deg"),
        (npz(q_rad=T), "no array is the time"),
        (npz(time_fortnights=T, q_rad=T), "'time_fortnights' is not understood"),
        (npz(time_s=T, q_mm=T), "unit 'mm' is not read"),
        (npz(time_s=T), "no array is a joint"),
        (npz(time_s=T[::-1], q_rad=T), "times must increase, but row 2 is at"),
        (npz(time_s=T, q_rad=T[:5]), "array 'q' has not as many rows as 20 times"),
        (npz(time_s=T, q_rad=np.full(20, np.inf)), "'q_rad' has a value that is out of range"),
        (npz(time_s=T, q_rad=np.full(20, 1j)), "array 'q_rad' holds complex128, no numbers"),
        (npz(time_s=T, q_rad=T, q_deg=T), "joint 'q' has two arrays"),
        (npz(time_s=1e18 * T, q_rad=T), "its times are no seconds"),
        (npz(fps=0, q_rad=T), "'fps' must be one number"),
        (npz(time_s=np.zeros(9_000_000)), "holds 72,000,128 bytes, more than"),
        (npz(time_s=np.zeros(5_000_000, dtype="i1")), "has more than 4,000,000 values"),
        (npy(np.array([{}])), "cannot be read as NumPy arrays: Object arrays cannot be loaded"),
        (npz(time_s=T, q_rad=T)[:-40], "cannot be read as NumPy arrays"),
        (npy(T)[:90], "cannot be read as NumPy arrays"),
        (b"\x93NUMPY\x01\x00\x76\x00" + (HEADER % b"9" * 15).ljust(118), "cannot be read as NumPy"),
    ],
)  # fmt: skip
def test_what_has_no_meaning_or_is_damaged_is_refused(refusal, data: bytes, reason: str) -> None:
    assert NUMPY.recognises(data)
    assert reason in refusal(NUMPY, data).reason
