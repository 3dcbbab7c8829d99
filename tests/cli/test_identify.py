"""`thorvaldc can identify` on a bus in another process."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.cli.test_bus import running
from tests.simulation.bus.robots import CIA402


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Runs the bus of a robot of which one drive was replaced."""
    folder = tmp_path_factory.mktemp("bus")
    real = CIA402.replace('serial: "0x103"', 'serial: "0x777"')
    (folder / "real.yaml").write_text(real, encoding="utf-8")
    with running(folder, "real.yaml", "--channel", "shed"):
        yield folder


@pytest.fixture
def workshop(bus: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(bus))
    folder = tmp_path / "robots"
    for name, text in (
        ("alpha", CIA402.replace("with_cia402", "alpha")),
        ("beta", CIA402.replace("with_cia402", "beta").replace('"0x10', '"0x50')),
        ("broken", CIA402.replace("length: 1.1 m", "length: 1.1 kg")),
        (".hidden", CIA402),
    ):
        (folder / name).mkdir(parents=True)
        (folder / name / "robot.yaml").write_text(text, encoding="utf-8")
    (folder / "fleet.yaml").write_text(
        "thorvaldc: 1\nname: both\nrobots: {a: {robot: alpha/robot.yaml}}\n", encoding="utf-8"
    )
    (folder / "notes.yaml").write_text("modules: none\n", encoding="utf-8")
    (folder / "scenario.yaml").write_bytes(b"\xff\xfe")
    return folder


@pytest.mark.slow
def test_the_file_of_a_robot_after_a_repair(thorvaldc: Command, workshop: Path) -> None:
    result = thorvaldc("can", "identify", str(workshop), "--bus", "sim:shed")
    assert result.status == 1
    lines = result.out.splitlines()
    assert lines[1].split()[1:] == ["alpha", "6", "of", "7", "3", "1"]
    assert lines[2].split()[1] == "beta"
    assert "this is most likely alpha" in result.out
    assert 'write `serial: "0x777"` at robot.yaml:17' in result.out
    assert "broken/robot.yaml is left out: it has errors" in result.err
    assert "fleet.yaml" not in result.err
    assert ".hidden" not in result.out + result.err
    fleet = str(workshop / "fleet.yaml")
    named = thorvaldc("can", "identify", str(workshop), fleet, "--bus", "sim:shed")
    assert "fleet.yaml is left out: it is no robot" in named.err
    file = workshop / "alpha" / "robot.yaml"
    text = file.read_text(encoding="utf-8").replace('"0x103"', '"0x777"')
    file.write_text(text, encoding="utf-8")
    again = thorvaldc("can", "identify", str(workshop), "--bus", "main=sim:shed", "--json")
    assert again.status == 0
    first, second = json.loads(again.out)
    assert (first["robot"], first["differences"], first["serials"]) == ("alpha", [], 4)
    assert second["robot"] == "beta"


@pytest.mark.slow
def test_a_model_of_a_build_is_the_same_robot(thorvaldc: Command, workshop: Path) -> None:
    folder = workshop / "alpha"
    output = str(folder / "build")
    build = thorvaldc("build", str(folder / "robot.yaml"), "--target", "can", "-o", output)
    assert build.status == 0, build.err
    result = thorvaldc("can", "identify", str(folder), "--bus", "sim:shed", "--json")
    (match,) = json.loads(result.out)
    assert match["file"].endswith("robot.yaml")
    (folder / "robot.yaml").unlink()
    result = thorvaldc("can", "identify", str(folder), "--bus", "sim:shed", "--json")
    (match,) = json.loads(result.out)
    assert match["file"].endswith("model.json")


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("none",), 3, "none does not exist"),
        ((".",), 2, "there is no robot file with a bus"),
        (("{workshop}", "--bitrate", "250"), 2, "the files have buses with 500 kbit/s"),
        (("{workshop}", "--bus", "left=sim:shed"), 2, "there is no robot file with a bus left"),
        (("{workshop}", "--bus", "main=virtual"), 2, "`virtual` simulates the robot of one file"),
        (("{workshop}", "--bus", "virtual"), 2, "`virtual` simulates the robot of one file"),
        (("{workshop}", "--bus", "sim:other"), 3, "sim:other"),
    ],
)
def test_calls_that_are_refused(
    thorvaldc: Command, workshop: Path, arguments: tuple[str, ...], status: int, text: str
) -> None:
    for path in Path().glob("*.yaml"):
        path.unlink()
    (workshop / "alpha" / "robot.yaml").rename(workshop / "robot.yaml")
    words = [word.format(workshop=workshop) for word in arguments]
    if "--bus" not in words:
        words += ["--bus", "sim:shed"]
    if words[0] == ".":
        workshop.rename(Path("..").resolve() / "moved")
    result = thorvaldc("can", "identify", *words)
    assert text in " ".join(result.err.split())
    assert result.status == status, result.err


def test_files_with_two_bit_rates_need_the_right_one(thorvaldc: Command, workshop: Path) -> None:
    file = workshop / "beta" / "robot.yaml"
    text = file.read_text(encoding="utf-8")
    file.write_text(
        text.replace("modules:", "buses: {main: {bitrate: 1 Mbit/s}}\nmodules:", 1), "utf-8"
    )
    result = thorvaldc("can", "identify", str(workshop), "--bus", "sim:shed")
    assert result.status == 2
    assert "500, 1000 kbit/s; say which one it is" in " ".join(result.err.split())
    result = thorvaldc(
        "can", "identify", str(workshop), "--bus", "sim:shed", "--bitrate", "500", "--json"
    )
    assert result.status == 1, result.err
    assert [match["robot"] for match in json.loads(result.out)] == ["alpha"]
