from __future__ import annotations

from tests.backends.conftest import written

__all__ = ["written"]
