"""The extension for VS Code: it builds and is packaged, and it starts and ends the server."""

from __future__ import annotations

import json
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from tests.outside_tools import path_of
from tests.tools.language_server.conftest import ROOT

EXTENSION = ROOT / "editors" / "vscode"
HOST = """
// A host with the parts of VS Code that the extension needs before a server runs.
const Module = require("node:module");
const [extension, command, text] = process.argv.slice(2);
const disposable = { dispose() {} };
class Any { constructor() {} dispose() {} }
const document = {
  languageId: "yaml", uri: { scheme: "file", path: "/x/robot.yaml" }, lineCount: 1,
  lineAt: () => ({ text }),
};
const languages = [];
const api = {
  workspace: {
    onDidOpenTextDocument: () => disposable, onDidChangeTextDocument: () => disposable,
    onDidChangeConfiguration: () => disposable, textDocuments: [document],
    getConfiguration: () => ({ get: () => command }), createFileSystemWatcher: () => new Any(),
  },
  languages: {
    setTextDocumentLanguage: (document, language) => { languages.push(language); },
  },
  commands: { registerCommand: (name) => { console.log(`command ${name}`); return disposable; } },
  window: {
    showErrorMessage: async (message) => { console.log(`error ${message}`); },
    createOutputChannel: () => ({ append() {}, appendLine() {}, show() {}, dispose() {} }),
  },
};
const stub = (known) => new Proxy(known, {
  get: (target, name) => name in target ? target[name] : Any,
});
for (const part of ["workspace", "languages", "window"]) {
  api[part] = new Proxy(api[part], {
    get: (target, name) => name in target ? target[name] : () => disposable,
  });
}
const load = Module._load;
Module._load = (name, ...rest) => name === "vscode" ? stub(api) : load(name, ...rest);
const { activate } = require(extension);
activate({ subscriptions: [] }).then(() => console.log(`languages ${languages}`));
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with the extension, built and packaged as `t.vsix`.

    The tools of the extension run on the Node 18 of Debian 12; npm names one that does not.
    """
    npm = path_of("npm")
    folder = tmp_path_factory.mktemp("vscode") / "extension"
    shutil.copytree(EXTENSION, folder, ignore=shutil.ignore_patterns("node_modules", "dist"))
    install = ["ci", "--engine-strict", "--ignore-scripts", "--no-audit", "--no-fund"]
    for arguments in (install, ["run", "package", "--", "-o", "t.vsix"]):
        process = subprocess.run(
            [npm, *arguments], cwd=folder, capture_output=True, text=True, check=False, timeout=300
        )
        assert process.returncode == 0, process.stdout + process.stderr
    return folder


@pytest.mark.slow
def test_the_package_contains_the_extension_alone(package: Path) -> None:
    with zipfile.ZipFile(package / "t.vsix") as archive:
        names = {n for n in archive.namelist() if n.startswith("extension/")}
    assert names == {
        "extension/package.json",
        "extension/README.md",
        "extension/language-configuration.json",
        "extension/thorvaldc.tmLanguage.json",
        "extension/dist/extension.js",
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "languages"),
    [("thorvaldc: 1", "thorvaldc"), ("", "thorvaldc"), ("services: {}", ""), ("robot: x", "")],
)
def test_only_documents_of_thorvaldc_change_their_language(
    package: Path, text: str, languages: str
) -> None:
    (package / "host.js").write_text(HOST, encoding="utf-8")
    run = subprocess.run(
        [path_of("node"), "host.js", "./dist/extension.js", "missing", text],
        cwd=package,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert f"languages {languages}\n" in run.stdout
    assert "command thorvaldc.preview" in run.stdout
    assert "error" not in run.stdout


def test_commands_and_settings_have_titles() -> None:
    manifest = json.loads((EXTENSION / "package.json").read_text(encoding="utf-8"))
    contributes = manifest["contributes"]
    assert [command["command"] for command in contributes["commands"]] == [
        "thorvaldc.preview",
        "thorvaldc.build",
        "thorvaldc.restart",
    ]
    assert "thorvaldc.command" in contributes["configuration"]["properties"]
    assert "http" not in (EXTENSION / "src/extension.js").read_text(encoding="utf-8")
