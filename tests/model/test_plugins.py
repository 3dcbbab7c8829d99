"""The table of plug-ins: names, loading, and every reason why loading fails."""

from __future__ import annotations

import abc
import sys
from pathlib import Path

import pytest

from thorvaldc.model.plugins import PluginFailure, PluginTable

GROUP = "thorvaldc.test_tools"
MODULE = """
from tests.model.test_plugins import Tool
class Hammer(Tool):
    def use(self): return "bang"
class Idea(Tool): pass
number = 3
"""


class Tool(abc.ABC):
    @abc.abstractmethod
    def use(self) -> str: ...


class Saw(Tool):
    def use(self) -> str:
        return "ritsch"


TOOLS: PluginTable[Tool] = PluginTable(GROUP, Tool, {"saw": f"{__name__}:Saw"})


def install(folder: Path, package: str, entries: dict[str, str]) -> None:
    """Write an installed package with these entry points, and its module."""
    (folder / f"{package}.py").write_text(MODULE)
    info = folder / f"{package}-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\n")
    lines = [f"{name} = {value}" for name, value in entries.items()]
    (info / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines, ""]))


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(sys.modules, "tests.model.test_plugins", sys.modules[__name__])
    for package in ("tool_shop", "tool_barn"):
        monkeypatch.delitem(sys.modules, package, raising=False)
    install(
        tmp_path,
        "tool_shop",
        {
            "hammer": "tool_shop:Hammer",
            "saw": "tool_shop:Hammer",
            "both": "tool_shop:Hammer",
            "idea": "tool_shop:Idea",
            "three": "tool_shop:number",
            "gone": "tool_shop:Gone",
        },
    )
    install(tmp_path, "tool_barn", {"both": "tool_barn:Hammer", "hammer": "tool_shop:Hammer"})


def test_a_built_in_class_needs_no_package_metadata(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", None)
    assert TOOLS.load("saw") is Saw


@pytest.mark.usefixtures("packages")
def test_a_class_of_another_package() -> None:
    assert TOOLS.names() == ["both", "gone", "hammer", "idea", "saw", "three"]
    hammer = TOOLS.load("hammer")  # offered twice, but it is the same class
    assert not isinstance(hammer, PluginFailure)
    assert hammer().use() == "bang"


@pytest.mark.usefixtures("packages")
def test_a_built_in_name_cannot_be_replaced() -> None:
    assert TOOLS.load("saw") is Saw


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        (
            "both",
            "is offered by several packages: tool_barn (tool_barn:Hammer), "
            "tool_shop (tool_shop:Hammer); uninstall all but one of them",
        ),
        ("idea", "is incomplete: Idea lacks use"),
        ("three", "is no Tool"),
        ("gone", "cannot be loaded: module 'tool_shop' has no attribute 'Gone'"),
    ],
)
def test_a_plugin_that_cannot_be_used(name: str, reason: str) -> None:
    assert TOOLS.load(name) == PluginFailure(reason)


@pytest.mark.usefixtures("packages")
def test_a_name_that_no_package_offers() -> None:
    assert TOOLS.load("hamer") == PluginFailure("no package offers `hamer`", unknown=True)
