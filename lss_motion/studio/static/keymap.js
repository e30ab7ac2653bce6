// @ts-check
/**
 * The keys of the studio as data: the handler, the help and a test read the same table. Escape is not
 * here: stop.js has it, and what it closes is in `Actions.closeOpen`.
 */

/** @typedef {{ keys: string[], action: string, text: string, pages?: string[] }} Binding */

/** @type {Binding[]} */
export const KEYMAP = [
  { keys: ["Space"], action: "toggle", text: "play from the cursor, pause, resume (never GO)" },
  { keys: ["Enter"], action: "go", text: "GO, where the show waits for it", pages: ["show"] },
  { keys: ["ArrowLeft"], action: "step_back", text: "10 ms back", pages: ["timeline"] },
  { keys: ["ArrowRight"], action: "step", text: "10 ms forward", pages: ["timeline"] },
  { keys: ["Shift+ArrowLeft"], action: "stride_back", text: "100 ms back", pages: ["timeline"] },
  { keys: ["Shift+ArrowRight"], action: "stride", text: "100 ms forward", pages: ["timeline"] },
  { keys: ["["], action: "previous_key", text: "previous key", pages: ["timeline"] },
  { keys: ["]"], action: "next_key", text: "next key", pages: ["timeline"] },
  { keys: ["ArrowUp"], action: "row_up", text: "row above", pages: ["timeline"] },
  { keys: ["ArrowDown"], action: "row_down", text: "row below", pages: ["timeline"] },
  { keys: ["Home"], action: "to_start", text: "to the start", pages: ["timeline"] },
  { keys: ["End"], action: "to_end", text: "to the end", pages: ["timeline"] },
  { keys: ["+", "="], action: "zoom_in", text: "zoom in", pages: ["timeline"] },
  { keys: ["-"], action: "zoom_out", text: "zoom out", pages: ["timeline"] },
  { keys: ["f"], action: "fit", text: "show all", pages: ["timeline"] },
  { keys: ["p"], action: "follow", text: "keep the playhead in sight", pages: ["timeline"] },
  { keys: ["a"], action: "order_0", text: "curves of angle", pages: ["timeline"] },
  { keys: ["s"], action: "order_1", text: "curves of speed", pages: ["timeline"] },
  { keys: ["d"], action: "order_2", text: "curves of acceleration", pages: ["timeline"] },
  { keys: ["i", "k", "I", "K", "Delete", "Backspace", "Control+z", "Control+y", "Control+Z"], action: "shows_only", text: "nothing: this page shows, the file is edited", pages: ["timeline"] },
  { keys: ["v"], action: "theatre", text: "figure and clock only, and back" },
  { keys: ["1"], action: "page_show", text: "Show page" },
  { keys: ["2"], action: "page_timeline", text: "Timeline page" },
  { keys: ["3"], action: "page_robot", text: "Robot page" },
  { keys: ["t"], action: "theme", text: "dark or light" },
  { keys: ["?"], action: "help", text: "this list" },
];

/** Keys of stop.js, for the help. @type {Binding[]} */
export const STOP_KEYS = [
  { keys: ["Escape"], action: "stop", text: "closes what is open (this list, a question, a message, a selection); else STOP: brakes within the limits" },
  { keys: ["Shift+Escape"], action: "estop", text: "E-STOP, always: the safe bytes at once" },
];

/** Return the name of a pressed key as the table has it.
 * @param {{ key: string, code: string, shiftKey: boolean, ctrlKey: boolean, metaKey: boolean }} event */
export function keyName(event) {
  if (event.ctrlKey || event.metaKey) return `Control+${event.key}`;
  if (event.code === "Space") return "Space";
  const isNamed = event.key.length > 1;
  return event.shiftKey && isNamed ? `Shift+${event.key}` : event.key;
}

/**
 * Return what a key does on a page, or null. @param {string} name @param {string} page
 */
export function actionOf(name, page) {
  const found = KEYMAP.find(
    (one) => one.keys.includes(name) && (one.pages === undefined || one.pages.includes(page)),
  );
  return found?.action ?? null;
}

/**
 * Return whether an element needs the key for itself. @param {Element | null} element
 * @param {string} name
 */
export function keepsKey(element, name) {
  if (element === null || element.matches(":disabled")) return false;
  if (element.closest("dialog") !== null) return true;
  if (element.matches("textarea, input:not([type=range])")) return true;
  if (element.matches("input[type=range]")) return name.includes("Arrow") || name === "Home" || name === "End";
  // Space never means GO, also where the GO button has the focus.
  if (name === "Space" && element.matches("[data-go]")) return false;
  return (name === "Space" || name === "Enter") && element.matches("button, a, summary, [role=tab]");
}

/**
 * Give the keys back to the page after a click by a pointer: Enter is GO then, and does not press the
 * clicked button once more. Who presses a button by a key keeps the focus there.
 * @param {MouseEvent} event
 */
export function releaseFocus(event) {
  const element = document.activeElement;
  if (event.detail === 0 || !(element instanceof HTMLElement) || element.closest("dialog") !== null) return;
  if (element.matches("button, summary, input[type=checkbox], input[type=radio]")) element.blur();
}
