"""Plans of a show on several computers: made once, split by figure, stored and checked by hash.

The conductor's computer plans. Joints of a show for several figures are named `left.jaw`: they are
planned together, on a robot that has the joints of all (`joined_robot`), so that what one of them
needs more time for, all wait for. Then each figure gets its part. Where the stage names one
sequence for each figure, each is planned alone.

A computer never plays a plan because of where it came from: the bytes have the hash that was asked
for, the robot has the hash for which the plan was made, and the plan is verified here again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, LssMotionError
from lss_motion.stage.hosts.messages import Cast, Part, hash_of, packed

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.shows import Show
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.stage.check import Planned
    from lss_motion.stage.model import Stage

SEPARATOR: Final = "."
"""Between the name of a figure and that of its joint, bus, sensor, pose or group."""
STORE_MAX_BYTES: Final = 512 * 1024 * 1024
"""The oldest plans are removed beyond this size. Chosen: some hundred shows of ten minutes."""
PLAN_MAX_BYTES: Final = 64 * 1024 * 1024
"""A larger answer is no plan of ours: ten minutes of 18 joints have 3 MB."""


def robot_hash(robot: Robot) -> str:
    """Return the hash of what decides where a robot moves, and how fast.

    Ports are no part of it: they differ between computers. Nor is what was learnt about it.
    """
    from lss_motion.robot.learnt import settings_hash

    told: dict[str, object] = {
        "name": robot.name,
        "joints": [[name, settings_hash(joint)] for name, joint in sorted(robot.joints.items())],
        "buses": [
            [name, bus.baud_bps, bus.firmware, bus.pro_firmware]
            for name, bus in sorted(robot.buses.items())
        ],
        "sensors": sorted(
            [name, one.bus, one.servo_id, one.kind] for name, one in robot.sensors.items()
        ),
        "drives": [[name, str(joint.drive)] for name, joint in sorted(robot.joints.items())],
    }
    if robot.servos:
        told["servos"] = robot_hash(robot.servo_robot)
        told["mechanisms"] = [repr(one) for one in robot.mechanisms.values()]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def joined_robot(name: str, robots: Mapping[str, Robot]) -> Robot:
    """Return one robot with the joints of all figures, named `FIGURE.JOINT`.

    A pose that every figure has may be used without a figure's name: all take it.
    """
    joints: dict[str, Joint] = {}
    buses, sensors = {}, {}
    poses: dict[str, dict[str, float]] = {}
    groups: dict[str, tuple[str, ...]] = {}
    mirror = {}
    for figure, robot in robots.items():
        for bus in robot.buses.values():
            named = _named(figure, bus.name)
            buses[named] = replace(bus, name=named)
        for joint in robot.joints.values():
            named, line = _named(figure, joint.name), _named(figure, joint.bus)
            joints[named] = replace(joint, name=named, bus=line)
        for sensor in robot.sensors.values():
            named, line = _named(figure, sensor.name), _named(figure, sensor.bus)
            sensors[named] = replace(sensor, name=named, bus=line)
        for pose, angles in robot.poses.items():
            named_deg = {_named(figure, joint): deg for joint, deg in angles.items()}
            poses[_named(figure, pose)] = named_deg
            if all(pose in other.poses for other in robots.values()):
                poses.setdefault(pose, {}).update(named_deg)
        for group, members in robot.groups.items():
            groups[_named(figure, group)] = tuple(_named(figure, one) for one in members)
        for joint_name, (other, sign) in robot.mirror.items():
            mirror[_named(figure, joint_name)] = (_named(figure, other), sign)
    first = next(iter(robots.values()))
    return replace(
        first,
        name=name,
        path=None,
        buses=buses,
        joints=joints,
        poses=poses,
        groups=groups,
        mirror=mirror,
        sensors=sensors,
        visemes={},
        read_limits={},
        figure=None,
        urdf=None,
    )


def part_of(program: Program, figure: str, robot: Robot, *, is_conductor: bool) -> Program:
    """Return what one figure plays of a program for the joined robot.

    Sounds and functions are the conductor's; lights are those of the figure's own servos.
    """
    start = f"{figure}{SEPARATOR}"

    def own(name: str) -> bool:
        return name.startswith(start)

    cues = []
    for cue in program.cues:
        led = tuple((name.removeprefix(start), code) for name, code in cue.led if own(name))
        kept = replace(cue, led=led)
        if not is_conductor:
            kept = replace(kept, sound="", run="", say="")
        if kept.led or kept.sound or kept.run or kept.say:
            cues.append(kept)
    return replace(
        program,
        robot=robot.name,
        robot_path=None,
        moves=[
            move._replace(bus=move.bus.removeprefix(start))
            for move in program.moves
            if own(move.bus)
        ],
        start_deg={
            name.removeprefix(start): deg for name, deg in program.start_deg.items() if own(name)
        },
        drives={name.removeprefix(start): by for name, by in program.drives.items() if own(name)},
        drive_reasons={},
        cues=tuple(cues),
    )


class PlannedCast(Struct, frozen=True):
    """A show planned for all figures."""

    cast: Cast
    contents: Mapping[str, bytes]
    """The plans, and the cast itself, by hash."""
    programs: Mapping[str, Program]
    """What each figure plays."""
    shows: Mapping[str, Show]
    """By figure, or one with the joints of all, named ``."""


def planned_cast(
    show: str,
    source: Path | Mapping[str, Path],
    robots: Mapping[str, Robot],
    conductor: str,
) -> PlannedCast:
    """Plan a show for all figures; raises what planning raises.

    `source` is a sequence with the joints of all figures, or a sequence for each figure. It is
    planned with headroom, since every figure trims its clock.
    """
    from lss_motion.planning.program.text import from_text
    from lss_motion.planning.shows import prepare

    shows: dict[str, Show] = {}
    programs: dict[str, Program] = {}
    if isinstance(source, Mapping):
        for figure, path in source.items():
            robot = robots[figure]
            shows[figure] = prepare(path, path, partial(_given, robot), is_following=True)
            program = shows[figure].program
            programs[figure] = part_of_alone(program, robot, figure == conductor)
    else:
        whole = joined_robot("stage", robots)
        shows[""] = prepare(source, source, partial(_given, whole), is_following=True)
        program = shows[""].program
        for figure, robot in robots.items():
            part = part_of(program, figure, robot, is_conductor=figure == conductor)
            if part.start_deg:
                programs[figure] = part
    for one in shows.values():
        if one.program.waits:
            raise InputError(
                "a show for several figures cannot wait for a sensor: use a cue of the stage",
                path=source if not isinstance(source, Mapping) else None,
            )
    plans, parts, duration_s = {}, {}, 0.0
    for figure, program in programs.items():
        content = program.to_text().encode()
        plans[hash_of(content)] = content
        parts[figure] = Part(plan=hash_of(content), robot=robot_hash(robots[figure]))
        duration_s = max(duration_s, from_text(content.decode(), robots[figure]).duration_s)
    is_endless = duration_s == float("inf")
    cast = Cast(show=show, duration_s=None if is_endless else duration_s, parts=parts)
    plans[hash_of(packed(cast))] = packed(cast)
    return PlannedCast(cast, plans, programs, shows)


def _given(robot: Robot, _path: Path) -> Robot:
    return robot


def planned_stage(stage: Stage, robots: Mapping[str, Robot]) -> dict[str, PlannedCast]:
    """Plan every show of a stage for all figures; raises one error for all that cannot be."""
    from lss_motion.stage.check import as_one

    assert stage.conductor is not None
    made: dict[str, PlannedCast] = {}
    errors: list[tuple[int | None, str, LssMotionError]] = []
    for entry in stage.shows.values():
        source = entry.paths[""] if "" in entry.paths else dict(entry.paths)
        try:
            made[entry.name] = planned_cast(entry.name, source, robots, stage.conductor)
        except LssMotionError as error:
            errors.append((entry.line, entry.name, error))
    if errors:
        raise as_one(stage, errors)
    return made


def planned_figures(stage: Stage, robots: Mapping[str, Robot]) -> list[tuple[str, Planned]]:
    """Return the shows of each figure, planned; those with the joints of all have the name ``."""
    from lss_motion.stage.check import Planned

    made = planned_stage(stage, robots)
    shows = {
        figure: {name: one.shows[figure] for name, one in made.items() if figure in one.shows}
        for figure in ("", *stage.figures)
    }
    return [(figure, Planned(stage=stage, shows=own)) for figure, own in shows.items() if own]


def part_of_alone(program: Program, robot: Robot, is_conductor: bool) -> Program:  # noqa: FBT001
    """Return a program that was made for one figure, without what is the conductor's."""
    named = replace(program, robot=robot.name, robot_path=None)
    if is_conductor:
        return named
    kept = [replace(cue, sound="", run="", say="") for cue in named.cues if cue.led]
    return replace(named, cues=tuple(kept))


def read_plan(content: bytes, robot: Robot) -> Program:
    """Return the program of a plan, verified against this robot; raises `LssMotionError`."""
    from lss_motion.planning.program.text import from_text
    from lss_motion.planning.program.verify import verify_program

    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"the plan is no text: {error}") from None
    program = from_text(text, robot)
    verify_program(program, robot)
    return program


class PlanStore:
    """Content by its hash, in a folder. What does not have the hash of its name is not there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, name: str) -> bytes | None:
        """Return content; None if it is not there, or damaged."""
        try:
            content = (self._folder / name).read_bytes()
        except OSError:
            return None
        return content if hash_of(content) == name else None

    def put(self, content: bytes) -> str:
        """Store content and return its hash; raises `OSError` where the disk does not take it."""
        name = hash_of(content)
        self._folder.mkdir(parents=True, exist_ok=True)
        if self.get(name) is None:
            handle, fresh = tempfile.mkstemp(dir=self._folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(content)
                os.replace(fresh, self._folder / name)  # noqa: PTH105
            except OSError:
                with contextlib.suppress(OSError):
                    os.unlink(fresh)  # noqa: PTH108
                raise
            self._prune()
        return name

    def _prune(self) -> None:
        found = []
        for path in self._folder.iterdir():
            with contextlib.suppress(OSError):
                state = path.stat()
                found.append((state.st_mtime_ns, state.st_size, path))
        total = sum(size for _, size, _ in found)
        for _, size, path in sorted(found)[:-1]:
            if total <= STORE_MAX_BYTES:
                return
            with contextlib.suppress(OSError):
                path.unlink()
                total -= size


def _named(figure: str, name: str) -> str:
    return f"{figure}{SEPARATOR}{name}"
