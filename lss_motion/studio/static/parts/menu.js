// @ts-check
/** The menu of the timeline: by the right button or a long touch. STOP stays above it. */

import { html, useLayoutEffect, useRef } from "../vendor/preact.js";

/** @typedef {import("../actions.js").Actions} Actions */
/** @typedef {{ action: string, text: string, keys: string, isOff?: boolean }} Entry */

/** Return what can be done at a place. @param {Actions} actions @param {NonNullable<import("../state.js").State["menu"]>} menu @returns {Entry[]} */
function entriesOf(actions, menu) {
  const hasKeys = actions.editor.keys.length > 0;
  const isKey = { isOff: !hasKeys };
  return [
    { action: "add_at_menu", text: "Key here", keys: "double-click", isOff: menu.row === null },
    { action: "delete", text: "Delete", keys: "Del", ...isKey },
    { action: "copy", text: "Copy", keys: "Ctrl C", ...isKey },
    { action: "cut", text: "Cut", keys: "Ctrl X", ...isKey },
    { action: "paste", text: "Paste at the cursor", keys: "Ctrl V", isOff: !actions.editor.hasCopied },
    { action: "grab", text: "Move", keys: "G", ...isKey },
    { action: "scale", text: "Scale about the cursor", keys: "S", ...isKey },
    { action: "duplicate", text: "Duplicate", keys: "Shift D", ...isKey },
    { action: "mirror", text: "Mirror", keys: "Ctrl M", ...isKey },
    { action: "type_value", text: "Type a value", keys: "Enter", ...isKey },
    { action: "ease", text: "Next ease", keys: "T", ...isKey },
    { action: "slope", text: "Slope: flat, free, or not", keys: "V", ...isKey },
    { action: "hold", text: "Hold …", keys: "H", ...isKey },
    { action: "anchor", text: "Anchor, or not", keys: "N", ...isKey },
    { action: "label", text: "Label …", keys: "L", ...isKey },
    { action: "say_at_menu", text: "Text event here", keys: "" },
    { action: "led_at_menu", text: "LED event here", keys: "" },
    { action: "open_text", text: "Open its line of the file", keys: "", ...isKey },
  ];
}

/** @param {{ state: import("../state.js").State, actions: Actions }} props */
export function Menu({ state, actions }) {
  const { menu } = state;
  const place = useRef(/** @type {HTMLDivElement | null} */ (null));
  useLayoutEffect(() => {
    const box = place.current;
    if (box === null || menu === null) return;
    const before = document.activeElement;
    // It is within the page, also when that is turned, and never over the foot with both stops.
    const put = () => {
      const foot_px = document.querySelector("#stops")?.getBoundingClientRect().top ?? innerHeight;
      box.style.left = `${Math.max(Math.min(menu.x_px, innerWidth - box.offsetWidth - 8), 8)}px`;
      box.style.top = `${Math.max(Math.min(menu.y_px, foot_px - box.offsetHeight - 8), 8)}px`;
    };
    put();
    addEventListener("resize", put);
    box.querySelector("button")?.focus({ preventScroll: true });
    return () => {
      removeEventListener("resize", put);
      if (before instanceof HTMLElement) before.focus({ preventScroll: true });
    };
  }, [menu]);
  if (menu === null) return null;
  /** @param {string} action */
  const run = (action) => {
    actions.set({ menu: null });
    actions.run(action);
  };
  return html`<div class="menu-veil" onPointerDown=${(/** @type {PointerEvent} */ event) => {
    if (event.target === event.currentTarget) actions.set({ menu: null });
  }} onContextMenu=${(/** @type {Event} */ event) => event.preventDefault()}>
    <div class="menu" role="menu" aria-label="What can be done here" ref=${place} onKeyDown=${walk}>
      ${entriesOf(actions, menu).map((own) => html`<button type="button" role="menuitem" key=${own.action} disabled=${own.isOff}
        onClick=${() => (own.action.endsWith("_at_menu") ? actions.addAtMenu(own.action) : run(own.action))}>${own.text}<span class="key-hint">${own.keys}</span></button>`)}
    </div></div>`;
}

/** Arrow keys go through the entries. @param {KeyboardEvent} event */
function walk(event) {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (step === undefined) return;
  const all = [.../** @type {HTMLElement} */ (event.currentTarget).querySelectorAll("button:not(:disabled)")];
  const index = all.indexOf(/** @type {Element} */ (document.activeElement));
  /** @type {HTMLElement | undefined} */ (all[(index + step + all.length) % all.length])?.focus();
  event.preventDefault();
}
