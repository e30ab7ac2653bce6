"""Operations on the text of files: what is asked for is what the text says, and nothing else."""

from __future__ import annotations

import random
from pathlib import Path

import msgspec
import pytest

from lss_motion.errors import InputError
from lss_motion.files.yaml_edit import Page
from lss_motion.files.yaml_source import parse_yaml
from lss_motion.playing.remote import schema as m
from lss_motion.show.key_edit import entries_at, lists_of, times_of
from lss_motion.studio.allowed import require_allowed
from lss_motion.studio.history import History
from lss_motion.studio.operations import RobotNames, new_texts

FILE = Path("/show/wave.yaml")
SHOW = """\
# A wave.  ümläut
sequence: Wäve
robot: arm.yaml

keyframes:
  # begins here
  - {deg: {a: 0, b: 1.50}, label: rest}   # at 0
  - {after_s: 0.5, deg: {a: 30}, hold_s: 0.2}

  # the second
  - after_s: 0.30   # in lines
    pose: up
    ease: linear
  - {at_s: 2.00, deg: {a: 5, b: 6}}
"""
ROBOT = RobotNames(
    poses={"up": {"a": 10.0, "b": 20.0}}, mirror={"a": ("b", -1), "b": ("a", -1), "c": ("c", 1)}
)


def key(index, *joints):
    return {"place": ["keyframes", index], "file": "w", **({"joints": joints} if joints else {})}


def text_after(op, text=SHOW, **fields):
    operation = msgspec.convert({"op": op, "revision": 0, **fields}, m.AnyOperation, strict=False)
    ((before, after),) = new_texts(operation, lambda _: (FILE, text), ROBOT).values()
    assert before == text
    return after


def lines_changed(before, after):
    """Return the lines that went and those that came."""
    old, new = before.splitlines(), after.splitlines()
    return [one for one in old if one not in new], [one for one in new if one not in old]


def test_a_key_that_is_moved_keeps_its_form_and_the_others_their_instants():
    after = text_after("key.move", keys=[key(1)], by_s=0.1)
    assert lines_changed(SHOW, after) == (
        [
            "  - {after_s: 0.5, deg: {a: 30}, hold_s: 0.2}",
            "  - after_s: 0.30   # in lines",
        ],
        [
            "  - {after_s: 0.6, deg: {a: 30}, hold_s: 0.2}",
            "  - after_s: 0.2   # in lines",
        ],
    )
    after = text_after("key.move", keys=[key(1)], by_s=0.1, ripple=True)
    assert lines_changed(SHOW, after)[1] == [
        "  - {after_s: 0.6, deg: {a: 30}, hold_s: 0.2}",
        "  - {at_s: 2.1, deg: {a: 5, b: 6}}",
    ]


def test_a_key_that_passes_another_goes_behind_it_with_its_comments():
    after = text_after("key.move", keys=[key(1)], by_s=0.75)
    assert after == SHOW.replace(
        """\
  - {after_s: 0.5, deg: {a: 30}, hold_s: 0.2}

  # the second
  - after_s: 0.30   # in lines
    pose: up
    ease: linear
""",
        """\
  # the second
  - after_s: 1   # in lines
    pose: up
    ease: linear

  - {after_s: 0.25, deg: {a: 30}, hold_s: 0.2}
""",
    )


def test_a_joint_that_is_moved_alone_gets_a_keyframe_of_its_own_or_joins_one():
    after = text_after("key.move", keys=[key(3, "a")], by_s=-0.5)
    assert lines_changed(SHOW, after) == (
        ["  - {at_s: 2.00, deg: {a: 5, b: 6}}"],
        ["  - {at_s: 1.5, deg: {a: 5}}", "  - {at_s: 2.00, deg: {b: 6}}"],
    )
    after = text_after("key.move", keys=[key(1, "a")], by_s=1.5)
    assert times_of(parse_yaml(after, FILE).value, ("keyframes",)) == [0.0, 1.0, 2.0, 2.0]
    assert "{at_s: 2.00, deg: {b: 6}}" in after, "it takes the place of the key there"
    after = text_after("key.move", keys=[key(0, "b")], by_s=0.5)
    assert "{after_s: 0.5, deg: {a: 30}, hold_s: 0.2}" in after, "what holds is not joined"
    text = SHOW.replace("{a: 5, b: 6}", "{a: 5}").replace("label: rest", "label: rest, hold_s: 0")
    after = text_after("key.move", text.replace(", hold_s: 0}", "}"), keys=[key(0, "b")], by_s=2)
    assert "{at_s: 2.00, deg: {a: 5, b: 1.5}}" in after, "what has the same values is joined"
    after = text_after("key.move", keys=[key(2, "b")], by_s=0.2)
    assert "    deg: {a: 10}" in after, "the rest of a pose stays"
    assert "    label: up" in after


def test_keys_are_added_set_and_deleted():
    after = text_after(
        "key.add",
        keys=[{"file": "w", "place": ["keyframes"], "at_s": 1.6, "deg": {"b": 3.14159}}],
    )
    assert lines_changed(SHOW, after) == ([], ["  - {after_s: 0.6, deg: {b: 3.142}}"])
    after = text_after(
        "key.add", keys=[{"file": "w", "place": ["keyframes"], "at_s": 0.5, "deg": {"b": 3}}]
    )
    assert lines_changed(SHOW, after)[1] == ["  - {after_s: 0.5, deg: {a: 30, b: 3}, hold_s: 0.2}"]
    after = text_after("key.set", keys=[key(1)], deg={"a": -7.5}, values={"ease": "hold"})
    assert lines_changed(SHOW, after)[1] == [
        "  - {after_s: 0.5, deg: {a: -7.5}, hold_s: 0.2, ease: hold}"
    ]
    after = text_after("key.set", keys=[key(1)], values={"hold_s": None})
    assert lines_changed(SHOW, after)[1] == [
        "  - {after_s: 0.5, deg: {a: 30}}",
        "  - after_s: 0.5   # in lines",
    ]
    after = text_after("key.delete", keys=[key(1)])
    assert lines_changed(SHOW, after)[1] == ["  - after_s: 1   # in lines"]
    after = text_after("key.delete", keys=[key(1)], ripple=True)
    assert lines_changed(SHOW, after)[1] == ["  - {at_s: 1.3, deg: {a: 5, b: 6}}"]
    after = text_after("key.delete", keys=[key(3, "a")])
    assert lines_changed(SHOW, after)[1] == ["  - {at_s: 2.00, deg: {b: 6}}"]


def test_keys_are_mirrored_by_the_images_of_the_robot():
    after = text_after("key.mirror", keys=[key(0), key(1), key(3)])
    assert lines_changed(SHOW, after)[1] == [
        "  - {deg: {a: -1.5, b: 0}, label: rest}   # at 0",
        "  - {after_s: 0.5, deg: {b: -30}, hold_s: 0.2}",
        "  - {at_s: 2.00, deg: {a: -6, b: -5}}",
    ]
    assert text_after("key.mirror", after, keys=[key(0), key(1), key(3)]).count("{a: 5, b: 6}") == 1
    after = text_after("key.mirror", keys=[key(3, "a")])
    assert lines_changed(SHOW, after)[1] == ["  - {at_s: 2.00, deg: {b: -5}}"]
    after = text_after("key.mirror", keys=[key(2)])
    assert "deg: {a: -20, b: -10}" in after, "a pose becomes angles"
    assert "label: up" in after
    text = SHOW.replace("a: ", "x: ").replace("b: ", "y: ")
    with pytest.raises(InputError, match="pairs under its key mirror"):
        text_after("key.mirror", text, keys=[key(0)])


def test_keys_are_scaled_in_time_or_in_angle():
    after = text_after("key.scale", keys=[key(1), key(3)], ratio=0.5, about_deg={"a": 10, "c": 0})
    assert lines_changed(SHOW, after)[1] == [
        "  - {after_s: 0.5, deg: {a: 20}, hold_s: 0.2}",
        "  - {at_s: 2.00, deg: {a: 7.5, b: 6}}",
    ]
    after = text_after("key.scale", keys=[key(3)], ratio=2, about_s=1.5)
    assert lines_changed(SHOW, after)[1] == ["  - {at_s: 2.5, deg: {a: 5, b: 6}}"]


def test_slopes_follow_what_is_done_to_their_keys():
    text = SHOW.replace(
        "{a: 5, b: 6}}", "{a: 5, b: 6}, slope_deg_s: {a: 20}}\n  - {at_s: 3, deg: {a: 0, b: 0}}"
    )
    last = "  - {at_s: 2.00, deg: {a: 5, b: 6}, slope_deg_s: {a: 20}}"
    assert last in text

    def line(op, **fields):
        return lines_changed(text, text_after(op, text, **fields))[1]

    assert line("key.set", keys=[key(3)], slope_deg_s={"a": None, "b": -7.5}) == [
        "  - {at_s: 2.00, deg: {a: 5, b: 6}, slope_deg_s: {b: -7.5}}"
    ]
    assert line("key.set", keys=[key(3)], slope_deg_s={"a": None}) == [
        "  - {at_s: 2.00, deg: {a: 5, b: 6}}"
    ]
    assert line("key.delete", keys=[key(3, "a")]) == ["  - {at_s: 2.00, deg: {b: 6}}"]
    assert line("key.move", keys=[key(3, "a")], by_s=0.5) == [
        "  - {at_s: 2.00, deg: {b: 6}}",
        "  - {at_s: 2.5, deg: {a: 5}, slope_deg_s: {a: 20}}",
    ]
    assert line("key.mirror", keys=[key(3)]) == [
        "  - {at_s: 2.00, deg: {a: -6, b: -5}, slope_deg_s: {b: -20}}"
    ]
    assert line("key.scale", keys=[key(3)], ratio=0.5, about_deg={"a": 0}) == [
        "  - {at_s: 2.00, deg: {a: 2.5, b: 6}, slope_deg_s: {a: 10}}"
    ]
    assert line("key.scale", keys=[key(3)], ratio=2, about_s=1.5) == [
        "  - {at_s: 2.5, deg: {a: 5, b: 6}, slope_deg_s: {a: 10}}"
    ]
    new = {"file": "w", "place": ["keyframes"], "at_s": 2, "deg": {"a": 1}}
    assert line("key.add", keys=[new | {"values": {"slope_deg_s": {"a": 3}}}]) == [
        "  - {at_s: 2.00, deg: {a: 1, b: 6}, slope_deg_s: {a: 3}}"
    ]
    with pytest.raises(InputError, match="x has no key here"):
        line("key.set", keys=[key(3)], slope_deg_s={"x": 1})


def test_keys_on_beats_stay_on_beats():
    text = (
        "sequence: s\nbeats: [0.5, 1, 1.5, 2]\nkeyframes:\n- {at_s: 0, deg: {a: 1}}\n"
        "- {at_beat: 2, deg: {a: 2}}\n- {at_beat: 3.5, deg: {a: 3}}\n"
    )
    after = text_after("key.move", text, keys=[key(1)], by_s=0.25)
    assert "- {at_beat: 2.5, deg: {a: 2}}" in after
    after = text_after("key.move", text, keys=[key(2)], by_s=4)
    assert "- {at_s: 5.75, deg: {a: 3}}" in after


def test_parts_of_a_show_are_inserted_moved_renamed_and_removed():
    layer = {"file": "blink.yaml", "weight": 0.5}
    text = text_after("item.insert", file="w", place=["layers"], index=0, value=layer)
    assert text == SHOW + "layers:\n  - {file: blink.yaml, weight: 0.5}\n"
    text = text_after("item.insert", text, file="w", place=["layers"], index=1, value=layer)
    text = text_after("value.set", text, file="w", place=["layers", 1, "weight"], value=0.75)
    assert text.endswith("{file: blink.yaml, weight: 0.5}\n  - {file: blink.yaml, weight: 0.75}\n")
    text = text_after("item.move", text, file="w", place=["layers"], index=1, to=0)
    text = text_after("item.delete", text, file="w", place=["layers"], index=1)
    assert text.endswith("layers:\n  - {file: blink.yaml, weight: 0.75}\n")
    assert text_after("item.delete", text, file="w", place=["layers"], index=0) == SHOW
    track = {"keyframes": [{"at_s": 0, "deg": {"c": 0}}, {"at_s": 1, "deg": {"c": 9}}]}
    text = text_after("value.set", file="w", place=["tracks", "jaw"], value=track)
    assert text.endswith(
        "tracks:\n  jaw:\n    keyframes:\n      - {at_s: 0, deg: {c: 0}}\n"
        "      - {at_s: 1, deg: {c: 9}}\n"
    )
    text = text_after("value.rename", text, file="w", place=["tracks", "jaw"], name="mouth")
    assert "tracks:\n  mouth:\n" in text
    assert text_after("value.set", text, file="w", place=["tracks"], value=None) == SHOW


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_lines_are_replaced_and_the_others_keep_their_ends(newline):
    text = SHOW.replace("\n", newline)
    after = text_after("text.set", text, file="w", from_line=2, to_line=3, lines=["sequence: x"])
    assert after == text.replace("sequence: Wäve", "sequence: x")
    after = text_after("text.set", text, file="w", from_line=1, to_line=1, lines=["# a", "# b"])
    assert after == f"# a{newline}# b{newline}{text}"
    after = text_after("text.set", "a: 1", file="w", from_line=2, to_line=2, lines=["b: 2"])
    assert after == "a: 1\nb: 2"


@pytest.mark.parametrize(
    ("op", "fields", "why"),
    [
        ("key.move", {"keys": [key(9)], "by_s": 1}, "there is no keyframe 9"),
        ("key.move", {"keys": [key(0)], "by_s": -1}, "before the start"),
        ("key.move", {"keys": [key(1, "c")], "by_s": 1}, "c has no key here"),
        ("key.move", {"keys": [key(2)], "by_s": -0.4}, "the end of the hold"),
        ("key.set", {"keys": [key(1)], "values": {"colour": 1}}, "no such value"),
        ("key.delete", {"keys": [key(i) for i in range(4)]}, "leave one"),
        ("key.delete", {"keys": [{"file": "w", "place": ["robot", 0]}]}, "no list of keyframes"),
        ("item.delete", {"file": "w", "place": ["keyframes"], "index": 4}, "has 4 items"),
        ("item.delete", {"file": "w", "place": ["robot"], "index": 0}, "is no list"),
        ("value.set", {"file": "w", "place": ["robot", "x"], "value": 1}, "there is no"),
        ("value.set", {"file": "w", "place": ["x"], "value": {"a": [None]}}, "null"),
        ("value.rename", {"file": "w", "place": ["robot"], "name": "keyframes"}, "there already"),
        ("text.set", {"file": "w", "from_line": 99, "to_line": 99, "lines": []}, "14 lines"),
    ],
)
def test_what_cannot_be_is_refused_in_words(op, fields, why):
    with pytest.raises(InputError, match=why):
        text_after(op, **fields)


def test_an_alias_is_not_changed_behind_its_back():
    text = "sequence: s\nkeyframes:\n- &k {at_s: 0, deg: {a: 1}}\n- {at_s: 1, deg: &d {a: 2}}\n"
    text += "tracks:\n  t:\n    keyframes:\n    - *k\n"
    with pytest.raises(InputError, match="alias"):
        text_after("key.set", text, keys=[key(0)], deg={"a": 2})
    after = text_after("key.set", text, keys=[key(1)], deg={"a": 3})
    assert after == text.replace("{a: 2}", "{a: 3}")


# ---- any operations on any file

EXAMPLES = sorted(
    path
    for folder in (Path("sequences"), Path("sequences/parts"))
    for path in folder.glob("*.yaml")
    if "keyframes" in parse_yaml(path.read_text(), path).value
    or "tracks" in parse_yaml(path.read_text(), path).value
)


def random_operation(draw, value):
    """Return an operation on some list of keyframes, as a page may send it."""
    places = lists_of(value)
    place = draw.choice(places)
    entries = entries_at(value, place)
    index = draw.randrange(len(entries))
    joints = [*entries[index].get("deg", {})]
    one = {"file": "w", "place": [*place, index]}
    if joints and draw.random() < 0.4:
        one["joints"] = draw.sample(joints, draw.randint(1, len(joints)))
    shift = draw.choice([0.01, -0.01, 0.1, -0.25, 1.0, -1.5, 3.3])
    name = draw.choice(joints or ["a"])
    match draw.randrange(9):
        case 0 | 1:
            ripple = draw.random() < 0.3
            return {"op": "key.move", "keys": [one], "by_s": shift, "ripple": ripple}
        case 2:
            deg = round(draw.uniform(-20, 20), 2)
            return {"op": "key.set", "keys": [one], "deg": {name: deg}}
        case 3:
            values = draw.choice(
                [{"label": "grüße"}, {"hold_s": 0.05}, {"ease": "linear"}, {"ease": None}]
            )
            return {"op": "key.set", "keys": [one], "values": values}
        case 4:
            new = {"file": "w", "place": place, "at_s": abs(shift) * index, "deg": {name: shift}}
            return {"op": "key.add", "keys": [new]}
        case 6:
            return {"op": "key.mirror", "keys": [one]}
        case 7:
            about_deg = dict.fromkeys(joints, 5.0)
            return {"op": "key.scale", "keys": [one], "ratio": 0.5, "about_deg": about_deg}
        case 5:
            return {"op": "key.delete", "keys": [one], "ripple": draw.random() < 0.5}
        case _:
            return {
                "op": "key.scale",
                "keys": [{"file": "w", "place": [*place, i]} for i in range(len(entries))],
                "about_s": 0.0,
                "ratio": draw.choice([0.5, 1.25, 2]),
            }


@pytest.mark.slow
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_any_operations_leave_what_they_do_not_touch(path, newline):
    """Comments stay, nothing outside of the list changes, and undo gives each byte back."""
    draw = random.Random(f"{path.name} {newline!r}")
    text = first = f"# äöü 😀\n{path.read_text()}".replace("\n", newline)
    done, history = 0, History()
    for _ in range(200):
        if history.undo_word is not None and draw.random() < 0.3:
            text = history.undo(lambda _, text=text: text)[path]
            continue
        value = parse_yaml(text, path).value
        operation = random_operation(draw, value)
        try:
            after = text_after(**operation, text=text)
        except InputError:
            continue
        done += 1
        require_allowed(Path("sequences").resolve(), path.resolve(), text, after)
        made = parse_yaml(after, path).value
        if count_of(made) >= count_of(value):  # Else a keyframe has gone, with its comment.
            assert comments_of(text) <= comments_of(after), operation
        assert ("\r\n" in after) == (newline == "\r\n")
        assert "\n" not in after.replace("\r\n", "") or newline == "\n"
        check_times(operation, value, made)
        check_span(operation, text, after)
        history.add("edit", {path: (text, after)})
        text = after
    assert done > 40
    while history.undo_word is not None:
        text = history.undo(lambda _, text=text: text)[path]
    assert text == first


def count_of(value):
    return sum(len(entries_at(value, place)) for place in lists_of(value))


def comments_of(text):
    return {line.partition(" # ")[2] for line in text.splitlines() if " # " in line}


def check_span(operation, before, after):
    """Check that only characters of the list of keyframes differ."""
    place = tuple(operation["keys"][0]["place"])
    place = place[: place.index("keyframes") + 1]
    node = Page(FILE, before).node(place)
    start = before.rfind("\n", 0, node.start) + 1
    while before[:start].splitlines()[-1].lstrip().startswith("#"):
        start = before.rfind("\n", 0, start - 1) + 1
    end = before.find("\n", node.end) + 1 or len(before)
    assert after.startswith(before[:start])
    assert after.endswith(before[end:])


def check_times(operation, before, after):
    """Check that all instants of other keyframes are what they were."""
    if operation["op"] != "key.set" or "hold_s" in operation.get("values", {}):
        return
    for place in lists_of(before):
        old, new = times_of(before, place), times_of(after, place)
        assert old == pytest.approx(new, abs=1e-5)
