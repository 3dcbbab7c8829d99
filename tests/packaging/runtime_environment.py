"""Creates environments that contain only some packages and their requirements.

Nothing is downloaded: the required packages come from the environment that runs the tests.  So all
others are really absent: numpy, MuJoCo, PyYAML and the rest of thorvaldc beside the wheel
``thorvaldc-runtime``, and scipy beside an extra that does not need it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import venv
from collections.abc import Iterable
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]


def requirements_of(*lines: str) -> dict[str, Distribution]:
    """Returns the packages of these requirements and all that they need themselves, by name."""
    distributions: dict[str, Distribution] = {}
    pending = [Requirement(line) for line in lines]
    while pending:
        requirement = pending.pop()
        if requirement.name in distributions:
            continue
        try:
            required = distribution(requirement.name)
        except PackageNotFoundError:
            continue  # optional for another platform
        distributions[requirement.name] = required
        for line in required.requires or ():
            candidate = Requirement(line)
            names = [*requirement.extras, ""]
            if candidate.marker is None or any(
                candidate.marker.evaluate({"extra": extra}) for extra in names
            ):
                pending.append(candidate)
    return distributions


def build_wheel(folder: Path) -> Path:
    """Builds ``thorvaldc-runtime`` into ``folder``."""
    subprocess.run(
        [
            *(sys.executable, "-m", "build", "--no-isolation", "--wheel"),
            *("--outdir", str(folder), str(ROOT / "thorvaldc/runtime")),
        ],
        check=True,
        capture_output=True,
        cwd=folder,
    )
    (wheel,) = folder.glob("thorvaldc_runtime-*.whl")
    return wheel


def create(home: Path, wheel: Path, required: tuple[str, ...] = ("python-can", "typer")) -> Path:
    """Creates the environment in ``home`` and returns its ``bin``."""
    venv.create(home, with_pip=False, symlinks=True)
    (site,) = (home / "lib").glob("python*/site-packages")
    for name in required:
        for dependency in requirements_of(name).values():
            copy(dependency, site)
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "--python", str(home / "bin/python")),
            *("install", "--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"),
            str(wheel),
        ],
        check=True,
        capture_output=True,
        cwd=home,
    )
    return home / "bin"


def create_linked(home: Path, lines: Iterable[str]) -> Path:
    """Creates an environment with the checkout and these requirements; returns its Python.

    Folders are linked, in a tenth of a second.  Packages with a folder in common, such as
    ``backports``, bring their neighbours.
    """
    venv.create(home, with_pip=False, symlinks=True)
    (site,) = (home / "lib").glob("python*/site-packages")
    (site / "checkout.pth").write_text(f"{ROOT}\n", encoding="utf-8")
    for name, dependency in requirements_of(*lines).items():
        parts = {file.parts[0] for file in dependency.files or () if name != "thorvaldc"}
        for part in sorted(parts - {"..", "__pycache__"}):
            if not (site / part).exists():
                (site / part).symlink_to(str(dependency.locate_file(part)))
    return home / "bin/python"


def copy(dependency: Distribution, site: Path) -> None:
    """Copies the files of an installed distribution to another site-packages."""
    for file in dependency.files or ():
        if ".." in file.parts or file.suffix == ".pyc":
            continue  # scripts are outside; Python compiles the bytecode again
        target = site / file
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(str(file.locate()), target)
