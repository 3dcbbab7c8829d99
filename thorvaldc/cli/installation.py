"""Detection of the installed package: all of thorvaldc, or only the runtime (`thorvaldc-runtime`).

The runtime package is for the computer of a robot, which needs neither the compiler nor the
simulation. The runtime wheel contains the packages ``runtime``, ``can``, ``commissioning``,
``model``, ``diagnostics``, ``cli``, ``tools.monitor``, ``tools.service_calls`` and
``tools.teleoperation``.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import NoReturn

from thorvaldc.cli.exits import OutsideError

# Both packages contain the same files, so a computer must not have both.
REPLACE_RUNTIME = "to replace it: `pip uninstall thorvaldc-runtime`, then `pip install thorvaldc`"


def is_runtime_only() -> bool:
    """Returns whether only the runtime package is installed, without the compiler and the
    simulation."""
    return find_spec("thorvaldc.compiler") is None


def require_full_installation(feature: str) -> NoReturn:
    """Raises ``OutsideError`` for a feature that needs the compiler or the simulation."""
    raise OutsideError(
        f"{feature} is not available: this installation is the runtime alone; {REPLACE_RUNTIME}"
    )


def check_full_installation(feature: str) -> None:
    """Raises ``OutsideError`` if only the runtime package is installed."""
    if is_runtime_only():
        require_full_installation(feature)
