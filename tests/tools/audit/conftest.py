"""Expansion of xacro files for many audits."""

from __future__ import annotations

from functools import partial

import pytest

from thorvaldc.compiler.extras import xacro_expand
from thorvaldc.compiler.sandbox.worker_process import limited_worker


@pytest.fixture
def quick_xacro(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expands xacro files in this process, as in a web browser: a process takes longer to start
    than an audit."""
    monkeypatch.setattr(
        xacro_expand, "limited_worker", partial(limited_worker, has_processes=False)
    )
