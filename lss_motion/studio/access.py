"""Which request may do what: a pure decision about Host, Origin, token, cookie and role.

The address that is printed carries a token of 256 bits behind `#`, which browsers never send. The
page gives it back once, for a cookie; a code of six digits gives the cookie of a lesser role. A
cookie proves itself: role and nonce, signed with the token. So the process that only stops decides
by the same function, without asking the server.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Mapping

TOKEN_BYTES: Final = 32
NONCE_BYTES: Final = 16
CODE_DIGITS: Final = 6
CODE_VALID_S: Final = 120.0
CODE_TRIES: Final = 5
"""With six digits, five guesses find a code once in 200,000 times."""
STRANGER: Final = "open the address that the server printed, or pair with a code"
OWN_SITE: Final = frozenset({"same-origin", "none"})
"""Values of Sec-Fetch-Site of a request that no other page has caused."""


RoleName = Literal["view", "operate", "edit"]


class Role(IntEnum):
    """What a client may do; each includes those before."""

    VIEW = 0
    OPERATE = 1
    EDIT = 2

    @property
    def word(self) -> RoleName:
        """The role as messages name it."""
        return ROLE_NAMES[self]


ROLE_NAMES: Final[tuple[RoleName, ...]] = ("view", "operate", "edit")


class Purpose(Enum):
    """What a request is for."""

    PAGE = "page"
    """Program text of the page: the same for all, without secrets."""
    SESSION = "session"
    """Token or code for a cookie."""
    DATA = "data"
    SOCKET = "socket"
    STOP = "stop"


class RequestClaims(Struct, frozen=True):
    """What a request says about itself."""

    purpose: Purpose
    host: str | None
    origin: str | None = None
    fetch_site: str | None = None
    cookie: str | None = None
    bearer: str | None = None


class Door(Struct, frozen=True):
    """What is compared with: the names of this server, the origins of its pages, the secret."""

    hosts: frozenset[str]
    origins: frozenset[str]
    token: str
    cookie_name: str

    def is_token(self, text: str) -> bool:
        """Return whether this is the token, in a time that tells nothing."""
        return hmac.compare_digest(text.encode(), self.token.encode())


class Denied(Struct, frozen=True):
    """The answer to a request that may not."""

    status: int
    text: str


def decide(asked: RequestClaims, door: Door) -> Role | Denied:
    """Return the role that a request has, or why it is denied.

    Host and Origin must be equal to ours, letter for letter. What changes anything needs our
    Origin; a client without one (curl, a script) has the token itself as bearer.
    """
    if asked.host not in door.hosts:
        return Denied(421, "this server has another name; use the address that it printed")
    if asked.purpose is Purpose.PAGE:
        return Role.VIEW
    if _is_of_another_site(asked, door):
        return Denied(403, "another site may not ask")
    if asked.bearer is not None:
        if door.is_token(asked.bearer):
            return Role.EDIT
        return Denied(401, "this token is not ours; the server printed the address with the token")
    if asked.origin is None and asked.purpose is not Purpose.DATA:
        return Denied(401, "without Origin a client sends `Authorization: Bearer TOKEN`")
    if asked.purpose is Purpose.SESSION:
        return Role.VIEW
    role = role_of(asked.cookie, door.token)
    return Denied(401, STRANGER) if role is None else role


def proved(asked: RequestClaims, door: Door) -> Role | None:
    """Return the role that a request proves by a secret, whatever it is for; None: no secret."""
    if asked.bearer is not None:
        return Role.EDIT if door.is_token(asked.bearer) else None
    return role_of(asked.cookie, door.token)


def _is_of_another_site(asked: RequestClaims, door: Door) -> bool:
    """Return whether a page that is not ours has caused a request."""
    if asked.origin is not None:
        return asked.origin not in door.origins
    return asked.fetch_site is not None and asked.fetch_site not in OWN_SITE


def new_token() -> str:
    """Return a token that is not guessed."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def make_cookie(role: Role, token: str) -> str:
    """Return the value of a cookie that gives `role`."""
    text = f"{role.word}.{secrets.token_urlsafe(NONCE_BYTES)}"
    return f"{text}.{_signature(text, token)}"


def role_of(cookie: str | None, token: str) -> Role | None:
    """Return the role that a cookie gives; None if it is none of ours."""
    if cookie is None:
        return None
    text, _, signature = cookie.rpartition(".")
    if not hmac.compare_digest(signature.encode(), _signature(text, token).encode()):
        return None
    return Role[text.partition(".")[0].upper()]


def _signature(text: str, token: str) -> str:
    return hmac.new(token.encode(), text.encode(), hashlib.sha256).hexdigest()


def asked_of(purpose: Purpose, headers: Mapping[str, str], door: Door) -> RequestClaims:
    """Return what the headers of a request say; their names are lower case."""
    scheme, _, bearer = headers.get("authorization", "").partition(" ")
    return RequestClaims(
        purpose,
        headers.get("host"),
        origin=headers.get("origin"),
        fetch_site=headers.get("sec-fetch-site"),
        cookie=_cookie(headers.get("cookie", ""), door.cookie_name),
        bearer=bearer.strip() if scheme.lower() == "bearer" else None,
    )


def _cookie(header: str, wanted: str) -> str | None:
    for part in header.split(";"):
        name, _, value = part.strip().partition("=")
        if name == wanted:
            return value
    return None


class Pairing:
    """The code that gives one more client a role: for two minutes, once, with five tries."""

    def __init__(self) -> None:
        self._code = ""
        self._role = Role.VIEW
        self._until_s = 0.0
        self._tries = 0

    def open(self, role: Role, now_s: float) -> str:
        """Return a new code for this role; the one before is void."""
        self._code = f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"
        self._role, self._until_s, self._tries = role, now_s + CODE_VALID_S, 0
        return self._code

    def give(self, code: str, now_s: float) -> Role | Denied:
        """Return the role for a code; a code that was given or guessed too often is void."""
        if not self._code or now_s > self._until_s:
            self._code = ""
            return Denied(403, "no code is valid now; make a new one at the computer of the robot")
        self._tries += 1
        if hmac.compare_digest(code.encode(), self._code.encode()):
            self._code = ""
            return self._role
        if self._tries >= CODE_TRIES:
            self._code = ""
            return Denied(429, "too many wrong codes; make a new one at the computer of the robot")
        return Denied(403, f"a wrong code; {CODE_TRIES - self._tries} more may be tried")
