"""The guide "A talking figure in ten minutes", followed from an empty folder.

The voice is synthetic, since espeak-ng is not everywhere, and so is the music.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import lss_motion as lss
from benches.drums import RATE_HZ, Style, music
from lss_motion.cli import main, play
from tests.speech import spoken

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)
GUIDE = Path(__file__).resolve().parents[2] / "sequences" / "guides" / "talking-figure.md"
TEXTGRID = """\
File type = "ooTextFile"
Object class = "TextGrid"
0 2 <exists> 1
"IntervalTier" "phones" 0 2 3
0 0.5 ""
0.5 0.8 "M"
0.8 2 "AA1"
"""


@pytest.mark.slow
def test_every_step_of_the_page_works_in_an_empty_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = GUIDE.read_text(encoding="utf-8")
    for name, content in re.findall(r"```yaml\n# (\w+\.yaml)\n(.*?)```", page, re.DOTALL):
        Path(name).write_text(content, encoding="utf-8")
    soundfile.write("voice.wav", spoken(np.arange(0.1, 5.0, 0.24).tolist(), 5.39), 22_050)
    samples, _ = music(Style(name="x", bpm=110, off_gain=0.3), 20.0)
    soundfile.write("song.wav", np.clip(samples, -1.0, 1.0), RATE_HZ)
    Path("voice.TextGrid").write_text(TEXTGRID)
    Path("labels.txt").write_text("0.5\t0.5\thello\n2.5\t3.0\trest\n")
    commands = re.findall(r"^\$ (lss-\w+ .*)$", page, re.MULTILINE)
    assert len(commands) == 11
    for command in commands:
        program, *words = shlex.split(command)
        run = play.main if program == "lss-play" else main.main
        typed = [*words, "--virtual", "--quiet"] if program == "lss-play" else words
        assert run(typed) == 0, (command, capsys.readouterr())
    assert Path("song.png").exists()
    sequence = lss.load_sequence("show.yaml")
    assert len(sequence.beats_s) > 10
    jaw = lss.plan(sequence, lss.load_robot("talker.yaml")).sample(np.arange(0.0, 5.0, 0.01))[:, 0]
    assert np.ptp(jaw) > 2.0
    assert lss.load_sequence("mouth.yaml").keyframes[-1].deg == {"jaw": 15.0}
