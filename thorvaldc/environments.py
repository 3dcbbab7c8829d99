"""Robot and scenario files as environments of Gymnasium, by the id ``thorvaldc/Robot-v0``.

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
    """The environment of a robot, fleet or scenario file, or of a robot in ``scenario``.

    ``library`` are further module folders, ``options`` the arguments of ``RobotEnv``.  Raises
    ``ValueError`` with all that is wrong where the file does not compile, and where ``scenario``
    is none.
    """
    from thorvaldc.simulation.gym.robot_env import RobotEnv

    folders = [Path(folder) for folder in library]
    done = compile_file(scenario or file, library=folders, robot=file if scenario else None)
    if done.model is None:
        said = "\n".join(
            f"{d.span}: {d.code.severity}[{d.code.number}]: {d.message}" for d in done.report.errors
        )
        raise ValueError(f"{scenario or file} does not compile:\n{said}")
    if scenario and done.scenario is None:
        raise ValueError(f"{scenario} is no scenario")
    files = emit(done.model, ["mjcf"], Report())
    return RobotEnv(done.scenario or done.model, files, **options)


if NAME not in registration.registry:
    registration.register(NAME, entry_point="thorvaldc.environments:make")
