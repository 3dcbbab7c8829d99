"""thorvaldc: a declarative compiler for modular robots.

``compile(path)`` returns a ``Compilation`` (``model``, ``report``), and ``emit(model, targets,
report)`` the files of the targets in memory.  ``Simulation(model, files)`` drives them in MuJoCo.
``BaseDriver(robot, base)`` drives a base, such as ``SimBase(robot)``, with a ``Twist``.

``import thorvaldc`` loads none of them; each name is imported at its first use.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"
__all__ = ["BaseDriver", "SimBase", "Simulation", "Twist", "__version__", "compile", "emit"]

_API = {
    "compile": "thorvaldc.compiler.pipeline:compile_file",
    "emit": "thorvaldc.compiler.pipeline:emit",
    "Simulation": "thorvaldc.simulation.simulation_run:Simulation",
    "BaseDriver": "thorvaldc.runtime.driver:BaseDriver",
    "SimBase": "thorvaldc.simulation.physics.sim_base:SimBase",
    "Twist": "thorvaldc.runtime.se2:Twist",
}


def __getattr__(name: str) -> Any:
    if name not in _API:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    module, attribute = _API[name].split(":")
    return getattr(import_module(module), attribute)
