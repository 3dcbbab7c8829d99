"""Builds the playground as a static site, for `make playground` and `make docs`.

    python playground/build.py build/playground

The page needs no special headers of its server and loads nothing from other hosts.  Large files are
compressed here, because not every static server does it.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib import metadata
from pathlib import Path

from thorvaldc.compiler.catalogue import describe_module
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span
from thorvaldc.tools.preview.compiled_robot import INPUT_SUFFIXES, CompiledRobot, robot_page

ROOT = Path(__file__).resolve().parents[1]
HERE = ROOT / "playground"
NODE = HERE / "node_modules"
FIRST_EXAMPLE = "car"
PICTURES = ROOT / "docs" / "assets" / "modules"
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'unsafe-inline';"
    " connect-src 'self'; worker-src 'self'; img-src 'self' data:;"
    " base-uri 'none'; form-action 'none'"
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
    r"|simulation/(bus|records)"
    r"|runtime/can_base"
    r"|tools/(?!__init__|preview/(__init__|compiled_robot|page_drive)"
    r"|language_server/(__init__|code_completion|cursor|hover|module_references|module_view"
    r"|open_document))"
    r"|_data/templates/(view|preview|study)|.*\.pyi$|.*/?py\.typed$|_data/modules/.*\.(md|png)$)"
)
"""Files of the package that no robot in a browser needs."""

UNUSED_STANDARD = re.compile(
    r"_aix_support|_android_support|_apple_support|_ios_support|_osx_support|_pyrepl/|antigravity"
    r"|_pyio|asyncio/(proactor|windows)|bdb|cProfile|cmd|doctest|ensurepip|ftplib|http/(cookie|server)|idlelib|imaplib|mailbox|mimetypes"
    r"|modulefinder|multiprocessing/|netrc|nturl2path|pdb|pickletools|plistlib|poplib|profile|pstats|pty"
    r"|pyclbr|pydoc|rlcompleter|sched|smtplib|ssl\.py|socketserver|sqlite3/|tabnanny|this\.py|trace\.py"
    r"|tracemalloc|turtle|unittest/|venv/|wave|webbrowser|wsgiref/|xmlrpc/|xml/sax/saxutils\.pyi"
    r"|encodings/(big5|cp7|cp8|cp9|cp1006|cp1026|cp11|euc|gb|hp_|hz|iso2022|johab|kz|mac_|mbcs|oem"
    r"|palmos|ptcp|quopri|rot_13|shift|tis|uu_|zlib|bz2)"
)
"""Files of Python's standard library that no robot in a browser needs."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the site; it is emptied")
    folder = parser.parse_args().folder.resolve()
    if shutil.which("npm") is None:
        print("error: the playground needs npm and node, and there is no npm", file=sys.stderr)
        return 1
    install()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("pyodide/pyodide.mjs", "@mujoco/mujoco/mujoco.js"):
        shutil.copy(NODE / name, folder)
    for name in (
        "pyodide/pyodide.asm.mjs",
        "pyodide/pyodide.asm.wasm",
        "@mujoco/mujoco/mujoco.wasm",
    ):
        pack(folder / Path(name).name, (NODE / name).read_bytes())
    lock = json.loads((NODE / "pyodide" / "pyodide-lock.json").read_text(encoding="utf-8"))
    write(folder / "index.html", page())
    npm("run", "--silent", "build", "--", f"--outfile={folder / 'editor.js'}")
    write_examples(folder)
    write(folder / "licences.txt", licences())
    with tempfile.TemporaryDirectory() as stage:
        stage_python(Path(stage, "app"))
        stage_standard_library(Path(stage, "lib"))
        for name, archive in (("app", "python.zip"), ("lib", "python_stdlib.zip")):
            command = ["node", "pack.mjs", str(Path(stage, name)), str(folder / archive)]
            subprocess.run(command, check=True, cwd=HERE)
    loaded = [path for path in folder.iterdir() if path.name.startswith(("py", "python"))]
    size = sum(path.stat().st_size for path in loaded if path.suffix != ".mjs")
    worker = (HERE / "worker.js").read_text(encoding="utf-8")
    worker = worker.replace("null /*LOCK*/", json.dumps(lock["info"]))
    write(folder / "worker.js", worker.replace("0 /*SIZE*/", str(size)))
    write_service_worker(folder)
    return 0


def install() -> None:
    """Installs the packages of package-lock.json, if they are not installed yet."""
    lock, present = HERE / "package-lock.json", NODE / ".package-lock.json"
    if not present.is_file() or present.stat().st_mtime < lock.stat().st_mtime:
        npm("ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent")


def npm(*arguments: str) -> None:
    subprocess.run(["npm", *arguments], check=True, cwd=HERE, stdout=subprocess.DEVNULL)


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def pack(path: Path, data: bytes) -> None:
    """Writes a file, compressed, beside the place of its name."""
    path.with_name(f"{path.name}.packed").write_bytes(gzip.compress(data, 9, mtime=0))


def page() -> str:
    host, workbench = (
        (HERE / n).read_text(encoding="utf-8") for n in ("host.js", "workbench.html")
    )
    head = '<meta charset="utf-8">'
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    policy += '<link rel="icon" href="data:,">'
    return robot_page(host, workbench).replace(head, f"{head}\n{policy}", 1)


def write_examples(folder: Path) -> None:
    """Writes the files and the picture of each example that compiles, and the library."""
    examples = []
    for path in sorted(ROOT.glob("examples/*/*.yaml")):
        if path.name not in ("robot.yaml", "fleet.yaml"):
            continue
        robot = CompiledRobot(path, (), False)
        robot.compile()
        if robot.model is not None:
            name = path.parent.name
            main = path.relative_to(ROOT / "examples").as_posix()
            files = {p.relative_to(ROOT / "examples").as_posix(): content(p) for p in inputs(path)}
            write(folder / "examples" / f"{name}.json", json.dumps({"main": main, "files": files}))
            picture = {"model": robot.message(set())["model"], "details": robot.details()}
            pack(folder / "examples" / name, json.dumps(picture).encode())
            examples.append(name)
    examples.sort(key=lambda name: name != FIRST_EXAMPLE)
    shutil.copytree(PICTURES, folder / "modules")
    library = Library([])
    types = [library.load(name, Node(name, Span(name)), Report()) for name in library.names()]
    modules = [
        {
            "type": module.name,
            "text": module.summary,
            "kinds": describe_module(module, library).mounts_on,
            "picture": (PICTURES / f"{module.name.replace('/', '_')}.png").is_file(),
        }
        for module in types
        if module is not None
    ]
    write(folder / "library.json", json.dumps({"examples": examples, "modules": modules}))


def write_service_worker(folder: Path) -> None:
    """Writes the script that keeps all files of the site, whose hash is its version."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    version = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]
    names = ["./", *(path.relative_to(folder).as_posix() for path in files)]
    script = (HERE / "sw.js").read_text(encoding="utf-8")
    script = script.replace("[] /*FILES*/", json.dumps(names))
    write(folder / "sw.js", script.replace('"" /*VERSION*/', json.dumps(version)))


def inputs(main: Path) -> list[Path]:
    """Returns the main file and the other files that its compilation can read."""
    sources = [path.resolve() for path in compile_file(main).sources.values()]
    folders = {main.parent, *(path.parent for path in sources)}
    others = {
        path
        for folder in folders
        if folder.is_relative_to(ROOT / "examples")
        for path in folder.rglob("*")
        if path.suffix in INPUT_SUFFIXES
    }
    return [main, *sorted(others - {main})]


def content(path: Path) -> str | list[str]:
    """Returns a text file as text, and another one in base64 as a list of one text."""
    data = path.read_bytes()
    try:
        return data.decode()
    except UnicodeDecodeError:
        return [base64.b64encode(data).decode()]


SOURCES = {
    "pyodide": "https://github.com/pyodide/pyodide",
    "@mujoco/mujoco": "https://github.com/google-deepmind/mujoco",
    "three": "https://github.com/mrdoob/three.js",
}
"""Where the sources are of what npm packages contain in another form."""
CPYTHON = """\
pyodide.asm.wasm and python_stdlib.zip contain CPython {version} (PSF-2.0); its modules are
compiled, and some are left out. Source: https://github.com/python/cpython
"""


def licences() -> str:
    """Returns the list of the programs in the site: version, licence, source, and its text."""
    lock = json.loads((NODE / "pyodide" / "pyodide-lock.json").read_text(encoding="utf-8"))
    parts = [CPYTHON.format(version=lock["info"]["python"])]
    for path in sorted(NODE.glob("*/package.json")) + sorted(NODE.glob("@*/*/package.json")):
        name = path.parent.relative_to(NODE).as_posix()
        package = json.loads(path.read_text(encoding="utf-8"))
        if "esbuild" in name or name.startswith("@types") or name == "ws":
            continue  # needed by the build alone
        repository = package.get("repository", "")
        address = repository.get("url", "") if isinstance(repository, dict) else repository
        source = SOURCES.get(name) or address.removeprefix("git+").removesuffix(".git")
        texts = [file.read_text(encoding="utf-8") for file in path.parent.glob("LICEN[SC]E*")]
        parts.append(licence(name, package["version"], package.get("license", ""), source, texts))
    parts.append(licence("three", "", "MIT", SOURCES["three"], []))
    for name in PACKAGES:
        data = metadata.metadata(name).json
        texts = [
            file.read_text(encoding="utf-8")
            for file in metadata.files(name) or ()
            if re.match(r"(LICEN[SC]E|COPYING|NOTICE)", file.name)
        ]
        declared = str(data.get("license_expression") or data.get("license") or "see the text")
        pages = dict(str(page).split(", ", 1) for page in data.get("project_url", ()))
        pages = {label.lower(): address for label, address in pages.items()}
        known = (pages.get(label) for label in ("source", "repository", "github", "homepage"))
        source = str(data.get("home_page") or next(filter(None, known), ""))
        version = str(data["version"])
        parts.append(licence(name, version, declared.split("\n")[0], source, texts))
    return "\n".join(parts)


def licence(name: str, version: str, declared: str, source: str, texts: list[str]) -> str:
    head = f"{name} {version}".strip() + f" ({declared})\nSource: {source}\n"
    return "\n".join([head, *texts])


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
    shutil.copytree(HERE / "stand_ins", stage, dirs_exist_ok=True)
    shutil.copy(HERE / "playground.py", stage)


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
    sys.exit(main())
