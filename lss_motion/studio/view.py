"""The view of a plan: everything that the pages show of a planned show, as JSON.

`view_of` is a function of the show alone, so a view belongs to its plan for ever and can be kept by
its hash. Times are those of the written program: show time, except that
a part that is played again and again is in it once (`repeat`). Numbers that are many are base64 of
little-endian arrays (`view_curves.packed`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.model import LoopedSpan, PathMotion
from lss_motion.planning.trajectory.playlist import PlayListPass, all_cues, all_marks
from lss_motion.planning.trajectory.tracks import ParallelPass
from lss_motion.robot.mechanisms import limits_along
from lss_motion.studio.view_curves import (
    ACCEL_RATIO,
    SPEED_RATIO,
    Curve,
    Samples,
    Tolerance,
    between,
    fitted,
    packed,
)
from lss_motion.studio.view_horns import horn_curves
from lss_motion.units import NS_PER_US, US_PER_S, line_time_ns, s_from_us

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.shows import Show
    from lss_motion.planning.trajectory.model import Mark, Pass, PathClock, Trajectory
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Cue, Keyframe, Layer, Sequence

    FloatArray = NDArray[np.float64]
    PeaksOf = Callable[[Path], "Peaks"]

VIEW_VERSION: Final = 1
INSIDE: Final = 3
"""Samples between two knots of a plan. Chosen: a cubic that fits there fits everywhere."""

KNOTS_MAX: Final = 60_000
"""Of more knots, instants at equal steps are taken: 10 ms apart in ten minutes."""

LINE_STEPS_MAX: Final = 2000
LINE_STEP_MIN_S: Final = 0.1
"""The use of a line is given for steps of at least this. It is the span that
`planning.program.line.WORST_WINDOW_US` judges."""

SAME_S: Final = 1e-6
AUTHORED_STEP_S: Final = 0.02
PEAKS_HZ: Final = 50.0
"""Columns of a waveform in a second. Chosen: 60 kB for ten minutes."""

PEAKS_AT_ONCE: Final = 500


class Peaks(Struct, frozen=True):
    """The least and largest sample of each step of a sound, as int8 pairs."""

    rate_hz: float
    duration_s: float
    pairs: NDArray[np.int8]


def view_of(show: Show, plan: str, peaks_of: PeaksOf | None = None) -> dict[str, Any]:
    """Return the view of a show that was planned from its file, ready for JSON.

    `plan` is the hash of its program. `peaks_of` reads a sound in place of `sound_peaks`; a sound
    that cannot be read has an `error` instead of its peaks.
    """
    sequence, trajectory, program, robot = show.sequence, show.trajectory, show.program, show.robot
    assert sequence is not None, "a program that was compiled before has no keys"
    assert trajectory is not None, "the same"
    window = ViewWindow(program)
    lanes = lanes_of(sequence, trajectory, window)
    horn = horn_curves(program, robot, window.end_s)
    motion = _motion_curves(trajectory, robot, window, _knot_keys(lanes))
    authored = _authored_curves(trajectory, window)
    return {
        "version": VIEW_VERSION,
        "plan": plan,
        "name": program.name,
        "robot": program.robot,
        "duration_s": None if program.is_endless else program.duration_s,
        "view_s": window.end_s,
        "is_endless": program.is_endless,
        "repeat": window.repeat,
        "tolerance_deg": program.tolerance_deg,
        "joints": [_joint(robot, name, program) for name in trajectory.joints],
        "lanes": lanes,
        "parts": window.spans(_parts(trajectory)),
        "events": _events(trajectory, program, window),
        "beats": [
            at_s for beat_s in sequence.beats_s if (at_s := window.written(beat_s)) is not None
        ],
        "marks": [
            {"label": mark.label, "at_s": at_s, "is_anchor": mark.is_anchor}
            for mark in program.marks
            if mark.label and (at_s := window.written(mark.planned_s)) is not None
        ],
        "curves": {
            name: {
                "plan": motion[name].as_json(),
                "predicted": horn[name].as_json(),
                "authored": authored[name].as_json() if name in authored else None,
            }
            for name in trajectory.joints
        },
        **_departures(trajectory, window),
        "error": {name: _largest_error(motion[name], horn[name]) for name in trajectory.joints},
        "line": _line_use(program, robot, window),
        "waveforms": _waveforms(trajectory, window, peaks_of or sound_peaks),
    }


def _departures(trajectory: Trajectory, window: ViewWindow) -> dict[str, list[dict[str, Any]]]:
    """Return where and why the plan is not what the author asks for."""
    return {
        "stretched": window.spans(
            {
                "from_s": span.from_s,
                "to_s": span.to_s,
                "by_s": span.by_s,
                "joint": span.joint,
                "limit": span.limit,
                "text": span.text,
            }
            for span in trajectory.stretched
        ),
        "given_up": window.spans(
            {
                "from_s": span.from_s,
                "to_s": span.to_s,
                "at_s": span.at_s,
                "deg": span.by_deg,
                "joint": span.joint,
                "text": span.text,
            }
            for span in trajectory.given_up
        ),
        "asked": window.spans(
            {
                "from_s": span.from_s,
                "to_s": span.to_s,
                "joint": span.joint,
                "deg": packed(np.array(span.deg), "<f4"),
            }
            for span in trajectory.asked
        ),
    }


class ViewWindow:
    """What of a show is in its view: the written program, from 0 to `end_s`."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self.end_s = program.pass_s
        own = program.repeat
        self._times = None if own is None else own.times
        self._added_s = 0.0 if own is None or own.times is None else s_from_us(own.added_us)
        self._to_s = math.inf if own is None else s_from_us(own.to_us)
        self.repeat = own and {
            "from_s": s_from_us(own.from_us),
            "to_s": self._to_s,
            "times": own.times,
        }

    def shown(self, times_s: FloatArray) -> FloatArray:
        """Return the show times of instants of the view, in which the last time is played."""
        return times_s + np.where(times_s >= self._to_s - SAME_S, self._added_s, 0.0)

    @property
    def show_end_s(self) -> float:
        """The show time of the end of the view."""
        return self.end_s + self._added_s

    def written(self, show_s: float) -> float | None:
        """Return where an instant of the show stands in the view; None: in a pass not written."""
        if show_s <= self._to_s + SAME_S:
            return show_s if show_s <= self.end_s + SAME_S else None
        if self._times is None:
            return None
        found = show_s - self._added_s
        return found if found >= self._to_s - SAME_S else None

    def spans(self, spans: Iterator[dict[str, Any]] | list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return spans with their times in the view; those of passes not written are left out."""
        found = []
        for span in spans:
            from_s = self.written(span["from_s"])
            if from_s is not None:
                by_s = from_s - span["from_s"]
                moved = {key: span[key] + by_s for key in ("from_s", "to_s", "at_s") if key in span}
                found.append(span | moved)
        return sorted(found, key=lambda span: span["from_s"])


# ---------------------------------------------------------------------------- lanes


class LaneOf(NamedTuple):
    """What a lane holds. Keys of one that is `added` are added to the angles of the others."""

    kind: str
    name: str
    path: Path | None
    is_added: bool = False


def lanes_of(
    sequence: Sequence, trajectory: Trajectory, window: ViewWindow
) -> list[dict[str, Any]]:
    """Return a lane for the keyframes of the show, of each track, layer and part of a play list."""
    lanes: dict[LaneOf, list[tuple[Keyframe, Mark, float]]] = {}
    for lane, keyed in _keyed(sequence, trajectory, window.show_end_s):
        lanes.setdefault(lane, []).extend(keyed)
    made = []
    for lane, keyed in lanes.items():
        # The instant at which a repeated part ends is in the show twice, and in the view once.
        different = {
            (round(key["at_s"], 6), frame.place, *key["deg"]): key
            for frame, mark, start_s in keyed
            for key in _keys(frame, mark, start_s, window)
            if key["at_s"] is not None
        }
        keys = sorted(different.values(), key=lambda key: float(key["at_s"]))
        joints = dict.fromkeys(joint for key in keys for joint in key["deg"])
        made.append(
            {
                "name": lane.name,
                "kind": lane.kind,
                "file": _file_of(lane.path or sequence.path, sequence.path),
                "is_added": lane.is_added,
                "joints": list(joints),
                "keys": keys,
            }
        )
    return made


def _file_of(path: Path | None, show: Path | None) -> str:
    """Return a file as the show names it: from its own folder, if it is there."""
    if path is None or show is None:
        return ""
    folder = show.resolve().parent
    full = path.resolve()
    return str(full.relative_to(folder) if full.is_relative_to(folder) else path)


def _keys(
    frame: Keyframe, mark: Mark, start_s: float, window: ViewWindow
) -> Iterator[dict[str, Any]]:
    """Yield a keyframe as one key; as two, where only some of its joints keep their time."""
    kept = set(mark.kept) if not mark.is_kept and mark.authored_s is not None else set()
    for names, at_s in (
        ([name for name in frame.deg if name not in kept], mark.planned_s),
        ([name for name in frame.deg if name in kept], mark.authored_s),
    ):
        if names and at_s is not None:
            yield {
                "at_s": window.written(start_s + at_s),
                "authored_s": None if mark.authored_s is None else start_s + mark.authored_s,
                "hold_s": mark.held_s,
                "is_anchor": frame.is_anchor,
                "label": frame.label,
                "ease": str(frame.ease),
                "line": frame.line,
                "place": frame.place,
                "deg": {name: round(frame.deg[name], 4) for name in names},
                "slope_deg_s": {n: one for n, one in frame.slope_deg_s.items() if n in names},
            }


def _keyed(
    sequence: Sequence, trajectory: Trajectory, end_s: float
) -> Iterator[tuple[LaneOf, list[tuple[Keyframe, Mark, float]]]]:
    """Yield a lane with its keyframes: each with its mark and what is added to its times.

    Keyframes and marks of one track are in the same order.
    """
    if sequence.layers:
        yield from _summed_keys(sequence, trajectory)
    elif sequence.play:
        yield from _played_keys(trajectory, end_s)
    elif sequence.tracks:
        own = [replace(sequence, tracks=())] if sequence.keyframes else []
        parts = trajectory.first.parts
        for track, part in zip([*own, *sequence.tracks], parts, strict=True):
            lane = LaneOf("track", track.name, track.path)
            yield lane, _in_passes(track.keyframes, part, end_s)
    else:
        lane = LaneOf("track", sequence.name, sequence.path)
        yield lane, _in_passes(sequence.keyframes, trajectory, end_s)


def _in_passes(
    keyframes: tuple[Keyframe, ...], trajectory: Trajectory, end_s: float
) -> list[tuple[Keyframe, Mark, float]]:
    """Return the keyframes of one track in every pass that begins before `end_s`."""
    numbered = replace(
        trajectory,
        marks=tuple(replace(mark, label=str(n)) for n, mark in enumerate(trajectory.marks)),
    )
    return [
        (keyframes[int(mark.label)], mark, 0.0)
        for mark in all_marks(numbered, end_s)
        if mark.planned_s <= end_s + SAME_S
    ]


def _played_keys(
    trajectory: Trajectory, end_s: float
) -> Iterator[tuple[LaneOf, list[tuple[Keyframe, Mark, float]]]]:
    """Yield the keyframes of the parts of a play list, each where it is played."""
    for pass_s in _pass_starts(trajectory, end_s):
        whole = trajectory.first
        assert isinstance(whole, PlayListPass)
        for part, own, from_s in zip(
            whole.parts, whole.sequences, whole.starts_s.tolist(), strict=True
        ):
            if own is None:
                continue
            for lane, keyed in _keyed(own, part, part.duration_s):
                start_s = pass_s + from_s
                moved = [(frame, mark, at_s + start_s) for frame, mark, at_s in keyed]
                yield lane._replace(kind="part"), moved


def _pass_starts(trajectory: Trajectory, end_s: float) -> Iterator[float]:
    index = 0
    while trajectory.loop is None or index < trajectory.loop:
        if (start_s := trajectory.pass_start_s(index)) >= end_s - SAME_S and index:
            return
        yield start_s
        index += 1


def _summed_keys(
    sequence: Sequence, trajectory: Trajectory
) -> Iterator[tuple[LaneOf, list[tuple[Keyframe, Mark, float]]]]:
    """Yield the keyframes of a show and its layers, in all passes, where the sum reaches them."""
    clock = _clock_of(trajectory.first)
    layers = [None, *sequence.layers]
    for layer, own in zip(layers, trajectory.summands, strict=True):
        part = replace(sequence, layers=()) if layer is None else layer.sequence
        for lane, keyed in _keyed(part, own.trajectory, own.to_s - own.from_s):
            if layer is not None:
                lane = lane._replace(kind="layer", is_added=layer.mode == "add")  # noqa: PLW2901
            placed = [(frame, mark.later(own.from_s + start_s)) for frame, mark, start_s in keyed]
            yield (
                lane,
                [
                    (_narrowed(frame, layer), _reached(mark, clock), 0.0)
                    for frame, mark in placed
                    if mark.planned_s <= own.to_s + SAME_S
                ],
            )


def _narrowed(frame: Keyframe, layer: Layer | None) -> Keyframe:
    """Return a keyframe with the joints that its layer has."""
    if layer is None:
        return frame
    return replace(frame, deg={name: frame.deg[name] for name in frame.deg if name in layer.joints})


def _clock_of(motion: Pass) -> PathClock:
    """Return the clock of a sum: of its joints that do not keep their time, if some do."""
    while not isinstance(motion, PathMotion):
        motion = motion.parts[0].first
    return motion.clock


def _reached(mark: Mark, clock: PathClock) -> Mark:
    """Return a mark of what is added up where the sum reaches and leaves it."""
    if mark.is_kept:
        return mark
    ends_s = clock.times_of(np.array([mark.planned_s, mark.planned_s + mark.held_s])).tolist()
    return replace(mark, planned_s=ends_s[0], held_s=ends_s[1] - ends_s[0])


def _knot_keys(lanes: list[dict[str, Any]]) -> dict[str, FloatArray]:
    """Return the instants of each joint at which its motion begins another cubic."""
    found: dict[str, list[float]] = defaultdict(list)
    for lane in lanes:
        for key in lane["keys"]:
            for name in key["deg"]:
                found[name] += [key["at_s"], key["at_s"] + key["hold_s"]]
    return {name: np.array(sorted(times_s)) for name, times_s in found.items()}


def _parts(trajectory: Trajectory) -> list[dict[str, Any]]:
    whole = trajectory.first
    if not isinstance(whole, PlayListPass):
        return []
    return [
        {"name": part.name, "from_s": from_s, "to_s": from_s + part.duration_s}
        for part, from_s in zip(whole.parts, whole.starts_s.tolist(), strict=True)
    ]


# --------------------------------------------------------------------------- curves


def _motion_curves(
    trajectory: Trajectory, robot: Robot, window: ViewWindow, keys_s: Mapping[str, FloatArray]
) -> dict[str, Curve]:
    """Return the planned motion of each joint."""
    knots_s = np.unique(
        [
            0.0,
            window.end_s,
            *(
                at_s
                for knot_s in trajectory.knots_until(window.show_end_s).tolist()
                if (at_s := window.written(knot_s)) is not None and 0.0 < at_s < window.end_s
            ),
        ]
    )
    if len(knots_s) > KNOTS_MAX:
        knots_s = np.linspace(0.0, window.end_s, KNOTS_MAX)
    times_s, is_knot = between(knots_s, INSIDE)
    deg, deg_s, deg_s2 = (trajectory.sample(window.shown(times_s), order) for order in (0, 1, 2))
    deg_s2[is_knot] = np.nan  # There it may jump.
    curves = {}
    for column, name in enumerate(trajectory.joints):
        joint = robot.joints[name]
        curves[name] = fitted(
            Samples(times_s, deg[:, column], deg_s[:, column], deg_s2[:, column]),
            keys_s.get(name, np.zeros(0)),
            Tolerance(
                deg_s=SPEED_RATIO * joint.speed_max_deg_s,
                deg_s2=ACCEL_RATIO * joint.accel_max_deg_s2,
            ),
        )
    return curves


def _authored_curves(trajectory: Trajectory, window: ViewWindow) -> dict[str, Curve]:
    """Return the motion at the author's own times, for plans that are slowed somewhere."""
    if not trajectory.stretched:
        return {}
    count = min(KNOTS_MAX, max(2, math.ceil(window.end_s / AUTHORED_STEP_S)))
    times_s = np.linspace(0.0, window.end_s, count + 1)
    shown_s = window.shown(times_s)
    deg, deg_s = (_authored(trajectory, shown_s, order) for order in (0, 1))
    nothing = np.full(len(times_s), np.nan)
    found = {
        name: Samples(times_s, deg[:, column], deg_s[:, column], nothing)
        for column, name in enumerate(trajectory.joints)
    }
    return {name: fitted(own, np.zeros(0), Tolerance(deg=0.1)) for name, own in found.items()}


def _authored(trajectory: Trajectory, times_s: FloatArray, order: int) -> FloatArray:
    """Return deg or deg/s of every joint as if no pass were slowed; it waits at the end of each."""
    values = np.zeros((len(times_s), len(trajectory.joints)))
    starts_s = np.array([*_pass_starts(trajectory, float(times_s[-1]) + SAME_S)])
    passes = np.searchsorted(starts_s, times_s + SAME_S, side="right") - 1
    for index in np.unique(passes).tolist():
        rows = np.flatnonzero(passes == index)
        motion = trajectory.motion_of(index)
        values[rows] = _authored_pass(motion, times_s[rows] - starts_s[index], order)
    return values


def _authored_pass(motion: Pass, times_s: FloatArray, order: int) -> FloatArray:
    """Return the motion of one pass at the author's times, which are its path positions."""
    if isinstance(motion, PathMotion):
        path_s = motion.path.knots_s[0] + np.clip(times_s, 0.0, motion.path.length_s)
        return motion.path.slopes(path_s)[0] if order else motion.path.evaluate(path_s)
    if isinstance(motion, LoopedSpan):
        return _authored(motion.whole, motion.from_s + np.maximum(times_s, 0.0), order)
    values = motion.sample(times_s, order)
    if isinstance(motion, ParallelPass):
        for part in motion.parts:
            columns = [motion.joints.index(name) for name in part.joints]
            values[:, columns] = _authored(part, motion.from_s + np.maximum(times_s, 0.0), order)
    elif isinstance(motion, PlayListPass):
        chosen = np.clip(np.searchsorted(motion.starts_s, times_s, side="right") - 1, 0, None)
        for index in np.unique(chosen).tolist():
            part, rows = motion.parts[index], np.flatnonzero(chosen == index)
            place = np.ix_(rows, np.array([motion.joints.index(name) for name in part.joints]))
            local_s = np.clip(times_s[rows] - motion.starts_s[index], 0.0, part.duration_s)
            values[place] = _authored(part, local_s, order)
    return values


def _largest_error(motion: Curve, horn: Curve) -> dict[str, float]:
    """Return the largest distance of the predicted horn from the plan, and when it is there."""
    times_s, _ = between(np.unique(np.concatenate([motion.times_s, horn.times_s])), INSIDE)
    error_deg = np.abs(horn.at(times_s) - motion.at(times_s))
    worst = int(np.argmax(error_deg))
    return {"max_deg": round(float(error_deg[worst]), 4), "at_s": float(times_s[worst])}


# ------------------------------------------------------------ joints, events, line, sound


def _joint(robot: Robot, name: str, program: Program) -> dict[str, Any]:
    joint = robot.joints[name]
    behind = (one.servos[0] for one in robot.mechanisms.values() if name in one.joints)
    servo = next(behind, name)
    deg, speed_deg_s, accel_deg_s2 = limits_along(robot, name)
    return {
        "name": joint.name,
        "id": joint.servo_id,
        "bus": joint.bus,
        "servo": joint.model.name,
        "range_deg": [joint.position_min_deg, joint.position_max_deg],
        "speed_max_deg_s": joint.speed_max_deg_s,
        "accel_max_deg_s2": joint.accel_max_deg_s2,
        "limits": {
            "deg": deg.tolist(),
            "speed_deg_s": speed_deg_s.tolist(),
            "accel_deg_s2": accel_deg_s2.tolist(),
        },
        "drive": program.drives[servo].drive if servo in program.drives else "timed",
        "temperature_max_c": joint.temperature_max_c,
        "voltage_min_v": joint.voltage_min_v,
        "following_deg": joint.following_deg,
    }


def _events(trajectory: Trajectory, program: Program, window: ViewWindow) -> list[dict[str, Any]]:
    """Return cues and waits in order of time."""
    found = [
        {
            "at_s": at_s,
            "kind": _kind(cue),
            "text": cue.text,
            "line": cue.line,
            "lasts_s": cue.style.lasts_s if cue.sound else None,
        }
        for cue in all_cues(trajectory, window.show_end_s)
        if (at_s := window.written(cue.at_s)) is not None
    ]
    found += [
        {
            "at_s": at_s,
            "kind": "wait",
            "text": f"{point.wait.sensor} {point.wait.side} {point.wait.threshold:g}",
            "line": None,
            "lasts_s": None,
        }
        for point in program.waits
        if (at_s := window.written(point.at_s)) is not None
    ]
    return sorted(found, key=lambda event: float(event["at_s"] or 0.0))


def _kind(cue: Cue) -> str:
    return "led" if cue.led else "say" if cue.say else "run" if cue.run else "sound"


def _line_use(program: Program, robot: Robot, window: ViewWindow) -> dict[str, Any]:
    """Return for each bus which share of each step commands take, and its reading rate."""
    step_s = max(LINE_STEP_MIN_S, window.end_s / LINE_STEPS_MAX)
    count = max(1, math.ceil(window.end_s / step_s))
    busy_us: dict[str, FloatArray] = {bus: np.zeros(count) for bus in program.line_use}
    for move in program.moves:
        index = math.floor(move.due_us / US_PER_S / step_s)
        size_us = line_time_ns(len(move.data), robot.buses[move.bus].baud_bps) / NS_PER_US
        busy_us[move.bus][min(max(index, 0), count - 1)] += size_us
    return {
        bus: {
            "step_s": step_s,
            "use_ratio": packed(busy_us[bus] / (step_s * US_PER_S), "<f4"),
            "baud_bps": use.baud_bps,
            "commands": use.commands,
            "mean_ratio": use.utilisation_ratio,
            "worst_100_ms_ratio": use.worst_100_ms_ratio,
            "reading_rate_hz": use.reading_rate_hz if math.isfinite(use.reading_rate_hz) else None,
            "reading_rate_min_hz": robot.buses[bus].reading_rate_min_hz,
        }
        for bus, use in program.line_use.items()
    }


def _waveforms(
    trajectory: Trajectory, window: ViewWindow, peaks_of: PeaksOf
) -> list[dict[str, Any]]:
    """Return the peaks of each sound where it sounds: seconds of the show, not of the file."""
    found = []
    for cue in all_cues(trajectory, window.show_end_s):
        at_s = window.written(cue.at_s)
        if not cue.sound or at_s is None:
            continue
        entry: dict[str, Any] = {"text": cue.text, "from_s": at_s, "is_bed": cue.style.is_bed}
        try:
            peaks = peaks_of(Path(cue.sound))
        except InputError as error:
            found.append(entry | {"to_s": at_s, "error": str(error)})
            continue
        speed = cue.style.speed_ratio
        lasts_s = peaks.duration_s / speed
        if cue.style.lasts_s is not None:
            lasts_s = cue.style.lasts_s if cue.style.is_looped else min(lasts_s, cue.style.lasts_s)
        found.append(
            entry
            | {
                "to_s": min(at_s + lasts_s, window.end_s),
                "is_looped": cue.style.is_looped,
                "rate_hz": peaks.rate_hz * speed,
                "peaks": packed(peaks.pairs, "i1"),
            }
        )
    return found


def sound_peaks(path: Path) -> Peaks:
    """Read the peaks of a sound file; raises `InputError` if it cannot be read."""
    from lss_motion.sound.files import SoundReader

    with SoundReader(path) as reader:
        info = reader.info
        step = max(1, round(info.rate_hz / PEAKS_HZ))
        pairs = []
        for frame in range(0, info.frames, step * PEAKS_AT_ONCE):
            piece = reader.read_at(frame, step * PEAKS_AT_ONCE).mean(axis=1)
            piece = np.pad(piece, (0, -len(piece) % step), mode="edge").reshape(-1, step)
            pairs.append(np.stack([piece.min(axis=1), piece.max(axis=1)], axis=1))
        found = np.clip(np.concatenate(pairs), -1.0, 1.0)
        whole = np.round(127.0 * found).astype(np.int8)
        return Peaks(info.rate_hz / step, info.duration_s, whole)
