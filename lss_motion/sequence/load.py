"""sequence.yaml → Sequence: the file, its robot, and the files that it is made of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.sequence.check import check_sequence
from lss_motion.sequence.cues import cues
from lss_motion.sequence.frames import TrackLoader
from lss_motion.sequence.mirror import mirrored
from lss_motion.sequence.model import Sequence, Timing
from lss_motion.sequence.parts import Part, PartLoader
from lss_motion.sequence.speed import at_speed
from lss_motion.sequence.timing import timing_of
from lss_motion.yaml_source import Location, Problem, read_yaml

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.file import SequenceFile
    from lss_motion.yaml_source import YamlSource


def load_sequence(
    path: Path | str,
    robot: Robot | None = None,
    *,
    read_other: Callable[[Path, Robot], Sequence | None] | None = None,
) -> Sequence:
    """Return the sequence of a sequence file, checked against its robot.

    The robot is `robot`, or else the one that the file names; it gives the poses, the ranges, and
    left and right. `robot_path` of the result is where that robot was read. Raises `InputError`
    with file, line, value and remedy; its `more` holds all further problems, those of the robot
    file and of the sequence files that this one plays included. `read_other` reads those of
    another kind; it returns None for a sequence file.
    """
    return _load(Path(path), robot, Part(read_other=read_other))


def sequence_schema() -> dict[str, Any]:
    """Return the JSON Schema of a sequence file."""
    from lss_motion.json_schema import json_schema
    from lss_motion.sequence.file import SequenceFile

    return json_schema(SequenceFile)


def _load(path: Path, robot: Robot | None, part: Part) -> Sequence:
    from lss_motion.sequence.file import (
        EventEntry,
        KeyframeEntry,
        LayerEntry,
        SequenceFile,
        StepEntry,
    )
    from lss_motion.validation import validate

    if (other := part.other(path, robot)) is not None:
        return other
    source = read_yaml(path)
    blanks = {
        "keyframes": KeyframeEntry(),
        "play": StepEntry(pause_s=0.0),
        "layers": LayerEntry(file="-"),
        "events": EventEntry(at_s=0.0),
    }
    content, problems, left_out = validate(SequenceFile, source, blanks=blanks)
    errors: list[InputError] = []
    try:
        robot = robot or _named_robot(source, left_out)
    except InputError as error:
        errors.append(error)
    if content is not None:
        loader = _Loader(content, left_out, source, robot, part.inside(path))
        sequence = loader.sequence()
        problems += loader.problems
        errors += loader.errors
        if not problems and not errors:
            assert robot is not None
            return _finished(sequence, content, robot, part)
    raise _all_of(source, problems, errors)


def _finished(sequence: Sequence, content: SequenceFile, robot: Robot, part: Part) -> Sequence:
    """Return the sequence, mirrored where the file says so, after the checks across its parts."""
    if content.mirror:
        sequence = mirrored(sequence, robot.mirror)
        check_sequence(sequence, robot, is_offset=part.is_offset)
    at_speed(sequence)
    return sequence


def _named_robot(source: YamlSource, left_out: frozenset[Location]) -> Robot | None:
    """Return the robot that the file names; None if that key itself is at fault."""
    name = source.value.get("robot")
    if ("robot",) in left_out or ("robot" in source.value and name is None):
        return None
    if name is None:
        raise source.error([Problem((), "no robot: give 'robot: FILE' here, or --robot FILE")])
    path = source.path.parent / str(name)
    if not path.exists():
        reason = f"robot file {str(name)!r} not found; looked for {path}"
        raise source.error([Problem(("robot",), reason)])
    return load_robot(path)


def _all_of(source: YamlSource, problems: list[Problem], errors: list[InputError]) -> InputError:
    """Return one error: the problems of this file first, then those of others."""
    own = [source.error(problems)] if problems else []
    top, *others = [*own, *errors]
    if not others:
        return top
    return InputError(top.reason, path=top.path, line=top.line, more=[*top.more, *others])


@dataclass(slots=True)
class _Loader:
    """Builds the sequence of one file and notes what does not fit, unless its part is left out."""

    content: SequenceFile
    left_out: frozenset[Location]
    source: YamlSource
    robot: Robot | None
    part: Part
    problems: list[Problem] = field(default_factory=list)
    errors: list[InputError] = field(default_factory=list)

    def sequence(self) -> Sequence:
        from lss_motion.robot.on_fault_file import ladders

        content = self.content
        main = TrackLoader(
            content,
            (),
            self._own_left_out(),
            self.source,
            self.robot,
            self.part.is_offset,
            is_looped_in_part=content.loop_span_s is not None,
        )
        # Without keyframes there is nothing to say about times; a play list has its own.
        sequence = (
            main.sequence(content.sequence)
            if content.keyframes
            else Sequence(
                name=content.sequence,
                path=self.source.path,
                robot_path=None if self.robot is None else self.robot.path,
                loop=None if content.loop == "forever" else content.loop,
            )
        )
        self.problems += main.problems
        self._check_kinds()
        parts = PartLoader(content, self.left_out, self.source, self.robot, self.part, _load)
        sequence = replace(
            sequence,
            loop_span_s=self._loop_span_s(),
            speed_ratio=content.speed_ratio,
            tracks=self._tracks(),
            play=parts.steps(),
            layers=parts.layers(),
            events=tuple(cues(content.events, self.left_out, self.source, self.robot, self._note)),
            on_fault=ladders(content.on_fault),
        )
        self.problems += parts.problems
        self.errors += parts.errors
        self._check_tracks(sequence)
        return sequence

    def _own_left_out(self) -> frozenset[Location]:
        return frozenset(
            p for p in self.left_out if p[0] not in {"tracks", "play", "layers", "events"}
        )

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Problem(location, reason))

    def _check_kinds(self) -> None:
        content, left_out = self.content, {place[0] for place in self.left_out}
        has_frames, has_play = bool(content.keyframes), bool(content.play)
        if left_out & {"keyframes", "tracks", "play"}:
            return
        if not (has_frames or has_play or content.tracks):
            self._note((), "no keyframes: give 'keyframes', 'tracks' or 'play'")
        for key in ("keyframes", "tracks", "timing", "duration_s"):
            if has_play and getattr(content, key):
                self._note((key,), f"{key} does not go with 'play'; put it into a file of the list")
        if content.layers and content.loop == "forever":
            self._note(
                ("layers",),
                "layers need a show that ends; give loop a count, or layer the file that is looped",
            )
        if content.loop != 1 and not has_frames and not has_play:
            self._note(("loop",), "there is nothing to loop; give each track its own loop")

    def _loop_span_s(self) -> tuple[float, float] | None:
        content = self.content
        if content.loop_span_s is None:
            return None
        place: Location = ("loop_span_s",)
        from_s, to_s = content.loop_span_s
        if to_s <= from_s:
            self._note(place, f"the loop would end at {to_s:g} s, not after {from_s:g} s")
        if content.play or content.tracks or content.events or not content.keyframes:
            self._note(place, "only keyframes without tracks and events can be looped in part")
        if timing_of(content) is not Timing.AUTHORED:
            self._note(place, "a loop of a part needs timing: authored")
        return from_s, to_s

    def _tracks(self) -> tuple[Sequence, ...]:
        tracks = []
        for name, entry in self.content.tracks.items():
            place = ("tracks", name)
            loader = TrackLoader(
                entry, place, frozenset(), self.source, self.robot, self.part.is_offset
            )
            if not entry.keyframes:
                self._note(place, f"track {name!r} has no keyframes")
                continue
            tracks.append(loader.sequence(name))
            self.problems += loader.problems
        return tuple(tracks)

    def _check_tracks(self, sequence: Sequence) -> None:
        owners = {name: "" for frame in sequence.keyframes for name in frame.deg}
        for track in sequence.tracks:
            own = {name: track.name for frame in track.keyframes for name in frame.deg}
            for name in own.keys() & owners.keys():
                of = f"track {owners[name]!r}" if owners[name] else "the keyframes outside tracks"
                self._note(
                    ("tracks", track.name),
                    f"joint {name!r} is keyed in track {track.name!r} and in {of}; keep it in one",
                )
            owners |= own
