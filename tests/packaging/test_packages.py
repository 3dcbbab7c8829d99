"""Wheel and sdist work where the checkout is not: built, installed apart, and used.

The fresh environment borrows the packages of the one that runs the tests (a
``.pth`` line), so that nothing is fetched; thorvaldc itself is the wheel's.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# One worker for all of them, so that the packages are built once.
pytestmark = pytest.mark.xdist_group("packaging")


def run(*command: str | Path, cwd: Path, check: bool = True) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sdist, and the wheel that is built from the sdist."""
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, ROOT, cwd=out)
    (sdist,) = out.glob("*.tar.gz")
    (wheel,) = out.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def environment(packages: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ``bin`` of a fresh environment with the wheel installed."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, with_pip=False, symlinks=True)
    (site,) = (home / "lib").glob("python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install(home / "bin", packages[1])
    return home / "bin"


def install(bin: Path, what: Path) -> None:
    run(
        *(sys.executable, "-m", "pip", "--python", bin / "python", "install", "--quiet"),
        *("--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check", what),
        cwd=bin,
    )


def test_wheel_holds_the_data(packages: tuple[Path, Path]) -> None:
    names = zipfile.ZipFile(packages[1]).namelist()
    for part in ("modules/drive/standard/module.yaml", "templates/robot/4wd4ws.yaml"):
        assert f"thorvaldc/_data/{part}" in names
    assert any(name.startswith("thorvaldc/_data/diagnostics/TV") for name in names)
    assert any(name.startswith("thorvaldc/schema/") and name.endswith(".json") for name in names)
    assert not [name for name in names if name.startswith(("tests/", "bench/", "build/"))]


def test_sdist_holds_what_a_build_and_the_tests_need(packages: tuple[Path, Path]) -> None:
    with tarfile.open(packages[0]) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    for part in ("Makefile", "LICENSE", "modules/palette.yaml", "examples/4wd4ws_wide/robot.yaml"):
        assert part in names
    assert not [name for name in names if name.startswith((".venv", "build/"))]


def test_installed_elsewhere_it_starts_checks_builds_and_drives(
    environment: Path, tmp_path: Path
) -> None:
    thorvaldc = environment / "thorvaldc"
    where = run(
        environment / "python", "-c", "import thorvaldc; print(thorvaldc.__file__)", cwd=tmp_path
    )
    assert where.stdout.startswith(str(environment.parent))
    run(thorvaldc, "new", "mine", cwd=tmp_path)
    assert "mine, 4 wheels" in run(thorvaldc, "check", "mine/robot.yaml", cwd=tmp_path).stdout
    run(thorvaldc, "build", "mine/robot.yaml", cwd=tmp_path)
    assert (tmp_path / "build/mine/manifest.json").is_file()
    driven = run(thorvaldc, "sim", "mine/robot.yaml", "--duration", "1", "--json", cwd=tmp_path)
    assert json.loads(driven.stdout)
    assert "TV501" in run(thorvaldc, "explain", "TV501", cwd=tmp_path).stdout
    assert "drive/standard" in run(thorvaldc, "modules", "list", cwd=tmp_path).stdout
    assert json.loads(run(thorvaldc, "schema", "robot", cwd=tmp_path).stdout)


def test_a_backend_of_another_package(environment: Path, tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "sheet").mkdir(parents=True)
    (package / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["hatchling"]\nbuild-backend = "hatchling.build"\n'
        '[project]\nname = "sheet"\nversion = "1"\n'
        '[project.entry-points."thorvaldc.backends"]\ndatasheetx = "sheet:Sheet"\n'
    )
    (package / "sheet/__init__.py").write_text(
        "from thorvaldc.backends import Backend\n"
        "class Sheet(Backend):\n"
        '    name = "datasheetx"\n'
        '    summary = "A line about the robot"\n'
        "    def emit(self, robot):\n"
        '        return {"sheet.txt": f"{robot.name} {robot.inertial.mass:.1f} kg".encode()}\n'
    )
    thorvaldc = environment / "thorvaldc"
    run(thorvaldc, "new", "mine", cwd=tmp_path)
    refused = run(
        thorvaldc, "build", "mine/robot.yaml", "--target", "datasheetx", cwd=tmp_path, check=False
    )
    assert refused.returncode == 2
    assert "datasheetx" in refused.stderr
    install(environment, package)
    try:
        assert "datasheetx" in run(thorvaldc, "targets", cwd=tmp_path).stdout
        run(thorvaldc, "build", "mine/robot.yaml", "--target", "urdf,datasheetx", cwd=tmp_path)
    finally:
        run(
            *(sys.executable, "-m", "pip", "--python", environment / "python"),
            *("uninstall", "--quiet", "--yes", "sheet"),
            cwd=tmp_path,
        )
    assert (tmp_path / "build/mine/sheet.txt").read_text().startswith("mine ")
    assert (tmp_path / "build/mine/urdf/robot.urdf").is_file()
