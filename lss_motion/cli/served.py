"""What `studio` and `serve` share: the files of TLS, and what they print of their server."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, NamedTuple

from lss_motion.cli.messages import put
from lss_motion.errors import InputError, install_command

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.studio.studio import Studio


@contextlib.contextmanager
def needing(what: str, *extras: str) -> Iterator[None]:
    """Import the server; raises `InputError` where a package of `extras` is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("lss_motion"):
            raise
        raise InputError(f"{what}: {install_command(*extras)}") from None


class Tls(NamedTuple):
    """The files of TLS, both or none."""

    certificate: str | None
    key: str | None


def tls_of(arguments: argparse.Namespace) -> Tls:
    """Return the files of TLS; raises `InputError` for one alone, or one that cannot be read."""
    from lss_motion.files.source import read_data

    paths: tuple[Path | None, ...] = (arguments.tls_certificate, arguments.tls_key)
    if paths.count(None) == 1:
        raise InputError("--tls-certificate and --tls-key belong together")
    for path in paths:
        if path is not None:
            read_data(path)
    return Tls(*(None if path is None else str(path) for path in paths))


def addresses_json(studio: Studio) -> dict[str, object]:
    """Return where a server can be reached, for `--json`."""
    return {
        "url": studio.url,
        "token": studio.door.token,
        "stop": studio.stop_addresses[0].origin,
        "addresses": [address.origin for address in studio.addresses],
        "stops": [address.origin for address in studio.stop_addresses],
    }


def print_addresses(studio: Studio, name: str) -> None:
    """Print where a server can be reached, each line after `name`."""
    put(f"{name}: {studio.url}")
    if studio.is_network_readable:
        put(
            "warning: without TLS others on this network can read along and take over; give "
            "--tls-certificate and --tls-key",
            sys.stderr,
        )
    for address in studio.addresses[1:]:
        put(f"{name}: {address.origin}/")
