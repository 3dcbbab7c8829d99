"""Commissioning of several units of one design."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.cli.conftest import Command
from tests.tools.commission.test_commission_command import folder  # noqa: F401


def test_the_report_of_a_unit_does_not_count_for_another_of_its_design(
    thorvaldc: Command,
    folder: Path,  # noqa: F811
) -> None:
    for name in ("first", "second"):
        (folder / f"{name}.yaml").write_text(f"thorvaldc: 1\nextends: robot.yaml\nname: {name}\n")
    first, second = str(folder / "first.yaml"), str(folder / "second.yaml")
    options = ("--bus", "virtual", "--fast", "--duration", "1s", "--commissioned")
    assert thorvaldc("can", "commission", first, "--bus", "virtual").status == 0
    assert thorvaldc("run", first, *options).status == 0
    assert thorvaldc("run", second, *options).status == 1
    shutil.copy(folder / "first.commission.json", folder / "second.commission.json")
    refused = thorvaldc("run", second, *options)
    assert refused.status == 1
    assert "left_drive_propulsion was checked at the robot first" in refused.err
    # Without a name of its own, no unit can claim the report of its design or of another unit.
    (folder / "second.yaml").write_text("thorvaldc: 1\nextends: robot.yaml\n")
    unnamed = thorvaldc("run", second, *options)
    assert unnamed.status == 1
    assert "the robot document has no `name`" in unnamed.err
