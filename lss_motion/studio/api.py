"""The HTTP interface of a stage: the operations of `remote.schema` as paths, its state, metrics.

    POST /trigger/NAME        fires the cues with `http: NAME`
    POST /cue/NAME            fires a cue by its name
    POST /op/OPERATION        any operation of the schema; its other keys are the body, JSON
    GET  /state               the state of the stage
    GET  /metrics             for Prometheus
    GET  /api, /openapi.json  this interface, for people and for programs

Every request needs the token (`Authorization: Bearer TOKEN`) or the cookie of a page. What it
changes needs no lease: it is another program, like a cue.
"""

from __future__ import annotations

import asyncio
import html
import json
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from lss_motion import __version__
from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as stage
from lss_motion.studio.access import Role
from lss_motion.studio.web import json_body

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.requests import Request
    from starlette.routing import BaseRoute

    from lss_motion.stage.triggers.sources import Gate

    Ask = Callable[[m.AnyOperation, str, Callable[[str | None], None]], None]

ANSWER_S: Final = 5.0
"""The player answers within milliseconds; one that does not is stuck or gone."""
OF_CLIENTS: Final = frozenset({"lease", "beat", "pair", "load"})
"""Operations that only make sense for a page."""


class Api:
    """The routes of a stage. `ask` carries an operation out and calls back with a refusal."""

    def __init__(
        self,
        gate: Gate,
        ask: Ask,
        state: Callable[[], dict[str, Any]],
        metrics: Callable[[], tuple[bytes, str]],
    ) -> None:
        self.names: frozenset[str] = frozenset()
        """The names of cues with `http`."""
        self._gate, self._ask, self._state, self._metrics = gate, ask, state, metrics

    def routes(self) -> list[BaseRoute]:
        """Return the routes."""
        return [
            Route("/trigger/{name}", self._trigger, methods=["POST"]),
            Route("/cue/{name}", self._cue, methods=["POST"]),
            Route("/op/{name}", self._operation, methods=["POST"]),
            Route("/state", self._get_state),
            Route("/metrics", self._get_metrics),
            Route("/openapi.json", self._openapi),
            Route("/api", self._page),
        ]

    async def _trigger(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self.names:
            known = ", ".join(sorted(self.names)) or "none"
            return JSONResponse({"error": f"no cue has http: {name}; there are: {known}"}, 404)
        return await self._answer(request, {"op": "trigger", "kind": "http", "address": name})

    async def _cue(self, request: Request) -> Response:
        return await self._answer(request, {"op": "cue", "label": request.path_params["name"]})

    async def _operation(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name in OF_CLIENTS:
            return JSONResponse({"error": f"{name} is for pages"}, 404)
        return await self._answer(request, {**await json_body(request), "op": name})

    async def _answer(self, request: Request, fields: dict[str, Any]) -> Response:
        """Carry an operation out, and wait for what the player says."""
        role: Role = request.scope["role"]
        if role < Role.OPERATE:
            return JSONResponse({"error": "this needs the role operate; you may look"}, 403)
        host = "" if request.client is None else request.client.host
        loop = asyncio.get_running_loop()
        if not self._gate.admits(host, loop.time()):
            return JSONResponse({"error": "too many requests"}, 429)
        try:
            operation = m.parse_operation(json.dumps(fields))
        except InputError as error:
            return JSONResponse({"error": str(error)}, 400)
        answer: asyncio.Future[str | None] = loop.create_future()

        def take(refusal: str | None) -> None:
            if not answer.done():
                answer.set_result(refusal)

        self._ask(operation, f"HTTP {request.url.path} from {host}", take)
        try:
            refusal = await asyncio.wait_for(answer, ANSWER_S)
        except TimeoutError:
            return JSONResponse({"error": "the player does not answer"}, 504)
        if refusal is not None:
            return JSONResponse({"error": refusal}, 409)
        return JSONResponse({"accepted": fields["op"]})

    async def _get_state(self, _request: Request) -> Response:
        return JSONResponse(self._state())

    async def _get_metrics(self, _request: Request) -> Response:
        content, kind = self._metrics()
        return Response(content, media_type=kind)

    async def _openapi(self, _request: Request) -> Response:
        return JSONResponse(openapi(sorted(self.names)))

    async def _page(self, _request: Request) -> Response:
        return HTMLResponse(page(sorted(self.names)))


def _done(text: str) -> dict[str, Any]:
    refusal = {"application/json": {"schema": {"$ref": "#/components/schemas/Refusal"}}}
    return {
        "200": {"description": "It is carried out, or has begun."},
        "400": {"description": "It is no operation of this kind.", "content": refusal},
        "401": {"description": "The token is missing or wrong.", "content": refusal},
        "409": {"description": f"{text}: refused, with the reason.", "content": refusal},
    }


def openapi(names: list[str]) -> dict[str, Any]:
    """Return the interface as OpenAPI 3.1; `names` are those of cues with `http`."""
    shared = json.loads(json.dumps(m.schema()["$defs"]).replace("#/$defs/", OF_SCHEMA))
    paths: dict[str, Any] = {
        "/trigger/{name}": _named("Fire the cues with this `http` name.", {"enum": names}),
        "/cue/{name}": _named("Fire a cue by its name.", {}),
    }
    for entry in shared.values():
        op = entry.get("properties", {}).get("op", {}).get("const")
        if op is None or op in OF_CLIENTS:
            continue
        own = {key: value for key, value in entry["properties"].items() if key not in ("op", "id")}
        needed = [key for key in entry["required"] if key in own]
        body = {"type": "object", "properties": own, "additionalProperties": False}
        text = " ".join(entry.get("description", "").split())
        paths[f"/op/{op}"] = {
            "post": {
                "summary": text,
                "operationId": op,
                "requestBody": {
                    "required": bool(needed),
                    "content": {"application/json": {"schema": {**body, "required": needed}}},
                },
                "responses": _done("Not possible now"),
            }
        }
    for path, text, kind in (
        ("/state", "The state of the stage.", "application/json"),
        ("/metrics", "Metrics for Prometheus.", "text/plain"),
    ):
        shown = {"description": text, "content": {kind: {}}}
        paths[path] = {"get": {"summary": text, "responses": {"200": shown}}}
    refusal = {"type": "object", "properties": {"error": {"type": "string"}}}
    return {
        "openapi": "3.1.0",
        "info": {"title": "lss_motion: stage", "version": __version__},
        "security": [{"token": []}],
        "paths": paths,
        "components": {
            "schemas": {**shared, "Refusal": refusal},
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


OF_SCHEMA: Final = "#/components/schemas/"


def _named(text: str, schema: dict[str, Any]) -> dict[str, Any]:
    name = {
        "name": "name",
        "in": "path",
        "required": True,
        "schema": {"type": "string", **({} if schema.get("enum") == [] else schema)},
    }
    return {"post": {"summary": text, "parameters": [name], "responses": _done("Not now")}}


def page(names: list[str]) -> str:
    """Return the interface as a page for people."""
    described = openapi(names)
    rows = []
    for path, methods in described["paths"].items():
        ((method, one),) = methods.items()
        content = one.get("requestBody", {}).get("content", {}).get("application/json", {})
        fields = content.get("schema", {}).get("properties", {})
        cells = (method.upper(), path, one["summary"], ", ".join(fields))
        rows.append("".join(f"<td>{html.escape(cell)}</td>" for cell in cells))
    table = "".join(f"<tr>{row}</tr>" for row in rows)
    known = html.escape(", ".join(names) or "none")
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>HTTP interface</title>'
        "<h1>HTTP interface of the stage</h1><p>Send <code>Authorization: Bearer TOKEN</code>, the "
        "token that <code>lss-motion serve</code> prints. For programs: "
        '<a href="/openapi.json">openapi.json</a> (OpenAPI 3.1).</p>'
        "<pre>curl -X POST -H 'Authorization: Bearer TOKEN' ADDRESS/trigger/NAME</pre>"
        f"<p>Names of cues with <code>http</code>: {known}</p>"
        f"<table><tr><th>method<th>path<th>what it does<th>keys of the body</tr>{table}</table>"
    )


def marked(operation: m.AnyOperation, origin: str) -> m.AnyOperation:
    """Return an operation with the sender that `origin` ends with, for the log of the stage."""
    if isinstance(operation, stage.Trigger | stage.FireCue | stage.Enable):
        return replace(operation, source=origin.rpartition(" from ")[2][:200])
    return operation
