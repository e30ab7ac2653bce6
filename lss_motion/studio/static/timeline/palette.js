// @ts-check
/** Colours of the canvas, read from the theme's custom properties at a theme change. */

const NAMES = /** @type {const} */ ({
  ground: "--ground", surface: "--surface", raised: "--raised", line: "--line", text: "--text",
  muted: "--muted", plan: "--plan", predicted: "--predicted", reading: "--reading",
  authored: "--authored", key: "--key", anchor: "--anchor", hold: "--hold", event: "--event",
  limit: "--limit", stretched: "--stretched", given_up: "--given-up", playhead: "--playhead",
  cursor: "--cursor", wave: "--wave", selected: "--accent",
});

/** @typedef {{ [name in keyof typeof NAMES]: string }} Palette */

/** Return the colours of the theme in force. @param {Element} element @returns {Palette} */
export function paletteOf(element) {
  const style = getComputedStyle(element);
  const entries = Object.entries(NAMES).map(([name, own]) => [name, style.getPropertyValue(own).trim()]);
  return /** @type {Palette} */ (Object.fromEntries(entries));
}
