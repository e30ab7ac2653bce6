"""The pure modules with which keys are shaped: gestures, drafts, estimates, edits, text."""

from __future__ import annotations

import json
import random

import pytest

from tests.browser.test_pure import modules

VIEW = """
const lane = (name, keys, more) => ({ name, kind: 'track', file: 'show.yaml', is_added: false,
  joints: ['pan', 'tilt'], keys, times_s: Float64Array.from(keys, (own) => own.at_s), ...more });
const item = (n, at_s, deg, more) => ({ at_s, authored_s: at_s, hold_s: 0, is_anchor: false,
  label: '', ease: 'smooth', line: n + 4, place: ['keyframes', n], deg, slope_deg_s: {},
  ...more });
const lanes = [lane('show', [item(0, 0, { pan: 0, tilt: 0 }), item(1, 2, { pan: 40, tilt: -20 }),
  item(2, 4, { pan: 0 }), item(3, 6, { pan: 30, tilt: 10 }, { hold_s: 1 })])];
const keys = { pan: [], tilt: [] };
lanes[0].keys.forEach(({ at_s, hold_s, deg }, key) => {
  for (const joint in deg) {
    const more = { lane: 0, key, is_anchor: false, is_added: false };
    keys[joint].push({ at_s, deg: deg[joint], hold_s, ...more });
  }
});
const limits = { range_deg: [-90, 90], speed_max_deg_s: 100, accel_max_deg_s2: 500 };
const curve = { times_s: Float64Array.from([0, 9]), deg: Float32Array.from([5, 5]),
  deg_s: Float32Array.from([0, 0]) };
const view = { lanes, keys, joints: [{ name: 'pan', ...limits }, { name: 'tilt', ...limits }],
  marks: [{ label: 'there', at_s: 2.503 }], events: [], beats: [], view_s: 8, waveforms: [],
  parts: [], line: {},
  curves: { pan: { plan: curve }, tilt: { plan: curve } } };
const seen = { start_s: 0, px_per_s: 100, width_px: 800 };
const ref = (key, joint = null) => ({ lane: 0, key, joint });
"""


def asked(page, names, body):
    """Return what a function says that has the modules as arguments, and `VIEW` around it."""
    arguments = ", ".join(name.rpartition("/")[2] for name in names)
    return page.run(modules(*names) + f".then(([{arguments}]) => {{ {VIEW}\n{body} }})")


GESTURES = """
const finger = (x_px, y_px, id = 1) => ({ id, x_px, y_px });
const key = { kind: 'key', ...ref(1), at_s: 2 };
const down = (hit, more) => ({ kind: 'down', finger: finger(200, 50), hit, isTouch: false,
  isMiddle: false, isAdded: false, isChosen: false, ...more });
const move = (x, y) => ({ kind: 'move', finger: finger(x, y), isFine: false, snaps: false });
const up = (x, y) => ({ kind: 'up', finger: finger(x, y) });
const told = (...inputs) => {
  let gesture = gestures.REST;
  const acts = inputs.flatMap((input) => {
    const [next, own] = gestures.afterInput(gesture, input);
    gesture = next;
    return own.map((one) => one.act);
  });
  return [gesture.kind, acts.join(' ')];
};
const row = { kind: 'row', row: {}, at_s: 2 };
const other = { ...finger(300, 50, 2) };
const touch = { isTouch: true };
const second = { ...down(row, touch), finger: other };
const grab = { kind: 'grab', mode: 'move', at: finger(200, 50), hit: key };
const steps = { kind: 'steps', by: { by_s: 0.01, by_deg: 0 } };
return {
  'click on a key': told(down(key), up(200, 50)),
  'a slip is no drag': told(down(key), move(202, 51), up(202, 51)),
  'drag a key': told(down(key), move(240, 50), move(260, 50), up(260, 50)),
  'drag one of the chosen': told(down(key, { isChosen: true }), move(240, 50), up(240, 50)),
  'Shift-click adds or leaves': told(down(key, { isAdded: true }), up(200, 50)),
  'Shift-drag adds, then drags': told(down(key, { isAdded: true }), move(240, 50), up(240, 50)),
  'Escape while dragging': told(down(key), move(240, 50), { kind: 'drop' }, up(240, 50)),
  'click on nothing': told(down(row), up(200, 50)),
  'box': told(down(row), move(260, 90), up(260, 90)),
  'ruler': told(down({ kind: 'ruler', at_s: 2 }), move(260, 50), up(260, 50)),
  'middle button': told(down(row, { isMiddle: true }), move(260, 50), up(260, 50)),
  'a finger pans': told(down(row, touch), move(260, 50), up(260, 50)),
  'a finger drags a key': told(down(key, touch), move(260, 50), up(260, 50)),
  'long touch on a key': told(down(key, touch), { kind: 'held' }, up(200, 50)),
  'long touch beside keys': told(down(row, touch), { kind: 'held' }, up(200, 50)),
  'no menu while panning': told(down(row, touch), move(260, 50), { kind: 'held' }),
  'two fingers': told(down(row, touch), second, move(150, 50), up(150, 50)),
  'two fingers while a key is dragged':
    told(down(key, touch), move(240, 50), second, move(150, 50)),
  'another finger does not move the key':
    told(down(key), { ...move(240, 50), finger: finger(240, 50, 9) }),
  'G, then a click': told(grab, move(240, 50), up(240, 50), down(row), up(240, 50)),
  'G, arrow keys, Enter': told(grab, steps, steps, { kind: 'take' }),
  'G, then Escape': told(grab, move(240, 50), { kind: 'drop' }),
  'G, then a finger': told(grab, down(row, touch), move(260, 50), up(260, 50)),
  'B, then a box from a key': told({ kind: 'arm' }, down(key), move(260, 90), up(260, 90)),
  'B, then Escape': told({ kind: 'arm' }, { kind: 'drop' }),
  'no G while dragging': told(down(key), move(240, 50), grab),
};
"""
TOLD = {
    "click on a key": ["rest", "choose choose"],
    "a slip is no drag": ["rest", "choose choose"],
    "drag a key": ["rest", "choose draft draft commit undraft"],
    "drag one of the chosen": ["rest", "draft commit undraft"],
    "Shift-click adds or leaves": ["rest", "toggle"],
    "Shift-drag adds, then drags": ["rest", "choose draft commit undraft"],
    "Escape while dragging": ["rest", "choose draft undraft"],
    "click on nothing": ["rest", "choose"],
    "box": ["rest", "draft box undraft"],
    "ruler": ["rest", "cursor cursor"],
    "middle button": ["rest", "pan"],
    "a finger pans": ["rest", "pan"],
    "a finger drags a key": ["rest", "choose draft commit undraft"],
    "long touch on a key": ["rest", "choose menu"],
    "long touch beside keys": ["rest", "menu"],
    "no menu while panning": ["pan", "pan"],
    "two fingers": ["pan", "zoom"],
    "two fingers while a key is dragged": ["pinch", "choose draft undraft zoom"],
    "another finger does not move the key": ["press", "choose"],
    "G, then a click": ["rest", "draft draft commit undraft"],
    "G, arrow keys, Enter": ["rest", "draft draft draft commit undraft"],
    "G, then Escape": ["rest", "draft draft undraft"],
    "G, then a finger": ["rest", "draft draft commit undraft"],
    "B, then a box from a key": ["rest", "draft box undraft"],
    "B, then Escape": ["rest", "undraft"],
    "no G while dragging": ["keys", "choose draft"],
}


def test_what_pointers_do_is_told_by_one_table(wave, opened):
    with opened(wave) as page:
        assert asked(page, ["timeline/gestures"], GESTURES) == TOLD


DRAFTS = """
const finger = (x_px, y_px) => ({ id: 1, x_px, y_px });
const drafted = (keys, hit, to, more = {}) => {
  const gesture = { kind: 'keys', from: finger(200, 50), at: finger(...to),
    hit: { kind: 'key', at_s: 2, ...hit }, axis: 'free', isFine: false, snaps: false,
    mode: 'move', isLoose: false, steps: { by_s: 0, by_deg: 0 }, ...more };
  const own = draft.draftOf(gesture, { view, seen, keys, cursor_s: 1, deg_per_px: 0.2 });
  return [own.by_s, own.by_deg, own.what, own.late && own.late.joint];
};
const one = [ref(1)], pan = [ref(1, 'pan')];
return {
  'a lane: in time, in steps of 10 ms': drafted(one, ref(1), [233.4, 90]),
  'fine: a tenth, in steps of 1 ms': drafted(one, ref(1), [233.4, 50], { isFine: true }),
  'Ctrl: to a label': drafted(one, ref(1), [248, 50], { snaps: true }),
  'Ctrl: to another key': drafted(one, ref(1), [397, 50], { snaps: true }),
  'Ctrl: to the grid': drafted(one, ref(1), [333, 50], { snaps: true }),
  'a joint: its angle, in steps of half a degree': drafted(pan, ref(1, 'pan'), [202, 29]),
  'both': drafted(pan, ref(1, 'pan'), [240, 10]),
  'x: time only': drafted(pan, ref(1, 'pan'), [240, 10], { axis: 'time' }),
  'y: angle only': drafted(pan, ref(1, 'pan'), [240, 10], { axis: 'angle' }),
  'not beyond its range': drafted(pan, ref(1, 'pan'), [200, -900]),
  'not before the start': drafted(one, ref(1), [-900, 50]),
  'too fast, and which joint': drafted(one, ref(1), [390, 50]),
  'by arrow keys': drafted(pan, ref(1, 'pan'), [200, 50], { steps: { by_s: 0.03, by_deg: -1.5 } }),
};
"""
DRAFTED = {
    "a lane: in time, in steps of 10 ms": [0.33, 0, "", None],
    "fine: a tenth, in steps of 1 ms": [0.033, 0, "", None],
    "Ctrl: to a label": [0.503, 0, "there", None],
    "Ctrl: to another key": [2, 0, "a key of show", "pan"],
    "Ctrl: to the grid": [1.3, 0, "the grid", None],
    "a joint: its angle, in steps of half a degree": [0, 4, "", None],
    "both": [0.4, 8, "", None],
    "x: time only": [0.4, 0, "", None],
    "y: angle only": [0, 8, "", None],
    "not beyond its range": [0, 50, "", None],
    "not before the start": [-2, 0, "", "pan"],
    "too fast, and which joint": [1.9, 0, "", "pan"],
    "by arrow keys": [0.03, -1.5, "", None],
}


def test_dragged_keys_come_to_rest_at_even_places_and_say_who_is_late(wave, opened):
    with opened(wave) as page:
        found = asked(page, ["timeline/draft"], DRAFTS)
    for name, (by_s, by_deg, what, late) in DRAFTED.items():
        assert found[name] == [pytest.approx(by_s), pytest.approx(by_deg), what, late], name


def test_an_estimate_is_never_more_than_the_least_time(wave, opened):
    """A trapezoid of speed is the fastest way from rest to rest; on the way, the speed alone."""
    draw = random.Random(5)
    cases = [
        (draw.uniform(0, 200), draw.uniform(20, 400), draw.uniform(50, 3000)) for _ in range(200)
    ]
    with opened(wave) as page:
        found = asked(
            page, ["timeline/estimate"],
            f"""return {json.dumps(cases)}.map(([by, speed_max_deg_s, accel_max_deg_s2]) =>
              [true, false].map((isRest) => {{
                const limits = {{ speed_max_deg_s, accel_max_deg_s2 }};
                const {{ least_s }} = estimate.leastTime(-by, limits, isRest);
                return [least_s, estimate.farthest(least_s, limits, isRest)];
              }}));""",
        )  # fmt: skip
        low, high = asked(
            page,
            ["timeline/estimate"],
            """
          const stop = (at_s, deg) => ({ at_s, deg, hold_s: 0.5 });
          return estimate.corridor(limits, stop(0, 0), stop(2, 80), 1);""",
        )
    for (by, speed, accel), ((rest_s, far), (way_s, way)) in zip(cases, found, strict=True):
        assert (far, way) == (pytest.approx(by), pytest.approx(by)), "and how far is its inverse"
        ramp_s = min(speed / accel, (by / accel) ** 0.5)
        covered = accel * ramp_s**2 + speed * (rest_s - 2 * ramp_s)
        assert covered == pytest.approx(by, abs=1e-6)
        assert way_s == pytest.approx(by / speed)
    assert (low, high) == (-20.0, 50.0), "what the time before and after it allows"


EDITS = """
const mixed = [ref(1), ref(2, 'pan'), ref(3, 'tilt')];
const copy = edits.copied(view, mixed);
return {
  addresses: edits.addressesOf(view, mixed),
  move: edits.moveOf(view, [ref(3, 'tilt')], { by_s: 0.5, by_deg: 2, ripple: true }),
  nothing: edits.moveOf(view, [ref(1)], { by_s: 0, by_deg: 0, ripple: false }),
  remove: edits.deleteOf(view, [ref(3, 'pan'), ref(3, 'tilt')], false),
  add: edits.addOf(view, 0, [{ at_s: 1, deg: { pan: 3 } }]),
  paste: edits.pasteOf(view, copy, 10),
  chosen: keys_.refound(view, keys_.placesOf(view, [ref(1), ref(3, 'tilt')])),
  undone: keys_.refound(view, keys_.placesOf(view, [ref(1)], 0.5)),
  gone: keys_.refound(view, [{ lane: 'show', at_s: 2.5, joint: null, nth: 1, of: 9 }]),
};
"""


def test_what_is_done_to_keys_is_told_by_their_places(wave, opened):
    with opened(wave) as page:
        found = page.run(
            modules("edits", "timeline/keys") + f".then(([edits, keys_]) => {{ {VIEW}\n{EDITS} }})"
        )

    def at(number, *joints):
        own = {"file": "show.yaml", "place": ["keyframes", number]}
        return own | ({"joints": list(joints)} if joints else {})

    listed = {"file": "show.yaml", "place": ["keyframes"]}
    assert found["addresses"] == [at(1), at(2), at(3, "tilt")], "a key of one joint is whole"
    assert found["move"] == {
        "op": "key.move",
        "fields": {"keys": [at(3, "tilt")], "by_s": 0.5, "by_deg": {"tilt": 2}, "ripple": True},
    }
    assert found["nothing"] is None
    assert found["remove"]["fields"]["keys"] == [at(3)]
    assert found["add"]["fields"]["keys"] == [listed | {"at_s": 1, "deg": {"pan": 3}}]
    assert found["paste"]["fields"]["keys"] == [
        listed | {"at_s": 10, "deg": {"pan": 40, "tilt": -20}},
        listed | {"at_s": 12, "deg": {"pan": 0}},
        listed | {"at_s": 14, "deg": {"tilt": 10}, "values": {"hold_s": 1}},
    ]
    assert [one["key"] for one in found["chosen"]] == [1, 3]
    assert found["undone"] == [{"lane": 0, "key": 1, "joint": None}]
    assert found["gone"] == []


def test_keys_are_hit_within_12_px_by_mouse_and_44_by_touch_and_boxed(wave, opened):
    with opened(wave) as page:
        found = page.run(
            modules("timeline/hit", "timeline/keys", "timeline/layout")
            + f".then(([hit, keys_, layout]) => {{ {VIEW}\n"
            + """
              view.stretched = []; view.given_up = [];
              const rows = layout.rowsInSight(layout.layoutOf(view), 0, 900);
              const row = rows.find((one) => one.name === 'pan');
              const yOf = (own, key) => own.y_px + own.height_px / 2 - key.deg / 2;
              const y = row.y_px + row.height_px / 2 - 20;
              const kindAt = (x, dy, reach_px) =>
                hit.hitAt(view, rows, seen, { x_px: 200 + x, y_px: y + dy, reach_px, yOf }).kind;
              const boxed = (left_px, right_px, top_px, bottom_px) => {
                const box = { left_px, right_px, top_px, bottom_px };
                return keys_.keysInBox(view, rows, seen, box, yOf)
                  .map((own) => `${own.joint ?? 'lane'} ${own.key}`);
              };
              const middle = row.y_px + row.height_px / 2;
              return {
                mouse: [kindAt(6, 0, hit.REACH_PX), kindAt(7, 0, hit.REACH_PX),
                  kindAt(0, 6, hit.REACH_PX), kindAt(0, 8, hit.REACH_PX)],
                touch: [kindAt(22, 0, hit.TOUCH_REACH_PX), kindAt(23, 0, hit.TOUCH_REACH_PX),
                  kindAt(0, 22, hit.TOUCH_REACH_PX)],
                all: boxed(0, 800, 0, 900).length,
                upper: boxed(150, 700, row.y_px, middle - 5),
              };
            })"""
        )
    assert found["mouse"] == ["key", "row", "key", "row"]
    assert found["touch"] == ["key", "row", "key"]
    assert found["all"] == 4 + 4 + 3, "every key of the lane and of both joints"
    assert found["upper"] == ["pan 1", "pan 3"]


def test_lines_that_are_others_are_all_that_is_sent(wave, opened):
    """Whatever is typed: the lines that are sent make the typed text of the old one."""
    draw = random.Random(9)
    cases = []
    for _ in range(300):
        before = [draw.choice("ab") for _ in range(draw.randrange(1, 8))]
        after = list(before)
        for _ in range(draw.randrange(0, 3)):
            at = draw.randrange(0, len(after) + 1)
            after[at : at + draw.randrange(0, 3)] = [
                draw.choice("abc") for _ in range(draw.randrange(0, 3))
            ]
        cases.append(["\n".join(before), "\n".join(after)])
    with opened(wave) as page:
        found = asked(
            page, ["parts/text"],
            f"return {json.dumps(cases)}.map(([one, other]) => text.changedLines(one, other));",
        )  # fmt: skip
    for (before, after), change in zip(cases, found, strict=True):
        if change is None:
            assert before == after
            continue
        lines = before.split("\n")
        lines[change["from_line"] - 1 : change["to_line"] - 1] = change["lines"]
        assert "\n".join(lines) == after
