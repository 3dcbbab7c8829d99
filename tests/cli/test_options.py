"""Options: times, and new values of a file."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import typer

from tests.cli.conftest import GOOD, Command
from thorvaldc.cli.options import parse_duration, parse_time


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("5", 5.0),
        ("1.5 sec", 1.5),
        ("300ms", 0.3),
        ("20 us", 20e-6),
        ("2 min", 120.0),
        ("1 minute", 60.0),
        ("1 h", 3600.0),
        ("2 hours", 7200.0),
    ],
)
def test_units_of_times(text: str, seconds: float) -> None:
    assert parse_time(text) == seconds


def test_the_longest_duration_is_a_day() -> None:
    assert parse_duration("24 h", "--duration") == 24 * 3600.0
    for text in ("24.01 h", "0 s", "-1 s"):
        with pytest.raises(typer.BadParameter, match="is not between 0 and 86400 s"):
            parse_duration(text, "--duration")
    assert parse_duration("2 s", "--interval", least=2.0) == 2.0
    with pytest.raises(typer.BadParameter, match="is not between 2 and"):
        parse_duration("1.99 s", "--interval", least=2.0)


@pytest.mark.parametrize("command", ["check", "build", "sim"])
def test_a_value_of_the_file_is_replaced(thorvaldc: Command, command: str) -> None:
    more = {"build": ["-o", "out", "-t", "can"], "sim": ["--ideal", "--duration", "100 ms"]}
    arguments = [command, "good.yaml", *more.get(command, [])]
    values = ["--set", "driver.rate=20 Hz", "--set", "modules.battery.mount.xyz=[0, 0.2, 0.07]"]
    assert thorvaldc(*arguments, *values).status == 0
    wrong = thorvaldc(*arguments, "--set", "driver.rate=5 kg")
    assert wrong.status == 1
    assert "--set driver.rate" in wrong.out + wrong.err
    assert "is not PATH=VALUE" in thorvaldc(*arguments, "--set", "driver.rate").err
    if command == "build":
        model = json.loads(Path("out/model.json").read_text())["model"]
        assert model["driver"]["rate"] == 20.0
        fresh = thorvaldc(*arguments, *values, "--check")
        assert fresh.status == 0
        stale = thorvaldc(*arguments, "--check")
        assert stale.status == 1


def test_a_value_is_set_once(thorvaldc: Command) -> None:
    settings = ("--set", "driver.rate=20 Hz", "--set", "driver.rate=50 Hz")
    twice = thorvaldc("check", "good.yaml", *settings)
    assert twice.status == 2
    assert "driver.rate is set twice" in twice.err


AUTOMATIC = re.sub(r", can: \d", "", GOOD)
"""The ids of the nodes are automatic: hardware has those of the lock file."""


def test_the_ids_of_a_robot_with_other_values_are_not_pinned(thorvaldc: Command) -> None:
    Path("good.yaml").write_text(AUTOMATIC)
    lock = Path("good.lock.yaml")
    without = ("build", "good.yaml", "-t", "can", "--set", "modules.rr.type=assembly/fixed_drive")
    assert thorvaldc(*without).status == 0
    assert not lock.exists()
    assert thorvaldc("build", "good.yaml", "-t", "can").status == 0
    pinned = lock.read_bytes()
    assert thorvaldc(*without).status == 0
    assert lock.read_bytes() == pinned
