// @ts-check
/** What buttons and keys do: one table for pointer, keyboard and the accessible grid. */

import { ContentsEditor } from "./contents/editor.js";
import { lowerBound, showTimeOf } from "./curves.js";
import { Editor } from "./editor.js";
import { isUnderWay } from "./states.js";
import { layoutOf, walkedRows } from "./timeline/layout.js";

/** @typedef {import("./store.js").Store} Store */
/** @typedef {import("./link.js").ServerLink} ServerLink */
/** @typedef {import("./timeline/board.js").TimelineBoard} TimelineBoard */

const STEP_S = 0.01;
const STEP_DEG = 0.5;
/** What is done to keys, for which a person has to be allowed to edit, and what needs chosen ones. */
const EDITS = new Set(["add", "delete", "cut", "paste", "ease", "anchor", "undo", "redo", "save", "hold", "label", "type_value", "grab", "scale",
  "duplicate", "mirror", "slope"]);
const OF_CHOSEN = new Set(["delete", "copy", "cut", "ease", "anchor", "hold", "label", "type_value", "grab", "scale", "duplicate", "mirror", "slope"]);
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
    this.editor = new Editor(store, link);
    store.select(({ document: own, player, live, lease }) => (
      live && lease.is_mine && ["playing", "paused"].includes(player.state) && own?.is_current && own.plan !== player.plan ? own.plan : null))
      .subscribe((plan) => { if (plan !== null) this.splice(); });
    this.contents = new ContentsEditor(store, link);
  }

  /** Do what a key or a button is called. @param {string} name */
  run(name) {
    const { store } = this;
    const state = store.state.value;
    if (name.startsWith("page_")) return this.set({ page: name.slice(5) });
    if (!this.#mayDo(name)) return undefined;
    if (name.startsWith("order_")) return this.set({ order: Number(name.slice(6)) });
    const simple = /** @type {Record<string, () => void>} */ ({
      toggle: () => this.toggle(),
      go: () => this.go(),
      step_back: () => this.step(-STEP_S, 0),
      step: () => this.step(STEP_S, 0),
      stride_back: () => this.step(-10 * STEP_S, 0),
      stride: () => this.step(10 * STEP_S, 0),
      up: () => this.step(0, STEP_DEG),
      down: () => this.step(0, -STEP_DEG),
      far_up: () => this.step(0, 10 * STEP_DEG),
      far_down: () => this.step(0, -10 * STEP_DEG),
      add: () => this.editor.addAtCursor(),
      delete: () => this.editor.delete(),
      copy: () => this.editor.copy(),
      cut: () => this.editor.cut(),
      paste: () => this.editor.paste(),
      ease: () => this.editor.ease(),
      anchor: () => this.editor.anchor(),
      grab: () => this.board?.grab("move"),
      scale: () => this.board?.grab("scale"),
      duplicate: () => this.board?.grab("copy"),
      mirror: () => this.editor.mirror(),
      slope: () => this.editor.slope(),
      choose_box: () => this.board?.arm(),
      undo: () => this.editor.ask("undo"),
      redo: () => this.editor.ask("redo"),
      save: () => this.editor.ask("save"),
      choose_all: () => this.editor.chooseAll(),
      choose_none: () => this.editor.choose([]),
      type_value: () => void (this.board?.take() || this.#focusField(this.editor.keys[0]?.joint ?? "at")),
      hold: () => this.#focusField("hold"),
      label: () => this.#focusField("label"),
      axis_time: () => void this.board?.lockAxis("time"),
      axis_angle: () => void this.board?.lockAxis("angle"),
      ripple: () => this.set({ ripple: !state.ripple }),
      live: () => this.set({ live: !state.live }),
      open_text: () => this.#openText(),
      previous_key: () => this.toKey(-1),
      next_key: () => this.toKey(1),
      to_start: () => this.moveTo(0),
      to_end: () => this.moveTo(state.view?.view_s ?? 0),
      zoom_in: () => this.board?.zoom(ZOOM),
      zoom_out: () => this.board?.zoom(1 / ZOOM),
      fit: () => this.board?.fit(),
      fit_chosen: () => this.#fitChosen(),
      follow: () => this.set({ follow: !state.follow }),
      theme: () => this.set({ theme: state.theme === "dark" ? "light" : "dark" }),
      theatre: () => this.set({ theatre: !state.theatre, page: "show" }),
      help: () => this.set({ dialog: { kind: "help" } }),
    });
    simple[name]?.();
  }

  /** Whether it can be done; says why not. @param {string} name */
  #mayDo(name) {
    const { welcome } = this.store.state.value;
    if (EDITS.has(name) && welcome?.role !== "edit") {
      this.store.dispatch({ type: "refused", text: "You may look here. Changing the show needs the role edit: pair again with it." });
      return false;
    }
    if (OF_CHOSEN.has(name) && this.editor.keys.length === 0) {
      this.hint("No key is chosen: click one, or draw a box round several. Double-click makes one.");
      return false;
    }
    return true;
  }

  /** @param {Record<string, unknown>} fields */
  set(fields) {
    this.store.dispatch({ type: "set", fields });
  }

  /** Say something that is neither refused nor wrong. @param {string} text */
  hint(text) {
    this.store.dispatch({ type: "refused", text, is_hint: true });
  }

  /** Close what is open: a field, a question or help, a menu, a message, a drag, a selection; return whether it was. */
  closeOpen() {
    const { dialog, menu, refusal, selection, page } = this.store.state.value;
    const field = document.activeElement;
    if (field instanceof HTMLInputElement && field.matches(".about [data-field]:not([type=checkbox])")) {
      field.value = field.dataset["was"] ?? "";
      field.blur();
    } else if (dialog !== null) this.set({ dialog: null });
    else if (menu !== null) this.set({ menu: null });
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
    const state = this.store.state.value;
    if (!this.isRunning) this.play(state.page !== "show");
    else if (isUnderWay(state)) this.withLease(() => this.link.ask(state.rate.is_paused ? "resume" : "pause"));
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

  /** Let the show that plays go on as the edited one; why it cannot is said. */
  splice() {
    const { document: own } = this.store.state.value;
    if (own?.plan == null) return;
    const { plan } = own;
    this.withLease(() => void this.link.send("splice", { plan }).then(
      () => this.hint("The show goes on with the edit."),
      (error) => this.store.dispatch({ type: "refused", text: `The edit is kept for the next START: ${error.message}` }),
    ));
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

  /** One step of an arrow key: of the chosen keys, else of the cursor or the row.
   * @param {number} by_s @param {number} by_deg */
  step(by_s, by_deg) {
    const { cursor_s, row } = this.store.state.value;
    const { keys } = this.editor;
    if (this.board?.step(by_s, by_deg)) return;
    if (keys.length > 0 && this.#mayDo("add")) this.editor.nudge(by_s, by_deg);
    else if (keys.length === 0 && by_deg === 0) this.moveTo(cursor_s + by_s);
    else if (keys.length === 0) this.toRow(row - Math.sign(by_deg));
  }

  /** Make a key or an event where the menu was opened. @param {string} action */
  addAtMenu(action) {
    const { menu, view } = this.store.state.value;
    this.set({ menu: null });
    if (menu === null || !this.#mayDo("add")) return;
    if (action === "add_at_menu" && menu.row !== null) this.editor.add(menu.row, menu.at_s, menu.deg);
    if (action === "say_at_menu") this.contents.addEvent(menu.at_s, { say: "text" });
    const joint = menu.row?.kind === "joint" ? menu.row.name : view?.joints[0]?.name;
    if (action === "led_at_menu" && joint !== undefined) this.contents.addEvent(menu.at_s, { led: { [joint]: "red" } });
  }

  /** @param {string} name */
  #focusField(name) {
    const fields = /** @type {HTMLInputElement[]} */ ([...document.querySelectorAll(".about [data-field]")]);
    const own = fields.find((one) => one.dataset["field"] === name) ?? fields[0];
    own?.focus();
    own?.select();
  }

  #openText() {
    const { view } = this.store.state.value;
    const [first] = this.editor.keys;
    const lane = first === undefined ? undefined : view?.lanes[first.lane];
    if (first !== undefined && lane !== undefined) {
      this.set({ dialog: { kind: "text", file: lane.file, line: lane.keys[first.key]?.line ?? null } });
    }
  }

  #fitChosen() {
    const { view } = this.store.state.value;
    const times_s = this.editor.keys.flatMap(({ lane, key }) => view?.lanes[lane]?.keys[key]?.at_s ?? []);
    if (times_s.length < 2) this.board?.fit();
    else this.board?.show(Math.min(...times_s), Math.max(...times_s));
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
    this.editor.choose([{ lane: found.lane, key: found.key, joint: found.joint }]);
    this.moveTo(found.at_s);
  }
}
