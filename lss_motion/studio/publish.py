"""A show as one page: figure, sound, plan, predicted errors, verdict, and the files it is made of.

`published` makes the data of a page, `page_of` the page from the data alone, `verified` the data
again from the files in a page. So a page is consistent if it is what its data say, and its data are
what its files give. That proves nothing about who made it.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import os
import platform
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion import __version__
from lss_motion.errors import InputError
from lss_motion.files.source import ABSENT, read_data, recorded, text_of
from lss_motion.files.texts import counted, duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lss_motion.planning.shows import Show

FORMAT: Final = "lss_motion page"
VERSION: Final = 1
STATIC: Final = Path(__file__).parent / "static"
MODULES: Final = ("kinematics", "camera", "orbit", "stick", "figure")
"""What draws a figure, in an order in which each finds what it imports."""
RATE_HZ: Final = 25.0
"""Samples of the plan: the frames of a film."""
SAMPLES_MAX: Final = 4_000_000
"""Angles in a page: 18 joints for two hours."""
DECIMALS: Final = 3
"""Of angles: a hundredth of the unit of a servo."""
FILES_MAX_BYTES: Final = 64_000_000
TOLERANCE_DEG: Final = 0.01
TOLERANCE_S: Final = 0.001
TOLERANCE_RATIO: Final = 0.001
"""How far a plan that is made again may be from that of the page: other processors and libraries
round in another way."""
_DATA: Final = re.compile(
    r'<script type="application/json" id="lss_motion">\n(.*?)\n</script>', re.DOTALL
)


def published(path: Path, robot_path: Path | None = None) -> dict[str, Any]:
    """Return the data of the page of a show; raises what `check` raises, or `InputError`."""
    from lss_motion.planning import shows

    with recorded() as record:
        show = shows.prepare(path, robot_path)
    read = [Path(name).resolve() for name, state in record.states.items() if state != ABSENT]
    sounds = {Path(cue.sound).resolve() for cue in show.program.cues if cue.sound}
    files = sorted({one for one in (*read, *sounds) if one.is_file() and not _is_learnt(one)})
    top = Path(os.path.commonpath([one.parent for one in files]))
    data = _data_of(show)
    data |= {
        "show": path.resolve().relative_to(top).as_posix(),
        "robot": None if robot_path is None else robot_path.resolve().relative_to(top).as_posix(),
        "files": dict(_packed(files, top)),
        "cues": [
            {"at_s": cue.at_s, "sound": Path(cue.sound).resolve().relative_to(top).as_posix()}
            for cue in show.program.cues
            if cue.sound
        ],
    }
    return data


def _is_learnt(path: Path) -> bool:
    from lss_motion.files.output import STATE_VARIABLE, user_folder

    return path.is_relative_to(user_folder(STATE_VARIABLE, "state").resolve())


def _packed(files: list[Path], top: Path) -> Iterator[tuple[str, dict[str, str]]]:
    total = 0
    for path in files:
        content = read_data(path)
        total += len(content)
        if total > FILES_MAX_BYTES:
            raise InputError(f"has files of more than {FILES_MAX_BYTES / 1e6:g} MB", path=path)
        packed = {"sha256": hashlib.sha256(content).hexdigest()}
        try:
            packed["text"] = text_of(content, path)
        except InputError:
            packed["base64"] = base64.b64encode(content).decode()
        yield path.relative_to(top).as_posix(), packed


def _data_of(show: Show) -> dict[str, Any]:
    """Return what a show comes to: checked, sampled, with its figure."""
    from lss_motion.planning import shows
    from lss_motion.planning.check_json import show_as_json
    from lss_motion.show.gait.kinematics import figure_view

    if show.trajectory is None:
        raise InputError(
            "is a compiled program; publish its sequence", path=show.program.robot_path
        )
    trajectory = show.trajectory
    until_s = shows.shown_s(trajectory)
    count = math.ceil(until_s * RATE_HZ) + 1
    if count * len(trajectory.joints) > SAMPLES_MAX:
        raise InputError(f"lasts {until_s:.0f} s, too long for one page")
    angles_deg = trajectory.sample(np.minimum(np.arange(count) / RATE_HZ, until_s))
    checked = show_as_json(show)
    checked["functions"] = [call["run"] for call in checked["functions"]]
    joints = {
        name: [joint.position_min_deg, joint.position_max_deg]
        for name, joint in show.robot.joints.items()
        if name in trajectory.joints
    }
    return {
        "format": FORMAT,
        "version": VERSION,
        "made_by": {
            "lss_motion": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "check": json.loads(json.dumps(checked, default=str)),
        "ranges_deg": joints,
        "figure": figure_view(show.robot),
        "plan": {
            "rate_hz": RATE_HZ,
            "until_s": until_s,
            "joints": list(trajectory.joints),
            "deg": np.round(angles_deg, DECIMALS).tolist(),
        },
    }


def data_of(page: str) -> dict[str, Any]:
    """Return the data of a page; raises `InputError` for what is none."""
    found = _DATA.search(page)
    if found is None:
        raise InputError("is no page of lss-motion publish: it holds no data of a show")
    try:
        data = json.loads(found[1])
    except ValueError as error:
        raise InputError("is damaged: its data cannot be read") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise InputError("is no page of lss-motion publish")
    if data.get("version") != VERSION:
        raise InputError(f"is of version {data.get('version')}; this program reads {VERSION}")
    return data


def verified(page: str) -> list[str]:
    """Plan the show in a page again; return what differs. An empty list: the page is consistent.

    Raises `InputError` for what is no such page.
    """
    data = data_of(page)
    problems = []
    try:
        # Another version of the program shows the data in another way: they decide.
        is_own = data["made_by"]["lss_motion"] == __version__
        if is_own and page_of(data) != page:
            problems.append("what is shown is not what the data say")
        again = _made_again(data)
    except (InputError, LookupError, AttributeError, TypeError, ValueError) as error:
        return [*problems, f"the show cannot be made again: {error}"]
    for key in ("check", "ranges_deg", "figure", "plan", "cues"):
        problems += _differences(key, data.get(key), again[key])
    return problems


def _made_again(data: Mapping[str, Any]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as place:
        top = Path(place).resolve()
        for name, packed in data["files"].items():
            path = (top / name).resolve()
            if not path.is_relative_to(top) or path == top:
                raise InputError(f"{name!r:.80} lies outside of the folder of the show")
            content = (
                packed["text"].encode()
                if "text" in packed
                else base64.b64decode(packed["base64"], validate=True)
            )
            if hashlib.sha256(content).hexdigest() != packed["sha256"]:
                raise InputError(f"{name!r:.80} is not the file that its hash names")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        robot = data["robot"]
        return published(top / data["show"], None if robot is None else top / robot)


def _differences(place: str, said: Any, found: Any) -> list[str]:  # noqa: ANN401  JSON
    """Return where two values differ by more than rounding does."""
    if isinstance(said, dict) and isinstance(found, dict) and said.keys() == found.keys():
        return [
            text for key in said for text in _differences(f"{place}.{key}", said[key], found[key])
        ]
    if isinstance(said, list) and isinstance(found, list) and len(said) == len(found):
        pairs = enumerate(zip(said, found, strict=True))
        return [
            text for n, (one, other) in pairs for text in _differences(f"{place}[{n}]", one, other)
        ]
    if said == found or _is_near(place, said, found):
        return []
    return [f"{place} is {said!r:.60}, but {found!r:.60} comes of the files"]


def _is_near(place: str, said: Any, found: Any) -> bool:  # noqa: ANN401  JSON
    if not all(isinstance(one, int | float) and not isinstance(one, bool) for one in (said, found)):
        return False
    away = abs(said - found)
    largest = TOLERANCE_S if place.endswith("_s") else TOLERANCE_DEG
    return bool(away <= max(largest, TOLERANCE_RATIO * abs(found)))


# ---- the page, from the data alone


def page_of(data: Mapping[str, Any]) -> str:
    """Return the page of these data: one file that needs no other, and no network."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("</", "<\\/")
    check = data["check"]
    rows = "\n".join(_joint_rows(data))
    files = "\n".join(
        f"<li><code>{html.escape(name)}</code> <small>{packed['sha256'][:16]}</small>"
        for name, packed in data["files"].items()
    )
    verdict = "\n".join(f"<li>{html.escape(line)}" for line in verdict_of(data))
    made = ", ".join(f"{name} {version}" for name, version in data["made_by"].items())
    title = html.escape(f"{check['name']} · {check['robot']}")
    return f"""<!doctype html>
<html lang="en" data-theme="dark"><meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy" content="{CONTENT_POLICY}">
<title>{title}</title>
<style>
{_static("theme.css")}
{_static("figure/figure.css")}
{STYLE}
</style>
<h1>{title}</h1>
<div id="figure"></div>
<p><button id="play">Play</button> <input id="at" type="range" min="0" step="any"
 aria-label="time"> <output id="clock"></output></p>
<h2>Verdict</h2>
<ul>
{verdict}
</ul>
<h2>Plan</h2>
<table><tr><th>joint<th>angle<th>fastest<th>hardest<th>horn off by at most
{rows}
</table>
<h2>Files</h2>
<ul>
{files}
</ul>
<p><small>Made by {html.escape(made)}. <code>lss-motion verify</code> plans it again from the files
in this page: that proves that the page is consistent, not who made it.</small></p>
<script type="application/json" id="lss_motion">
{text}
</script>
<script>
{_scripts()}
</script>
"""


CONTENT_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; media-src data:"
)
"""Whatever a name in a show holds, the page loads nothing from elsewhere."""
STYLE: Final = """\
body { background: var(--ground); color: var(--text); font: 16px var(--font); margin: auto;
  max-width: 60rem; padding: 1rem; }
#figure { height: 24rem; background: var(--surface); border-radius: var(--radius); }
#at { width: 60%; } small { color: var(--muted); } li { margin: .2rem 0; }
table { border-collapse: collapse; width: 100%; }
td, th { padding: .2rem .6rem; text-align: right; }
td:nth-child(-n + 2), th:nth-child(-n + 2) { text-align: left; }
svg { background: var(--surface); height: 3rem; width: 20rem; }
polyline { fill: none; stroke: var(--plan); stroke-width: 2; vector-effect: non-scaling-stroke; }
"""


def verdict_of(data: Mapping[str, Any]) -> list[str]:
    """Return what a person wants to know first: late keyframes, limits, predicted errors."""
    check = data["check"]
    lines = [f"lasts {duration_text(data['plan']['until_s'])}"]
    late = check["late_keyframes"]
    if late:
        worst = max(late, key=lambda one: one["late_s"])
        lines.append(
            f"{counted(late, 'keyframe')} late, at most by {worst['late_s']:.3f} s"
            f" ({worst['label'] or worst['place']})"
        )
    else:
        lines.append("every keyframe is on time")
    if slowed := check["stretched"]:
        by_s = sum(span["by_s"] for span in slowed)
        lines.append(f"{counted(slowed, 'span')} slowed by limits, {by_s:.2f} s in all")
    joints = check["joints"]
    worst_name = max(joints, key=lambda name: joints[name].get("error_max_deg", 0.0))
    lines.append(
        f"no horn more than {joints[worst_name].get('error_max_deg', 0.0):.2f}° off as predicted"
        f" ({worst_name}); with what the model leaves open"
        f" {max(one.get('bound_deg', 0.0) for one in joints.values()):.2f}°"
    )
    if check["functions"]:
        lines.append(f"calls Python functions: {', '.join(check['functions'])}")
    return lines


def _joint_rows(data: Mapping[str, Any]) -> Iterator[str]:
    plan, check = data["plan"], data["check"]
    for column, name in enumerate(plan["joints"]):
        low, high = data["ranges_deg"][name]
        use = check["joints"][name]
        angles = [row[column] for row in plan["deg"]]
        cells = (
            _curve(angles, low, high),
            f"{use['speed_deg_s']:.0f} of {use['speed_max_deg_s']:g} deg/s",
            f"{use['accel_deg_s2']:.0f} of {use['accel_max_deg_s2']:g} deg/s²",
            f"{use.get('error_max_deg', 0.0):.2f}° ({use.get('bound_deg', 0.0):.2f}°)",
        )
        yield f"<tr><td>{html.escape(name)}<td>{'<td>'.join(cells)}"


def _curve(angles: list[float], low: float, high: float) -> str:
    """Return a curve over its range, in at most 400 points."""
    step = max(1, len(angles) // 400)
    shown = angles[::step]
    points = " ".join(
        f"{400 * n / max(1, len(shown) - 1):.1f},{58 - 56 * (deg - low) / (high - low):.1f}"
        for n, deg in enumerate(shown)
    )
    return (
        f'<svg viewBox="0 0 400 60" preserveAspectRatio="none"><polyline points="{points}"/></svg>'
    )


def _static(name: str) -> str:
    return (STATIC / name).read_text(encoding="utf-8")


def _scripts() -> str:
    """Return the modules that draw a figure as one script, and what plays."""
    parts = []
    for name in (*(f"figure/{own}.js" for own in MODULES), "published.js"):
        text = _static(name)
        text = re.sub(r"^import .*?;\n", "", text, flags=re.MULTILINE | re.DOTALL)
        parts.append(re.sub(r"^export ", "", text, flags=re.MULTILINE))
    return "(() => {\n" + "\n".join(parts) + "\n})();"
