"""Which part of thorvaldc is installed: all of it, or the runtime alone (`thorvaldc-runtime`).

The computer of a robot needs neither the compiler nor the simulation.  The runtime wheel has the
packages ``runtime``, ``can``, ``commissioning``, ``model``, ``diagnostics``, ``cli``,
``tools.monitor`` and ``tools.teleoperation``.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import NoReturn

from thorvaldc.cli.exits import OutsideError


def is_runtime_only() -> bool:
    """Whether the compiler and the simulation are missing."""
    return find_spec("thorvaldc.compiler") is None


def require_full_installation(feature: str) -> NoReturn:
    """Raises ``OutsideError`` for a feature that the runtime alone does not have."""
    raise OutsideError(
        f"{feature} is not available: this installation is the runtime alone;"
        " `pip install thorvaldc` installs the rest"
    )


def check_full_installation(feature: str) -> None:
    """Raises ``OutsideError`` where the compiler and the simulation are not installed."""
    if is_runtime_only():
        require_full_installation(feature)
