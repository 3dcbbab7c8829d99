"""The public names of `import thorvaldc`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import thorvaldc

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/4wd4ws_slim/robot.yaml"


def test_compile_emit_and_simulate() -> None:
    compilation = thorvaldc.compile(EXAMPLE)
    files = thorvaldc.emit(compilation.model, ["mjcf"], compilation.report)
    result = thorvaldc.Simulation(compilation.model, files).run(0.5, _forward())
    assert result.robots[0].path_true > 0.0


def _forward() -> object:
    from thorvaldc.runtime.se2 import Twist

    return Twist(0.5, 0.0, 0.0)


def test_all_public_names_exist() -> None:
    assert all(getattr(thorvaldc, name) is not None for name in thorvaldc.__all__)
    with pytest.raises(AttributeError, match="unknown_name"):
        thorvaldc.unknown_name  # noqa: B018


def test_the_import_loads_no_other_module() -> None:
    script = "import sys, thorvaldc; print([m for m in sys.modules if m.startswith('thorvaldc.')])"
    process = subprocess.run(
        [sys.executable, "-c", script],
        check=True,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": ":".join(sys.path)},
    )
    assert process.stdout == "[]\n"


def test_script_of_the_readme_runs(tmp_path: Path) -> None:
    readme = (EXAMPLE.parents[2] / "README.md").read_text(encoding="utf-8")
    document = readme.split("```yaml\n", 1)[1].split("```", 1)[0]
    (tmp_path / "first.yaml").write_text(document, encoding="utf-8")
    script = readme.split("```python\n", 1)[1].split("```", 1)[0]
    process = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": ":".join(sys.path)},
    )
    assert float(process.stdout) > 2.0
