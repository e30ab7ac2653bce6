"""sequence.yaml → `Sequence`: the file, its robot, its events, and the files that it plays.

Law: all problems of a file come in one `InputError`, each with its line. What could not be read
is left out of later checks, so that one mistake is reported once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.source import Location, looked_for
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake, read_yaml, source_of
from lss_motion.protocol.constants import Led
from lss_motion.robot.load import load_named_robot
from lss_motion.show.beats import beats_of, on_beats
from lss_motion.show.check import check_sequence
from lss_motion.show.functions import function_problem
from lss_motion.show.keyframes import TrackLoader, at_speed, timing_of
from lss_motion.show.model import EXPANDED_MAX, Cue, Sequence, SoundStyle, Timing
from lss_motion.show.parts import (
    FileContext,
    PartLoader,
    expanded,
    expanded_text,
    mirrored,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.model import Robot
    from lss_motion.show.file import EventEntry, SequenceFile, SoundEntry


def load_sequence(
    path: Path | str | Mapping[str, object],
    robot: Robot | None = None,
    *,
    read_other: Callable[[Path, Robot], Sequence | None] | None = None,
) -> Sequence:
    """Return the sequence of a file, or of the same keys as a dict, checked against its robot.

    The robot is `robot`, or else the one that the file names; it gives the poses, the ranges and
    the mirror images. `robot_path` of the result is the file of that robot. Raises `InputError`
    with file, line, value and remedy; its `more` holds all further problems, also those of the
    robot file and of the sequence files that this one plays. `read_other` reads files of another
    kind, such as gaits; it returns None for a sequence file.
    """
    part = FileContext(read_other=read_other)
    if isinstance(path, Path | str):
        return _load(Path(path), robot, part)
    return replace(_loaded(source_of(path), robot, part), path=None)


def sequence_schema() -> dict[str, Any]:
    """Return the JSON Schema of a sequence file."""
    from lss_motion.files.keys import json_schema
    from lss_motion.show.file import SequenceFile

    return json_schema(SequenceFile)


def _load(path: Path, robot: Robot | None, part: FileContext) -> Sequence:
    other = part.other(path, robot)
    return _loaded(read_yaml(path), robot, part) if other is None else other


def _loaded(source: YamlSource, robot: Robot | None, part: FileContext) -> Sequence:
    from lss_motion.files.validation import validate
    from lss_motion.show.file import (
        EventEntry,
        KeyframeEntry,
        LayerEntry,
        SequenceFile,
        StepEntry,
    )

    if "joints" in source.value and "sequence" not in source.value:
        reason = "this is a robot file, which cannot be played; name a sequence that has `robot:`"
        raise InputError(reason, path=source.path, line=source.line(("joints",)))
    blanks = {
        "keyframes": KeyframeEntry(),
        "play": StepEntry(pause_s=0.0),
        "layers": LayerEntry(file="-"),
        "events": EventEntry(at_s=0.0),
    }
    content, problems, left_out = validate(SequenceFile, source, blanks=blanks)
    errors: list[InputError] = []
    found: list[Mistake] = []
    try:
        robot = robot or _named_robot(source, left_out)
    except InputError as error:
        errors.append(error)
    if content is not None:
        content, found = on_beats(content)
        problems += found
    if content is not None and not found:
        loader = _SequenceLoader(content, left_out, source, robot, part.inside(source.path))
        sequence = loader.sequence()
        problems += loader.problems
        errors += loader.errors
        if not problems and not errors:
            assert robot is not None
            return _finished(sequence, content, robot, part)
    raise _as_one(source, problems, errors)


TRACK_KEYS: Final = (
    *("keyframes", "tracks", "timing", "duration_s", "hold_may_shrink", "keep", "smooth_s"),
)
"""Keys that say how keyframes are planned, which a play list does not hold."""


def _finished(
    sequence: Sequence, content: SequenceFile, robot: Robot, part: FileContext
) -> Sequence:
    """Return the sequence, mirrored if the file requires it, after the checks across its parts."""
    if content.mirror:
        sequence = mirrored(sequence, robot.mirror)
        check_sequence(sequence, robot, is_offset=part.is_offset)
    at_speed(sequence)
    return sequence


def _named_robot(source: YamlSource, left_out: frozenset[Location]) -> Robot | None:
    """Return the robot that the file names; None if the key `robot` itself could not be read."""
    name = source.value.get("robot")
    if ("robot",) in left_out or ("robot" in source.value and name is None):
        return None
    return load_named_robot(source, name if name is None else str(name))


def _as_one(source: YamlSource, problems: list[Mistake], errors: list[InputError]) -> InputError:
    """Return one error: the problems of this file first, then those of others."""
    own = [source.error(problems)] if problems else []
    top, *others = [*own, *errors]
    if not others:
        return top
    return InputError(top.reason, path=top.path, line=top.line, more=[*top.more, *others])


@dataclass(slots=True)
class _SequenceLoader:
    """Builds the sequence of one file.

    `problems` are those of this file, `errors` those of other files.
    """

    content: SequenceFile
    left_out: frozenset[Location]
    source: YamlSource
    robot: Robot | None
    part: FileContext
    problems: list[Mistake] = field(default_factory=list)
    errors: list[InputError] = field(default_factory=list)

    def sequence(self) -> Sequence:
        from lss_motion.robot.file import escalations

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
        # Without keyframes there are no times to check; the files of a play list have their own.
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
            events=(
                *bed(content.sound, self.left_out, self.source, self._note),
                *cues(content.events, self.left_out, self.source, self.robot, self._note),
            ),
            beats_s=beats_of(content),
            on_fault=escalations(content.on_fault),
        )
        self.problems += parts.problems
        self.errors += parts.errors
        self._check_tracks(sequence)
        self._check_expanded(sequence)
        return sequence

    def _own_left_out(self) -> frozenset[Location]:
        return frozenset(
            p for p in self.left_out if p[0] not in {"tracks", "play", "layers", "events"}
        )

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _check_kinds(self) -> None:
        content, left_out = self.content, {place[0] for place in self.left_out}
        has_frames, has_play = bool(content.keyframes), bool(content.play)
        if left_out & {"keyframes", "tracks", "play"}:
            return
        if not (has_frames or has_play or content.tracks):
            self._note((), "no keyframes: give 'keyframes', 'tracks' or 'play'")
        if content.tracks and not has_frames and all(one.mute for one in content.tracks.values()):
            self._note(("tracks",), "every track is muted, so nothing moves; leave one of them on")
        for key in TRACK_KEYS:
            if has_play and getattr(content, key):
                self._note((key,), f"{key} does not go with 'play'; put it into a file of the list")
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
        has_others = bool(content.play or content.tracks or content.events or content.sound)
        if has_others or not content.keyframes:
            self._note(place, "only keyframes without tracks and events can be looped in part")
        if timing_of(content) is not Timing.AUTHORED:
            self._note(place, "a loop of a part needs timing: authored")
        return from_s, to_s

    def _tracks(self) -> tuple[Sequence, ...]:
        tracks = []
        for name, entry in self.content.tracks.items():
            place = ("tracks", name)
            loader = TrackLoader(
                entry,
                place,
                frozenset(),
                self.source,
                self.robot,
                self.part.is_offset,
                smooth_s=self.content.smooth_s or 0.0,
                holds_may_shrink=bool(self.content.hold_may_shrink),
                keep=self.content.keep,
            )
            if not entry.keyframes:
                self._note(place, f"track {name!r} has no keyframes")
                continue
            track = loader.sequence(name)
            if not entry.mute:
                tracks.append(track)
            self.problems += loader.problems
        return tuple(tracks)

    def _check_expanded(self, sequence: Sequence) -> None:
        """Note parts that repeat so often that the memory would not hold their plan."""
        for track in sequence.tracks:
            if (count := expanded(track)) > EXPANDED_MAX:
                self._note(("tracks", track.name, "loop"), f"loop: {expanded_text(count)}")
        layered = sum(expanded(layer.sequence) for layer in sequence.layers)
        if sequence.layers and (count := expanded(replace(sequence, layers=()))) > EXPANDED_MAX:
            self._note(("loop",), f"loop: with layers it {expanded_text(count)}")
        elif layered > EXPANDED_MAX:
            self._note(("layers",), f"layers: {expanded_text(layered)}")

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


def bed(
    entry: str | SoundEntry | None,
    left_out: frozenset[Location],
    source: YamlSource,
    note: Callable[[Location, str], None],
) -> Iterator[Cue]:
    """Yield the sound of the show as a cue at its beginning, if there is one."""
    place: Location = ("sound",)
    if entry is None or any(location[:1] == place for location in left_out):
        return
    name, style = entry, SoundStyle(is_bed=True)
    if not isinstance(entry, str):
        name = entry.file
        style = SoundStyle(gain_db=entry.gain_db, is_looped=entry.loop, is_bed=True)
    path = source.path.absolute().parent / str(name)
    if not looked_for(path, is_found=path.is_file()):
        note(place, f"sound file {str(name)!r} not found; looked for {path}")
    yield Cue(at_s=0.0, sound=str(path), style=style, line=source.line(place))


KINDS: Final = ("led", "say", "run", "sound")


def cues(
    entries: Iterable[EventEntry],
    left_out: frozenset[Location],
    source: YamlSource,
    robot: Robot | None,
    note: Callable[[Location, str], None],
) -> Iterator[Cue]:
    """Yield the cues of the entries; call `note` with location and reason of each problem."""
    folder = source.path.absolute().parent
    for index, entry in enumerate(entries):
        place: Location = ("events", index)
        if place in left_out:
            continue
        given = [kind for kind in KINDS if getattr(entry, kind) is not None]
        if len(given) != 1:
            note(
                place, f"an event is one of {', '.join(KINDS)}, not {' and '.join(given) or 'none'}"
            )
            continue
        for key in ("lead_s", "gain_db", "loop", "duck_db"):
            if getattr(entry, key) and entry.sound is None:
                note((*place, key), f"{key} belongs to a sound")
        path = None if entry.sound is None else folder / entry.sound
        if path is not None and not looked_for(path, is_found=path.is_file()):
            note((*place, "sound"), f"sound file {entry.sound!r} not found; looked for {path}")
        if entry.run is not None and (problem := function_problem(entry.run, str(folder))):
            note((*place, "run"), f"run: {entry.run!r} cannot be used: {problem}")
        known = {} if robot is None else robot.joints
        for name in entry.led or () if robot is not None else ():
            if name not in known:
                note((*place, "led", name), f"unknown joint {name!r}; {known_names(name, known)}")
        led = {} if entry.led is None else entry.led
        yield Cue(
            at_s=entry.at_s,
            led=tuple((name, int(Led[colour.upper()])) for name, colour in led.items()),
            say=entry.say or "",
            run=entry.run or "",
            sound="" if entry.sound is None else str(folder / entry.sound),
            lead_s=entry.lead_s,
            style=SoundStyle(gain_db=entry.gain_db, is_looped=entry.loop, duck_db=entry.duck_db),
            folder=str(folder) if entry.run else "",
            line=source.line(place),
        )
