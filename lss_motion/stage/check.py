"""Plans every show of a stage, and finds what does not go together.

A stage can be played only if each of its shows can be planned. What else an author would not
expect in the evening is a finding: it is printed, and stops nothing.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, LssMotionError, PlanningError
from lss_motion.files.texts import counted, duration_text, known_names
from lss_motion.planning import shows
from lss_motion.playing.player.added_show import why_not_beside
from lss_motion.playing.player.following import require_can_follow
from lss_motion.show.functions import modules_of
from lss_motion.stage.log import why_not_writable
from lss_motion.stage.model import TriggerKind

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from lss_motion.planning.shows import ReadRobot, Show
    from lss_motion.show.functions import ModuleSource
    from lss_motion.stage.model import CueTrigger, Stage


class StageFinding(Struct, frozen=True):
    """What an author may not expect, and the line of the stage file."""

    line: int | None
    text: str


class Planned(Struct, frozen=True, kw_only=True):
    """A stage with its shows planned and compiled, by name; with figures, those of one."""

    stage: Stage
    shows: Mapping[str, Show]

    @property
    def functions(self) -> tuple[str, ...]:
        """The Python functions that shows call."""
        cues = (cue for show in self.shows.values() for cue in show.program.cues)
        return tuple(dict.fromkeys(cue.run for cue in cues if cue.run))

    @property
    def modules(self) -> tuple[ModuleSource, ...]:
        """What lies beside the shows and is run for these functions, as it is now."""
        return modules_of(cue for show in self.shows.values() for cue in show.program.cues)


def plan_stage(
    stage: Stage, read_robot: ReadRobot | None = None, *, figure: str | None = None
) -> Planned:
    """Return the stage with its shows planned; with figures, those of `figure`.

    The idle show loops where it ends as it begins. Raises one error for all shows that cannot be
    played: `InputError`, or `PlanningError` if all files are right.
    """
    robot_path = _robot_path(stage, figure)
    planned: dict[str, Show] = {}
    errors: list[tuple[int | None, str, LssMotionError]] = []
    following = following_shows(stage)
    for entry in stage.shows.values():
        path = entry.paths.get(figure or "", entry.paths.get(""))
        if path is None:
            continue
        try:
            planned[entry.name] = plan_show(
                path,
                robot_path,
                read_robot,
                is_idle=entry.name == stage.idle,
                is_following=entry.name in following,
            )
            if entry.name in following:
                require_can_follow(planned[entry.name].program)
        except LssMotionError as error:
            errors.append((entry.line, entry.name, error))
    if stage.idle is not None:  # Without it they play where nothing else does.
        found = _alone(stage, planned)
        errors += [(f.line, "", InputError(f.text, path=stage.path, line=f.line)) for f in found]
    if errors:
        raise as_one(stage, errors)
    return Planned(stage=stage, shows=planned)


def _alone(stage: Stage, planned: Mapping[str, Show]) -> Iterator[StageFinding]:
    """Yield the cues that add a show which can only play alone."""
    for cue in stage.cues:
        for name in cue.shows if cue.start == "add" else ():
            if name in planned and (what := why_not_beside(planned[name].program)):
                text = (
                    f"cue {cue.name!r} adds {name!r}, which {what}: a show that does so plays only "
                    f"where no other one does; give the cue another start, such as terminate, or "
                    f"take that out of the show"
                )
                yield StageFinding(cue.line, text)


def following_shows(stage: Stage) -> set[str]:
    """Return the shows that may follow the timecode, which are planned with headroom."""
    if stage.sync.timecode is None:
        return set()
    return {name for cue in stage.cues if cue.follows and cue.start != "add" for name in cue.shows}


def plan_show(
    path: Path,
    robot_path: Path,
    read_robot: ReadRobot | None = None,
    *,
    is_idle: bool,
    is_following: bool = False,
) -> Show:
    """Return a show of a stage; an idle one loops where it ends as it begins."""
    if is_idle and not shows.is_program(path):
        try:
            sequence, robot = shows.load(path, robot_path, read_robot)
            if sequence.loop is not None:
                once = replace(sequence, loop=None)
                return shows.compiled(once, robot, is_following=is_following)
        except (InputError, PlanningError):
            pass  # Played as it is, again and again; its own errors are found below.
    return shows.prepare(path, robot_path, read_robot, is_following=is_following)


def _robot_path(stage: Stage, figure: str | None) -> Path:
    if stage.robot_path is not None:
        return stage.robot_path
    if figure is not None and figure in stage.figures:
        return stage.figures[figure].robot_path
    known = known_names(figure or "", stage.figures)
    raise InputError(f"the stage has figures; name one of them: {known}", path=stage.path)


def as_one(
    stage: Stage, errors: list[tuple[int | None, str, LssMotionError]]
) -> InputError | PlanningError:
    """Return one error; those of files keep their files and lines."""
    if not any(isinstance(error, InputError) for _, _, error in errors):
        texts = [f"{stage.path}:{line}: show {name!r}: {error}" for line, name, error in errors]
        return PlanningError("\n".join(texts))
    found = [
        error
        if isinstance(error, InputError)
        else InputError(f"show {name!r}: {error}", path=stage.path, line=line)
        for line, name, error in errors
    ]
    top, *others = found
    return InputError(top.reason, path=top.path, line=top.line, more=[*top.more, *others])


# ---- what an author may not expect


def findings(planned: Planned) -> list[StageFinding]:
    """Return what does not go together, in the order of the lines."""
    found = [*_endless(planned), *_never_added(planned), *_same_triggers(planned.stage)]
    found += [*_unused(planned.stage), *_never_enabled(planned.stage)]
    if (why := why_not_writable(planned.stage.log.folder)) is not None:
        found.append(StageFinding(None, f"the log of the stage cannot be written: {why}"))
    return sorted(found, key=lambda one: one.line or 0)


def _endless(planned: Planned) -> Iterator[StageFinding]:
    """Yield shows that never end: nothing that waits for their end would come."""
    stage = planned.stage
    for name, show in planned.shows.items():
        if name != stage.idle and show.program.is_endless:
            line = stage.shows[name].line
            text = (
                f"show {name!r} loops forever: it plays until a cue with terminate or interrupt "
                f"ends it, and queued shows wait for ever; give its loop a count"
            )
            yield StageFinding(line, text)


def _never_added(planned: Planned) -> Iterator[StageFinding]:
    """Yield shows that are to be added, but cannot be, or only where nothing else plays."""
    stage, idle = planned.stage, planned.stage.idle
    if idle is None:
        yield from _alone(stage, planned.shows)
    if idle is None or idle not in planned.shows:
        return
    moved = set(planned.shows[idle].program.start_deg)
    for cue in stage.cues:
        for name in cue.shows if cue.start == "add" else ():
            show = planned.shows.get(name)
            shared = [] if show is None else [j for j in show.program.start_deg if j in moved]
            if shared:
                text = (
                    f"cue {cue.name!r} adds {name!r}, which moves {', '.join(shared)}, as the idle "
                    f"show {idle!r} does: it plays only if nothing moves them"
                )
                yield StageFinding(cue.line, text)


def _same_triggers(stage: Stage) -> Iterator[StageFinding]:
    by_trigger: dict[CueTrigger, list[str]] = defaultdict(list)
    for cue in stage.cues:
        if cue.shows and cue.on.kind is not TriggerKind.GO:
            by_trigger[cue.on].append(cue.name)
    for cue in stage.cues:
        others = by_trigger[cue.on]
        if cue.name in others[1:] and cue.start == "only_if_idle":
            text = (
                f"cue {cue.name!r} has the trigger of {others[0]!r}, which comes first: it fires "
                f"only if that one cannot"
            )
            yield StageFinding(cue.line, text)


def _unused(stage: Stage) -> Iterator[StageFinding]:
    used = {name for cue in stage.cues for name in cue.shows} | {stage.idle, stage.duty.rest}
    for show in stage.shows.values():
        if show.name not in used:
            text = f"no cue plays {show.name!r}; an operator can"
            yield StageFinding(show.line, text)


def _never_enabled(stage: Stage) -> Iterator[StageFinding]:
    enabled = {name for cue in stage.cues for name in cue.enables}
    for cue in stage.cues:
        if not cue.is_enabled and cue.name not in enabled:
            yield StageFinding(cue.line, f"no cue enables {cue.name!r}; an operator can")


# ---- text


def stage_lines(planned: Planned) -> list[str]:
    """Return the shows, the cues and the findings of a stage, for people."""
    stage = planned.stage
    lines = [
        f"{stage.name}: {counted(stage.shows, 'show')}, {counted(stage.cues, 'cue')}"
        + ("" if stage.robot is None else f", robot {stage.robot.name}")
    ]
    width = max(len(name) for name in stage.shows)
    for name, show in planned.shows.items():
        joints = counted(show.program.start_deg, "joint")
        uses = [use.worst_100_ms_ratio for use in show.program.line_use.values()]
        line = f", line at most {max(uses):.0%}" if uses else ""
        is_idle = " (idle)" if name == stage.idle else ""
        duration = duration_text(show.program.duration_s)
        lines.append(f"  {name:{width}}  {duration:>10}, {joints}{line}{is_idle}")
    width = max((len(cue.name) for cue in stage.cues), default=0)
    for cue in stage.cues:
        choice = f" ({cue.choice})" if len(cue.shows) > 1 else ""
        what = ", ".join(cue.shows) + choice or cue.deed or "enable, disable"
        start = f", {cue.start}" if cue.shows else ""
        lines.append(f"  {cue.name:{width}}  on {cue.on.text}: {what}{start}")
    if names := planned.functions:
        lines.append(f"calls Python functions, which need --allow-run: {', '.join(names)}")
    for one in findings(planned):
        line = "" if one.line is None else f":{one.line}"
        lines.append(f"{stage.path}{line}: {one.text}")
    return lines


def file_as_json(path: Path, robot_path: Path | None = None) -> dict[str, Any]:
    """Return what `check --json` prints of a robot, a show, or a stage of one robot.

    Raises what loading, planning and compiling raise.
    """
    from lss_motion.planning.check_json import robot_as_json, show_as_json
    from lss_motion.robot.load import load_robot
    from lss_motion.stage import is_stage_file
    from lss_motion.stage.load import load_stage

    if shows.is_robot_file(path):
        return robot_as_json(load_robot(path))
    if is_stage_file(path):
        stage = load_stage(path)
        return {"stage": stage.name} if stage.figures else stage_as_json(plan_stage(stage))
    return show_as_json(shows.prepare(path, robot_path))


def stage_as_json(planned: Planned) -> dict[str, Any]:
    """Return the same as JSON."""
    stage = planned.stage
    return {
        "stage": stage.name,
        "shows": {
            name: {
                "file": str(stage.shows[name].path),
                "duration_s": show.program.duration_s,
                "joints": list(show.program.start_deg),
                "line_worst_100_ms_ratio": {
                    bus: use.worst_100_ms_ratio for bus, use in show.program.line_use.items()
                },
            }
            for name, show in planned.shows.items()
        },
        "idle": stage.idle,
        "cues": [
            {"cue": cue.name, "on": cue.on.text, "play": list(cue.shows), "start": cue.start}
            for cue in stage.cues
        ],
        "functions": list(planned.functions),
        "findings": [{"line": one.line, "text": one.text} for one in findings(planned)],
    }
