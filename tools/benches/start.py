"""How much processor time commands take to start: to their end, and to the first byte of motion.

Each command is a process of its own, with bytecode, as on a user's machine. What counts is its user
and system time, from its start to its end, or (`first byte`) to the first move that is written to a
simulated bus. The reference is `python -c "import numpy"` in each round: on a busy machine all of
them take two to four times as long, and only the ratio can be compared.

What Structs save (FACTS.md N24), in alternating runs with the version before them: `lss-play wave
--dry-run` takes 0.29 s and not 0.38. On a busy machine: `check wave` 0.39 s and not 0.49, `send QV`
0.62 and not 0.70, `scan` 0.73 and not 0.83; `--help` 0.10 in both.

Where it went for wave.yaml from the cache before that, in one run on a busy machine, where `import
numpy` took 187 ms: Python 32, the command and its arguments 81, what is left of numpy 93, the
values of a show with their modules 103, the verifier 22, player and ports 100, simulator 35, the
check of the servos and the approach 57; 523 ms in all.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from benches.table import Row

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SEQUENCES = Path(__file__).resolve().parents[2] / "sequences"
SHOWS = ("wave", "show", "hexapod_walk", "playlist", "quadruped_trot")
ROUNDS = 10
SHORT_ROUNDS = 4
NUMPY = (sys.executable, "-c", "import numpy")

CHILD = """
import sys
from lss_motion.cli.start import {program} as run
sys.exit(run())
"""
FIRST_BYTE = """
import os, re, sys, time

class Watch:
    "Lets the simulated bus end the process at its first move."
    def find_spec(self, name, path, target=None):
        if name != "lss_motion.sim.bus":
            return None
        sys.meta_path.remove(self)
        spec = next(filter(None, (f.find_spec(name, path, target) for f in sys.meta_path)))
        load = spec.loader.exec_module
        def watched(module):
            load(module)
            write = module.SimBus.write
            def look(bus, data, now_ns):
                if re.search(rb"[0-9]D-?[0-9]+T", data):
                    os.write(1, b"%d" % time.process_time_ns())
                    os._exit(0)
                write(bus, data, now_ns)
            module.SimBus.write = look
        spec.loader.exec_module = watched
        return spec

sys.meta_path.insert(0, Watch())
from lss_motion.cli.start import play
sys.exit(play())
"""


def measure(rounds: int = ROUNDS) -> list[Row]:
    """Return a row for each command and show."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ,
            "LSS_MOTION_CACHE_DIR": f"{folder}/cache",
            "LSS_MOTION_STATE_DIR": f"{folder}/state",
        }
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        main, play = (CHILD.format(program=name) for name in ("main", "play"))
        wave, arm = str(SEQUENCES / "wave.yaml"), str(SEQUENCES / "robots" / "desk_arm.yaml")
        commands: dict[str, tuple[str, ...]] = {
            "lss-motion --help": (main, "--help"),
            "lss-play --help": (play, "--help"),
            "lss-motion send QV": (
                main,
                "send",
                "QV",
                "--id",
                "1",
                "--robot",
                arm,
                "--port",
                "sim://",
            ),
            "lss-motion scan": (main, "scan", "sim://", "--robot", arm),
        }
        for name in SHOWS:
            path = str(SEQUENCES / f"{name}.yaml")
            commands[f"lss-play {name} --dry-run"] = (play, path, "--dry-run")
            commands[f"lss-play {name}, first byte"] = (FIRST_BYTE, path, "--virtual", "--quiet")
        commands["lss-motion check wave"] = (main, "check", wave)
        runs = {name: (sys.executable, "-c", *words) for name, words in commands.items()}
        made_s = {name: _taken_s(words, environment) for name, words in runs.items()}
        taken_s: dict[str, list[float]] = {name: [] for name in ("numpy", *runs)}
        for _ in range(rounds):
            for name, words in {"numpy": NUMPY, **runs}.items():
                taken_s[name].append(_taken_s(words, environment))
    numpy_s = statistics.median(taken_s["numpy"])
    return [
        Row(
            what=name,
            ours=f"{statistics.median(taken_s[name]):.3f} s, least {min(taken_s[name]):.3f}"
            + (f", made {made_s[name]:.3f}" if "--dry-run" in name else ""),
            reference=f"{numpy_s:.3f} s (import numpy)",
            ratio=statistics.median(taken_s[name]) / numpy_s,
        )
        for name in runs
    ]


def measure_short() -> list[Row]:
    """Return the same with fewer rounds."""
    return measure(SHORT_ROUNDS)


def _taken_s(words: Sequence[str], environment: Mapping[str, str]) -> float:
    """Return the processor time of a command, or what it prints itself, to its first byte."""
    before = os.times()
    done = subprocess.run(words, env=dict(environment), capture_output=True, text=True, check=False)
    after = os.times()
    if FIRST_BYTE in words:
        return int(done.stdout.splitlines()[-1]) / 1e9
    if done.returncode:
        raise RuntimeError(f"{words[2:]}: {done.stdout}{done.stderr}")
    return (
        after.children_user + after.children_system - before.children_user - before.children_system
    )
