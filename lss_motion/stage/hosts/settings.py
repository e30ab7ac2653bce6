"""How a computer takes part in the network of a stage, and the configuration of zenoh for that.

By default nothing is sent to the network: the conductor listens on the loopback. Any other address
needs keys (`keys.py`: mutual TLS, and access by the name in the certificate), or an explicit
`trust_network`. Nothing is searched for by multicast unless an interface is named for it.
"""

from __future__ import annotations

import ipaddress
import json
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

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


class NetworkSettings(Struct, frozen=True, kw_only=True):
    """One computer's place in the network of a stage."""

    stage: str
    figure: str
    conductor: str
    figures: Collection[str]
    address: str = f"127.0.0.1:{PORT}"
    """Host and port of the conductor; what it listens on, and what the others connect to."""
    spare: str = ""
    """Host and port of another computer that may conduct in its place, for the others."""
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
    others = [endpoint, *([f"{kind}/{settings.spare}"] if settings.spare else [])]
    retry = {
        "period_init_ms": RETRY_FIRST_MS,
        "period_max_ms": RETRY_MAX_MS,
        "period_increase_factor": 2,
    }
    connect: dict[str, Any] = {
        "endpoints": [] if settings.is_conductor else others,
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
