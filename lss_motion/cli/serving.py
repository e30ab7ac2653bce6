"""The commands `studio`, a show in a browser, and `serve`, a stage with its cues and its page."""

from __future__ import annotations

import contextlib
import os
import secrets
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.messages import put
from lss_motion.cli.options import add_options
from lss_motion.cli.terminal import is_at_keyboard
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, InputError, install_command

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from lss_motion.cli.commands import Commands
    from lss_motion.stage.hosts.serving import Sources
    from lss_motion.stage.model import Stage
    from lss_motion.studio.access import RoleName
    from lss_motion.studio.stage_service import StageService
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


DESCRIPTION: Final = """\
See and run a show in a browser: its plan, the moving figure, the state of every servo.

  lss-motion studio wave.yaml                              at this computer
  lss-motion studio my_folder                              begin there, with nothing
  lss-motion studio wave.yaml --port /dev/ttyUSB0          on this port
  lss-motion studio wave.yaml --listen 192.168.1.20        for a tablet, too

Open the address that is printed; it holds the key to the robot, so keep it to yourself. Other
devices pair with a code that the page shows. Everyone who may look may stop, one client operates.
A file that changes on disk is planned again. Ctrl-C stops the show and ends.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_serve(commands)
    studio = add_command(commands, "studio", _studio, DESCRIPTION)
    studio.add_argument(
        "file",
        type=Path,
        metavar="FILE",
        help="a sequence, a gait, a play list or a robot (.yaml), or a folder to begin in",
    )
    add_options(studio, "--port", "--robot", "--robot-cache")
    studio.add_argument(
        "--listen",
        default="",
        metavar="ADDRESS[:PORT]",
        help="serve this address of the computer, too; :PORT alone sets the port (default: any)",
    )
    add_options(studio, "--tls-certificate", help="serve that address with TLS")
    add_options(studio, "--tls-key")
    add_options(
        studio,
        "--on-operator-lost",
        help="what a show does when its operator, or the server, is gone (default go_on)",
    )
    studio.add_argument("--no-browser", action="store_true", help="print the address only")
    add_options(studio, "--allow-run", "--json")


def _studio(arguments: argparse.Namespace) -> int:
    with needing("the studio needs three packages", "studio"):
        from lss_motion.studio.server import serve
    from lss_motion.files.source import read_data
    from lss_motion.studio.desk import DeskOptions
    from lss_motion.studio.studio import StudioOptions

    if not arguments.file.is_dir():
        read_data(arguments.file)  # What cannot be read is said here, not in the browser.
    host, port = _address(arguments.listen)
    tls = tls_of(arguments)
    options = StudioOptions(
        path=arguments.file,
        robot_path=arguments.robot,
        backup=arguments.robot_cache,
        port=arguments.port,
        listen_host=host,
        listen_port=port,
        certificate=tls.certificate,
        key=tls.key,
        desk=DeskOptions(on_lost=arguments.on_operator_lost, may_run=arguments.allow_run),
    )
    serve(
        options,
        lambda studio: _tell(studio, is_json=arguments.json),
        opens=not (arguments.no_browser or arguments.json) and has_desktop(),
    )
    return EXIT_FINISHED


def _tell(studio: Studio, *, is_json: bool) -> None:
    if is_json:
        print_json(addresses_json(studio))
        return
    print_addresses(studio, "studio")
    if len(studio.addresses) > 1:
        _print_code(studio, "operate")
        _make_codes_on_enter(studio)
    put("Ctrl-C stops the show and ends")


def _print_code(studio: Studio, role: RoleName) -> None:
    code = studio.make_code(role)
    put(f"studio: code {code[:3]} {code[3:]} gives one device the role {role}, for two minutes")


def _make_codes_on_enter(studio: Studio) -> None:
    """Let a person at the terminal make more codes: Enter, or the name of a role."""
    import asyncio

    from lss_motion.studio.access import ROLE_NAMES

    if not is_at_keyboard():
        return
    put("studio: Enter makes another code; so do the words view, operate and edit")

    def read() -> None:
        line = sys.stdin.readline()
        if not line:
            asyncio.get_running_loop().remove_reader(sys.stdin)
            return
        word = line.strip().lower() or "operate"
        for role in ROLE_NAMES:
            if role == word:
                _print_code(studio, role)
                return
        put(f"{word!r} is no role: {', '.join(ROLE_NAMES)}")

    asyncio.get_running_loop().add_reader(sys.stdin, read)


def _address(text: str) -> tuple[str | None, int]:
    """Return host and port of `--listen`."""
    host, colon, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
    if host in ("0.0.0.0", "::", "*"):  # noqa: S104  (refused)
        raise InputError(f"--listen {host}: give the one address that the tablet reaches")
    if colon and not (port.isascii() and port.isdigit() and int(port) < 65536):
        raise InputError(f"--listen {text}: the port is a number below 65536")
    return host or None, int(port) if colon else 0


def has_desktop() -> bool:
    """Return whether there is a screen to open a browser on."""
    if sys.platform == "darwin":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


SERVE_TEXT: Final = """\
Run a stage: its idle show, and the shows that cues start, until it is ended. Cues come from
sensors, keys, OSC, HTTP, MIDI, sACN, MQTT, pins, times of day and timecode, as the stage file has
them. Its page in a browser has the cues with GO, their state, the servos and STOP.

  lss-motion check hall.yaml                   what the stage would do
  lss-motion serve hall.yaml                   run it here; simulated, if its robot is
  lss-motion serve hall.yaml --port /dev/ttyUSB0 --wait-port --real-time
  lss-motion serve hall.yaml --wait-go         stand until GO
  lss-motion serve duet.yaml --figure left     one of several figures, on its own computer

At the terminal, Enter is GO, Escape stops, other keys are those of cues with `key`. Files that
change are taken between two shows; one with an error never is, the last good one stays. Ctrl-C ends
the show within the limits and gives the servos their settings back; twice ends it at once.

Of several figures each is served by itself. That of the conductor has the page, with the cues, all
computers and one STOP for all; with --go it plays the first show as soon as all are there. At the
others s and Enter stops all, ? and Enter tells the rest. With --no-pages the conductor is steered
like that, too, and cues fire by their names, or by triggers of the figures.

Exit codes: 0 ended; 2 a file or argument must change, or lines of the log could not be written; 3 a
show cannot be planned; 4 the port or the servos are not there (with --wait-port they are waited
for); 5 the robot did not follow.
"""
TOKEN_BYTES: Final = 32
TOKEN_MAX_BYTES: Final = 200


def _add_serve(commands: Commands) -> None:
    serve = add_command(
        commands,
        "serve",
        _serve,
        SERVE_TEXT,
    )
    serve.add_argument("stage", type=Path, metavar="STAGE", help="the stage file (.yaml)")
    add_options(serve, "--port", "--robot", "--robot-cache")
    serve.add_argument(
        "--wait-port",
        action="store_true",
        help="wait for the port, the servos and the network address, as long as it takes",
    )
    serve.add_argument("--wait-go", action="store_true", help="stand as found until GO")
    serve.add_argument(
        "--start-at",
        type=_instant,
        metavar="TIME",
        help="begin at this time of day or date, such as 18:30 or 2026-10-31T18:30",
    )
    add_options(serve, "--real-time")
    add_options(
        serve,
        "--on-operator-lost",
        help="what a show does when its operator is gone (default go_on)",
    )
    add_options(serve, "--tls-certificate", help="serve with TLS")
    add_options(serve, "--tls-key")
    serve.add_argument(
        "--new-token", action="store_true", help="make a new token; the old one opens nothing more"
    )
    serve.add_argument("--figure", metavar="NAME", help="of a stage with several: which one")
    serve.add_argument(
        "--no-pages", action="store_true", help="with --figure: steer by lines of the terminal"
    )
    serve.add_argument(
        "--go", action="store_true", help="with --figure: start as soon as all figures are ready"
    )
    serve.add_argument(
        "--trust-network",
        action="store_true",
        help="with --figure: use an address that others can reach without keys",
    )
    add_options(serve, "--allow-run", "--json")


def _instant(text: str) -> datetime:
    """Return the time of `--start-at`, of this computer; of a time of day the next one."""
    import argparse
    from datetime import timedelta

    now = datetime.now().astimezone()
    try:
        found = datetime.fromisoformat(text if "-" in text else f"{now:%Y-%m-%d}T{text}")
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no time, such as 18:30 or 2026-10-31T18:30"
        ) from None
    found = found.astimezone()
    return found if "-" in text or found > now else found + timedelta(days=1)


def _serve(arguments: argparse.Namespace) -> int:
    from lss_motion.stage import is_stage_file
    from lss_motion.stage.load import load_stage

    if not is_stage_file(arguments.stage):
        raise InputError("is no stage file, which has `stage: NAME`", path=arguments.stage)
    stage = load_stage(arguments.stage)
    if stage.figures or arguments.figure is not None:
        has_pages = arguments.figure == stage.conductor is not None and not arguments.no_pages
        if not has_pages:
            return _serve_figure(arguments, stage)
    with tempfile.TemporaryDirectory(prefix="lss-stage-") as views, _keys_restored():
        return _run(arguments, stage, Path(views))


def _serve_figure(arguments: argparse.Namespace, stage: Stage) -> int:
    from lss_motion.stage.hosts.serving import serve_figure

    if arguments.figure is None:
        known = ", ".join(stage.figures)
        raise InputError(
            f"has several figures, each of which is served by itself: --figure, one of {known}",
            path=arguments.stage,
        )
    sources = None
    if arguments.figure in stage.figures and stage.figures[arguments.figure].listen is not None:
        sources = _sources(stage, arguments.figure)
    return serve_figure(
        stage,
        arguments.figure,
        sources=sources,
        port=arguments.port,
        trust_network=arguments.trust_network,
        starts=arguments.go,
        is_real_time=arguments.real_time,
        print_line=put,
    )


def _sources(stage: Stage, figure: str) -> Sources:
    """Return what opens the triggers at a figure, in a thread of their own."""
    from msgspec.structs import replace

    with needing("a stage needs some packages", "stage", "studio"):
        from lss_motion.studio.inlets import inlets_thread, require_packages
    listen = stage.figures[figure].listen
    assert listen is not None
    own = replace(stage, listen=listen)
    require_packages(own)
    return lambda take: inlets_thread(own, take, lambda text: put(text, sys.stderr))


def _run(arguments: argparse.Namespace, stage: Stage, views: Path) -> int:
    with needing("a stage needs some packages", "stage", "studio"):
        from lss_motion.studio.inlets import require_packages
        from lss_motion.studio.server import serve
        from lss_motion.studio.stage_service import ServiceOptions, StageService
    from lss_motion.studio.desk import DeskOptions
    from lss_motion.studio.studio import StudioOptions
    from lss_motion.system.service import Notifier

    require_packages(stage)
    tls = tls_of(arguments)
    host, port = stage.listen.http or (None, 0)
    start_at = arguments.start_at
    job = {
        "waits_for_port": arguments.wait_port,
        "waits_for_go": arguments.wait_go,
        "start_at": None if start_at is None else start_at.isoformat(),
        "is_real_time": arguments.real_time,
    }
    if stage.figures:
        from lss_motion.stage.hosts.serving import settings_of

        settings_of(stage, arguments.figure, is_trusted=arguments.trust_network)
        job |= {"goes": arguments.go, "trusts_network": arguments.trust_network}
        del job["waits_for_port"]
    options = StudioOptions(
        path=arguments.stage,
        robot_path=arguments.robot,
        backup=arguments.robot_cache,
        port=arguments.port,
        listen_host=host,
        listen_port=port,
        certificate=tls.certificate,
        key=tls.key,
        token=_token(arguments.stage, is_new=arguments.new_token),
        views=views,
        figure=arguments.figure,
        is_early=arguments.wait_port,
        desk=DeskOptions(
            on_lost=arguments.on_operator_lost, may_run=arguments.allow_run, stage=job
        ),
    )
    services: list[StageService] = []

    def make_service(studio: Studio) -> StageService:
        notifier = Notifier.from_environment()
        own = ServiceOptions(note=lambda text: put(text, sys.stderr), notifier=notifier)
        services.append(StageService(studio, own))
        return services[-1]

    failure = serve(
        options,
        lambda studio: _tell_stage(studio, services[0], is_json=arguments.json),
        opens=False,
        make_service=make_service,
    )
    if failure is not None:
        put(f"lss-motion: {failure.text}", sys.stderr)
        return failure.exit_code
    if services and services[0].log_text:
        put(f"lss-motion: {services[0].log_text}", sys.stderr)
        return EXIT_INPUT
    return EXIT_FINISHED


def _tell_stage(studio: Studio, service: StageService, *, is_json: bool) -> None:
    """Print where the stage can be operated, and take keys."""
    if is_json:
        print_json(addresses_json(studio))
    else:
        print_addresses(studio, "stage")
        if len(studio.addresses) > 1 and is_at_keyboard():
            code = studio.make_code("operate")
            put(f"stage: code {code[:3]} {code[3:]} lets one device operate, for two minutes")
        if is_at_keyboard():
            put("Enter is GO, Escape stops, Ctrl-C ends")
    if is_at_keyboard() and not is_json:
        _take_keys(service)


def _take_keys(service: StageService) -> None:
    """Let keys of the terminal be triggers."""
    import asyncio
    import tty

    from lss_motion.playing.remote import schema as m
    from lss_motion.playing.remote import stage_messages as stage

    stdin = sys.stdin.fileno()
    tty.setcbreak(stdin)

    def read() -> None:
        data = os.read(stdin, 64)
        if not data:
            asyncio.get_running_loop().remove_reader(stdin)
        elif data == b"\x1b":
            service.take(m.Stop(), "keyboard")
        elif not data.startswith(b"\x1b"):  # An arrow, or another key without a character.
            for char in data.decode(errors="ignore"):
                if char in "\r\n":
                    service.take(m.Go(), "keyboard")
                elif char.isprintable():
                    service.take(stage.Trigger(kind="key", address=char), "keyboard")

    asyncio.get_running_loop().add_reader(stdin, read)


@contextlib.contextmanager
def _keys_restored() -> Iterator[None]:
    """Give the terminal its settings back at the end."""
    if not is_at_keyboard():
        yield
        return
    import termios

    before = termios.tcgetattr(sys.stdin.fileno())
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, before)


def _token(stage: Path, *, is_new: bool) -> str:
    """Return the token of a stage, the same after a restart: paired tablets stay paired.

    It is kept in the user's state folder, readable by that user only.
    """
    import hashlib

    from lss_motion.files.cache import own_secret
    from lss_motion.files.output import state_directory

    name = hashlib.sha256(str(stage.resolve()).encode()).hexdigest()[:16]
    path = state_directory() / "tokens" / name
    if not is_new and (secret := own_secret(path, TOKEN_MAX_BYTES)) is not None:
        kept = secret.decode("ascii", "replace").strip()
        if len(kept) > TOKEN_BYTES:
            return kept
    token = secrets.token_urlsafe(TOKEN_BYTES)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(number, "w", encoding="ascii") as file:
            file.write(token)
    except OSError as error:
        put(f"warning: the token cannot be kept, so tablets pair again: {error}", sys.stderr)
    return token
