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

pytestmark = pytest.mark.xdist_group("contributing")


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


def thorvaldc(package: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(package / "site"), str(ROOT)])
    return subprocess.run(
        [sys.executable, "-m", "thorvaldc", *arguments],
        cwd=package,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


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


def test_every_command_of_the_page_succeeds(package: Path) -> None:
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
    commands = re.findall(r"^thorvaldc (.*)$", "".join(blocks), re.M)
    assert len(commands) >= 5
    for command in commands:
        run = thorvaldc(package, *command.split())
        assert run.returncode == 0, f"{command}\n{run.stderr}"
        assert run.stderr == "" or "warning" not in run.stderr, run.stderr


def test_the_module_is_in_the_robot(package: Path) -> None:
    assert "1 module" in thorvaldc(package, "modules", "check", "modules").stdout
    thorvaldc(package, "build", "robot.yaml", "--target", "urdf")
    model = json.loads((package / "build/narrow_rover/model.json").read_text())["model"]
    assert [wheel["radius"] for wheel in model["wheels"]] == [0.18] * 4


def test_the_backend_writes_its_file(package: Path) -> None:
    assert "parts_list" in thorvaldc(package, "targets").stdout
    thorvaldc(package, "build", "robot.yaml", "--target", "urdf,parts_list")
    with (package / "build/narrow_rover/parts.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(int(row["links"]) for row in rows) > 10
    assert "frame" in {row["module"] for row in rows}


def test_the_command_is_listed_and_runs(package: Path) -> None:
    assert "  links " in thorvaldc(package, "--help").stdout
    assert "Print the number of links" in thorvaldc(package, "links", "--help").stdout
    assert thorvaldc(package, "links", "robot.yaml").stdout.endswith(" links\n")


def test_the_code_is_explained_and_reported(package: Path) -> None:
    page = FILES["acme/codes.py"].split('"""')[3].removeprefix("\\\n")
    for name in ("AC601", "ac601", "parts-list-mesh"):
        assert thorvaldc(package, "explain", name).stdout == page
    build = ("build", "robot.yaml", "--target", "parts_list")
    assert "note[AC601] parts-list-mesh: the table leaves" in thorvaldc(package, *build).stderr
    sarif = json.loads(thorvaldc(package, *build, "--format", "sarif").stdout)
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


def test_the_calculator_limits_the_yaw_rate(package: Path) -> None:
    run = thorvaldc(package, "sim", "robot.yaml", "--twist", "0,0,1", "--duration", "4", "--json")
    assert run.returncode == 0, run.stderr
    # 1 rad/s would turn the robot by more than 3 rad in 4 s, 0.5 rad/s by less than 2.
    (robot,) = json.loads(run.stdout)["robots"]
    assert 1.5 < robot["pose_true"]["yaw"] < 2.0
