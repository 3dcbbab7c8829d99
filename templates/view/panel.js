// The tables beside the 3D scene: parts, CAN nodes, joints and the selected part of a robot.
"use strict";

function element(name, content, className) {
  const element = document.createElement(name);
  if (content !== undefined) element.append(content);
  if (className) element.className = className;
  return element;
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
