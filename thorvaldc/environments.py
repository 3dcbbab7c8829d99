"""Gymnasium environments of robot, fleet and scenario files, with the id ``thorvaldc/Robot-v0``.

``gymnasium.make("thorvaldc.environments:thorvaldc/Robot-v0", file="robot.yaml")`` imports this
module, which registers the id.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report

try:
    from gymnasium.envs import registration
except ImportError:
    raise ImportError(
        "an environment needs Gymnasium, which is not installed: pip install 'thorvaldc[gym]'"
    ) from None

if TYPE_CHECKING:
    from thorvaldc.simulation.gym.robot_env import RobotEnv

NAME = "thorvaldc/Robot-v0"


def make(
    file: str | Path,
    *,
    scenario: str | Path | None = None,
    library: Sequence[str | Path] = (),
    **options: Any,
) -> RobotEnv:
    """Returns the environment of a robot, fleet or scenario file.

    With ``scenario`` the robot of ``file`` replaces that of the scenario.  ``library`` are
    additional module folders, ``options`` the arguments of ``RobotEnv``.  Raises ``ValueError``
    with all errors if the file does not compile, and if ``scenario`` is not a scenario.
    """
    from thorvaldc.simulation.gym.robot_env import RobotEnv

    folders = [Path(folder) for folder in library]
    compilation = compile_file(scenario or file, library=folders, robot=file if scenario else None)
    if compilation.model is None:
        errors = "\n".join(
            f"{d.span}: {d.code.severity}[{d.code.number}]: {d.message}"
            for d in compilation.report.errors
        )
        raise ValueError(f"{scenario or file} does not compile:\n{errors}")
    if scenario and compilation.scenario is None:
        raise ValueError(f"{scenario} is not a scenario")
    files = emit(compilation.model, ["mjcf"], Report())
    return RobotEnv(compilation.scenario or compilation.model, files, **options)


if NAME not in registration.registry:
    registration.register(NAME, entry_point="thorvaldc.environments:make")
