#!/usr/bin/env python3
"""Damage small files of every format and read them: only a refusal with a reason may follow.

    tools/run tools/fuzz_readers.py [INPUTS] [SEED] [FORMAT...]

100,000 inputs in all by default, shared evenly by all readers, or by those of the formats named.
Prints what fails, as bytes for a test, and how many were read. Exit code 1 when anything failed. An
input that takes more than two seconds of processor time is reported as a hang.
"""

from __future__ import annotations

import importlib.util
import signal
import sys
import traceback
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from lss_motion.interchange import READERS

if TYPE_CHECKING:
    from types import FrameType

LAWS = Path(__file__).resolve().parents[1] / "tests" / "property" / "test_interchange.py"
HANG_S = 2.0


def main(inputs_count: int, seed: int, formats: list[str]) -> int:
    """Fuzz the readers of `formats` (none: all); return the exit code."""
    spec = importlib.util.spec_from_file_location("laws", LAWS)
    assert spec is not None
    assert spec.loader is not None
    laws = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(laws)
    signal.signal(signal.SIGPROF, _hung)
    failures = 0
    readers = [r for r in READERS if not formats or r.name in formats]
    if unread := [reader.name for reader in readers if reader.name not in laws.SEEDS]:
        print(f"not fuzzed, because a library is missing: {', '.join(unread)}")
    readers = [reader for reader in readers if reader.name in laws.SEEDS]
    each = -(-inputs_count // len(readers))
    for reader in readers:
        random = Random(f"{seed}/{reader.name}")  # noqa: S311
        tokens = sorted(laws.TOKENS)
        read_count = 0
        for _ in range(each):
            data = _damaged(random, laws.SEEDS[reader.name], tokens)
            signal.setitimer(signal.ITIMER_PROF, HANG_S)
            try:
                read_count += laws.fuzz_one(reader, data)
            except Exception:  # noqa: BLE001  (any other exception is a fault of the reader)
                failures += 1
                print(f"{reader.name}: {data!r}\n{traceback.format_exc(limit=-3)}")
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
        print(f"{reader.name}: {each} inputs, {read_count} read, the others refused", flush=True)
    print(f"{each * len(readers)} inputs, {failures} failures")
    return 1 if failures else 0


def _damaged(random: Random, data: bytes, tokens: list[bytes]) -> bytes:
    for _ in range(random.randint(1, 5)):
        start = random.randint(0, len(data))
        end = random.randint(start, min(len(data), start + 12))
        middle = random.choice([random.choice(tokens), random.randbytes(random.randint(0, 4)), b""])
        data = data[:start] + middle + data[end:]
    return data


def _hung(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError("hangs")


if __name__ == "__main__":
    counts = [int(word) for word in sys.argv[1:] if word.isdigit()]
    named = [word for word in sys.argv[1:] if not word.isdigit()]
    known = [reader.name for reader in READERS]
    if "--help" in named:
        print(f"{__doc__}\nFormats: {', '.join(known)}")
        sys.exit()
    if unknown := [word for word in named if word not in known]:
        print(f"no such format: {', '.join(unknown)}; there are {', '.join(known)}")
        sys.exit(2)
    inputs_count, seed = [*counts, *[100_000, 1][len(counts) :]]
    sys.exit(main(inputs_count, seed, named))
