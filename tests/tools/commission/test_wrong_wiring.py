"""`can commission` finds controllers that are wired otherwise than the robot file says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.examples import FOLDER
from tests.slow import mostly_slow


@pytest.mark.parametrize("exchanged", mostly_slow([False, True]))
def test_the_serial_numbers_of_the_labels_decide_which_wheel_turns(
    exchanged: bool, thorvaldc: Command, tmp_path: Path
) -> None:
    """New drives, whose serial numbers a person writes into the file, right and exchanged."""
    file = tmp_path / "robot.yaml"
    text = re.sub(r', serial: "\w+"', "", (FOLDER / "lss/robot.yaml").read_text(encoding="utf-8"))
    file.write_text(text, encoding="utf-8")
    store = ("robot.yaml", "--store", "memory.json", "--bus")
    assert thorvaldc("can", "scan", *store, "virtual:delivered", "--active").status == 1
    labels = json.loads((tmp_path / "memory.json").read_text(encoding="utf-8"))
    serials = [labels[f"{side}_controller"]["serial"] for side in ("left", "right")]
    for number, serial in enumerate(reversed(serials) if exchanged else serials, 1):
        text = text.replace(f"can: {{id: {number}}}", f'can: {{id: {number}, serial: "{serial}"}}')
    file.write_text(text, encoding="utf-8")
    assert thorvaldc("can", "flash", *store, "virtual:delivered", "--apply", "--yes").status == 0
    assert thorvaldc("can", "scan", *store, "virtual", "--active").status == 0, "they cannot know"
    checked = thorvaldc("can", "commission", *store, "virtual")
    assert checked.status == int(exchanged)
    finding = "left_drive_propulsion and right_drive_propulsion are exchanged"
    assert (finding in checked.out) is exchanged
