// @ts-check
/** A figure in 3D, by three.js. Loaded only where there is WebGL; `figure.js` falls back to 2D. */

import {
  BoxGeometry,
  CapsuleGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  Float32BufferAttribute,
  BufferGeometry,
  GridHelper,
  Group,
  HemisphereLight,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  PerspectiveCamera,
  Quaternion,
  Scene,
  SphereGeometry,
  STLLoader,
  Vector3,
  WebGLRenderer,
} from "../vendor/three.js";
import {
  BOX_EDGES, STRIDE, boxCorners, cloudOf, groundOf, isThick, linksApart, placeLinks, pointOn,
} from "./kinematics.js";
import { axesOf, distanceFor, extentsOf, middleOf } from "./camera.js";
import { Orbit } from "./orbit.js";
import { coloursOf } from "./stick.js";

/** @typedef {import("./kinematics.js").Figure} Figure */
/** @typedef {import("./kinematics.js").Link} Link */
/** @typedef {import("./kinematics.js").Shape} Shape */
/** @typedef {import("./kinematics.js").Cloud} Cloud */
/** @typedef {import("./stick.js").Poses} Poses */
/** @typedef {import("./stick.js").Palette} Palette */

const FIELD_OF_VIEW_DEG = 32;
/** How many times the size of the figure the picture has. */
const MARGIN_RATIO = 1.1;
const GHOST_OPACITY = 0.45;
const GROUND_LINES = 10;
const UP = new Vector3(0, 0, 1);

/** A figure in 3D on a canvas. */
export class SceneFigure {
  kind = /** @type {const} */ ("webgl");
  /** @type {Cloud | null} */
  #cloud = null;
  /** @type {import("./kinematics.js").Pose[]} */
  #poses = [];

  /**
   * Throws where there is no WebGL.
   * @param {HTMLCanvasElement} canvas @param {Figure} figure @param {() => void} changed
   * @param {(path: string) => string} meshUrl
   */
  constructor(canvas, figure, changed, meshUrl) {
    this.canvas = canvas;
    this.figure = figure;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, figure.reach_mm / 50, 60 * figure.reach_mm);
    this.camera.up.copy(UP);
    this.orbit = new Orbit(canvas, changed);
    this.materials = {
      solid: new MeshLambertMaterial(),
      edge: new MeshLambertMaterial(),
      ghost: new MeshLambertMaterial({
        transparent: true,
        opacity: GHOST_OPACITY,
        depthWrite: false,
        // Behind the solid figure, where both are in one place.
        polygonOffset: true,
        polygonOffsetFactor: 2,
        polygonOffsetUnits: 2,
      }),
      dark: new MeshLambertMaterial(),
      light: new MeshLambertMaterial(),
      line: new LineBasicMaterial({ depthTest: false }),
      ground: new LineBasicMaterial({ transparent: true, opacity: 0.6 }),
    };
    const { solid, edge, ghost, dark, light, line, ground } = this.materials;
    this.parts = {
      solid: figure.links.map((link) => solidLink(link, { own: solid, edge, dark, light })),
      authored: figure.links.map((link) => solidLink(link, { own: ghost, edge: ghost, dark: ghost, light: ghost })),
      line: figure.links.map((link) => lineLink(link, line)),
    };
    this.robot = new Group();
    for (const groups of Object.values(this.parts)) this.robot.add(...groups);
    this.grid = new GridHelper(2 * figure.reach_mm, GROUND_LINES);
    this.grid.material = ground;
    this.grid.rotation.x = Math.PI / 2;
    this.sun = new DirectionalLight(0xffffff, 2.2);
    this.scene.add(this.robot, this.grid, new HemisphereLight(0xffffff, 0x777788, 1.6), this.sun);
    loadMeshes(this, meshUrl, () => {
      this.frame(this.#poses);
      changed();
    });
  }

  /** Keep these poses in the picture. @param {import("./kinematics.js").Pose[]} poses */
  frame(poses) {
    this.#poses = poses;
    this.#cloud = cloudOf(this.figure, poses, null);
    // Meshes may be larger than the lines, from which `reach_mm` is.
    const reach_mm = Math.max(this.figure.reach_mm, ...this.#cloud.low.map(Math.abs), ...this.#cloud.high);
    this.camera.near = reach_mm / 50;
    this.camera.far = 60 * reach_mm;
    this.grid.scale.setScalar(reach_mm / this.figure.reach_mm);
  }

  /** @param {Poses} poses @param {Palette} palette @param {import("./camera.js").Size} size @param {number} ratio device pixels per CSS pixel */
  draw(poses, palette, size, ratio) {
    const { edge, ground, dark, light, authored } = palette;
    const colours = { ...coloursOf(poses, palette), edge, ground, dark, light, ghost: authored };
    for (const [role, colour] of Object.entries(colours)) {
      this.materials[/** @type {keyof typeof colours} */ (role)].color = new Color(colour);
    }
    const placed = placeLinks(this.figure, poses.solid);
    this.robot.position.z = -groundOf(this.figure, placed);
    apply(this.parts.solid, placed);
    for (const role of /** @type {const} */ (["authored", "line"])) {
      const pose = poses[role];
      const isShown = role === "line" && pose !== null ? linksApart(this.figure, poses.solid, pose) : [];
      this.parts[role].forEach((group, index) => { group.visible = pose !== null && (isShown[index] ?? true); });
      if (pose !== null) apply(this.parts[role], placeLinks(this.figure, pose));
    }
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(size.width_px, size.height_px, false);
    this.camera.aspect = size.width_px / Math.max(1, size.height_px);
    this.#cloud = cloudOf(this.figure, [poses.solid, poses.authored], this.#cloud, true);
    this.#aim(this.#cloud);
    this.camera.updateProjectionMatrix();
    this.sun.position.copy(this.camera.position).addScaledVector(UP, this.figure.reach_mm);
    this.renderer.render(this.scene, this.camera);
  }

  dispose() {
    this.orbit.dispose();
    this.renderer.dispose();
    this.scene.traverse((/** @type {any} */ part) => part.geometry?.dispose());
    for (const material of Object.values(this.materials)) material.dispose();
  }

  /** Keep the whole figure in the picture. @param {Cloud} cloud */
  #aim(cloud) {
    const axes = axesOf(this.orbit.direction);
    const middle = middleOf(extentsOf(cloud, axes), axes);
    const slope = Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360) / MARGIN_RATIO;
    const away_mm = distanceFor(cloud, axes, middle, slope * this.camera.aspect, slope);
    const [x, y, z] = middle;
    const [dx, dy, dz] = axes.toward.map((part) => (part * away_mm) / this.orbit.zoom);
    this.camera.position.set(x + dx, y + dy, z + dz);
    this.camera.lookAt(x, y, z);
  }
}

/** @param {Group[]} groups @param {Float64Array} placed */
function apply(groups, placed) {
  groups.forEach((group, index) => {
    const at = index * STRIDE;
    const [a, b, c, x, d, e, f, y, g, h, i, z] = placed.subarray(at, at + STRIDE);
    group.matrix.set(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1);
    group.matrixWorldNeedsUpdate = true;
  });
}

/** @typedef {Record<"own" | "edge" | "dark" | "light", MeshLambertMaterial>} Materials */

/** @param {Link} link @param {Materials} materials */
function solidLink(link, materials) {
  const material = materials[link.shade ?? "own"];
  const group = new Group();
  group.name = link.name;
  group.matrixAutoUpdate = false;
  const radius_mm = link.width_mm / 2;
  for (const line of link.lines_mm) {
    for (let i = 1; i < line.length; i += 1) group.add(bar(line[i - 1], line[i], radius_mm, material));
  }
  for (const shape of link.shapes) {
    const solid = solidShape(shape, materials[shape.shade ?? "own"]);
    if (solid !== null) group.add(solid);
  }
  const line = link.lines_mm[0];
  const isBare = line !== undefined && link.shapes.length === 0;
  if (link.joint !== null && isBare && !isThick(link.width_mm, line[0], line[1])) {
    group.add(new Mesh(new SphereGeometry(1.15 * radius_mm, 16, 12), materials.edge));
  }
  return group;
}

/** @param {Link} link @param {LineBasicMaterial} material */
function lineLink(link, material) {
  const group = new Group();
  group.matrixAutoUpdate = false;
  const lines = [...link.lines_mm, ...link.shapes.flatMap(outlineOf)];
  const points = lines.flatMap((line) => line.slice(1).flatMap((point, i) => [...line[i], ...point]));
  if (points.length > 0) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new Float32BufferAttribute(points, 3));
    const lines = new LineSegments(geometry, material);
    lines.renderOrder = 1;
    group.add(lines);
  }
  return group;
}

/** Corners of a ring. */
const RING_POINTS = 25;

/** Return lines that show a shape as a wire in its link. @param {Shape} shape @returns {number[][][]} */
function outlineOf(shape) {
  const [a, b = a, c = b] = shape.size_mm;
  if (shape.kind === "capsule") return [[pointOn(shape, [0, 0, -b / 2]), pointOn(shape, [0, 0, b / 2])]];
  if (shape.kind === "box") {
    const corners = boxCorners(shape);
    return BOX_EDGES.map(([from, to]) => [corners[from], corners[to]]);
  }
  return shape.kind === "ellipsoid" ? ringsOf(shape, [a, b, c]) : [];
}

/** Return a ring round an ellipsoid in each of its three planes. @param {Shape} shape @param {number[]} half_mm */
function ringsOf(shape, half_mm) {
  return [[0, 1], [1, 2], [2, 0]].map(([across, up]) => Array.from({ length: RING_POINTS }, (_, i) => {
    const turn = (2 * Math.PI * i) / (RING_POINTS - 1);
    const point = [0, 0, 0];
    point[across] = half_mm[across] * Math.cos(turn);
    point[up] = half_mm[up] * Math.sin(turn);
    return pointOn(shape, point);
  }));
}

/** @param {number[]} from @param {number[]} to @param {number} radius_mm @param {MeshLambertMaterial} material */
function bar(from, to, radius_mm, material) {
  const [start, end] = [new Vector3(...from), new Vector3(...to)];
  const along = end.clone().sub(start);
  const length_mm = along.length();
  const geometry = isThick(2 * radius_mm, from, to)
    ? new CylinderGeometry(radius_mm, radius_mm, length_mm, 32)
    : new CapsuleGeometry(radius_mm, length_mm, 6, 14);
  const mesh = new Mesh(geometry, material);
  mesh.position.copy(start).addScaledVector(along, 0.5);
  mesh.quaternion.copy(
    new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), along.normalize()),
  );
  return mesh;
}

/** Return a solid, of which those of three.js stand along y and ours along z; null for a mesh, which is loaded. @param {Shape} shape @param {MeshLambertMaterial} material */
function solidShape(shape, material) {
  const [a, b, c] = shape.size_mm;
  const group = framed(shape);
  if (shape.kind === "box") group.add(new Mesh(new BoxGeometry(a, b, c), material));
  if (shape.kind === "sphere") group.add(new Mesh(new SphereGeometry(a, 24, 16), material));
  if (shape.kind === "ellipsoid") {
    const ball = new Mesh(new SphereGeometry(1, 32, 24), material);
    ball.scale.set(a, b, c);
    group.add(ball);
  }
  if (shape.kind === "capsule") {
    const capsule = new Mesh(new CapsuleGeometry(a, b, 6, 14), material);
    capsule.rotation.x = Math.PI / 2;
    group.add(capsule);
  }
  if (shape.kind === "cylinder") {
    const cylinder = new Mesh(new CylinderGeometry(a, a, b, 24), material);
    cylinder.rotation.x = Math.PI / 2;
    group.add(cylinder);
  }
  return shape.kind === "mesh" ? null : group;
}

/** @param {Shape} shape */
function framed(shape) {
  const group = new Group();
  const [a, b, c, d, e, f, g, h, i] = shape.rotation;
  const [x, y, z] = shape.origin_mm;
  group.applyMatrix4(new Matrix4().set(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1));
  return group;
}

/** Return the corners of a mesh in its link. @param {any} geometry @param {Shape} shape */
function cornersOf(geometry, shape) {
  geometry.computeBoundingBox();
  const { min, max } = geometry.boundingBox;
  const frame = framed(shape);
  frame.scale.set(shape.size_mm[0], shape.size_mm[1], shape.size_mm[2]);
  frame.updateMatrix();
  return [...Array(8).keys()].map((corner) =>
    new Vector3(
      corner & 1 ? max.x : min.x,
      corner & 2 ? max.y : min.y,
      corner & 4 ? max.z : min.z,
    ).applyMatrix4(frame.matrix).toArray(),
  );
}

/**
 * Load the meshes of a URDF file and add them as they come; one that cannot be read is left out.
 * @param {SceneFigure} scene @param {(path: string) => string} meshUrl @param {() => void} changed
 */
async function loadMeshes(scene, meshUrl, changed) {
  const wanted = scene.figure.links.flatMap((link, index) =>
    link.shapes.filter((shape) => shape.kind === "mesh").map((shape) => ({ index, shape })),
  );
  if (wanted.length === 0) return;
  await Promise.all(
    wanted.map(async ({ index, shape }) => {
      const answer = await fetch(meshUrl(shape.path ?? ""));
      if (!answer.ok) return;
      const geometry = new STLLoader().parse(await answer.arrayBuffer());
      geometry.computeVertexNormals(); // Many programs write none into the file.
      shape.corners_mm = cornersOf(geometry, shape);
      const groups = [scene.parts.solid[index], scene.parts.authored[index]];
      for (const [i, material] of [scene.materials.solid, scene.materials.ghost].entries()) {
        const mesh = new Mesh(geometry, material);
        mesh.scale.set(shape.size_mm[0], shape.size_mm[1], shape.size_mm[2]);
        groups[i].add(framed(shape).add(mesh));
      }
    }),
  );
  changed();
}
