"""The path that a document probably means by one that does not exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from thorvaldc.compiler.source.input_file import DOCUMENTS, FOLDERS, MAX_ENTRIES, near_path

FILES = (
    "robot.yaml",
    "scenario.yml",
    "notes.txt",
    ".hidden.yaml",
    "meshes/frame.stl",
    "robots/small/cart.yaml",
    "robots/large/wagon.yaml",
    "robots/large/deep/lowest.yaml",
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("robot.yaml", "robot.yaml"),
        ("Robot.YAML", "robot.yaml"),
        ("robt.yaml", "robot.yaml"),
        ("robot.yml", "robot.yaml"),
        ("scenario", "scenario.yml"),
        (" ./robot.yml ", "robot.yaml"),
        ("robots\\small\\cart.yaml", "robots/small/cart.yaml"),
        ("robot/smal/cart.yml", "robots/small/cart.yaml"),
        ("cart.yaml", "robots/small/cart.yaml"),
        ("elsewhere/wagon.yaml", "robots/large/wagon.yaml"),
        ("lowest.yaml", None),  # three folders below
        ("hidden.yaml", None),
        ("frame.stl", None),
        ("notes.txt", None),
        ("quite_different.yaml", None),
        ("/robot.yml", None),
        ("~/robot.yml", None),
        ("", None),
        ("robot\0.yaml", None),
        ("x" * 301, None),
    ],
)
def test_documents(folder: Path, name: str, path: str | None) -> None:
    assert near_path(folder, name, DOCUMENTS) == path


def test_folders(folder: Path) -> None:
    assert near_path(folder, "Meshes", FOLDERS) == "meshes"
    assert near_path(folder, "robots/smal", FOLDERS) == "robots/small"
    assert near_path(folder, "small", FOLDERS) is None
    assert near_path(folder / "meshes", "../robot.yml", DOCUMENTS) == "../robot.yaml"


def test_a_folder_of_many_entries_is_not_compared(folder: Path) -> None:
    for number in range(MAX_ENTRIES - len(list(folder.iterdir()))):
        (folder / f"{number:06}.bin").touch()
    assert near_path(folder, "robt.yaml", DOCUMENTS) == "robot.yaml"
    (folder / "one_more.bin").touch()
    assert near_path(folder, "robt.yaml", DOCUMENTS) is None
