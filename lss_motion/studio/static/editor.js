// @ts-check
/**
 * The changes of the show: one after the other, each made for the text that the server has. What is
 * shown follows when it is planned; until then it is a draft.
 */

import { addOf, copied, deleteOf, editOf, mirrorOf, moveOf, nextEase, pasteOf, scaleOf, setOf } from "./edits.js";
import { draggedTime, plannedAt, withinRange, withinShow } from "./timeline/draft.js";
import { allKeys, placesOf, refound } from "./timeline/keys.js";
import { handleOf, handlesOf, nextSlope } from "./timeline/slopes.js";
import { layoutOf, walkedRows } from "./timeline/layout.js";

/** @typedef {import("./store.js").Store} Store */
/** @typedef {import("./link.js").ServerLink} ServerLink */
/** @typedef {import("./state.js").KeyRef} KeyRef */
/** @typedef {import("./edits.js").Edit} Edit */

/** @typedef {import("./timeline/keys.js").Place} Place */
/** @typedef {{ by_s: number, by_deg: number, gesture: string }} Nudge */
/** @typedef {{ make: () => Edit | null, nudge?: Nudge }} Waiting an edit that is not sent yet */

/** Steps of one key press on the keyboard that follow each other so soon are one step of undo. */
const SAME_GESTURE_MS = 1500;

export class Editor {
  /** @type {import("./edits.js").Copied[]} */
  #clipboard = [];
  /** @type {Waiting[]} */
  #waiting = [];
  #isSending = false;
  /** @type {Promise<void>} */
  #asked = Promise.resolve();
  #nudge = { ms: -Infinity, number: 0 };

  /** @param {Store} store @param {ServerLink} link */
  constructor(store, link) {
    this.store = store;
    this.link = link;
    store.select((state) => `${state.document?.revision} ${state.document?.is_current} ${state.view?.revision}`)
      .subscribe(() => this.#settle());
  }

  get #view() {
    return this.store.state.value.view;
  }

  /** @returns {KeyRef[]} */
  get keys() {
    const { selection } = this.store.state.value;
    return selection?.kind === "keys" ? selection.keys : [];
  }

  /** @param {KeyRef[]} keys */
  choose(keys) {
    this.store.dispatch({ type: "set", fields: { selection: keys.length === 0 ? null : { kind: "keys", keys } } });
  }

  /** Choose all keys of the row, then of all rows. */
  chooseAll() {
    const { view, row, selection } = this.store.state.value;
    if (view === null) return;
    const own = allKeys(view, walkedRows(layoutOf(view))[row] ?? null);
    const isRow = selection?.kind === "keys" && selection.keys.length >= own.length;
    this.choose(isRow ? allKeys(view, null) : own);
  }

  // ------------------------------------------------------------------------ edits

  /** Move the chosen keys, and choose them where they are then. @param {{ by_s: number, by_deg: number }} by */
  move(by) {
    const { ripple } = this.store.state.value;
    this.#edit((view, keys) => moveOf(view, keys, { ...by, ripple }), (at_s) => at_s + by.by_s);
  }

  /** Take a draft; what it moves or copies is chosen then. @param {import("./timeline/draft.js").Draft} draft */
  takeDraft(draft) {
    const { ripple } = this.store.state.value;
    this.#edit((view, keys) => editOf(view, keys, draft, ripple), (at_s) => draggedTime(draft, at_s));
  }

  /** Exchange left and right of the chosen keys. */
  mirror() {
    this.#edit(mirrorOf, (at_s) => at_s);
  }

  /** One step of an arrow key. @param {number} by_s @param {number} by_deg */
  nudge(by_s, by_deg) {
    const view = this.#view;
    if (view === null) return;
    const now_ms = performance.now();
    if (now_ms - this.#nudge.ms > SAME_GESTURE_MS) this.#nudge.number += 1;
    this.#nudge.ms = now_ms;
    const step = { by_s: withinShow(view, this.keys, by_s), by_deg: withinRange(view, this.keys, by_deg) };
    const gesture = `nudge-${this.#nudge.number}`;
    const last = this.#waiting.at(-1)?.nudge;
    if (last?.gesture === gesture) {
      last.by_s += step.by_s;
      last.by_deg += step.by_deg;
      const { wanted } = this.store.state.value;
      this.store.dispatch({ type: "set", fields: { wanted: wanted?.map((own) => ({ ...own, at_s: own.at_s + step.by_s })) ?? null } });
      return;
    }
    const nudge = { ...step, gesture };
    const { ripple } = this.store.state.value;
    this.#edit((now, keys) => moveOf(now, keys, { ...nudge, ripple }), (at_s) => at_s + step.by_s, nudge);
  }

  /** Stretch the chosen keys about the cursor. @param {number} ratio */
  scale(ratio) {
    const { cursor_s } = this.store.state.value;
    const scale = { ratio, about_s: cursor_s, about_deg: {} };
    this.#edit((view, keys) => scaleOf(view, keys, scale), (at_s) => draggedTime({ by_s: 0, by_deg: 0, scale }, at_s));
  }

  /** Carry out an edit of the text that is shown. @param {Edit} edit */
  take(edit) {
    const { view } = this.store.state.value;
    this.#edit((now) => (now === view ? edit : null));
  }

  delete() {
    this.#edit((view, keys) => deleteOf(view, keys, this.store.state.value.ripple));
    this.choose([]);
  }

  /** @param {{ deg?: Record<string, number | null>, slope_deg_s?: Record<string, number | null>, values?: Record<string, unknown> }} change */
  set(change) {
    this.#edit((view, keys) => setOf(view, keys, change));
  }

  /** Give the chosen keys the next ease. */
  ease() {
    const [first] = this.keys;
    const own = first === undefined ? undefined : this.#view?.lanes[first.lane]?.keys[first.key];
    if (own !== undefined) this.set({ values: { ease: nextEase(own.ease) } });
  }

  /** Give the chosen key of a joint the next slope: flat, free, and none of its own. */
  slope() {
    const view = this.#view;
    const [first] = view === null ? [] : handlesOf(view, this.keys);
    if (first !== undefined) this.setSlope(first, nextSlope);
    else {
      const text = "Choose a key in the row of a joint that passes it: not its first or last, not held, smooth or spline to and from it.";
      this.store.dispatch({ type: "refused", is_hint: true, text });
    }
  }

  /** Set the slope with which a joint passes a chosen key; null: the curve finds it.
   * @param {import("./timeline/slopes.js").Handle} handle
   * @param {(view: import("./state.js").View, handle: import("./timeline/slopes.js").Handle) => number | null} slopeOf */
  setSlope({ joint, key: index }, slopeOf) {
    this.#edit((view, keys) => {
      const ref = keys.find((own) => own.key === index);
      const handle = ref === undefined ? null : handleOf(view, { ...ref, joint });
      return ref === undefined || handle === null ? null : setOf(view, [ref], { slope_deg_s: { [joint]: slopeOf(view, handle) } });
    });
  }

  /** Make the chosen keys anchors, or no more. */
  anchor() {
    const [first] = this.keys;
    const own = first === undefined ? undefined : this.#view?.lanes[first.lane]?.keys[first.key];
    if (own !== undefined) this.set({ values: { anchor: own.is_anchor ? null : true } });
  }

  /** Add a key of a joint, or of all joints of a lane, as they are planned there.
   * @param {import("./timeline/layout.js").Row} row @param {number} at_s @param {number} [deg] */
  add(row, at_s, deg) {
    const view = this.#view;
    if (view === null) return;
    const isJoint = row.kind === "joint";
    const ownKeys = isJoint ? view.keys[row.name] ?? [] : [];
    const lane = isJoint ? (ownKeys.find((key) => !key.is_added) ?? ownKeys[0])?.lane ?? 0 : row.index;
    const joints = isJoint ? [row.name] : view.lanes[lane]?.joints ?? [];
    const own = Object.fromEntries(joints.map((joint) => [joint, deg ?? plannedAt(view, joint, at_s)]));
    const name = view.lanes[lane]?.name ?? "";
    const instant_s = Number(at_s.toFixed(3));
    this.#send(() => {
      const now = this.#view;
      return now === null ? null : addOf(now, now.lanes.findIndex((one) => one.name === name), [{ at_s: instant_s, deg: own }]);
    }, [{ lane: name, at_s: instant_s, joint: isJoint ? row.name : null }]);
  }

  /** Make a key of a joint at the cursor. @param {string} joint @param {number} deg */
  pose(joint, deg) {
    const { view, cursor_s } = this.store.state.value;
    const index = view?.joints.findIndex((own) => own.name === joint) ?? -1;
    if (index < 0) return;
    this.add({ kind: "joint", name: joint, index, y_px: 0, height_px: 0 }, cursor_s, deg);
    this.store.dispatch({ type: "set", fields: { wanted: [] } });
  }

  /** Add a key to the row that has the focus, at the cursor. */
  addAtCursor() {
    const { view, row, cursor_s } = this.store.state.value;
    const own = view === null ? undefined : walkedRows(layoutOf(view))[row];
    if (own !== undefined) this.add(own, cursor_s);
  }

  copy() {
    if (this.#view !== null && this.keys.length > 0) this.#clipboard = copied(this.#view, this.keys);
  }

  cut() {
    this.copy();
    this.delete();
  }

  /** Paste from the cursor on. */
  paste() {
    const { cursor_s } = this.store.state.value;
    const own = this.#clipboard;
    this.#send(() => (this.#view === null ? null : pasteOf(this.#view, own, cursor_s)),
      own.map(({ lane, after_s }) => ({ lane, at_s: cursor_s + after_s, joint: null })));
  }

  get hasCopied() {
    return this.#clipboard.length > 0;
  }

  /** `undo`, `redo` and `save` need no plan; each is asked when the one before is done.
   * @param {"undo" | "redo" | "save"} op */
  ask(op) {
    this.#waiting = [];
    this.#asked = this.#asked.then(() => this.link.ask(op, { revision: this.store.state.value.document?.revision ?? 0 }));
  }

  /**
   * Return what a draft would do, or null where that is not known now.
   * @param {import("./timeline/draft.js").Draft} draft @returns {Promise<import("./state.js").Tried | null>}
   */
  async triedDraft(draft) {
    const { view, ripple } = this.store.state.value;
    const edit = view === null ? null : editOf(view, this.keys, draft, ripple);
    return edit === null ? null : this.tried(edit);
  }

  /** Return what the slope of a handle would do. @param {import("./timeline/slopes.js").Handle} handle
   * @returns {Promise<import("./state.js").Tried | null>} */
  async triedSlope({ joint, slope, ...ref }) {
    const { view } = this.store.state.value;
    const edit = view === null ? null : setOf(view, [{ ...ref, joint }], { slope_deg_s: { [joint]: slope } });
    return edit === null ? null : this.tried(edit);
  }

  /** Return what an edit of the text that is shown would do, or null where that is not known now.
   * @param {Edit} edit @returns {Promise<import("./state.js").Tried | null>} */
  async tried(edit) {
    const revision = this.store.state.value.document?.revision;
    if (!this.#isShown) return null;
    try {
      await this.link.send("edit.try", { revision, edit: { op: edit.op, revision, ...edit.fields } });
      return this.store.tried.value;
    } catch {
      return null; // Something newer came first.
    }
  }

  // ---------------------------------------------------------------- one after the other

  /** @param {(view: import("./state.js").View, keys: KeyRef[]) => Edit | null} make
   * @param {(at_s: number) => number} [to] when the keys are then @param {Nudge} [nudge] */
  #edit(make, to = (at_s) => at_s, nudge) {
    const { wanted, drafts } = this.store.state.value;
    const view = this.#view;
    if (view === null) return;
    const places = drafts > 0 && wanted !== null ? wanted : placesOf(view, this.keys);
    if (places.length === 0) return;
    this.#send(() => {
      const now = this.#view;
      return now === null ? null : make(now, refound(now, places));
    }, places.map((own) => ({ ...own, at_s: to(own.at_s) })), nudge);
  }

  /** @param {() => Edit | null} make @param {Place[]} wanted what is chosen then @param {Nudge} [nudge] */
  #send(make, wanted, nudge) {
    const { document: own } = this.store.state.value;
    if (own !== null && own.errors.length > 0 && !own.is_planning) {
      this.store.dispatch({ type: "refused", text: "The file has an error, so its keys are not known: undo, or mend its text." });
      return;
    }
    this.#waiting.push({ make, ...(nudge === undefined ? {} : { nudge }) });
    this.store.dispatch({ type: "drafted", wanted });
    void this.#flush();
  }

  /** Whether what is shown is what the server has. */
  get #isShown() {
    const { document: own, view } = this.store.state.value;
    return own !== null && own.is_current && view !== null && view.revision === own.revision;
  }

  /** Go on with what waits; where the text has an error now, that has to be mended first. */
  #settle() {
    const { document: own, drafts } = this.store.state.value;
    const isWrong = own !== null && own.errors.length > 0 && !own.is_planning;
    if (isWrong) this.#waiting = [];
    void this.#flush();
    const count = this.#waiting.length + (this.#isSending ? 1 : 0);
    if (count === 0 && drafts > 0 && (this.#isShown || isWrong)) this.#clear();
  }

  #clear() {
    this.store.dispatch({ type: "set", fields: { drafts: 0, wanted: null } });
  }

  /** Send what waits, when what is shown is what the server has. */
  async #flush() {
    const { document: own } = this.store.state.value;
    if (this.#isSending || own === null || !this.#isShown) return;
    const next = this.#waiting.shift();
    if (next === undefined) return;
    const edit = next.make();
    if (edit === null) {
      this.#settle();
      return;
    }
    this.#isSending = true;
    try {
      await this.link.send(edit.op, { revision: own.revision, ...edit.fields });
      this.#isSending = false;
      this.#settle();
    } catch (error) {
      this.#isSending = false;
      this.#waiting = [];
      this.#clear();
      this.store.dispatch({ type: "refused", text: error instanceof Error ? error.message : String(error) });
    }
  }
}
