"""Creates the files of a new repository of robots from templates."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from thorvaldc.compiler.scaffolding.new_robot import robot_text
from thorvaldc.diagnostics.atomic_file import write_file
from thorvaldc.model.data_folder import data_folder
from thorvaldc.schema.documents import schema_text

# The templates have no leading point, so that packagers and file managers show them.
_FILES = {
    "README.md": "README.md",
    "modules/top/plate/module.yaml": "module.yaml",
    "scenarios/straight.yaml": "scenario.yaml",
    ".github/workflows/robots.yml": "github.yml",
    ".gitlab-ci.yml": "gitlab.yml",
    ".pre-commit-config.yaml": "pre-commit.yaml",
}
_MODELINE = "# yaml-language-server: $schema=robot.schema.json\n"
_PLATE = "  plate: {type: top/plate, mount: {parent: frame, xyz: [0, 0, 300 mm]}}\n"


def robot_files(name: str, preset: str) -> dict[str, str]:
    """Returns the text of each file of a new folder with one robot, by its relative path."""
    return {
        "robot.yaml": _MODELINE + robot_text(name, preset),
        "robot.schema.json": schema_text("robot"),
    }


def project_files(name: str, preset: str) -> dict[str, str]:
    """Returns the text of each file of a new repository, by its relative path.

    - ``name``: name of the repository and of its first robot.
    - ``preset``: name of the template of the robot.
    """
    folder = data_folder("templates") / "project"
    files = {
        path: (folder / template).read_text(encoding="utf-8").replace("@NAME@", name)
        for path, template in _FILES.items()
    }
    robot = robot_text(name, preset).replace("modules:\n", "library: [../modules]\nmodules:\n", 1)
    files[f"robots/{name}.yaml"] = _MODELINE + robot.rstrip("\n") + "\n" + _PLATE
    for directory in ("modules", "robots", "scenarios"):
        kind = directory.removesuffix("s")
        files[f"{directory}/{kind}.schema.json"] = schema_text(kind)
    files[".gitignore"] = "build/\n"
    return files


def write_new_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Writes files with new names into a folder; an existing file is never replaced.

    Raises ``FileExistsError`` before any file is written if one of them exists.  If the disk is
    full, raises ``OSError``, and no file remains.
    """
    for path in files:
        if (folder / path).exists():
            raise FileExistsError(str(folder / path))
    written: list[Path] = []
    try:
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_file(folder / path, content, new=True)
            written.append(folder / path)
    except OSError:
        for file in written:
            with suppress(OSError):
                file.unlink()
        raise
