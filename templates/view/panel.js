// The 3D scene and the tables beside it: parts, CAN nodes, ports, joints and the selected part of a robot.
"use strict";
const $ = (id) => document.getElementById(id);

function element(name, content, className) {
  const element = document.createElement(name);
  if (content !== undefined) element.append(content);
  if (className) element.className = className;
  return element;
}

function button(content, onClick) {
  const button = element("button", content);
  button.addEventListener("click", onClick);
  return button;
}

// A row of a table: texts or elements, and the numbers of the cells with numbers.
function tableRow(cells, numeric = [], name = "td") {
  const row = element("tr");
  row.append(...cells.map((cell, n) => element(name, cell, numeric.includes(n) ? "number" : "")));
  return row;
}

// Ids of other protocols than CANopen are a range of their own: the battery 1 and the controller 1 share no id.
const idOf = ({ id, id_space: space }) => (space ? (space === "canopen" ? "" : `${space} `) + id : "");

const kilograms = (mass) => `${mass.toFixed(mass < 10 ? 2 : 1)} kg`;

// The parts of a robot, by module: mass, links and addresses.
function partsOf(design) {
  const byModule = new Map();
  const part = (module) => {
    if (!byModule.has(module)) byModule.set(module, { mass: 0, links: [], ids: [] });
    return byModule.get(module);
  };
  for (const link of design.links) {
    part(link.module).mass += link.mass;
    part(link.module).links.push(link.name);
  }
  for (const node of design.nodes) part(node.module).ids.push(`${node.bus} ${idOf(node)}`);
  return byModule;
}

function partRows(design, select) {
  return [...partsOf(design)].filter(([, p]) => p.mass || p.ids.length).map(([name, part]) => {
    const row = tableRow([element("button", name || "base"), part.mass ? kilograms(part.mass) : "", part.ids.join(", ")], [1]);
    row.className = "part";
    row.dataset.part = name;
    row.addEventListener("click", () => select(name));
    return row;
  });
}

function nodeRows(design) {
  return design.nodes.map((node) => tableRow([node.bus, node.name, idOf(node), node.serial || ""], [2]));
}

function portRows(design) {
  return design.ports.map((port) => {
    const row = tableRow([port.name, port.kind, port.carries.join(", ") || "free"]);
    row.className = port.carries.length ? "" : "free";
    return row;
  });
}

function slider(robot, joint, moveJoint) {
  const box = element("label", undefined, "joint"), value = element("span", "", "number"), input = element("input");
  Object.assign(input, { type: "range", min: joint.lower, max: joint.upper, step: (joint.upper - joint.lower) / 1000 || "any" });
  input.dataset.joint = joint.name;
  box.update = () => {
    const position = robot.position(joint.name);
    const q = joint.type === "continuous" ? Math.atan2(Math.sin(position), Math.cos(position)) : position;
    input.value = q;
    const shown = joint.type === "prismatic" ? 1000 * q : (180 / Math.PI) * q;
    value.textContent = `${shown.toFixed(1).replace(/^-(0\.0)$/, "$1")}${joint.type === "prismatic" ? " mm" : "°"}`;
  };
  input.addEventListener("input", () => {
    moveJoint(joint.name, Number(input.value));
    box.update();
  });
  box.update();
  box.append(element("span", joint.name), value, input);
  return box;
}

// A slider for each joint that moves by itself; `update` shows the position of its joint.
function sliders(robot, moveJoint) {
  return robot.design.joints.filter((j) => j.type !== "fixed" && !j.mimic).map((joint) => slider(robot, joint, moveJoint));
}

function setZero(robot) {
  for (const joint of robot.design.joints) robot.positions[joint.name] = 0;
  robot.move();
}

function selectionLines(robot, name, part) {
  const lines = [element("b", name || "base")], { design } = robot;
  const addLine = (text) => lines.push(element("div", text));
  if (part.mass) addLine(`mass ${kilograms(part.mass)}`);
  for (const node of design.nodes)
    if (node.module === name) addLine(`CAN ${node.bus}: ${node.name}, id ${idOf(node)}${node.serial ? `, serial ${node.serial}` : ""}`);
  for (const link of part.links) {
    const at = robot.at(link).map((v) => v.toFixed(3).replace(/^-(0\.0+)$/, "$1"));
    addLine(`${link} at ${at.join(", ")} m`);
  }
  for (const joint of design.joints)
    if (joint.type !== "fixed" && part.links.includes(joint.child)) addLine(`moved by ${joint.name}`);
  return lines;
}

// -- the robots and the selection ------------------------------------------------------------------

let current = null, selected = null, jointSliders = [];
const viewer = new ThorvaldViewer.Viewer($("canvas"), $("labels"), (robot, part) => {
  if (!current) return;
  if (viewer.robots[robot] !== current) showRobot(viewer.robots[robot]);
  selectPart(part);
});
const number = () => viewer.robots.indexOf(current);
if (!viewer.renderer) {
  $("fault").textContent = "This browser does not support WebGL 2: there is no 3D picture, only the tables.";
  $("fault").hidden = false;
}

// Shows a scene.  Joint positions, selection and camera stay.
function showScene(scene) {
  const part = selected, name = current?.name;
  viewer.setScene(scene, scene.ghost);
  const { robots } = viewer;
  $("title").textContent = document.title = scene.name;
  $("robots").hidden = robots.length < 2;
  $("robot").replaceChildren(...robots.map((robot, n) => new Option(robot.name, n)));
  showRobot(robots.find((robot) => robot.name === name) ?? robots[0]);
  if (part !== null) selectPart(part);
}

function showRobot(robot) {
  current = robot;
  $("robot").value = number();
  $("facts").textContent = robot.design.facts;
  jointSliders = sliders(robot, (name, value) => { viewer.setJoint(number(), name, value); showSelection(); });
  $("joints").replaceChildren(...jointSliders);
  $("parts").replaceChildren(...partRows(robot.design, (name) => selectPart(selected === name ? null : name)));
  $("nodes")?.replaceChildren(...nodeRows(robot.design));
  $("port-rows")?.replaceChildren(...portRows(robot.design));
  selectPart(null);
}

function selectPart(part) {
  selected = part;
  for (const row of $("parts").children) row.classList.toggle("chosen", row.dataset.part === part);
  showSelection();
  viewer.select(number(), part);
}

function showSelection() {
  const part = selected === null ? undefined : partsOf(current.design).get(selected);
  $("chosen").hidden = !part;
  if (part) $("chosen").replaceChildren(...selectionLines(current, selected, part));
}

$("robot").addEventListener("change", () => showRobot(viewer.robots[$("robot").value]));
$("names").addEventListener("change", () => viewer.setNames($("names").checked));
$("zero").addEventListener("click", () => {
  if (!current) return;
  setZero(current);
  for (const item of jointSliders) item.update();
  showSelection();
  viewer.redraw();
});
