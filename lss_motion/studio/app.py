"""Routes of the server: no decisions here, only calls.

`make_app` returns an ASGI application; tests drive it without a port.
"""

from __future__ import annotations

import asyncio
import contextlib
import mimetypes
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from starlette.applications import Starlette
from starlette.requests import HTTPConnection
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocketDisconnect

from lss_motion.errors import InputError
from lss_motion.studio.access import Denied, Purpose, Role, asked_of, decide, make_cookie, proved
from lss_motion.studio.allowed import remembered
from lss_motion.studio.client import Allowance, Client
from lss_motion.studio.entrance import admit
from lss_motion.studio.folder import joints_of, listed
from lss_motion.studio.planner import finite_json
from lss_motion.studio.web import json_body

if TYPE_CHECKING:
    from collections.abc import Sequence

    from starlette.requests import Request
    from starlette.routing import BaseRoute
    from starlette.types import ASGIApp, Message, Receive, Scope, Send
    from starlette.websockets import WebSocket

    from lss_motion.studio.studio import Studio

STATIC: Final = Path(__file__).parent / "static"
FILE_MAX_BYTES: Final = 64_000_000
"""The largest file of a figure."""
FILE_TYPES: Final = {
    ".urdf": "application/xml",
    ".stl": "model/stl",
    ".dae": "model/vnd.collada+xml",
    ".obj": "model/obj",
    ".mtl": "text/plain",
}
"""What a figure is made of; no other file of the folder is given to anyone."""
CLOSE_DENIED: Final = 4001
CLOSE_OVERRUN: Final = 4002
CLOSE_FULL: Final = 4003
"""Codes of a closed websocket: not allowed; too slow, come again; too many clients."""

# The types of files come from the system, and some systems know none for modules.
mimetypes.add_type("text/javascript", ".js")
mimetypes.add_type("text/javascript", ".mjs")


def make_app(studio: Studio, more: Sequence[BaseRoute] = ()) -> Starlette:
    """Return the application of one studio, with further routes."""
    routes = [
        Route("/", _page),
        Mount("/static", PageFiles(directory=STATIC)),
        Route("/session", _session, methods=["POST"]),
        Route("/robot.json", _robot),
        Route("/view/{plan}.json", _view),
        Route("/files/{path:path}", _file),
        Route("/text/{path:path}", _text),
        Route("/model/{revision:int}.json", _model),
        Route("/folder.json", _folder),
        Route("/joints/{path:path}", _joints),
        Route("/stop", _stop, methods=["POST"]),
        Route("/estop", _stop, methods=["POST"]),
        WebSocketRoute("/ws", _socket),
        *studio.uploads.routes(),
        *more,
    ]
    app = Starlette(routes=routes, exception_handlers={InputError: _refused})
    app.state.studio = studio
    app.add_middleware(Guard, studio=studio)
    return app


class PageFiles(StaticFiles):
    """The modules of the pages. A browser asks each time whether its copy is still right (`ETag`).

    Else it would go on with a part of the old modules after an update of this package.
    """

    def file_response(self, *given: Any, **named: Any) -> Response:  # noqa: ANN401  (passed on)
        response = super().file_response(*given, **named)
        response.headers["cache-control"] = "no-cache"
        return response


PURPOSES: Final = {
    "/session": Purpose.SESSION,
    "/ws": Purpose.SOCKET,
    "/stop": Purpose.STOP,
    "/estop": Purpose.STOP,
}


class Guard:
    """Decides about each request before anything else sees it, and adds the headers of safety."""

    def __init__(self, app: ASGIApp, studio: Studio) -> None:
        self._app, self._studio = app, studio

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass an allowed request on, with its role in `scope["role"]`."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        path = scope["path"]
        is_page = path == "/" or path.startswith("/static/")
        other = Purpose.DATA if scope.get("method") in ("GET", "HEAD") else Purpose.STOP
        purpose = Purpose.PAGE if is_page else PURPOSES.get(path, other)
        door = self._studio.door
        asked = asked_of(purpose, HTTPConnection(scope).headers, door)
        found = scope["role"] = decide(asked, door)
        if not isinstance(found, Denied) and (role := proved(asked, door)) is not None:
            admit(scope, role)

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *self._studio.safety_headers(scope)]
            await send(message)

        if isinstance(found, Denied):
            await _deny(found, scope, receive, send_guarded)
        else:
            await self._app(scope, receive, send_guarded)


async def _deny(denied: Denied, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": CLOSE_DENIED, "reason": denied.text})
        return
    await JSONResponse({"error": denied.text}, denied.status)(scope, receive, send)


async def _refused(request: HTTPConnection, error: Exception) -> Response:  # noqa: ARG001
    return JSONResponse({"error": str(error)}, 404)


def _studio(connection: HTTPConnection) -> Studio:
    studio: Studio = connection.app.state.studio
    return studio


async def _page(request: Request) -> Response:  # noqa: ARG001
    return FileResponse(STATIC / "index.html", headers={"cache-control": "no-cache"})


async def _session(request: Request) -> Response:
    """Give a cookie for the token, or for a code of six digits."""
    studio = _studio(request)
    given = await json_body(request)
    found = studio.admit(given)
    if isinstance(found, Denied):
        return JSONResponse({"error": found.text}, found.status)
    response = Response(status_code=204)
    response.set_cookie(
        studio.door.cookie_name,
        make_cookie(found, studio.door.token),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )
    return response


async def _stop(request: Request) -> Response:
    _studio(request).desk.stop(is_emergency=request.url.path == "/estop")
    return Response(status_code=204)


async def _robot(request: Request) -> Response:
    document = _studio(request).document
    reply = document.newest if document.newest.robot else document.good
    if reply is None or not reply.robot:
        return JSONResponse({"error": "the robot is not known yet"}, 404)
    return Response(reply.robot, media_type="application/json")


async def _view(request: Request) -> Response:
    view = _studio(request).document.view(request.path_params["plan"])
    if view is None:
        return JSONResponse({"error": "this plan is not kept any more"}, 404)
    headers = {"cache-control": "no-store"}  # Another text may have the same plan.
    return Response(view, media_type="application/json", headers=headers)


async def _file(request: Request) -> Response:
    """Return a file of a figure, from below the folder of the show."""
    path = _studio(request).document.inside(request.path_params["path"])
    kind = FILE_TYPES.get(path.suffix.lower())
    with contextlib.suppress(OSError):  # A name that no file can have.
        if kind is not None and path.is_file() and path.stat().st_size <= FILE_MAX_BYTES:
            return FileResponse(path, media_type=kind)
    return JSONResponse({"error": "no file of a figure"}, 404)


async def _text(request: Request) -> Response:
    """Return the text of one of the files that the show is made of, to who may operate."""
    role: Role = request.scope["role"]
    document = _studio(request).document
    path = document.inside(request.path_params["path"])
    if role < Role.OPERATE:
        return JSONResponse({"error": "this needs the role operate; you may look"}, 403)
    if path.suffix.lower() not in (".yaml", ".yml") or not document.is_made_of(path):
        return JSONResponse({"error": "no file of this show"}, 404)
    return Response(document.text(path), media_type="text/plain; charset=utf-8")


async def _model(request: Request) -> Response:
    """Return what the files of the show hold now, to who may operate."""
    role: Role = request.scope["role"]
    if role < Role.OPERATE:
        return JSONResponse({"error": "this needs the role operate; you may look"}, 403)
    document = _studio(request).document
    if request.path_params["revision"] != document.revision:
        return JSONResponse({"error": f"the newest revision is {document.revision}"}, 404)
    return Response(finite_json(document.model()), media_type="application/json")


async def _folder(request: Request) -> Response:
    """Return which shows, robots and sounds lie in the folder, to who may operate."""
    role: Role = request.scope["role"]
    if role < Role.OPERATE:
        return JSONResponse({"error": "this needs the role operate; you may look"}, 403)
    return JSONResponse(listed(_studio(request).document.folder))


async def _joints(request: Request) -> Response:
    """Return the joints of a robot file of the folder, to who may operate."""
    role: Role = request.scope["role"]
    if role < Role.OPERATE:
        return JSONResponse({"error": "this needs the role operate; you may look"}, 403)
    document, name = _studio(request).document, request.path_params["path"]
    if name not in listed(document.folder)["robots"]:
        return JSONResponse({"error": "no robot of this folder"}, 404)
    path = document.inside(name)
    return JSONResponse(joints_of(remembered(document.text(path), path).value))


async def _socket(websocket: WebSocket) -> None:
    """Serve one client until it goes, or is too slow."""
    studio = _studio(websocket)
    await websocket.accept()
    role: Role = websocket.scope["role"]
    name, place = studio.name_of(websocket, role), studio.place_of(websocket.headers["host"])
    client = studio.hub.join(role, name, studio.now_s(), place)
    if client is None:
        await websocket.close(CLOSE_FULL, "too many clients")
        return
    writing = asyncio.create_task(_write(websocket, client, studio))
    try:
        await _read(websocket, client, studio)
    finally:
        writing.cancel()
        studio.hub.leave(client, studio.now_s())


async def _read(websocket: WebSocket, client: Client, studio: Studio) -> None:
    """Obey what a client sends; one that sends too much is read more slowly."""
    allowance = Allowance(studio.now_s())
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if client.is_overrun:
                continue
            text = message.get("text")
            studio.hub.receive(client, text if text is not None else b"", studio.now_s())
            if wait_s := allowance.take(studio.now_s()):
                await asyncio.sleep(wait_s)


async def _write(websocket: WebSocket, client: Client, studio: Studio) -> None:
    """Send what waits for a client; close it if that is too much."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while (content := await client.next()) is not None:
            if isinstance(content, bytes):
                await websocket.send_bytes(content)
            else:
                await websocket.send_text(content)
        studio.hub.leave(client, studio.now_s())  # Now: it may never answer to being closed.
        await websocket.close(CLOSE_OVERRUN, "too slow; come again")
