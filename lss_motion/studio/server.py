"""Opens the sockets of a studio and serves it until a signal ends it.

Processes: this server (asyncio), the planner, the player while a show plays, and the process that
only stops. Nothing here waits for one of them.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import webbrowser
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import InputError
from lss_motion.studio.app import make_app
from lss_motion.studio.entrance import PAGES_SHARES
from lss_motion.studio.studio import Studio, StudioAddress, StudioOptions
from lss_motion.studio.web import LOOPBACK, Address, listen, make_server

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from starlette.routing import BaseRoute

    from lss_motion.studio.keeper import Failure

LOOK_S: Final = 0.5
"""How often the files are looked at. Chosen: soon enough for a person who saves and looks up."""
BEAT_S: Final = 1.0
CLOSE_S: Final = 30.0
"""A show that is stopped at the end of the server has ended by then; otherwise it is aborted."""


def listening(options: StudioOptions) -> list[StudioAddress]:
    """Return the open sockets; raises `InputError` for an address that cannot be used."""
    places = [(LOOPBACK, False)]
    if options.listen_host not in (None, LOOPBACK):
        assert options.listen_host is not None
        places.append((options.listen_host, options.certificate is not None))
    found = []
    port = options.listen_port
    for host, is_tls in places:
        is_early = options.is_early
        own, other = listen(host, port, is_early=is_early), listen(host, 0, is_early=is_early)
        port = port or own.getsockname()[1]
        found.append(
            StudioAddress(
                Address(host, own.getsockname()[1], is_tls),
                own,
                Address(host, other.getsockname()[1], is_tls),
                other,
            )
        )
    return found


class Service(Protocol):
    """What a server does besides that of the studio, such as a stage."""

    def routes(self) -> list[BaseRoute]:
        """Return further routes."""

    @property
    def failure(self) -> Failure | None:
        """Why the program ends; None: it goes on."""

    def look(self) -> None:
        """Do what is due; called every `LOOK_S`."""

    async def close(self) -> None:
        """Close what the service has opened, after all motion has ended."""


def serve(
    options: StudioOptions,
    tell: Callable[[Studio], None],
    *,
    opens: bool,
    make_service: Callable[[Studio], Service] | None = None,
) -> Failure | None:
    """Serve until a signal ends it; `tell` is called when clients may come.

    Returns why it ended by itself. Raises `InputError` where it cannot begin.
    """
    if sys.platform == "win32":
        raise InputError(
            "the studio needs Linux or macOS: on Windows a new process cannot inherit a socket "
            "pair, by which server, player and stop reach each other; lss-play works here"
        )
    return asyncio.run(
        _serve(options, listening(options), tell, opens=opens, make_service=make_service)
    )


async def _serve(
    options: StudioOptions,
    sockets: Sequence[StudioAddress],
    tell: Callable[[Studio], None],
    *,
    opens: bool,
    make_service: Callable[[Studio], Service] | None,
) -> Failure | None:
    studio = Studio(options, sockets)
    service = None if make_service is None else make_service(studio)
    app = make_app(studio, () if service is None else service.routes())
    servers = []
    for one in sockets:
        is_tls = one.address.is_tls
        server = make_server(
            app,
            PAGES_SHARES,
            certificate=options.certificate if is_tls else None,
            key=options.key if is_tls else None,
        )
        servers.append((server, one.own_socket))
    ending = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, ending.set)
    tasks = [loop.create_task(_every(BEAT_S, studio.tick))]
    tasks.append(loop.create_task(_every(LOOK_S, studio.document.look)))
    if service is not None:
        tasks.append(loop.create_task(_every(LOOK_S, lambda: _look(service, ending))))
    serving = [loop.create_task(server.serve([own])) for server, own in servers]
    try:
        tell(studio)
        if opens:
            loop.run_in_executor(None, webbrowser.open, studio.url)
        await ending.wait()
        free = asyncio.Event()
        studio.desk.close(free.set)
        ending.clear()
        again = loop.create_task(ending.wait())
        waiting = [loop.create_task(free.wait()), again]
        await asyncio.wait(waiting, timeout=CLOSE_S, return_when=asyncio.FIRST_COMPLETED)
        if not free.is_set():
            studio.desk.stop(is_emergency=True)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(free.wait(), CLOSE_S)
    finally:
        for server, _ in servers:
            server.should_exit = True
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, *serving, return_exceptions=True)
        if service is not None:
            await service.close()
        studio.close()
    return None if service is None else service.failure


def _look(service: Service, ending: asyncio.Event) -> None:
    service.look()
    if service.failure is not None:
        ending.set()


async def _every(period_s: float, do: Callable[[], None]) -> None:
    while True:
        do()
        await asyncio.sleep(period_s)
