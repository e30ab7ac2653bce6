// @ts-check
/**
 * The timeline on its canvases: names, plan, and what moves over it. Owns window, scroll and pointer;
 * everything else comes from the store. Layers are drawn in the next frame after something changed.
 */

import { angleAt, usedOf, withinView } from "../curves.js";
import { onFrame, requestFrame } from "../frames.js";
import { draftName, draftOf, draftText, isNothing, triedTexts } from "./draft.js";
import { drawLive, drawNames, drawTimeline, scaleOf } from "./draw.js";
import { drawBeats } from "./draw_beats.js";
import { drawBox, drawDraft, drawInstant, drawWindow, drawWords } from "./draw_draft.js";
import { drawBent, drawHandles, endAt, handleOf, handlesOf, slopeText, turned } from "./slopes.js";
import { afterInput, HELD_MS, REST } from "./gestures.js";
import { hitAt, REACH_PX, TOUCH_REACH_PX } from "./hit.js";
import { heightOf, isSame, joined, keysInBox } from "./keys.js";
import { layoutOf, NAMES_PX, rowsInSight, scrolledTo, scrollMax, walkedRows } from "./layout.js";
import { paletteOf } from "./palette.js";
import { evened, snapped, STEPS_DEG, STEPS_S, targetsOf } from "./snap.js";
import { fitted, following, kept, panned, pixelOf, timeAt, zoomed } from "./window.js";

/** @typedef {import("../store.js").Store} Store */
/** @typedef {import("./window.js").Window} Window */

const WHEEL_FACTOR = 1.0015;
/** Of more keys the planner is asked when they are let go: their window is nearly the whole show. */
const TRIED_MAX = 100;

export class TimelineBoard {
  /** @type {Store} */
  #store;
  /** @type {HTMLElement} */
  #element;
  /** @type {HTMLCanvasElement[]} */
  #canvases = [];
  /** @type {Window} */
  #seen = { start_s: 0, px_per_s: 100, width_px: 1 };
  #scroll_px = 0;
  #height_px = 1;
  /** @type {import("../state.js").View | null} */
  #view = null;
  /** @type {import("./layout.js").Layout | null} */
  #layout = null;
  /** @type {Record<string, [number, number]>} */
  #used_deg = {};
  /** @type {import("./palette.js").Palette | null} */
  #palette = null;
  #drawn = "";
  /** @type {import("../state.js").Selection} */
  #selection = null;
  #live = "";
  #isFitted = true;
  /** @type {import("./gestures.js").Gesture} */
  #gesture = REST;
  #held = 0;
  /** Where the pointer was last. @type {import("./gestures.js").Finger} */
  #pointer = { id: 0, x_px: 0, y_px: 0 };
  /** What the planner said last of a draft. @type {{ name: string, tried: import("../state.js").Tried | null }} */
  #trial = { name: "", tried: null };
  #isTrying = false;
  #actions;
  /** @type {(() => void)[]} */
  #ends = [];
  /** How many keys the last drawing had, for tests. */
  keys = 0;

  /**
   * @param {HTMLElement} element filled with the canvases @param {Store} store
   * @param {import("../actions.js").Actions} actions
   */
  constructor(element, store, actions) {
    this.#actions = actions;
    this.#element = element;
    this.#store = store;
    for (const name of ["names", "plan", "live"]) {
      const canvas = document.createElement("canvas");
      canvas.className = `board-${name}`;
      canvas.setAttribute("aria-hidden", "true"); // The grid of mirror.js is the same for others.
      element.append(canvas);
      this.#canvases.push(canvas);
    }
    const sizes = new ResizeObserver(() => this.#resize());
    sizes.observe(element);
    const live = /** @type {HTMLCanvasElement} */ (this.#canvases[2]);
    const listen = /** @type {[string, (event: any) => void][]} */ ([
      ["pointerdown", (event) => this.#press(event)],
      ["pointermove", (event) => this.#move(event)],
      ["pointerup", (event) => this.#handle({ kind: "up", finger: fingerOf(event) })],
      ["dblclick", (event) => this.#double(event)],
      ["contextmenu", (event) => this.#context(event)],
      ["pointercancel", () => this.#handle({ kind: "drop" })],
    ]);
    for (const [name, act] of listen) live.addEventListener(name, act);
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    this.#ends = [() => sizes.disconnect(), onFrame(() => this.#draw())];
    this.#resize();
  }

  get #editor() {
    return this.#actions.editor;
  }

  dispose() {
    window.clearTimeout(this.#held);
    for (const end of this.#ends) end();
    this.#element.replaceChildren();
  }

  get seen() {
    return this.#seen;
  }

  /** Read the colours of the theme again. */
  setTheme() {
    this.#palette = null;
    this.#drawn = "";
    requestFrame();
  }

  // -------------------------------------------------------------- what a key or button does

  /** @param {number} factor @param {number} [x_px] about this pixel; default: the cursor, if in sight */
  zoom(factor, x_px) {
    const cursor_px = pixelOf(this.#seen, this.#store.state.value.cursor_s);
    const isSeen = cursor_px >= 0 && cursor_px <= this.#seen.width_px;
    const about_px = x_px ?? (isSeen ? cursor_px : this.#seen.width_px / 2);
    this.#look(zoomed(this.#seen, factor, about_px, this.#length_s));
  }

  fit() {
    this.#isFitted = true;
    this.#look(fitted(this.#length_s, this.#seen.width_px), true);
  }

  /** Show from one instant to another. @param {number} from_s @param {number} to_s */
  show(from_s, to_s) {
    const own = fitted(to_s - from_s, this.#seen.width_px);
    this.#look(kept({ ...own, start_s: own.start_s + from_s }, this.#length_s));
  }

  /** Bring an instant into sight. @param {number} at_s */
  reveal(at_s) {
    this.#look(following(this.#seen, at_s, this.#length_s), this.#isFitted);
  }

  /** Show a row, by its place among the rows that can be walked through. @param {number} index */
  revealRow(index) {
    const row = this.#layout === null ? undefined : walkedRows(this.#layout)[index];
    if (this.#layout === null || row === undefined) return;
    this.#scroll_px = scrolledTo(this.#layout, row, this.#scroll_px, this.#height_px);
    requestFrame();
  }

  get #length_s() {
    return this.#view?.view_s ?? 1;
  }

  /** @param {Window} seen @param {boolean} [isFitted] */
  #look(seen, isFitted = false) {
    this.#isFitted = isFitted;
    this.#seen = seen;
    requestFrame();
  }

  // ------------------------------------------------------------------------- drawing

  #resize() {
    const width_px = Math.max(this.#element.clientWidth - NAMES_PX, 50);
    this.#height_px = Math.max(this.#element.clientHeight, 50);
    if (this.#view !== null) this.#layout = layoutOf(this.#view, this.#height_px);
    this.#seen = this.#isFitted ? fitted(this.#length_s, width_px)
      : kept({ ...this.#seen, width_px }, this.#length_s);
    const ratio = window.devicePixelRatio || 1;
    for (const canvas of this.#canvases) {
      const own_px = canvas.className === "board-names" ? NAMES_PX : width_px;
      canvas.width = Math.round(own_px * ratio);
      canvas.height = Math.round(this.#height_px * ratio);
      canvas.style.width = `${own_px}px`;
      canvas.style.height = `${this.#height_px}px`;
    }
    this.#drawn = "";
    requestFrame();
  }

  /** @param {import("../state.js").View} view */
  #take(view) {
    this.#view = view;
    this.#layout = layoutOf(view, this.#height_px);
    this.#used_deg = Object.fromEntries(view.joints.map(({ name }) => [name, usedOf(view.curves[name]?.plan, view.view_s)]));
    this.#scroll_px = Math.min(this.#scroll_px, scrollMax(this.#layout, this.#height_px));
    this.#seen = this.#isFitted ? fitted(view.view_s, this.#seen.width_px) : kept(this.#seen, view.view_s);
    this.#drawn = "";
  }

  #draw() {
    const state = this.#store.state.value;
    if (state.view === null) return;
    if (state.view !== this.#view) this.#take(state.view);
    if (this.#layout === null) return;
    this.#palette ??= paletteOf(this.#element);
    this.#scroll_px = Math.min(Math.max(this.#scroll_px, 0), scrollMax(this.#layout, this.#height_px));
    const playhead_s = this.#playhead(state);
    const isDragged = this.#gesture.kind !== "rest";
    if (state.follow && playhead_s !== null && state.player.state === "playing" && !isDragged) {
      this.#seen = following(this.#seen, playhead_s, this.#length_s);
    }
    const rows = rowsInSight(this.#layout, this.#scroll_px, this.#height_px);
    const scene = {
      view: state.view, rows, seen: this.#seen, fixed_px: this.#layout.fixed_px,
      height_px: this.#height_px, order: state.order, selection: state.selection, row: state.row,
      palette: this.#palette, used_deg: this.#used_deg, ghosts: state.ghosts,
    };
    this.#drawPlan(scene, state);
    this.#drawMoving(scene, state, playhead_s);
  }

  /** @param {import("./draw.js").Scene} scene @param {import("../state.js").State} state */
  #drawPlan(scene, state) {
    const { start_s, px_per_s, width_px } = this.#seen;
    const drawn = [start_s, px_per_s, width_px, this.#scroll_px, this.#height_px, state.order, state.row, ...Object.values(state.ghosts)].join(" ");
    if (drawn === this.#drawn && state.selection === this.#selection) return;
    this.#drawn = drawn;
    this.#selection = state.selection;
    const [names, plan] = this.#contexts();
    this.keys = drawTimeline(plan, scene);
    drawBeats(plan, scene, scene.view.beats, scene.palette.anchor);
    const walked = this.#layout === null ? [] : walkedRows(this.#layout);
    const row = walked[state.row];
    const own = scene.rows.find((one) => row !== undefined && one.kind === row.kind && one.index === row.index);
    drawNames(names, scene, NAMES_PX, own?.y_px ?? NaN);
    this.#live = "";
  }

  /** @param {import("./draw.js").Scene} scene @param {import("../state.js").State} state
   * @param {number | null} playhead_s */
  #drawMoving(scene, state, playhead_s) {
    const view = scene.view;
    const { segments, plan } = this.#store.readings;
    const proposed = state.proposed ?? [];
    const counts = `${proposed.length} ${proposed[0]} ${segments.length} ${segments.at(-1)?.count ?? 0} ${playhead_s} ${state.cursor_s}`;
    if (counts === this.#live) return;
    this.#live = counts;
    const live = this.#contexts()[2];
    drawLive(live, scene, {
      playhead_s,
      cursor_s: state.cursor_s,
      order: plan === view.plan ? (state.started?.joints ?? []) : [],
      segments,
      toView: (at_s) => withinView(view, at_s),
    });
    drawBeats(live, scene, proposed, scene.palette.selected);
    const gesture = this.#gesture;
    if (gesture.kind === "box" && gesture.isMoved) drawBox(live, scene, boxOf(gesture.from, gesture.at));
    if (gesture.kind === "event" && gesture.isMoved) {
      const { at_s, what } = this.#eventAt(gesture);
      drawInstant(live, scene, at_s, [view.events[gesture.hit.event]?.text ?? "", what], gesture.at);
    }
    if (gesture.kind === "slope") this.#drawSlope(live, scene, gesture);
    else if (scene.order === 0) this.#drawHandles(live, scene, handlesOf(view, this.#editor.keys));
    const draft = gesture.kind === "keys" ? this.#draft(gesture) : null;
    if (gesture.kind !== "keys" || draft === null) return;
    if (draft.keys.length <= TRIED_MAX) void this.#try(draftName(draft), () => this.#editor.triedDraft(draft));
    const tried = this.#trial.name === draftName(draft) ? this.#trial.tried : null;
    const words = draftText(view, draft, gesture.hit, tried);
    this.#element.dataset["draft"] = words.join("; ");
    drawDraft(live, scene, draft, { held: gesture.hit, at: gesture.at, tried, words });
  }

  /** @param {CanvasRenderingContext2D} ctx @param {import("./draw.js").Scene} scene @param {import("./slopes.js").Handle[]} handles */
  #drawHandles(ctx, scene, handles) {
    for (const row of scene.rows) {
      if (row.kind !== "joint") continue;
      drawHandles(ctx, scene, handles.filter((one) => one.joint === row.name), this.#scale(row).y, scene.palette.selected);
    }
  }

  /** A handle that is dragged: the curve that it makes, and what the planner says of it. @param {CanvasRenderingContext2D} ctx
   * @param {import("./draw.js").Scene} scene @param {Extract<import("./gestures.js").Gesture, { kind: "slope" }>} gesture */
  #drawSlope(ctx, scene, gesture) {
    const row = scene.rows.find((own) => own.kind === "joint" && own.name === gesture.hit.joint);
    const handle = this.#turned(gesture);
    if (row === undefined || handle === null) return;
    const { y } = this.#scale(row);
    const name = `slope ${handle.slope}`;
    void this.#try(name, () => this.#editor.triedSlope(handle));
    const tried = this.#trial.name === name ? this.#trial.tried : null;
    const isSlow = tried?.problem != null || (tried?.window?.slow.length ?? 0) > 0;
    const colour = isSlow ? scene.palette.stretched : scene.palette.selected;
    if (tried?.window != null) drawWindow(ctx, scene, row, tried.window, colour);
    drawBent(ctx, scene, handle, y, colour);
    drawHandles(ctx, scene, [handle], y, colour);
    const words = [slopeText(handle), ...(tried === null ? [] : triedTexts(tried))];
    this.#element.dataset["draft"] = words.join("; ");
    drawWords(ctx, scene, words, gesture.at, isSlow);
  }

  /** Return the handle as it is dragged. @param {Extract<import("./gestures.js").Gesture, { kind: "slope" }>} gesture */
  #turned({ hit, at, isFine }) {
    const handle = this.#view === null ? null : handleOf(this.#view, hit);
    const row = this.#layout === null ? undefined : rowsInSight(this.#layout, this.#scroll_px, this.#height_px)
      .find((own) => own.kind === "joint" && own.name === hit.joint);
    return handle === null || row === undefined ? null : turned(handle, hit.side, at, this.#seen, this.#scale(row).y, isFine);
  }

  /** Ask the planner for the newest draft, one at a time. @param {string} name
   * @param {() => Promise<import("../state.js").Tried | null>} ask */
  async #try(name, ask) {
    if (this.#isTrying || name === this.#trial.name) return;
    this.#isTrying = true;
    const tried = await ask();
    this.#isTrying = false;
    this.#trial = { name, tried };
    if (this.#gesture.kind === "keys" || this.#gesture.kind === "slope") this.#redraw();
  }

  /** @param {import("../state.js").State} state @returns {number | null} */
  #playhead(state) {
    const frame = this.#store.telemetry.value;
    const isOver = state.player.state === "idle" || state.player.state === "ended";
    if (frame === null || state.view === null || isOver || frame.plan !== state.view.plan) return null;
    return withinView(state.view, frame.show_s);
  }

  /** @returns {[CanvasRenderingContext2D, CanvasRenderingContext2D, CanvasRenderingContext2D]} */
  #contexts() {
    const ratio = window.devicePixelRatio || 1;
    const found = this.#canvases.map((canvas) => {
      const ctx = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
      ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
      return ctx;
    });
    return /** @type {any} */ (found);
  }

  // ------------------------------------------------------------------------- pointer

  /** @param {PointerEvent} event */
  #press(event) {
    if (event.button > 1) return;
    const canvas = /** @type {HTMLCanvasElement} */ (event.currentTarget);
    canvas.setPointerCapture(event.pointerId);
    const hit = this.#hit(event);
    if ((event.ctrlKey || event.metaKey) && hit?.kind === "row" && this.#gesture.kind === "rest") {
      this.#add(event, hit);
      return;
    }
    const isTouch = event.pointerType === "touch";
    this.#handle({
      kind: "down", finger: fingerOf(event), hit, isTouch, isMiddle: event.button === 1, isAdded: event.shiftKey,
      isChosen: hit?.kind === "key" && this.#editor.keys.some((own) => isSame(own, hit)),
    });
    if (isTouch) this.#held = window.setTimeout(() => this.#handle({ kind: "held" }), HELD_MS);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    this.#pointer = fingerOf(event);
    if (this.#gesture.kind === "rest") {
      const kind = this.#hit(event)?.kind ?? "nothing";
      this.#element.style.cursor = kind === "key" || kind === "handle" ? "grab" : kind === "span" ? "pointer" : "";
      return;
    }
    this.#handle({ kind: "move", finger: fingerOf(event), isFine: event.shiftKey, snaps: event.ctrlKey || event.metaKey });
  }

  /** Go on with the gesture, and do what it says. @param {import("./gestures.js").Input} input */
  #handle(input) {
    const before = this.#gesture.kind;
    const [next, acts] = afterInput(this.#gesture, input);
    this.#gesture = next;
    const isHeld = next.kind === "press" || next.kind === "event" && !next.isMoved || next.kind === "pan" && !next.isMoved;
    if (!isHeld) window.clearTimeout(this.#held);
    if ((next.kind === "keys" || next.kind === "slope") && before !== next.kind) {
      this.#trial = { name: "", tried: null };
      this.#element.style.cursor = "grabbing";
      this.#store.dispatch({ type: "set", fields: { is_dragging: true } });
    }
    for (const act of acts) this.#do(act);
  }

  /** @param {import("./gestures.js").Act} act */
  #do(act) {
    switch (act.act) {
      case "cursor": return this.#setCursor(act.x_px);
      case "zoom": return this.#look(zoomed(this.#seen, act.factor, act.x_px, this.#length_s));
      case "pan":
        this.#look(panned(this.#seen, act.by_px, this.#length_s), this.#isFitted && act.by_px === 0);
        this.#scroll_px += act.down_px;
        return undefined;
      case "choose": return this.#choose(act.hit, act.isAdded);
      case "toggle": return this.#editor.choose(joined(this.#editor.keys, [refOf(act.hit)], true));
      case "box": return this.#chooseBox(act);
      case "menu": return this.#menu(act.at, act.hit);
      case "commit": return this.#commit(act.gesture);
      case "draft": return this.#redraw();
      default:
        this.#element.style.cursor = "";
        delete this.#element.dataset["draft"];
        this.#store.dispatch({ type: "set", fields: { is_dragging: false } });
        return this.#redraw();
    }
  }

  #redraw() {
    this.#live = "";
    requestFrame();
  }

  /** End the drag under way; return whether there was one. */
  dropDrags() {
    const hasAny = this.#gesture.kind !== "rest";
    this.#handle({ kind: "drop" });
    return hasAny;
  }

  /** Let the chosen keys follow the pointer and the arrow keys until a click or Enter.
   * @param {import("./gestures.js").Mode} mode */
  grab(mode) {
    const [first] = this.#editor.keys;
    const own = first === undefined ? undefined : this.#view?.lanes[first.lane]?.keys[first.key];
    if (first === undefined || own === undefined) return;
    this.#handle({ kind: "grab", mode, at: this.#pointer, hit: { kind: "key", ...first, at_s: own.at_s } });
  }

  /** Move what is dragged by a step of an arrow key; return whether anything is. @param {number} by_s @param {number} by_deg */
  step(by_s, by_deg) {
    this.#handle({ kind: "steps", by: { by_s, by_deg } });
    return this.#gesture.kind === "keys";
  }

  /** Take what follows the pointer; return whether anything did. */
  take() {
    const isDragged = this.#gesture.kind === "keys";
    this.#handle({ kind: "take" });
    return isDragged;
  }

  /** Let the next drag draw a box, wherever it begins. */
  arm() {
    this.#handle({ kind: "arm" });
    this.#element.style.cursor = "crosshair";
  }

  /** Keep dragged keys on one axis, or let them free again; return whether any are dragged.
   * @param {"time" | "angle"} axis */
  lockAxis(axis) {
    this.#handle({ kind: "axis", axis });
    return this.#gesture.kind === "keys";
  }

  /** @param {import("./hit.js").Hit | null} hit @param {boolean} isAdded */
  #choose(hit, isAdded) {
    if (hit === null || this.#layout === null) return;
    const walked = walkedRows(this.#layout);
    /** @param {string} kind @param {number} index */
    const rowOf = (kind, index) => Math.max(walked.findIndex((row) => row.kind === kind && row.index === index), 0);
    /** @type {Record<string, unknown>} */
    let fields = isAdded ? {} : { selection: null };
    if (hit.kind === "key") {
      const joint = this.#view?.joints.findIndex((own) => own.name === hit.joint) ?? -1;
      const keys = isAdded ? joined(this.#editor.keys, [refOf(hit)], false) : [refOf(hit)];
      fields = { selection: { kind: "keys", keys }, row: joint >= 0 ? rowOf("joint", joint) : rowOf("lane", hit.lane) };
    } else if (hit.kind === "event") {
      fields = { ...fields, side: "contents" };
    } else if (hit.kind === "span") {
      fields = { selection: { kind: "span", list: hit.list, index: hit.index } };
    } else if (hit.kind === "row" && (hit.row.kind === "joint" || hit.row.kind === "lane")) {
      fields = { ...fields, row: rowOf(hit.row.kind, hit.row.index) };
    }
    this.#store.dispatch({ type: "set", fields });
    this.#store.dispatch({ type: "cursor", at_s: hit.at_s });
  }

  /** @param {Extract<import("./gestures.js").Act, { act: "box" }>} box */
  #chooseBox({ from, to, isAdded }) {
    if (this.#view === null || this.#layout === null) return;
    const rows = rowsInSight(this.#layout, this.#scroll_px, this.#height_px);
    const found = keysInBox(this.#view, rows, this.#seen, boxOf(from, to), (row, key) => this.#keyY(row, key));
    this.#editor.choose(isAdded ? joined(this.#editor.keys, found, false) : found);
  }

  /** @param {import("./gestures.js").Gesture} gesture */
  #commit(gesture) {
    const event = gesture.kind === "event" ? this.#view?.events[gesture.hit.event] : undefined;
    if (gesture.kind === "event" && event !== undefined) void this.#actions.contents.moveEvent(event, this.#eventAt(gesture).at_s);
    const handle = gesture.kind === "slope" ? this.#turned(gesture) : null;
    if (handle !== null) this.#editor.setSlope(handle, () => handle.slope);
    if (gesture.kind !== "keys") return;
    const draft = this.#draft(gesture);
    if (draft !== null && !isNothing(draft)) this.#editor.takeDraft(draft);
  }

  /** @param {import("./draft.js").KeysGesture} gesture */
  #draft(gesture) {
    const view = this.#view;
    const row = this.#layout === null ? undefined : rowsInSight(this.#layout, this.#scroll_px, this.#height_px)
      .find((own) => own.kind === "joint" && own.name === gesture.hit.joint);
    if (view === null) return null;
    const { order, cursor_s } = this.#store.state.value;
    const deg_per_px = row === undefined || order !== 0 ? 0 : 1 / Math.abs(this.#scale(row).y(1) - this.#scale(row).y(0));
    return draftOf(gesture, { view, seen: this.#seen, keys: this.#editor.keys, cursor_s, deg_per_px });
  }

  /** Where a dragged event would be, and at what. @param {Extract<import("./gestures.js").Gesture, { kind: "event" }>} gesture */
  #eventAt({ at, from, hit, isFine, snaps }) {
    const by_s = (at.x_px - from.x_px) / this.#seen.px_per_s / (isFine ? 10 : 1);
    const wanted_s = Math.min(Math.max(hit.at_s + by_s, 0), this.#length_s);
    const step_s = isFine ? STEPS_S.fine : STEPS_S.coarse;
    if (!snaps || this.#view === null) return { at_s: evened(wanted_s, step_s), what: "" };
    const targets = targetsOf(this.#view, this.#store.state.value.cursor_s, () => false).filter(({ at_s }) => at_s !== hit.at_s);
    return snapped(wanted_s, targets, REACH_PX / this.#seen.px_per_s, step_s);
  }

  /** @param {MouseEvent} event */
  #double(event) {
    const hit = this.#hit(event);
    if (hit?.kind === "key") this.#actions.run("type_value");
    else if (hit?.kind === "row") this.#add(event, hit);
  }

  /** Add a key where the pointer is. @param {MouseEvent} event @param {Extract<import("./hit.js").Hit, { kind: "row" }>} hit */
  #add(event, hit) {
    if (hit.row.kind !== "joint" && hit.row.kind !== "lane") return;
    this.#editor.add(hit.row, evened(hit.at_s, STEPS_S.coarse), this.#degAt(hit.row, event.offsetY));
  }

  /** Return the angle at a height of a joint's row; undefined where it shows none.
   * @param {import("./layout.js").Row} row @param {number} y_px */
  #degAt(row, y_px) {
    const joint = this.#view?.joints[row.index];
    if (row.kind !== "joint" || joint === undefined || this.#store.state.value.order !== 0) return undefined;
    const { y } = this.#scale(row);
    const deg = (y_px - y(0)) / (y(1) - y(0));
    return evened(Math.min(Math.max(deg, joint.range_deg[0]), joint.range_deg[1]), STEPS_DEG.coarse);
  }

  /** @param {MouseEvent} event */
  #context(event) {
    event.preventDefault();
    // It gives up what follows the pointer. A long touch has asked for the menu already.
    if (this.dropDrags() || /** @type {PointerEvent} */ (event).pointerType === "touch") return;
    this.#menu({ x_px: event.offsetX, y_px: event.offsetY }, this.#hit(event));
  }

  /** @param {{ x_px: number, y_px: number }} at @param {import("./hit.js").Hit | null} hit */
  #menu(at, hit) {
    if (hit === null) return;
    if (hit.kind !== "key" || !this.#editor.keys.some((own) => isSame(own, refOf(hit)))) this.#choose(hit, false);
    const rows = this.#layout === null ? [] : rowsInSight(this.#layout, this.#scroll_px, this.#height_px);
    const row = rows.find((own) => (own.kind === "joint" || own.kind === "lane") && at.y_px >= own.y_px && at.y_px < own.y_px + own.height_px) ?? null;
    const { left, top } = this.#element.getBoundingClientRect();
    const deg = row === null ? undefined : this.#degAt(row, at.y_px);
    const place = { x_px: left + NAMES_PX + at.x_px, y_px: top + at.y_px };
    this.#store.dispatch({ type: "set", fields: { menu: { ...place, at_s: evened(hit.at_s, STEPS_S.coarse), row, deg } } });
  }

  /** @param {MouseEvent} event */
  #hit(event) {
    if (this.#view === null || this.#layout === null) return null;
    const rows = rowsInSight(this.#layout, this.#scroll_px, this.#height_px);
    const isTouch = /** @type {PointerEvent} */ (event).pointerType === "touch";
    const point = { x_px: event.offsetX, y_px: event.offsetY, reach_px: isTouch ? TOUCH_REACH_PX : REACH_PX };
    if (this.#store.state.value.order !== 0) return hitAt(this.#view, rows, this.#seen, point);
    const row = rows.find((own) => own.kind === "joint" && point.y_px >= own.y_px && point.y_px < own.y_px + own.height_px);
    for (const handle of row === undefined ? [] : handlesOf(this.#view, this.#editor.keys)) {
      const end = row?.name === handle.joint ? endAt(handle, this.#seen, this.#scale(row).y, point) : undefined;
      if (end !== undefined) return { .../** @type {const} */ ({ kind: "handle" }), ...handle, side: end.side };
    }
    return hitAt(this.#view, rows, this.#seen, { ...point, yOf: (row, key) => this.#keyY(row, key) });
  }

  /** @param {import("./layout.js").Row} row */
  #scale(row) {
    const view = /** @type {import("../state.js").View} */ (this.#view);
    return scaleOf({ view, order: this.#store.state.value.order, used_deg: this.#used_deg }, row);
  }

  /** @param {import("./layout.js").Row} row @param {import("../state.js").JointKey} key */
  #keyY(row, key) {
    const plan = this.#view?.curves[row.name]?.plan;
    return heightOf(key, this.#scale(row).y, (at_s) => (plan === undefined ? 0 : angleAt(plan, at_s)));
  }

  /** @param {number} x_px */
  #setCursor(x_px) {
    this.#store.dispatch({ type: "cursor", at_s: timeAt(this.#seen, x_px) });
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    event.preventDefault();
    const x_px = event.clientX - this.#element.getBoundingClientRect().left - NAMES_PX;
    if (event.ctrlKey || event.metaKey || event.altKey) {
      this.#look(zoomed(this.#seen, WHEEL_FACTOR ** -event.deltaY, x_px, this.#length_s));
    } else if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      this.#look(panned(this.#seen, event.deltaX || event.deltaY, this.#length_s));
    } else {
      this.#scroll_px += event.deltaY;
      requestFrame();
    }
  }
}

/** @param {PointerEvent} event @returns {import("./gestures.js").Finger} */
function fingerOf(event) {
  return { id: event.pointerId, x_px: event.offsetX, y_px: event.offsetY };
}

/** @param {import("./gestures.js").KeyHit} hit @returns {import("../state.js").KeyRef} */
function refOf({ lane, key, joint }) {
  return { lane, key, joint };
}

/** @param {{ x_px: number, y_px: number }} one @param {{ x_px: number, y_px: number }} other @returns {import("./keys.js").Box} */
function boxOf(one, other) {
  return {
    left_px: Math.min(one.x_px, other.x_px), right_px: Math.max(one.x_px, other.x_px),
    top_px: Math.min(one.y_px, other.y_px), bottom_px: Math.max(one.y_px, other.y_px),
  };
}
