"""`Sequence` → sequence.yaml: the text of the file. A property test reads files back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Cue, Interpolation, Keyframe, PlaylistStep, Sequence, SoundStyle
from lss_motion.show.write import sequence_text, write_sequence

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def sequence(folder: Path) -> Sequence:
    return Sequence(
        name="two words",
        robot_path=folder / "robot.yaml",
        loop=None,
        keyframes=(
            Keyframe(at_s=0.0, deg={"base": 0.5, "elbow": -20.0}, label="true"),
            Keyframe(at_s=1.25, deg={"base": 3.0}, hold_s=0.5, ease=Interpolation.LINEAR),
            Keyframe(at_s=2.0, deg={"base": 3.0}, hold_s=1.5, hold_may_shrink=True),
            Keyframe(at_s=4.0, deg={"base": 0.5, "elbow": -20.0}, is_anchor=True),
        ),
    )


def test_a_keyframe_is_one_line_with_only_what_is_not_the_default(
    folder: Path, sequence: Sequence
) -> None:
    assert sequence_text(sequence, folder, comments=["From a\ntest.\x1b"]) == (
        "# From a\n"
        "# test.?\n"
        'sequence: "two words"\n'
        "robot: robot.yaml\n"
        "timing: authored\n"
        "loop: forever\n"
        "keyframes:\n"
        '  - {at_s: 0, label: "true", deg: {base: 0.5, elbow: -20}}\n'
        "  - {at_s: 1.25, deg: {base: 3}, hold_s: 0.5, ease: linear}\n"
        "  - {at_s: 2, deg: {base: 3}, hold_s: 1.5, hold_may_shrink: true}\n"
        "  - {at_s: 4, deg: {base: 0.5, elbow: -20}, anchor: true}\n"
    )


def test_the_robot_is_named_relative_to_the_file(folder: Path, sequence: Sequence) -> None:
    below = folder / "shows" / "mine"
    below.mkdir(parents=True)
    write_sequence(sequence, below / "s.yaml")
    assert "robot: ../../robot.yaml" in (below / "s.yaml").read_text(encoding="utf-8")
    back = load_sequence(below / "s.yaml")
    assert back == sequence
    assert back.robot_path is not None
    assert back.robot_path.samefile(folder / "robot.yaml")


@pytest.mark.parametrize("place", ["schema", "lss_motion/schema"])
def test_the_schema_is_named_where_one_lies_above(
    folder: Path, sequence: Sequence, place: str
) -> None:
    (folder / place).mkdir(parents=True)
    (folder / place / "sequence.schema.json").write_text("{}")
    (folder / "shows").mkdir()
    first, _, _ = sequence_text(sequence, folder / "shows").partition("\n")
    assert first == f"# yaml-language-server: $schema=../{place}/sequence.schema.json"


def test_the_most_common_interpolation_is_written_once(folder: Path, sequence: Sequence) -> None:
    linear = Keyframe(at_s=5.0, deg={"base": 0.5}, ease=Interpolation.LINEAR)
    keyframes = (linear, Keyframe(at_s=6.0, deg={"base": 1.0}, ease=Interpolation.LINEAR))
    text = sequence_text(Sequence(name="s", keyframes=keyframes), folder)
    assert text.count("linear") == 1
    assert "interpolation: linear" in text


def test_a_place_that_cannot_be_written_is_an_input_error(folder: Path, sequence: Sequence) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_sequence(sequence, folder / "no such folder" / "s.yaml")


def test_tracks_are_written_below_their_names(folder: Path, sequence: Sequence) -> None:
    track = Sequence(name="eyes", keyframes=(Keyframe(at_s=0.0, deg={"elbow": 1.0}),), loop=3)
    text = sequence_text(Sequence(name="x", tracks=(track,), speed_ratio=0.5), folder)
    assert text == (
        "sequence: x\nspeed_ratio: 0.5\ntracks:\n  eyes:\n    timing: authored\n    loop: 3\n"
        "    keyframes:\n      - {at_s: 0, deg: {elbow: 1}}\n"
    )


def test_play_lists_and_layers_cannot_be_written(folder: Path, sequence: Sequence) -> None:
    with pytest.raises(InputError, match="play lists and layers cannot be written"):
        sequence_text(Sequence(name="x", play=(PlaylistStep(sequence=sequence),)), folder)


def test_escalations_are_written(folder: Path, sequence: Sequence) -> None:
    ladders = {Cause.ASTRAY: (FaultStep.WARN, FaultStep.HOLD), Cause.SILENT: (FaultStep.RESUME,)}
    write_sequence(replace(sequence, on_fault=ladders), folder / "s.yaml")
    assert load_sequence(folder / "s.yaml").on_fault == ladders


def test_the_sound_of_the_show_and_its_beats_are_written(folder: Path, sequence: Sequence) -> None:
    (folder / "voice 1.wav").write_bytes(b"")
    bed = Cue(
        at_s=0.0,
        sound=str(folder / "voice 1.wav"),
        style=SoundStyle(is_bed=True, gain_db=-6.0, is_looped=True),
    )
    with_sound = replace(sequence, events=(bed,), beats_s=(0.5, 1.25))
    write_sequence(with_sound, folder / "s.yaml")
    text = (folder / "s.yaml").read_text(encoding="utf-8")
    assert 'sound: {file: "voice 1.wav", gain_db: -6, loop: true}\n' in text
    assert load_sequence(folder / "s.yaml") == with_sound
    other = replace(sequence, events=(Cue(at_s=0.0, say="hello"),))
    with pytest.raises(InputError, match="events cannot be written"):
        sequence_text(other, folder)
