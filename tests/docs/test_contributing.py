"""The examples of docs/contributing.md, typed in as the page shows them, in an empty package."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/contributing.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^File `([^`]+)`:\n\n```\w+\n(.*?)^```", PAGE, re.M | re.S))

pytestmark = [pytest.mark.xdist_group("contributing"), pytest.mark.slow]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the page, written to disk and installed for the tests' own commands."""
    folder = tmp_path_factory.mktemp("acme")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    # Installed beside the sources, so that the environment of the tests stays as it is.
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"),
            *("--no-build-isolation", "--disable-pip-version-check"),
            *("--target", str(folder / "site"), str(folder)),
        ],
        check=True,
        capture_output=True,
    )
    return folder


def python(package: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs a module of Python in the package, which is installed beside thorvaldc."""
    variables = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    path = os.pathsep.join([str(package / "site"), str(ROOT)])
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=package,
        env={**variables, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def thorvaldc(package: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return python(package, "thorvaldc", *arguments)


@pytest.fixture(scope="module")
def outputs(package: Path) -> dict[str, str]:
    """The commands of the page, in its order, and what each prints."""
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
    commands = re.findall(r"^thorvaldc (.*)$", "".join(blocks), re.M)
    outputs = {}
    for command in commands:
        run = thorvaldc(package, *command.split())
        assert run.returncode == 0, f"{command}\n{run.stderr}"
        assert "warning" not in run.stderr, run.stderr
        outputs[command] = run.stdout + run.stderr
    return outputs


def test_the_page_has_the_files_of_a_package() -> None:
    assert set(FILES) == {
        "pyproject.toml",
        "acme/__init__.py",
        "acme/parts_list.py",
        "acme/gentle.py",
        "acme/links.py",
        "acme/codes.py",
        "modules/wheel/narrow/module.yaml",
        "robot.yaml",
    }


# What `make test` runs on Python files, here with the settings of the project on those of the page.
@pytest.mark.parametrize(
    "command",
    [
        "ruff check --no-cache --extend-select ANN --config",  # most of what mypy would refuse
        "ruff format --check --no-cache --config",
        pytest.param("mypy --cache-dir=/dev/null --config-file", marks=pytest.mark.slow),
    ],
)
def test_the_files_pass_the_checks_of_the_project(package: Path, command: str) -> None:
    run = python(package, *command.split(), str(ROOT / "pyproject.toml"), "acme")
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize(
    ("tests", "least"),
    [
        # Of the calculator, what fails first where it changes a twist in a way of its own.
        ("parts_list or every_target and odd_text or gentle and (scaling or allowed)", 10),
        pytest.param("gentle", 10, marks=pytest.mark.slow),
    ],
    ids=["backend", "calculator"],
)
def test_the_plug_ins_pass_the_conformance_tests(package: Path, tests: str, least: int) -> None:
    files = [
        str(ROOT / f"tests/conformance/test_{name}.py") for name in ("backends", "calculators")
    ]
    run = python(package, "pytest", "-n0", "-p", "no:cacheprovider", "-k", tests, *files)
    assert run.returncode == 0, run.stdout + run.stderr
    passed = re.search(r"^(\d+) passed, \d+ deselected", run.stdout, re.M)
    assert passed, run.stdout
    assert int(passed[1]) >= least


@pytest.mark.slow
def test_the_module_is_in_the_robot(package: Path, outputs: dict[str, str]) -> None:
    assert "1 module" in outputs["modules check modules"]
    model = json.loads((package / "build/narrow_rover/model.json").read_text())["model"]
    assert [wheel["radius"] for wheel in model["wheels"]] == [0.18] * 4


def test_the_backend_writes_its_file(package: Path, outputs: dict[str, str]) -> None:
    assert "parts_list" in outputs["targets"]
    with (package / "build/narrow_rover/parts.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(int(row["links"]) for row in rows) > 10
    assert "frame" in {row["module"] for row in rows}


@pytest.mark.slow
def test_the_command_is_listed_and_runs(package: Path, outputs: dict[str, str]) -> None:
    assert "  links " in thorvaldc(package, "--help").stdout
    assert "Print the number of links" in thorvaldc(package, "links", "--help").stdout
    assert outputs["links robot.yaml"].endswith(" links\n")


def test_the_code_is_explained_and_reported(package: Path, outputs: dict[str, str]) -> None:
    page = FILES["acme/codes.py"].split('"""')[3].removeprefix("\\\n")
    assert outputs["explain AC601"] == page
    assert thorvaldc(package, "explain", "parts-list-mesh").stdout == page
    build = "build robot.yaml --target urdf,parts_list"
    assert "note[AC601] parts-list-mesh: the table leaves" in outputs[build]
    sarif = json.loads(thorvaldc(package, *build.split(), "--format", "sarif").stdout)
    (rule,) = sarif["runs"][0]["tool"]["driver"]["rules"]
    assert (rule["id"], rule["help"]["markdown"]) == ("AC601", page)


@pytest.mark.parametrize("number", ["TV901", "AD601", "AC6"])
def test_a_code_without_its_prefix_is_one_line(package: Path, tmp_path: Path, number: str) -> None:
    (tmp_path / "acme").mkdir()
    codes = FILES["acme/codes.py"].replace('Code("AC601"', f'Code("{number}"')
    (tmp_path / "acme/__init__.py").touch()
    (tmp_path / "acme/codes.py").write_text(codes)
    path = os.pathsep.join([str(tmp_path), str(package / "site"), str(ROOT)])
    run = subprocess.run(
        [sys.executable, "-m", "thorvaldc", "explain", "AC601"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, len(run.stderr.splitlines())) == (3, 1)
    assert f"error: the code {number} parts-list-mesh of `acme.codes:CODES`" in run.stderr


def test_the_calculator_limits_the_yaw_rate(outputs: dict[str, str]) -> None:
    # 1 rad/s would turn the robot by more than 3 rad in 4 s, 0.5 rad/s by less than 2.
    (command,) = (command for command in outputs if command.startswith("sim "))
    assert command == "sim robot.yaml --twist 0.5,0,1 --duration 4 --json"
    (robot,) = json.loads(outputs[command])["robots"]
    assert 1.5 < robot["pose_true"]["yaw"] < 2.0
