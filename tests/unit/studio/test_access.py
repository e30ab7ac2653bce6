"""Access: a table of requests and answers, and the pairing code."""

from __future__ import annotations

import pytest

from lss_motion.studio.access import (
    CODE_TRIES,
    CODE_VALID_S,
    Denied,
    Door,
    Pairing,
    Purpose,
    RequestClaims,
    Role,
    asked_of,
    decide,
    make_cookie,
    new_token,
    role_of,
)

TOKEN = new_token()
HOST, ORIGIN = "127.0.0.1:8000", "http://127.0.0.1:8000"
DOOR = Door(frozenset({HOST}), frozenset({ORIGIN}), TOKEN, "lss_studio_8000")
VIEWER = make_cookie(Role.VIEW, TOKEN)
OPERATOR = make_cookie(Role.OPERATE, TOKEN)
P = Purpose

TABLE = [
    # what is asked, Host, Origin, Sec-Fetch-Site, cookie, bearer → role or status
    (P.PAGE, HOST, None, "none", None, None, Role.VIEW),
    (P.PAGE, "127.0.0.1.evil:8000", None, None, None, None, 421),
    (P.PAGE, "127.0.0.1", None, None, None, None, 421),
    (P.PAGE, "localhost:8000", None, None, None, None, 421),
    (P.PAGE, None, None, None, None, TOKEN, 421),
    (P.SESSION, HOST, ORIGIN, "same-origin", None, None, Role.VIEW),
    (P.SESSION, HOST, None, None, None, None, 401),
    (P.SESSION, HOST, "http://evil.example", "cross-site", None, None, 403),
    (P.DATA, HOST, None, "same-origin", VIEWER, None, Role.VIEW),
    (P.DATA, HOST, None, None, OPERATOR, None, Role.OPERATE),
    (P.DATA, HOST, None, None, None, TOKEN, Role.EDIT),
    (P.DATA, HOST, None, None, None, None, 401),
    (P.DATA, HOST, None, "cross-site", OPERATOR, None, 403),
    (P.DATA, HOST, None, "same-site", OPERATOR, None, 403),
    (P.DATA, HOST, "null", None, OPERATOR, None, 403),
    (P.DATA, HOST, None, None, OPERATOR[:-1] + "x", None, 401),
    (P.DATA, HOST, None, None, OPERATOR.replace("operate", "edit"), None, 401),
    (P.DATA, HOST, None, None, "edit..", None, 401),
    (P.SOCKET, HOST, ORIGIN, None, OPERATOR, None, Role.OPERATE),
    (P.SOCKET, HOST, None, None, OPERATOR, None, 401),
    (P.SOCKET, HOST, None, None, None, TOKEN, Role.EDIT),
    (P.SOCKET, HOST, None, None, None, TOKEN[:-1], 401),
    (P.SOCKET, HOST, ORIGIN + "0", None, OPERATOR, TOKEN, 403),
    (P.SOCKET, HOST, "https://127.0.0.1:8000", None, OPERATOR, None, 403),
    (P.STOP, HOST, ORIGIN, "same-site", VIEWER, None, Role.VIEW),
    (P.STOP, HOST, None, "same-site", VIEWER, None, 403),
    (P.STOP, HOST, ORIGIN, "same-site", None, None, 401),
    (P.STOP, HOST, None, None, None, TOKEN, Role.EDIT),
]


@pytest.mark.parametrize("row", TABLE)
def test_the_table_of_requests(row):
    purpose, host, origin, site, cookie, bearer, answer = row
    asked = RequestClaims(
        purpose, host, origin=origin, fetch_site=site, cookie=cookie, bearer=bearer
    )
    found = decide(asked, DOOR)
    assert (found.status if isinstance(found, Denied) else found) == answer
    assert isinstance(found, Denied) == isinstance(answer, int) or isinstance(answer, Role)


def test_headers_become_what_is_asked():
    headers = {
        "host": HOST,
        "origin": ORIGIN,
        "sec-fetch-site": "same-origin",
        "cookie": f"lss_studio_80001=a; lss_studio_8000={VIEWER}; b=c",
        "authorization": f"Bearer {TOKEN}",
    }
    asked = asked_of(P.SOCKET, headers, DOOR)
    assert asked == RequestClaims(P.SOCKET, HOST, ORIGIN, "same-origin", VIEWER, TOKEN)
    assert asked_of(P.DATA, {"authorization": f"Basic {TOKEN}"}, DOOR).bearer is None


def test_a_cookie_gives_its_role_to_the_holder_of_the_token_only():
    assert role_of(OPERATOR, TOKEN) is Role.OPERATE
    assert role_of(OPERATOR, new_token()) is None
    assert make_cookie(Role.VIEW, TOKEN) != VIEWER
    assert len(TOKEN) >= 43  # 256 bits


def test_a_code_is_given_once_for_its_time_and_not_guessed():
    pairing = Pairing()
    assert pairing.give("000000", 0.0).status == 403
    code = pairing.open(Role.OPERATE, 10.0)
    assert len(code) == 6
    assert pairing.give(code, 10.0 + CODE_VALID_S) is Role.OPERATE
    assert isinstance(pairing.give(code, 11.0), Denied), "one use"
    code = pairing.open(Role.VIEW, 0.0)
    assert isinstance(pairing.give(code, CODE_VALID_S + 0.1), Denied), "two minutes"
    code = pairing.open(Role.EDIT, 0.0)
    wrong = "111111" if code != "111111" else "222222"
    answers = [pairing.give(wrong, 1.0) for _ in range(CODE_TRIES)]
    assert [answer.status for answer in answers] == [403] * (CODE_TRIES - 1) + [429]
    assert isinstance(pairing.give(code, 1.0), Denied), "five tries"
