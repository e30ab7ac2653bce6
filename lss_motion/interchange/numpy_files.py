"""Arrays of NumPy: `.npz` with an array for each column, and `.npy` with named fields.

    np.savez("wave.npz", time_s=t, elbow_rad=elbow, wrist_deg=wrist)
    np.savez("wave.npz", fps=50, q_rad=samples, names=["elbow", "wrist"])

`columns` says what the names mean. An array of rows and joints takes the names of the joints from
an array of texts, or numbers them. The time is an array, or `fps`, or `dt` (in seconds). An array
without a unit in its name is refused: many programs count in radians. Objects are not loaded.
"""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from typing import TYPE_CHECKING, Any, Final, NoReturn

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import RECORDING_MAX_BYTES
from lss_motion.files.texts import counted
from lss_motion.interchange.columns import (
    is_other_measure,
    is_time_name,
    name_and_unit,
    seconds_of,
    unit_of_column,
)
from lss_motion.interchange.fields import VALUE_MAX
from lss_motion.interchange.reader import (
    FPS_MAX,
    VALUES_MAX,
    Channel,
    ForeignMotion,
    Measure,
    Reader,
    is_dense,
    motion_name,
    summarised,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.interchange.reader import FloatArray

NPY: Final = b"\x93NUMPY"
ZIP: Final = b"PK\x03\x04"
ARRAYS_MAX: Final = 10_000
"""Chosen: arrays of one file; each joint of a robot may have one."""
RATES: Final = ("fps", "rate_hz", "hz")
STEPS: Final = ("dt", "dt_s", "timestep_s")
BROKEN: Final = (
    ValueError, EOFError, OSError, MemoryError, OverflowError, KeyError, TypeError, SyntaxError,
    NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error, tokenize.TokenError,
)  # fmt: skip
"""What NumPy and its libraries raise for a file that is damaged."""
EXAMPLE: Final = "np.savez(file, time_s=times, elbow_rad=angles)"


def _is_numpy(data: bytes) -> bool:
    return data.startswith(NPY) or (data.startswith(ZIP) and b".npy" in data[:4096])


def _numpy_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    file = _NumpyFile(path)
    arrays = file.arrays(data)
    times_s, time_name = file.times_s(arrays)
    times_s, columns, left_out = file.columns(arrays, times_s, time_name)
    channels: list[Channel] = []
    for joint, unit, values in columns:
        given = np.isfinite(values)
        if given.any():
            own = Channel(name=joint, unit=unit, times_s=times_s[given], values=values[given])
            channels.append(own)
        else:
            left_out.append(f"array {joint}, which has no number")
    if not channels:
        raise InputError("has no array of numbers that is a joint", path=path)
    motion = ForeignMotion(
        path=path,
        name=motion_name(path),
        channels=tuple(channels),
        notes={},
        comments=(f"Imported from {path.name} (NumPy).", *summarised(left_out)),
        is_recording=is_dense(times_s),
    )
    return (motion,)


NUMPY: Final = Reader("numpy", _is_numpy, _numpy_motions)
"""Reads arrays with names; a plain array has neither a time nor joints, and is refused."""

Arrays = dict[str, "NDArray[Any]"]
Column = tuple[str, Measure, "FloatArray"]


class _NumpyFile(Struct, frozen=True):
    """Reads the arrays of one file; every `InputError` has the name of the array."""

    path: Path

    def arrays(self, data: bytes) -> Arrays:
        """Return the arrays by name; those of a structured array are its fields."""
        try:
            if data.startswith(NPY):
                loaded = dict(self._fields(np.load(io.BytesIO(data), allow_pickle=False)))
            else:
                loaded = self._members(data)
        except InputError:
            raise
        except BROKEN as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"cannot be read as NumPy arrays: {reason:.200}", path=self.path
            ) from error
        if sum(array.size for array in loaded.values()) > VALUES_MAX:
            self._refuse(f"has more than {VALUES_MAX:,} values, the maximum")
        return loaded

    def _members(self, data: bytes) -> Arrays:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size_bytes = sum(member.file_size for member in archive.infolist())
            if size_bytes > RECORDING_MAX_BYTES or len(archive.infolist()) > ARRAYS_MAX:
                self._refuse(f"holds {size_bytes:,} bytes, more than {RECORDING_MAX_BYTES:,}")
        with np.load(io.BytesIO(data), allow_pickle=False) as members:
            return {name: np.asarray(members[name]) for name in members.files}

    def _fields(self, array: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
        for name in array.dtype.names or ():
            yield name, array[name]
        if not array.dtype.names:
            self._refuse(
                f"is a plain array of {'x'.join(map(str, array.shape))} numbers, without times, "
                f"joints and units; write it with {EXAMPLE}"
            )

    def times_s(self, arrays: Arrays) -> tuple[FloatArray | None, str]:
        """Return the times and the name of their array; None: they are counted, see `columns`."""
        for name, array in arrays.items():
            second = seconds_of(name)
            if second is not None and array.ndim == 1:
                return self._numbers(name, array) * second, name
        for names in (RATES, STEPS):
            for name in arrays:
                if name.lower() in names:
                    return None, name
        like = [name for name in arrays if is_time_name(name)]
        also = f"; {like[0]!r:.60} is not understood" if like else ""
        raise InputError(f"no array is the time: write it with {EXAMPLE}{also}", path=self.path)

    def columns(
        self, arrays: Arrays, times_s: FloatArray | None, time_name: str
    ) -> tuple[FloatArray, list[Column], list[str]]:
        """Return the times, the columns of joints, and what is left out."""
        left_out: list[str] = []
        own: list[tuple[str, Measure, FloatArray, bool]] = []
        for name, array in arrays.items():
            if name == time_name or array.dtype.kind in "USO":
                continue
            if is_time_name(name) or is_other_measure(name) or array.ndim not in (1, 2):
                left_out.append(f"array {name}")
                continue
            base, unit = unit_of_column(self.path, None, name)
            if not name_and_unit(name)[1]:
                self._refuse(f"array {name!r:.60} has no unit: name it {name:.40}_rad or _deg")
            values = self._numbers(name, array).reshape(len(array), -1)
            own += [(base, unit, values[:, at], array.ndim == 2) for at in range(values.shape[1])]
        if not own:
            self._refuse(f"no array is a joint: write it with {EXAMPLE}")
        rows = len(own[0][2])
        times_s = self._counted(arrays, time_name, rows) if times_s is None else times_s
        wrong = next((name for name, _, values, _ in own if len(values) != len(times_s)), None)
        if wrong is not None:
            self._refuse(f"array {wrong!r:.60} has not as many rows as {counted(times_s, 'time')}")
        self._check_times(times_s)
        return times_s, self._named(arrays, own), left_out

    def _named(
        self, arrays: Arrays, own: list[tuple[str, Measure, FloatArray, bool]]
    ) -> list[Column]:
        """Return the columns, those of arrays of several joints by the names in the file."""
        texts = [array for array in arrays.values() if array.dtype.kind == "U" and array.ndim == 1]
        several = sum(is_part for *_, is_part in own)
        names = next((map(str, array.tolist()) for array in texts if len(array) == several), None)
        numbers = iter(f"J{number}" for number in range(1, several + 1)) if names is None else names
        columns = [
            (next(numbers) if is_part else name, unit, values)
            for name, unit, values, is_part in own
        ]
        joints = [joint for joint, _, _ in columns]
        twice = next((joint for joint in joints if joints.count(joint) > 1 or not joint), None)
        if twice is not None:
            self._refuse(f"joint {twice!r:.60} has two arrays")
        return columns

    def _counted(self, arrays: Arrays, name: str, rows: int) -> FloatArray:
        number = self._numbers(name, arrays[name])
        value = float(number.flat[0]) if number.size == 1 else 0.0
        step_s = (1.0 / value if value else 0.0) if name.lower() in RATES else value
        if not 1.0 / FPS_MAX <= step_s <= VALUE_MAX:
            self._refuse(
                f"{name!r:.60} must be one number, of at most {FPS_MAX:g} samples a second"
            )
        return np.asarray(np.arange(rows) * step_s, dtype=np.float64)

    def _numbers(self, name: str, array: NDArray[Any]) -> FloatArray:
        if array.dtype.kind not in "fiub":
            self._refuse(f"array {name!r:.60} holds {array.dtype}, no numbers")
        numbers = np.asarray(array, dtype=np.float64)
        if np.isinf(numbers).any() or (np.abs(numbers) > VALUE_MAX * 1e9).any():
            self._refuse(f"array {name!r:.60} has a value that is out of range")
        return numbers

    def _check_times(self, times_s: FloatArray) -> None:
        if not len(times_s) or not np.isfinite(times_s).all() or np.abs(times_s).max() > VALUE_MAX:
            self._refuse("its times are no seconds: is the unit in their name (time_ms, time_ns)?")
        steps = np.diff(times_s)
        if (steps <= 0.0).any():
            at = int(np.argmax(steps <= 0.0)) + 1
            self._refuse(f"times must increase, but row {at + 1} is at {times_s[at]:g} s")

    def _refuse(self, reason: str) -> NoReturn:
        raise InputError(reason, path=self.path)
