from __future__ import annotations

import pytest

from lss_motion.protocol.constants import Led

KEYS = "  - {at_s: 0, pose: home}\n  - {at_s: 2, pose: out}\n"


def test_events_are_read(load, folder):
    (folder / "bell.wav").touch()
    (folder / "effects").mkdir()
    (folder / "effects" / "smoke.py").write_text("def fog(at_s): pass\n")
    show = load(
        KEYS
        + "events:\n"
        + "  - {at_s: 1, led: {base: red, elbow: white}}\n"
        + "  - {at_s: 1.5, say: hello}\n"
        + "  - {at_s: 1.5, run: 'effects.smoke:fog'}\n"
        + "  - {at_s: 2, sound: bell.wav, lead_s: 0.25}\n"
    )
    led, say, run, sound = show.events
    assert (led.at_s, led.led) == (1.0, (("base", Led.RED), ("elbow", Led.WHITE)))
    assert (say.at_s, say.say) == (1.5, "hello")
    assert (run.run, run.folder) == ("effects.smoke:fog", str(folder))
    assert (sound.sound, sound.start_s) == (str(folder / "bell.wav"), 1.75)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{at_s: 1}", "one of led, say, run, sound, not none"),
        ("{at_s: 1, say: a, run: 'b:c'}", "not say and run"),
        ("{at_s: 1, led: {bose: red}}", "unknown joint 'bose'"),
        ("{at_s: 1, led: {base: pink}}", "'pink'"),
        ("{at_s: 1, run: fog}", "'fog'"),
        ("{at_s: 1, run: 'nomodule:fog'}", "there is no module 'nomodule' in "),
        ("{at_s: 1, run: 'json.none:fog'}", "there is no module 'json.none' in "),
        ("{at_s: 1, run: 'json:lods'}", "did you mean 'loads'?"),
        ("{at_s: 1, sound: none.wav}", "sound file 'none.wav' not found"),
        ("{at_s: 1, say: a, lead_s: 1}", "lead_s belongs to a sound"),
        ("{say: a}", "at_s"),
    ],
)
def test_a_wrong_event_is_refused_with_its_line(refusals, entry, words):
    [(line, reason)] = refusals(KEYS + "events:\n  - " + entry + "\n")
    assert line == 7
    assert words in reason
