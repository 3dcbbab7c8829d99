// The web worker of the playground: Python (Pyodide) with the compiler, and MuJoCo at the first
// drive.  Messages of the page are JSON texts for `Playground.receive`, see playground.py.

// Files are compressed (gzip) by the build, because not every static server compresses.  Their names
// do not end with `.gz`, which some servers would announce as a compression of their own.
async function unpacked(name, type) {
  const response = await fetch(new URL(`${name}.packed`, self.location));
  if (!response.ok) throw new Error(`${name}.packed: ${response.status}`);
  return new Response(response.body.pipeThrough(new DecompressionStream("gzip")), { headers: { "Content-Type": type } });
}

const WASM = "application/wasm", SCRIPT = "text/javascript";
const SIZE = 0 /*SIZE*/, STEP = 200000; // bytes until the start, and between two messages about them
const plainFetch = self.fetch;
let loaded = 0;

// Tells the page how much is loaded.
async function counted(request) {
  const response = await request;
  const count = (chunk, controller) => {
    loaded += chunk.length;
    if (!playground && loaded % STEP < chunk.length) postMessage(JSON.stringify({ kind: "loading", loaded, size: SIZE }));
    controller.enqueue(chunk);
  };
  return new Response(response.body.pipeThrough(new TransformStream({ transform: count })), response);
}

self.fetch = (address, ...options) =>
  String(address.url ?? address).endsWith("pyodide.asm.wasm") ? unpacked("pyodide.asm.wasm", WASM) : counted(plainFetch(address, ...options));

const TICK = 10; // ms
// No packages are loaded: all are in python.zip.
const LOCK = null /*LOCK*/;
let python = null, playground = null, timer = null, simulator = null;

// The default export of a module.
async function imported(name) {
  const address = URL.createObjectURL(await (await unpacked(name, SCRIPT)).blob());
  return (await import(address)).default;
}

async function start() {
  const archive = fetch(new URL("python.zip", self.location)).then((response) => response.arrayBuffer());
  const asm = imported("pyodide.asm.mjs");
  const { loadPyodide } = await import("./pyodide.mjs");
  python = await loadPyodide({
    indexURL: new URL(".", self.location).href,
    createPyodideModule: await asm,
    lockFileContents: JSON.stringify({ info: LOCK, packages: {} }),
  });
  python.unpackArchive(await archive, "zip", { extractDir: "/app" });
  python.registerJsModule("page", { send: (text) => postMessage(text) });
  playground = python.runPython(`
import sys
sys.path.insert(0, "/app")
sys.dont_write_bytecode = True
import os, page
from pathlib import Path
from playground import Playground
os.mkdir("/robot")
os.chdir("/robot")
Playground(page.send, Path())
`);
  postMessage(JSON.stringify({ kind: "ready" }));
}

async function startSimulator() {
  const { default: load } = await import("./mujoco.js");
  const wasm = await (await unpacked("mujoco.wasm", WASM)).arrayBuffer();
  const mujoco = await load({ wasmBinary: wasm, print: () => {}, printErr: () => {} });
  mujoco.steps = (model, data, number) => { for (let i = 0; i < number; i++) mujoco.mj_step(model, data); };
  python.registerJsModule("mujoco_wasm", mujoco);
}

function drive() {
  if (!playground.advance()) {
    clearInterval(timer);
    timer = null;
  }
}

const started = start();
let order = started; // messages are answered one after the other

self.onmessage = ({ data }) => {
  order = order.then(async () => {
    const message = JSON.parse(data);
    if (message.kind === "drive" && message.on) {
      try {
        await (simulator ??= startSimulator());
      } catch (error) {
        simulator = null;
        const text = `the simulator cannot be loaded (${error.message}); is there a network?`;
        return postMessage(JSON.stringify({ kind: "drive", on: false, message: text }));
      }
    }
    playground.receive(data);
    if (message.kind === "drive" || timer !== null) timer ??= setInterval(drive, TICK);
  }).catch((error) => {
    console.error(error);
    const lines = String(error.message ?? error).trim().split("\n"); // the last one of a traceback says what is wrong
    postMessage(JSON.stringify({ kind: "broken", text: lines.at(-1) }));
  });
};
