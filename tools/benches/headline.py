"""The table of `tools/FIGURES.md` and one line of the README, from `tools/bench.py all --json`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "tools" / "benches" / "last.json"
"""The last run of all benches, kept: each figure of the page is in it."""
PAGE = ROOT / "tools" / "FIGURES.md"
README = ROOT / "README.md"
BUSY_LOAD = 1.0
"""With more than this at work on two cores, what is timed by the clock says little."""
TABLE = "<!-- headline -->\n", "<!-- end of headline -->\n"
LINE = "<!-- figure -->\n", "<!-- end of figure -->\n"


@dataclass(frozen=True, slots=True)
class Pick:
    """One line of the table: the row of `bench` that begins with `row`, the worst if several."""

    what: str
    bench: str
    row: str
    is_worst: bool = False


PICKS = (
    Pick("plan 10 minutes, 18 joints, verified; against the usual call of toppra", "plan",
         "authored: 1"),
    Pick("the same, as fast as the limits allow", "plan", "fastest: 1"),
    Pick("late at the keys of 20 random shows; plain toppra, and the least there is", "lateness",
         "time lost"),
    Pick("from rest to rest, against the closed form", "states", "20 moves"),
    Pick("through keyframes, against ruckig, which stops at each", "states", "fastest through"),
    Pick("compile it, against planning it", "compile", "compiling"),
    Pick("moves needed, against the fewest straight segments (worst of 12)", "compress", "",
         is_worst=True),
    Pick("horn against plan, RMS; one `D…T…` a keyframe", "horn", "RMS of (a)"),
    Pick("… `D…T…` to samples at 30 Hz", "horn", "RMS of (b)"),
    Pick("… bare `D` at 50 Hz, EM0, FPC 3", "horn", "RMS of (c)"),
    Pick("… line used for commands, 18 servos at 115200 bps", "horn", "line used"),
    Pick("all of it disturbed, with feedback and without", "feedback",
         "RMS of all horns, disturbed by: all"),
    Pick("random shows on random robots that are worse with feedback", "random_pairs", "random"),
    Pick("answers at 115200 bps, against a line that never idles", "line",
         "18 servos at 115200 bps, v"),
    Pick("… against asking and waiting", "line", "18 servos at 115200 bps b"),
    Pick("late at the servo (p50, p99, p99.9, max), against a loop in C", "late", "idle"),
    Pick("simulator, 40 moving servos", "loop", "40 moving"),
    Pick("largest robot with a lively show at 115200 bps", "capacity",
         "largest robot at 115200 bps, lively"),
)  # fmt: skip


def block() -> str:
    """Return the table that stands on the page between the marks."""
    run = json.loads(FIGURES.read_text(encoding="utf-8"))
    lines = ["| what | ours | against | ratio |", "|---|---|---|---|"]
    for pick in PICKS:
        row = _row(pick, run["benches"][pick.bench])
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.3g}"
        short = " (short)" if row["is_met"] is False else ""
        lines.append(f"| {pick.what} | {row['ours']} | {row['reference']} | {ratio}{short} |")
    about = run["machine"]
    judged = [row["is_met"] for rows in run["benches"].values() for row in rows]
    met, targets = judged.count(True), len(judged) - judged.count(None)
    lines += [
        "",
        f"{met} of {targets} targets met, in {sum(run['seconds'].values()):.0f} s; "
        f"{about['processor']}, load before {about['load before']}; {about['versions']}.",
    ]
    if again := run.get("again"):
        lines += ["", f"Measured again after the others: {', '.join(again)}."]
    short = [
        f"- `{bench}`: {row['what']}: {row['ours']}, target {row['target']}"
        + (f" ({row['reference']})" if row["reference"] else "")
        for bench, rows in run["benches"].items()
        for row in rows
        if row["is_met"] is False
    ]
    if short:
        lines += ["", "Short of their targets; the head of `tools/benches/BENCH.py` says why:", ""]
        lines += short
    if float(about["load before"].split(",")[0]) > BUSY_LOAD:
        lines += [
            "",
            "That machine was busy: what real time counts in (lateness, answers) is short.",
        ]
    return "\n".join(lines) + "\n"


def _row(pick: Pick, rows: list[dict[str, Any]]) -> dict[str, Any]:
    found = [row for row in rows if row["what"].startswith(pick.row)]
    assert found, f"no row of {pick.bench} begins with {pick.row!r}"
    return max(found, key=lambda row: row["ratio"]) if pick.is_worst else found[0]


def line() -> str:
    """Return the line of the README: how far the horn is from the plan."""
    run = json.loads(FIGURES.read_text(encoding="utf-8"))
    pick = next(pick for pick in PICKS if pick.bench == "horn")
    row = _row(pick, run["benches"][pick.bench])
    return (
        f"Error of a simulated horn against its plan: {row['ours']} RMS, "
        f"against {row['reference']} with one `D…T…` a keyframe.\n"
    )


def is_current() -> bool:
    """Return whether page and README show the figures of the last run."""
    return _parts(PAGE, TABLE)[1] == block() and _parts(README, LINE)[1] == line()


def keep(run: dict[str, Any], *, is_whole: bool) -> None:
    """Keep the figures of a run, and show them. One of some benches leaves those of the others.

    The machine that is named is that of the last whole run.
    """
    if not is_whole:
        some, run = run, json.loads(FIGURES.read_text(encoding="utf-8"))
        run["seconds"] |= some["seconds"]
        run["benches"] |= some["benches"]
        run["again"] = sorted({*run.get("again", ()), *some["benches"]})
    FIGURES.write_text(json.dumps(run, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    write()


def write() -> None:
    """Put the figures of the last run into the page, and its line into the README."""
    for path, marks, text in ((PAGE, TABLE, block()), (README, LINE, line())):
        before, _, after = _parts(path, marks)
        path.write_text(before + marks[0] + text + marks[1] + after, encoding="utf-8")


def _parts(path: Path, marks: tuple[str, str]) -> tuple[str, str, str]:
    text = path.read_text(encoding="utf-8")
    assert marks[0] in text, path
    before, _, rest = text.partition(marks[0])
    shown, _, after = rest.partition(marks[1])
    return before, shown, after
