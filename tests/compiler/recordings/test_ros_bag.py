"""Bags that expand to gigabytes, or hold very many messages."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD
from tests.fuzz.products import BOMB_BYTES, mcap_with_chunk, products, zeros
from thorvaldc.compiler.pipeline import compile_file


def error_of(folder: Path, log: str) -> str:
    """Returns the message of the only error of a scenario with a log."""
    (folder / "robot.yaml").write_text(GOOD, encoding="utf-8")
    scenario = folder / "scenario.yaml"
    scenario.write_text(
        "thorvaldc: 1\nscenario: trial\nrobots: {cart: {robot: robot.yaml}}\nduration: 2 s\n"
        f"script: {{log: {log}}}\n",
        encoding="utf-8",
    )
    (diagnostic,) = compile_file(scenario).report.errors
    return diagnostic.message


@pytest.mark.parametrize(
    ("compression", "stated"),
    [
        ("zstd", BOMB_BYTES),
        ("lz4", 100),
        pytest.param("lz4", BOMB_BYTES, marks=pytest.mark.exhaustive),
        pytest.param("zstd", 100, marks=pytest.mark.exhaustive),
    ],
)
def test_a_chunk_that_expands_to_gigabytes(tmp_path: Path, compression: str, stated: int) -> None:
    data = mcap_with_chunk(compression, zeros(compression), stated)
    assert len(data) < 10_000_000
    (tmp_path / "log.mcap").write_bytes(data)
    message = error_of(tmp_path, "log.mcap")
    # rosbags 0.11.0 reads only the stated size of a chunk, and finds that more follows.
    assert message.endswith(
        ("it needs more than 0.375 GB of memory", "did not decompress full frame")
    )


def test_a_small_bag_with_very_many_messages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "log.bag").write_bytes(products()["twists.bag"])
    monkeypatch.setattr("thorvaldc.compiler.recordings.ros_bag._MEMORY_OF_SMALL_BAG", 5_000)
    monkeypatch.setattr("thorvaldc.compiler.recordings.ros_bag._EXPANSION", 0)
    assert "its messages have many times the size of the file" in error_of(tmp_path, "log.bag")


@pytest.mark.parametrize("kind", ["pipe", "huge"])
def test_a_refused_file_is_not_read(tmp_path: Path, kind: str) -> None:
    """Neither by the reader nor for the hash of the sources."""
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_bytes(products()["bag_db3/metadata.yaml"])
    if kind == "pipe":
        os.mkfifo(bag / "bag_db3.db3")
    else:
        (bag / "bag_db3.db3").touch()
        os.truncate(bag / "bag_db3.db3", 2**36)
    expected = "it is a pipe" if kind == "pipe" else "has more than 256 MB"
    assert expected in error_of(tmp_path, "bag")
