"""Broken and hostile files of every kind: a sample of ``make fuzz``."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.generator import case_of, kinds
from tests.fuzz.judge import judge, prepare
from tests.slow import mostly_slow
from thorvaldc.cli.main import all_commands
from thorvaldc.schema import KINDS

pytestmark = pytest.mark.xdist_group("fuzz")  # every process would make the valid files again
SAMPLE = 100
BATCH = 10
# These commands read no file, read what another command of the list reads in the same way, or need
# a terminal, a driver or a bus of another process.
NOT_RUN = {
    *("new", "targets", "schema", "explain", "call", "demo", "teleop", "bus", "render"),
    *("modules show", "modules new", "can monitor", "preview", "lsp", "study run", "study show"),
    *("can identify", "can commission", "usd", "install", "uninstall", "status", "logs"),
}


@pytest.mark.slow
def test_every_kind_of_document_is_broken() -> None:
    assert {kind.schema for kind in kinds()} >= set(KINDS)


def test_every_command_that_reads_files_is_run() -> None:
    names = {entry.name for entry in all_commands() if entry.target}
    run = set()
    for line in (line for kind in kinds() for line in kind.commands):
        first, second, *_ = [*line.split(), ""]
        run.add(f"{first} {second}" if f"{first} {second}" in names else first)
    assert names - run == NOT_RUN - run


def test_cases_are_repeatable() -> None:
    for seed in range(20):
        assert case_of(seed) == case_of(seed)


@pytest.mark.parametrize("first", mostly_slow(range(0, SAMPLE, BATCH), slow=2))
def test_hostile_files(first: int, tmp_path: Path) -> None:
    prepare()
    for seed in range(first, first + BATCH):
        case = case_of(seed)
        verdict = judge(case)
        assert not verdict.violations, (
            f"seed {seed}: {case.kind.name}, {case.description}: {case.command}\n"
            f"{'; '.join(verdict.violations)}\n{verdict.output[-2000:]}"
        )


@pytest.mark.parametrize("text", ["Traceback (most recent call last)", "internal error: x"])
def test_the_judge_sees_a_bug(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> int:
        print(text)
        Path("left").touch()
        return 1

    monkeypatch.setattr("tests.fuzz.judge.run_command", fail)
    verdict = judge(case_of(0))
    assert len(verdict.violations) == 3, verdict
    assert verdict.violations[2] == "changed left"
