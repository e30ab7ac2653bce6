// @ts-check
/**
 * The timeline on its canvases: names, plan, and what moves over it. Owns window, scroll and pointer;
 * everything else comes from the store. Layers are drawn in the next frame after something changed.
 */

import { angleAt, withinView } from "../curves.js";
import { onFrame, requestFrame } from "../frames.js";
import { drawLive, drawNames, drawTimeline } from "./draw.js";
import { hitAt, REACH_PX, TOUCH_REACH_PX } from "./hit.js";
import { layoutOf, NAMES_PX, rowsInSight, scrolledTo, scrollMax, walkedRows } from "./layout.js";
import { paletteOf } from "./palette.js";
import { fitted, following, kept, panned, pixelOf, timeAt, zoomed } from "./window.js";

/** @typedef {import("../store.js").Store} Store */
/** @typedef {import("./window.js").Window} Window */

const WHEEL_FACTOR = 1.0015;
const DRAG_PX = 4;
const SAMPLES = 400;

/** @typedef {{ id: number, x_px: number, y_px: number, from_x_px: number, kind: "pan" | "cursor" | "key", isMoved: boolean }} Drag */

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
  #live = "";
  #isFitted = true;
  /** @type {Map<number, Drag>} */
  #drags = new Map();
  #showsOnly;
  /** @type {(() => void)[]} */
  #ends = [];
  /** How many keys the last drawing had, for tests. */
  keys = 0;

  /**
   * @param {HTMLElement} element filled with the canvases @param {Store} store
   * @param {() => void} showsOnly called when somebody tries to change a key
   */
  constructor(element, store, showsOnly) {
    this.#showsOnly = showsOnly;
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
      ["pointerup", (event) => this.#release(event)],
      ["dblclick", () => this.#showsOnly()],
      ["contextmenu", (event) => {
        event.preventDefault();
        this.#showsOnly();
      }],
      ["pointercancel", (event) => void this.#drags.delete(event.pointerId)],
    ]);
    for (const [name, act] of listen) live.addEventListener(name, act);
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    this.#ends = [() => sizes.disconnect(), onFrame(() => this.#draw())];
    this.#resize();
  }

  dispose() {
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
    this.#layout = layoutOf(view);
    this.#used_deg = Object.fromEntries(view.joints.map((joint) => [joint.name, usedOf(view, joint.name)]));
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
    const isDragged = this.#drags.size > 0;
    if (state.follow && playhead_s !== null && state.player.state === "playing" && !isDragged) {
      this.#seen = following(this.#seen, playhead_s, this.#length_s);
    }
    const rows = rowsInSight(this.#layout, this.#scroll_px, this.#height_px);
    const scene = {
      view: state.view, rows, seen: this.#seen, fixed_px: this.#layout.fixed_px,
      height_px: this.#height_px, order: state.order, selection: state.selection, row: state.row,
      palette: this.#palette, used_deg: this.#used_deg,
    };
    this.#drawPlan(scene, state);
    this.#drawMoving(scene, state, playhead_s);
  }

  /** @param {import("./draw.js").Scene} scene @param {import("../state.js").State} state */
  #drawPlan(scene, state) {
    const { start_s, px_per_s, width_px } = this.#seen;
    const drawn = [start_s, px_per_s, width_px, this.#scroll_px, this.#height_px, state.order,
      state.row, JSON.stringify(state.selection)].join(" ");
    if (drawn === this.#drawn) return;
    this.#drawn = drawn;
    const [names, plan] = this.#contexts();
    this.keys = drawTimeline(plan, scene);
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
    const counts = `${segments.length} ${segments.at(-1)?.count ?? 0} ${playhead_s} ${state.cursor_s}`;
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
    if (event.button !== 0 && event.button !== 1) return;
    const canvas = /** @type {HTMLCanvasElement} */ (event.currentTarget);
    canvas.setPointerCapture(event.pointerId);
    const hit = this.#hit(event);
    const kind = hit?.kind === "ruler" ? "cursor" : hit?.kind === "key" && event.pointerType !== "touch" ? "key" : "pan";
    this.#drags.set(event.pointerId, {
      id: event.pointerId, x_px: event.offsetX, y_px: event.offsetY, from_x_px: event.offsetX, kind, isMoved: false,
    });
    if (kind === "cursor") this.#setCursor(event.offsetX);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const drag = this.#drags.get(event.pointerId);
    if (drag === undefined) {
      const kind = this.#hit(event)?.kind ?? "nothing";
      this.#element.style.cursor = kind === "key" || kind === "span" ? "pointer" : "";
      return;
    }
    const by_px = drag.x_px - event.offsetX;
    const down_px = drag.y_px - event.offsetY;
    if (!drag.isMoved && Math.hypot(by_px, down_px) < DRAG_PX) return;
    if (drag.kind === "key") {
      if (!drag.isMoved) this.#showsOnly();
      this.#element.style.cursor = "not-allowed";
    } else if (drag.kind === "cursor") {
      this.#setCursor(event.offsetX);
    } else if (this.#drags.size === 2) {
      const other = /** @type {Drag} */ ([...this.#drags.values()].find((one) => one !== drag));
      const before_px = Math.max(Math.abs(drag.x_px - other.x_px), 20);
      const after_px = Math.max(Math.abs(event.offsetX - other.x_px), 20);
      this.#look(zoomed(this.#seen, after_px / before_px, other.x_px, this.#length_s));
    } else {
      this.#look(panned(this.#seen, by_px, this.#length_s), this.#isFitted && by_px === 0);
      this.#scroll_px += down_px;
    }
    drag.isMoved = true;
    drag.x_px = event.offsetX;
    drag.y_px = event.offsetY;
  }

  /** @param {PointerEvent} event */
  #release(event) {
    const drag = this.#drags.get(event.pointerId);
    this.#drags.delete(event.pointerId);
    if (drag === undefined || drag.isMoved || drag.kind === "cursor") return;
    this.#choose(this.#hit(event));
  }

  /** End the drags under way; return whether there were any. */
  dropDrags() {
    const hasAny = this.#drags.size > 0;
    this.#drags.clear();
    return hasAny;
  }

  /** @param {import("./hit.js").Hit | null} hit */
  #choose(hit) {
    if (hit === null || this.#layout === null) return;
    const walked = walkedRows(this.#layout);
    /** @param {string} kind @param {number} index */
    const rowOf = (kind, index) => Math.max(walked.findIndex((row) => row.kind === kind && row.index === index), 0);
    /** @type {Record<string, unknown>} */
    let fields = { selection: null };
    if (hit.kind === "key") {
      const joint = this.#view?.joints.findIndex((own) => own.name === hit.joint) ?? -1;
      fields = {
        selection: { kind: "key", lane: hit.lane, key: hit.key, joint: hit.joint },
        row: joint >= 0 ? rowOf("joint", joint) : rowOf("lane", hit.lane),
      };
    } else if (hit.kind === "span") {
      fields = { selection: { kind: "span", list: hit.list, index: hit.index } };
    } else if (hit.kind === "row" && (hit.row.kind === "joint" || hit.row.kind === "lane")) {
      fields = { selection: null, row: rowOf(hit.row.kind, hit.row.index) };
    }
    this.#store.dispatch({ type: "set", fields });
    this.#store.dispatch({ type: "cursor", at_s: hit.at_s });
  }

  /** @param {PointerEvent} event */
  #hit(event) {
    if (this.#view === null || this.#layout === null) return null;
    const rows = rowsInSight(this.#layout, this.#scroll_px, this.#height_px);
    const reach_px = event.pointerType === "touch" ? TOUCH_REACH_PX : REACH_PX;
    return hitAt(this.#view, rows, this.#seen, { x_px: event.offsetX, y_px: event.offsetY, reach_px });
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

/** Return least and largest angle of a joint's plan. @param {import("../state.js").View} view
 * @param {string} joint @returns {[number, number]} */
function usedOf(view, joint) {
  const curve = view.curves[joint]?.plan;
  if (curve === undefined) return [0, 0];
  let low = Infinity;
  let high = -Infinity;
  for (const deg of curve.deg) {
    low = Math.min(low, deg);
    high = Math.max(high, deg);
  }
  for (let index = 0; index <= SAMPLES; index += 1) {
    const deg = angleAt(curve, (view.view_s * index) / SAMPLES);
    low = Math.min(low, deg);
    high = Math.max(high, deg);
  }
  return [low, high];
}
