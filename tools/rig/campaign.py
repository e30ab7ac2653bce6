"""Faults of many computers by seed, in network namespaces, judged at every servo.

    tools/run python tools/rig/campaign.py [--runs 20] [--seed 0] [--hosts 3] [--keep FOLDER]

A run: three hosts with their simulated robots, a line like Wi-Fi or a plain one, a show, and one
fault at a random instant: conductor killed, cable cut and healed, host restarted, player killed,
clock jumped, stale conductor, storm of messages, wrong keys. Whatever happens, no servo may get
what breaks a limit, and the last thing that it gets is to hold (`tools/judge`, which shares no code
with the package); and every host must have logged what it did. Prints a line a run; exits with 1
if one was unsafe or unexplained.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.stage import PLAIN, WIFI, RigStage, why_not

if TYPE_CHECKING:
    from collections.abc import Callable

FAULTS: Final = (
    "none",
    "conductor killed",
    "cable cut",
    "host restarted",
    "figure killed",
    "clock jumped",
    "stale conductor",
    "storm",
    "wrong keys",
)
START_S: Final = 180.0


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=len(FAULTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hosts", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="keep logs and verdicts of bad runs here")
    arguments = parser.parse_args()
    if why := why_not():
        print(why, file=sys.stderr)
        return 2
    bad = 0
    for seed in range(arguments.seed, arguments.seed + arguments.runs):
        fault = FAULTS[seed % len(FAULTS)]
        began = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="lss-rig-") as folder:
            problems = one_run(Path(folder), seed, fault, arguments.hosts)
            if problems and arguments.keep is not None:
                shutil.copytree(folder, arguments.keep / f"{seed}", dirs_exist_ok=True)
        verdict = "; ".join(problems) or "safe"
        print(f"{seed:4} {fault:16} {time.monotonic() - began:5.0f} s  {verdict}", flush=True)
        bad += bool(problems)
    print(f"{arguments.runs} runs, {bad} bad")
    return 1 if bad else 0


def one_run(folder: Path, seed: int, fault: str, hosts: int) -> list[str]:
    """Play one show with one fault; return what was unsafe or not explained."""
    random = Random(f"{seed}/{fault}")
    victim = f"f{random.randint(1, hosts - 1)}"
    others = random.choice(("go_on", "slow", "hold"))
    keys = make_keys(folder, hosts, victim) if fault == "wrong keys" else None
    jumps = {}
    if fault == "clock jumped":
        jump_ns = round(random.choice((-1, 1)) * random.uniform(0.02, 0.6) * 1e9)
        jumps = {victim: (time.monotonic_ns() + round(random.uniform(12, 18) * 1e9), jump_ns)}
    with RigStage(
        folder,
        hosts=hosts,
        seed=seed,
        line=random.choice((PLAIN, WIFI)),
        show_s=6,
        others=others,
        ppm=100.0,
        jumps=jumps,
        keys=keys,
    ) as rig:
        rig.start_all()
        missing: list[str] = []
        with contextlib.suppress(TimeoutError):
            play(rig, fault, victim, random, missing)
        verdicts = rig.end()
        logs = {name: rig.log(name) for name in rig.names}
    problems = [f"{name}: {text}" for name, one in verdicts.items() for text in one["objections"]]
    problems += missing
    problems += [f"{name}: a traceback" for name, log in logs.items() if "Traceback" in log]
    return problems


def play(rig: RigStage, fault: str, victim: str, random: Random, missing: list[str]) -> None:
    """Bring the show to play, let the fault happen, and wait for what must follow."""

    def expect(name: str, pattern: str, seconds: float, after: int = 0) -> int:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := re.compile(pattern).search(rig.log(name), after):
                return found.end()
            time.sleep(0.05)
        missing.append(f"{name} has not logged {pattern!r}")
        raise TimeoutError

    if fault == "wrong keys":
        expect("f0", f"{victim}: it has not connected", START_S)
        rig.say("f0", "g")
        expect("f0", f"refused: .*{victim}", 20.0)
        return
    for name in rig.names:
        expect(name, "-> ready", START_S)
    try:
        rig.go()
    except TimeoutError:
        missing.append("no start")
        raise
    time.sleep(random.uniform(0.0, 3.0))
    marks = {name: len(rig.log(name)) for name in rig.names}
    DEEDS[fault](rig, victim, random, lambda n, p, s: expect(n, p, s, marks[n]))


def _none(rig: RigStage, _victim: str, _random: Random, expect: Callable[..., int]) -> None:
    for name in rig.names:
        expect(name, "-> ended", 40.0)


def _conductor(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    number = random.choice((signal.SIGKILL, signal.SIGTERM))
    rig.kill("f0", number)
    if number == signal.SIGKILL:
        expect(victim, "-> freewheeling", 10.0)
        expect(victim, "-> holding|-> ended", 20.0)
    else:
        expect(victim, "stops: the conductor stopped all|-> ended", 20.0)
        return
    rig.start("f0")
    expect("f0", "-> ready", START_S)
    expect(victim, "follows conductor f0 of epoch", 30.0)


def _cable(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    rig.cut(victim)
    time.sleep(random.uniform(0.2, 4.0))
    rig.heal(victim)
    expect(victim, "-> ended|-> ready|-> stopped", 60.0)


def _restart(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    rig.kill(victim)
    time.sleep(random.uniform(0.0, 2.0))
    rig.start(victim)
    expect("f0", f"figure {victim} has started again|{victim}: lost", 30.0)
    expect(victim, "-> (ready|playing|arming|ended|idle)", START_S)


def _figure(rig: RigStage, victim: str, _random: Random, expect: Callable[..., int]) -> None:
    """End the process of a figure; it comes back only for the end."""
    rig.kill(victim)
    expect("f0", f"{victim}: lost", 10.0)
    rig.say("f0", "s")
    expect("f0", "STOP for all", 5.0)
    rig.start(victim)
    expect(victim, "-> (ready|stopped|idle)", START_S)


def _jump(_rig: RigStage, victim: str, _random: Random, expect: Callable[..., int]) -> None:
    expect(victim, "-> ended|-> ready|-> stopped", 60.0)


def _stale(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    """Let the conductor stand still for long, as a computer that sleeps."""
    rig.kill("f0", signal.SIGSTOP)
    time.sleep(random.uniform(0.3, 5.0))
    rig.kill("f0", signal.SIGCONT)
    expect(victim, "-> ended|-> ready|-> stopped", 60.0)


def _storm(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    """Garbage, and many messages, from the computer of a figure."""
    with rig.storm(victim, random.randint(0, 10**6)):
        time.sleep(3.0)
    expect(victim, "-> ended|-> ready|-> stopped", 60.0)


DEEDS: Final = {
    "none": _none,
    "conductor killed": _conductor,
    "cable cut": _cable,
    "host restarted": _restart,
    "figure killed": _figure,
    "clock jumped": _jump,
    "stale conductor": _stale,
    "storm": _storm,
}


def make_keys(folder: Path, hosts: int, victim: str) -> dict[str, Path]:
    """Make keys for all, but those of the victim by another authority."""
    from lss_motion.network.keys import make_keys as make

    names = [f"f{index}" for index in range(hosts)]
    right, wrong = folder / "keys", folder / "wrong"
    for one in (right, wrong):
        make("rig", names, one)
    return {name: wrong if name == victim else right for name in names}


if __name__ == "__main__":
    sys.exit(main())
