"""One computer's session with the others: zenoh, and nothing else of this package imports it.

By default nothing is sent to the network: the conductor listens on the loopback. Any other address
needs keys (mutual TLS, and access by the name in the certificate), or an explicit `trust_network`.
Nothing is searched for by multicast unless an interface is named for it.

Keys of a stage are a small authority, and a certificate for each figure with its name. The key of
the authority (`ca.key`) stays where the keys were made and is on no computer of the stage: with it
more figures can be made.

zenoh has threads. They put what arrives into a queue (`Peer.take`), with the instant at which it
arrived; a question about the clock is answered by the thread itself. Nothing here waits for the
network: what finds no room is dropped, since every message is repeated.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import ipaddress
import json
import os
import queue
import threading
import time
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct

from lss_motion.errors import BusError, InputError, install_command
from lss_motion.stage.hosts.messages import (
    MESSAGE_MAX_BYTES,
    ClockAnswer,
    ClockQuestion,
    hash_of,
    packed,
    parse,
)
from lss_motion.stage.hosts.plans import PLAN_MAX_BYTES
from lss_motion.system.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import Certificate

INBOX_MAX: Final = 2000
"""Messages that were not taken yet; newer ones are dropped. Chosen: 200 figures for two seconds."""
FETCH_S: Final = 20.0
"""An answer may take so long: 64 MB over a slow Wi-Fi."""

What = Literal["message", "alive", "gone", "content", "no content"]


class NetworkArrival(Struct, frozen=True):
    """What arrived: below the name of the stage, at this instant of the own clock."""

    what: What
    key: str
    content: bytes
    at_ns: int


class Peer(Closing):
    """An open session. `clock_id` is the process whose clock is told to those who ask."""

    def __init__(
        self,
        settings: NetworkSettings,
        *,
        clock_id: str = "",
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open the session; raises `InputError` for settings, `BusError` where it fails."""
        check_settings(settings)
        try:
            import zenoh
        except ModuleNotFoundError:
            raise InputError(
                f"shows on several computers need a package: {install_command('network')}"
            ) from None
        self._zenoh = zenoh
        self._now_ns = now_ns
        self._top = settings.stage
        self._clock_id = clock_id
        self._inbox: queue.Queue[NetworkArrival] = queue.Queue(INBOX_MAX)
        self._fetching: set[str] = set()
        self._kept: list[Any] = []
        self.dropped = 0
        """Messages that found no room in the inbox."""
        self.sent_bytes = self.received_bytes = 0
        try:
            self._session = zenoh.open(zenoh.Config.from_json5(json_of(settings)))
        except Exception as error:  # noqa: BLE001  (zenoh raises its own, and panics)
            raise BusError(f"the network of stage {settings.stage!r}: {error}") from None

    # ---- what arrives

    def take(self, timeout_s: float) -> list[NetworkArrival]:
        """Return what has arrived; wait for it, at most so long."""
        found: list[NetworkArrival] = []
        with contextlib.suppress(queue.Empty):
            found.append(self._inbox.get(timeout=timeout_s))
            while True:
                found.append(self._inbox.get_nowait())
        return found

    def subscribe(self, key: str) -> None:
        """Receive messages with this key; `*` stands for a name."""
        handler = self._session.declare_subscriber(f"{self._top}/{key}", self._message)
        self._kept.append(handler)

    def watch(self, key: str) -> None:
        """Receive `alive` and `gone` of the tokens with this key."""
        handler = self._session.liveliness().declare_subscriber(
            f"{self._top}/{key}", self._token, history=True
        )
        self._kept.append(handler)

    def announce(self, key: str) -> None:
        """Let others know that this process lives."""
        self._kept.append(self._session.liveliness().declare_token(f"{self._top}/{key}"))

    def answer_clock(self) -> None:
        """Answer questions about the clock, at once and in zenoh's thread."""
        handler = self._session.declare_subscriber(f"{self._top}/figure/*/clock", self._clock)
        self._kept.append(handler)

    def serve(self, content_of: Callable[[str], bytes | None]) -> None:
        """Answer queries for content by its hash."""

        def answer(query: Any) -> None:  # noqa: ANN401  (zenoh is imported when it is needed)
            name = str(query.key_expr).rpartition("/")[2]
            content = content_of(name)
            if content is not None:
                self.sent_bytes += len(content)
                query.reply(query.key_expr, content)
            query.drop()

        self._kept.append(self._session.declare_queryable(f"{self._top}/plan/*", answer))

    def _message(self, sample: Any) -> None:  # noqa: ANN401
        at_ns = self._now_ns()
        content = sample.payload.to_bytes()
        self.received_bytes += len(content)
        if len(content) <= MESSAGE_MAX_BYTES:
            self._put("message", str(sample.key_expr), content, at_ns)

    def _token(self, sample: Any) -> None:  # noqa: ANN401
        is_alive = sample.kind == self._zenoh.SampleKind.PUT
        what: What = "alive" if is_alive else "gone"
        self._put(what, str(sample.key_expr), b"", self._now_ns())

    def _clock(self, sample: Any) -> None:  # noqa: ANN401
        received_ns = self._now_ns()
        name = str(sample.key_expr).split("/")[2]
        with contextlib.suppress(InputError):
            asked = parse(ClockQuestion, sample.payload.to_bytes(), 200)
            answer = ClockAnswer(
                asked_ns=asked.asked_ns,
                received_ns=received_ns,
                answered_ns=self._now_ns(),
                instance=self._clock_id,
            )
            self.send(f"clock/{name}", packed(answer))

    def _put(self, what: What, key: str, content: bytes, at_ns: int) -> None:
        try:
            self._inbox.put_nowait(
                NetworkArrival(what, key.removeprefix(f"{self._top}/"), content, at_ns)
            )
        except queue.Full:
            self.dropped += 1

    # ---- what is sent

    def send(self, key: str, content: bytes) -> None:
        """Send a message, or drop it where the network takes none."""
        zenoh = self._zenoh
        self.sent_bytes += len(content)
        with contextlib.suppress(zenoh.ZError):
            self._session.put(
                f"{self._top}/{key}",
                content,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )

    def fetch(self, name: str) -> None:
        """Ask for content by its hash; it arrives as `content`, checked, or as `no content`."""
        if name in self._fetching:
            return
        self._fetching.add(name)
        threading.Thread(target=self._fetch, args=(name,), daemon=True).start()

    def _fetch(self, name: str) -> None:
        found = None
        try:
            for reply in self._session.get(f"{self._top}/plan/{name}", timeout=FETCH_S):
                if reply.ok is None:
                    continue
                content = reply.ok.payload.to_bytes()
                self.received_bytes += len(content)
                if len(content) <= PLAN_MAX_BYTES and hash_of(content) == name:
                    found = content
                    break
        except self._zenoh.ZError:
            pass
        finally:
            self._fetching.discard(name)
        what: What = "no content" if found is None else "content"
        self._put(what, f"{self._top}/plan/{name}", found or b"", self._now_ns())

    def close(self) -> None:
        """Leave the network."""
        for handler in reversed(self._kept):
            with contextlib.suppress(Exception):
                handler.undeclare()
        with contextlib.suppress(Exception):
            self._session.close()  # type: ignore[no-untyped-call]


PORT: Final = 7447
LEASE_MS: Final = 1000
"""A cut cable is noticed after this time; by default it takes 10 s (measured)."""
KEEP_ALIVES: Final = 4
"""In a lease; a link counts as failed when 3.5 of them are missing."""
RETRY_FIRST_MS: Final = 200
RETRY_MAX_MS: Final = 1000
"""A computer that starts first, or a healed cable, is found within a second."""
MESSAGES: Final = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
"""All kinds of messages that access control knows."""


YEARS: Final = 10
"""Chosen: a figure is not to stop on the evening on which a certificate ends. Keys of a lost
computer are made worthless by new keys for all."""


class NetworkSettings(Struct, frozen=True, kw_only=True):
    """One computer's place in the network of a stage."""

    stage: str
    figure: str
    conductor: str
    figures: Collection[str]
    address: str = f"127.0.0.1:{PORT}"
    """Host and port of the conductor; what it listens on, and what the others connect to."""
    keys: Path | None = None
    """A folder made by `lss-motion stage-keys`."""
    scouting: str = ""
    """The interface on which computers find each other; empty: by the address only."""
    is_trusted: bool = False
    """Whether this network may be used without keys."""
    is_visitor: bool = False
    """A second process on the conductor's computer, which asks the one that conducts."""

    @property
    def is_conductor(self) -> bool:
        return self.figure == self.conductor and not self.is_visitor

    @property
    def host(self) -> str:
        """The host of `address`, without brackets."""
        return self.address.rpartition(":")[0].strip("[]")


def is_loopback(host: str) -> bool:
    """Return whether a host is this computer and no other can reach it."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return False


def check_settings(settings: NetworkSettings) -> None:
    """Raise `InputError` for what would be open to everyone, or cannot work."""
    host, _, port = settings.address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(
            f"address {settings.address!r} of the conductor: HOST:PORT, such as 192.168.1.20:{PORT}"
        )
    if settings.figure not in settings.figures:
        known = ", ".join(sorted(settings.figures))
        raise InputError(f"the stage has no figure {settings.figure!r}; it has {known}")
    is_open = not is_loopback(settings.host) or bool(settings.scouting)
    if is_open and settings.keys is None and not settings.is_trusted:
        raise InputError(
            f"{settings.address} can be reached from other computers, and there are no keys: "
            f"make them with `lss-motion stage-keys`, and name their folder in the stage file "
            f"(network: {{keys: …}}); on a network that only you can reach, --trust-network does"
        )
    if settings.keys is not None:
        for name in ("ca.pem", f"{settings.figure}.pem", f"{settings.figure}.key"):
            if not (settings.keys / name).is_file():
                raise InputError(
                    f"{settings.keys / name} is missing: `lss-motion stage-keys` makes keys for "
                    f"every figure; copy ca.pem and the two files of this figure here"
                )


def configuration(settings: NetworkSettings) -> dict[str, Any]:
    """Return the configuration of zenoh."""
    kind = "tls" if settings.keys else "tcp"
    endpoint = f"{kind}/{settings.address}"
    retry = {
        "period_init_ms": RETRY_FIRST_MS,
        "period_max_ms": RETRY_MAX_MS,
        "period_increase_factor": 2,
    }
    connect: dict[str, Any] = {
        "endpoints": [] if settings.is_conductor else [endpoint],
        "timeout_ms": -1,
        "exit_on_failure": False,
        "retry": retry,
    }
    listen = {
        "endpoints": [endpoint] if settings.is_conductor else [],
        "timeout_ms": 0,
        "exit_on_failure": True,
    }
    found: dict[str, Any] = {
        "mode": "peer",
        "connect": connect,
        "listen": listen,
        # Every figure has one link, to the conductor.
        "scouting": {
            "multicast": {"enabled": bool(settings.scouting)},
            "gossip": {"enabled": False},
        },
        "timestamping": {"enabled": False},
        "adminspace": {"enabled": False},
        "transport": {
            "link": {"tx": {"lease": LEASE_MS, "keep_alive": KEEP_ALIVES}},
            "shared_memory": {"enabled": False},
        },
    }
    if settings.scouting:
        found["scouting"]["multicast"] |= {"interface": settings.scouting, "ttl": 1}
    if settings.keys is not None:
        found["transport"]["link"]["tls"] = _tls(settings)
        found["access_control"] = access_control(settings)
    return found


def _tls(settings: NetworkSettings) -> dict[str, Any]:
    assert settings.keys is not None
    own = {
        "certificate": str(settings.keys / f"{settings.figure}.pem"),
        "private_key": str(settings.keys / f"{settings.figure}.key"),
    }
    return {
        "root_ca_certificate": str(settings.keys / "ca.pem"),
        "enable_mtls": True,
        # Certificates name figures, not hosts: access control checks the name.
        "verify_name_on_connect": False,
        **{f"listen_{name}": value for name, value in own.items()},
        **{f"connect_{name}": value for name, value in own.items()},
    }


def access_control(settings: NetworkSettings) -> dict[str, Any]:
    """Return who may say what to this computer: a figure its own keys, the conductor the rest."""
    top = settings.stage
    common = [f"{top}/beat", f"{top}/stop", f"{top}/plan/**", f"{top}/conductor/**"]
    rules, subjects, policies = [], [], []
    for name in sorted(settings.figures):
        own = [f"{top}/figure/{name}/**", f"{top}/clock/{name}"]
        if name == settings.conductor:
            keys = [*common, f"{top}/figure/**", f"{top}/clock/**", f"{top}/examined/**"]
        else:
            keys = [*own, *common]
        # What a figure sends is its own; what it subscribes and queries is the conductor's.
        published = [f"{top}/**"] if name == settings.conductor else [f"{top}/figure/{name}/**"]
        rules += [
            {
                "id": f"{name}-says",
                "permission": "allow",
                "flows": ["ingress"],
                "messages": ["put", "delete", "reply", "declare_queryable", "liveliness_token"],
                "key_exprs": published,
            },
            {
                "id": f"{name}-asks",
                "permission": "allow",
                "flows": ["ingress"],
                "messages": [
                    "query",
                    "declare_subscriber",
                    "liveliness_query",
                    "declare_liveliness_subscriber",
                ],
                "key_exprs": keys,
            },
            {
                "id": f"{name}-gets",
                "permission": "allow",
                "flows": ["egress"],
                "messages": list(MESSAGES),
                "key_exprs": [f"{top}/**"],
            },
        ]
        subjects.append({"id": name, "cert_common_names": [name]})
        policies.append(
            {"rules": [f"{name}-says", f"{name}-asks", f"{name}-gets"], "subjects": [name]}
        )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def json_of(settings: NetworkSettings) -> str:
    """Return the configuration as the JSON that zenoh reads."""
    return json.dumps(configuration(settings))


def make_keys(stage: str, figures: Collection[str], folder: Path) -> list[Path]:
    """Write authority and keys into a new or empty `folder`; return the files.

    With an authority that is there already, only figures without keys get some.
    """
    try:
        from cryptography import x509
    except ModuleNotFoundError:
        raise InputError(f"keys need a package: {install_command('network')}") from None
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    authority, authority_key = folder / "ca.pem", folder / "ca.key"
    if authority.exists() != authority_key.exists():
        raise InputError(
            f"{folder} has one of ca.pem and ca.key only: both are needed to make more keys; "
            f"give another folder to begin anew"
        )
    if authority.exists():
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        issuer = x509.load_pem_x509_certificate(authority.read_bytes())
        issuer_key = load_pem_private_key(authority_key.read_bytes(), None)
    else:
        issuer_key = _new_key()
        issuer = _certificate(f"stage {stage}", issuer_key, None, issuer_key)
        written += [_write(authority, _pem(issuer)), _write(authority_key, _key_pem(issuer_key))]
    for name in sorted(figures):
        path, key_path = folder / f"{name}.pem", folder / f"{name}.key"
        if path.exists() or key_path.exists():
            continue
        key = _new_key()
        certificate = _certificate(name, key, issuer, issuer_key)  # type: ignore[arg-type]
        written += [_write(path, _pem(certificate)), _write(key_path, _key_pem(key))]
    return written


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _certificate(
    name: str,
    key: EllipticCurvePrivateKey,
    issuer: Certificate | None,
    issuer_key: EllipticCurvePrivateKey,
) -> Certificate:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    # A certificate is judged by wall clocks, and that of a small computer may be behind.
    begin = dt.datetime(2020, 1, 1, tzinfo=dt.UTC)
    end = dt.datetime.now(dt.UTC) + dt.timedelta(days=365 * YEARS)
    is_authority = issuer is None
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
    )
    if not is_authority:
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        builder = builder.add_extension(
            x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False
        )
    return builder.sign(issuer_key, hashes.SHA256())


def _pem(certificate: Certificate) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding

    return certificate.public_bytes(Encoding.PEM)


def _key_pem(key: EllipticCurvePrivateKey) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _write(path: Path, content: bytes) -> Path:
    """Write a new file that only its owner may read."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    return path
