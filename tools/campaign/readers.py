"""Damaged files of every foreign format: only a refusal with a reason may follow.

What fails is shown as bytes for a test. More than two seconds of processor time count as a hang.
"""

from __future__ import annotations

import importlib.util
import signal
import traceback
from functools import cache
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final

from campaign import Told
from lss_motion.interchange.importing import READERS

if TYPE_CHECKING:
    import argparse
    from types import FrameType

SEEDS: Final = 100_000
LAWS: Final = Path(__file__).resolve().parents[2] / "tests" / "property" / "test_interchange.py"
HANG_S: Final = 2.0


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind."""
    known = [reader.name for reader in READERS]
    parser.add_argument("--formats", nargs="+", choices=known, default=known, metavar="NAME",
                        help=f"only these of {', '.join(known)}")  # fmt: skip


def play(seed: int, options: argparse.Namespace) -> Told:
    """Damage a file and read it; the seeds go to all readers in turn."""
    laws = _laws()
    readers = [r for r in READERS if r.name in options.formats and r.name in laws.SEEDS]
    reader = readers[seed % len(readers)]
    data = _damaged(Random(f"{seed}/{reader.name}"), laws.SEEDS[reader.name], sorted(laws.TOKENS))
    signal.signal(signal.SIGPROF, _hung)
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    try:
        return Told("read" if laws.fuzz_one(reader, data) else "refused")
    except Exception:  # noqa: BLE001  (any other exception is a fault of the reader)
        text = f"{reader.name}: {data!r}\n{traceback.format_exc(limit=-3)}"
        return Told("failed", (text,))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


@cache
def _laws() -> Any:  # noqa: ANN401  (a module of the tests)
    spec = importlib.util.spec_from_file_location("laws", LAWS)
    assert spec is not None
    assert spec.loader is not None
    laws = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(laws)
    return laws


def _damaged(random: Random, data: bytes, tokens: list[bytes]) -> bytes:
    for _ in range(random.randint(1, 5)):
        start = random.randint(0, len(data))
        end = random.randint(start, min(len(data), start + 12))
        middle = random.choice([random.choice(tokens), random.randbytes(random.randint(0, 4)), b""])
        data = data[:start] + middle + data[end:]
    return data


def _hung(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError("hangs")
