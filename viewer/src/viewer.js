// The 3D viewer of `thorvaldc view --html` and `thorvaldc preview`: robots as links and joints, drawn by three.js.
//
// The data are those of thorvaldc/simulation/web_viewer.py: lengths in m, angles in rad, poses
// [x, y, z, qw, qx, qy, qz], z up.

import {
  AmbientLight, AxesHelper, Box3, BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, Group,
  FrontSide, Line, LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, PerspectiveCamera, Quaternion, Raycaster, Scene, Vector2,
  Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const SELECTED = new Color().setRGB(1, 0.62, 0.1, "srgb");
const GREY = new Color().setRGB(0.72, 0.74, 0.76, "srgb");
const GHOST = new Color().setRGB(0.2, 0.45, 0.9, "srgb");
const FRAME_SIZE = 0.12; // m
const TURNS = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }; // rad
const ZOOMS = { "+": 0.9, "=": 0.9, "-": 1 / 0.9 };
const FLAT = ["ground", "zone"]; // parts of the world that may be much larger than what stands on it
const REST = 400; // ms
const GRID = 60; // m, half the side
const TRAIL_STEP = 0.1; // m, between points of a way
const RANKS = ["free", "", "taken"]; // kinds of labels, the most important first
const SHIFTS = [0, -1, 1, -2, 2]; // places of a label beside its own, in lines

// Squares of 1 m around the origin, which fade with the distance. Short pieces: renderers without a GPU drop lines that pass the camera.
function squares(n, piece = 4) {
  const points = [], colors = [];
  for (let i = -n; i <= n; i++)
    for (let k = -n; k < n; k += piece)
      for (const [x, y] of [[i, k], [i, k + piece], [k, i], [k + piece, i]]) {
        points.push(x, y, 0);
        colors.push(1, 1, 1, Math.max(0, 1 - Math.hypot(x, y) / n));
      }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colors), 4));
  const material = new LineBasicMaterial({ color: 0x9aa2a8, vertexColors: true, transparent: true, opacity: 0.45 });
  return new LineSegments(geometry, material);
}

function place(object, [x, y, z, qw, qx, qy, qz]) {
  object.position.set(x, y, z);
  object.quaternion.set(qx, qy, qz, qw);
  return object;
}

const geometries = new WeakMap(); // of the shapes of the data

function geometryOf(shape) {
  if (geometries.has(shape)) return geometries.get(shape);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(bytes(shape.points)), 3));
  geometry.setIndex(new BufferAttribute(new Uint32Array(bytes(shape.faces)), 1));
  geometry.computeBoundingBox();
  geometry.computeBoundingSphere();
  geometry.userData.closed = shape.closed;
  geometries.set(shape, geometry);
  return geometry;
}

const spares = new Map(); // materials of the last scene, by kind: three.js prepares each new material for some 0.1 ms

function materialOf([r, g, b, a], geometry, ghost = false, vertexColors = false) {
  // The inside of a closed surface is never visible; an open surface has two visible sides.
  const side = geometry.userData.closed && a >= 1 && !ghost ? FrontSide : DoubleSide;
  const options = {
    flatShading: true, side, transparent: ghost || a < 1, opacity: ghost ? 0.25 : a, depthWrite: !ghost, vertexColors,
  };
  const kind = JSON.stringify(options), material = spares.get(kind)?.pop() || new MeshLambertMaterial(options);
  material.userData.kind = kind;
  material.userData.color = ghost ? GHOST : new Color().setRGB(r, g, b, "srgb");
  material.color.copy(material.userData.color);
  return material;
}

function bytes(text) {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0)).buffer;
}

// The surface of a height grid, with squares of 1 m.
function reliefOf({ size, rows, columns, heights }) {
  const z = new Float32Array(bytes(heights)), points = new Float32Array(3 * z.length), shades = new Float32Array(3 * z.length);
  const faces = new Uint32Array(6 * (rows - 1) * (columns - 1));
  for (let row = 0, n = 0, f = 0; row < rows; row++)
    for (let column = 0; column < columns; column++, n++) {
      const x = size[0] * (column / (columns - 1) - 0.5), y = size[1] * (row / (rows - 1) - 0.5);
      points.set([x, y, z[n]], 3 * n);
      shades.fill((Math.floor(x) + Math.floor(y)) % 2 ? 1 : 0.86, 3 * n, 3 * n + 3);
      if (row && column) {
        faces.set([n - columns - 1, n - columns, n, n - columns - 1, n, n - 1], f);
        f += 6;
      }
    }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  geometry.setAttribute("color", new BufferAttribute(shades, 3));
  geometry.setIndex(new BufferAttribute(faces, 1));
  return geometry;
}

// What surrounds the robots: fixed bodies, zones and terrain.
class WorldView {
  constructor(world, geometries) {
    this.group = new Group();
    this.meshes = world.bodies.map((body) => {
      const mesh = place(new Mesh(geometries[body.shape], materialOf(body.color, geometries[body.shape])), body.pose);
      mesh.userData = { kind: body.kind, name: body.name };
      return mesh;
    });
    for (const relief of world.reliefs) {
      const geometry = reliefOf(relief), material = materialOf(relief.color, geometry, false, true);
      const mesh = place(new Mesh(geometry, material), relief.pose);
      mesh.userData = { kind: relief.kind, name: "" };
      this.meshes.push(mesh);
    }
    this.group.add(...this.meshes);
  }
}

// One robot of the scene: a tree of groups, one for each link.
class RobotView {
  constructor(robot, design, geometries, number, ghost) {
    this.name = robot.name;
    this.design = design;
    this.positions = {}; // of the joints that were moved
    this.base = place(new Group(), robot.pose);
    this.links = { [design.links[0].name]: new Group() };
    this.base.add(this.links[design.links[0].name]);
    this.joints = {};
    for (const joint of design.joints) {
      const fixed = place(new Group(), joint.pose), moving = new Group();
      fixed.add(moving);
      this.links[joint.parent].add(fixed);
      this.links[joint.child] = moving;
      this.joints[joint.name] = { ...joint, group: moving, axis: new Vector3(...joint.axis) };
    }
    this.meshes = [];
    for (const link of design.links)
      for (const visual of link.visuals) {
        const mesh = place(new Mesh(geometries[visual.shape], materialOf(visual.color, geometries[visual.shape], ghost)), visual.pose);
        mesh.userData = { robot: number, part: link.module };
        if (this.links[link.name]) this.links[link.name].add(mesh);
        this.meshes.push(mesh);
      }
    this.frames = (design.frames || []).map((frame) => {
      const axes = new AxesHelper(frame.kind === "link" ? FRAME_SIZE / 2 : FRAME_SIZE);
      axes.userData = { name: frame.name, kind: frame.kind, note: frame.note || "" };
      axes.material.depthTest = false; // most frames are inside a body
      axes.renderOrder = 1;
      axes.visible = false;
      if (frame.pose) place(axes, frame.pose);
      if (this.links[frame.link]) this.links[frame.link].add(axes);
      return axes;
    });
  }

  setJoint(name, value) {
    this.positions[name] = value;
    this.move();
  }

  // The position (rad or m) of a joint: that of its servo at the start, until it is moved.
  position(name) {
    return this.positions[name] ?? this.joints[name]?.start ?? 0;
  }

  move() {
    for (const [name, joint] of Object.entries(this.joints)) {
      const value = joint.mimic
        ? joint.mimic.multiplier * this.position(joint.mimic.joint) + joint.mimic.offset
        : this.position(name);
      if (joint.type === "prismatic") joint.group.position.copy(joint.axis).multiplyScalar(value);
      else joint.group.quaternion.setFromAxisAngle(joint.axis, value);
    }
  }

  // The position (m) of a link in the scene.
  at(link) {
    this.base.updateWorldMatrix(true, true);
    const point = this.links[link].getWorldPosition(new Vector3());
    return (this.base.parent ? this.base.parent.worldToLocal(point) : point).toArray();
  }
}

// Returns whether OpenGL draws without a graphics card. Smooth edges then take several times as long.
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|basic render/i.test(name);
}

export class Viewer {
  // `onPick(robot number, module)` is called when a part is clicked; the module is null beside the robots.
  constructor(canvas, labels, onPick) {
    this.canvas = canvas;
    this.labels = labels;
    this.robots = [];
    this.ghosts = [];
    this.selected = null;
    this.isGrey = false;
    this.names = false;
    this.grid = squares(GRID);
    this.trail = new Line(new BufferGeometry(), new LineBasicMaterial({ color: SELECTED }));
    this.retired = []; // materials and geometries to dispose of
    this.shown = { sensor: false, link: false, port: false };
    this.surroundings = null;
    this.camera = new PerspectiveCamera(40, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.scene = new Scene();
    this.sun = new DirectionalLight(0xffffff, 2.2);
    this.scene.add(new AmbientLight(0xffffff, 1.1), this.sun);
    this.world = new Group();
    this.scene.add(this.world);
    try {
      this.isSoftware = isSoftware();
      this.renderer = new WebGLRenderer({ canvas, antialias: !this.isSoftware, alpha: true });
    } catch {
      this.renderer = null; // a browser without WebGL 2
    }
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.redraw());
    this.controls.zoomSpeed = 1.5;
    let down = null;
    canvas.addEventListener("pointerdown", (event) => { down = [event.clientX, event.clientY]; });
    canvas.addEventListener("pointerup", (event) => {
      if (down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 4 && event.button === 0) onPick(...this.pick(event));
      down = null;
    });
    canvas.addEventListener("keydown", (event) => this.turn(event));
    window.addEventListener("resize", () => this.redraw());
  }

  // Arrow keys turn the camera around its target, plus and minus change the distance.
  turn(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const [right, up] = TURNS[event.key] || [0, 0], scale = ZOOMS[event.key] || 1;
    if (!right && !up && scale === 1) return;
    event.preventDefault();
    const offset = this.camera.position.clone().sub(this.controls.target), length = offset.length() * scale;
    const rise = Math.min(Math.max(Math.asin(offset.z / offset.length()) + up, -1.5), 1.5);
    const angle = Math.atan2(offset.y, offset.x) + right;
    offset.set(Math.cos(rise) * Math.cos(angle), Math.cos(rise) * Math.sin(angle), Math.sin(rise)).multiplyScalar(length);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.redraw();
  }

  // Shows other robots. The camera stays where it is if the viewer showed robots before.
  setScene(data, ghost = null) {
    const isFirst = this.robots.length === 0;
    const positions = Object.fromEntries(this.robots.map((robot) => [robot.name, robot.positions]));
    for (const child of [...this.world.children]) this.world.remove(child);
    const old = new Set();
    for (const { meshes } of this.views())
      for (const { material, geometry } of meshes) {
        const { kind } = material.userData;
        if (spares.get(kind)?.push(material) === undefined) spares.set(kind, [material]);
        old.add(geometry);
      }
    for (const robot of this.robots) this.retired.push(...robot.frames);
    const views = (data, isGhost) => {
      const geometries = data.shapes.map(geometryOf);
      return data.robots.map((robot, number) => new RobotView(robot, data.designs[robot.design], geometries, number, isGhost));
    };
    this.robots = views(data, false);
    this.ghosts = ghost ? views(ghost, true) : [];
    for (const robot of this.robots) {
      const known = positions[robot.name] || {};
      for (const name of Object.keys(known)) if (robot.joints[name]) robot.positions[name] = known[name];
    }
    for (const robot of [...this.robots, ...this.ghosts]) { robot.move(); this.world.add(robot.base); }
    this.surroundings = data.world ? new WorldView(data.world, data.shapes.map(geometryOf)) : null;
    if (this.surroundings) this.world.add(this.surroundings.group);
    const [w, x, y, z] = data.world ? data.world.tilt : [1, 0, 0, 0];
    this.world.quaternion.set(x, y, z, w);
    for (const { meshes } of this.views()) for (const mesh of meshes) old.delete(mesh.geometry);
    this.retired.push(...old, ...[...spares.values()].flat());
    spares.clear();
    if (isFirst) this.look();
    this.addGrid();
    this.color();
    this.setShown(this.shown);
  }

  views() {
    return [...this.robots, ...this.ghosts, ...(this.surroundings ? [this.surroundings] : [])];
  }

  bounds() {
    const box = new Box3();
    this.world.updateWorldMatrix(true, true);
    for (const { meshes } of this.views())
      for (const mesh of meshes) if (!FLAT.includes(mesh.userData.kind)) box.expandByObject(mesh);
    return box.isEmpty() ? new Box3(new Vector3(-1, -1, 0), new Vector3(1, 1, 1)) : box;
  }

  // Turns the camera to all robots, from the front right; in a world from behind, as worlds are mostly ahead of the robots.
  look() {
    const box = this.bounds(), radius = box.getSize(new Vector3()).length() / 2;
    const target = box.getCenter(new Vector3()), turn = this.surroundings ? Math.PI + 0.5 : -0.7, rise = 0.4;
    const direction = new Vector3(Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise));
    this.camera.position.copy(target).addScaledVector(direction, (this.surroundings ? 2.2 : 2.9) * radius);
    this.controls.target.copy(target);
    this.controls.minDistance = 0.05;
    this.controls.maxDistance = 50 * radius + 10;
    this.controls.update();
    this.radius = radius;
  }

  addGrid() {
    // Rough ground has squares of its own.
    this.grid.visible = !this.surroundings || !this.surroundings.meshes.some((mesh) => mesh.userData.kind === "ground");
    this.world.add(this.grid);
    this.way = [];
  }

  setJoint(robot, name, value) {
    this.robots[robot].setJoint(name, value);
    this.redraw();
  }

  // Moves the base of a robot to a pose [x, y, z, qw, qx, qy, qz] of the scene.
  setBase(robot, pose) {
    place(this.robots[robot].base, pose);
    this.redraw();
  }

  // Moves the base of a robot, and the camera with it, and draws its way on the ground.
  follow(robot, pose) {
    const base = this.robots[robot].base, before = base.position.clone();
    place(base, pose);
    const way = base.position.clone().sub(before).applyQuaternion(this.world.quaternion);
    this.camera.position.add(way);
    this.controls.target.add(way);
    if (!this.way.length || base.position.distanceTo(this.way.at(-1)) > TRAIL_STEP) {
      this.way.push(base.position.clone());
      this.retired.push(this.trail.geometry);
      this.trail.geometry = new BufferGeometry().setFromPoints(this.way);
      this.world.add(this.trail);
    }
    this.redraw();
  }

  select(robot, part) {
    this.selected = part === null ? null : { robot, part };
    this.color();
  }

  setGrey(isGrey) {
    this.isGrey = isGrey;
    this.color();
  }

  setNames(names) {
    this.names = names;
    this.redraw();
  }

  // Shows the frames of sensors, links or mounting ports, `{sensor: true, link: false}`.
  setShown(shown) {
    this.shown = { ...this.shown, ...shown };
    for (const robot of this.robots) for (const axes of robot.frames) axes.visible = this.shown[axes.userData.kind];
    this.redraw();
  }

  color() {
    for (const robot of this.robots)
      for (const { material, userData } of robot.meshes) {
        const isSelected = this.selected && this.selected.robot === userData.robot && this.selected.part === userData.part;
        material.color.copy(isSelected ? SELECTED : this.isGrey ? GREY : material.userData.color);
      }
    for (const { material } of this.surroundings ? this.surroundings.meshes : [])
      material.color.copy(this.isGrey ? GREY : material.userData.color);
    this.redraw();
  }

  pick(event) {
    const box = this.canvas.getBoundingClientRect();
    const point = new Vector2(
      (2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    const ray = new Raycaster();
    ray.setFromCamera(point, this.camera);
    const [hit] = ray.intersectObjects(this.robots.flatMap((robot) => robot.meshes), false);
    return hit ? [hit.object.userData.robot, hit.object.userData.part] : [0, null];
  }

  redraw() {
    this.waiting = this.waiting || requestAnimationFrame(() => this.draw());
  }

  // Draws at once, instead of with the next frame. Without a graphics card, edges become smooth when nothing changes:
  // the picture is drawn again with twice as many pixels along each side.
  draw(detail = 1) {
    cancelAnimationFrame(this.waiting);
    clearTimeout(this.resting);
    this.waiting = 0;
    if (this.isSoftware && detail === 1) this.resting = setTimeout(() => this.draw(2), REST);
    const width = Math.max(this.canvas.clientWidth, 1), height = Math.max(this.canvas.clientHeight, 1);
    const ratio = width / height;
    this.camera.aspect = ratio;
    this.camera.fov = (2 * 180 * Math.atan(Math.tan(0.35) * Math.max(1, 1 / ratio))) / Math.PI;
    this.camera.near = this.camera.position.distanceTo(this.controls.target) / 100;
    this.camera.far = this.camera.near * 2000 + 200;
    this.camera.updateProjectionMatrix();
    this.sun.position.copy(this.camera.position).add(new Vector3(0.3, 0.2, 1.5).multiplyScalar(this.radius || 1));
    this.sun.target.position.copy(this.controls.target);
    this.sun.target.updateMatrixWorld();
    // The ground has no end: its squares are those around the target.
    const { x, y } = this.world.worldToLocal(this.controls.target.clone());
    this.grid.position.set(Math.round(x), Math.round(y), 0);
    let triangles = 0;
    if (this.renderer) {
      // Each of these calls makes a new buffer for the picture.
      const scale = detail * (window.devicePixelRatio || 1), size = this.renderer.getSize(new Vector2());
      if (this.renderer.getPixelRatio() !== scale) this.renderer.setPixelRatio(scale);
      if (size.x !== width || size.y !== height) this.renderer.setSize(width, height, false);
      this.renderer.render(this.scene, this.camera);
      triangles = this.robots.flatMap((robot) => robot.meshes).reduce((sum, mesh) => sum + mesh.geometry.index.count / 3, 0);
    }
    // After the draw: without a living material, three.js would compile the shaders again.
    for (const item of this.retired) item.dispose();
    this.retired = [];
    this.label(width, height);
    document.documentElement.dataset.triangles = triangles;
    if (this.onDraw) this.onDraw();
  }

  label(width, height) {
    const labels = [], seen = new Set();
    const add = (text, object, point, kind, robot) => {
      const at = point.applyMatrix4(object.matrixWorld).project(this.camera);
      if (!text || seen.has(`${robot} ${text}`) || Math.max(Math.abs(at.x), Math.abs(at.y), at.z) > 1) return;
      seen.add(`${robot} ${text}`);
      const span = document.createElement("span");
      span.textContent = text;
      span.className = kind;
      labels.push({ span, rank: RANKS.indexOf(kind), depth: at.z, x: ((1 + at.x) * width) / 2, y: ((1 - at.y) * height) / 2 });
    };
    this.world.updateWorldMatrix(true, true);
    for (const robot of this.robots) {
      if (this.names)
        for (const mesh of robot.meshes)
          add(this.robots.length > 1 ? robot.name : mesh.userData.part, mesh, mesh.geometry.boundingBox.getCenter(new Vector3()), "", robot.name);
      for (const axes of robot.frames) if (axes.visible && axes.userData.kind !== "link") add(axes.userData.name, axes, new Vector3(), axes.userData.note, robot.name);
    }
    if (this.names && this.surroundings)
      for (const mesh of this.surroundings.meshes)
        if (["obstacle", "zone"].includes(mesh.userData.kind)) add(mesh.userData.name, mesh, new Vector3(), "", "");
    this.labels.replaceChildren(...labels.map(({ span }) => span));
    spread(labels, width);
  }
}

// Places labels beside each other, the important and near ones first. A label without room is not shown.
function spread(labels, width) {
  for (const label of labels) [label.w, label.h] = [label.span.offsetWidth, label.span.offsetHeight];
  const placed = [];
  for (const label of labels.sort((a, b) => a.rank - b.rank || a.depth - b.depth)) {
    const { span, w, h } = label, x = Math.max(Math.min(label.x, width - w / 2), w / 2);
    const isFree = (y) => placed.every((other) => 2 * Math.abs(other.x - x) >= other.w + w || 2 * Math.abs(other.y - y) >= other.h + h);
    const y = SHIFTS.map((lines) => label.y + lines * h).find(isFree);
    span.hidden = y === undefined;
    if (span.hidden) continue;
    span.style.left = `${x}px`;
    span.style.top = `${y}px`;
    placed.push({ x, y, w, h });
  }
}

// The rotation about z in rad of a pose.
export function yaw([, , , qw, qx, qy, qz]) {
  const forward = new Vector3(1, 0, 0).applyQuaternion(new Quaternion(qx, qy, qz, qw));
  return Math.atan2(forward.y, forward.x);
}
