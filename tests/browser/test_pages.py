"""The pages in a real browser, against the real studio with a simulated robot."""

from __future__ import annotations

import json
import shutil
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import lss_motion as lss

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
PLAYING = "document.querySelector('.word')?.textContent === 'playing'"
MODULE = "import('/static/{}.js')"


def test_a_show_is_seen_and_run_with_the_keyboard_alone(studio, opened):
    """No pointer, no request to another origin, every control named, readings over the plan."""
    with studio(EXAMPLES / "wave.yaml") as own, opened(own) as page:
        page.key(" ")
        page.wait("document.querySelector('.state-detail')?.textContent === 'moves to the start'")
        page.wait(PLAYING)
        page.key(" ")
        page.wait("document.querySelector('.word').textContent === 'paused'")
        page.key(" ")
        page.wait(PLAYING)
        check_names(page)
        page.key("2")
        page.wait("document.querySelector('.board-plan')")
        page.wait("document.querySelector('.figure-views')")
        page.key("]")
        page.wait("document.querySelector('.about h2').textContent.startsWith('Key')")
        page.key("Alt+a")  # Arrows move what is chosen.
        page.key("ArrowDown")
        page.key("]")
        page.idle()
        assert page.run("document.querySelector('#mirror [aria-selected=true]').textContent")
        focus = page.run("document.querySelector('#chosen-key').textContent")
        assert "deg" in focus
        check_names(page)
        page.wait(painted("live", "--reading"))
        page.run("document.querySelector('[aria-label=\"Light theme\"]').click()")
        page.wait("document.documentElement.dataset.theme === 'light'")
        page.key("?")
        page.wait("document.querySelector('dialog .keys')")
        page.key("Enter")
        page.wait("!document.querySelector('dialog')")
        page.key("Escape")  # It gives up the chosen key; only the next one stops.
        page.wait("document.querySelector('#chosen-key')?.textContent !== " + repr(focus))
        page.key("Escape")
        page.wait("document.body.dataset.latched === 'true'")
        origins = {request.split(" ")[1].split("/")[2] for request in page.requests}
        ours = {address.split("/")[2] for address in (own.origin, own.stop_origin)}
        assert origins <= ours | {"127.0.0.1"} | {""}, origins


def check_names(page):
    """Assert that assistive technology has a name for every control."""
    controls = (
        "button",
        "tab",
        "slider",
        "radio",
        "grid",
        "textbox",
        "meter",
        "radiogroup",
    )
    unnamed = [role for role, name in page.names() if role in controls and not name.strip()]
    assert unnamed == []
    assert ("button", "STOP brakes · Esc") in page.names()


def painted(layer, colour):
    """Return a script: whether a canvas of the timeline has pixels of a colour of the theme."""
    return f"""(() => {{
      const canvas = document.querySelector('.board-{layer}');
      const own = getComputedStyle(canvas).getPropertyValue('{colour}').trim();
      const [r, g, b] = [1, 3, 5].map((n) => parseInt(own.slice(n, n + 2), 16));
      const {{ data }} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
      let count = 0;
      for (let n = 0; n < data.length; n += 4) {{
        const off = Math.abs(data[n] - r) + Math.abs(data[n + 1] - g) + Math.abs(data[n + 2] - b);
        if (data[n + 3] > 200 && off < 12) count += 1;
      }}
      return count > 20;
    }})()"""


HINT = "document.querySelector('.banner-note')?.textContent.includes('No key is chosen')"


def test_whoever_changes_no_key_is_told_and_a_line_leads_to_the_file(wave, opened):
    with opened(wave) as page:
        page.key("2")
        page.wait("document.querySelector('.board-plan')")
        page.wait("document.querySelector('[role=grid]')")
        at = "document.querySelector('.way-at').textContent"
        assert page.run(at) == "0:00.0", "where the cursor is, not how long the show is"
        for key in ("Delete", "t", "n", "Control+c", "Enter"):
            page.key(key)
            page.wait(HINT)
            page.key("Escape")
            page.wait(f"!({HINT})")
            assert page.run("document.body.dataset.latched") == "false", key
        for _ in range(3):
            page.key("]")
        page.click(".about .file-line")
        line = page.wait("document.querySelector('.file-text [aria-current]')?.textContent")
        assert "deg: {wrist:" in line


@pytest.mark.slow
def test_a_file_that_changes_is_shown_and_an_error_stands_at_its_line(studio, opened, tmp_path):
    shutil.copytree(EXAMPLES / "robots", tmp_path / "robots")
    show = tmp_path / "wave.yaml"
    good = (EXAMPLES / "wave.yaml").read_text(encoding="utf-8")
    show.write_text(good, encoding="utf-8")
    with studio(show) as own, opened(own) as page:
        assert page.run("document.querySelector('.clock-of').textContent") == "of 0:19.5"
        show.write_text(good.replace("wrist: 22}}", "wrist: 999}}", 1), encoding="utf-8")
        line = 1 + good[: good.index("wrist: 22}}")].count("\n")
        page.wait(
            f"document.querySelector('.banner-warn')?.textContent.startsWith('wave.yaml:{line}')"
        )
        # The last good plan stays, and says that it is one.
        assert page.run("document.querySelector('.clock-of').textContent") == "of 0:19.5"
        page.wait("document.querySelector('.chip-warn')?.textContent.includes('last good plan')")
        show.write_text(good.replace("loop: 3", "loop: 2"), encoding="utf-8")
        page.wait("document.querySelector('.clock-of').textContent === 'of 0:13.0'")
        assert page.run("document.querySelector('.banner-warn') === null")


@pytest.mark.slow
def test_only_one_client_operates_and_taking_over_is_a_question(wave, opened):
    with opened(wave) as first, opened(wave) as second:
        first.click(".operator button")
        first.wait("document.querySelector('.operator').textContent.includes('you operate')")
        second.wait("document.querySelector('.operator').textContent.includes(' operates')")
        second.key(" ")
        second.wait("document.querySelector('dialog h2')?.textContent.startsWith('Take over from')")
        second.click("dialog .dialog-buttons button")
        second.wait("!document.querySelector('dialog')")
        assert first.run(f"!({PLAYING})")
        second.click(".operator button")
        second.click("dialog .primary")
        second.wait("document.querySelector('.operator').textContent.includes('you operate')")
        first.wait("document.querySelector('.operator').textContent.includes(' operates')")
        first.wait("document.querySelector('.banner-warn')?.textContent.includes('has taken over')")
        second.click(".operator button.plain:last-child")


@pytest.mark.slow
def test_a_device_without_a_key_learns_that_it_cannot_stop_and_pairs_by_the_code(studio, opened):
    trouble = "document.getElementById('trouble')"
    with (
        studio(EXAMPLES / "wave.yaml", "--listen", "127.0.0.2") as own,
        opened(own) as desk,
        opened(own, size=(820, 1180), token=False) as tablet,
    ):
        tablet.wait("document.querySelector('.entry input')")
        tablet.touch(*tablet.place("#stop"))
        tablet.touch()
        tablet.wait(f"{trouble}.textContent.includes('is not paired')")
        desk.click(".operator button:last-child")
        first = desk.wait("document.querySelector('.code')?.textContent")
        desk.click("dialog .choice button")  # To look and stop.
        desk.wait(f"document.querySelector('.code').textContent !== '{first}'")
        code = desk.run("document.querySelector('.code').textContent")
        for typed, then in (
            ("12 34 5", "!document.querySelector('.head')"),
            (first, "document.querySelector('.bad-text').textContent.includes('wrong code')"),
            (code, "document.querySelector('.joints')"),
        ):
            tablet.run("document.querySelector('.entry input').select()")
            tablet.call("Input.insertText", text=typed)
            tablet.key("Enter")
            tablet.wait(then)
        assert "you may look, and stop" in tablet.run("document.body.innerText")
        assert tablet.run(f"{trouble}.hidden"), "what was said before it was paired"
        tablet.click("#stop")
        desk.wait("document.body.dataset.latched === 'true'")


@pytest.mark.slow
def test_the_curves_of_the_page_are_those_of_the_plan(wave, opened):
    """The same instants in Python and JavaScript: angle, speed and acceleration."""
    sequence = lss.load_sequence(EXAMPLES / "wave.yaml")
    trajectory = lss.plan(sequence, lss.load_robot(sequence.robot_path))
    times_s = np.linspace(0.0137, 19.4, 200)
    with opened(wave) as page:
        found = page.run(
            f"""Promise.all([{MODULE.format("curves")}, {MODULE.format("messages")},
              fetch(performance.getEntriesByType('resource').map((one) => one.name)
                .find((name) => name.includes('/view/'))).then((answer) => answer.json())])
            .then(([curves, messages, json]) => {{
              const view = messages.viewFrom(json);
              const times = {json.dumps(times_s.tolist())};
              return [0, 1, 2].map((order) => view.joints.map(({{ name }}) =>
                times.map((at) => curves.valueAt(view.curves[name].plan, at, order))));
            }})"""
        )
    for order, allowed in enumerate((0.05, 2.0, 30.0)):
        expected = trajectory.sample(times_s, order).T
        assert np.abs(np.array(found[order]) - expected).max() < allowed, order


@pytest.mark.slow
def test_strangers_are_refused_by_the_running_server(wave):
    def asked(path, **headers):
        request = urllib.request.Request(f"{wave.origin}{path}", headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=60.0) as answer:
                return answer.status
        except urllib.error.HTTPError as error:
            with error:
                return error.code

    key = wave.key
    for _ in range(600):  # The planner may still read the files.
        if asked("/robot.json", **key) != 404:
            break
        time.sleep(0.1)
    assert asked("/robot.json", **key) == 200
    assert asked("/robot.json") == 401
    assert asked("/robot.json", Host="127.0.0.1.evil", **key) == 421
    assert asked("/robot.json", Origin="http://127.0.0.1.evil", **key) == 403
    assert asked("/files/..%2f..%2fpyproject.toml", **key) == 404
    assert asked("/static/..%2f..%2f__init__.py") == 404
    with pytest.raises(InvalidStatus), connect(wave.socket_url):
        pass
    with pytest.raises((ConnectionClosed, ConnectionError)):
        flood(wave.socket_url, key)


def flood(place, key):
    """Send one frame that is far too large, and read until the link is closed."""
    with connect(place, additional_headers=key, max_size=None) as socket:
        socket.send("x" * 10_000_000)
        while True:
            socket.recv(timeout=10.0)


@pytest.mark.slow
def test_a_long_show_is_drawn_by_what_is_in_sight(wave, opened):
    """Ten minutes, 18 joints, 1,200 keys: what a frame draws depends on the screen."""
    with opened(wave) as page:
        whole, near = page.run(LONG_SHOW)
    assert 500 <= whole["keys"] <= 1100, "one a pixel in the lane, none where they hide the curve"
    assert 10 <= near["keys"] <= 24 * 11, "eleven seconds of it"
    assert near["calls"] < 10 * 3000


LONG_SHOW = """
Promise.all(['draw', 'layout', 'window'].map((name) => import(`/static/timeline/${name}.js`)))
.then(([draw, layout, window]) => {
  const names = Array.from({length: 18}, (_, n) => `joint_${n}`);
  const times_s = Float64Array.from({length: 1200}, (_, n) => 0.5 * n);
  const curve = {
    times_s, deg: Float32Array.from(times_s, (at, n) => 20 * (n % 2)),
    deg_s: new Float32Array(1200),
  };
  const keys = Array.from(times_s, (at_s) => ({at_s, hold_s: 0, is_anchor: false, deg: {}}));
  const view = {
    view_s: 599.5, repeat: null, tolerance_deg: 0.2, marks: [], parts: [], events: [], beats: [],
    waveforms: [], stretched: [], given_up: [], asked: [], error: {}, line: {},
    lanes: [{name: 'long', kind: 'track', joints: names, keys, times_s}],
    joints: names.map((name) => ({
      name, range_deg: [-90, 90], speed_max_deg_s: 100, accel_max_deg_s2: 900})),
    curves: Object.fromEntries(names.map((name) => [
      name, {plan: curve, predicted: curve, authored: null}])),
    keys: Object.fromEntries(names.map((name) => [
      name, keys.map((key, n) => ({...key, deg: 20 * (n % 2), lane: 0, key: n}))])),
  };
  let calls = 0;
  const ctx = new Proxy({measureText: () => ({width: 0})}, {
    get: (own, name) => name in own ? own[name] : () => { calls += 1; },
    set: (own, name, value) => { own[name] = value; return true; },
  });
  const rows = layout.layoutOf(view);
  const all = window.fitted(view.view_s, 1100);
  return [all, {...all, start_s: 300, px_per_s: 100}].map((seen) => {
    calls = 0;
    const count = draw.drawTimeline(ctx, {
      view, rows: layout.rowsInSight(rows, 0, 600), seen, fixed_px: rows.fixed_px,
      height_px: 600, order: 0, selection: null, row: 0, palette: {},
      used_deg: Object.fromEntries(names.map((name) => [name, [0, 20]])),
    });
    return {keys: count, calls};
  });
})"""
