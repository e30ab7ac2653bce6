"""`Sequence` → sequence.yaml that a person can read and edit.

Law: the file loads as an equal sequence. Only what differs from the default is written.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.files.output import write_output
from lss_motion.files.texts import printable
from lss_motion.show.model import Interpolation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from lss_motion.show.model import Cue, Keyframe, Sequence

SCHEMAS: Final = (
    Path("schema", "sequence.schema.json"),
    Path("lss_motion", "schema", "sequence.schema.json"),
)
"""Where the schema is below a folder of examples or a checkout. A file written there names it."""

_PLAIN: Final = re.compile(r"(\.\./)*[A-Za-z_][A-Za-z0-9_./-]*")
_NOT_TEXT: Final = frozenset({"null", "true", "false"})


def write_sequence(sequence: Sequence, path: Path | str, *, comments: Iterable[str] = ()) -> None:
    """Write `sequence_text` to `path`, replacing a file there; raise `InputError` if that fails."""
    path = Path(path)
    text = sequence_text(sequence, path.parent, comments=comments)
    write_output(path, text)


def sequence_text(sequence: Sequence, folder: Path, *, comments: Iterable[str] = ()) -> str:
    """Return a sequence file for `folder` that loads as `sequence` again.

    Poses are written as angles, beats as times. `comments` come first, one a line. Raises
    `InputError` for a play list or layers: the file would have to name their files, and the
    sequence does not hold those; and for events besides the sound of the show.
    """
    if sequence.play or sequence.layers:
        raise InputError("play lists and layers cannot be written", path=sequence.path)
    beds = [cue for cue in sequence.events if cue.style.is_bed]
    if len(beds) < len(sequence.events) or len(beds) > 1:
        raise InputError("events cannot be written", path=sequence.path)
    sound = [_bed(cue, folder) for cue in beds]
    return "\n".join([*_head(sequence, folder, comments), *sound, *_body(sequence), ""])


def _head(sequence: Sequence, folder: Path, comments: Iterable[str]) -> Iterator[str]:
    places = (above / schema for above in _upwards(folder) for schema in SCHEMAS)
    schema = next((place for place in places if place.is_file()), None)
    if schema is not None:
        yield f"# yaml-language-server: $schema={_relative(schema, folder)}"
    for comment in comments:
        for line in comment.splitlines():
            yield f"# {printable(line)}".rstrip()
    yield f"sequence: {_text(sequence.name)}"
    if sequence.robot_path is not None:
        yield f"robot: {_text(_relative(sequence.robot_path, folder))}"


def _bed(cue: Cue, folder: Path) -> str:
    file = _text(_relative(Path(cue.sound), folder))
    gain = f", gain_db: {_number(cue.style.gain_db)}" if cue.style.gain_db else ""
    loop = ", loop: true" if cue.style.is_looped else ""
    return f"sound: {{file: {file}{gain}{loop}}}" if gain or loop else f"sound: {file}"


def _body(sequence: Sequence) -> Iterator[str]:
    if sequence.beats_s:
        yield f"beats: [{', '.join(map(_number, sequence.beats_s))}]"
    if sequence.speed_ratio != 1.0:
        yield f"speed_ratio: {_number(sequence.speed_ratio)}"
    if sequence.on_fault:
        yield "on_fault:"
    for cause, steps in sequence.on_fault.items():
        yield f"  {cause}: [{', '.join(steps)}]"
    if sequence.keyframes:
        yield from _track(sequence)
    if sequence.tracks:
        yield "tracks:"
    for track in sequence.tracks:
        yield f"  {_text(track.name)}:"
        yield from (f"    {line}" for line in _track(track, sequence.smooth_s))


def _track(sequence: Sequence, default_smooth_s: float = 0.0) -> Iterator[str]:
    yield f"timing: {sequence.timing}"
    if sequence.fit_duration_s is not None:
        yield f"duration_s: {_number(sequence.fit_duration_s)}"
    default = Counter(keyframe.ease for keyframe in sequence.keyframes).most_common(1)[0][0]
    if default is not Interpolation.SMOOTH:
        yield f"interpolation: {default}"
    if sequence.keeps_time:
        keyed = {name for keyframe in sequence.keyframes for name in keyframe.deg}
        named = ", ".join(f"{_text(name)}: time" for name in sorted(sequence.keeps_time))
        # Tracks inherit what a file says of all joints, but not what it says of single ones.
        is_whole = keyed == sequence.keeps_time and not sequence.tracks
        yield "keep: time" if is_whole else f"keep: {{{named}}}"
    if sequence.smooth_s != default_smooth_s:
        yield f"smooth_s: {_number(sequence.smooth_s)}"
    if sequence.loop != 1:
        yield f"loop: {'forever' if sequence.loop is None else sequence.loop}"
    if sequence.loop_span_s is not None:
        yield f"loop_span_s: [{', '.join(map(_number, sequence.loop_span_s))}]"
    yield "keyframes:"
    for keyframe in sequence.keyframes:
        yield f"  - {{{', '.join(_keyframe(keyframe, default))}}}"


def _keyframe(keyframe: Keyframe, default: Interpolation) -> Iterator[str]:
    if keyframe.at_s is not None:
        yield f"at_s: {_number(keyframe.at_s)}"
    if keyframe.label:
        yield f"label: {_text(keyframe.label)}"
    yield f"deg: {_angles(keyframe.deg)}"
    if keyframe.hold_s > 0.0:
        yield f"hold_s: {_number(keyframe.hold_s)}"
    if keyframe.hold_may_shrink:
        yield "hold_may_shrink: true"
    if keyframe.is_anchor:
        yield "anchor: true"
    if keyframe.is_exact:
        yield "exact: true"
    if keyframe.weight != 1.0:
        yield f"weight: {_number(keyframe.weight)}"
    if keyframe.ease is not default:
        yield f"ease: {keyframe.ease}"


def _angles(angles_deg: Mapping[str, float]) -> str:
    return "{" + ", ".join(f"{_text(n)}: {_number(a)}" for n, a in angles_deg.items()) + "}"


def _number(value: float) -> str:
    """Return the shortest text that reads back as exactly this number."""
    return str(int(value)) if value.is_integer() else repr(value)


def _text(text: str) -> str:
    if _PLAIN.fullmatch(text) and text.lower() not in _NOT_TEXT:
        return text
    return json.dumps(text, ensure_ascii=False)  # JSON of printable text is YAML.


def _upwards(folder: Path) -> list[Path]:
    folder = folder.absolute()
    return [folder, *folder.parents]


def _relative(path: Path, folder: Path) -> str:
    """Return `path` as seen from `folder`, with forward slashes."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # On another drive of Windows no relative path exists.
        return path.absolute().as_posix()
