"""Checks the accessibility of a page in a browser with axe-core."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

from tests.outside_tools import path_of, without

PACKAGE = Path(__file__).parent / "docs" / "axe"


def axe_script(folder: Path) -> str:
    """Installs axe-core in a folder and returns its text.  Skips the test if it cannot."""
    for name in ("package.json", "package-lock.json"):
        shutil.copy(PACKAGE / name, folder)
    install = subprocess.run(
        [path_of("npm"), "ci", "--ignore-scripts", "--no-audit", "--no-fund"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if install.returncode != 0:
        without(f"axe-core cannot be installed: {install.stderr[-300:]}")
    return (folder / "node_modules/axe-core/axe.min.js").read_text(encoding="utf-8")


def violations(page: Any, axe: str, label: str) -> list[str]:
    """Returns the violations in a page of playwright, whose policy must be off (``bypass_csp``)."""
    page.evaluate(axe)
    result = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [
        f"{label}: {violation['id']}: {node['html'][:200]}"
        for violation in result["violations"]
        for node in violation["nodes"][:3]
    ]
