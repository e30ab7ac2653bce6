"""The HTTP routes that bring sounds into a show: a file, its beats, a joint that follows it.

    PUT  /sound/NAME     the body becomes the sound file NAME in the folder of the show
    POST /beats          finds the beats of a sound (`listening.BeatsTask`)
    POST /voice          a joint that follows a sound (`listening.VoiceTask`), as the text of a file

All need the role edit. A file is never overwritten: the same sound once more is the same file,
another one of that name is refused. What a show makes of it are edits (`document`).
"""

from __future__ import annotations

import asyncio
import contextlib
import filecmp
import os
import secrets
from typing import TYPE_CHECKING, Final

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from lss_motion.errors import InputError
from lss_motion.sound.files import has_soundfile, is_sound, sound_info
from lss_motion.studio.access import Role
from lss_motion.studio.folder import SOUNDS
from lss_motion.studio.listening import BeatsTask, SoundJob, SoundListener, VoiceTask, task_of
from lss_motion.studio.web import json_body

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from pathlib import Path

    from starlette.routing import BaseRoute

    from lss_motion.studio.document import Document

    Handler = Callable[[Request], Awaitable[Response]]

SOUND_MAX_BYTES: Final = 256_000_000
"""The largest sound: 24 minutes of WAV in CD quality."""
NAME_MAX_CHARS: Final = 120


class Uploads:
    """The routes of one studio."""

    def __init__(self, document: Callable[[], Document], backup: Path | None) -> None:
        self._document, self._backup = document, backup
        self._listener = SoundListener()

    def routes(self) -> list[BaseRoute]:
        """Return the routes."""
        return [
            Route("/sound/{name}", _for_editors(self._sound), methods=["PUT"]),
            Route("/beats", _for_editors(self._beats), methods=["POST"]),
            Route("/voice", _for_editors(self._voice), methods=["POST"]),
        ]

    def close(self) -> None:
        """End the process that reads sounds."""
        self._listener.close()

    async def _sound(self, request: Request) -> Response:
        """Keep the body as a file of the folder."""
        document = self._document()
        document.require_editable()
        path = sound_path(document, request.path_params["name"])
        own = path.with_name(f".{secrets.token_hex(8)}.part{path.suffix}")
        try:
            if not await _received(request, own):
                return JSONResponse({"error": "the sound is too large, or was cut off"}, 400)
            is_new = await asyncio.to_thread(_kept, own, path)  # It reads all of a large file.
        finally:
            own.unlink(missing_ok=True)
        return JSONResponse({"file": document.name_of(path), "is_new": is_new})

    async def _beats(self, request: Request) -> Response:
        return await self._heard(task_of(BeatsTask, await json_body(request)))

    async def _voice(self, request: Request) -> Response:
        return await self._heard(task_of(VoiceTask, await json_body(request)))

    async def _heard(self, task: BeatsTask | VoiceTask) -> Response:
        document = self._document()
        path = document.inside(task.file)
        if path.suffix.lower() not in SOUNDS or not path.is_file():
            raise InputError("is no sound of this folder", path=task.file)
        job = SoundJob(
            number=0,
            task=task,
            folder=document.folder,
            robot=document.robot_path,
            backup=self._backup,
            texts=document.unsaved_texts(),
        )
        return JSONResponse(await self._listener.ask(job))


def _for_editors(handler: Handler) -> Handler:
    """Let only those who may edit in; answer what is refused with its reason."""

    async def guarded(request: Request) -> Response:
        role: Role = request.scope["role"]
        if role < Role.EDIT:
            return JSONResponse({"error": "this needs the role edit"}, 403)
        try:
            return await handler(request)
        except InputError as error:
            return JSONResponse({"error": str(error)}, 409)

    return guarded


def sound_path(document: Document, name: str) -> Path:
    """Return where a sound would be kept; raises `InputError` for a name that none may have."""
    if "/" in name or "\\" in name or name.startswith(".") or not name.isprintable():
        raise InputError(f"{name!r} is no name of a file in the folder of the show")
    path = document.inside(name)
    if path.suffix.lower() not in SOUNDS or len(name) > NAME_MAX_CHARS:
        known = ", ".join(sorted(SOUNDS))
        raise InputError(
            f"{name!r}: a sound has a name of up to {NAME_MAX_CHARS} letters and {known}"
        )
    return path


async def _received(request: Request, path: Path) -> bool:
    """Write the body of a request to a new file; return whether it came whole."""
    size = 0
    try:
        with path.open("xb") as file, contextlib.suppress(ClientDisconnect):
            async for part in request.stream():
                size += len(part)
                if size > SOUND_MAX_BYTES:
                    return False
                file.write(part)
            return True
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}") from None
    return False


def _kept(own: Path, path: Path) -> bool:
    """Give a received file its name; return whether it is new. Nothing is overwritten."""
    if not is_sound(own):
        raise InputError(f"{path.name} is no sound: WAV, FLAC, OGG or MP3")
    if has_soundfile():
        try:
            sound_info(own)
        except InputError as error:
            raise InputError(f"{path.name} {error.reason}") from None
    try:
        os.link(own, path)
    except FileExistsError:
        if filecmp.cmp(own, path, shallow=False):
            return False
        raise InputError(
            f"there is another {path.name} already; it is not overwritten: give yours another name"
        ) from None
    except OSError as error:
        raise InputError(f"{path.name} cannot be written: {error.strerror or error}") from None
    return True
