"""``thorvaldc check -`` reads the standard input."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from tests.cli.conftest import BAD, GOOD, Command, Result


def test_check_reads_the_standard_input(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(text: str, *options: str) -> Result:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        return thorvaldc("check", "-", *options)

    good = read(GOOD)
    assert good.status == 0
    assert good.out.startswith("-: good, 4 wheels")
    bad = read(BAD)
    assert bad.status == 1
    shown = thorvaldc("check", "bad.yaml").out
    assert bad.out == shown.replace("bad.yaml", "-")  # with excerpts of the lines
    Path("parts").mkdir()
    assert read(GOOD + "library: [parts]\n").status == 0  # paths start in the working folder
    assert not Path("-").exists()
