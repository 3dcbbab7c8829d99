"""`build` pins automatic ids in a lock file; no other command writes beside the robot file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.cli.conftest import GOOD, Command
from thorvaldc.compiler.pipeline import compile_file

AUTO = GOOD.replace(", can: 3", "").replace(", can: 4", "")
LOCK = Path("auto.lock.yaml")


@pytest.fixture(autouse=True)
def robot(thorvaldc: Command) -> None:
    Path("auto.yaml").write_text(AUTO, encoding="utf-8")


def pins() -> dict[str, int]:
    document = yaml.safe_load(LOCK.read_text())
    assert document["thorvaldc_lock"] == 1
    return dict(document["addresses"]["main"]["canopen"])


def test_build_pins_automatic_ids(thorvaldc: Command) -> None:
    result = thorvaldc("build", "auto.yaml", "-o", "out")
    assert (result.status, result.err) == (0, "")
    assert "auto.lock.yaml: automatic ids are pinned" in result.out
    assert pins() == {"rl.controller": 3, "rr.controller": 4}
    # A new module before the others, and one with an id set by hand.
    text = AUTO.replace("  fl:", "  io: {type: io/board}\n  new: {type: io/board, can: 5}\n  fl:")
    Path("auto.yaml").write_text(text.replace("  rr:", "  rr2:"), encoding="utf-8")
    assert thorvaldc("build", "auto.yaml", "-o", "out").status == 0
    assert pins() == {"io": 32, "rl.controller": 3, "rr2.controller": 4}


def test_two_builds_are_equal(thorvaldc: Command) -> None:
    outputs = []
    for _ in range(2):
        result = thorvaldc("build", "auto.yaml", "-o", "out")
        outputs.append({p: p.read_bytes() for p in Path("out").rglob("*") if p.is_file()})
    assert outputs[0] == outputs[1]  # the manifest with the sources' hash, too
    assert "pinned" not in result.out


def test_the_hash_of_the_sources_includes_the_lock_file(thorvaldc: Command) -> None:
    hashes = set()
    for node_id in (3, 9):
        LOCK.write_text(
            f"thorvaldc_lock: 1\naddresses: {{main: {{canopen: {{rl.controller: {node_id}}}}}}}\n"
        )
        thorvaldc("build", "auto.yaml", "-o", "out", "--target", "ros2")
        hashes.add(json.loads(Path("out/manifest.json").read_text())["source_sha256"])
    assert len(hashes) == 2


@pytest.mark.parametrize(
    "arguments",
    [("check",), ("check", "--strict"), ("sim", "--duration", "0.1", "--ideal")],
    ids=" ".join,
)
def test_other_commands_write_no_lock_file(thorvaldc: Command, arguments: tuple[str, ...]) -> None:
    bytes_before = sorted(os.listdir())
    thorvaldc(arguments[0], "auto.yaml", *arguments[1:])
    assert sorted(os.listdir()) == bytes_before


def test_check_reads_the_lock_file(thorvaldc: Command) -> None:
    LOCK.write_text("thorvaldc_lock: 1\naddresses: {main: {canopen: {rl.controller: 2}}}\n")
    result = thorvaldc("check", "auto.yaml")
    assert result.status == 1
    assert "auto.yaml:6:" in result.out
    assert "TV509" in result.out
    assert "auto.lock.yaml:2:" in result.out


def test_a_pattern_may_name_the_lock_files_too(thorvaldc: Command) -> None:
    thorvaldc("build", "auto.yaml")
    files = sorted(str(path) for path in Path().glob("auto*.yaml"))
    assert files == ["auto.lock.yaml", "auto.yaml"]
    for command in (["check", "--strict"], ["build"], ["build", "--check"]):
        result = thorvaldc(*command, *files)
        assert (result.status, result.err) == (0, ""), command
    assert "TV218" in thorvaldc("check", "auto.lock.yaml").out  # alone it is a mistake


def test_a_build_that_fails_pins_nothing(thorvaldc: Command) -> None:
    Path("auto.yaml").write_text(AUTO.replace("can: 2", "can: 1"), encoding="utf-8")
    assert thorvaldc("build", "auto.yaml").status == 1
    assert not LOCK.exists()
    assert compile_file("auto.yaml").locks == {}


def test_no_lock_file_if_every_id_is_set(thorvaldc: Command) -> None:
    thorvaldc("build", "good.yaml")
    assert not list(Path().glob("*.lock.yaml"))


def test_ids_that_are_set_later_leave_the_lock_file(thorvaldc: Command) -> None:
    thorvaldc("build", "auto.yaml")
    Path("auto.yaml").write_text(GOOD, encoding="utf-8")
    assert thorvaldc("build", "auto.yaml").status == 0
    assert yaml.safe_load(LOCK.read_text())["addresses"] == {}


@pytest.fixture
def read_only(robot: None) -> Iterator[Path]:
    folder = Path("robots")
    folder.mkdir()
    (folder / "auto.yaml").write_text(AUTO, encoding="utf-8")
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)


def test_a_folder_that_is_read_only_is_a_warning(thorvaldc: Command, read_only: Path) -> None:
    result = thorvaldc("build", "robots/auto.yaml", "-o", "out")
    assert result.status == 0
    assert "TV515" in result.err
    assert "robots/auto.lock.yaml" in result.err
    assert Path("out/can/canmap.json").exists()
    assert os.listdir(read_only) == ["auto.yaml"]
    report = json.loads(thorvaldc("build", "robots/auto.yaml", "--format", "json").out)
    assert "TV515" in json.dumps(report)


def test_a_lock_file_that_is_a_folder_is_an_error(thorvaldc: Command) -> None:
    LOCK.mkdir()
    result = thorvaldc("build", "auto.yaml")
    assert result.status == 1
    assert "auto.lock.yaml" in result.err
    assert "Traceback" not in result.err


def test_a_linked_lock_file_is_written_at_its_target(thorvaldc: Command) -> None:
    Path("elsewhere").mkdir()
    Path("elsewhere/ids.yaml").write_text("thorvaldc_lock: 1\naddresses: {}\n")
    LOCK.symlink_to("elsewhere/ids.yaml")
    assert thorvaldc("build", "auto.yaml").status == 0
    assert LOCK.is_symlink()
    assert pins() == {"rl.controller": 3, "rr.controller": 4}


def test_each_robot_of_a_fleet_has_its_lock_file(thorvaldc: Command) -> None:
    Path("fleet.yaml").write_text(
        "thorvaldc: 1\nname: two\nrobots:\n"
        "  a: {robot: auto.yaml, xyz: [0, 0, 0]}\n  b: {robot: auto.yaml, xyz: [0, 3, 0]}\n"
    )
    assert thorvaldc("build", "fleet.yaml").status == 0
    assert pins() == {"rl.controller": 3, "rr.controller": 4}
    assert sorted(p.name for p in Path().glob("*.lock.yaml")) == ["auto.lock.yaml"]
