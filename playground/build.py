"""Builds the playground as a static site: `make playground` calls it after `npm ci`.

    python playground/build.py build/site/playground

The page needs no special headers of its server and loads nothing from other hosts.  Large files are
compressed here, because not every static server does it.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import json
import re
import shutil
import subprocess
import tempfile
import zipfile
from importlib import metadata
from pathlib import Path

from thorvaldc.compiler.catalogue import describe_module, first_sentence
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span
from thorvaldc.tools.preview.compiled_robot import INPUT_SUFFIXES, robot_page

ROOT = Path(__file__).resolve().parents[1]
HERE = ROOT / "playground"
NODE = HERE / "node_modules"
FIRST_EXAMPLE = "4wd4ws_wide"
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline';"
    " connect-src 'self'; worker-src 'self'; img-src data:; base-uri 'none'; form-action 'none'"
)
"""The page loads nothing from other hosts."""
PACKAGES = (
    "attrs",
    "Jinja2",
    "jsonschema",
    "jsonschema-specifications",
    "MarkupSafe",
    "PyYAML",
    "referencing",
    "xacro",
)
"""Python packages of the compiler; those with compiled parts also work without them."""
UNUSED = re.compile(
    r"thorvaldc/(__main__|cli|ros|commissioning|can/(backends|socket)"
    r"|compiler/recordings"
    r"|simulation/(bus|vectorised|records)"
    r"|runtime/can_base"
    r"|tools/(?!__init__|preview/(__init__|compiled_robot|page_drive)"
    r"|language_server/(__init__|code_completion|hover|module_references|module_view|open_document))"
    r"|_data/templates/(view|preview|study)|.*\.pyi$|.*/?py\.typed$|.*\.md$|.*\.png$)"
)
"""Files of the package that no robot in a browser needs."""

UNUSED_STANDARD = re.compile(
    r"_aix_support|_android_support|_apple_support|_ios_support|_osx_support|_pyrepl/|antigravity"
    r"|_pyio|asyncio/(proactor|windows)|bdb|cProfile|cmd|doctest|ensurepip|ftplib|http/(cookie|server)|idlelib|imaplib|mailbox|mimetypes"
    r"|modulefinder|multiprocessing/|netrc|nturl2path|optparse|pdb|pickletools|plistlib|poplib|profile|pstats|pty"
    r"|pyclbr|pydoc|rlcompleter|sched|smtplib|ssl\.py|socketserver|sqlite3/|tabnanny|this\.py|trace\.py"
    r"|tracemalloc|turtle|unittest/|venv/|wave|webbrowser|wsgiref/|xmlrpc/|xml/sax/saxutils\.pyi"
    r"|encodings/(big5|cp7|cp8|cp9|cp1006|cp1026|cp11|euc|gb|hp_|hz|iso2022|johab|kz|mac_|mbcs|oem"
    r"|palmos|ptcp|quopri|rot_13|shift|tis|uu_|zlib|bz2)"
)
"""Files of Python's standard library that no robot in a browser needs."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder.resolve()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(NODE / "pyodide" / "pyodide.mjs", folder)
    for name in ("pyodide/pyodide.asm.mjs", "pyodide/pyodide.asm.wasm"):
        compressed(NODE / name, folder)
    compressed(NODE / "@mujoco" / "mujoco" / "mujoco.wasm", folder)
    shutil.copy(NODE / "@mujoco" / "mujoco" / "mujoco.js", folder)
    lock = json.loads((NODE / "pyodide" / "pyodide-lock.json").read_text(encoding="utf-8"))
    worker = (HERE / "worker.js").read_text(encoding="utf-8")
    info = json.dumps(lock["info"])
    write(folder / "worker.js", worker.replace("null /*LOCK*/", info))
    write(folder / "index.html", page())
    subprocess.run(
        ["npm", "run", "--silent", "build", "--", f"--outfile={folder / 'editor.js'}"],
        check=True,
        cwd=HERE,
    )
    write_examples(folder)
    with tempfile.TemporaryDirectory() as stage:
        stage_python(Path(stage, "app"))
        stage_standard_library(Path(stage, "lib"))
        for name, archive in (("app", "python.zip"), ("lib", "python_stdlib.zip")):
            command = ["node", "pack.mjs", str(Path(stage, name)), str(folder / archive)]
            subprocess.run(command, check=True, cwd=HERE)


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def page() -> str:
    host, workbench = (
        (HERE / n).read_text(encoding="utf-8") for n in ("host.js", "workbench.html")
    )
    head = '<meta charset="utf-8">'
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    return robot_page(host, workbench).replace(head, f"{head}\n{policy}", 1)


def write_examples(folder: Path) -> None:
    """Writes the files of each example that compiles, and the module types of the library."""
    examples = []
    for path in sorted(ROOT.glob("examples/*/*.yaml")):
        if path.name in ("robot.yaml", "fleet.yaml") and compile_file(path).model is not None:
            name = path.parent.name
            main = path.relative_to(ROOT / "examples").as_posix()
            files = {p.relative_to(ROOT / "examples").as_posix(): content(p) for p in inputs(path)}
            write(folder / "examples" / f"{name}.json", json.dumps({"main": main, "files": files}))
            examples.append({"name": name, "title": name})
    examples.sort(key=lambda example: example["name"] != FIRST_EXAMPLE)
    library = Library([])
    types = [library.load(name, Node(name, Span(name)), Report()) for name in library.names()]
    modules = [
        {
            "type": module.name,
            "text": first_sentence(module),
            "kinds": describe_module(module, library).mounts_on,
        }
        for module in types
        if module is not None
    ]
    write(folder / "library.json", json.dumps({"examples": examples, "modules": modules}))


def inputs(main: Path) -> list[Path]:
    """Returns the main file and the other files that its compilation can read."""
    others = {path.resolve() for path in compile_file(main).sources.values() if path.is_file()}
    for path in main.parent.rglob("*"):
        if path.is_file() and path.suffix in INPUT_SUFFIXES:
            others.add(path)
    others.discard(main)
    return [main, *sorted(path for path in others if path.is_relative_to(ROOT / "examples"))]


def content(path: Path) -> str | list[str]:
    """Returns a text file as text, and another one in base64 as a list of one text."""
    data = path.read_bytes()
    try:
        return data.decode()
    except UnicodeDecodeError:
        return [base64.b64encode(data).decode()]


def compressed(path: Path, folder: Path) -> None:
    data = gzip.compress(path.read_bytes(), 9, mtime=0)
    (folder / f"{path.name}.gz").write_bytes(data)


def stage_python(stage: Path) -> None:
    """Copies all Python files and data that the worker needs."""
    for path in (ROOT / "thorvaldc").rglob("*"):
        copy_used(path, stage / path.relative_to(ROOT), stage)
    for name in ("modules", "templates"):
        for path in (ROOT / name).rglob("*"):
            copy_used(path, stage / "thorvaldc" / "_data" / path.relative_to(ROOT), stage)
    for package in PACKAGES:
        for file in metadata.files(package) or ():
            if (
                file.suffix in (".py", ".json")
                and ".." not in file.parts
                and not {"tests", "benchmarks"} & {*file.parts}
            ):
                copy(Path(str(file.locate())), stage / file)
    shutil.copytree(HERE / "python", stage, dirs_exist_ok=True)


def stage_standard_library(stage: Path) -> None:
    """Unpacks the modules of the standard library that a robot in a browser can need."""
    with zipfile.ZipFile(NODE / "pyodide" / "python_stdlib.zip") as archive:
        archive.extractall(stage, [n for n in archive.namelist() if not UNUSED_STANDARD.match(n)])


def copy_used(path: Path, target: Path, stage: Path) -> None:
    name = target.relative_to(stage).as_posix()
    if path.is_file() and "__pycache__" not in path.parts and not UNUSED.match(name):
        copy(path, target)


def copy(path: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(path, target)


if __name__ == "__main__":
    main()
