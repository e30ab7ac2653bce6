"""The pure modules of the pages, in the browser: the same cases in Python and JavaScript."""

from __future__ import annotations

import json

import numpy as np

from lss_motion.planning.program.model import Program, Repeat
from lss_motion.playing.remote.message import Telemetry
from lss_motion.playing.remote.schema import schema
from lss_motion.studio.view_curves import Curve


def modules(*names):
    """Return a script that imports modules; `then` gets them in this order."""
    paths = ", ".join(f"import('/static/{name}.js')" for name in names)
    return f"Promise.all([{paths}])"


def test_columns_hold_all_that_a_curve_does_within_them(wave, opened):
    random = np.random.default_rng(7)
    times_s = np.sort(random.uniform(0.0, 10.0, 60))
    times_s[20] = times_s[21]  # A jump.
    curve = Curve(times_s, random.uniform(-40, 40, 60), random.uniform(-90, 90, 60))
    given = json.dumps([values.tolist() for values in (curve.times_s, curve.deg, curve.deg_s)])
    with opened(wave) as page:
        found = page.run(
            modules("curves")
            + f""".then(([curves]) => {{
              const [times, deg, deg_s] = {given};
              const curve = {{times_s: Float64Array.from(times), deg: Float32Array.from(deg),
                deg_s: Float32Array.from(deg_s)}};
              const lows = new Float32Array(100), highs = new Float32Array(100);
              const step = (times[59] - times[0]) / 100;
              return [0, 2].flatMap((order) => {{
                curves.fillColumns(curve, order, times[0], step, lows, highs);
                return [[...lows], [...highs]];
              }});
            }})"""
        )
    lows, highs, least, most = np.array(found)
    step_s = (times_s[-1] - times_s[0]) / 100
    for column in range(100):
        at_s = times_s[0] + step_s * (column + np.linspace(0.0, 1.0, 41))
        values = curve.at(at_s)
        # Within a pixel a cubic bends by little.
        slack = 0.35 * step_s * np.abs(curve.at(at_s, 1)).max() + 0.02
        assert lows[column] <= values.min() + slack, column
        assert highs[column] >= values.max() - slack, column
        assert lows[column] >= values.min() - slack
        assert highs[column] <= values.max() + slack
        # The acceleration jumps at knots: both of its sides are within their column.
        inner_s = times_s[1:-1][(times_s[1:-1] >= at_s[0]) & (times_s[1:-1] <= at_s[-1])]
        sides = np.concatenate([curve.at(inner_s - 1e-9, 2), curve.at(inner_s + 1e-9, 2)])
        wide = 1e-3 * np.abs(sides).max(initial=1.0)
        assert sides.min(initial=np.inf) >= least[column] - wide
        assert sides.max(initial=-np.inf) <= most[column] + wide


def test_a_show_time_is_in_the_view_where_the_program_plays_it(wave, opened):
    shown_s = np.linspace(0.0, 145.0, 301).tolist()
    for times in (None, 40):
        repeat = Repeat(from_us=2_000_000, to_us=5_500_000, times=times)
        program = Program(
            name="p", robot="r", moves=(), duration_s=150.0 if times else float("inf"),
            start_deg={}, tolerance_deg=0.1, repeat=repeat,
        )  # fmt: skip
        view = {"repeat": {"from_s": 2.0, "to_s": 5.5, "times": times}}
        with opened(wave) as page:
            found = page.run(
                modules("curves")
                + f""".then(([curves]) =>
                  {json.dumps(shown_s)}.map((at) => curves.withinView({json.dumps(view)}, at)))"""
            )
        assert np.allclose(found, [program.within(at_s) for at_s in shown_s], atol=1e-9)


def test_telemetry_is_read_as_it_was_written(wave, opened):
    frame = Telemetry(bytes(range(8)), 12.625, 0.5, [(1.5, -2.25, float("nan")), (3.0, 4.0, 5.0)])
    assert schema()["x-telemetry"]["version"] == 1
    with opened(wave) as page:
        found = page.run(
            modules("messages")
            + f""".then(([messages]) => {{
              const own = messages.telemetryFrom(Uint8Array.from({[*frame.to_bytes()]}).buffer);
              const list = (values) => [...values].map((one) => Number.isNaN(one) ? null : one);
              return [own.plan, own.show_s, own.rate, list(own.planned_deg),
                list(own.predicted_deg), list(own.read_deg),
                messages.telemetryFrom(Uint8Array.from([9, 0, 0, 0]).buffer)];
            }})"""
        )
    expected = ["0001020304050607", 12.625, 0.5, [1.5, 3.0], [-2.25, 4.0], [None, 5.0], None]
    assert found == expected


def test_zoom_keeps_the_instant_under_the_pointer_and_the_show_in_sight(wave, opened):
    """And: no key has two meanings on one page, and what is drawn at a point is found there."""
    with opened(wave) as page:
        problems = page.run(
            modules("timeline/window", "timeline/hit", "keymap")
            + """.then(([w, hit, keymap]) => {
              const problems = [];
              for (const length of [0.4, 19.5, 600]) {
                const whole = w.fitted(length, 900);
                if (w.pixelOf(whole, 0) < 0 || w.pixelOf(whole, length) > 900) problems.push('fit');
                let seen = whole;
                for (let n = 0; n < 300; n += 1) {
                  const x = (n * 137) % 900;
                  const before = w.timeAt(seen, x);
                  const next = n % 3 === 2 ? w.panned(seen, (n % 7 - 3) * 90, length)
                    : w.zoomed(seen, n % 2 ? 1.6 : 0.7, x, length);
                  const margin_s = w.MARGIN_PX / next.px_per_s;
                  const inside = next.start_s > 1e-6 - margin_s
                    && w.endOf(next) < length + margin_s - 1e-6;
                  const moved = Math.abs(w.pixelOf(next, before) - x);
                  if (n % 3 !== 2 && inside && moved > 0.01) problems.push(`zoom ${moved}`);
                  if (next.start_s < whole.start_s - 1e-6) problems.push('before the start');
                  if (next.px_per_s < whole.px_per_s - 1e-9) problems.push('too far out');
                  seen = next;
                }
              }
              const times_s = Float64Array.from({length: 50}, (_, n) => n / 5);
              const view = {marks: [], joints: [], keys: {}, stretched: [], given_up: [],
                lanes: [{times_s, keys: Array.from(times_s, (at_s) => ({at_s}))}]};
              const rows = [{kind: 'lane', name: '', index: 0, y_px: 40, height_px: 20}];
              const seen = {start_s: 1, px_per_s: 90, width_px: 800};
              for (let n = 6; n < 40; n += 1) for (const off of [-5, 0, 5]) {
                const found = hit.hitAt(view, rows, seen,
                  {x_px: w.pixelOf(seen, times_s[n]) + off, y_px: 50, reach_px: 6});
                if (found.kind !== 'key' || found.key !== n) problems.push(`hit ${n} ${off}`);
              }
              for (const page of ['show', 'timeline', 'robot']) {
                const names = keymap.KEYMAP.filter((one) => !one.pages || one.pages.includes(page))
                  .flatMap((one) => one.keys);
                if (new Set(names).size !== names.length) problems.push(`keys of ${page}`);
                const unknown = names.filter((name) => keymap.actionOf(name, page) === null);
                problems.push(...unknown);
              }
              return problems;
            })"""
        )
    assert problems == []


def test_numbers_strips_and_readings_say_what_is(wave, opened):
    """No −0.0, nothing outside of its limits by noise, no readings of another show."""
    with opened(wave) as page:
        found = page.run(
            modules("numbers", "pages/robot_joints", "readings", "timeline/window", "reduce")
            + """.then(([numbers, joints, readings, times, reduce]) => {
              const troubled = (show_s) => reduce.reduce({ ...reduce.firstState(),
                health: { show_s } }, { type: 'event', event: { event: 'warned', text: '' } });
              const trace = new readings.ReadingTrace();
              for (let n = 0; n < 9; n += 1) trace.push('before', n / 10, [n], [n]);
              trace.push('now', 0.95, [5], [5]);
              // Two joints are not read for a second, in which only the second is to move.
              const unread = new readings.ReadingTrace();
              for (let n = 0; n <= 10; n += 1) {
                unread.push('now', n / 10, n < 10 ? [5, 5] : [6, 9], [5, 5 + 0.4 * n]);
              }
              const count = (own, deg) => [...deg.slice(0, own.count)].filter((one) => one === 5);
              const away = new readings.Deviations();
              away.take({ plan: 'before', predicted_deg: [1], read_deg: [4] });
              away.take({ plan: 'now', predicted_deg: [2], read_deg: [NaN] });
              const place = (deg) => {
                const own = joints.placeOnStrip([0, 70], deg);
                return own.isOutside ? 'outside' : own.isNear ? 'near' : 'within';
              };
              return {
                texts: [-0.04, 0.04, -0.06, -12.34, NaN, null].map((own) => numbers.number(own, 1)),
                places: [-0.1, 70.2, 35, -3, 73].map(place),
                times: [-0.04, 0, 61.26, -1.5].map((own) => times.timeText(own, 0.1)),
                troubles: [-0.1, 0.2].map((own) => troubled(own).trouble[0].at_s),
                kept: trace.segments.flatMap((own) => [...own.times_s.slice(0, own.count)]),
                away: Number.isNaN(away.of(0)),
                rests: unread.segments.map((own) => own.deg.map((deg) => count(own, deg).length)),
              };
            })"""
        )
    assert found["texts"] == ["0.0", "0.0", "−0.1", "−12.3", "–", "–"]
    assert found["places"] == ["near", "near", "within", "outside", "outside"]
    assert found["times"] == ["0:00.0", "0:00.0", "1:01.3", "−0:01.5"]
    assert found["troubles"] == [None, 0.2], "before the start there is no show time"
    assert found["kept"] == [0.95]
    assert found["away"] is True
    assert found["rests"] == [[2, 1]], "where a joint was that had to move is not known"


def test_the_figure_stands_where_the_robot_was_read(wave, opened):
    """While a show runs and when it has ended, whatever the cursor shows; who seeks sees it."""
    with opened(wave) as page:
        found = page.run(
            modules("figure/panel")
            + """.then(([panel]) => {
              const curve = (deg) => ({ times_s: Float64Array.from([0, 9]),
                deg: Float32Array.from([deg, deg]), deg_s: Float32Array.from([0, 0]) });
              const view = { joints: [{ name: 'arm' }], stretched: [], given_up: [],
                curves: { arm: { plan: curve(10), predicted: curve(10), authored: null } } };
              const shown = (read, isRunning, isSought) => {
                const own = panel.posesOf(view, read, { at_s: 3, isRunning, isSought });
                return [own.solid.arm, own.isRead, own.line?.arm ?? null];
              };
              return [shown(null, false, false), shown({ arm: 60 }, true, false),
                shown({ arm: 60 }, false, false), shown({ arm: 60 }, false, true)];
            })"""
        )
    assert found == [[10, False, None], [60, True, 10], [60, True, None], [10, False, 60]]


def test_a_span_leaves_its_row_readable_and_added_keys_stand_on_the_curve(wave, opened):
    with opened(wave) as page:
        found = page.run(
            modules("timeline/draw", "timeline/layout")
            + """.then(([draw, layout]) => {
              const curve = { times_s: Float64Array.from([0, 9]), deg: Float32Array.from([20, 20]),
                deg_s: Float32Array.from([0, 0]) };
              const key = { at_s: 4, deg: -12, hold_s: 0, is_anchor: false, lane: 0, key: 0 };
              const view = { view_s: 9, repeat: null, tolerance_deg: 0.2, marks: [], parts: [],
                events: [], beats: [],
                waveforms: [], stretched: [], asked: [], error: {}, line: {}, lanes: [],
                given_up: [{ joint: 'a', from_s: 0, to_s: 9, at_s: 1, deg: 0.8, text: '' }],
                joints: [{ name: 'a', range_deg: [-90, 90] }],
                curves: { a: { plan: curve, predicted: curve, authored: null } }, keys: {} };
              const seen = { start_s: 0, px_per_s: 50, width_px: 450 };
              const rows = layout.rowsInSight(layout.layoutOf(view), 0, 300);
              const drawn = (is_added) => {
                const fills = [], clips = [], points = [];
                let alpha = 1;
                const ctx = new Proxy({}, {
                  get: (_, name) => name === 'fillRect'
                    ? (...box) => fills.push([alpha, ...box])
                    : name === 'rect' ? (...box) => clips.push(box)
                    : name === 'measureText' ? () => ({ width: 0 })
                    : name === 'moveTo' ? (...at) => points.push(at) : () => {},
                  set: (_, name, value) => {
                    if (name === 'globalAlpha') alpha = value;
                    return true;
                  },
                });
                view.keys.a = [{ ...key, is_added }];
                draw.drawTimeline(ctx, { view, rows, seen, fixed_px: 26, height_px: 300, order: 0,
                  selection: null, row: 0, palette: { given_up: 'red' },
                  used_deg: { a: [-12, 20] } });
                return { fills, clips, points };
              };
              const row = rows.find((one) => one.kind === 'joint');
              const scene = { view, order: 0, used_deg: { a: [-12, 20] } };
              const scale = draw.scaleOf(scene, row);
              const diamond = (own) => own.points.filter(([x]) => x === 200)
                .map(([, y]) => y);
              const isTall = ([alpha, , , , height]) => alpha > 0.1 && height > 20;
              return { fills: drawn(false).fills.filter(isTall),
                strips: drawn(false).clips.map((box) => box[3]), added: diamond(drawn(true)),
                own: diamond(drawn(false)), wanted: [scale.y(20), scale.y(-12)] };
            })"""
        )
    rows = [box for box in found["fills"] if box[3] > 100 and 40 < box[4] < 100]
    assert rows == [], "a span of 0.8° fills no row"
    assert min(found["strips"]) <= 8, "it is hatched in a strip"
    on_curve, off_curve = found["wanted"]
    assert any(abs(y - on_curve) < 6 for y in found["added"])
    assert not any(abs(y - off_curve) < 6 for y in found["added"])
    assert any(abs(y - off_curve) < 6 for y in found["own"])
