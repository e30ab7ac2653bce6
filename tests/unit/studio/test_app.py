"""Routes and their guard, driven without a port: who gets what, and with which headers."""

from __future__ import annotations

import io
import wave
from types import SimpleNamespace

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.studio import web
from lss_motion.studio.access import Door, Pairing, Role, make_cookie, new_token
from lss_motion.studio.app import make_app
from lss_motion.studio.document import Document
from lss_motion.studio.hub import Hub
from lss_motion.studio.planner import PlannerReply, Request
from lss_motion.studio.studio import Studio
from lss_motion.studio.uploads import Uploads
from lss_motion.studio.web import BODY_MAX_BYTES, Address

OWN = Address("127.0.0.1", 8000, is_tls=False)
STOP = Address("127.0.0.1", 8001, is_tls=False)
TOKEN = new_token()
PLAN = "0123456789abcdef"


class DeskStub:
    def __init__(self):
        self.stops = []

    def stop(self, *, is_emergency):
        self.stops.append(is_emergency)

    def obey(self, operation, key):
        return True

    def state(self):
        return (m.Links(clients=7).to_json().decode(),)

    def operator_lost(self):
        pass


@pytest.fixture
def studio(tmp_path):
    """A studio without its processes."""
    (tmp_path / "show").mkdir()
    (tmp_path / "show" / "arm.urdf").write_text("<robot/>")
    (tmp_path / "show" / "secret.py").write_text("x")
    (tmp_path / "outside.stl").write_text("x")
    (tmp_path / "show" / "link.stl").symlink_to(tmp_path / "outside.stl")
    studio = object.__new__(Studio)
    studio.addresses, studio.stop_addresses = [OWN], [STOP]
    studio.door = Door(frozenset({OWN.name}), frozenset({OWN.origin}), TOKEN, "lss_studio_8000")
    studio.pairing, studio.desk = Pairing(), DeskStub()
    studio.hub = Hub(studio._welcome)
    studio.hub.desk = studio.desk
    studio.uploads = Uploads(lambda: studio.document, None)
    path = tmp_path / "show" / "wave.yaml"
    studio.document = Document(Request(number=0, path=path), lambda _: None, lambda: None)
    studio.document.take(
        PlannerReply(number=1, plan=PLAN, view=b'{"plan": 1}', robot=b'{"name": "a"}')
    )
    return studio


@pytest.fixture
def client(studio):
    with TestClient(make_app(studio), base_url=OWN.origin, raise_server_exceptions=False) as client:
        yield client


def cookie(role):
    return {"cookie": f"lss_studio_8000={make_cookie(role, TOKEN)}"}


SAFE = {"origin": OWN.origin}


def test_a_token_or_a_code_becomes_a_cookie_that_scripts_cannot_read(client, studio):
    for wrong in ({"token": "x"}, {"token": 1}, {"code": "000000"}, {}, [], "x" * BODY_MAX_BYTES):
        answer = client.post("/session", json=wrong, headers=SAFE)
        assert answer.status_code in (401, 403)
        assert answer.json()["error"]
        assert "set-cookie" not in answer.headers
    code = studio.pairing.open(Role.OPERATE, studio.now_s())
    for given, role in (({"token": TOKEN}, "edit"), ({"code": code}, "operate")):
        client.cookies.clear()
        answer = client.post("/session", json=given, headers=SAFE)
        assert answer.status_code == 204
        for word in ("HttpOnly", "SameSite=strict", f"lss_studio_8000={role}."):
            assert word in answer.headers["set-cookie"]
    assert client.post("/session", json={"token": TOKEN}).status_code == 401


def test_a_sound_is_kept_once_whole_and_never_over_another_file(client, tmp_path):
    folder = tmp_path / "show"
    good = b"RIFF....WAVEfmt "
    for role in (Role.VIEW, Role.OPERATE):
        refused = client.put("/sound/a.wav", content=good, headers=SAFE | cookie(role))
        assert refused.status_code == 403
    assert client.put("/sound/a.wav", content=good, headers=cookie(Role.EDIT)).status_code == 401
    foreign = {"origin": "http://evil.example"} | cookie(Role.EDIT)
    assert client.put("/sound/a.wav", content=good, headers=foreign).status_code == 403
    edit = SAFE | cookie(Role.EDIT)
    before = sorted(folder.iterdir())
    for name in (
        *(
            "wave.yaml",
            "a.py",
            ".a.wav",
            "..%2Fa.wav",
            "%2e%2e",
            "a%00.wav",
            "a%0A.wav",
            "b%5Ca.wav",
        ),
        *(f"{'a' * 130}.wav", "sub%2Fa.wav"),
    ):
        assert client.put(f"/sound/{name}", content=good, headers=edit).status_code in (404, 409)
    answer = client.put("/sound/a.wav", content=b"sequence: a", headers=edit)
    assert "is no sound" in answer.json()["error"]
    assert sorted(folder.iterdir()) == before, "nothing half is left"
    sound = io.BytesIO()
    with wave.open(sound, "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes(bytes(1600))
    good = sound.getvalue()
    answer = client.put("/sound/%C3%BC.wav", content=good, headers=edit)
    assert answer.json() == {"file": "ü.wav", "is_new": True}
    assert (folder / "ü.wav").read_bytes() == good
    assert client.put("/sound/%C3%BC.wav", content=good, headers=edit).json()["is_new"] is False
    other = client.put("/sound/%C3%BC.wav", content=good + bytes(2), headers=edit)
    assert "not overwritten" in other.json()["error"]
    assert (folder / "ü.wav").read_bytes() == good
    (folder / "link.wav").symlink_to(tmp_path / "new.wav")
    assert client.put("/sound/link.wav", content=good, headers=edit).status_code == 409
    assert not (tmp_path / "new.wav").exists()


@pytest.mark.parametrize("path", ["/robot.json", f"/view/{PLAN}.json", "/files/arm.urdf"])
def test_data_needs_a_role_and_the_page_does_not(client, path):
    assert client.get(path).status_code == 401
    assert client.get(path, headers=cookie(Role.VIEW)).status_code == 200
    assert client.get(path, headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
    assert client.get(path, headers={**cookie(Role.VIEW), "host": "evil"}).status_code == 421
    foreign = {**cookie(Role.EDIT), "origin": "http://127.0.0.1.evil"}
    assert client.get(path, headers=foreign).status_code == 403


@pytest.mark.parametrize(
    "path",
    [
        "secret.py",
        "wave.yaml",
        "../outside.stl",
        "..%2foutside.stl",
        "%2e%2e/outside.stl",
        "link.stl",
        "/etc/passwd",
        "//etc/passwd",
        "none.stl",
        "",
        "arm.urdf/x.stl",
        "a%00.stl",
        "%ff.stl",
        "x" * 5000 + ".stl",
    ],
)
def test_only_files_of_a_figure_below_the_folder_are_given(client, path):
    answer = client.get(f"/files/{path}", headers=cookie(Role.EDIT))
    assert answer.status_code == 404
    assert "root:" not in answer.text


def test_every_answer_has_the_headers_of_safety(client):
    for path in ("/robot.json", "/static/vendor/none.js", "/nothing"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert f"connect-src 'self' ws://{OWN.name} {STOP.origin};" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in headers


def test_modules_have_the_type_that_browsers_require(client):
    answer = client.get("/static/figure/figure.js")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/javascript")


def test_a_browser_asks_whether_its_copy_of_a_module_is_still_right(client):
    answer = client.get("/static/main.js")
    assert answer.headers["cache-control"] == "no-cache"
    again = client.get("/static/main.js", headers={"if-none-match": answer.headers["etag"]})
    assert again.status_code == 304
    assert again.content == b""
    assert again.headers["cache-control"] == "no-cache"


def test_everyone_who_may_look_may_stop(client, studio):
    for path, is_emergency in (("/stop", False), ("/estop", True)):
        assert client.post(path, headers=SAFE).status_code == 401
        assert client.post(path, headers=cookie(Role.VIEW)).status_code == 401
        assert client.get(path, headers={**SAFE, **cookie(Role.VIEW)}).status_code == 405
        assert studio.desk.stops == []
        assert client.post(path, headers={**SAFE, **cookie(Role.VIEW)}).status_code == 204
        assert studio.desk.stops.pop() is is_emergency


def test_a_websocket_is_opened_for_our_page_and_for_who_has_the_token(client):
    for headers in (cookie(Role.EDIT), {**cookie(Role.EDIT), "origin": "http://x"}, SAFE, {}):
        with (
            pytest.raises(WebSocketDisconnect) as closed,
            client.websocket_connect(f"ws://{OWN.name}/ws", headers=headers),
        ):
            pass
        assert closed.value.code == 4001
    bearer = {"authorization": f"Bearer {TOKEN}"}
    for headers, role in (({**SAFE, **cookie(Role.VIEW)}, "view"), (bearer, "edit")):
        with client.websocket_connect(f"ws://{OWN.name}/ws", headers=headers) as link:
            welcome = link.receive_json()
            assert (welcome["event"], welcome["role"]) == ("welcome", role)
            assert welcome["stop_origin"] == STOP.origin
            assert link.receive_json()["event"] == "lease"
            assert link.receive_json() == {"event": "links", "clients": 7}
            assert link.receive_json() == {"event": "links", "clients": 1}
            link.send_json({"op": "play", "id": 3})
            if role == "view":
                assert link.receive_json()["event"] == "refused"
            link.send_bytes(b'{"op": "play"}')
            link.send_json({"op": "stop", "id": 4})
            answers = [link.receive_json() for _ in range(4 if role == "edit" else 2)]
            assert answers[-1] == {"event": "accepted", "id": 4, "op": "stop"}


def test_a_port_in_use_and_an_address_of_another_computer_are_said():
    with web.listen("127.0.0.1", 0) as own:
        port = own.getsockname()[1]
        with pytest.raises(InputError, match="another program listens"):
            web.listen("127.0.0.1", port)
    with pytest.raises(InputError, match="no address of this computer; this computer has"):
        web.listen("192.0.2.7", 0)
    with pytest.raises(InputError, match="no such address"):
        web.listen("no.such.name.invalid", 0)


def test_a_studio_on_the_network_says_what_others_can_read(studio):
    assert not studio.is_network_readable
    with pytest.raises(InputError, match="--listen"):
        studio._pair("view")
    studio.addresses.append(Address("192.0.2.7", 8000, is_tls=False))
    assert studio.is_network_readable
    pairing = studio._pair("view")
    assert pairing.urls == ("http://192.0.2.7:8000/",)
    assert studio.admit({"code": pairing.code}) is Role.VIEW
    studio.addresses[1] = Address("192.0.2.7", 8000, is_tls=True)
    assert not studio.is_network_readable
    assert studio.place_of("192.0.2.7:8000") == 1
    assert studio.name_of(SimpleNamespace(client=None), Role.VIEW) == "a client (view)"
