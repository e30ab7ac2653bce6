"""Motion from sound: a jaw that follows ten spoken sentences in three voices, and beats of music.

The envelope with which the planned jaw is compared is made otherwise than that of the package: the
rectified sound through Butterworth filters, forwards and backwards. Peaks are matched with the
nearest one of the sound.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

import lss_motion as lss
from benches.drums import RATE_HZ, STYLES, music, verdict
from benches.table import Row
from lss_motion.interchange.voice import VoiceStyle, shortfall, voice_sequence
from lss_motion.sound.beats import beats_of, half_shifted
from lss_motion.sound.files import read_sound
from lss_motion.sound.spectra import Part

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from benches.drums import Style
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

VOICES = ("en-gb", "en-us+f3", "en+m7")
SENTENCES = (
    "Good evening. I am the oldest robot in this museum, and nobody ever asks me how I feel.",
    "Peter Piper picked a peck of pickled peppers.",
    "Welcome to the haunted house. Please mind the gap between the coffins.",
    "One, two, three, four, five, six, seven, eight, nine, ten.",
    "The owl turns its head, looks at you for a while, and says nothing.",
    "Mama, papa, and the baby bought a big brown bamboo boat.",
    "Do not touch the glass! It is older than both of us.",
    "Tomorrow and tomorrow and tomorrow creeps in this petty pace from day to day.",
    "Who goes there? Friend, or foe?",
    "If you can hear this, the sound is on time, and so is my mouth.",
)
NEAR_S = 0.02
JAW = {"id": 1, "model": "LSS-ST1", "speed_max_deg_s": 360, "accel_max_deg_s2": 1000}
BEATS_S = 30.0


def robot_with(open_deg: float) -> Robot:
    """Return a robot with a jaw that opens so far."""
    joints = {"jaw": {**JAW, "range_deg": [0, open_deg]}}
    return lss.load_robot({"robot": "jaw", "joints": joints})


def envelope(path: Path) -> tuple[FloatArray, float]:
    """Return the loudness of a file, and its step in s."""
    samples, rate_hz = read_sound(path)
    band = butter(4, (150.0, min(5000.0, 0.45 * rate_hz)), "bandpass", fs=rate_hz, output="sos")
    level = np.abs(sosfiltfilt(band, samples[:, 0].astype(np.float64)))
    smooth = sosfiltfilt(butter(2, 8.0, fs=rate_hz, output="sos"), level)
    step = rate_hz // 200
    return smooth[::step], step / rate_hz


def jaw_rows(paths: Sequence[Path], open_deg: float, style: VoiceStyle, what: str) -> list[Row]:
    """Return what a jaw makes of the sounds."""
    robot = robot_with(open_deg)
    joint = robot.joints["jaw"]
    likeness, off_s, keys, seconds, broken, openings, less_deg = [], [], 0, 0.0, 0, 0, []
    heard = 0
    for path in paths:
        voiced = voice_sequence(Part(path=path), robot, "jaw", style)
        plan = lss.plan(voiced.sequence, robot)
        level, step_s = envelope(path)
        times_s = step_s * np.arange(len(level))
        times_s = times_s[times_s <= plan.duration_s]
        level, jaw_deg = level[: len(times_s)], plan.sample(times_s)[:, 0]
        likeness.append(float(np.corrcoef(jaw_deg, level)[0, 1]))
        sound_s = times_s[find_peaks(level, prominence=0.1 * np.percentile(level, 95))[0]]
        jaw_s = times_s[find_peaks(jaw_deg, prominence=0.5)[0]]
        off_s += [float(np.abs(sound_s - at_s).min()) for at_s in jaw_s]
        heard += len(sound_s)
        fine_s = np.arange(0.0, plan.duration_s, 0.001)
        bounds = (joint.speed_max_deg_s, joint.accel_max_deg_s2)
        for order, bound in enumerate(bounds, start=1):
            broken += int((np.abs(plan.sample(fine_s, order)) > 1.001 * bound).sum())
        found = shortfall(voiced, lambda at_s, plan=plan: plan.sample(at_s)[:, 0])
        openings += found.openings
        less_deg += [found.median_deg] * bool(found.less)
        keys, seconds = keys + len(voiced.sequence.keyframes), seconds + plan.duration_s
    off_ms = 1000.0 * np.array(off_s)
    share = float((off_ms <= 1000.0 * NEAR_S).mean())
    return [
        Row(
            what=f"{what}: peaks of the jaw within 20 ms of one of the sound's, of {len(off_ms)} "
            f"(the sound has {heard})",
            ours=f"{share:.1%}; p50 {np.median(off_ms):.0f} ms, "
            f"p90 {np.percentile(off_ms, 90):.0f} ms",
            reference="95 %" if style.is_fitted else "",
            ratio=share / 0.95 if style.is_fitted else None,
            target=">= 1" if style.is_fitted else "",
            is_met=share >= 0.95 if style.is_fitted else None,
        ),
        Row(
            what=f"{what}: correlation of jaw and envelope, mean and least of {len(paths)}",
            ours=f"{np.mean(likeness):.2f}, {min(likeness):.2f}",
        ),
        Row(
            what=f"{what}: limits broken by more than 0.1 % at 1 kHz",
            ours=str(broken),
            ratio=float(broken),
            target="0",
            is_met=broken == 0,
        ),
        Row(
            what=f"{what}: keys per second; openings, less than asked by (median)",
            ours=f"{keys / seconds:.1f}; {openings}, {np.median(less_deg or [0.0]):.1f} deg",
        ),
    ]


def beat_rows(styles: Sequence[Style]) -> list[Row]:
    """Return what becomes of synthetic music of each kind."""
    kinds: dict[str, list[tuple[str, float, float]]] = {}
    shifted = warned = 0
    with tempfile.TemporaryDirectory() as name:
        import soundfile

        path = Path(name) / "song.wav"
        for style in styles:
            samples, true_s = music(style, BEATS_S)
            soundfile.write(path, np.clip(samples, -1.0, 1.0), RATE_HZ)
            found = beats_of(Part(path=path))
            kinds.setdefault(style.name, []).append(verdict(found.at_s, true_s))
            if kinds[style.name][-1][0] == "half off":
                shifted += verdict(half_shifted(found.at_s), true_s)[0] == "right"
                warned += found.off_beat_ratio > 0.4
    rows = []
    for kind, verdicts in kinds.items():
        counts = Counter(name for name, _, _ in verdicts)
        errors_ms = [1000.0 * abs(error_s) for name, _, error_s in verdicts if name == "right"]
        worst = f"; median error of these up to {max(errors_ms):.1f} ms" if errors_ms else ""
        rows.append(
            Row(
                what=f"beats, {kind}, {len(verdicts)} tempos from 60 to 180 bpm",
                ours=", ".join(f"{n} {name}" for name, n in counts.most_common()) + worst,
            )
        )
    every = [name for verdicts in kinds.values() for name, _, _ in verdicts]
    half_off = every.count("half off")
    rows.append(
        Row(
            what=f"beats half off, of {len(every)}: said so, and right after --shift half",
            ours=f"{half_off}: {warned}, {shifted}",
            ratio=shifted / half_off if half_off else None,
            target="1" if half_off else "",
            is_met=shifted == warned == half_off if half_off else None,
        )
    )
    return rows


def measure() -> list[Row]:
    """Measure the jaw, if espeak-ng is there, and the beats."""
    if shutil.which("espeak-ng") is None:
        missing = Row(what="jaw: espeak-ng is missing (sudo apt install espeak-ng)", ours="-")
        return [missing, *beat_rows(STYLES)]
    with tempfile.TemporaryDirectory() as name:
        paths = []
        for voice in VOICES:
            for number, sentence in enumerate(SENTENCES):
                paths.append(Path(name) / f"{voice}{number}.wav")
                command = ["espeak-ng", "-v", voice, "-w", str(paths[-1]), sentence]
                subprocess.run(command, check=True)
        full = VoiceStyle(is_fitted=False)
        rows = jaw_rows(paths, 25.0, VoiceStyle(), "jaw of 25 deg")
        rows += jaw_rows(paths, 12.0, VoiceStyle(), "jaw of 12 deg")
        rows += jaw_rows(paths, 25.0, full, "25 deg, the planner alone gives up angle")
    return [*rows, *beat_rows(STYLES)]
