"""The command that installs an extra: that of the installer, with the place of the program."""

from __future__ import annotations

import json
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from thorvaldc.diagnostics.installation import install_command

COMMIT = "0123456789abcdef0123456789abcdef01234567"
RECORDS: dict[str, tuple[Any, str]] = {
    "index": (None, '"thorvaldc[lsp]"'),
    "checkout": ({"url": "file:///home/a%20b", "dir_info": {}}, '"/home/a b[lsp]"'),
    "editable": (
        {"url": "file:///src", "dir_info": {"editable": True}},
        '--editable "/src[lsp]"',
    ),
    "wheel": (
        {"url": "file:///w/thorvaldc-0.1.0-py3-none-any.whl", "archive_info": {}},
        '"/w/thorvaldc-0.1.0-py3-none-any.whl[lsp]"',
    ),
    "url": (
        {"url": "https://example.org/t.whl", "archive_info": {}},
        '"thorvaldc[lsp] @ https://example.org/t.whl"',
    ),
    "git": (
        {
            "url": "https://example.org/t.git",
            "vcs_info": {"vcs": "git", "commit_id": COMMIT},
        },
        f'"thorvaldc[lsp] @ git+https://example.org/t.git@{COMMIT}"',
    ),
    "unreadable": ("{", '"thorvaldc[lsp]"'),
    "another form": ([1], '"thorvaldc[lsp]"'),
}


def installed(
    monkeypatch: pytest.MonkeyPatch, record: Any, prefix: Path, name: str = "thorvaldc"
) -> None:
    """Lets the program run in an environment with a record of its installation."""

    def distribution(wanted: str) -> Any:
        if wanted != name:
            raise PackageNotFoundError(wanted)
        text = record if isinstance(record, str | None) else json.dumps(record)
        return SimpleNamespace(read_text=lambda file: text)

    monkeypatch.setattr("importlib.metadata.distribution", distribution)
    (prefix / "bin").mkdir(parents=True)
    (prefix / "bin" / "pip").touch(0o755)
    monkeypatch.setattr(sys, "prefix", str(prefix))
    monkeypatch.setattr(sys, "executable", str(prefix / "bin" / "python"))
    monkeypatch.setenv("PATH", str(prefix / "bin"))


@pytest.mark.parametrize("kind", RECORDS)
def test_the_place_of_the_program(
    kind: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    record, requirement = RECORDS[kind]
    installed(monkeypatch, record, tmp_path / "venv")
    assert install_command("lsp") == f"pip install {requirement}"


def test_the_installer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    wheel = RECORDS["wheel"][0]
    name = RECORDS["wheel"][1]
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)  # with pip
    for marker, command in (
        ("pipx_metadata.json", f"pipx install --force {name}"),
        ("uv-receipt.toml", f"uv tool install --force {name}"),
    ):
        prefix = tmp_path / marker
        installed(monkeypatch, wheel, prefix)
        (prefix / marker).touch()
        assert install_command("lsp") == command
    installed(monkeypatch, wheel, tmp_path / "archive-v0" / "x")
    assert install_command("lsp") == f"uvx --from {name} thorvaldc"
    # The environment is not active: `pip` is that of another one.
    installed(monkeypatch, wheel, tmp_path / "venv")
    monkeypatch.setenv("PATH", "/usr/bin")
    assert install_command("lsp") == f"{tmp_path}/venv/bin/python -m pip install {name}"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)  # without pip
    python = f"{tmp_path}/venv/bin/python"
    assert install_command("lsp") == f"uv pip install --python {python} {name}"


def test_the_runtime_alone_and_a_folder_with_the_sources(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed(monkeypatch, None, tmp_path / "venv", "thorvaldc-runtime")
    assert install_command("serial") == 'pip install "thorvaldc-runtime[serial]"'
    installed(monkeypatch, None, tmp_path / "other", "something-else")
    root = Path(__file__).resolve().parents[2]
    assert install_command("serial") == f'pip install "{root}[serial]"'
