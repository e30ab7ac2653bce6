// @ts-check
/** What buttons and keys do: one table for pointer, keyboard and the accessible grid. */

import { lowerBound, showTimeOf } from "./curves.js";
import { layoutOf, walkedRows } from "./timeline/layout.js";

/** @typedef {import("./store.js").Store} Store */
/** @typedef {import("./link.js").ServerLink} ServerLink */
/** @typedef {import("./timeline/board.js").TimelineBoard} TimelineBoard */

const STEP_S = 0.01;
const GO_DEBOUNCE_MS = 400;
const ZOOM = 1.5;

/** What belongs together on a page. */
export class Actions {
  #go_ms = -Infinity;
  /** The board of the timeline, while that page is open. @type {TimelineBoard | null} */
  board = null;

  /** @param {Store} store @param {ServerLink} link */
  constructor(store, link) {
    this.store = store;
    this.link = link;
  }

  /** Do what a key or a button is called. @param {string} name */
  run(name) {
    const { store } = this;
    const state = store.state.value;
    if (name.startsWith("page_")) return this.set({ page: name.slice(5) });
    if (name.startsWith("order_")) return this.set({ order: Number(name.slice(6)) });
    const simple = /** @type {Record<string, () => void>} */ ({
      toggle: () => this.toggle(),
      go: () => this.go(),
      step_back: () => this.move(-STEP_S),
      step: () => this.move(STEP_S),
      stride_back: () => this.move(-10 * STEP_S),
      stride: () => this.move(10 * STEP_S),
      previous_key: () => this.toKey(-1),
      next_key: () => this.toKey(1),
      row_up: () => this.toRow(state.row - 1),
      row_down: () => this.toRow(state.row + 1),
      to_start: () => this.moveTo(0),
      to_end: () => this.moveTo(state.view?.view_s ?? 0),
      zoom_in: () => this.board?.zoom(ZOOM),
      zoom_out: () => this.board?.zoom(1 / ZOOM),
      fit: () => this.board?.fit(),
      follow: () => this.set({ follow: !state.follow }),
      theme: () => this.set({ theme: state.theme === "dark" ? "light" : "dark" }),
      theatre: () => this.set({ theatre: !state.theatre, page: "show" }),
      help: () => this.set({ dialog: { kind: "help" } }),
      shows_only: () => this.hint("This page shows the plan and does not change it. Edit the file: a key names its line. A saved file is planned again at once."),
    });
    simple[name]?.();
  }

  /** @param {Record<string, unknown>} fields */
  set(fields) {
    this.store.dispatch({ type: "set", fields });
  }

  /** Say something that is neither refused nor wrong. @param {string} text */
  hint(text) {
    this.store.dispatch({ type: "refused", text, is_hint: true });
  }

  /** Close what is open: a question or help, a message, a drag, a selection; return whether it was. */
  closeOpen() {
    const { dialog, refusal, selection, page } = this.store.state.value;
    if (dialog !== null) this.set({ dialog: null });
    else if (refusal !== null) this.set({ refusal: null });
    else if (page === "timeline" && this.board?.dropDrags()) return true;
    else if (page === "timeline" && selection !== null) this.set({ selection: null });
    else return false;
    return true;
  }

  // ------------------------------------------------------------------------ the show

  /** Whether a show runs, so that another cannot be started. */
  get isRunning() {
    return ["starting", "ready", "playing", "paused", "stopping"].includes(this.store.state.value.player.state);
  }

  /** Play, pause or resume; never GO. */
  toggle() {
    const { player, rate } = this.store.state.value;
    if (!this.isRunning) this.play(this.store.state.value.page !== "show");
    else if (player.state === "playing" || player.state === "paused") {
      this.withLease(() => this.link.ask(rate.is_paused ? "resume" : "pause"));
    }
  }

  /** Start the show, from the cursor or from its start. @param {boolean} fromCursor */
  play(fromCursor) {
    const { document: own, view, cursor_s, player } = this.store.state.value;
    if (player.latch !== null) {
      this.askRearm();
      return;
    }
    /** @type {Record<string, unknown>} */
    const fields = own?.plan ? { plan: own.plan } : {};
    if (fromCursor && view !== null && cursor_s > 0 && cursor_s < view.view_s) fields["from_s"] = showTimeOf(view, cursor_s);
    this.withLease(() => this.link.ask("play", fields));
  }

  /** GO, where the show waits for it. A second one at once is a slip of the finger. */
  go() {
    const now_ms = performance.now();
    if (now_ms - this.#go_ms < GO_DEBOUNCE_MS) return;
    this.#go_ms = now_ms;
    const { player } = this.store.state.value;
    const waits = player.state === "ready" || this.store.state.value.stage !== null;
    if (waits) this.withLease(() => this.link.ask("go"));
    else if (!this.isRunning) this.play(false);
  }

  /** Fire a cue of a stage. A second one at once is a slip of the finger. @param {string} name */
  cue(name) {
    const now_ms = performance.now();
    if (now_ms - this.#go_ms < GO_DEBOUNCE_MS) return;
    this.#go_ms = now_ms;
    this.withLease(() => this.link.ask("cue", { label: name }));
  }

  /** Ask something else of a stage. @param {string} op @param {Record<string, unknown>} fields */
  stage(op, fields = {}) {
    this.withLease(() => this.link.ask(op, fields));
  }

  /** @param {number} ratio */
  rate(ratio) {
    this.withLease(() => this.link.ask("rate", { ratio }));
  }

  /** Send the running show to an instant of the view. @param {number} view_s */
  seek(view_s) {
    const { view } = this.store.state.value;
    if (view !== null) this.withLease(() => this.link.ask("seek", { to: Math.max(showTimeOf(view, view_s), 0) }));
  }

  /** Make a code for one more device. @param {string} role */
  pair(role) {
    this.withLease(() => this.link.ask("pair", { role }));
  }

  /** Ask before motion is allowed again. */
  askRearm() {
    this.set({
      dialog: {
        kind: "confirm",
        title: "Arm again?",
        text: "The robot was stopped. Arm it only when nobody is near it.",
        yes: "Arm",
        run: () => this.withLease(() => this.link.ask("rearm")),
      },
    });
  }

  /** Do what needs the lease; ask first where another operates. @param {() => void} run */
  withLease(run) {
    const { lease, welcome } = this.store.state.value;
    if (welcome?.role === "view") {
      this.store.dispatch({ type: "refused", text: "You may look, and stop. Operating needs another role: pair again with one." });
      return;
    }
    if (lease.holder === null || lease.is_mine) {
      run();
      return;
    }
    this.set({
      dialog: {
        kind: "confirm",
        title: `Take over from ${lease.holder_name ?? "another"}?`,
        text: "They operate now. What they began goes on; they are told.",
        yes: "Take over",
        run: () => {
          this.link.send("lease", { want: "take" }).then(run, (error) => {
            this.store.dispatch({ type: "refused", text: error.message });
          });
        },
      },
    });
  }

  // -------------------------------------------------------------------- the timeline

  /** @param {number} by_s */
  move(by_s) {
    this.moveTo(this.store.state.value.cursor_s + by_s);
  }

  /** @param {number} at_s */
  moveTo(at_s) {
    this.store.dispatch({ type: "cursor", at_s: Math.round(at_s * 1e4) / 1e4 });
    this.board?.reveal(this.store.state.value.cursor_s);
  }

  /** Go to another row. @param {number} row */
  toRow(row) {
    const { view } = this.store.state.value;
    if (view === null) return;
    const rows = walkedRows(layoutOf(view));
    this.set({ row: Math.min(Math.max(row, 0), rows.length - 1) });
    this.board?.revealRow(this.store.state.value.row);
  }

  /** Go to the next key of the row, or the one before. @param {1 | -1} direction */
  toKey(direction) {
    const { view, row, cursor_s } = this.store.state.value;
    const own = view === null ? undefined : walkedRows(layoutOf(view))[row];
    if (view === null || own === undefined) return;
    const keys = own.kind === "joint" ? (view.keys[own.name] ?? []).map((key) => ({ ...key, joint: own.name }))
      : view.lanes[own.index]?.keys.map((key, index) => ({ at_s: key.at_s, lane: own.index, key: index, joint: null })) ?? [];
    const times_s = keys.map((key) => key.at_s);
    const next = direction > 0 ? lowerBound(times_s, cursor_s + 1e-6) : lowerBound(times_s, cursor_s - 1e-6) - 1;
    const found = keys[next];
    if (found === undefined) return;
    this.set({ selection: { kind: "key", lane: found.lane, key: found.key, joint: found.joint } });
    this.moveTo(found.at_s);
  }
}
