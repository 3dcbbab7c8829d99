"""The wheel and the sdist work without the checkout.

The tests build them, install the wheel in a new environment and use it.  A ``.pth`` file gives
the new environment the packages of the environment that runs the tests, so nothing is
downloaded.  thorvaldc itself comes from the wheel.
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

from tests.cli.conftest import needs_tools

ROOT = Path(__file__).resolve().parents[2]

# One worker runs all these tests: then the packages are built once.
pytestmark = pytest.mark.xdist_group("packaging")


def run(
    *command: str | Path, cwd: Path, check: bool = True, **variables: str
) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment |= variables
    process = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert not check or process.returncode == 0, process.stdout + process.stderr
    return process


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Builds the sdist, and the wheel from the sdist."""
    out = tmp_path_factory.mktemp("dist")
    command = (sys.executable, "-m", "build", "--no-isolation", "--outdir", out, ROOT)
    run(*command, cwd=out, THORVALDC_COMPILE="0")
    (sdist,) = out.glob("*.tar.gz")
    (wheel,) = out.glob("*.whl")
    return sdist, wheel


@pytest.mark.slow
@needs_tools
def test_indexes_accept_the_packages(packages: tuple[Path, Path]) -> None:
    """Also that of the runtime, as `make dist` and the release workflow build them."""
    runtime = packages[0].parent / "runtime"
    command = (sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", runtime)
    run(*command, ROOT / "thorvaldc" / "runtime", cwd=runtime.parent)
    files = [*packages, *runtime.glob("*.whl")]
    assert len(files) == 3
    run(sys.executable, "-m", "twine", "check", "--strict", *files, cwd=runtime)


@pytest.fixture(scope="module")
def environment(packages: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Installs the wheel in a new environment; returns its ``bin``."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, with_pip=False, symlinks=True)
    (site,) = (home / "lib").glob("python*/site-packages")
    (site / "test_packages.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install(home / "bin", packages[1])
    return home / "bin"


def install(bin: Path, package: Path) -> None:
    run(
        *(sys.executable, "-m", "pip", "--python", bin / "python", "install", "--quiet"),
        *(
            "--no-deps",
            "--no-index",
            "--no-build-isolation",
            "--disable-pip-version-check",
            package,
        ),
        cwd=bin,
    )


def test_wheel_contains_the_data(packages: tuple[Path, Path]) -> None:
    names = zipfile.ZipFile(packages[1]).namelist()
    for part in ("modules/drive/standard/module.yaml", "templates/robot/4wd4ws.yaml"):
        assert f"thorvaldc/_data/{part}" in names
    assert any(name.startswith("thorvaldc/_data/diagnostics/TV") for name in names)
    assert any(name.startswith("thorvaldc/schema/") and name.endswith(".json") for name in names)
    assert not [name for name in names if name.startswith(("tests/", "bench/", "build/"))]


def test_sdist_contains_the_files_for_builds_and_tests(packages: tuple[Path, Path]) -> None:
    with tarfile.open(packages[0]) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    for part in ("Makefile", "LICENSE", "modules/palette.yaml", "examples/4wd4ws_wide/robot.yaml"):
        assert part in names
    assert not [name for name in names if name.startswith((".venv", "build/"))]


@pytest.mark.slow
def test_installed_wheel_checks_builds_and_simulates(environment: Path, tmp_path: Path) -> None:
    thorvaldc = environment / "thorvaldc"
    location = run(
        environment / "python", "-c", "import thorvaldc; print(thorvaldc.__file__)", cwd=tmp_path
    )
    assert location.stdout.startswith(str(environment.parent))
    run(thorvaldc, "new", "mine", cwd=tmp_path)
    assert "mine, 4 wheels" in run(thorvaldc, "check", "mine/robot.yaml", cwd=tmp_path).stdout
    run(thorvaldc, "build", "mine/robot.yaml", cwd=tmp_path)
    assert (tmp_path / "build/mine/manifest.json").is_file()
    simulation = run(thorvaldc, "sim", "mine/robot.yaml", "--duration", "1", "--json", cwd=tmp_path)
    assert json.loads(simulation.stdout)
    assert "TV501" in run(thorvaldc, "explain", "TV501", cwd=tmp_path).stdout
    assert "drive/standard" in run(thorvaldc, "modules", "list", cwd=tmp_path).stdout
    assert json.loads(run(thorvaldc, "schema", "robot", cwd=tmp_path).stdout)


@pytest.mark.slow
def test_a_program_that_uses_the_package_is_type_checked(environment: Path, tmp_path: Path) -> None:
    """mypy sees the types of the installed wheel: no name is ``Any``, and a typing error is one."""
    (tmp_path / "script.py").write_text(
        "import thorvaldc\n"
        'robot = thorvaldc.load("robot.yaml")\n'
        "reveal_type(robot)\n"
        'reveal_type(thorvaldc.emit(robot, ["urdf"]))\n'
        "twist = thorvaldc.Twist(0.5, 0.0, 0.0)\n"
        "reveal_type(thorvaldc.Simulation(robot).run(1.0, twist).robots[0].path_true)\n"
        "reveal_type(thorvaldc.BaseDriver(robot, thorvaldc.SimBase(robot)).state.pose)\n"
        'reveal_type(thorvaldc.compile("robot.yaml").report.errors)\n'
        'thorvaldc.laod("robot.yaml")\n'
    )
    process = run(
        *(sys.executable, "-m", "mypy", "--strict", "--no-error-summary"),
        *("--python-executable", environment / "python", "--cache-dir", tmp_path / "cache"),
        "script.py",
        cwd=tmp_path,
        check=False,
    )
    assert [line.split(": ", 1)[1] for line in process.stdout.splitlines()] == [
        'note: Revealed type is "thorvaldc.model.robot.Robot"',
        'note: Revealed type is "dict[str, bytes]"',
        'note: Revealed type is "float"',
        'note: Revealed type is "tuple[float, float, float, fallback=thorvaldc.runtime.se2.Pose2]"',
        'note: Revealed type is "list[thorvaldc.diagnostics.report.Diagnostic]"',
        'error: Module has no attribute "laod"  [attr-defined]',
    ]


@pytest.mark.slow
def test_backend_of_another_package(environment: Path, tmp_path: Path) -> None:
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
