"""The command that installs an extra of this program, from where the program itself came."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from thorvaldc.diagnostics.files import read_json

NAME, RUNTIME = "thorvaldc", "thorvaldc-runtime"
"""Names of the two distributions that contain this file."""


def program_version() -> str:
    """Returns the version of this program.

    The package names its whole API for type checkers, so that the lower rooms do not import it.
    """
    return str(sys.modules["thorvaldc"].__dict__["__version__"])


class Origin(NamedTuple):
    """Where this program was installed from.

    - ``name``: name of the distribution;
    - ``place``: path of a checkout or a wheel, a URL as pip takes it, or an empty text for the name
      on a package index;
    - ``editable``: ``True`` if changes of the checkout change the program.
    """

    name: str
    place: str = ""
    editable: bool = False

    @property
    def is_local(self) -> bool:
        return self.place != "" and "://" not in self.place

    def requirement(self, extra: str = "") -> str:
        """Returns what pip installs for this program with an extra, without quotes."""
        extras = f"[{extra}]" if extra else ""
        if self.is_local:
            return f"{self.place}{extras}"
        return f"{self.name}{extras} @ {self.place}" if self.place else f"{self.name}{extras}"


def origin() -> Origin:
    """Returns where this program was installed from, as its installer has recorded it (PEP 610)."""
    from importlib.metadata import PackageNotFoundError, distribution  # a slow import

    for name in (NAME, RUNTIME):
        try:
            text = distribution(name).read_text("direct_url.json")
        except PackageNotFoundError:
            continue
        try:
            record = read_json(text) if text else {}
            return _recorded(name, record)
        except (ValueError, KeyError, TypeError, AttributeError):
            return Origin(name)
    return Origin(NAME, str(Path(__file__).resolve().parents[2]))  # run in its folder


def _recorded(name: str, record: dict[str, dict[str, object]]) -> Origin:
    if not record:
        return Origin(name)
    url = str(record["url"])
    parts = urlsplit(url)
    if "vcs_info" in record:
        vcs = record["vcs_info"]
        return Origin(name, f"{vcs['vcs']}+{url}@{vcs['commit_id']}")
    if parts.scheme != "file":
        return Origin(name, url)
    path = unquote(parts.path)
    if os.name == "nt":
        path = path.lstrip("/").replace("/", "\\")
    return Origin(name, path, bool(record.get("dir_info", {}).get("editable")))


def install_command(extra: str = "") -> str:
    """Returns the command that installs this program again with an extra, where it is installed.

    The command is that of the installer whose environment runs this program: pip, pipx or uv.
    """
    program = origin()
    requirement = _quoted(program.requirement(extra))
    if program.editable:
        requirement = f"--editable {requirement}"
    prefix = Path(sys.prefix)
    if (prefix / "pipx_metadata.json").is_file():
        return f"pipx install --force {requirement}"
    if (prefix / "uv-receipt.toml").is_file():
        return f"uv tool install --force {requirement}"
    if prefix.parent.name.startswith(("archive-v", "environments-v")):  # in the cache of uv
        return f"uvx --from {_quoted(program.requirement(extra))} thorvaldc"
    python = _quoted(sys.executable)
    pip = shutil.which("pip")
    if pip is not None and Path(pip).parent == Path(sys.executable).parent:
        return f"pip install {requirement}"
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {python} {requirement}"
    return f"{python} -m pip install {requirement}"


def _quoted(text: str) -> str:
    """Returns a word for a shell; double quotes are understood on every system."""
    if os.name == "nt" or not set(text) & set('"$`\\!'):
        return f'"{text}"' if set(text) & set(" []@&;()'") else text
    return shlex.quote(text)
