"""What is in a sound: beats to confirm, and keys of a joint that follows it.

`SoundListener` is the server's end, `main` the process that reads sounds and computes, so that the
server answers at once. One task after the other; a process that ends fails the tasks that wait.
"""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from msgspec import Meta, Struct, convert, field
from msgspec import ValidationError as WrongMessageError

from lss_motion.errors import InputError, LssMotionError
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import wait_for

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lss_motion.system.messages import MessagePipe

TASKS_MAX: Final = 8
"""Tasks that wait. Chosen: a few persons who move sliders."""
FADE_S: Final = 0.2
"""Of a layer of syllables: a syllable, as `interchange.voice` has it."""
DIGITS: Final = 3

Name = Annotated[str, Meta(min_length=1, max_length=200)]
Ratio = Annotated[float, Meta(ge=0.0, le=1.0)]
Seconds = Annotated[float, Meta(ge=0.0, le=5.0)]
Angle = Annotated[float, Meta(ge=-36_000.0, le=36_000.0)]


class BeatsTask(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Find the beats of a sound file: about at `bpm`, half a beat later, each `every`-th."""

    file: Name
    bpm: Annotated[float, Meta(ge=30.0, le=300.0)] | None = None
    is_shifted: bool = False
    every: Annotated[int, Meta(ge=1, le=64)] = 1


class MouthValues(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a sound opens a mouth, as the options of `lss-motion import` of the same names."""

    threshold_db: Annotated[float, Meta(ge=-80.0, le=0.0)] = -30.0
    attack_s: Seconds = 0.05
    release_s: Seconds = 0.1
    gain_db: Annotated[float, Meta(ge=-40.0, le=40.0)] = 0.0
    opening_min: Ratio = 0.15


class VoiceTask(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Let a joint follow a sound file; the text of a sequence file comes back."""

    file: Name
    joint: Name
    follow: Literal["syllables", "energy", "stereo"] = "syllables"
    mouth: MouthValues = field(default_factory=MouthValues)
    near_deg: Angle | None = None
    far_deg: Angle | None = None


class SoundJob(Struct, frozen=True, kw_only=True):
    """A task with what the process needs to know besides."""

    number: int
    task: BeatsTask | VoiceTask
    folder: Path
    robot: Path | None
    backup: Path | None
    texts: Mapping[Path, bytes]
    """What edited files have that is not saved yet."""


class SoundFindings(Struct, frozen=True, kw_only=True):
    """What was found, or why nothing was."""

    number: int
    found: dict[str, Any] | None = None
    problem: str = ""


class SoundListener:
    """The process that reads sounds, started when it is first needed."""

    def __init__(self) -> None:
        self._process: ChildProcess[SoundFindings] | None = None
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._number = 0

    async def ask(self, job: SoundJob) -> dict[str, Any]:
        """Return what the process finds; raises `InputError` that says why it finds nothing."""
        if len(self._waiting) >= TASKS_MAX:
            raise InputError("too many sounds are being read; wait a moment")
        self._number += 1
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[self._number] = answer
        if self._process is None:
            self._process = ChildProcess("lss_motion.studio.listening")
            asyncio.get_running_loop().add_reader(self._process.fileno(), self._read)
        own = SoundJob(
            number=self._number,
            task=job.task,
            folder=job.folder,
            robot=job.robot,
            backup=job.backup,
            texts=job.texts,
        )
        self._process.send_object(own)
        try:
            return await answer
        finally:
            self._waiting.pop(own.number, None)

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(InputError("the process that reads sounds has ended"))
        if process is not None:
            asyncio.get_running_loop().remove_reader(process.fileno())
            process.close()

    def _read(self) -> None:
        assert self._process is not None
        for heard in self._process.receive():
            answer = self._waiting.get(heard.number)
            if answer is None or answer.done():
                continue
            if heard.found is None:
                answer.set_exception(InputError(heard.problem))
            else:
                answer.set_result(heard.found)
        if self._process.has_ended:
            self.close()


def task_of(kind: type[BeatsTask | VoiceTask], given: dict[str, Any]) -> BeatsTask | VoiceTask:
    """Return the task of a request; raises `InputError` for one that is none."""
    try:
        return convert(given, kind)
    except WrongMessageError as error:
        raise InputError(str(error)) from None


# ------------------------------------------------------------------------ the process


def heard(job: SoundJob) -> dict[str, Any]:
    """Carry a task out; raises `LssMotionError` with the reason where that is not possible."""
    from lss_motion.files.source import with_edits

    with with_edits(job.texts):
        return _beats(job, job.task) if isinstance(job.task, BeatsTask) else _voice(job, job.task)


def _beats(job: SoundJob, task: BeatsTask) -> dict[str, Any]:
    from lss_motion.sound.beats import beats_of, every, half_shifted
    from lss_motion.sound.files import SoundPart

    found = beats_of(SoundPart(path=job.folder / task.file), task.bpm)
    at_s = half_shifted(found.at_s) if task.is_shifted else found.at_s
    at_s = every(at_s, 0.0, task.every).round(DIGITS)
    return {
        "at_s": at_s[at_s >= 0.0].tolist(),
        "bpm": round(found.bpm / task.every, 1),
        "off_beat_ratio": round(found.off_beat_ratio, 2),
    }


def _voice(job: SoundJob, task: VoiceTask) -> dict[str, Any]:
    from msgspec import to_builtins

    from lss_motion.interchange.voice import (
        VoiceFollow,
        VoiceStyle,
        voice_comments,
        voice_sequence,
    )
    from lss_motion.maintenance.settings import with_backup
    from lss_motion.robot.load import load_robot
    from lss_motion.show.write import sequence_text
    from lss_motion.sound.envelope import MouthStyle
    from lss_motion.sound.files import SoundPart

    if job.robot is None:
        raise InputError("the robot is not known; mend its file first")
    robot = with_backup(load_robot(job.robot), job.backup)
    part = SoundPart(path=job.folder / task.file)
    style = VoiceStyle(
        follow=VoiceFollow(task.follow),
        mouth=MouthStyle(**to_builtins(task.mouth)),
        near_deg=task.near_deg,
        far_deg=task.far_deg,
        is_sounding=False,
    )
    voiced = voice_sequence(part, robot, task.joint, style)
    comments = [*voice_comments(voiced, part, style), _command(task, robot.name)]
    sequence = voiced.sequence
    text = sequence_text(sequence, job.folder, comments=comments)
    begins_open = sequence.keyframes[0].deg[task.joint] != round(float(voiced.asked_deg[0]), 2)
    return {
        "text": text,
        "keys": len(sequence.keyframes),
        "end_s": sequence.keyframes[-1].at_s,
        "fade_s": FADE_S if begins_open else 0.0,
    }


def _command(task: VoiceTask, robot: str) -> str:
    """Return how the file was made, as a person would make it again in a terminal."""
    values = {
        name: getattr(task.mouth, name)
        for name in MouthValues.__struct_fields__
        if getattr(task.mouth, name) != getattr(MouthValues(), name)
    }
    values |= {
        name: value
        for name, value in (("closed_deg", task.near_deg), ("open_deg", task.far_deg))
        if value is not None
    }
    options = "".join(f" --{name.replace('_', '-')} {value:g}" for name, value in values.items())
    follow = "" if task.follow == "syllables" else f" --follow {task.follow}"
    return f"Made by: import {task.file} --robot {robot}.yaml --joint {task.joint}{follow}{options}"


def main(pipe: MessagePipe) -> int:
    """Carry out tasks until the pipe ends; return an exit code."""
    typed: TypedPipe[SoundJob] = TypedPipe(pipe)
    while wait_for([typed.fileno()], math.inf):
        for job in typed.receive():
            try:
                reply = SoundFindings(number=job.number, found=heard(job))
            except LssMotionError as error:
                reply = SoundFindings(number=job.number, problem=str(error))
            except MemoryError:
                reply = SoundFindings(number=job.number, problem="needs more memory than there is")
            typed.send_object(reply)
        if typed.has_ended:
            return 0
    return 0
