"""Registers the Gymnasium environment ``thorvaldc/Robot-v0``.

The environment simulates the robots of a robot, fleet or scenario file.  The import of this module
registers the environment with Gymnasium.  Example::

    gymnasium.make("thorvaldc.tools.gym.environments:thorvaldc/Robot-v0", file="robot.yaml")
    gymnasium.make_vec("thorvaldc.tools.gym.environments:thorvaldc/Robot-v0", 8, file="robot.yaml")
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import Scenario

try:
    from gymnasium.envs import registration
except ImportError:
    raise ImportError(
        f"an environment needs Gymnasium, which is not installed: {install_command('gym')}"
    ) from None

if TYPE_CHECKING:
    from thorvaldc.tools.gym.robot_env import RobotEnv
    from thorvaldc.tools.gym.robot_vector_env import RobotVectorEnv

NAME = "thorvaldc/Robot-v0"


def make(
    file: str | Path,
    *,
    scenario: str | Path | None = None,
    library: Sequence[str | Path] = (),
    trust: bool = False,
    **options: Any,
) -> RobotEnv:
    """Creates the Gymnasium environment of a robot, fleet or scenario file.

    Raises ``ValueError`` if the file has errors or if the file for ``scenario`` is not a scenario
    file.  The message of the ``ValueError`` contains all errors of the file.

    Parameters
    ----------
    file : path of a robot, fleet or scenario file.
    scenario : path of a scenario file.  The robots of ``file`` replace the robots of the scenario.
    library : additional library folders with module types.
    trust : whether xacro files are expanded without restrictions, as trusted programs.
    options : keyword arguments of ``RobotEnv``.
    """
    from thorvaldc.tools.gym.robot_env import RobotEnv

    compiled = partial(_compiled, file, scenario, library, trust)
    return RobotEnv(*compiled(None), recompile=compiled, **options)


def make_batch(
    file: str | Path,
    num_envs: int = 1,
    *,
    scenario: str | Path | None = None,
    library: Sequence[str | Path] = (),
    trust: bool = False,
    **options: Any,
) -> RobotVectorEnv:
    """Creates ``num_envs`` environments of a file, whose physics is one batch.

    ``gymnasium.make_vec`` calls it, unless its ``vectorization_mode`` is ``sync`` or ``async``.
    The parameters are those of ``make``; ``options`` are keyword arguments of ``RobotVectorEnv``.
    """
    from thorvaldc.tools.gym.robot_vector_env import RobotVectorEnv

    return RobotVectorEnv(*_compiled(file, scenario, library, trust, None), num_envs, **options)


def _compiled(
    file: str | Path,
    scenario: str | Path | None,
    library: Sequence[str | Path],
    trust: bool,
    changes: Mapping[str, object] | None,
) -> tuple[Robot | Fleet | Scenario, dict[str, bytes]]:
    """Returns the model of a file with new values by their paths, and its MJCF files."""
    folders = [Path(folder) for folder in library]
    robot = file if scenario else None
    compilation = compile_file(
        scenario or file, library=folders, robot=robot, set=changes, trust=trust
    )
    if compilation.model is None:
        errors = "\n".join(
            f"{d.span}: {d.code.severity}[{d.code.number}]: {d.message}"
            for d in compilation.report.errors
        )
        raise ValueError(f"{scenario or file} does not compile:\n{errors}")
    if scenario and compilation.scenario is None:
        raise ValueError(f"{scenario} is not a scenario")
    files = emit(compilation.model, ["mjcf"], Report())
    return compilation.scenario or compilation.model, files


if NAME not in registration.registry:
    registration.register(
        NAME,
        entry_point="thorvaldc.tools.gym.environments:make",
        vector_entry_point="thorvaldc.tools.gym.environments:make_batch",
    )
