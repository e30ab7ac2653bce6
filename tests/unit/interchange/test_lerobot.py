"""LeRobot datasets as pyarrow writes them: episodes, rate, names, and errors."""

from __future__ import annotations

import builtins
import io
import json
from pathlib import Path

import pytest

from lss_motion.errors import InputError, install_command
from lss_motion.interchange.lerobot import LEROBOT
from lss_motion.interchange.reader import Measure

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

FRAMES = {
    "action": [[9.0, 9.0]] * 5,
    "observation.state": [[0.5, 10.0], [1.5, 11.0], [2.5, 12.0], [50.0, 60.0], [51.0, 61.0]],
    "timestamp": [0.0, 0.033333, 0.066667, 0.0, 0.033333],
    "frame_index": [0, 1, 2, 0, 1],
    "episode_index": [0, 0, 0, 1, 1],
}
INFO = {
    "fps": 30,
    "features": {"observation.state": {"names": ["shoulder_pan.pos", "gripper.pos"]}},
}


def parquet(**changes) -> bytes:
    columns = {name: column for name, column in {**FRAMES, **changes}.items() if column is not None}
    out = io.BytesIO()
    pq.write_table(pa.table(columns), out, compression="snappy")
    return out.getvalue()


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    path = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    path.write_bytes(parquet())
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(json.dumps(INFO), encoding="utf-8")
    return path


def test_episodes_have_the_rate_and_the_names_of_the_dataset(dataset: Path) -> None:
    data = dataset.read_bytes()
    assert LEROBOT.recognises(data)
    first, second = LEROBOT.motions(dataset, data)
    assert (first.name, second.name, first.is_recording) == ("episode 0", "episode 1", True)
    pan, gripper = first.channels
    assert (pan.name, gripper.name, pan.unit) == ("shoulder_pan", "gripper", Measure.RAW)
    assert pan.times_s.tolist() == pytest.approx([0.0, 1 / 30, 2 / 30], abs=1e-6)
    assert pan.values.tolist() == [0.5, 1.5, 2.5]
    assert second.channels[1].values.tolist() == [60.0, 61.0]


@pytest.mark.parametrize(
    "state",
    [
        pa.array([[1.0], [2.0], [3.0], [4.0], [5.0]], pa.list_(pa.float32(), 1)),
        pa.array([[1.0], [2.0], [3.0], [4.0], [5.0]], pa.large_list(pa.float64())),
        pa.array([1, 2, 3, 4, 5], pa.int32()),
    ],
)
def test_without_a_description_joints_have_numbers_and_times_are_timestamps(state) -> None:
    data = parquet(**{"observation.state": state})
    first, _ = LEROBOT.motions(Path("x.parquet"), data)
    assert [channel.name for channel in first.channels] == ["state_0"]
    assert first.channels[0].times_s.tolist() == pytest.approx([0.0, 0.033333, 0.066667])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"observation.state": None, "action": None}, "has no column observation.state or action"),
        (
            {"observation.state": [[1.0], [2.0], [3.0], [4.0], [5.0, 6.0]]},
            "lists of the same length",
        ),
        ({"observation.state": [[float("nan")]] * 5}, "missing or too large"),
        ({"observation.state": [["a"]] * 5}, "cannot be read as parquet"),
        ({"timestamp": None}, "has no column timestamp"),
        ({"timestamp": [0.0, 0.0, 0.1, 0.0, 0.1]}, "the times of an episode must increase"),
    ],
)
def test_what_is_no_dataset_is_refused(refusal, changes, reason) -> None:
    assert reason in refusal(LEROBOT, parquet(**changes)).reason


def test_a_file_that_was_cut_off_is_recognised_and_called_so(refusal) -> None:
    data = parquet()[:-40]
    assert LEROBOT.recognises(data)
    assert refusal(LEROBOT, data).reason.endswith("it was cut off")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ({"motors": ["pan", "tilt", "grip"]}, ["pan", "tilt", "grip"]),
        (["pan", "gripper", "gripper"], ["pan", "gripper", "gripper_2"]),
        (["grip", "grip_2", "grip"], ["grip", "grip_2", "grip_3"]),
        (["state"], ["state_0", "state_1", "state_2"]),
        (None, ["state_0", "state_1", "state_2"]),
    ],
)
def test_names_of_public_datasets(dataset: Path, names, expected) -> None:
    info = {**INFO, "features": {"observation.state": {"names": names}}}
    (dataset.parents[2] / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    data = parquet(**{"observation.state": [[1.0, 2.0, 3.0]] * 5})
    motion, _ = LEROBOT.motions(dataset, data)
    assert [channel.name for channel in motion.channels] == expected
    assert [channel.values[0] for channel in motion.channels] == [1.0, 2.0, 3.0]


def test_names_for_other_joints_are_refused(dataset: Path) -> None:
    dataset.write_bytes(parquet(**{"observation.state": [[1.0]] * 5}))
    with pytest.raises(InputError, match="names 2 joints, but"):
        LEROBOT.motions(dataset, dataset.read_bytes())


def test_without_pyarrow_the_message_tells_what_to_install(monkeypatch, refusal) -> None:
    data = parquet()
    found = builtins.__import__

    def without(name, *rest):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return found(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    assert install_command("lerobot") in refusal(LEROBOT, data).reason
