// Starts the language server `thorvaldc lsp`, and adds the commands `preview` and `build`.
"use strict";

const { spawn } = require("node:child_process");
const path = require("node:path");
const vscode = require("vscode");
const { CloseAction, ErrorAction, LanguageClient } = require("vscode-languageclient/node");
const { isOurs } = require("./documents");

const LANGUAGE = "thorvaldc";
const WATCHED = "**/*.{yaml,yml,xacro,urdf,stl,obj,dae,csv}";
const MAX_ERROR_TEXT = 4000;

/** @type {LanguageClient | undefined} */
let client;
/** @type {Promise<void> | undefined} */
let starting;
let errorText = "";
let isReported = false;

async function activate(context) {
  context.subscriptions.push(
    vscode.workspace.onDidOpenTextDocument(adopt),
    vscode.workspace.onDidChangeTextDocument((event) => adopt(event.document)),
    vscode.commands.registerCommand("thorvaldc.preview", () => run("preview")),
    vscode.commands.registerCommand("thorvaldc.build", () => run("build")),
    vscode.commands.registerCommand("thorvaldc.restart", restart),
    vscode.workspace.onDidChangeConfiguration((event) => {
      if (event.affectsConfiguration("thorvaldc.command")) {
        restart();
      }
    }),
  );
  vscode.workspace.textDocuments.forEach(adopt);
}

async function deactivate() {
  await stop();
}

/** Gives a YAML document of thorvaldc its language, and starts the server for the first one. */
function adopt(document) {
  if (document.languageId === LANGUAGE) {
    start();
    return;
  }
  if (document.languageId !== "yaml" || !["file", "untitled"].includes(document.uri.scheme)) {
    return;
  }
  const name = path.posix.basename(document.uri.path);
  if (isOurs(name, (line) => document.lineAt(line).text, document.lineCount)) {
    vscode.languages.setTextDocumentLanguage(document, LANGUAGE);
  }
}

/** Returns the path of the command: a relative path with a folder starts at the workspace. */
function commandPath() {
  const value = vscode.workspace.getConfiguration("thorvaldc").get("command") || "thorvaldc";
  const folder = vscode.workspace.workspaceFolders?.[0]?.uri.fsPath;
  const isRelative = /[\\/]/.test(value) && !path.isAbsolute(value);
  return isRelative && folder ? path.join(folder, value) : value;
}

function start() {
  starting ??= startClient();
  return starting;
}

async function startClient() {
  errorText = "";
  isReported = false;
  client = new LanguageClient(
    LANGUAGE,
    "thorvaldc",
    startServer,
    {
      documentSelector: [{ language: LANGUAGE }],
      synchronize: { fileEvents: vscode.workspace.createFileSystemWatcher(WATCHED) },
      initializationFailedHandler: () => false,
      errorHandler: {
        error: () => ({ action: ErrorAction.Continue, handled: true }),
        closed: () => {
          report();
          return { action: CloseAction.DoNotRestart, handled: true };
        },
      },
    },
  );
  try {
    await client.start();
  } catch {
    report();
  }
}

/** Starts the process of the server, and keeps the end of what it prints on standard error. */
function startServer() {
  const command = commandPath();
  return new Promise((resolve, reject) => {
    const server = spawn(command, ["lsp", "--stdio"], {
      cwd: vscode.workspace.workspaceFolders?.[0]?.uri.fsPath,
      shell: false,
    });
    server.stderr.on("data", (data) => {
      errorText = (errorText + data).slice(-MAX_ERROR_TEXT);
    });
    server.once("spawn", () => resolve(server));
    server.once("error", (error) => {
      errorText =
        error.code === "ENOENT"
          ? `the command \`${command}\` does not exist: pip install 'thorvaldc[lsp]', and set its path`
          : `the command \`${command}\` does not start: ${error.message}`;
      reject(error);
    });
  });
}

/** Shows once why the server has ended. */
async function report() {
  if (isReported) {
    return;
  }
  isReported = true;
  // The last line on standard error can arrive after the end of the connection.
  await new Promise((resolve) => setTimeout(resolve, 300));
  const line = errorText.trim().split("\n").pop() || "the language server has ended";
  const choice = await vscode.window.showErrorMessage(`thorvaldc: ${line}`, "Settings", "Restart");
  if (choice === "Settings") {
    vscode.commands.executeCommand("workbench.action.openSettings", "thorvaldc.command");
  } else if (choice === "Restart") {
    restart();
  }
}

async function stop() {
  const last = client;
  client = undefined;
  starting = undefined;
  isReported = true; // an end on request is no failure
  await last?.stop().catch(() => undefined);
}

async function restart() {
  await stop();
  await start();
}

/** Runs a command of thorvaldc for the document of the active editor, in the panel of tasks. */
async function run(name) {
  const document = vscode.window.activeTextEditor?.document;
  if (document === undefined || document.languageId !== LANGUAGE || document.isUntitled) {
    vscode.window.showErrorMessage("thorvaldc: open a robot file that is saved first");
    return;
  }
  await document.save();
  const folder = vscode.workspace.getWorkspaceFolder(document.uri);
  const task = new vscode.Task(
    { type: "process" },
    folder ?? vscode.TaskScope.Workspace,
    `${name} ${path.basename(document.fileName)}`,
    LANGUAGE,
    new vscode.ProcessExecution(commandPath(), [name, document.fileName], {
      cwd: path.dirname(document.fileName),
    }),
  );
  task.presentationOptions = { clear: true, reveal: vscode.TaskRevealKind.Always };
  await vscode.tasks.executeTask(task);
}

module.exports = { activate, deactivate };
