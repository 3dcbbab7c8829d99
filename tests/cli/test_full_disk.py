"""Commands that write files while the disk becomes full."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.full_disk import full_disk
from tests.outside_tools import require
from tests.slow import one_quick_of

OLD = "of an earlier command"
DRIVE = ("sim", "good.yaml", "--twist", "0.3,0,0", "--duration", "0.5")


@pytest.mark.parametrize(
    ("arguments", "file"),
    one_quick_of(
        3,
        [
            (("view", "good.yaml", "-o"), "page.html"),
            (("render", "good.yaml", "-o"), "picture.png"),
            (("diff", "good.yaml", "other.yaml", "--html"), "page.html"),
            ((*DRIVE, "--plot"), "plot.png"),
            ((*DRIVE, "--plot"), "plot.svg"),
            ((*DRIVE, "--video"), "video.gif"),
            ((*DRIVE, "--record"), "record.csv"),
            ((*DRIVE, "--log"), "log.csv"),
        ],
    ),
)
def test_a_full_disk_leaves_the_old_file_and_is_reported_with_its_name(
    thorvaldc: Command, arguments: tuple[str, ...], file: str
) -> None:
    if file.startswith(("picture", "video")):
        require("OpenGL")
    Path("good.yaml").write_text(GOOD)
    Path("other.yaml").write_text(GOOD.replace("name: good", "name: other"))
    Path(file).write_text(OLD)
    with full_disk(400):
        result = thorvaldc(*arguments, file)
    assert result.status == 3
    assert result.err.startswith("error: ")
    assert result.err.endswith(f"{file}: File too large\n")
    assert result.err.count("\n") == 1
    assert Path(file).read_text() == OLD
    assert not list(Path().glob(".*"))


def test_a_full_disk_leaves_no_half_project(thorvaldc: Command) -> None:
    with full_disk(2000):
        result = thorvaldc("new", "field")
    assert result.status == 3
    assert "field/" in result.err
    assert "File too large" in result.err
    assert not [path for path in Path("field").rglob("*") if path.is_file()]
