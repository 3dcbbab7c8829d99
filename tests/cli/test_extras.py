"""Extras: `all` has those for users, and a hint names the extra with the missing package."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement

from tests.cli.conftest import Command, needs_tools
from tests.cli.test_missing_libraries import STUDY
from tests.slow import mostly_slow
from thorvaldc.diagnostics.installation import install_command

ROOT = Path(__file__).parents[2]
# usd needs an older MuJoCo, batch and warp a newer one than the oldest that is supported.
NOT_IN_ALL = {"dev", "bench", "docs", "all", "usd", "batch", "warp"}
# A package, a command that needs it, and the extra that installs it.
HINTS = [
    ("matplotlib", ("sim", "good.yaml", "--ideal", "--duration", "0.1", "--plot", "o.png"), "plot"),
    ("PIL", ("sim", "good.yaml", "--duration", "0.1", "--video", "o.gif"), "video"),
    ("imageio_ffmpeg", ("sim", "good.yaml", "--duration", "0.1", "--video", "o.mp4"), "video"),
    (
        "rosbags",
        ("sim", "good.yaml", "--ideal", "--duration", "0.1", "--record", "o.mcap"),
        "record",
    ),
    ("evdev", ("teleop", "good.yaml", "--on", "ideal", "--joystick", "auto"), "joystick"),
    ("serial", ("can", "scan", "good.yaml", "--bus", "slcan:/dev/null"), "serial"),
    ("msgpack", ("can", "scan", "good.yaml", "--bus", "udp"), "udp"),
    ("pygls", ("lsp",), "lsp"),
    ("optuna", ("study", "run", "study.yaml"), "study"),
    (
        "distributed",
        ("study", "run", "study.yaml", "--scheduler", "tcp://127.0.0.1:9"),
        "study",
    ),
    ("plotly", ("study", "show", "study.yaml", "--html", "o.html"), "study"),
    ("mujoco_usd_converter", ("usd", "good.yaml", "-o", "o.usda"), "usd"),
    ("cantools", ("modules", "from-dbc", "io/mine", "mine.dbc", "--node", "A"), "dbc"),
    ("aiohttp", ("preview", "good.yaml", "--no-browser"), "preview"),
]
# Modules that were imported before keep the packages that they use.  Those of an interface of
# python-can also keep functions of each other.
INTERFACES = "can.interfaces."
# Hints of which other tests show that they appear.
SHOWN_ELSEWHERE = {"gym", "batch", "warp"}


def extras(file: str) -> dict[str, list[Requirement]]:
    project = tomllib.loads((ROOT / file).read_text())["project"]
    table = project["optional-dependencies"]
    return {name: list(map(Requirement, texts)) for name, texts in table.items()}


@pytest.mark.parametrize("file", ["pyproject.toml", "thorvaldc/runtime/pyproject.toml"])
def test_the_extra_all_contains_all_extras_for_users(file: str) -> None:
    found = extras(file)
    (requirement,) = found["all"]
    assert requirement.extras == found.keys() - NOT_IN_ALL


@needs_tools
def test_every_hint_names_an_extra_and_has_a_test() -> None:
    text = "\n".join(p.read_text() for p in (ROOT / "thorvaldc").rglob("*.py"))
    named = set(re.findall(r"""install_command\(["']([a-z]+)["']\)""", text))
    named |= {extra for _, _, extra in HINTS if extra in ("serial", "udp")}
    assert named <= extras("pyproject.toml").keys()
    assert named == {extra for _, _, extra in HINTS} | SHOWN_ELSEWHERE
    assert {"joystick", "serial", "udp"} <= extras("thorvaldc/runtime/pyproject.toml").keys()


def holds(module: ModuleType, package: str) -> bool:
    origins = (getattr(v, "__module__", getattr(v, "__name__", "")) for v in vars(module).values())
    return any(str(origin).partition(".")[0] == package for origin in origins)


@pytest.fixture
def own_interfaces() -> Iterator[None]:
    """Forgets the interfaces of python-can that a test imports without their packages."""
    before = set(sys.modules)
    yield
    for name in [n for n in sys.modules if n.startswith(INTERFACES) and n not in before]:
        folder, _, child = name.rpartition(".")
        vars(sys.modules.get(folder, sys)).pop(child, None)
        del sys.modules[name]


@pytest.mark.usefixtures("own_interfaces")
@pytest.mark.parametrize("hint", mostly_slow(HINTS), ids=[h[0] for h in HINTS])
def test_a_missing_package_is_one_line_with_the_extra_that_installs_it(
    thorvaldc: Command,
    monkeypatch: pytest.MonkeyPatch,
    hint: tuple[str, tuple[str, ...], str],
) -> None:
    package, arguments, extra = hint
    for name, module in list(sys.modules.items()):
        is_of_package = name.partition(".")[0] == package or name.startswith(INTERFACES)
        if is_of_package or (name.startswith("thorvaldc.") and holds(module, package)):
            folder, _, child = name.rpartition(".")
            gone = ModuleType(folder)
            monkeypatch.delattr(sys.modules.get(folder, gone), child, raising=False)
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setenv("PATH", "")  # no ffmpeg
    Path("o.mcap").write_bytes(b"\x89MCAP0\r\n")
    Path("study.yaml").write_text(STUDY, encoding="utf-8")
    result = thorvaldc(*arguments)
    assert result.status in (1, 3)
    assert install_command(extra) in result.err
    assert "Traceback" not in result.err
    if package in packages_distributions():  # evdev exists on Linux alone
        installs = {requirement.name.lower() for requirement in extras("pyproject.toml")[extra]}
        assert {name.lower() for name in packages_distributions()[package]} & installs
