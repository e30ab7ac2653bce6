"""Lip-sync and label files: what each format says, and the keyframes that come of it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import lss_motion as lss
from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.interchange.importing import READERS, imported, read_motions
from lss_motion.interchange.labels import LabelStyle, label_sequence, shape_reader
from lss_motion.interchange.reader import LabelTrack, Span

ROBOT = {
    "robot": "talker",
    "defaults": {"model": "LSS-ST1", "speed_max_deg_s": 360, "accel_max_deg_s2": 1000},
    "joints": {"jaw": {"id": 1, "range_deg": [0, 25]}, "lip": {"id": 2, "range_deg": [-10, 10]}},
    "poses": {"home": {"jaw": 0, "lip": 0}, "gape": {"jaw": 25}},
    "visemes": {
        "rest": {"jaw": 0, "lip": 0},
        "MBP": {"jaw": 0, "lip": 5},
        "AI": {"jaw": 25, "lip": 0},
        "E": {"jaw": 12, "lip": -5},
        "O": {"jaw": 18, "lip": 8},
        "etc": {"jaw": 6, "lip": 0},
    },
}
CUES = [(0.0, 0.3, "X"), (0.3, 0.5, "D"), (0.5, 0.54, "A"), (0.54, 0.9, "E")]
TEXTGRID = """\
File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 1
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "IntervalTier"
        name = "phones"
        xmin = 0
        xmax = 1
        intervals: size = 3
        intervals [1]:
            xmin = 0
            xmax = 0.25
            text = ""
        intervals [2]:
            xmin = 0.25
            xmax = 0.5
            text = "M"
        intervals [3]:
            xmin = 0.5
            xmax = 1
            text = "AA1"
    item [2]:
        class = "TextTier"
        name = "said ""so"" ü"
        xmin = 0
        xmax = 1
        points: size = 1
        points [1]:
            number = 0.5
            mark = "gape"
"""
SHORT = """\
File type = "ooTextFile"
Object class = "TextGrid"

0
1
<exists>
2
"IntervalTier"
"phones"
0
1
3
0
0.25
""
0.25
0.5
"M"
0.5
1
"AA1"
"TextTier"
"said ""so"" ü"
0
1
1
0.5
"gape"
"""
PROJECT = """\
lipsync version 1
voice.wav
20
40
2
\tOwl
\tHi you
\t1
\t\tHi you
\t\t2
\t\t19
\t\t2
\t\t\tHi 2 5 2
\t\t\t\t2 etc
\t\t\t\t3 AI
\t\t\tyou 10 15 1
\t\t\t\t10 O
\tBear
\tMum
\t1
\t\tMum
\t\t4
\t\t9
\t\t1
\t\t\tMum 4 9 1
\t\t\t\t4 MBP
"""


def tracks(name, data, path="v.txt"):
    data = data.encode() if isinstance(data, str) else data
    reader = next(reader for reader in READERS if reader.recognises(data))
    assert reader.name == name
    found = reader.motions(Path(path), data)
    assert all(isinstance(track, LabelTrack) for track in found)
    return found


def spans(track):
    return [(span.from_s, span.to_s, span.text) for span in track.spans]


def sequence(track, **style):
    return label_sequence(track, lss.load_robot(ROBOT), LabelStyle(**style))[0]


def keys(made, joint="jaw"):
    return [(k.at_s, k.hold_s, k.deg[joint], k.label) for k in made.keyframes]


RHUBARB_JSON = (
    '{"metadata": {"soundFile": "v.wav", "duration": 0.9}, "mouthCues": ['
    + ", ".join(f'{{"start": {a}, "end": {b}, "value": "{c}"}}' for a, b, c in CUES)
    + "]}"
)
RHUBARB_XML = (
    '<?xml version="1.0"?>\n<rhubarbResult><metadata><soundFile>v.wav</soundFile></metadata>'
    "<mouthCues>"
    + "".join(f'<mouthCue start="{a}" end="{b}">{c}</mouthCue>' for a, b, c in CUES)
    + "</mouthCues></rhubarbResult>"
)
RHUBARB_TSV = "".join(f"{a:.2f}\t{c}\n" for a, _, c in [*CUES, (0.9, 1.0, "X")])


@pytest.mark.parametrize(
    ("text", "closing"),
    [(RHUBARB_JSON, []), (RHUBARB_XML, []), (RHUBARB_TSV, [(0.9, 0.9, "X")])],
)
def test_the_three_forms_of_rhubarb_say_the_same(text, closing):
    (track,) = tracks("rhubarb", text)
    assert spans(track) == CUES + closing
    made = sequence(track)
    assert keys(made) == [
        (0.05, 0.2, 0.0, "rest"),
        (0.35, 0.1, 25.0, "AI"),
        (0.52, 0.0, 0.0, "MBP"),
        (0.59, 0.26, 18.0, "O"),
        *((at_s, 0.0, 0.0, "rest") for at_s, _, _ in closing),
    ]
    assert made.keeps_time == {"jaw", "lip"}


def test_a_long_and_a_short_textgrid_say_the_same_in_utf_8_and_16(tmp_path):
    for text in (TEXTGRID.encode(), SHORT.encode(), TEXTGRID.encode("utf-16"), SHORT.encode()):
        (tmp_path / "a.TextGrid").write_bytes(text)
        phones, said = read_motions(tmp_path / "a.TextGrid")
        assert (phones.name, said.name) == ("phones", 'said "so" ü')
        assert spans(phones) == [(0.0, 0.25, ""), (0.25, 0.5, "M"), (0.5, 1.0, "AA1")]
        assert spans(said) == [(0.5, 0.5, "gape")]
    assert [(label, deg) for _, _, deg, label in keys(sequence(phones))] == [
        ("rest", 0.0), ("MBP", 0.0), ("AI", 25.0),
    ]  # fmt: skip
    (key,) = sequence(said, is_anchored=True).keyframes
    assert (key.at_s, key.deg, key.label, key.is_anchor) == (0.5, {"jaw": 25.0}, "gape", True)


def test_a_word_that_papagayo_did_not_know_has_no_phoneme():
    text = "lipsync version 1\nv.wav\n24\n48\n1\nA\nhi\n1\nhi\n2\n9\n2\nxq 2 5 0\nhi 6 9 1\n6 AI\n"
    (track,) = tracks("papagayo", text)
    assert [shape for _, _, shape in spans(track)] == ["AI"]


def test_each_voice_of_a_papagayo_project_is_a_track_with_rests_between_its_words():
    owl, bear = tracks("papagayo", PROJECT)
    assert (owl.name, bear.name, owl.sound) == ("Owl", "Bear", "voice.wav")
    assert spans(owl) == [(0.1, 0.15, "etc"), (0.15, 0.3, "AI"), (0.5, 0.8, "O")]
    assert [label for *_, label in keys(sequence(owl))] == ["rest", "etc", "AI", "rest", "O"]
    assert spans(bear) == [(0.2, 0.5, "MBP")]


def test_switch_data_counts_frames_from_1_at_a_rate_that_it_does_not_give():
    (track,) = tracks("papagayo", "MohoSwitch1\n1 rest\n13 AI\n25 rest\n")
    assert spans(track) == [(0.0, 0.5, "rest"), (0.5, 1.0, "AI"), (1.0, 1.0, "rest")]
    made = imported(track, lss.load_robot(ROBOT))
    assert any("Assumed: 24 frames per second" in comment for comment in made.comments)
    assert [at_s for at_s, *_ in keys(sequence(track, fps=12))] == [0.05, 1.05, 2.0]


def test_the_layers_of_an_xlights_track_are_tracks():
    row = '<Effect label="{}" starttime="{}" endtime="{}"/>'
    layers = [("Hi you", 0, 900), ("Hi", 0, 400)], [("Hi", 0, 400)], [("AI", 100, 400)]
    text = "".join(
        f"<EffectLayer>{''.join(row.format(*label) for label in layer)}</EffectLayer>"
        for layer in layers
    )
    found = tracks("xlights", f'<?xml version="1.0"?><timing name="V" x="1">{text}</timing>')
    assert [track.name for track in found] == ["V phrases", "V words", "V phonemes"]
    assert spans(found[2]) == [(0.1, 0.4, "AI")]
    assert keys(sequence(found[2]))[1] == (0.15, 0.2, 25.0, "AI")


def test_labels_of_audacity_become_keyframes_with_poses_held_to_their_end():
    text = "0.000000\t0.000000\thome\n1,5\t2,5\tgape\n\\\t100.0\t200.0\n2.0\t3.0\tbow\n"
    (track,) = tracks("audacity", text)
    with pytest.raises(InputError, match=r"label 'bow' is no pose of robot 'talker'.* --pose NAME"):
        sequence(track)
    made = sequence(track, pose="home")
    assert [(k.at_s, k.hold_s, k.label, dict(k.deg)) for k in made.keyframes] == [
        (0.0, 0.0, "home", {"jaw": 0.0, "lip": 0.0}),
        (1.5, 0.112702, "gape", {"jaw": 25.0}),  # It needs the rest of the time to get away.
        (2.0, 1.0, "bow", {"jaw": 0.0, "lip": 0.0}),
    ]
    assert made.keeps_time == frozenset()


@pytest.mark.parametrize(
    ("labels", "shapes"),
    [
        (["A", "B", "E", "F", ""], ["MBP", "etc", "O", "U", "rest"]),
        (["AI", "E", "mbp", "wq"], ["AI", "E", "MBP", "WQ"]),
        (["AA1", "B", "F", "OW0", "sil"], ["AI", "MBP", "FV", "O", "rest"]),
        (["ˈaː", "tʃ", "ə", "w", "uː"], ["AI", "etc", "E", "WQ", "U"]),
    ],
)
def test_the_kind_of_shapes_is_found_by_all_labels(labels, shapes):
    reader = shape_reader(labels)
    assert reader is not None
    assert [reader(label) for label in labels] == shapes
    assert shape_reader([*labels, "window"]) is None


def test_the_last_row_of_rhubarb_closes_the_mouth_once():
    for end in ("X", "A"):
        (track,) = tracks("rhubarb", f"0.00\tX\n0.50\tD\n1.00\t{end}\n")
        assert sequence(track).keyframes[-1].deg["jaw"] == 0.0
    (track,) = tracks("rhubarb", "0.00\tD\n0.50\tX\n1.00\tX\n")
    assert spans(track) == [(0.0, 0.5, "D"), (0.5, 1.0, "X")]


def test_a_robot_may_have_the_shapes_of_rhubarb_and_only_some():
    visemes = {"A": {"jaw": 0}, "D": {"jaw": 25}, "B": {"jaw": 6}}
    robot = lss.load_robot({**ROBOT, "visemes": visemes})
    (track,) = tracks("rhubarb", "0.00\tX\n0.50\tC\n1.00\tX\n")
    made = imported(track, robot)
    assert [frame.deg["jaw"] for frame in made.sequence.keyframes] == [0.0, 6.0, 0.0]
    assert any("B is taken for E" in comment for comment in made.comments)
    with pytest.raises(InputError, match="has no viseme for 'E'"):
        imported(tracks("rhubarb", "0.00\tX\n0.50\tE\n1.00\tX\n")[0], robot)
    bare = lss.load_robot({**ROBOT, "visemes": {}})
    with pytest.raises(
        InputError, match=r"holds mouth shapes, but robot 'talker' has none; .*visem"
    ):
        imported(track, bare)


def test_a_viseme_beyond_the_range_or_of_no_joint_is_refused():
    with pytest.raises(InputError) as caught:
        lss.load_robot({**ROBOT, "visemes": {"AI": {"jaw": 40}, "O": {"jawe": 1}}})
    assert "viseme 'AI'" in str(caught.value)
    assert "viseme 'O': unknown joint 'jawe'; did you mean 'jaw'?" in str(caught.value)


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 5.0), st.floats(0.0, 0.5), st.sampled_from(["AI", "MBP", "", "O"])
        ),
        min_size=1,
        max_size=12,
    )
)
def test_any_shapes_become_keys_that_can_be_planned(found):
    ordered = sorted((round(a, 6), round(a + b, 6), text) for a, b, text in found)
    track = LabelTrack(path=Path("x"), name="x", spans=tuple(Span(*one) for one in ordered),
                       is_mouth=True)  # fmt: skip
    made = sequence(track)
    ends_s = [(k.at_s, k.at_s + k.hold_s) for k in made.keyframes]
    assert all(before[1] < after[0] for before, after in pairwise(ends_s))


def test_import_writes_the_mouth_with_its_sound_and_refuses_other_options(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    import yaml

    Path("robot.yaml").write_text(yaml.safe_dump(ROBOT))
    Path("v.json").write_text(RHUBARB_JSON)
    Path("v.wav").write_bytes(b"a sound")
    words = ["import", "v.json", "--robot", "robot.yaml", "-o", "mouth.yaml"]
    assert main(words) == 0
    assert "The mouth cues of v.json (Rhubarb)." in capsys.readouterr().out
    made = lss.load_sequence("mouth.yaml")
    assert [cue.sound for cue in made.events] == [str(tmp_path / "v.wav")]
    assert made.keeps_time == {"jaw", "lip"}
    for options, said in (
        (["--clip"], "--clip: not for labels"),
        (["--fps", "25"], "gives its times itself; leave out --fps"),
        (["--gain-db", "3"], "--gain-db: only for a sound; add --joint"),
    ):
        assert main([*words, "--force", *options]) == 2
        assert said in capsys.readouterr().err
    Path("m.csv").write_text("t_s,jaw\n0,0\n1,5\n")
    assert main(["import", "m.csv", *words[2:], "--force", "--anchors"]) == 2
    assert "--anchors: only for labels, and this is a motion" in capsys.readouterr().err
