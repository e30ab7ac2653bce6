"""The command `example`: list the packaged examples, write one into the current folder.

A wheel has them in `lss_motion/examples`, a checkout in `sequences/`. The schemas that they name
are packaged in `lss_motion/schema`; a written example gets a copy beside it.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import FORCE_REMEDY, write_output
from lss_motion.files.source import read_text

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from lss_motion.cli.commands import Commands

DESCRIPTION: Final = """\
List the examples, or write one into the current folder, with its robot and all files that it uses.

  lss-motion example             list the names and what each shows
  lss-motion example wave        write wave.yaml and robots/desk_arm.yaml
  lss-play wave.yaml             play it, simulated
"""

PACKAGE: Final = Path(__file__).resolve().parent.parent
SCHEMA: Final = re.compile(r"\$schema=(\S+)")
SUMMARY_CHARS_MAX: Final = 80
CHECKOUT_FOLDER: Final = "sequences"
SCHEMA_FOLDER: Final = "schema"

STAGES: Final = "stages/"
"""Where the examples are that are stages."""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    example = add_command(commands, "example", _example, DESCRIPTION)
    example.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="the example to write, such as wave (default: list all)",
    )
    add_options(example, "--force")


def _example(arguments: argparse.Namespace) -> int:
    names = example_names()
    if arguments.name is None:
        width = max(map(len, names))
        for name in names:
            say(f"{name:{width}}  {_summary(_file(name))}")
        return EXIT_FINISHED
    name = arguments.name.removesuffix(".yaml")
    if name not in names:
        from lss_motion.files.texts import known_names

        raise InputError(f"unknown example {arguments.name!r}; {known_names(name, names)}")
    for path in write_example(name, Path(), is_forced=arguments.force):
        say(f"wrote {path}")
    for line in _commands(name):
        say(line)
    return EXIT_FINISHED


def _commands(name: str) -> list[str]:
    """Return how a written example is played: a line, or one for each figure of a stage."""
    file = _file(name)
    if not file.startswith(STAGES):
        return [f"play it: lss-play {file}"]
    import yaml

    stage: dict[str, Any] = yaml.safe_load(_text(file))
    first, *others = _served(stage)
    lines = [f"run it: lss-motion serve {file}{first}"]
    return lines + [f"and in another terminal: lss-motion serve {file}{one}" for one in others]


def _served(stage: dict[str, Any]) -> list[str]:
    """Return the options by which the parts of a stage are served, the conductor last."""
    figures = list(stage.get("figures", ()))
    if not figures:
        return [""]
    conductor = stage.get("conductor", figures[0])
    others = [f" --figure {name}" for name in figures if name != conductor]
    return [*others, f" --figure {conductor} --go"]


def example_names() -> list[str]:
    """Return the names of all examples: shows, and stages."""
    folder = _folder()
    return sorted(path.stem for place in ("", STAGES) for path in (folder / place).glob("*.yaml"))


def _file(name: str) -> str:
    """Return the path of an example within its folder."""
    path = f"{name}.yaml"
    return path if (_folder() / path).exists() else STAGES + path


def write_example(name: str, folder: Path, *, is_forced: bool) -> list[Path]:
    """Write an example and all files that it uses; return the files that are new or replaced.

    Raises `InputError` before anything is written if a different file is in the way.
    """
    texts = {folder / part: _text(part) for part in _parts(_file(name))}
    fresh = {path: text for path, text in texts.items() if not _has(path, text)}
    for path in fresh:
        if path.exists() and not is_forced:
            raise InputError(f"exists already; {FORCE_REMEDY}", path=path)
    for path, text in fresh.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"cannot be written: its folder cannot be made: {error.strerror}", path=path
            ) from error
        write_output(path, text)
    return list(fresh)


def _folder() -> Path:
    packaged = PACKAGE / "examples"
    found = packaged if packaged.is_dir() else PACKAGE.parent / CHECKOUT_FOLDER
    if not found.is_dir():
        raise InputError("this installation has no examples; install lss-motion again")
    return found


def _text(part: str) -> str:
    """Return a file of the examples; its comments name commands and schemas as written copies."""
    is_schema = part.startswith(f"{SCHEMA_FOLDER}/")
    text = ((PACKAGE if is_schema else _folder()) / part).read_text(encoding="utf-8")
    text = text.replace(f"../{PACKAGE.name}/{SCHEMA_FOLDER}/", f"{SCHEMA_FOLDER}/")
    return text.replace(f"{CHECKOUT_FOLDER}/", "")


def _has(path: Path, text: str) -> bool:
    try:
        return read_text(path) == text
    except InputError:
        return False


def _parts(name: str) -> list[str]:
    """Return the paths of an example and of all files that it uses, relative to its folder."""
    found, pending = [], [name]
    while pending:
        part = pending.pop()
        if part not in found:
            found.append(part)
            pending += [posixpath.normpath(posixpath.join(posixpath.dirname(part), other))
                        for other in _references(part)]  # fmt: skip
    return found


def _references(part: str) -> Iterator[str]:
    """Yield every path of another file in the text of a file, relative to its folder."""
    if not part.endswith(".yaml"):
        return
    import yaml

    text = _text(part)
    if schema := SCHEMA.search(text):  # Editors use it to complete and check.
        yield schema[1]
    pending: list[Any] = [yaml.safe_load(text)]
    while pending:
        match pending.pop():
            case dict() as table:
                pending += table.values()
            case list() as row:
                pending += row
            case str() as value if value.endswith(".yaml"):
                yield value
            case _:
                pass


def _summary(path: str) -> str:
    """Return the first sentence at the head of an example; only up to `:` if it is long."""
    words = []
    for line in _text(path).splitlines():
        if not line.startswith("#"):
            break
        if SCHEMA.search(line) is None:
            words += line.lstrip("# ").split()
    sentence = re.match(r".*?\.(?=\s|$)", " ".join(words))
    text = "" if sentence is None else sentence[0].rstrip(".")
    return text if len(text) <= SUMMARY_CHARS_MAX else text.partition(":")[0]
