"""The planner process, started by `planning`.

It loads, plans and compiles the file of each request, and returns what the server shows and
starts: bytes, so that the server never needs what planning imports. Of requests that wait only the
newest is carried out.
"""

from __future__ import annotations

import hashlib
import json
import math
import pickle
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.source import read_data, with_edits
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import wait_for

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from lss_motion.planning.shows import Show
    from lss_motion.playing.remote.edit_messages import AnyChange, TriedWindow
    from lss_motion.playing.remote.schema import FileKind
    from lss_motion.robot.model import Robot
    from lss_motion.show.functions import ModuleSource
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.model import Sequence
    from lss_motion.stage.check import Planned
    from lss_motion.stage.model import Stage
    from lss_motion.studio.trial import WholePlan
    from lss_motion.system.messages import MessagePipe

PROBLEMS_MAX: Final = 100
"""More errors of one file are not sent."""


EDIT_MAX_BYTES: Final = 2_000_000
"""An edit of a show that plays is read by the player between two moves: this takes it 10 ms
(measured: 2 ms for 60 s of 18 joints)."""


class Request(Struct, frozen=True, kw_only=True):
    """What is to be planned."""

    number: int
    path: Path
    robot_path: Path | None = None
    backup: Path | None = None
    """The backup with the limits that the robot file leaves to the servos."""
    port: str | None = None
    views: Path | None = None
    """Folder for the views of the shows of a stage, by plan."""
    figure: str | None = None
    """Of a stage with several: that of this computer, which conducts."""
    texts: Mapping[Path, bytes] = field(default_factory=dict)
    """What edited files have that is not saved yet, by their full paths."""


class EditTrial(Struct, frozen=True, kw_only=True):
    """An edit of which a client wants to know what it would do."""

    number: int
    """It comes back in the result."""
    operation: AnyChange
    texts: Mapping[Path, bytes]
    """What edited files have that is not saved yet."""


class TrialResult(Struct, frozen=True, kw_only=True):
    """What an edit would do."""

    number: int
    problem: str | None = None
    window: TriedWindow | None = None
    is_dropped: bool = False
    """Something newer came before it was tried, or the planner has ended."""


class SpliceRequest(Struct, frozen=True, kw_only=True):
    """A show that plays (`job`) shall go on as the show that was planned last, named `plan`."""

    number: int
    """It comes back in the result."""
    plan: str
    job: bytes
    reached_s: float
    """What is due before that show time stays."""


class SpliceResult(Struct, frozen=True, kw_only=True):
    """The edit for the player (a pickled `ProgramEdit`) and the job that then plays, or why not."""

    number: int
    problem: str | None = None
    plan: str = ""
    edit: bytes = b""
    job: bytes = b""


class PlannerReply(Struct, frozen=True, kw_only=True):
    """What became of a request; without a plan where `problems` say why, or it is a robot file."""

    number: int
    kind: FileKind = "sequence"
    title: str = ""
    problems: tuple[tuple[str, int | None, str], ...] = ()
    """Path, line and text of each error."""
    notes: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()
    plan: str | None = None
    view: bytes = b""
    job: bytes = b""
    """The packed job of the show."""
    functions: tuple[str, ...] = ()
    """The Python functions that the show calls."""
    modules: tuple[ModuleSource, ...] = ()
    """What lies beside the show and is run for them."""
    robot: bytes = b""
    """The view of the robot, JSON; empty where it could not be read."""
    live_job: bytes = b""
    """The packed job of the robot without a show."""
    scan_job: bytes = b""
    puppet_job: bytes = b""
    """The packed job of joints that follow a client; empty where they cannot."""
    robot_path: Path | None = None
    robot_digest: str = ""
    """Of the content of the robot file, when it was loaded."""
    port: str = ""
    is_simulated: bool = False
    has_planner: bool = True
    """Whether the planner lived until it had answered."""
    files: tuple[Path, ...] = ()
    """All files that the result depends on."""
    stage: Stage | None = None
    """The stage of a stage file, without its robot."""
    plans: Mapping[str, str] = field(default_factory=dict)
    """The plan of each show of a stage."""


AnyRequest = Request | EditTrial | SpliceRequest


def reply_to(request: Request, keep: Callable[[WholePlan], None] = lambda _: None) -> PlannerReply:
    """Return the plan of a request, or what is wrong; raises nothing about the files.

    `keep` is called with the plan of a show.
    """
    with with_edits(request.texts):
        return _reply_to(request, keep)


def _reply_to(request: Request, keep: Callable[[WholePlan], None]) -> PlannerReply:
    from lss_motion.planning.shows import is_program, is_robot_file
    from lss_motion.stage import is_stage_file

    found: dict[str, Any] = {"files": _first_files(request)}
    try:
        if request.path.is_dir():
            return PlannerReply(number=request.number, kind="folder", **found)
        if is_program(request.path):
            raise InputError(
                "is a compiled program; open the sequence it was made of", path=request.path
            )
        if is_robot_file(request.path):
            found |= {"kind": "robot", "title": request.path.stem}
            robot = _robot(request.path, request)
            found["files"] = tuple(sorted({*found["files"], *_files_of_robot(robot)}))
            found |= _of_robot(robot)
        elif is_stage_file(request.path):
            found |= _of_stage(request, found)
        else:
            found |= _of_show(request, found, keep)
    except LssMotionError as error:
        found["problems"] = tuple(_problems(error, request.path))
    except RecursionError:
        found["problems"] = ((str(request.path), None, "is nested too deeply"),)
    except MemoryError:
        found["problems"] = ((str(request.path), None, "needs more memory than there is"),)
    named = {Path(path) for path, _, _ in found.get("problems", ())}
    found["files"] = tuple(sorted({*found["files"], *named}))
    return PlannerReply(number=request.number, **found)


def _first_files(request: Request) -> tuple[Path, ...]:
    """Return the files that are known before anything was read."""
    return tuple(p for p in (request.path, request.robot_path, request.backup) if p is not None)


def file_digest(path: Path) -> str:
    """Return a hash of the content of a file; empty if it cannot be read."""
    try:
        return hashlib.sha256(read_data(path)).hexdigest()
    except InputError:
        return ""


def _robot(path: Path, request: Request) -> Robot:
    from lss_motion.maintenance.settings import with_backup
    from lss_motion.playing.connection import with_port
    from lss_motion.robot.load import load_robot

    return with_port(with_backup(load_robot(path), request.backup), request.port)


def _files_of_robot(robot: Robot) -> list[Path]:
    return [
        path
        for path in (robot.path, None if robot.urdf is None else robot.urdf.path)
        if path is not None
    ]


def _puppet(robot: Robot) -> dict[str, Any]:
    """Return how late joints follow a client at most, or why they cannot."""
    from lss_motion.playing.remote.job import puppet_latency_s

    try:
        return {"latency_s": puppet_latency_s(robot), "problem": None}
    except InputError as error:
        return {"latency_s": None, "problem": error.reason}


def _of_robot(robot: Robot, gait: Gait | None = None) -> dict[str, Any]:
    from lss_motion.maintenance.guided import ServoTasks
    from lss_motion.maintenance.survey import ScanJob
    from lss_motion.playing.connection import is_simulated
    from lss_motion.playing.live_end import LiveJob
    from lss_motion.playing.remote.job import PuppetJob
    from lss_motion.playing.remote.process import packed
    from lss_motion.studio.robot_view import robot_view

    puppet = _puppet(robot)
    return {
        "robot_path": robot.path,
        "robot_digest": "" if robot.path is None else file_digest(robot.path),
        "robot": finite_json({**robot_view(robot, gait), "puppet": puppet}),
        "live_job": packed(LiveJob(robot=robot, tasks=ServoTasks())),
        "scan_job": packed(ScanJob(robot=robot)),
        "puppet_job": packed(PuppetJob(robot=robot)) if puppet["problem"] is None else b"",
        "port": ", ".join(bus.port for bus in robot.buses.values()),
        "is_simulated": is_simulated(robot),
        "title": robot.name,
    }


def _of_show(
    request: Request, found: dict[str, Any], keep: Callable[[WholePlan], None]
) -> dict[str, Any]:
    """Return the fields of a show; those that are known so far go to `found` on the way."""
    from lss_motion.planning.shows import compiled, files_of, load, load_gait
    from lss_motion.planning.summaries import program_lines
    from lss_motion.playing.remote.job import Job
    from lss_motion.playing.remote.message import plan_hash
    from lss_motion.playing.remote.process import packed
    from lss_motion.show.functions import calls_of, modules_of
    from lss_motion.show.gait import is_gait_file
    from lss_motion.studio.trial import WholePlan
    from lss_motion.studio.view import view_of

    is_gait = is_gait_file(request.path)
    found |= {"kind": "gait" if is_gait else "sequence", "title": request.path.stem}

    def read(path: Path) -> Robot:
        return _robot(path, request)

    def load_again() -> tuple[Sequence, Robot]:
        return load(request.path, request.robot_path, read)

    sequence, robot = load_again()
    gait = load_gait(request.path, robot.path, read)[0] if is_gait else None
    files = {*found["files"], *files_of(sequence), *_files_of_robot(robot)}
    found |= {**_of_robot(robot, gait), "files": tuple(sorted(files)), "title": sequence.name}
    if sequence.play:
        found["kind"] = "playlist"
    show = compiled(sequence, robot)
    keep(WholePlan(show, request.path.resolve().parent, load_again))
    plan = plan_hash(show.program).hex()
    files |= {Path(cue.sound) for cue in show.program.cues if cue.sound}
    modules = modules_of(show.program.cues)
    files |= _files_of_modules(modules)
    job = Job(shows=show.program, robot=robot, trajectory=show.trajectory)
    return {
        "files": tuple(sorted(files)),
        "plan": plan,
        "view": finite_json(view_of(show, plan)),
        "job": packed(job),
        "summary": tuple(program_lines(show)),
        "notes": tuple(_notes(show)),
        "functions": tuple(call.run for call in calls_of(show.program.cues)),
        "modules": modules,
    }


def _files_of_modules(modules: Iterable[ModuleSource]) -> set[Path]:
    return {Path(one.path) for one in modules if one.data}


def _of_stage(request: Request, found: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a stage; those that are known so far go to `found` on the way."""
    from lss_motion.planning.shows import files_of
    from lss_motion.playing.connection import with_port
    from lss_motion.playing.remote.process import packed
    from lss_motion.stage.check import plan_stage, stage_lines
    from lss_motion.stage.job import StageJob
    from lss_motion.stage.load import load_stage

    found |= {"kind": "stage", "title": request.path.stem}
    stage = load_stage(request.path)
    if stage.figures:
        return _of_figures(stage, request, found)
    assert stage.robot is not None
    robot = with_port(stage.robot, request.port)
    files = {*found["files"], *(show.path for show in stage.shows.values())}
    files |= set(_files_of_robot(robot))
    found |= {**_of_robot(robot), "files": tuple(sorted(files)), "title": stage.name}
    planned = plan_stage(stage, lambda path: _robot(path, request))
    for show in planned.shows.values():
        files |= set() if show.sequence is None else set(files_of(show.sequence))
        files |= {Path(cue.sound) for cue in show.program.cues if cue.sound}
    modules = planned.modules
    files |= _files_of_modules(modules)
    plans = _plans(planned, request.views)
    names = json.dumps(plans, sort_keys=True).encode() + read_data(request.path)
    lines = stage_lines(planned)
    return {
        "files": tuple(sorted(files)),
        "plan": hashlib.sha256(names).hexdigest()[:16],
        "plans": plans,
        "stage": replace(stage, robot=None),
        "job": packed(StageJob(planned=planned)),
        "summary": tuple(lines),
        "functions": planned.functions,
        "modules": modules,
    }


def _of_figures(stage: Stage, request: Request, found: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a stage with figures, for the computer that conducts."""
    from lss_motion.planning.shows import files_of
    from lss_motion.playing.remote.message import plan_hash
    from lss_motion.playing.remote.process import packed
    from lss_motion.show.functions import modules_of
    from lss_motion.stage.hosts.plans import planned_stage
    from lss_motion.stage.hosts.serving import conductor_job

    if request.figure is None or request.figure != stage.conductor:
        raise InputError(f"the stage has figures; {stage.conductor} conducts it: --figure")
    robots = {
        name: _robot(
            one.robot_path,
            request if name == request.figure else Request(number=0, path=request.path),
        )
        for name, one in stage.figures.items()
    }
    files = {
        *found["files"],
        *(path for show in stage.shows.values() for path in show.paths.values()),
    }
    files |= {path for robot in robots.values() for path in _files_of_robot(robot)}
    own = robots[request.figure]
    found |= {**_of_robot(own), "files": tuple(sorted(files)), "title": stage.name}
    made = planned_stage(stage, robots)
    plans = {}
    for name, one in made.items():
        for show in one.shows.values():
            files |= set() if show.sequence is None else set(files_of(show.sequence))
        program = one.programs.get(request.figure)
        if program is not None:
            plans[name] = plan_hash(program).hex()
            _write_view(
                one.shows.get(request.figure, one.shows.get("")), plans[name], request.views
            )
    names = json.dumps(plans, sort_keys=True).encode() + read_data(request.path)
    cues = [cue for one in made.values() for p in one.programs.values() for cue in p.cues]
    modules = modules_of(cues)
    files |= _files_of_modules(modules)
    return {
        "files": tuple(sorted(files)),
        "plan": hashlib.sha256(names).hexdigest()[:16],
        "plans": plans,
        "stage": replace(stage, robot=None),
        "job": packed(conductor_job(stage, made, own, plans)),
        "functions": tuple(dict.fromkeys(cue.run for cue in cues if cue.run)),
        "modules": modules,
    }


def _plans(planned: Planned, folder: Path | None) -> dict[str, str]:
    """Return the plan of each show; write the views that are not in the folder yet."""
    from lss_motion.playing.remote.message import plan_hash

    plans = {}
    for name, show in planned.shows.items():
        plan = plans[name] = plan_hash(show.program).hex()
        _write_view(show, plan, folder)
    return plans


def _write_view(show: Show | None, plan: str, folder: Path | None) -> None:
    """Write the view of a show, unless it is in the folder."""
    from lss_motion.studio.view import view_of

    path = None if folder is None else folder / f"{plan}.json"
    has_view = show is not None and show.sequence is not None
    if path is not None and show is not None and has_view and not path.exists():
        path.with_suffix(".new").write_bytes(finite_json(view_of(show, plan)))
        path.with_suffix(".new").replace(path)


def _notes(show: Show) -> Iterator[str]:
    """Yield what a person should know before the show is played."""
    from lss_motion.show.functions import call_lines

    yield from call_lines(show.program.cues)
    if show.program.is_endless:
        yield "the show has no end: it plays until it is stopped"


def _problems(error: LssMotionError, path: Path) -> Iterator[tuple[str, int | None, str]]:
    """Yield the place and the text of an error, and of those that came with it."""
    if not isinstance(error, InputError):
        yield str(path), None, str(error)
        return
    for one in (error, *error.more)[:PROBLEMS_MAX]:
        yield str(one.path or path), one.line, one.reason


def finite_json(value: dict[str, object]) -> bytes:
    """Return JSON; None in place of what is no finite number."""
    return json.dumps(_finite(value), ensure_ascii=False, separators=(",", ":")).encode()


def _finite(value: Any) -> Any:  # noqa: ANN401  JSON
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def main(pipe: MessagePipe) -> int:
    """Answer requests until the pipe ends; return an exit code."""
    typed: TypedPipe[AnyRequest] = TypedPipe(pipe)
    from lss_motion.studio.trial import tried

    plans: list[WholePlan] = []
    while arrived := _arrived(typed):
        for request in _newest(arrived):
            if isinstance(request, SpliceRequest):
                typed.send_object(spliced(request, plans[-1] if plans else None))
            elif isinstance(request, EditTrial):
                whole = plans[-1] if plans else None
                problem, window = tried(request.operation, request.texts, whole)
                result = TrialResult(number=request.number, problem=problem, window=window)
                typed.send_object(result)
            else:
                typed.send_object(reply_to(request, plans.append))
                del plans[:-1]
    return 0


def spliced(request: SpliceRequest, whole: WholePlan | None) -> SpliceResult:
    """Return how a show that plays goes on as the one that was planned last, or why it cannot."""
    from lss_motion.planning.program.live_edit import PlannedShow, live_edit
    from lss_motion.playing.remote.message import plan_hash
    from lss_motion.playing.remote.process import packed

    number = request.number
    plan = None if whole is None else plan_hash(whole.show.program)
    if whole is None or plan is None or plan.hex() != request.plan:
        return SpliceResult(number=number, problem="it is planned again already; try again")
    job = pickle.loads(request.job)  # noqa: S301  (packed by this program)
    show = whole.show
    assert show.trajectory is not None
    if job.robot != show.robot:
        return SpliceResult(number=number, problem="the robot file was changed; START plays it")
    playing = PlannedShow(job.shows, job.trajectory)
    edited = PlannedShow(show.program, show.trajectory)
    try:
        edit = live_edit(playing, edited, job.robot, reached_s=request.reached_s, plan=plan)
    except LssMotionError as error:
        return SpliceResult(number=number, problem=str(error))
    content = pickle.dumps(edit)
    if len(content) > EDIT_MAX_BYTES:
        problem = f"the rest of the show has {len(content) / 1e6:.1f} MB, too much beside moves"
        return SpliceResult(number=number, problem=problem)
    job = replace(job, shows=edit.program, trajectory=show.trajectory)
    return SpliceResult(number=number, plan=request.plan, edit=content, job=packed(job))


def _arrived(typed: TypedPipe[AnyRequest]) -> list[AnyRequest]:
    """Wait for requests, and return all that have arrived; none: the pipe has ended."""
    requests: list[AnyRequest] = []
    while wait_for([typed.fileno()], 0.0 if requests else math.inf):
        requests += typed.receive()
        if typed.has_ended:
            return []
    return requests


def _newest(arrived: list[AnyRequest]) -> Iterator[AnyRequest]:
    """Yield the newest request for a plan, splices, and a trial if that is the newest of all."""
    plans = [request for request in arrived if isinstance(request, Request)]
    yield from plans[-1:]
    yield from (request for request in arrived if isinstance(request, SpliceRequest))
    if isinstance(arrived[-1], EditTrial):
        yield arrived[-1]
