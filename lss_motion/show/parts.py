"""The parts of a sequence file: steps of its play list and layers, both from other files.

`PartLoader` loads them for `show.load`. `mirrored` exchanges left and right of a sequence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake
from lss_motion.show.check import check_sequence, jumps_between
from lss_motion.show.keyframes import at_speed
from lss_motion.show.model import (
    EXPANDED_MAX,
    PLAY_STEPS_MAX,
    Layer,
    PlaylistStep,
    Sequence,
    Timing,
    Wait,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.model import Robot
    from lss_motion.show.file import LayerEntry, SequenceFile, StepEntry, WaitEntry

    Images = Mapping[str, tuple[str, Literal[1, -1]]]


def mirrored(sequence: Sequence, images: Images) -> Sequence:
    """Return the sequence with left and right exchanged; joints without an image stay as they are.

    `images` gives for a joint the joint on the other side and the sign of the angle there.
    """
    return replace(
        sequence,
        keyframes=tuple(
            replace(
                frame,
                deg=_exchanged(frame.deg, images),
                slope_deg_s=_exchanged(frame.slope_deg_s, images),
            )
            for frame in sequence.keyframes
        ),
        keeps_time=frozenset(images.get(name, (name, 1))[0] for name in sequence.keeps_time),
        tracks=tuple(mirrored(track, images) for track in sequence.tracks),
        play=tuple(
            replace(step, sequence=step.sequence and mirrored(step.sequence, images))
            for step in sequence.play
        ),
        layers=tuple(
            replace(
                layer,
                sequence=mirrored(layer.sequence, images),
                joints=tuple(images.get(name, (name, 1))[0] for name in layer.joints),
            )
            for layer in sequence.layers
        ),
    )


def keeping(sequence: Sequence, *, is_time: bool) -> Sequence:
    """Return the sequence with all joints of it and of its parts keeping time, or angle."""
    keyed = frozenset(name for frame in sequence.keyframes for name in frame.deg)
    return replace(
        sequence,
        keeps_time=keyed if is_time else frozenset(),
        tracks=tuple(keeping(track, is_time=is_time) for track in sequence.tracks),
        play=tuple(
            replace(step, sequence=step.sequence and keeping(step.sequence, is_time=is_time))
            for step in sequence.play
        ),
        layers=tuple(
            replace(layer, sequence=keeping(layer.sequence, is_time=is_time))
            for layer in sequence.layers
        ),
    )


def _exchanged(angles_deg: Mapping[str, float], images: Images) -> dict[str, float]:
    exchanged = {}
    for name, angle_deg in angles_deg.items():
        image, sign = images.get(name, (name, 1))
        exchanged[image] = angle_deg if sign == 1 else -angle_deg
    return exchanged


class FileContext(Struct, frozen=True):
    """The place of a file within a show.

    `files` are those that include it, so that a file cannot include itself. `is_offset`: its angles
    are added to others. `read_other` reads files of other kinds, such as gaits; it returns None
    for a sequence file.
    """

    files: tuple[Path, ...] = ()
    is_offset: bool = False
    read_other: Callable[[Path, Robot], Sequence | None] | None = None

    def inside(self, path: Path) -> FileContext:
        """Return the context of the files that `path` includes."""
        return replace(self, files=(*self.files, path.resolve()))

    def other(self, path: Path, robot: Robot | None) -> Sequence | None:
        """Return the sequence of a file of another kind; None for a sequence file."""
        if self.read_other is None or robot is None:
            return None
        sequence = self.read_other(path, robot)
        if sequence is not None and self.is_offset:
            raise InputError("gives joint positions, so it cannot be added to others", path=path)
        return sequence


@dataclass(slots=True)
class PartLoader:
    """Loads the parts of one file.

    `problems` are those of this file, `errors` those of the files of its parts.
    """

    content: SequenceFile
    left_out: frozenset[Location]
    source: YamlSource
    robot: Robot | None
    part: FileContext
    load: Callable[[Path, Robot | None, FileContext], Sequence]
    problems: list[Mistake] = field(default_factory=list)
    errors: list[InputError] = field(default_factory=list)

    def steps(self) -> tuple[PlaylistStep, ...]:
        """Return the steps of the play list; steps with problems are left out."""
        steps: list[PlaylistStep] = []
        total = 0
        for index, entry in enumerate(self.content.play):
            place: Location = ("play", index)
            if place in self.left_out or (step := self._step(entry, place)) is None:
                continue
            total += expanded(step)
            if total > EXPANDED_MAX:
                key = "times" if step.times > 1 else "file"
                self._note((*place, key), f"{key}: {expanded_text(total)}")
                break
            if entry.join == "through" and not self.problems and not self.errors:
                self._join(steps, step, place)
            else:
                steps.append(step)
        if sum(map(_count, steps)) > PLAY_STEPS_MAX:
            self._note(
                ("play",), f"comes to more than {PLAY_STEPS_MAX} steps, nested ones included"
            )
        return tuple(steps)

    def layers(self) -> tuple[Layer, ...]:
        """Return the layers; those that are muted or have problems are left out."""
        found = []
        for index, entry in enumerate(self.content.layers):
            place: Location = ("layers", index)
            if place in self.left_out:
                continue
            layer = self._layer(entry, place)
            if layer is not None and not entry.mute:
                found.append(layer)
        return tuple(found)

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _step(self, entry: StepEntry, place: Location) -> PlaylistStep | None:
        given = entry.given
        kinds = [kind for kind in ("file", "pause_s", "wait_for") if kind in given]
        if len(kinds) != 1:
            self._note(place, "a step is a 'file', a 'pause_s' or a 'wait_for'")
            return None
        if entry.wait_for is None and "timeout_s" in given:
            self._note((*place, "timeout_s"), "timeout_s belongs to a wait_for")
        if entry.wait_for is None and "idle" in given:
            self._note((*place, "idle"), "idle belongs to a wait_for")
        if entry.file is None:
            if extra := sorted(given - {"pause_s", "wait_for", "timeout_s", "idle"}):
                self._note((*place, extra[0]), f"{extra[0]} belongs to a file")
            if entry.wait_for is None:
                return PlaylistStep(pause_s=entry.pause_s or 0.0)
            step = self._wait(entry.wait_for, entry.timeout_s, place)
            if step is None or entry.idle is None:
                return step
            idle = self._idle(entry, entry.idle, place)
            return None if idle is None else replace(step, sequence=idle)
        sequence = self._file(entry.file, entry, place, is_offset=self.part.is_offset)
        if sequence is None:
            return None
        if _is_endless(sequence):
            self._note(
                (*place, "file"),
                f"{entry.file} loops forever, so that nothing could follow; give its loop a count",
            )
        return PlaylistStep(sequence=sequence, times=entry.times, move_s=entry.move_s)

    def _idle(self, entry: StepEntry, name: str, place: Location) -> Sequence | None:
        """Return the idle motion of a wait: one pass of a file that loops forever."""
        sequence = self._file(name, entry, place, is_offset=self.part.is_offset, key="idle")
        if sequence is None:
            return None
        if sequence.loop is None:
            sequence = replace(sequence, loop=1)
        reason = ""
        if _is_endless(sequence):
            reason = (
                "has tracks that loop forever; give each loop a count: all are repeated together"
            )
        elif _has_events(sequence):
            reason = "has events, which cannot be repeated while the show waits; leave them out"
        elif _waits(sequence):
            reason = "waits itself; leave that out"
        if reason:
            self._note((*place, "idle"), f"{name} {reason}")
        return sequence

    def _wait(
        self, entry: WaitEntry, timeout_s: float | None, place: Location
    ) -> PlaylistStep | None:
        if self.robot is None:
            return None
        place = (*place, "wait_for")
        sensor = self.robot.sensors.get(entry.sensor)
        if sensor is None:
            known = known_names(entry.sensor, self.robot.sensors)
            reason = f"robot {self.robot.name!r} has no sensor {entry.sensor!r}; {known}"
            self._note((*place, "sensor"), reason)
            return None
        keys = list(entry.given - {"sensor"})
        allowed = (f"below_{sensor.unit}", f"above_{sensor.unit}")
        if len(keys) != 1 or keys[0] not in allowed:
            reason = (
                f"a sensor of kind {sensor.kind} needs one of {allowed[0]!r} and {allowed[1]!r}"
            )
            self._note(place, reason)
            return None
        side: Literal["below", "above"] = "below" if keys[0].startswith("below") else "above"
        threshold = float(getattr(entry, keys[0]))
        wait = Wait(sensor=sensor.name, side=side, threshold=threshold, timeout_s=timeout_s)
        return PlaylistStep(wait=wait)

    def _layer(self, entry: LayerEntry, place: Location) -> Layer | None:
        is_offset = entry.mode == "add"
        sequence = self._file(entry.file, entry, place, is_offset=is_offset)
        if sequence is None or self.robot is None:
            return None
        if entry.to_s is not None and entry.to_s <= entry.from_s:
            self._note((*place, "to_s"), f"{entry.to_s:g} s is not after from_s {entry.from_s:g} s")
        joints: list[str] = []
        for number, name in enumerate(entry.joints or ()):
            known = [*self.robot.joints, *self.robot.groups]
            if name not in known:
                reason = f"unknown joint or group {name!r}; {known_names(name, known)}"
                self._note((*place, "joints", number), reason)
            joints += self.robot.groups.get(name, (name,))
        keyed = keyed_joints(sequence)
        if entry.keep is not None:
            sequence = keeping(sequence, is_time=entry.keep == "time")
        if joints and not keyed & {*joints}:
            self._note((*place, "joints"), f"{entry.file} keys none of them")
        return Layer(
            sequence=sequence,
            joints=tuple(name for name in self.robot.joints if name in (joints or keyed)),
            mode=entry.mode,
            weight=entry.weight,
            from_s=entry.from_s,
            to_s=entry.to_s,
            fade_s=entry.fade_s,
            line=self.source.line(place),
        )

    def _file(
        self,
        name: str,
        entry: StepEntry | LayerEntry,
        place: Location,
        *,
        is_offset: bool,
        key: str = "file",
    ) -> Sequence | None:
        path = self.source.path.parent / name
        if path.resolve() in self.part.files:
            self._note((*place, key), f"{name} would play itself without end")
            return None
        if not path.exists():
            self._note((*place, key), f"sequence file {name!r} not found; looked for {path}")
            return None
        if self.robot is None:
            return None
        try:
            sequence = self.load(path, self.robot, replace(self.part, is_offset=is_offset))
            if entry.mirror:
                sequence = mirrored(sequence, self.robot.mirror)
                check_sequence(sequence, self.robot, is_offset=is_offset)
            sequence = replace(sequence, speed_ratio=sequence.speed_ratio * entry.speed_ratio)
            at_speed(sequence)
        except InputError as error:
            self.errors.append(error)
            return None
        return sequence

    def _join(self, steps: list[PlaylistStep], step: PlaylistStep, place: Location) -> None:
        """Append the keyframes of `step` to those of the step before."""
        before = steps[-1] if steps else PlaylistStep()
        parts = [part.sequence for part in (before, step) if _is_plain(part)]
        if len(parts) < 2:
            self._note(
                (*place, "join"),
                "join: through needs keyframes with times, played once and without tracks or "
                "layers, in this step and the one before",
            )
            return
        first, second = (at_speed(part) for part in parts if part is not None)
        last = [frame for frame in first.keyframes if frame.at_s == first.keyframes[-1].at_s]
        end_s = max((frame.at_s or 0.0) + frame.hold_s for frame in last) + (step.move_s or 0.0)
        shifted = [replace(frame, at_s=(frame.at_s or 0.0) + end_s) for frame in second.keyframes]
        for reason in jumps_between(last, [f for f in shifted if f.at_s == shifted[0].at_s]):
            self._note((*place, "join"), f"{reason}; or give move_s")
        joined = replace(
            first,
            keyframes=(*first.keyframes, *shifted),
            keeps_time=first.keeps_time | second.keeps_time,
        )
        steps[-1] = replace(before, sequence=joined)


def expanded(part: PlaylistStep | Sequence) -> int:
    """Return how many keyframes a part comes to, with every pass and repetition written out."""
    if isinstance(part, PlaylistStep):
        return part.times * expanded(part.sequence) if part.sequence is not None else 0
    own = len(part.keyframes) + sum(map(expanded, part.play))
    beside = sum(map(expanded, (*part.tracks, *(layer.sequence for layer in part.layers))))
    return (part.loop or 1) * own + beside


def expanded_text(count: int) -> str:
    """Return why a part that comes to so many keyframes is refused."""
    return (
        f"comes to {count:,} keyframes with all its repetitions, at most {EXPANDED_MAX:,} can be "
        f"played as a part; repeat it less often, or loop the file that is played: that is "
        f"compiled once"
    )


def keyed_joints(sequence: Sequence) -> set[str]:
    """Return every joint that the sequence or a part of it keys."""
    inner = [*sequence.tracks, *(step.sequence for step in sequence.play if step.sequence)]
    names = {name for frame in sequence.keyframes for name in frame.deg}
    return names.union(*map(keyed_joints, inner), *(layer.joints for layer in sequence.layers))


def time_keepers(sequence: Sequence) -> set[str]:
    """Return every joint that the sequence or a part of it moves and that keeps its time."""
    inner = [*sequence.tracks, *(step.sequence for step in sequence.play if step.sequence)]
    above = (time_keepers(layer.sequence) & {*layer.joints} for layer in sequence.layers)
    return {*sequence.keeps_time}.union(*map(time_keepers, inner), *above)


def _is_endless(sequence: Sequence) -> bool:
    return sequence.loop is None or (
        not sequence.keyframes and any(track.loop is None for track in sequence.tracks)
    )


def _has_events(sequence: Sequence) -> bool:
    parts = [*sequence.tracks, *(layer.sequence for layer in sequence.layers)]
    parts += [step.sequence for step in sequence.play if step.sequence is not None]
    return bool(sequence.events) or any(map(_has_events, parts))


def _waits(sequence: Sequence) -> bool:
    inner = [step.sequence for step in sequence.play if step.sequence is not None]
    return any(step.wait is not None for step in sequence.play) or any(map(_waits, inner))


def _is_plain(step: PlaylistStep) -> bool:
    sequence = step.sequence
    return (
        sequence is not None
        and step.times == 1
        and sequence.loop == 1
        and sequence.timing is Timing.AUTHORED
        and bool(sequence.keyframes)
        and not sequence.tracks
        and not sequence.layers
    )


def _count(step: PlaylistStep) -> int:
    return 1 + sum(map(_count, step.sequence.play)) if step.sequence else 1
