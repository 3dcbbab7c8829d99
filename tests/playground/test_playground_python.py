"""The Python side of the playground, with the messages of a page, outside of a browser."""

from __future__ import annotations

import base64
import importlib.util
import io
import json
import re
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from packaging.requirements import Requirement

from thorvaldc import __version__, backends
from thorvaldc.compiler.output.writer import MANIFEST, write_build
from thorvaldc.compiler.pipeline import compile_file, emit, load
from thorvaldc.tools.preview import page_drive

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "examples/4wd4ws_wide/robot.yaml").read_text(encoding="utf-8")


def module(name: str) -> ModuleType:
    """Imports a file of the playground, whose folder has stand-ins for other packages."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "playground" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


playground = module("playground")


class Page:
    """A page that sends messages, and keeps the answers by their kind."""

    def __init__(self, folder: Path) -> None:
        self.answers: dict[str, list[Any]] = {}
        self.playground = playground.Playground(self._receive, folder)

    def _receive(self, text: str) -> None:
        message = json.loads(text)
        self.answers.setdefault(message["kind"], []).append(message)

    def send(self, kind: str, **fields: Any) -> None:
        self.playground.receive(json.dumps({"kind": kind, "id": 7, **fields}))

    def open(self, files: dict[str, Any], main: str = "robot.yaml") -> Any:
        self.send("open", files=files, main=main)
        return self.answers["model"][-1]

    def ask(self, kind: str, answer: str, **fields: Any) -> Any:
        self.send(kind, **fields)
        message = self.answers[answer][-1]
        assert message["id"] == 7
        return message


@pytest.fixture
def page(tmp_path: Path) -> Page:
    page = Page(tmp_path / "robot")
    assert page.open({"robot.yaml": TEXT})["good"]
    return page


def test_a_change_an_error_and_the_last_good_robot(page: Page) -> None:
    page.send("edit", files={"robot.yaml": TEXT.replace("1.10 m", "70 kg")})
    model = page.answers["model"][-1]
    assert not model["good"]
    assert model["model"]["name"] == "thorvald_4wd4ws_wide"
    (diagnostic,) = model["diagnostics"]
    assert diagnostic["span"]["file"] == "robot.yaml"
    line, column = diagnostic["span"]["start"]
    assert TEXT.replace("1.10 m", "70 kg").splitlines()[line - 1][column - 1 :].startswith("70 kg")
    page.send("edit", files={"robot.yaml": TEXT.replace("tube_inset_y", "tube_inset")})
    (diagnostic,) = page.answers["model"][-1]["diagnostics"]
    (fix,) = diagnostic["fixes"]
    assert fix["text"] == "tube_inset_y"
    page.send("edit", files={"robot.yaml": TEXT})
    page.send("drawn")
    assert page.answers["model"][-1]["good"]
    assert {table["key"] for table in page.answers["details"][-1]["tables"]} >= {"size", "mass"}


def test_files_stay_in_the_folder_of_the_robot(page: Page, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="outside of the folder"):
        page.open({"../other.yaml": TEXT})
    assert not (tmp_path / "other.yaml").exists()


def test_proposals_at_the_cursor(page: Page) -> None:
    text = TEXT + "purchase: {}\n"
    start = text.index("mount: battery_left.lid") + len("mount: battery_left.")
    answer = page.ask("complete", "proposals", file="robot.yaml", text=text, offset=start)
    proposals = [proposal["label"] for proposal in answer["proposals"]]
    assert any("lid" in label for label in proposals)
    assert answer["start"] <= start
    unfinished = TEXT.replace("{type: io/board, can: 20}", "{type: caster/")
    offset = unfinished.index("caster/") + len("caster/")
    answer = page.ask("complete", "proposals", file="robot.yaml", text=unfinished, offset=offset)
    assert "caster/swivel" in [proposal["label"] for proposal in answer["proposals"]]


def test_a_module_is_mounted_at_a_free_port(page: Page) -> None:
    kinds = ["frame_clamp"]
    places = page.ask("places", "places", type="assembly/fixed_drive", kinds=kinds)["places"]
    by_text = {place["text"]: place["mount"] for place in places}
    assert "frame.center" in by_text
    assert "frame.front_left" not in by_text  # carries a drive
    assert by_text["frame, at a pose"] == "{parent: frame, xyz: [0, 0, 0]}"
    for mount in (by_text["frame.center"], by_text["frame, at a pose"]):
        answer = page.ask("mount", "insertion", text=TEXT, type="battery/enclosure", mount=mount)
        text = TEXT[: answer["offset"]] + answer["text"] + TEXT[answer["offset"] :]
        changed = page.open({"robot.yaml": text})
        parts = {link["module"] for link in changed["model"]["designs"][0]["links"]}
        assert "enclosure" in parts, changed["diagnostics"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("modules:\n  a: {type: x}\n", "modules:\n  a: {type: x}\n  board: {type: io/board}\n"),
        ("modules:\n  a: {type: x}", "modules:\n  a: {type: x}\n  board: {type: io/board}\n"),
        (
            "modules: {board: {type: x}}\n",
            "modules: {board_2: {type: io/board}, board: {type: x}}\n",
        ),
        (
            "modules:\n  a:\n    type: x\n    params:\n      b: 1\n\n  # end\nname: r\n",
            "modules:\n  a:\n    type: x\n    params:\n      b: 1\n  board: {type: io/board}\n\n"
            "  # end\nname: r\n",
        ),
        ("# µ😀\nmodules:\n  a: x\n", "# µ😀\nmodules:\n  a: x\n  board: {type: io/board}\n"),
    ],
)
def test_the_text_of_a_new_module(text: str, expected: str) -> None:
    answer = playground.insertion(text, "io/board", "")
    assert text[: answer["offset"]] + answer["text"] + text[answer["offset"] :] == expected


@pytest.mark.parametrize("text", ["name: r\n", "modules: {\n", "modules: {}\n", ""])
def test_a_file_without_modules_gets_none(text: str) -> None:
    answer = playground.insertion(text, "io/board", "")
    assert answer["text"] == ""
    assert "no section `modules`" in answer["reason"]


def test_the_built_files_are_those_of_a_build(page: Page, tmp_path: Path) -> None:
    targets = backends.names()
    answer = page.ask("build", "files", targets=targets)
    built = emit(load(ROOT / "examples/4wd4ws_wide/robot.yaml"), targets)
    assert {file["path"]: file["bytes"] for file in answer["files"]} == {
        path: len(data) for path, data in built.items()
    }
    archive = page.ask("archive", "archive")["base64"]
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(archive))) as packed:
        files = {name: packed.read(name) for name in packed.namelist()}
    write_build(
        built,
        tmp_path / "out",
        name="thorvald_4wd4ws_wide",
        source_sha256=compile_file(ROOT / "examples/4wd4ws_wide/robot.yaml").source_sha256,
        version=__version__,
    )
    assert files.pop(MANIFEST) == (tmp_path / "out" / MANIFEST).read_bytes()
    assert files == built
    text = page.ask("file", "file", path="urdf/robot.urdf")["text"]
    assert text.encode() == built["urdf/robot.urdf"]
    mesh = next(path for path in built if path.endswith(".stl"))
    assert base64.b64decode(page.ask("file", "file", path=mesh)["base64"]) == built[mesh]


class Clock:
    """The time of a page, which advances only with its drive."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def advance(self, page: Page, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.01
            assert page.playground.advance()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(page_drive, "time", clock)
    return clock


@pytest.mark.slow
def test_a_drive_goes_on_while_another_part_is_edited(page: Page, clock: Clock) -> None:
    page.send("drive", on=True, robot="thorvald_4wd4ws_wide")
    assert page.answers["drive"] == [{"kind": "drive", "on": True, "message": "ready"}]
    clock.advance(page, 0.3)
    assert abs(page.answers["state"][-1]["odometry"]["x"]) < 1e-6  # it does not move unasked
    for number in range(8):
        page.send("motion", x=1.0, y=0.0, yaw=0.0)
        page.send("edit", files={"robot.yaml": f"# {number}\n{TEXT}"})
        clock.advance(page, 0.2)
    driven = page.answers["state"][-1]["odometry"]["x"]
    assert driven > 0.1
    assert len(page.answers["drive"]) == 1
    page.send("edit", files={"robot.yaml": TEXT.replace("1.60 m", "1.50 m")})
    assert [message["on"] for message in page.answers["drive"]] == [True, False, True]
    clock.advance(page, 0.2)  # the motion of the old robot does not drive the new one
    assert abs(page.answers["state"][-1]["odometry"]["x"]) < 1e-6
    page.send("drive", on=False)
    assert not page.playground.advance()
    assert page.answers["drive"][-1]["on"] is False


def test_a_fleet_drives_and_a_wrong_name_drives_its_first_robot(
    tmp_path: Path, clock: Clock
) -> None:
    page = Page(tmp_path / "robot")
    fleet = ROOT / "examples/fleet_of_four/fleet.yaml"
    sources = {path.resolve() for path in compile_file(fleet).sources.values()}
    names = [
        path.relative_to(ROOT / "examples")
        for path in sources | {fleet}
        if path.is_relative_to(ROOT / "examples")
    ]
    files = {
        name.as_posix(): (ROOT / "examples" / name).read_text("utf-8")
        for name in names
        if name.suffix in (".yaml", ".xacro")
    }
    for mesh in (ROOT / "examples/4wd2ws_tall/meshes").iterdir():
        data = base64.b64encode(mesh.read_bytes()).decode()
        files[f"4wd2ws_tall/meshes/{mesh.name}"] = [data]  # type: ignore[assignment]
    assert page.open(files, "fleet_of_four/fleet.yaml")["good"]
    page.send("drive", on=True, robot="nobody")
    clock.advance(page, 0.1)
    assert page.answers["state"][-1]["robot"] == "tall"
    page.send("drive", on=False)


def test_the_page_offers_every_target() -> None:
    script = (ROOT / "playground/host.js").read_text(encoding="utf-8")
    assert {*json.loads(script.partition("const TARGETS = ")[2].partition(";")[0])} == {
        *backends.names()
    }


def test_the_page_has_the_modules_that_it_loads() -> None:
    code = "import sys, playground; print(*(n for n in sys.modules if n.startswith('thorvaldc.')))"
    loaded = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": f"{ROOT / 'playground'}:{':'.join(filter(None, sys.path))}"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert len(loaded) > 50
    unused = module("build").UNUSED
    files = [name.replace(".", "/") for name in loaded]
    paths = [f"{f}.py" if (ROOT / f"{f}.py").is_file() else f"{f}/__init__.py" for f in files]
    assert [path for path in paths if unused.match(path)] == []


def test_the_playground_is_built_with_the_packages_that_it_contains() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (target,) = re.findall(r"^playground: \$\(if \$\(READY\),(.+)\)$", makefile, re.M)
    (recipe,) = re.findall(rf"^{re.escape(target)}:.*\n((?:\t.*\n)+)", makefile, re.M)
    (names,) = re.findall(r"bin\) ((?:\w+ )+)\$\(NOT_INSTALLED\)", recipe)
    installed: set[str] = set()
    more = set(names.split())
    while more := more - installed:
        installed |= more
        texts = [text for name in more for text in metadata.requires(name) or ()]
        requirements = [Requirement(text) for text in texts]
        more = {
            r.name.lower()
            for r in requirements
            if r.marker is None or r.marker.evaluate({"extra": ""})
        }
    contained = {name.lower() for name in module("build").PACKAGES}
    assert contained <= installed <= contained | {"rpds-py", "typing-extensions"}
