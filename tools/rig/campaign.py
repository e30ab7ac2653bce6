"""Faults of many computers by seed, in network namespaces, judged at every servo.

    tools/run python tools/rig/campaign.py [--runs 20] [--seed 0] [--directed] [--keep FOLDER]

A run: three hosts with their simulated robots, a line like Wi-Fi or a plain one, a show, and one
fault at a random instant: conductor killed, cable cut and healed, host restarted, figure killed,
clock jumped, stale conductor, storm of messages, wrong keys. Whatever happens, no servo may get
what breaks a limit, and the last thing that it gets is to hold (`tools/judge`, which shares no code
with the package); and every host must have logged what it did. With `--directed`, cues at random
figures start the show, and in every second run interrupt it by another one before the fault. The
hosts of `SESSION` runs are the same processes, unless the fault ends them; robots and ports are new
in each. Prints a line a run; exits with 1 if one was unsafe or unexplained.
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

from lss_motion.stage.hosts.conductor import READY_S
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
SESSION: Final = len(FAULTS)
START_S: Final = 120.0
QUIET: Final = frozenset({"ready", "idle", "alone", "stopped", "ended", "out", "not connected"})
"""States of a figure without a player."""


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=len(FAULTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hosts", type=int, default=3)
    parser.add_argument("--directed", action="store_true", help="cues of the stage start the show")
    parser.add_argument("--keep", type=Path, help="keep logs and verdicts of bad runs here")
    arguments = parser.parse_args()
    if why := why_not():
        print(why, file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda number, _frame: sys.exit(128 + number))  # Tidies up.
    seeds = list(range(arguments.seed, arguments.seed + arguments.runs))
    bad = 0
    while seeds:
        with tempfile.TemporaryDirectory(prefix="lss-rig-") as folder:
            bad += session(
                Path(folder), seeds, arguments.hosts, arguments.keep, is_directed=arguments.directed
            )
    print(f"{arguments.runs} runs, {bad} bad")
    return 1 if bad else 0


def session(
    folder: Path, seeds: list[int], hosts: int, keep: Path | None, *, is_directed: bool
) -> int:
    """Take runs from `seeds` and play them with the same hosts; return how many were bad.

    A bad one ends the session: the next begins anew.
    """
    random = Random(f"session {seeds[0]}")
    faults = random.sample(FAULTS, len(FAULTS))
    line, others = random.choice((PLAIN, WIFI)), random.choice(("go_on", "slow", "hold"))
    has_keys = random.random() < 0.5
    keys = make_keys(folder, hosts) if has_keys else None
    with RigStage(
        folder,
        hosts=hosts,
        seed=seeds[0],
        line=line,
        show_s=5,
        others=others,
        ppm=100.0,
        keys=keys,
        is_directed=is_directed,
    ) as rig:
        rig.start_all()
        for fault in faults:
            # Without keys nothing keeps garbage out; with them, it needs a key to come in.
            if (fault == "wrong keys" and (is_directed or not has_keys)) or (
                fault == "storm" and has_keys
            ):
                continue
            if not seeds:
                break
            seed, began = seeds.pop(0), time.monotonic()
            problems = one_run(rig, seed, fault)
            verdict = "; ".join(problems) or "safe"
            took = time.monotonic() - began
            print(f"{seed:4} {fault:16} {others:5} {took:5.0f} s  {verdict}", flush=True)
            if problems:
                if keep is not None:
                    shutil.copytree(folder, keep / f"{seed}", dirs_exist_ok=True)
                return 1
    return 0


def one_run(rig: RigStage, seed: int, fault: str) -> list[str]:
    """Play one show with one fault; return what was unsafe or not explained."""
    random = Random(f"{seed}/{fault}")
    victim = f"f{random.randint(1, len(rig.names) - 1)}"
    marks = {name: len(rig.log(name)) for name in rig.names}
    if not rig.has_robots:
        rig.start_robots()
    missing: list[str] = []
    with contextlib.suppress(TimeoutError):
        play(rig, fault, victim, random, missing)
        settle(rig, missing)
    try:
        verdicts = rig.end_robots()
    except TimeoutError as error:
        return [*missing, str(error)]
    problems = [f"{name}: {text}" for name, one in verdicts.items() for text in one["objections"]]
    problems += missing
    logs = {name: rig.log(name)[mark:] for name, mark in marks.items()}
    problems += [f"{name}: a traceback" for name, log in logs.items() if "Traceback" in log]
    return problems


def settle(rig: RigStage, missing: list[str]) -> None:
    """Stop what still plays, and wait until all hosts are there and nothing does."""
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        states = rig.states()
        if len(states) == len(rig.names) and set(states.values()) <= QUIET - {"not connected"}:
            return
        rig.say(rig.names[0], "s")
        time.sleep(1.0)
    missing.append(f"not settled: {rig.states()}")
    raise TimeoutError


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
        wrong_keys(rig, victim, expect)
        return
    if rig.is_directed:
        fire(rig, random, missing)
    else:
        mark = len(rig.log("f0"))
        order(rig, mark)
        expect("f0", "all stand at the start", START_S, mark)
        expect("f0", "armed -> playing", 30.0, mark)
    time.sleep(random.uniform(0.0, 3.0))
    if rig.is_directed and random.random() < 0.5:
        rig.say(random.choice(rig.names), "c more")
        time.sleep(random.uniform(0.0, 6.0))
    marks = {name: len(rig.log(name)) for name in rig.names}
    DEEDS[fault](rig, victim, random, lambda n, p, s: expect(n, p, s, marks[n]))


def order(rig: RigStage, mark: int) -> None:
    """Order the show until that is taken up: not before all figures are there."""
    end = time.monotonic() + START_S
    while "GO: the robots move" not in rig.log("f0")[mark:] and time.monotonic() < end:
        rig.say("f0", "l show")
        time.sleep(3.0)


def fire(rig: RigStage, random: Random, missing: list[str]) -> None:
    """Fire the cue of the show at some figure, again until it plays."""
    end, mark = time.monotonic() + START_S, len(rig.log("f0"))
    while time.monotonic() < end:
        rig.say(random.choice(rig.names), "c show")
        again = time.monotonic() + 5.0
        while time.monotonic() < again:
            if "armed -> playing" in rig.log("f0")[mark:]:
                return
            time.sleep(0.05)
    missing.append(f"does not play: {rig.states()}")
    raise TimeoutError


def wrong_keys(rig: RigStage, victim: str, expect: Callable[..., int]) -> None:
    """Let a host come back with keys of another authority: it stays out until it has its own."""
    right = rig.folder / "keys"
    rig.kill(victim)
    rig.write_stage(victim, rig.folder / "wrong")
    rig.start(victim)
    time.sleep(4.0)
    mark = len(rig.log("f0"))
    rig.say("f0", "l show")
    expect("f0", f"refused: .*{victim}|{victim}: it has not connected", READY_S + 20.0, mark)
    mark = len(rig.log(victim))
    rig.kill(victim)
    rig.write_stage(victim, right)
    rig.start(victim)
    expect(victim, "-> (ready|idle)", START_S, mark)


def _none(rig: RigStage, _victim: str, _random: Random, expect: Callable[..., int]) -> None:
    for name in rig.names:
        expect(name, "-> ended", 40.0)


def _conductor(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    number = random.choice((signal.SIGKILL, signal.SIGTERM))
    rig.kill("f0", number)
    if number == signal.SIGKILL:
        # A show on a cue may not have begun to play yet, or its robots not to move.
        moves = "-> freewheeling|the conductor is lost before the start"
        expect(victim, f"{moves}|(ready|stopped) -> alone", 10.0)
        expect(victim, "-> holding|-> ended|-> alone", 20.0)
    else:
        expect(victim, "stops: the conductor stopped all|-> ended", 20.0)
        expect("f0", "STOP for all", 5.0)
    rig.start("f0")
    expect("f0", "-> (ready|idle)", START_S)
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


def _jump(rig: RigStage, victim: str, random: Random, expect: Callable[..., int]) -> None:
    """Let the monotonic clock of a host jump, as of a computer that slept, or was moved."""
    rig.jump(victim, round(random.choice((-1, 1)) * random.uniform(0.02, 0.6) * 1e9))
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


def make_keys(folder: Path, hosts: int) -> Path:
    """Make keys for all, and others by another authority; return the folder of the right ones."""
    from lss_motion.stage.hosts.peer import make_keys as make

    for one in ("keys", "wrong"):
        make("rig", [f"f{index}" for index in range(hosts)], folder / one)
    return folder / "keys"


if __name__ == "__main__":
    sys.exit(main())
