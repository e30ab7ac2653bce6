"""What is played from seeds in virtual time, by the thousand, and judged: `tools/campaign`.

| file | what it holds |
|---|---|
| `__main__.py` | the command: plays the seeds of a kind, prints what broke a promise |
| `shows.py` | kind `shows`: short shows with faults and keys |
| `walks.py` | kind `walks`: robots that are steered while they walk |
| `stages.py` | kind `stages`: hours of an evening, with visitors, keys and faults |
| `readers.py` | kind `readers`: damaged files of every foreign format |
| `interrupts.py` | kind `interrupts`: commands with a port, interrupted at any byte |
| `hands.py` | kind `hands`: joints in the hands of a person, with faults |
| `live_edits.py` | kind `live_edits`: shows that are edited while they play |
| `three_shows.py`, `any_show.py`, `random_faults.py` | what `shows` draws from a seed |
| `witness.py` | records all of a run, presses keys, ends a run that does not end |
| `judge.py`, `allowances.py`, `stale.py` | the promises of a show |
| `outside.py` | what the independent judge (`tools/judge`) is given of a run |

A kind is a module with `SEEDS`, how many are played by default, `add_to`, which adds its options,
and `play`, which plays one seed and returns a `Told`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Told:
    """What became of one seed: in a word, which promises it broke, and what to know of them."""

    outcome: str
    broken: tuple[str, ...] = ()
    about: tuple[str, ...] = ()
    """What it played, one line each: shown if it broke a promise."""
    line: str = ""
    """What is shown of it in any case."""
