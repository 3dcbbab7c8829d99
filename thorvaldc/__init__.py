"""thorvaldc: a declarative compiler for modular robots.

- ``load(path)`` returns the ``Robot`` of a robot.yaml, ``load_fleet(path)`` the ``Fleet`` of a
  fleet or scenario file.  Errors in the file raise ``CompileError``.
- ``compile(path)`` returns a ``Compilation``: the model, and a ``Report`` with every error and
  warning as data.
- ``emit(robot, targets)`` returns the files of the targets in memory.
- ``Episode(robot)`` drives the robot in MuJoCo, one control cycle after the other, with commands
  of the program; ``Simulation(robot, files)`` whole runs.
- ``BaseDriver(robot, base)`` drives a base, such as ``SimBase(robot)``, with a ``Twist``.

All values are in SI units: m, kg, s, rad.  The frame ``base_link`` lies on the ground: x forward,
y to the left, z up.

``import thorvaldc`` loads none of these names; each name is imported at its first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__version__ = "0.1.0"
__all__ = [
    "BaseDriver",
    "Compilation",
    "CompileError",
    "Diagnostic",
    "DiagnosticError",
    "DriverState",
    "Episode",
    "Fleet",
    "JointCommands",
    "Pose2",
    "Report",
    "Robot",
    "RobotResult",
    "Sample",
    "Scenario",
    "SensorSettings",
    "Severity",
    "SimBase",
    "Simulation",
    "SimulationResult",
    "Span",
    "Twist",
    "__version__",
    "compile",
    "emit",
    "load",
    "load_fleet",
]

# Type checkers and editors read the imports; the program reads the table below.  A test compares
# the two.
if TYPE_CHECKING:
    from thorvaldc.compiler.pipeline import CompileError, emit, load, load_fleet
    from thorvaldc.compiler.pipeline import compile_file as compile
    from thorvaldc.compiler.result import Compilation
    from thorvaldc.diagnostics import Diagnostic, DiagnosticError, Report, Severity, Span
    from thorvaldc.model import Fleet, Robot
    from thorvaldc.model.scenario import Scenario, SensorSettings
    from thorvaldc.runtime.base_interface import JointCommands
    from thorvaldc.runtime.driver import BaseDriver, DriverState
    from thorvaldc.runtime.se2 import Pose2, Twist
    from thorvaldc.simulation.control_loop import Sample
    from thorvaldc.simulation.episode import Episode
    from thorvaldc.simulation.physics.sim_base import SimBase
    from thorvaldc.simulation.simulation_result import RobotResult, SimulationResult
    from thorvaldc.simulation.simulation_run import Simulation
else:
    # Type checkers do not see ``__getattr__``: they would accept every name, with the type Any.
    _API = {
        "BaseDriver": "runtime.driver",
        "Compilation": "compiler.result",
        "CompileError": "compiler.pipeline",
        "Diagnostic": "diagnostics",
        "DiagnosticError": "diagnostics",
        "DriverState": "runtime.driver",
        "Episode": "simulation.episode",
        "Fleet": "model",
        "JointCommands": "runtime.base_interface",
        "Pose2": "runtime.se2",
        "Report": "diagnostics",
        "Robot": "model",
        "RobotResult": "simulation.simulation_result",
        "Sample": "simulation.control_loop",
        "Scenario": "model.scenario",
        "SensorSettings": "model.scenario",
        "Severity": "diagnostics",
        "SimBase": "simulation.physics.sim_base",
        "Simulation": "simulation.simulation_run",
        "SimulationResult": "simulation.simulation_result",
        "Span": "diagnostics",
        "Twist": "runtime.se2",
        "compile": "compiler.pipeline:compile_file",
        "emit": "compiler.pipeline",
        "load": "compiler.pipeline",
        "load_fleet": "compiler.pipeline",
    }

    def __getattr__(name):
        if name not in _API:
            # Only the error needs the list of names, and the search for a similar one.
            hint = ""
            if not name.startswith("_"):
                from thorvaldc.diagnostics import nearest

                near = nearest(name, _API)
                hint = f"; did you mean {near!r}?" if near else ""
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
        if name not in _present_names():
            raise AttributeError(
                f"thorvaldc.{name} is not in this installation, which is the runtime alone; install"
                " the wheel or the checkout of the whole package"
            )
        from importlib import import_module

        module, _, attribute = _API[name].partition(":")
        value = getattr(import_module(f"{__name__}.{module}"), attribute or name)
        globals()[name] = value
        return value

    def __dir__():
        helpers = {"TYPE_CHECKING", "annotations", "_API", "_present_names"}
        return sorted({*globals(), *_present_names()} - helpers)

    def _present_names():
        """The names of the API that this installation has: the wheel ``thorvaldc-runtime`` has no
        compiler and no simulation."""
        from importlib.util import find_spec

        rooms = {name: module.partition(".")[0] for name, module in _API.items()}
        present = {room: find_spec(f"{__name__}.{room}") is not None for room in {*rooms.values()}}
        return [name for name, room in rooms.items() if present[room]]
