"""The command `beats`: tempo and beats of music as a proposal, and into a sequence file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options, channel_of, number_from
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.cli.commands import Commands
    from lss_motion.sound.beats import Beats
    from lss_motion.sound.files import SoundPart

    FloatArray = NDArray[np.float64]

DESCRIPTION: Final = """\
Find tempo and beats of music. What is found is a proposal: trackers are often half a beat off, or
at half or twice the tempo. Look at --plot, or listen, before the beats go into a show.

  lss-motion beats song.ogg --plot song.png
  lss-motion beats song.ogg --shift half --every 2 --plot song.png
  lss-motion beats song.ogg --into show.yaml --anchors

In the show, `at_beat: 12` is then the time of beat 12, and `at_beat: 12.5` half a beat later.
"""
SURE_RATIO: Final = 0.4
"""Off-beats that are weaker leave no doubt where the beat is. Measured on synthetic music: what was
half a beat off had 0.46 and more."""
ROW_S: Final = 30.0
ROWS_MAX: Final = 12
"""A picture has up to so many rows of half a minute; those of longer music are longer."""
WIDTH_IN: Final = 16.0
DIGITS: Final = 3


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    beats = add_command(commands, "beats", _beats, DESCRIPTION)
    beats.add_argument("file", type=Path, metavar="FILE", help="a sound file")
    beats.add_argument(
        "--bpm",
        type=number_from(30.0, 300.0, "beats per minute"),
        metavar="N",
        help="about the tempo, if you know it",
    )
    beats.add_argument(
        "--shift", choices=("half",), help="half a beat later, where the off-beats were found"
    )
    beats.add_argument(
        "--from",
        dest="from_s",
        type=number_from(0.0, 86_400.0, "s"),
        default=0.0,
        metavar="S",
        help="beat 1 is the one nearest to this second (default: the first that is found)",
    )
    beats.add_argument(
        "--every",
        type=int,
        choices=range(1, 65),
        default=1,
        metavar="N",
        help="only each N-th beat: 2 at twice the tempo, 4 for bars",
    )
    beats.add_argument(
        "--channel", type=channel_of, default="mix", metavar="C", help="left, right, or a number"
    )
    add_options(beats, "--plot")
    beats.add_argument(
        "--into", type=Path, metavar="SHOW.yaml", help="write them into this sequence file"
    )
    beats.add_argument(
        "--anchors",
        action="store_true",
        help="with --into: keyframes at beats are anchors, whose times must be met",
    )
    add_options(beats, "--force", help="replace the beats that the sequence file has")
    add_options(beats, "--json")


def _beats(arguments: argparse.Namespace) -> int:
    from lss_motion.show.file import EVENTS_MAX
    from lss_motion.sound.beats import beats_of, every, half_shifted
    from lss_motion.sound.files import SoundPart

    require_outputs(
        [Output(arguments.plot, OutputKind.PICTURE)],
        sources=[arguments.file, arguments.into],
        is_forced=arguments.force,
    )
    if arguments.anchors and arguments.into is None:
        raise InputError("--anchors: only with --into, the sequence file of the keyframes")
    before = None if arguments.into is None else _beats_of_show(arguments)
    part = SoundPart(path=arguments.file, channel=arguments.channel)
    found = beats_of(part, arguments.bpm)
    at_s = half_shifted(found.at_s) if arguments.shift else found.at_s
    at_s = every(at_s, arguments.from_s, arguments.every).round(DIGITS)
    at_s = at_s[at_s >= 0.0]
    if len(at_s) < 2:
        raise InputError(
            f"has {counted(at_s, 'beat')} from {arguments.from_s:g} s on", path=part.path
        )
    if arguments.into is not None and len(at_s) > EVENTS_MAX:
        raise InputError(
            f"has {len(at_s):,} beats, at most {EVENTS_MAX:,} go into a show; give --every",
            path=part.path,
        )
    if arguments.plot is not None:
        plot_beats(arguments.plot, part, found, at_s)
    if arguments.json:
        print_json(_as_json(found, at_s))
    else:
        say("\n".join(_lines(arguments, found, at_s)))
    if arguments.into is not None:
        text = _into(arguments.into, at_s, is_anchored=arguments.anchors)
        replaced = "" if before is None else ", in place of those before"
        say(f"{text}{replaced}", sys.stderr if arguments.json else None)
    return EXIT_FINISHED


def _lines(arguments: argparse.Namespace, found: Beats, at_s: FloatArray) -> list[str]:
    slow, fast = found.bpm_range
    steady = "steady" if fast < 1.03 * slow else f"from {slow:.1f} to {fast:.1f}"
    bpm = found.bpm / arguments.every
    lines = [
        f"{arguments.file}: {counted(at_s, 'beat')} from {at_s[0]:.3f} s to {at_s[-1]:.3f} s, "
        f"{bpm:.1f} a minute ({steady})",
        f"half way between the beats that were found the music is {found.off_beat_ratio:.0%} as "
        "strong as on them",
    ]
    if found.off_beat_ratio > SURE_RATIO:
        lines.append("so it may be half a beat off: compare with --shift half")
    if arguments.into is None:
        lines.append(
            "this is a proposal: --plot F.png draws it over the music, --shift half, --every 2 and "
            "--bpm N change it, --into SHOW.yaml writes it"
        )
    return lines


def _as_json(found: Beats, at_s: FloatArray) -> dict[str, Any]:
    return {
        "at_s": at_s.tolist(),
        "bpm": round(found.bpm, 2),
        "bpm_range": [round(bpm, 2) for bpm in found.bpm_range],
        "off_beat_ratio": round(found.off_beat_ratio, 3),
    }


def _beats_of_show(arguments: argparse.Namespace) -> object:
    """Return what the sequence file has as beats; raise `InputError` if they must stay."""
    from lss_motion.files.yaml_source import read_yaml

    source = read_yaml(arguments.into)
    if "sequence" not in source.value:
        reason = "is no sequence file, which has a key `sequence`"
        raise InputError(reason, path=arguments.into)
    before: object = source.value.get("beats")
    if before is not None and not arguments.force:
        line = source.line(("beats",))
        raise InputError("has beats already; --force replaces them", path=arguments.into, line=line)
    return before


def _into(path: Path, at_s: FloatArray, *, is_anchored: bool) -> str:
    """Write the beats into a sequence file; return what was done."""
    from lss_motion.files.source import read_text
    from lss_motion.files.yaml_edit import set_values
    from lss_motion.files.yaml_text import in_rows

    beats_s = [round(beat_s, DIGITS) for beat_s in at_s.tolist()]
    value = in_rows({"at_s": beats_s, "anchor": True} if is_anchored else beats_s)
    write_output(path, set_values(path, read_text(path), (), {"beats": value}))
    return f"{path}: {counted(at_s, 'beat')}; at_beat: 1 is at {at_s[0]:g} s"


def plot_beats(path: Path, part: SoundPart, found: Beats, at_s: FloatArray) -> None:
    """Draw the music, the strength of its onsets and the beats, in rows of a minute at most."""
    import numpy as np

    from lss_motion.planning.picture import new_figure, save
    from lss_motion.sound.beats import LATER_S
    from lss_motion.sound.envelope import draw_beats, draw_waveform, waveform

    wave = waveform(part, ROWS_MAX * 1200)
    end_s = float(wave.at_s[-1])
    rows = int(np.clip(np.ceil(end_s / ROW_S), 1, ROWS_MAX))
    figure = new_figure(path, WIDTH_IN, 0.6 + 1.5 * rows)
    axes = figure.subplots(rows, 1, squeeze=False)[:, 0]
    strength_s = LATER_S + found.step_s * np.arange(len(found.strength))
    scale = 1.0 / max(float(found.strength.max()), 1e-9)
    for row, axis in enumerate(axes):
        from_s, to_s = row * end_s / rows, (row + 1) * end_s / rows
        draw_waveform(axis, wave)
        peak = max(float(wave.high.max()), 1e-6)
        shown = (strength_s >= from_s) & (strength_s <= to_s)
        axis.plot(
            strength_s[shown],
            -peak * (1.0 - scale * found.strength[shown]),
            color="#b0413e",
            linewidth=0.8,
        )
        draw_beats(axis, at_s, (from_s, to_s), WIDTH_IN)
        axis.set_xlim(from_s, to_s)
        axis.set_yticks([])
        axis.tick_params(labelsize=7)
    axes[-1].set_xlabel("s", fontsize=8)
    title = f"{part.path.name}: {found.bpm:.1f} beats a minute (a proposal); below, onsets in red"
    figure.suptitle(title, fontsize=10, x=0.01, ha="left", parse_math=False)
    save(figure, path)
