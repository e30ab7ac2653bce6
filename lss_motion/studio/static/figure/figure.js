// @ts-check
/**
 * The figure of a robot on a page: 3D where the browser has WebGL, else 2D.
 *
 * `createFigure` fills an element with a canvas and buttons for the views. Nothing is drawn but on a
 * change, by one request to `schedule`.
 */

import { VIEWS } from "./camera.js";
import { StickFigure } from "./stick.js";

/** @typedef {import("./kinematics.js").Figure} Figure */
/** @typedef {import("./kinematics.js").Pose} Pose */
/** @typedef {import("./stick.js").Poses} Poses */
/** @typedef {import("./stick.js").Palette} Palette */
/** @typedef {import("./stick.js").StickFigure | import("./scene.js").SceneFigure} Drawing */

/** Custom properties of the theme by role. */
const COLOURS = /** @type {const} */ ({
  plan: "--plan",
  reading: "--reading",
  edge: "--figure-edge",
  authored: "--authored",
  ground: "--figure-ground",
  dark: "--figure-dark",
  light: "--figure-light",
});

/**
 * @typedef {object} FigureOptions
 * @property {(draw: () => void) => void} schedule calls `draw` once in the next frame
 * @property {string} [label] what the picture is called
 * @property {(path: string) => string} [meshUrl] where a mesh is
 * @property {boolean} [is2d] never 3D
 */

/**
 * Fill an element with a figure.
 * @param {HTMLElement} element @param {Figure} figure @param {FigureOptions} options
 */
export function createFigure(element, figure, options) {
  return new FigureOnPage(element, figure, options);
}

/** A figure in an element. `ready` resolves when it is decided whether it is 3D. */
class FigureOnPage {
  /** @type {Poses} */
  #poses = { solid: {}, isRead: false, authored: null, line: null };
  /** @type {Palette | null} */
  #palette = null;
  /** @type {Drawing | null} */
  #drawing = null;
  /** @type {Pose[]} */
  #framed = [];
  #isAsked = false;
  #isOver = false;

  /** @param {HTMLElement} element @param {Figure} figure @param {FigureOptions} options */
  constructor(element, figure, options) {
    this.element = element;
    this.figure = figure;
    this.options = options;
    this.stage = document.createElement("div");
    this.stage.className = "figure-stage";
    element.classList.add("figure");
    element.replaceChildren(this.stage, this.#buttons());
    this.observer = new ResizeObserver(() => this.#ask());
    this.observer.observe(this.stage);
    /** @type {Promise<void>} */
    this.ready = this.#choose();
  }

  /** "webgl", "2d", or "" until that is decided. */
  get kind() {
    return this.#drawing?.kind ?? "";
  }

  /**
   * Keep these poses in the picture, so that it stands still while they are played; one that goes
   * beyond them makes the figure smaller. @param {Pose[]} poses
   */
  frame(poses) {
    this.#framed = poses;
    this.#drawing?.frame(poses);
    this.#ask();
  }

  /** Show other angles; what is left out stays. @param {Partial<Poses>} poses */
  setPose(poses) {
    this.#poses = { ...this.#poses, ...poses };
    this.#ask();
  }

  /** Show these angles now; for a caller that is in a frame. @param {Poses} poses */
  show(poses) {
    this.#poses = poses;
    this.#draw();
  }

  /** Read the colours again. */
  setTheme() {
    this.#palette = null;
    this.#ask();
  }

  resize() {
    this.#ask();
  }

  dispose() {
    this.#isOver = true;
    this.observer.disconnect();
    this.#drawing?.dispose();
    this.element.replaceChildren();
  }

  async #choose() {
    if (this.options.is2d !== true && hasWebGl()) {
      try {
        const { SceneFigure } = await import("./scene.js");
        if (this.#isOver) return;
        const canvas = this.#canvas("webgl");
        const meshUrl = this.options.meshUrl ?? ((path) => `/files/${path}`);
        this.#drawing = new SceneFigure(canvas, this.figure, () => this.#ask(), meshUrl);
        this.#drawing.frame(this.#framed);
        canvas.addEventListener("webglcontextlost", () => this.#fallBack(), { once: true });
        this.#ask();
        return;
      } catch (error) {
        console.warn("no 3D figure", error);
      }
    }
    this.#fallBack();
  }

  #fallBack() {
    if (this.#isOver) return;
    this.#drawing?.dispose();
    this.#drawing = new StickFigure(this.#canvas("2d"), this.figure, () => this.#ask());
    this.#drawing.frame(this.#framed);
    this.#ask();
  }

  /** @param {"webgl" | "2d"} kind */
  #canvas(kind) {
    const canvas = document.createElement("canvas");
    canvas.dataset["kind"] = kind;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", this.options.label ?? "figure of the robot");
    this.stage.replaceChildren(canvas);
    return canvas;
  }

  #buttons() {
    const bar = document.createElement("div");
    bar.className = "figure-views";
    bar.setAttribute("role", "group");
    bar.setAttribute("aria-label", "view of the figure");
    for (const name of Object.keys(VIEWS)) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = name;
      button.addEventListener("click", () => {
        this.#drawing?.orbit.setView(name);
        this.#ask();
      });
      bar.append(button);
    }
    return bar;
  }

  #ask() {
    if (this.#isAsked || this.#isOver) return;
    this.#isAsked = true;
    this.options.schedule(() => this.#draw());
  }

  #draw() {
    this.#isAsked = false;
    const size = { width_px: this.stage.clientWidth, height_px: this.stage.clientHeight };
    if (this.#isOver || this.#drawing === null || size.width_px === 0 || size.height_px === 0) return;
    this.#palette ??= paletteOf(this.element);
    this.#drawing.draw(this.#poses, this.#palette, size, window.devicePixelRatio || 1);
  }
}

/** @param {HTMLElement} element @returns {Palette} */
function paletteOf(element) {
  const style = getComputedStyle(element);
  const colours = Object.entries(COLOURS).map(([role, name]) => [
    role,
    style.getPropertyValue(name).trim() || "#888888",
  ]);
  return Object.fromEntries(colours);
}

function hasWebGl() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}
