// @ts-check
/** Wires everything together; no logic. */

import { html, render, useState, useEffect } from "./vendor/preact.js";
import { Actions } from "./actions.js";
import { actionOf, keepsKey, keyName, releaseFocus } from "./keymap.js";
import { ServerLink } from "./link.js";
import { Dialogs } from "./parts/dialogs.js";
import { Entry } from "./parts/entry.js";
import { Banners, Header } from "./parts/header.js";
import { Transport } from "./parts/transport.js";
import { ShowPage } from "./pages/show.js";
import { TimelinePage } from "./pages/timeline.js";
import { setCloser } from "./stop.js";
import { createStore } from "./store.js";

const THEME_KEY = "lss-theme";

const store = createStore();
const link = new ServerLink(store);
const actions = new Actions(store, link);

function App() {
  const state = store.state.value;
  if (state.link.status === "denied") return html`<${Entry} text=${state.link.text} link=${link} />`;
  if (state.welcome === null) return html`<p class="boot" role="status">${state.link.text || "Connecting to the studio…"}</p>`;
  const Page = { show: ShowPage, timeline: TimelinePage, robot: RobotLoader }[state.page];
  const isTheatre = state.theatre && state.page === "show";
  return html`<div class=${`app app-${state.page} ${isTheatre ? "app-theatre" : ""} ${state.link.status === "lost" ? "app-lost" : ""}`}>
    <${Header} state=${state} actions=${actions} />
    <${Banners} state=${state} actions=${actions} />
    <${Page} state=${state} actions=${actions} store=${store} dispatch=${store.dispatch} link=${link} />
    <${Transport} state=${state} actions=${actions} store=${store} />
    <${Dialogs} state=${state} actions=${actions} />
  </div>`;
}

/** The Robot page, loaded when it is first opened. @param {Record<string, unknown>} props */
function RobotLoader(props) {
  const [loaded, setLoaded] = useState(/** @type {{ Page: any } | null} */ (null));
  const [problem, setProblem] = useState("");
  useEffect(() => {
    // @ts-ignore It is a module of its own.
    import("./pages/robot.js").then((module) => setLoaded({ Page: module.RobotPage }), (error) => setProblem(error.message));
  }, []);
  if (loaded === null) return html`<main class="page"><p class="boot">${problem || "Loading…"}</p></main>`;
  return html`<${loaded.Page} ...${props} />`;
}

window.addEventListener("keydown", (event) => {
  const name = keyName(event);
  const state = store.state.value;
  if (state.dialog !== null || keepsKey(document.activeElement, name)) return;
  const action = actionOf(name, state.page);
  if (action === null) return;
  event.preventDefault();
  if (event.repeat && ["toggle", "go"].includes(action)) return;
  actions.run(action);
});

window.addEventListener("click", releaseFocus);
setCloser(() => actions.closeOpen());

store.select((state) => state.theme).subscribe((theme) => {
  document.documentElement.dataset["theme"] = theme;
  localStorage.setItem(THEME_KEY, theme);
});
store.select((state) => state.page).subscribe((page) => {
  if (store.state.value.welcome !== null) history.replaceState(null, "", `#${page}`);
});

/** Take the key out of the address, then connect. */
async function begin() {
  const given = new URLSearchParams(location.hash.slice(1));
  const token = given.get("token");
  const page = location.hash.slice(1);
  const stored = localStorage.getItem(THEME_KEY);
  const isLight = stored === null ? matchMedia("(prefers-color-scheme: light)").matches : stored === "light";
  actions.set({ theme: isLight ? "light" : "dark", ...(["show", "timeline", "robot"].includes(page) ? { page } : {}) });
  if (token === null) {
    link.connect();
    return;
  }
  history.replaceState(null, "", "#show");
  await link.enter({ token }).catch((error) => {
    store.dispatch({ type: "set", fields: { link: { status: "denied", text: error.message } } });
  });
}

render(html`<${App} />`, /** @type {HTMLElement} */ (document.getElementById("app")));
await begin();
