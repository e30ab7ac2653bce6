// The state of the pages, and the messages of the server as far as the pages use them. Their source is
// `lss-motion schema remote`. For tsc only.
import type { Curve } from "./curves.js";

export type Span = { from_s: number; to_s: number; joint: string; text: string };
export type Key = {
  at_s: number; authored_s: number | null; hold_s: number; is_anchor: boolean; label: string;
  ease: string; line: number | null; deg: Record<string, number>;
  /** With which joints pass it by the author's word; of others the curve finds it. */
  slope_deg_s: Record<string, number>;
  /** Where its item stands in the file of its lane. */
  place: (string | number)[] | null;
};
/** A key of a lane, whole or only the angle of a joint. */
export type KeyRef = { lane: number; key: number; joint: string | null };
export type Lane = {
  name: string; kind: "track" | "layer" | "part"; file: string; is_added: boolean; joints: string[]; keys: Key[];
  times_s: Float64Array;
};
export type JointView = {
  name: string; id: number; bus: string; servo: string; range_deg: [number, number];
  speed_max_deg_s: number; accel_max_deg_s2: number; drive: string; temperature_max_c: number;
  voltage_min_v: number; following_deg: number;
};
export type JointCurves = { plan: Curve; predicted: Curve; authored: Curve | null };
export type JointKey = { at_s: number; deg: number; hold_s: number; is_anchor: boolean; lane: number; key: number; is_added: boolean };
export type LineView = {
  step_s: number; use_ratio: Float32Array; baud_bps: number; commands: number; mean_ratio: number;
  worst_100_ms_ratio: number; reading_rate_hz: number | null; reading_rate_min_hz: number;
};
export type Waveform = {
  text: string; from_s: number; to_s: number; is_bed: boolean; is_looped?: boolean;
  rate_hz?: number; peaks?: Int8Array; error?: string;
};
export type ShowEvent = { at_s: number; kind: string; text: string; line: number | null; lasts_s: number | null };
export type Mark = { label: string; at_s: number; is_anchor: boolean };
export type View = {
  plan: string; name: string; robot: string; duration_s: number | null; view_s: number;
  /** That of the document of which it is the plan. */
  revision: number;
  is_endless: boolean; repeat: null | { from_s: number; to_s: number; times: number | null };
  tolerance_deg: number; joints: JointView[]; lanes: Lane[];
  parts: { name: string; from_s: number; to_s: number }[];
  events: ShowEvent[]; beats: number[]; marks: Mark[]; curves: Record<string, JointCurves>;
  keys: Record<string, JointKey[]>;
  stretched: (Span & { by_s: number; limit: string })[];
  given_up: (Span & { at_s: number; deg: number })[];
  asked: { from_s: number; to_s: number; joint: string; deg: Float32Array }[];
  error: Record<string, { max_deg: number; at_s: number }>;
  line: Record<string, LineView>;
  waveforms: Waveform[];
};

export type JointHealth = {
  status: string | null; temperature_c: number | null; voltage_v: number | null;
  current_a: number | null; error_deg: number | null; correction_deg: number; allowed_deg: number;
};
export type Health = {
  phase: string; show_s: number | null; rate: number; is_paused: boolean; late_us: number;
  missed: number; joints: Record<string, JointHealth>;
  buses: Record<string, { use_ratio: number; replies_hz: number }>;
};
export type Telemetry = {
  plan: string; show_s: number; rate: number;
  planned_deg: Float32Array; predicted_deg: Float32Array; read_deg: Float32Array;
};
export type Trouble = { number: number; kind: "fault" | "warning" | "note"; joint?: string; at_s: number | null; text: string; done: string };
export type Document = {
  revision: number; file: string; kind: string; title: string; is_planning: boolean; planning_s: number;
  errors: { path: string; line: number | null; text: string }[]; notes: string[];
  plan: string | null; is_current: boolean; has_planner: boolean; summary: string[]; robot: number;
  editing: {
    undo: string | null; redo: string | null; unsaved: string[];
    conflicts: { file: string; difference: string[] }[]; recovered: string[];
  };
};
export type Player = { state: string; latch: "stop" | "estop" | null; plan: string | null; show_s: number | null; text: string };
export type StageCue = {
  name: string; on: string; when: string; plays: string; is_enabled: boolean; fired: number; refused: string;
};
export type StageTimecode = {
  state: string; source: string; at: string; rate: number | null; show: string | null; off_ms: number | null;
};
export type StageHost = {
  name: string; is_conductor: boolean; is_good: boolean; state: string; text: string; version: string;
  offset_ms: number | null; bound_ms: number | null; round_trip_ms: number | null; show_s: number | null;
  off_ms: number | null; hottest_c: number | null; late_ms: number | null; heard_s: number | null;
};
export type Stage = {
  state: string; show: string | null; cause: string; added: string[]; queue: string[];
  left: string[]; next_go: string | null; reasons: string[]; cues: StageCue[];
  timecode: StageTimecode | null;
  hosts: StageHost[];
};
export type StageNote = { number: number; kind: string; text: string };
/** The plan around an edit that is tried, `step_s` apart; outside of it all is as planned. */
export type TriedWindow = {
  from_s: number; to_s: number; later_s: number; is_joined: boolean;
  keys: { place: string; label: string; authored_s: number; planned_s: number; is_missed: boolean }[];
  slow: (Span & { by_s: number; limit: string })[]; step_s: number; deg: Record<string, Float32Array>;
};
export type Tried = { id: number; revision: number; problem: string | null; window: TriedWindow | null };
export type Page = "show" | "timeline" | "robot";
export type Selection =
  | { kind: "keys"; keys: KeyRef[] }
  | { kind: "span"; list: "stretched" | "given_up"; index: number }
  | { kind: "joint"; joint: string }
  | null;
export type Ghosts = { authored: boolean; plan: boolean; predicted: boolean; reading: boolean };
export type State = {
  link: { status: "connecting" | "open" | "lost" | "denied"; text: string };
  welcome: null | {
    client: number; role: "view" | "operate" | "edit"; stop_origin: string; version: string;
    file: string; title: string; is_network_readable: boolean;
  };
  clients: number;
  lease: { holder: number | null; holder_name: string | null; is_mine: boolean };
  document: Document | null;
  player: Player;
  robot_state: { state: string; port: string; is_simulated: boolean; joints: Record<string, { deg: number | null; is_limp: boolean }>; text: string } | null;
  robot: Record<string, unknown> | null;
  view: View | null;
  phase: string;
  started: null | { name: string; robot: string; is_simulated: boolean; duration_s: number | null; plan: string; joints: string[]; marks: Mark[] };
  ended: null | { outcome: string; error: string | null };
  rate: { ratio: number; is_paused: boolean };
  health: Health | null;
  trouble: Trouble[];
  stage: Stage | null;
  notes: StageNote[];
  last_mark: null | { label: string; at_s: number };
  waiting: string | null;
  scanned: any;
  maintenance: any;
  pairing: null | { code: string; role: string; valid_s: number; urls: string[] };
  /** What the files hold, and what lies beside them; null until it was asked for. */
  model: import("./contents/editor.js").Model | null;
  folder: Record<"sequences" | "gaits" | "stages" | "robots" | "sounds", string[]> | null;
  /** Whether the tour from nothing to a talking head is shown. */
  touring: boolean;
  /** Beats that are proposed, in seconds of their sound. */
  proposed: number[] | null;
  /** What is beside the timeline: what is chosen, or what the show consists of. */
  side: "chosen" | "contents";
  page: Page;
  theatre: boolean;
  theme: "dark" | "light";
  cursor_s: number;
  order: 0 | 1 | 2;
  follow: boolean;
  selection: Selection;
  /** What is chosen when the edits under way are planned. */
  wanted: import("./timeline/keys.js").Place[] | null;
  /** Edits that are not planned yet, and whether a key is being dragged. */
  drafts: number;
  is_dragging: boolean;
  ripple: boolean;
  /** Which motions are drawn over each other, each in a colour of its own. */
  ghosts: Ghosts;
  /** Edits that are checked are taken into the show that plays. */
  live: boolean;
  /** Angles that are tried at the cursor, while a slider is dragged. */
  posed: Record<string, number> | null;
  menu: null | { x_px: number; y_px: number; at_s: number; row: import("./timeline/layout.js").Row | null; deg: number | undefined };
  row: number;
  dialog: null | { kind: string; file?: string; line?: number | null; title?: string; text?: string; yes?: string; run?: () => void };
  refusal: null | { number: number; text: string; is_hint: boolean };
};
export type Action = { type: string; [key: string]: unknown };
