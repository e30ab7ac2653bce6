"""LeRobot datasets: parquet files with `observation.state`, one motion per episode.

The rate of the frames and the names of the joints are in `meta/info.json`, which is looked for in
the folders above the file. Values are degrees or -100 to 100, as the robot was configured; the file
does not define which, so a map file must. Needs pyarrow: the extra `[lerobot]`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.errors import InputError, install_command
from lss_motion.files.source import read_data
from lss_motion.files.texts import counted
from lss_motion.interchange.fields import JsonFields, parsed_json
from lss_motion.interchange.reader import (
    FPS_MAX,
    VALUES_MAX,
    Channel,
    Measure,
    Reader,
    recording,
    thinned,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.interchange.reader import FloatArray, ForeignMotion

MAGIC: Final = b"PAR1"
STATES: Final = ("observation.state", "action")
"""Columns with positions of all joints; the first that exists is read."""

INFO: Final = ("meta", "info.json")
INFO_MAX_BYTES: Final = 4_000_000
ABOVE_MAX: Final = 4
"""The file is in `data/chunk-000/`, below the folder of the dataset."""

TIMES: Final = ("timestamp", "frame_index", "episode_index")


def _is_lerobot(data: bytes) -> bool:
    return data.startswith(MAGIC)


def _lerobot_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    if data.startswith(MAGIC) and not data.endswith(MAGIC):
        raise InputError("does not end as a parquet file: it was cut off", path=path)
    column, values, times = _table(path, data)
    info = _info(path)
    fps = _fps(path, info)
    names = _names(path, info, column, values.shape[1])
    about = [f"Imported from {path.name} (LeRobot dataset, {column})."]
    if info is None:
        about.append("Without meta/info.json the joints have no names, only numbers.")
    episodes = times.get("episode_index", np.zeros(len(values)))
    motions: list[ForeignMotion] = []
    for episode in np.unique(episodes).tolist():
        rows = np.flatnonzero(episodes == episode)
        times_s = _times_s(path, times, rows, fps)
        channels: list[Channel] = []
        for index, name in enumerate(names):
            own_s, own = thinned(times_s, values[rows, index])
            channels.append(Channel(name=name, unit=Measure.RAW, times_s=own_s, values=own))
        motions.append(recording(path, f"episode {episode:g}", channels, comments=about))
    return tuple(motions)


LEROBOT: Final = Reader("lerobot", _is_lerobot, _lerobot_motions)
"""Reads `observation.state` (or `action`) by episode, at the rate of the dataset."""


def _table(path: Path, data: bytes) -> tuple[str, FloatArray, dict[str, FloatArray]]:
    """Return the name of the column of states, its values (rows, joints), and the times."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise InputError(
            f"is a parquet file, which needs pyarrow: {install_command('lerobot')}", path=path
        ) from error
    try:
        file = pq.ParquetFile(pa.BufferReader(data))
        names = file.schema_arrow.names
        column = next((name for name in STATES if name in names), None)
        if column is None:
            reason = f"has no column {' or '.join(STATES)}; it has {', '.join(names):.200}"
            raise InputError(reason, path=path)  # noqa: TRY301  (not one of those caught)
        if file.metadata.num_rows > VALUES_MAX:
            reason = f"has more than {VALUES_MAX:,} rows, the maximum"
            raise InputError(reason, path=path)  # noqa: TRY301
        wanted = [column, *(name for name in TIMES if name in names)]
        table = file.read(columns=wanted, use_threads=False)
        values = _values(path, column, table.column(column), pa)
        times = {name: np.asarray(table.column(name), dtype=np.float64) for name in wanted[1:]}
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, TypeError, MemoryError, OverflowError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"cannot be read as parquet: {reason:.200}", path=path) from error
    for name, own in times.items():
        if len(own) != len(values) or not np.isfinite(own).all() or np.abs(own).max() > 1e9:
            raise InputError(f"column {name} has values that are missing or too large", path=path)
    return column, values, times


def _values(path: Path, column: str, listed: Any, pa: Any) -> FloatArray:  # noqa: ANN401
    """Return lists of equal length, or single numbers, as (rows, joints)."""
    rows_count = len(listed)
    chunk = listed.combine_chunks()
    if (
        pa.types.is_list(chunk.type)
        or pa.types.is_large_list(chunk.type)
        or (pa.types.is_fixed_size_list(chunk.type))
    ):
        chunk = chunk.flatten()
    flat = np.asarray(chunk.to_numpy(zero_copy_only=False), dtype=np.float64)
    joints_count = len(flat) // rows_count if rows_count else 0
    if not joints_count or len(flat) != joints_count * rows_count:
        raise InputError(f"column {column} needs lists of the same length in every row", path=path)
    if len(flat) > VALUES_MAX:
        raise InputError(f"has more than {VALUES_MAX:,} values, the maximum", path=path)
    if not np.isfinite(flat).all() or np.abs(flat).max() > 1e9:
        raise InputError(f"column {column} has values that are missing or too large", path=path)
    return flat.reshape(rows_count, joints_count)


def _info(path: Path) -> dict[str, object] | None:
    """Return the content of `meta/info.json` above the file, or None."""
    for folder in list(path.parents)[:ABOVE_MAX]:
        place = folder.joinpath(*INFO)
        if place.is_file():
            content = parsed_json(place, read_data(place, INFO_MAX_BYTES))
            return JsonFields(place).mapping(content, "the file")
    return None


def _fps(path: Path, info: dict[str, object] | None) -> float | None:
    if info is None or "fps" not in info:
        return None
    fps = JsonFields(path).number(info, "fps", "meta/info.json")
    if not 0.0 < fps <= FPS_MAX:
        raise InputError(
            f"meta/info.json: fps {fps:g} is not above 0, at most {FPS_MAX:g}", path=path
        )
    return fps


def _names(path: Path, info: dict[str, object] | None, column: str, count: int) -> list[str]:
    """Return the names of the joints in `info`, or numbers; a name that repeats gets a number."""
    features = info.get("features") if info else None
    feature = features.get(column) if isinstance(features, dict) else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):  # Some datasets write {"motors": [...]}.
        names = next(iter(names.values()), None)
    if not isinstance(names, list):
        return [f"state_{index}" for index in range(count)]
    texts = [str(name).removesuffix(".pos") for name in names]
    if len(texts) == 1 < count:  # Some datasets name the axis, such as "state", not its values.
        texts = [f"{texts[0]}_{index}" for index in range(count)]
    if len(texts) != count:
        raise InputError(
            f"meta/info.json names {counted(texts, 'joint')}, but {column} has {count}", path=path
        )
    distinct: list[str] = []
    for text in texts:
        numbers = (f"_{number}" for number in range(2, count + 1))
        distinct.append(next(text + end for end in ("", *numbers) if text + end not in distinct))
    return distinct


def _times_s(
    path: Path, times: dict[str, FloatArray], rows: NDArray[np.intp], fps: float | None
) -> FloatArray:
    if fps is not None:
        frames = times.get("frame_index")
        taken = np.arange(len(rows)) if frames is None else frames[rows]
        times_s = np.asarray(taken, dtype=np.float64) / fps
    elif "timestamp" in times:
        times_s = times["timestamp"][rows]
    else:
        raise InputError(
            "has no column timestamp, and meta/info.json with the fps is not in a folder above it",
            path=path,
        )
    if (np.diff(times_s) <= 0.0).any():
        raise InputError("the times of an episode must increase", path=path)
    return np.asarray(times_s, dtype=np.float64)
