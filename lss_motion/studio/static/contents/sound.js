// @ts-check
/** Sounds of a show: brought in, their beats to confirm, and joints that follow them with live parameters. */

import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { angleAt } from "../curves.js";
import { Choice } from "../parts/choice.js";
import { changedLines } from "../parts/text.js";
import { Pick } from "../parts/pick.js";
import { Section, Slider, Small } from "./fields.js";
import { setOf } from "./editor.js";

/** @typedef {import("./panel.js").Part} Part */
/** @typedef {import("../actions.js").Actions} Actions */
/** @typedef {{ text: string, keys: number, end_s: number, fade_s: number }} Voice */
/** @typedef {{ at_s: number[], bpm: number, off_beat_ratio: number }} Beats */

const FOLLOWS = /** @type {const} */ ([["syllables", "syllables"], ["energy", "loudness"], ["stereo", "side"]]);
/** The parameters of a mouth, as the options of `lss-motion import`: least, most, step, default.
 * @type {Record<string, [string, number, number, number, number, string]>} */
export const MOUTH = {
  threshold_db: ["threshold", -60, -6, 1, -30, "dB"],
  gain_db: ["gain", -20, 20, 1, 0, "dB"],
  attack_s: ["attack", 0.02, 0.4, 0.01, 0.05, "s"],
  release_s: ["release", 0.02, 0.6, 0.01, 0.1, "s"],
  opening_min: ["least opening", 0, 1, 0.05, 0.15, ""],
};

/** Ask the server, or throw what it refuses with. @param {string} path @param {RequestInit} request @returns {Promise<any>} */
export async function asked(path, request) {
  const response = await fetch(path, request);
  const answer = await response.json();
  if (!response.ok) throw new Error(answer.error);
  return answer;
}

/** @param {Record<string, unknown>} content @returns {RequestInit} */
function posted(content) {
  return { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(content) };
}

/** Bring dropped or chosen files into the folder of the show; each is a file of its own afterwards.
 * @param {Actions} actions @param {Iterable<File>} files */
export async function bring(actions, files) {
  for (const file of files) {
    try {
      const { file: name } = await asked(`/sound/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
      await actions.contents.refresh();
      actions.hint(`${name} lies in the folder of the show now. Say under Contents, Sounds what it is for.`);
      actions.set({ side: "contents" });
    } catch (error) {
      actions.store.dispatch({ type: "refused", text: error instanceof Error ? error.message : String(error) });
    }
  }
}

/** @param {Part} props */
export function Sounds({ state, actions, file, value }) {
  const { contents } = actions;
  const all = state.folder?.sounds ?? [];
  const bed = typeof value.sound === "string" ? value.sound : value.sound?.file;
  const [open, setOpen] = useState(/** @type {{ name: string, what: "beats" | "follow" } | null} */ (null));
  const isStill = !actions.isRunning && !["connecting", "live"].includes(state.robot_state?.state ?? "");
  /** @param {string} name @param {"beats" | "follow"} what */
  const fold = (name, what) => {
    setOpen(open?.name === name && open.what === what ? null : { name, what });
    if (what === "beats") actions.set({ proposed: null });
  };
  return html`<${Section} title="Sounds" count=${all.length}>
    <label class=${`bring ${isStill ? "" : "bring-off"}`}>Drop a sound on this page, or choose one
      <input type="file" accept=".wav,.flac,.ogg,.mp3" disabled=${!isStill} onChange=${(/** @type {globalThis.Event} */ event) => {
        const own = /** @type {HTMLInputElement} */ (event.currentTarget);
        void bring(actions, own.files ?? []).then(() => { own.value = ""; });
      }} /></label>
    <ul class="items">${all.map((name) => html`<li key=${name}>
      <div class="item-head"><span class="name">${name}</span></div>
      <div class="adds"><${Small} name=${`${name} is the sound of the show`} text="of the show" isOn=${name === bed}
          run=${() => contents.set(file, ["sound"], name === bed ? null : name)} />
        <${Small} name=${`${name} at the cursor`} text="at the cursor" run=${() => contents.addEvent(state.cursor_s, { sound: name })} />
        <${Small} name=${`Beats of ${name}`} text="beats" isOn=${open?.name === name && open.what === "beats"} run=${() => fold(name, "beats")} />
        <${Small} name=${`A joint follows ${name}`} text="a joint follows" isOn=${open?.name === name && open.what === "follow"} run=${() => fold(name, "follow")} /></div>
      ${name === bed ? html`<${Length} ...${{ state, actions, file, value }} />` : null}
      ${open?.name !== name ? null : open.what === "beats" ? html`<${BeatsOf} ...${{ state, actions, file, value, name }} />`
        : html`<${Follower} ...${{ state, actions, file, value, name }} />`}
    </li>`)}</ul>
    ${value.beats === undefined ? null : html`<div class="adds"><span>${timesOf(value.beats).length} beats: keys and Ctrl-drags find them</span>
      <${Small} name="Remove the beats" text="✕" run=${() => contents.set(file, ["beats"], null)} /></div>`}
  </${Section}>`;
}

/** @param {any} beats of a file @returns {number[]} */
export function timesOf(beats) {
  return Array.isArray(beats) ? beats : beats?.at_s ?? [];
}

/** A show that ends before its sound cuts it; that can be mended. @param {Part} props */
function Length({ state, actions, file, value }) {
  const { view } = state;
  const wave = view?.waveforms.find((one) => one.is_bed);
  const lasts_s = wave?.peaks === undefined ? 0 : wave.peaks.length / 2 / (wave.rate_hz ?? 1);
  if (view === null || view.duration_s === null || value.keyframes === undefined || lasts_s <= view.view_s + 0.05) return null;
  const joints = [...new Set(value.keyframes.flatMap((/** @type {any} */ key) => Object.keys(key.deg ?? {})))];
  const last = () => {
    const deg = Object.fromEntries(joints.map((joint) => {
      const curve = view.curves[String(joint)]?.plan;
      const planned = curve === undefined ? NaN : angleAt(curve, view.view_s);
      // A show of one instant has no curve.
      const keyed = value.keyframes.findLast((/** @type {any} */ key) => joint in (key.deg ?? {}))?.deg[String(joint)];
      return [joint, Number.isFinite(planned) ? Number(planned.toFixed(1)) : keyed];
    }));
    return actions.contents.change(() => [{ op: "key.add", fields: { keys: [{ file, place: ["keyframes"], at_s: Math.ceil(lasts_s * 10) / 10, deg }] } }]);
  };
  return html`<p class="warn-text">The show ends ${(lasts_s - view.view_s).toFixed(1)} s before its sound.
    ${joints.length === 0 ? null : html`<${Small} name="Last as long as the sound" run=${last} />`}</p>`;
}

// ------------------------------------------------------------------------- beats

/** @param {Part & { name: string }} props */
function BeatsOf({ actions, file, value, name }) {
  const [way, setWay] = useState({ is_shifted: false, every: 1 });
  const [found, setFound] = useState(/** @type {Beats | null} */ (null));
  const [problem, setProblem] = useState("");
  useEffect(() => {
    let isOver = false;
    asked("/beats", posted({ file: name, ...way })).then((beats) => {
      if (isOver) return;
      setFound(beats);
      actions.set({ proposed: beats.at_s });
    }, (error) => setProblem(error.message));
    return () => {
      isOver = true;
      actions.set({ proposed: null });
    };
  }, [name, way.is_shifted, way.every]);
  if (problem !== "") return html`<p class="bad-text">${problem}</p>`;
  if (found === null) return html`<p class="muted" role="status">Listening…</p>`;
  /** @param {boolean} isAnchored */
  const take = (isAnchored) => actions.contents.change(() => [setOf(file, ["beats"], isAnchored ? { at_s: found.at_s, anchor: true } : found.at_s)]);
  return html`<p>${found.bpm} a minute, ${found.at_s.length} beats: drawn over the sound. They are a proposal.
      ${found.off_beat_ratio > 0.4 ? html` <span class="warn-text">They may be half a beat off.</span>` : null}</p>
    <div class="adds"><${Small} name="Half a beat later" isOn=${way.is_shifted} run=${() => setWay({ ...way, is_shifted: !way.is_shifted })} />
      <${Choice} label="each beat, or only some" options=${[[1, "each"], [2, "every 2nd"], [4, "every 4th"]]} chosen=${way.every} choose=${(/** @type {number} */ every) => setWay({ ...way, every })} /></div>
    <div class="adds"><${Small} name=${value.beats === undefined ? "Take these beats" : "Take these in place of those before"} run=${() => take(false)} />
      <${Small} name="Take them as anchors" run=${() => take(true)} /></div>`;
}

// --------------------------------------------------------------- a joint that follows

/** Return the options that a file was made with, from its head. @param {string} text @returns {Record<string, string> | null} */
export function madeBy(text) {
  const words = /^# Made by: import .*$/m.exec(text)?.[0].split(/\s+/) ?? null;
  if (words === null) return null;
  const found = /** @type {Record<string, string>} */ ({});
  words.forEach((word, index) => {
    if (word.startsWith("--")) found[word.slice(2).replaceAll("-", "_")] = words[index + 1] ?? "";
  });
  return found;
}

/** The name of the file in which a joint follows a sound. @param {string} name of the sound @param {string} joint */
export function followName(name, joint) {
  return `${name.replace(/\.[^.]*$/, "").replace(/[^\p{L}\p{N}_-]+/gu, "_")}_${joint}.yaml`;
}

/** @param {Part & { name: string }} props */
function Follower({ state, actions, file, value, name }) {
  const joints = /** @type {any} */ (state.robot)?.joints ?? [];
  const named = joints.find((/** @type {any} */ one) => /jaw|mouth|kiefer|mund/i.test(one.name)) ?? joints[0];
  const [joint, setJoint] = useState(String(named?.name ?? ""));
  const own = joints.find((/** @type {any} */ one) => one.name === joint);
  const target = followName(name, joint);
  const index = (value.layers ?? []).findIndex((/** @type {any} */ one) => one.file === target);
  if (own === undefined) return html`<p class="muted">The robot has no joint yet.</p>`;
  return html`<div class="adds"><span class="muted">joint</span><${Pick} label="joint that follows" options=${joints.map((/** @type {any} */ one) => one.name)} chosen=${joint} choose=${setJoint} /></div>
    <${Following} key=${target} ...${{ state, actions, file, name, joint, target, range_deg: own.range_deg, isLayer: index >= 0 }} />`;
}

/** @param {{ state: import("../state.js").State, actions: Actions, file: string, name: string, joint: string, target: string, range_deg: [number, number], isLayer: boolean }} props */
function Following({ actions, file, name, joint, target, range_deg, isLayer }) {
  const [way, setWay] = useState(() => firstWay(range_deg));
  const [made, setMade] = useState(/** @type {Voice | null} */ (null));
  const [problem, setProblem] = useState("");
  const busy = useRef({ isBusy: false, next: /** @type {typeof way | null} */ (null), gesture: 0 });
  useEffect(() => {
    if (!isLayer) return;
    void textOf(target).then((text) => {
      const options = madeBy(text);
      if (options !== null) setWay(wayOf(options, range_deg));
    }, () => undefined);
  }, [target, isLayer]);
  /** Compute, and give the layer its new text: one at a time, the newest last. @param {typeof way} wanted */
  const follow = async (wanted) => {
    const own = busy.current;
    own.next = wanted;
    if (own.isBusy) return;
    own.isBusy = true;
    while (own.next !== null) {
      const next = own.next;
      own.next = null;
      try {
        const voice = await asked("/voice", posted({ file: name, joint, ...next }));
        setMade(voice);
        setProblem("");
        if (isLayer) await rewrite(actions, target, voice.text, `follow-${target}-${own.gesture}`);
      } catch (error) {
        setProblem(error instanceof Error ? error.message : String(error));
      }
    }
    own.isBusy = false;
  };
  /** @param {Partial<typeof way>} change @param {boolean} isLast of a slider that is dragged */
  const set = (change, isLast) => {
    const wanted = { ...way, ...change };
    setWay(wanted);
    void follow(wanted);
    if (isLast) busy.current.gesture += 1;
  };
  const add = async () => {
    try {
      const voice = /** @type {Voice} */ (await asked("/voice", posted({ file: name, joint, ...way })));
      setMade(voice);
      await actions.contents.makeFile(target, voice.text);
      const item = { file: target, joints: [joint], ...(way.follow === "syllables" ? {} : { mode: "add" }), ...(voice.fade_s > 0 ? { fade_s: voice.fade_s } : {}) };
      await actions.contents.change((model) => [{ op: "item.insert", fields: { file, place: ["layers"], index: model.files[file]?.value.layers?.length ?? 0, value: item } }]);
    } catch (error) {
      setProblem(error instanceof Error ? error.message : String(error));
    }
  };
  const ends = way.follow === "stereo" ? ["left", "right"] : ["closed", "open"];
  const [least, most] = range_deg;
  return html`<div class="choices"><${Choice} label="what it follows" options=${FOLLOWS} chosen=${way.follow} choose=${(/** @type {string} */ kind) => set({ follow: kind }, true)} /></div>
    <${Slider} name=${ends[0] ?? ""} unit="°" value=${way.near_deg} ...${{ least, most }} step=${0.5} show=${(/** @type {number} */ near_deg) => set({ near_deg }, false)} set=${(/** @type {number} */ near_deg) => set({ near_deg }, true)} />
    <${Slider} name=${ends[1] ?? ""} unit="°" value=${way.far_deg} ...${{ least, most }} step=${0.5} show=${(/** @type {number} */ far_deg) => set({ far_deg }, false)} set=${(/** @type {number} */ far_deg) => set({ far_deg }, true)} />
    ${way.follow !== "syllables" ? null : Object.entries(MOUTH).map(([key, [words, low, high, step, , unit]]) => html`<${Slider} key=${key} name=${words} unit=${unit} value=${way.mouth[key] ?? 0}
      least=${low} most=${high} step=${step} show=${(/** @type {number} */ to) => set({ mouth: { ...way.mouth, [key]: to } }, false)} set=${(/** @type {number} */ to) => set({ mouth: { ...way.mouth, [key]: to } }, true)} />`)}
    <p class="muted" role="status">${isLayer ? `${target} is a layer: it changes while you move a slider. Keys changed there by hand are made anew.` : `Makes ${target}, and lays it on top.`}
      ${made === null ? "" : ` ${made.keys} keys.`}</p>
    ${problem === "" ? null : html`<p class="bad-text" role="alert">${problem}</p>`}
    ${isLayer ? null : html`<div class="adds"><${Small} name=${`Let ${joint} follow`} run=${add} /></div>`}`;
}

/** @param {[number, number]} range_deg */
function firstWay([least, most]) {
  const near_deg = Math.min(Math.max(0, least), most);
  const far_deg = Math.abs(most - near_deg) >= Math.abs(near_deg - least) ? Math.min(most, near_deg + 20) : Math.max(least, near_deg - 20);
  const mouth = Object.fromEntries(Object.entries(MOUTH).map(([key, [, , , , own]]) => [key, own]));
  return { follow: "syllables", near_deg, far_deg, mouth: /** @type {Record<string, number>} */ (mouth) };
}

/** @param {Record<string, string>} options @param {[number, number]} range_deg */
function wayOf(options, range_deg) {
  const first = firstWay(range_deg);
  const mouth = Object.fromEntries(Object.entries(first.mouth).map(([key, own]) => [key, options[key] === undefined ? own : Number(options[key])]));
  return {
    follow: options["follow"] ?? "syllables", mouth, near_deg: Number(options["closed_deg"] ?? first.near_deg),
    far_deg: Number(options["open_deg"] ?? first.far_deg),
  };
}

/** @param {string} file */
async function textOf(file) {
  const response = await fetch(`/text/${file.split("/").map(encodeURIComponent).join("/")}`);
  if (!response.ok) throw new Error((await response.json()).error);
  return response.text();
}

/** Give a file another text: only the lines that differ. @param {Actions} actions @param {string} file @param {string} text @param {string} gesture */
async function rewrite(actions, file, text, gesture) {
  const change = changedLines(await textOf(file), text);
  if (change === null) return;
  const revision = actions.store.state.value.document?.revision ?? 0;
  await actions.link.send("text.set", { revision, file, gesture, ...change });
}
