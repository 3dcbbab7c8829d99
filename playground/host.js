// The host of the page in the playground: a web worker with the compiler, see worker.js.  This
// script also runs the workbench beside the picture: editor, modules and generated files.

const LIMIT = 10000; // least limit (ms) of one compilation; a worker that needs longer is ended
const TIMES_LONGEST = 10; // the limit on a slow computer, in times of the longest compilation
const PAUSE = 300; // ms without a key until the facts are computed
const LONGEST_LINK = 30000; // characters
const TARGETS = ["urdf", "mjcf", "sdf", "ros2", "can", "computer", "datasheet"];

let worker = null, limit = null, describing = null, saving = null, requests = 0;
let isReady = false, isCompiling = false, isBehind = false; // the worker has other files than the page
let longest = 0, begun = 0; // ms: the longest compilation of this worker, and when the last one began
let isShown = false; // a robot was on the screen
let hasEnded = false; // the note on the screen is about a worker that ended
const changed = new Set(); // files with a text that is not compiled
let isOther = false; // the next model is another robot, not a changed one
let files = new Map(), main = "", file = "", good = null, last = [];
let origin = "", opened = ""; // name of the example and the files as they were opened
let identity = ""; // of the robot on the screen, for the history and the storage of the browser
const waiting = new Map(); // resolve functions of requests by their id

// -- the worker --------------------------------------------------------------------------------------

function post(message) {
  worker.postMessage(JSON.stringify(message));
}

// Sends a message of the page.  The facts wait until nobody types.
function send(message) {
  if (message.kind !== "drawn") return post(message);
  clearTimeout(describing);
  describing = setTimeout(() => { if (!isCompiling && isReady) post({ kind: "drawn" }); }, PAUSE);
}

// Sends a request and returns its answer, or null if the worker has not started or ended meanwhile.
async function ask(kind, fields) {
  if (!isReady) return null;
  const id = ++requests;
  return new Promise((resolve) => {
    waiting.set(id, resolve);
    post({ kind, id, ...fields });
  });
}

function startWorker() {
  status("starting the compiler…", false);
  isReady = isCompiling = false;
  longest = 0;
  worker = new Worker("worker.js", { type: "module" });
  worker.onmessage = ({ data }) => receive(JSON.parse(data), wallClock());
  worker.onerror = (event) => endWorker(`the compiler ended: ${event.message ?? "no reason given"}`);
}

function receive(message, received) {
  if (message.id !== undefined) {
    waiting.get(message.id)?.(message);
    waiting.delete(message.id);
  } else if (message.kind === "ready") {
    isReady = true;
    if (main) compileAll(good ?? { files, main });
  } else if (message.kind === "broken") endWorker(message.text);
  else {
    if (message.kind === "model") compiled(message);
    receivers[message.kind]?.(message, received);
    if (message.kind === "model") {
      if (isOther && message.good) showWhole();
      next();
    }
  }
}

receivers.loading = ({ loaded, size }) => {
  const megabytes = (bytes) => (bytes / 1e6).toFixed(1);
  status(`starting the compiler: ${megabytes(loaded)} of ${megabytes(size)} MB`, false);
  $("status").append(Object.assign(element("progress"), { max: size, value: loaded, ariaLabel: "Loaded" }));
};

// Shows the picture that the build of the page has made of an example, until the compiler has started.
async function showPicture(name, id) {
  try {
    const packed = await (await fetch(`examples/${name}.packed`)).arrayBuffer();
    const { model, details } = await through(new DecompressionStream("gzip"), packed).json();
    if (id !== identity || isReady) return;
    showModel(model);
    receivers.details(details);
    showWhole();
  } catch { /* the compiler shows the robot later */ }
}

// Turns the camera to another robot.
function showWhole() {
  isOther = false;
  viewer.look();
  viewer.addGrid();
  viewer.draw();
}

// Ends a worker whose state is unknown.  The page goes on with the last robot without errors.
function endWorker(reason) {
  clearTimeout(limit);
  worker.terminate();
  if (!isReady) {
    window.addEventListener("online", startWorker, { once: true });
    return status(`the compiler cannot be started: ${reason}`, true);
  }
  for (const resolve of waiting.values()) resolve(null);
  waiting.clear();
  drive.switched({ on: false, message: "" });
  const text = reason.length > 200 ? `${reason.slice(0, 200)}…` : reason;
  note(`${text}. This is the last robot without errors; change the file to try again.`);
  hasEnded = true;
  changed.clear();
  isBehind = good !== null;
  startWorker();
}

function compileAll({ files, main }) {
  changed.clear();
  post({ kind: "open", files: Object.fromEntries(files), main });
  expect();
}

function expect() {
  isCompiling = true;
  begun = wallClock();
  clearTimeout(limit);
  if (!longest) return; // the first compilation also loads modules; another robot ends it
  const most = Math.max(LIMIT, TIMES_LONGEST * longest);
  limit = setTimeout(() => endWorker(`the compilation took longer than ${Math.round(most / 1000)} s`), most);
}

function compiled(message) {
  clearTimeout(limit);
  isCompiling = false;
  longest = Math.max(longest, wallClock() - begun);
  if (hasEnded && !isBehind) note("");
  if (message.good && !isShown) {
    isShown = true; // the page itself comes first; then its files are kept for a time without a network
    setTimeout(() => navigator.serviceWorker?.register("sw.js"), 3000);
  }
  if (message.good && !changed.size && !isBehind) good = { files: new Map(files), main };
  last = message.diagnostics;
  if (!changed.size) mark();
}

// Compiles the text that was typed during the last compilation.
function next() {
  if (!isReady || isCompiling || !changed.size) return;
  if (isBehind) {
    isBehind = false;
    return compileAll({ files, main });
  }
  post({ kind: "edit", files: Object.fromEntries([...changed].map((name) => [name, files.get(name)])) });
  changed.clear();
  expect();
}

// -- files and the link of the page -------------------------------------------------------------------

const isText = (content) => typeof content === "string";

function edited(text) {
  files.set(file, text);
  changed.add(file);
  note("");
  keep(file);
  clearTimeout(describing);
  next();
  clearTimeout(saving);
  saving = setTimeout(saveLink, 1000);
}

const editor = ThorvaldEditor.create($("text"), {
  label: "Text of the file",
  onChange: edited,
  complete: (text, offset) => ask("complete", { file, text, offset }),
});

// -- robots that are kept ----------------------------------------------------------------------------
//
// What somebody typed or opened is in the storage of the browser at once, under the identity of the
// robot.  The history of the page has an entry for each robot that was opened, with its identity, so
// that "back" returns to the one before.  A robot is written by one page only: another page copies it.

const KEPT = "thorvaldc robot ", LOCK = "thorvaldc open ";
let release = () => {}; // the lock of the robot on the screen

// Keeps a file; the others of the robot are kept with the first one.
function keep(...names) {
  const robot = KEPT + identity;
  try {
    if (localStorage.getItem(robot) === null) names = [...files.keys()];
    for (const name of names) localStorage.setItem(`${robot} ${name}`, JSON.stringify(files.get(name)));
    localStorage.setItem(robot, JSON.stringify({ main, names: [...files.keys()], time: Date.now() }));
  } catch (error) {
    note(`This text is not kept (${error.name}): copy it, or remove robots from “my robots”.`);
  }
  $("example").value = "";
}

function keptRobot(id) {
  const robot = JSON.parse(localStorage.getItem(KEPT + id));
  if (!robot) return null;
  const content = robot.names.map((name) => [name, JSON.parse(localStorage.getItem(`${KEPT}${id} ${name}`))]);
  return { ...robot, id, files: Object.fromEntries(content) };
}

function keptIds() {
  try {
    return Object.keys(localStorage).filter((key) => /^thorvaldc robot \S+$/.test(key)).map((key) => key.slice(KEPT.length));
  } catch {
    return []; // a browser without storage
  }
}

// Takes the lock of a robot for this page, and returns whether no other page has it.
function hold(id) {
  if (!navigator.locks) return Promise.resolve(true);
  return new Promise((resolve) => navigator.locks.request(LOCK + id, { ifAvailable: true }, (lock) => {
    resolve(lock !== null);
    if (lock) return new Promise((free) => { release(); release = free; });
  }));
}

async function openKept(id, isNew) {
  if (id === identity) return;
  const isFree = await hold(id), robot = keptRobot(id); // as the page that had it open left it
  if (!robot) return note("This robot was removed in another page.");
  openFiles(robot.files, robot.main, "", isFree ? "" : "Another page has this robot open; this is a copy.", isFree ? id : newIdentity(), isNew);
  if (!isFree) keep();
}

$("mine").addEventListener("click", () => {
  const list = element("ul");
  for (const robot of keptIds().map(keptRobot).sort((a, b) => b.time - a.time)) {
    const name = /^name:\s*(\S+)/m.exec(robot.files[robot.main])?.[1] ?? robot.main;
    const title = `${name}, ${new Date(robot.time).toLocaleString()}`, item = element("li");
    const remove = button("remove", () => {
      if (!confirm(`Remove ${title}? It cannot be restored.`)) return;
      for (const file of robot.names) localStorage.removeItem(`${KEPT}${robot.id} ${file}`);
      localStorage.removeItem(KEPT + robot.id);
      item.remove();
    });
    remove.disabled = robot.id === identity;
    item.append(button(title, () => { $("dialog").close(); openKept(robot.id, true); }), " ", remove);
    list.append(item);
  }
  const text = list.children.length ? "Robots that were typed or opened here. They stay in this browser." : "No robot was typed or opened here yet.";
  showDialog("My robots", element("p", text), list);
});

const newIdentity = () => Date.now().toString(36) + Math.random().toString(36).slice(2, 8);

// Opens the files of a robot: texts, and bytes in base64 as a list of one text.  A new opening is an
// entry in the history of the page.
function openFiles(content, mainFile, name, message = "", id = newIdentity(), isNew = true) {
  if (id !== identity) clearTimeout(saving);
  identity = id;
  if (isNew) history.pushState({ id }, "", name ? `#example=${name}` : "#");
  else history.replaceState({ id }, "");
  hold(id);
  files = new Map(Object.entries(content));
  main = file = mainFile;
  origin = name;
  opened = JSON.stringify({ main, files: content });
  isBehind = false;
  isOther = true;
  good = null;
  $("example").value = name;
  $("built").replaceChildren();
  $("download").hidden = true;
  showTabs();
  openTab(main);
  note(message);
  if (isReady && isCompiling) endWorker("another robot was opened");
  else if (isReady) compileAll({ files, main });
  if (name && !isReady) return showPicture(name, id);
}

function showTabs() {
  const names = [...files.keys()];
  $("tabs").hidden = names.length < 2;
  $("tabs").replaceChildren(...names.map((name) => {
    const tab = button(name, () => openTab(name));
    tab.role = "tab";
    return tab;
  }));
}

function openTab(name) {
  file = name;
  const content = files.get(name);
  editor.open(isText(content) ? content : "(no text)", !isText(content), `${identity} ${name}`);
  for (const tab of $("tabs").children) tab.setAttribute("aria-selected", String(tab.textContent === name));
  mark();
}

// Paths of diagnostics are relative to the folder of the main file.
function pathOf(name) {
  const parts = main.split("/").slice(0, -1);
  for (const part of name.split("/")) {
    if (part === "..") parts.pop();
    else if (part !== ".") parts.push(part);
  }
  return parts.join("/");
}

function mark() {
  editor.mark(last.filter(({ span }) => span && pathOf(span.file) === file));
}

const through = (stream, bytes) => new Response(new Blob([bytes]).stream().pipeThrough(stream));

const base64 = (bytes) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
const bytesOf = (text) => Uint8Array.from(atob(text), (character) => character.charCodeAt(0));

// The fragment of a link: the name of an example, or the files as compressed JSON in base64.
async function fragment() {
  const text = JSON.stringify({ main, files: Object.fromEntries(files) });
  if (origin && text === opened) return `example=${origin}`;
  const packed = await through(new CompressionStream("deflate-raw"), text).arrayBuffer();
  return `robot=${base64(new Uint8Array(packed)).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "")}`;
}

async function saveLink() {
  const id = identity, text = await fragment();
  if (id === identity) history.replaceState({ id }, "", text.length <= LONGEST_LINK ? `#${text}` : "#");
}

async function openExample(name, ...options) {
  const { files: content, main: mainFile } = await (await fetch(`examples/${name}.json`)).json();
  return openFiles(content, mainFile, name, ...options);
}

// Opens the robot of the entry in the history: the kept one, else that of the address.
async function openLink() {
  const [key, value] = location.hash.slice(1).split(/=(.*)/s), id = history.state?.id;
  if (id && keptIds().includes(id)) return openKept(id, false);
  let message = "";
  try {
    if (key === "robot") {
      const packed = bytesOf(value.replaceAll("-", "+").replaceAll("_", "/"));
      const all = await through(new DecompressionStream("deflate-raw"), packed).json();
      if (!isText(all.files[all.main])) throw new Error("it has no robot file");
      return openFiles(all.files, all.main, "", "", id, false);
    }
  } catch (error) {
    message = `The link cannot be read (${error.message}); this is an example.`;
  }
  const known = [...$("example").options].map((option) => option.value).filter(Boolean);
  return openExample(key === "example" && known.includes(value) ? value : known[0], message, id, false);
}

$("share").addEventListener("click", async () => {
  const text = await fragment();
  if (text.length > LONGEST_LINK) return note("The files are too large for a link. They stay in this browser, see “my robots”.");
  history.replaceState(history.state, "", `#${text}`);
  try {
    await navigator.clipboard.writeText(location.href);
    note(`The link to this robot is copied: ${location.href.length} characters.`);
  } catch {
    note("The address of this page is now the link to this robot.");
  }
});

$("choose").addEventListener("click", () => $("chosen-files").click());
$("chosen-files").addEventListener("change", async () => {
  const content = {};
  for (const chosen of $("chosen-files").files) {
    const bytes = new Uint8Array(await chosen.arrayBuffer());
    try {
      content[chosen.name] = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
    } catch {
      content[chosen.name] = [base64(bytes)];
    }
  }
  $("chosen-files").value = "";
  const names = Object.keys(content).filter((name) => /\.ya?ml$/.test(name));
  const robot = names.find((name) => name === "robot.yaml") ?? names[0];
  if (robot) openFiles(content, robot, "");
  else if (files.size) {
    // Meshes and other files for the robot on the screen.
    const folder = main.split("/").slice(0, -1).map((part) => `${part}/`).join("");
    for (const [name, data] of Object.entries(content)) files.set(folder + name, data);
    openFiles(Object.fromEntries(files), main, "");
  }
  if (main) keep();
});
$("example").addEventListener("change", async () => {
  const name = $("example").value;
  if (!name) return;
  try {
    await openExample(name);
  } catch (error) {
    $("example").value = "";
    note(`${name} cannot be loaded (${error.message}). Is there a network?`);
  }
});
window.addEventListener("popstate", openLink);

function note(text) {
  hasEnded = false;
  $("note").textContent = text;
}

// -- dialogs -----------------------------------------------------------------------------------------

function showDialog(title, ...content) {
  $("dialog-title").textContent = title;
  $("dialog-content").replaceChildren(...content);
  if (!$("dialog").open) $("dialog").showModal();
}

// -- modules -----------------------------------------------------------------------------------------

function moduleItem(module) {
  const card = button(module.type, () => choosePlace(module)), picture = `modules/${module.type.replace("/", "_")}.png`;
  card.draggable = true;
  card.append(element("small", module.text));
  if (module.picture) card.prepend(Object.assign(element("img"), { src: picture, alt: "", loading: "lazy", draggable: false }));
  card.addEventListener("dragstart", (event) => {
    event.dataTransfer.setData("text/plain", module.type);
    dragged = { module, places: [] };
    viewer.setShown({ port: true });
    ask("places", { type: module.type, kinds: module.kinds }).then((answer) => { if (answer) dragged.places = answer.places; });
  });
  card.addEventListener("dragend", () => {
    viewer.setShown({ port: $("ports").checked });
    $("drop")?.remove();
  });
  return element("li", card);
}

async function choosePlace(module) {
  if (!module.kinds.length) return mount(module, "");
  const answer = await ask("places", { type: module.type, kinds: module.kinds });
  if (!answer) return;
  const list = element("ul");
  for (const place of answer.places) {
    list.append(element("li", button(place.text, () => { $("dialog").close(); mount(module, place.mount); })));
  }
  const fits = `${module.type} fits ports of the kind ${module.kinds.join(", ")}`;
  showDialog(`Mount ${module.type}`, element("p", answer.places.length ? `${fits}. Where?` : `${fits}, and no such port is free.`), list);
}

async function mount(module, place) {
  if (file !== main) openTab(main);
  const answer = await ask("mount", { text: files.get(main), type: module.type, mount: place });
  if (!answer) return;
  if (!answer.text) return note(answer.reason);
  setView("text");
  editor.insert(answer.text, answer.offset);
}

let dragged = null;

// The free port of the dragged module that is nearest to a place in the picture.
function nearestPort(event) {
  const box = $("canvas").getBoundingClientRect();
  let nearest = null;
  for (const robot of viewer.robots)
    for (const frame of robot.frames) {
      const place = dragged.places.find(({ mount }) => frame.userData.kind === "port" && mount === frame.userData.name);
      if (!place) continue;
      const point = frame.getWorldPosition(frame.position.clone()).project(viewer.camera);
      const x = ((1 + point.x) * box.width) / 2, y = ((1 - point.y) * box.height) / 2;
      const distance = Math.hypot(x - event.clientX + box.left, y - event.clientY + box.top);
      if (distance < 80 && distance < (nearest?.distance ?? Infinity)) nearest = { place, x, y, distance };
    }
  return nearest;
}

$("stage").addEventListener("dragover", (event) => {
  if (!dragged) return;
  event.preventDefault();
  $("drop")?.remove();
  const port = dragged.port = nearestPort(event), ring = element("div");
  if (!port) return;
  ring.id = "drop";
  ring.style.left = `${port.x}px`;
  ring.style.top = `${port.y}px`;
  $("stage").append(ring);
});
$("stage").addEventListener("drop", (event) => {
  if (!dragged) return;
  event.preventDefault();
  const { module, port } = dragged;
  dragged = null;
  $("drop")?.remove();
  if (port) mount(module, port.place.mount);
  else choosePlace(module);
});

$("filter").addEventListener("input", () => {
  const words = $("filter").value.toLowerCase().split(/\s+/);
  for (const item of $("modules").children) item.hidden = !words.every((word) => item.textContent.toLowerCase().includes(word));
});

// -- generated files ---------------------------------------------------------------------------------

for (const target of TARGETS) {
  const label = element("label", ` ${target}`), checked = target === "urdf" || target === "mjcf";
  label.prepend(Object.assign(element("input"), { type: "checkbox", value: target, checked }));
  $("targets").append(label);
}

const size = (bytes) => (bytes < 10000 ? `${bytes} bytes` : `${Math.round(bytes / 1000)} kB`);

$("build").addEventListener("click", async () => {
  const targets = [...$("targets").querySelectorAll("input:checked")].map((box) => box.value);
  $("built-note").textContent = "building…";
  const answer = await ask("build", { targets });
  const { files: built, warnings, error } = answer ?? { files: [], warnings: [], error: "build again when the compiler has started" };
  $("built-note").textContent = [error || (built.length ? "" : "there is no robot without errors"), ...warnings].filter(Boolean).join("; ");
  $("download").hidden = !built.length;
  $("built").replaceChildren(...built.map(({ path, bytes }) => element("li", button(`${path} (${size(bytes)})`, () => showBuilt(path)))));
});

function save(name, content) {
  const link = element("a");
  link.href = URL.createObjectURL(new Blob([content]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

async function showBuilt(path) {
  const answer = await ask("file", { path });
  if (!answer) return;
  const download = button("download", () => save(path.split("/").pop(), answer.text ?? bytesOf(answer.base64)));
  showDialog(path, download, Object.assign(element("pre", answer.text ?? "(no text)"), { tabIndex: 0 }));
}

$("download").addEventListener("click", async () => {
  const answer = await ask("archive", {});
  if (answer) save(`${$("title").textContent || "robot"}.zip`, bytesOf(answer.base64));
});

// -- views of a phone --------------------------------------------------------------------------------

function setView(view) {
  document.documentElement.classList.toggle("text-view", view === "text");
  for (const button of $("views").children) button.setAttribute("aria-pressed", String(button.dataset.view === view));
  // On a phone, one of both is the main part of the page.
  $("workbench").setAttribute("role", view === "text" && $("views").offsetParent ? "main" : "region");
  viewer.draw();
}
for (const button of $("views").children) button.addEventListener("click", () => setView(button.dataset.view));

// A click on a diagnostic shows its place in the text.
$("diagnostics").addEventListener("click", (event) => {
  const item = event.target.closest(".diagnostic"), diagnostic = last[[...$("diagnostics").children].indexOf(item)];
  if (!diagnostic?.span || !files.has(pathOf(diagnostic.span.file))) return;
  openTab(pathOf(diagnostic.span.file));
  setView("text");
  editor.show(diagnostic.span.start);
});

// The picture comes first, before the megabytes of the compiler.
async function begin() {
  $("wiring").parentElement.after($("outputs"));
  const { modules, examples: names } = await fetch("library.json").then((response) => response.json());
  $("modules").append(...modules.map(moduleItem));
  $("example").append(...names.map((name) => new Option(name)));
  try {
    await openLink();
  } finally {
    startWorker();
  }
}
begin();
