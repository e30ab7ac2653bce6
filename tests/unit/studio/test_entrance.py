"""Strangers on the network take nothing that an operator needs; real sockets in one process."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
import threading

import pytest

from lss_motion.studio import entrance, web
from lss_motion.studio.access import Door, Role, make_cookie
from lss_motion.studio.stop import StopPages
from lss_motion.system.reactor import wait_for

TOKEN = "secret"
WAIT_S = 20.0
"""Longest wait of these tests for anything."""
SHARES = {None: 4, Role.VIEW: 3, Role.OPERATE: 3, Role.EDIT: 3}


class Stops:
    """What the stop process does with a stop."""

    def __init__(self):
        self.kinds = []

    def stop(self, kind):
        self.kinds.append(kind)


class Site:
    """A stop server in a thread of its own, as the stop process has it."""

    def __init__(self, app=None):
        self.stops, self.opened = Stops(), []
        self.socket = web.listen("127.0.0.1", 0)
        self.port = self.socket.getsockname()[1]
        name = f"127.0.0.1:{self.port}"
        self.door = Door(frozenset({name}), frozenset({f"http://{name}"}), TOKEN, "c")
        self.name = name
        self.server = web.make_server(app or StopPages(self.stops, self.door), SHARES)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        asyncio.run(self.server.serve([self.socket]))

    def close(self):
        for own in self.opened:
            own.close()
        self.server.should_exit = True
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()

    def connect(self):
        self.opened.append(socket.create_connection(("127.0.0.1", self.port), timeout=WAIT_S))
        return self.opened[-1]

    def ask(self, path="/estop", headers=f"Authorization: Bearer {TOKEN}\r\n", own=None):
        own = own or self.connect()
        head = f"POST {path} HTTP/1.1\r\nHost: {self.name}\r\n{headers}"
        own.sendall(f"{head}Content-Length: 0\r\n\r\n".encode())
        return own.recv(4096).split(b"\r\n")[0]


@pytest.fixture
def site():
    made = []

    def make(app=None):
        made.append(Site(app))
        return made[-1]

    yield make
    for one in made:
        one.close()


def is_dropped(own):
    """Wait until the other end has closed a connection."""
    try:
        while own.recv(65536):
            pass
    except ConnectionResetError:
        pass
    except TimeoutError:
        return False
    return True


def test_a_stop_arrives_while_strangers_hold_every_place(site):
    stop = site()
    silent = [stop.connect() for _ in range(200)]
    assert stop.ask() == b"HTTP/1.1 204 No Content"
    assert stop.stops.kinds == ["estop"]
    assert all(is_dropped(one) for one in silent)


@pytest.mark.parametrize("begun", [b"", b"POST /estop HTTP/1.1\r\nHost: x\r\nX: "])
def test_a_stranger_without_a_whole_request_is_dropped(begun, site):
    own = site().connect()
    own.sendall(begun)
    assert is_dropped(own)


def test_a_known_connection_is_kept_and_strangers_do_not_push_it_out(site):
    stop = site()
    own = stop.connect()
    assert stop.ask(own=own).endswith(b"204 No Content")
    for _ in range(20):
        stop.connect()
    assert stop.ask(own=own).endswith(b"204 No Content")
    wrong = stop.connect()
    assert b"401" in stop.ask(headers="Authorization: Bearer x\r\n", own=wrong)
    assert is_dropped(wrong)


def test_a_role_has_a_share_and_takes_nothing_of_another(site):
    stop = site()
    cookie = f"Cookie: c={make_cookie(Role.VIEW, TOKEN)}\r\nOrigin: http://{stop.name}\r\n"
    operator = stop.connect()
    assert stop.ask(own=operator).endswith(b"204 No Content")
    viewers = []
    for _ in range(SHARES[Role.VIEW] + 2):
        viewers.append(stop.connect())
        assert stop.ask(headers=cookie, own=viewers[-1]).endswith(b"204 No Content")
    assert all(is_dropped(one) for one in viewers[:2])
    assert stop.ask(own=operator).endswith(b"204 No Content")


def test_a_client_that_does_not_read_is_dropped(site, monkeypatch):
    """It proves a role first, so that no other rule ends it."""
    monkeypatch.setattr(entrance, "STALLED_S", 0.5)

    async def much(scope, receive, send):
        entrance.admit(scope, Role.VIEW)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        with contextlib.suppress(OSError):
            await send({"type": "http.response.body", "body": bytes(50_000_000)})

    one = site(much)
    own = one.connect()
    own.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    places = one.server._entrance._places
    while not places:
        places = one.server._entrance._places
    while not places[0].is_gone:  # The limit of the test ends it.
        wait_for((), 0.05)


def test_a_websocket_that_pings_and_does_not_read_is_dropped(site):
    """The library answers each ping, whatever waits already."""

    async def listen(scope, receive, send):
        entrance.admit(scope, Role.VIEW)
        await receive()
        await send({"type": "websocket.accept"})
        while (await receive())["type"] != "websocket.disconnect":
            pass

    one = site(listen)
    own = one.connect()
    own.sendall(
        f"GET /ws HTTP/1.1\r\nHost: {one.name}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {'A' * 22}==\r\n\r\n".encode()
    )
    assert own.recv(4096).startswith(b"HTTP/1.1 101")
    ping = b"\x89\xfd" + bytes(4) + bytes(125)
    with pytest.raises((ConnectionResetError, BrokenPipeError)):
        own.sendall(500_000 * ping)


def test_an_accept_without_a_file_number_is_tried_again(site, monkeypatch, capfd):
    stop = site()
    real, left = socket.socket.accept, [20]

    def accept(own):
        if own is stop.socket and left[0]:
            left[0] -= 1
            raise OSError(errno.EMFILE, "Too many open files")
        return real(own)

    monkeypatch.setattr(socket.socket, "accept", accept)
    assert stop.ask().endswith(b"204 No Content")
    assert left == [0]
    assert "Traceback" not in capfd.readouterr().err


def test_trouble_of_connections_is_one_line_once_in_a_while(capfd):
    entrance.log_briefly()
    for name in ("uvicorn.error", "asyncio"):
        for number in range(50):
            error = ValueError(f"\x1b[31m{number}\nmore")
            logging.getLogger(name).error("Exception in ASGI application\n", exc_info=error)
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all(line.startswith("network: Exception in ASGI application") for line in lines)
    assert not any("\x1b" in line for line in lines)
