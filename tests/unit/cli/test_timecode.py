"""Options of timecode that do not fit are refused before anything is opened."""

from __future__ import annotations

import pytest

from lss_motion.cli.play import make_parser, require_timecode
from lss_motion.errors import InputError
from lss_motion.stage.timecode.timecode import FPS_25, RATES, Timecode


def specs(*words):
    return require_timecode(make_parser().parse_args(["show.yaml", *words]))


def test_what_is_followed_and_sent_is_read():
    follow, sends = specs(
        *["--follow", "artnet:10.0.0.4", "--offset-s", "01:00:00:10", "--rate-fps", "25"],
        *["--send", "ltc:USB", "--send", "osc:10.0.0.9:8000", "--freewheel", "5"],
    )
    assert (follow.kind, follow.allowed, follow.freewheel_s) == ("artnet", ("10.0.0.4",), 5.0)
    assert follow.start.at_s(FPS_25) == pytest.approx(3600.4)
    assert sends[0].offset_s == pytest.approx(3600.4)
    assert not follow.is_loopback
    assert [(one.kind, one.name, one.port) for one in sends] == [
        ("ltc", "USB", 0),
        ("osc", "10.0.0.9", 8000),
    ]
    assert specs("--follow", "ltc")[0].is_loopback
    assert specs() == (None, [])


@pytest.mark.parametrize("rate", ["23.976", "24", "25", "29.97", "29.97df", "30"])
def test_a_label_at_which_a_show_begins_is_that_frame_at_every_rate(rate):
    words = ["--offset-s", "01:00:00:20", "--rate-fps", rate, "--send", "ltc"]
    follow, (send,) = specs("--follow", "ltc", *words)
    first = Timecode(1, 0, 0, 20).frame(RATES[rate])
    assert follow.start.show_s(first, RATES[rate]) == pytest.approx(0.0, abs=1e-9)
    assert send.offset_s * RATES[rate].frames_per_s == pytest.approx(first)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--follow", "ltc", "--virtual"], "--virtual"),
        (["--follow", "ltc", "--from", "3"], "--from"),
        (["--follow", "ltc", "--careful"], "--careful"),
        (["--follow", "vitc"], "no source"),
        (["--follow", "fpp", "--rate-fps", "25"], "FPP sends seconds"),
        (["--follow", "ltc", "--rate-fps", "26"], "no frame rate"),
        (["--follow", "ltc", "--offset-s", "1 o'clock"], "no start in timecode"),
        (["--follow", "artnet:desk"], "no address"),
        (["--send", "artnet"], "names no address"),
        (["--send", "mtc", "--rate-fps", "23.976"], "cannot name"),
        (["--follow", "ltc", "--rate-fps", "25", "--offset-s", "1:0:0:29"], "no frame"),
        (["--rate-fps", "25"], "--rate-fps and --offset-s"),
    ],
)
def test_what_does_not_fit_is_refused(words, text):
    with pytest.raises(InputError, match=text):
        specs(*words)
