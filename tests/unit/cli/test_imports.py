"""What the programs import: an answer at once needs no numbers and no port, a check no gaits."""

import argparse
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from lss_motion.cli.commands import COMMAND_GROUPS, COMMANDS
from lss_motion.planning.kept import MAKERS

EXAMPLES = Path(__file__).parents[3] / "sequences"

HEAVY = ("numpy", "scipy", "toppra", "yaml", "serial", "rich", "matplotlib")

MODULES = tuple(dict.fromkeys(module for module, _ in COMMANDS.values()))

SET_BY_CLI = ("OPENBLAS_NUM_THREADS",)
"""Environment variables that `lss_motion.cli` sets unless the user does."""


@pytest.mark.parametrize("program", ["play", "main"])
def test_help_imports_no_heavy_library(program) -> None:
    code = (
        "import sys\n"
        f"from lss_motion.cli.start import {program} as run\n"
        "try:\n    run()\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', *(name for name in {HEAVY} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True
    )
    assert "usage:" in done.stdout
    assert done.stdout.splitlines()[-1].strip() == "loaded:"


def test_the_list_of_commands_imports_none_of_them() -> None:
    code = (
        "import sys\n"
        "from lss_motion.cli.start import _main as run\n"
        "try:\n    run()\nexcept SystemExit:\n    pass\n"
        "print('loaded:', *(name for name in sys.modules if name.startswith('lss_motion.cli.')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True
    )
    assert all(f"  {name} " in done.stdout.replace("\n", " ") for name in COMMANDS)
    loaded = done.stdout.splitlines()[-1].split()[1:]
    assert set(loaded) == {
        f"lss_motion.cli.{name}" for name in ("commands", "main", "messages", "start")
    }


def test_without_a_command_the_list_of_commands_is_printed_by_what_a_person_wants() -> None:
    done = [
        subprocess.run(
            [sys.executable, "-m", "lss_motion", *words], capture_output=True, text=True, check=True
        ).stdout
        for words in ([], ["--help"])
    ]
    assert done[0] == done[1]
    at = [done[0].index(f"\n{title}:\n") for title in COMMAND_GROUPS]
    assert at == sorted(at)
    listed = re.findall(r"^  ([a-z][a-z-]*) ", done[0], re.MULTILINE)
    assert listed == list(COMMANDS)


def test_check_imports_its_own_command_and_no_gait() -> None:
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from lss_motion.cli.start import main\n"
        "main()\n"
        "print('threads:', len(list(Path('/proc/self/task').glob('*'))))\n"
        "print('loaded:', *sorted(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "check", str(EXAMPLES / "wave.yaml")],
        capture_output=True,
        text=True,
        check=True,
        env={name: text for name, text in os.environ.items() if name not in SET_BY_CLI},
    )
    *checked, threads, last = done.stdout.splitlines()
    assert "every keyframe is on time" in checked
    assert threads in {"threads: 1", "threads: 0"}  # 0: not Linux
    loaded = set(last.split())
    assert {"lss_motion.cli.planning", "lss_motion.planning.trajectory.planner"} <= loaded
    others = {f"lss_motion.cli.{module}" for module in MODULES} - {"lss_motion.cli.planning"}
    needless = {"numpy.ma", "scipy", "serial", "rich", "lss_motion.show.gait.load"}
    needless |= {"lss_motion.stage.load", "lss_motion.stage.model"}
    assert not loaded & (others | needless)


def _loaded_by_play(tmp_path: Path) -> set[str]:
    """Return the modules that are loaded when the first byte of motion leaves."""
    code = (
        "import re, sys\n"
        "from lss_motion.cli.start import play\n"
        "from lss_motion.sim.bus import SimBus\n"
        "write = SimBus.write\n"
        "def look(self, data, now_ns):\n"
        "    if re.search(rb'\\d+D-?\\d+T', data) and not look.loaded:\n"
        "        look.loaded = sorted(sys.modules)\n"
        "    write(self, data, now_ns)\n"
        "look.loaded, SimBus.write = [], look\n"
        "play()\n"
        "print('loaded:', *look.loaded)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(EXAMPLES / "wave.yaml"), "--virtual", "--loop", "1"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "LSS_MOTION_CACHE_DIR": str(tmp_path)},
    )
    return set(done.stdout.splitlines()[-1].split()[1:])


@pytest.mark.slow
def test_a_kept_show_is_played_without_what_reads_and_makes_shows(tmp_path) -> None:
    made, kept = _loaded_by_play(tmp_path), _loaded_by_play(tmp_path)
    assert {"yaml", "lss_motion.planning.trajectory.planner"} <= made
    assert {"lss_motion.planning.program.verify", "lss_motion.playing.player.player"} <= kept
    libraries = {
        "yaml",
        "scipy",
        "toppra",
        "rich",
        "serial",
        "platformdirs",
        "numpy.ma",
    }
    makers = {
        *(f"lss_motion.planning.trajectory.{name}" for name in ("planner", "kept_plans", "tracks")),
        *(f"lss_motion.planning.program.{name}" for name in ("compile", "drives", "fit", "search")),
        *(f"lss_motion.{name}" for name in ("robot.load", "robot.learnt", "sequence.load")),
        *("lss_motion.files.yaml_source", "lss_motion.files.validation", "lss_motion.playing.api"),
        *("lss_motion.cli.display", "lss_motion.cli.report", "lss_motion.playing.report"),
        *("lss_motion.playing.performer", "subprocess", "zipfile"),
    }
    assert not kept & (libraries | makers)
    # What made the show is in the hash of its version: `planning.show_cache.MAKERS`, or the top
    # folder.
    parts = {tuple(name.split(".")[1:]) for name in made - kept if name.startswith("lss_motion.")}
    others = {part[0] for part in parts if len(part) > 1 and part[0] not in MAKERS}
    assert others <= {"cli"}


@pytest.mark.parametrize("module", MODULES)
def test_the_table_of_commands_says_what_each_module_adds(module) -> None:
    added: list[str] = []

    class Commands:
        def add_parser(self, name, **options):
            added.append(name)
            return argparse.ArgumentParser()

    importlib.import_module(f"lss_motion.cli.{module}").add_to(Commands())
    assert sorted(added) == sorted(name for name, row in COMMANDS.items() if row[0] == module)
