// @ts-check
/**
 * Changes of what a show consists of besides its keys: events, sound, loops, tracks, layers, play list.
 * They are made on what the files hold now (`/model/REVISION.json`), which needs no plan.
 */

/** @typedef {(string | number)[]} Place */
/** @typedef {{ op: string, fields: Record<string, unknown> }} Change */
/** @typedef {{ revision: number, files: Record<string, { value: any }> }} Model */
/** @typedef {import("../store.js").Store} Store */
/** @typedef {import("../link.js").ServerLink} ServerLink */

/** A change waits no longer for the newest text than this. */
const WAIT_MS = 8000;
/** A change is made so often where the file changed in between. */
const TRIES_MAX = 3;

export class ContentsEditor {
  /** @type {Promise<unknown>} */
  #last = Promise.resolve();
  #gesture = 0;
  #asked = -1;
  #fetches = 0;

  /** @param {Store} store @param {ServerLink} link */
  constructor(store, link) {
    this.store = store;
    this.link = link;
    store.select((state) => `${state.document?.revision} ${state.welcome?.role} ${state.page}`).subscribe(() => void this.#fetch());
  }

  /** What the files hold, where that is known now. @returns {Model | null} */
  get model() {
    const { model, document: own } = this.store.state.value;
    return model !== null && model.revision === own?.revision ? model : null;
  }

  /** Fetch what the files hold, while it can be seen. */
  async #fetch(isAnywhere = false) {
    const { document: own, welcome, page, model } = this.store.state.value;
    const revision = own?.revision ?? -1;
    if (page !== "timeline" && !isAnywhere || own === null || welcome === null || welcome.role === "view") return;
    if (this.#asked === revision && model?.revision === revision) return;
    this.#asked = revision;
    this.#fetches += 1;
    const own_fetch = this.#fetches;
    try {
      const [model, folder] = await Promise.all([`/model/${revision}.json`, "/folder.json"].map(async (path) => {
        const response = await fetch(path);
        return response.ok ? response.json() : null;
      }));
      // One that was asked for before may come later.
      if (own_fetch !== this.#fetches) return;
      this.store.dispatch({ type: "set", fields: { ...(folder === null ? {} : { folder }), ...(model === null ? {} : { model }) } });
    } catch {
      this.#asked = -1; // The link says what is wrong.
    }
  }

  /**
   * Make changes of the newest text, as one step of undo; resolves to whether they were made.
   * @param {(model: Model) => Change[]} make
   * @param {string} [gesture] changes with the same one, one after the other, are one step
   * @returns {Promise<boolean>}
   */
  change(make, gesture) {
    this.#gesture += 1;
    gesture ??= `contents-${Date.now()}-${this.#gesture}`;
    const name = gesture;
    const done = this.#last.then(() => this.#all(make, name));
    this.#last = done;
    return done;
  }

  /** @param {(model: Model) => Change[]} make @param {string} gesture */
  async #all(make, gesture) {
    for (let tries = TRIES_MAX; ; tries -= 1) {
      let revision = -1, made = 0;
      try {
        for (const { op, fields } of make(await this.#newest())) {
          revision = this.store.state.value.document?.revision ?? 0;
          await this.link.send(op, { revision, gesture, ...fields });
          made += 1;
        }
        return true;
      } catch (error) {
        // An undo or another client came between: it is made once more, of what the file holds then.
        const isStale = made === 0 && revision >= 0 && revision !== this.store.state.value.document?.revision;
        if (isStale && tries > 1) continue;
        this.store.dispatch({ type: "refused", text: error instanceof Error ? error.message : String(error) });
        return false;
      }
    }
  }

  /** @returns {Promise<Model>} */
  #newest() {
    const now = this.model;
    if (now !== null) return Promise.resolve(now);
    void this.#fetch();
    return new Promise((resolve, reject) => {
      const end = setTimeout(() => {
        stop();
        reject(new Error("what the file holds is not known; look again"));
      }, WAIT_MS);
      const stop = this.store.state.subscribe(() => {
        const found = this.model;
        if (found === null) return;
        clearTimeout(end);
        queueMicrotask(() => stop());
        resolve(found);
      });
    });
  }

  /** Look again what lies in the folder, on whatever page. */
  async refresh() {
    this.#asked = -1;
    await this.#fetch(true);
  }

  /** Make a file that is not there yet; throws what the server refuses with. @param {string} file @param {string} text */
  async makeFile(file, text) {
    await this.link.send("file.new", { revision: this.store.state.value.document?.revision ?? 0, file, text });
    await this.refresh();
  }

  /** Add an event to the open file, and show the contents. @param {number} at_s @param {Record<string, unknown>} event */
  addEvent(at_s, event) {
    this.store.dispatch({ type: "set", fields: { side: "contents" } });
    const file = this.store.state.value.document?.file ?? "";
    return this.change((model) => [eventOf(model.files[file]?.value, file, { at_s: Number(at_s.toFixed(3)), ...event })]);
  }

  /** Give an event of the view another time, if it is one of the open file.
   * @param {{ at_s: number, kind: string, text: string }} event @param {number} at_s */
  moveEvent(event, at_s) {
    return this.change((model) => {
      const file = this.store.state.value.document?.file ?? "";
      const index = eventIndex(model.files[file]?.value, event);
      if (index < 0) throw new Error(`${event.text} stands in another file of the show, or at another speed; open that file to move it`);
      return [setOf(file, ["events", index, "at_s"], at_s)];
    });
  }

  /** Set one value of a file; null removes it. @param {string} file @param {Place} place @param {unknown} value */
  set(file, place, value) {
    return this.change(() => [setOf(file, place, value)]);
  }
}

/** @param {string} file @param {Place} place @param {unknown} value @returns {Change} */
export function setOf(file, place, value) {
  return { op: "value.set", fields: { file, place, value } };
}

/** Add an item at the end of a list, which is made if there is none.
 * @param {any} value of the file @param {string} file @param {string} list @param {unknown} item @returns {Change} */
export function addOf(value, file, list, item) {
  return { op: "item.insert", fields: { file, place: [list], index: value[list]?.length ?? 0, value: item } };
}

/** @param {string} file @param {string} list @param {number} index @returns {Change} */
export function removeOf(file, list, index) {
  return { op: "item.delete", fields: { file, place: [list], index } };
}

/** @param {string} file @param {string} list @param {number} index @param {number} to @returns {Change} */
export function moveOf(file, list, index, to) {
  return { op: "item.move", fields: { file, place: [list], index, to } };
}

/**
 * Insert an event where its time belongs, so that the list stays in order of time.
 * @param {any} value of the file @param {string} file @param {{ at_s: number }} event @returns {Change}
 */
export function eventOf(value, file, event) {
  const all = /** @type {{ at_s: number }[]} */ (value.events ?? []);
  const after = all.findIndex((one) => one.at_s > event.at_s);
  return { op: "item.insert", fields: { file, place: ["events"], index: after < 0 ? all.length : after, value: event } };
}

/**
 * What is muted in a show: tracks and layers with their places.
 * @param {any} value of the file @returns {{ name: string, place: Place, isMuted: boolean }[]}
 */
export function mutable(value) {
  return [
    ...Object.entries(value.tracks ?? {}).map(([name, own]) => ({ name, place: ["tracks", name], isMuted: own.mute === true })),
    ...(value.layers ?? []).map((/** @type {any} */ own, /** @type {number} */ index) => ({
      name: String(own.file), place: ["layers", index], isMuted: own.mute === true,
    })),
  ];
}

/**
 * Solo one of the same kind: the others are muted; once more, and none is.
 * @param {any} value of the file @param {string} file @param {Place} place @returns {Change[]}
 */
export function soloOf(value, file, place) {
  const all = mutable(value).filter((one) => one.place[0] === place[0]);
  const isOwn = (/** @type {{ place: Place }} */ one) => one.place[1] === place[1];
  const isSolo = isAlone(all, isOwn);
  return all.flatMap((one) => {
    const wanted = isSolo ? false : !isOwn(one);
    return one.isMuted === wanted ? [] : [setOf(file, [...one.place, "mute"], wanted ? true : null)];
  });
}

/** @param {ReturnType<typeof mutable>} all @param {(one: { place: Place }) => boolean} isOwn */
function isAlone(all, isOwn) {
  return all.length > 1 && all.every((one) => one.isMuted !== isOwn(one));
}

/** Whether one is the only one of its kind that is not muted. @param {any} value @param {Place} place */
export function isSoloed(value, place) {
  return isAlone(mutable(value).filter((one) => one.place[0] === place[0]), (one) => one.place[1] === place[1]);
}

/**
 * Return which item of `events` an event of the view is, or -1: one of another file has none.
 * @param {any} value of the file @param {{ at_s: number, kind: string }} event
 */
export function eventIndex(value, event) {
  const all = /** @type {Record<string, any>[]} */ (value?.events ?? []);
  return all.findIndex((one) => Math.abs(one["at_s"] - event.at_s) < 1e-6 && one[event.kind] !== undefined);
}
