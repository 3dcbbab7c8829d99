"""Files of a new robot, project or module (``thorvaldc new``, ``thorvaldc modules new``).

The text comes from templates.  A new module type has a mesh, whose packages are imported only then.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path, PurePosixPath

from thorvaldc.compiler.modules.library import FILE
from thorvaldc.compiler.source.node import yaml_text
from thorvaldc.diagnostics import Report, Span, plain
from thorvaldc.diagnostics.files import write_file
from thorvaldc.diagnostics.installation import origin
from thorvaldc.model import Mesh
from thorvaldc.model.plugins import data_folder
from thorvaldc.schema import schema_text

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


def is_robot_name(name: str) -> bool:
    """Returns whether a text is a valid name of a robot.

    A robot name contains lower case letters, digits and underscores, and begins with a letter.
    """
    return _NAME.fullmatch(name) is not None


def presets() -> list[str]:
    """Returns the sorted names of the templates for robot files."""
    return sorted(path.stem for path in _templates().glob("*.yaml"))


def description_of(preset: str) -> str:
    """Returns the description in the template of a preset."""
    (description,) = re.findall(r"^description: (.*)$", robot_text("", preset), re.MULTILINE)
    return str(description)


def robot_text(name: str, preset: str) -> str:
    """Returns the text of a new robot file that contains the robot name ``name``.

    ``preset`` is the name of the template for the new robot file.
    """
    return (_templates() / f"{preset}.yaml").read_text(encoding="utf-8").replace("@NAME@", name)


def _templates() -> Path:
    return data_folder("templates") / "robot"


# The templates have no leading point, so that packagers and file managers show them.
_FILES = {
    "README.md": "README.md",
    "modules/top/plate/module.yaml": "module.yaml",
    "scenarios/straight.yaml": "scenario.yaml",
    ".github/workflows/robots.yml": "github.yml",
    ".gitlab-ci.yml": "gitlab.yml",
    ".pre-commit-config.yaml": "pre-commit.yaml",
}
WHEELS = "wheels"
"""Folder of a new repository with the wheel of thorvaldc that CI installs."""
_MODELINE = "# yaml-language-server: $schema=robot.schema.json\n"
_PLATE = "  plate: {type: top/plate, mount: {parent: frame, xyz: [0, 0, 310 mm]}}\n"


def robot_files(name: str, preset: str) -> dict[str, str]:
    """Returns the text of each file of a new folder with one robot, by its relative path."""
    return {
        "robot.yaml": _MODELINE + robot_text(name, preset),
        "robot.schema.json": schema_text("robot"),
    }


def unit_files(name: str, design: Path) -> dict[str, str]:
    """Returns the text of the file of a new unit of a design, by its name."""
    text = (data_folder("templates") / "unit" / "unit.yaml").read_text(encoding="utf-8")
    modeline = _MODELINE if (design.parent / "robot.schema.json").exists() else ""
    text = text.replace("@NAME@", name).replace("@DESIGN@", yaml_text(design.name))
    return {f"{name}.yaml": modeline + text}


def project_files(name: str, preset: str, version: str) -> dict[str, str | bytes]:
    """Returns the content of each file of a new repository, by its relative path.

    - ``name``: name of the repository and of its first robot.
    - ``preset``: name of the template of the robot.
    - ``version``: version of this program.

    CI installs thorvaldc from where this program came: the wheel, which is copied, a URL or an
    index.  For a checkout, the user builds the wheel, see ``missing_wheel``.
    """
    folder = data_folder("templates") / "project"
    files: dict[str, str | bytes] = {
        path: (folder / template).read_text(encoding="utf-8").replace("@NAME@", name)
        for path, template in _FILES.items()
    }
    robot = robot_text(name, preset).replace("modules:\n", "library: [../modules]\nmodules:\n", 1)
    files[f"robots/{name}.yaml"] = _MODELINE + robot.rstrip("\n") + "\n" + _PLATE
    for directory in ("modules", "robots", "scenarios"):
        kind = directory.removesuffix("s")
        files[f"{directory}/{kind}.schema.json"] = schema_text(kind)
    files[".gitignore"] = "build/\n"
    came_from = origin()
    requirement = came_from.requirement()
    if came_from.is_local:
        requirement = f"./{WHEELS}/thorvaldc-{version}-py3-none-any.whl"
        if came_from.place.endswith(".whl") and (wheel := Path(came_from.place)).is_file():
            requirement = f"./{WHEELS}/{wheel.name}"
            files[f"{WHEELS}/{wheel.name}"] = wheel.read_bytes()
    files["requirements.txt"] = f"# What CI installs: thorvaldc itself.\n{requirement}\n"
    return files


def missing_wheel(files: Mapping[str, str | bytes]) -> str:
    """Returns the command that builds the wheel for the CI of a new repository, or an empty text.

    ``files``: those of ``project_files``.  The command is for the folder of the repository.
    """
    came_from = origin()
    if not came_from.is_local or any(path.startswith(f"{WHEELS}/") for path in files):
        return ""
    return f'pip wheel --no-deps --wheel-dir {WHEELS} "{came_from.place}"'


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


SCHEMA = "module.schema.json"
_TYPE = re.compile(r"[a-z][a-z0-9_]{0,63}(/[a-z][a-z0-9_]{0,63}){1,3}")
# CAD programs export millimetres, and no part with a mount is longer.
_MAX_METRES = 5.0


def is_module_type(name: str) -> bool:
    """Returns whether a text is a valid name of a new module type, such as ``tool/sprayer``."""
    return _TYPE.fullmatch(name) is not None


def module_mesh(path: Path | None, report: Report) -> Mesh | None:
    """Returns the mesh of a new module: that of a file, or the mesh of the template.

    Returns ``None`` and reports an error if the file cannot be read.
    """
    from thorvaldc.compiler.shapes.meshes import load_mesh

    path = path or data_folder("templates") / "module" / "body.obj"
    return load_mesh(path, Span(str(path)), report, display=str(path))


def module_files(name: str, mesh: Mesh, mesh_name: str) -> dict[str, bytes]:
    """Returns the content of each file of a new module type, by its path in the library folder.

    The module has a box as large as the mesh, which gives mass, inertia and the shape for
    collisions.  A mesh longer than 5 m is taken to be in millimetres.  A frame has a port for a leg
    at each corner of the box.

    - ``name``: name of the module type, such as ``tool/sprayer``.
    - ``mesh_name``: name of the mesh file without its suffix.
    """
    from thorvaldc.backends.templates import Templates
    from thorvaldc.compiler.shapes.mesh_formats import mesh_triangles

    axes = [*zip(*chain.from_iterable(mesh_triangles(mesh.name, mesh.data)), strict=True)]
    low, high = [min(axis) for axis in axes], [max(axis) for axis in axes]
    is_metric = max(b - a for a, b in zip(low, high, strict=True)) <= _MAX_METRES
    to_millimetres = 1000.0 if is_metric else 1.0
    # The smallest whole millimetres that contain the mesh; a box of a flat mesh needs a thickness.
    lows = [math.floor(a * to_millimetres + 1e-3) for a in low]
    highs = [math.ceil(b * to_millimetres - 1e-3) for b in high]
    sizes = [max(b - a, 1) for a, b in zip(lows, highs, strict=True)]
    centre = [(a + b) / 2 for a, b in zip(lows, highs, strict=True)]
    mesh_file = f"meshes/{mesh_name}{PurePosixPath(mesh.name).suffix}"
    text = Templates("module").render(
        FILE,
        schema="../" * (name.count("/") + 1) + SCHEMA,
        mesh=mesh_file,
        scale="" if is_metric else ", scale: 0.001",
        size=_millimetres(sizes),
        centre=_millimetres(centre),
        top=_millimetres([centre[0], centre[1], highs[2]]),
        is_frame=name.startswith("frame/"),
        low=lows,
        high=highs,
        middle=f"{centre[2]:g}",
    )
    return {f"{name}/{FILE}": text.encode(), f"{name}/{mesh_file}": mesh.data}


def usage(name: str) -> str:
    """Returns the line of a robot file that uses a new module type."""
    if name.startswith("frame/"):
        return f"    frame: {{type: {name}}}"
    return f"    part: {{type: {name}, mount: {{parent: frame, xyz: [0, 0, 300 mm]}}}}"


def write_module(library: Path, files: dict[str, bytes]) -> None:
    """Writes the files of a new module type into a library folder, and the schema of modules for
    editors beside its types.

    Raises ``FileExistsError`` before any file is written if one of ``files`` exists.
    """
    write_new_files(library, files)
    with suppress(FileExistsError):
        write_new_files(library, {SCHEMA: schema_text("module")})


def _millimetres(values: list[int] | list[float]) -> str:
    return ", ".join(f"{plain(value)} mm" if value else "0" for value in values)
