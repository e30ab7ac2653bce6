#!/usr/bin/env python3
"""Damage small files of every format and read them: only a refusal with a reason may follow.

    tools/run tools/fuzz_readers.py [INPUTS] [SEED]

100,000 inputs in all by default, shared evenly. Prints what fails, as bytes for a test, and how
many were read. Exit code 1 when anything failed. An input that takes longer than two seconds is
reported as a hang.
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


def main(inputs_count: int, seed: int) -> int:
    """Fuzz every reader; return the exit code."""
    spec = importlib.util.spec_from_file_location("laws", LAWS)
    assert spec is not None
    assert spec.loader is not None
    laws = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(laws)
    signal.signal(signal.SIGALRM, _hung)
    failures = 0
    each = -(-inputs_count // len(READERS))
    for reader in READERS:
        random = Random(f"{seed}/{reader.name}")  # noqa: S311
        tokens = sorted(laws.TOKENS)
        read_count = 0
        for _ in range(each):
            data = _damaged(random, laws.SEEDS[reader.name], tokens)
            signal.setitimer(signal.ITIMER_REAL, HANG_S)
            try:
                read_count += laws.fuzz_one(reader, data)
            except Exception:  # noqa: BLE001  (any other exception is a fault of the reader)
                failures += 1
                print(f"{reader.name}: {data!r}\n{traceback.format_exc(limit=-3)}")
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
        print(f"{reader.name}: {each} inputs, {read_count} read, the others refused", flush=True)
    print(f"{each * len(READERS)} inputs, {failures} failures")
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
    words = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*words) if len(words) == 2 else main(words[0] if words else 100_000, 1))
