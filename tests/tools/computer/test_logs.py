"""What the service of an installed robot has written."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.outside_tools import JOURNAL_REMOTE, require
from tests.tools.computer.conftest import Programs

MACHINE = "0123456789abcdef" * 2
ENTRY = """\
__REALTIME_TIMESTAMP={time}
__MONOTONIC_TIMESTAMP={time}
_BOOT_ID={machine}
_MACHINE_ID={machine}
_HOSTNAME=robot
SYSLOG_IDENTIFIER=thorvaldc
_SYSTEMD_UNIT={unit}
MESSAGE={text}

"""


@pytest.fixture
def journal(root: Path, thorvaldc: Command) -> Path:
    """The file of the journal of a computer with an installed robot."""
    thorvaldc("install", "good.yaml", "--root", str(root))
    path = root / "var/log/journal" / MACHINE / "system.journal"
    path.parent.mkdir(parents=True)
    return path


def test_the_journal_of_a_computer_is_read(
    root: Path, journal: Path, thorvaldc: Command, capfd: pytest.CaptureFixture[str]
) -> None:
    require("journalctl")
    (root / "etc/machine-id").write_text(f"{MACHINE}\n", encoding="utf-8")
    lines = [f"line {number}" for number in range(250)]
    entries = [(f"{1_700_000_000_000_000 + n}", line) for n, line in enumerate(lines)]
    export = "".join(
        ENTRY.format(time=time, machine=MACHINE, text=text, unit="thorvaldc-good.service")
        + ENTRY.format(time=time, machine=MACHINE, text="unrelated", unit="other.service")
        for time, text in entries
    )
    write = [str(JOURNAL_REMOTE), "--output", str(journal), "-"]
    subprocess.run(write, input=export.encode(), check=True, capture_output=True)
    outcome = thorvaldc("logs", "good", "--root", str(root))
    assert outcome.status == 0, outcome.err
    shown = capfd.readouterr().out.splitlines()
    assert [line.partition(" thorvaldc: ")[2] for line in shown] == lines[-200:]


def test_journalctl_is_asked_for_the_units_of_all_robots(
    root: Path,
    journal: Path,
    thorvaldc: Command,
    programs: Programs,
    capfd: pytest.CaptureFixture[str],
) -> None:
    journal.touch()
    Path("good.yaml").write_text(GOOD.replace("name: good", "name: better"), encoding="utf-8")
    thorvaldc("install", "good.yaml", "--root", str(root))
    programs(journalctl='echo "$*"')
    units = "--unit=thorvaldc-better.service --unit=thorvaldc-good.service"
    assert thorvaldc("logs", "--root", str(root)).status == 0
    assert capfd.readouterr().out == f"--no-pager --lines=200 {units} --root={root}\n"
    assert thorvaldc("logs", "good", "--follow", "--root", str(root)).status == 0
    assert capfd.readouterr().out.endswith(f"={root} --follow\n")


def test_what_is_missing_is_named(
    root: Path,
    journal: Path,
    thorvaldc: Command,
    programs: Programs,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(*words: str) -> tuple[int, str]:
        outcome = thorvaldc("logs", *words, "--root", str(root))
        assert outcome.out == ""
        return outcome.status, outcome.err

    assert refused() == (
        3,
        f"error: there is no journal in /var/log/journal or /run/log/journal below {root}\n",
    )
    status, text = refused("goood")
    assert (status, "did you mean `good`?" in text) == (2, True)
    journal.touch()
    programs(journalctl="exit 1")
    assert refused() == (3, "error: journalctl ended with status 1\n")
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *_: False)  # root may read everything
        status, text = refused()
    assert (status, "usermod --append --groups systemd-journal" in text) == (3, True)
    monkeypatch.setenv("PATH", str(tmp_path))
    status, text = refused()
    assert (status, "there is no journalctl" in text) == (3, True)
    thorvaldc("uninstall", "good", "--root", str(root))
    assert refused() == (1, "no robot is installed on this computer\n")
