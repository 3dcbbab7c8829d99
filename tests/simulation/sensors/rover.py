"""A rover with sensors, in scenarios that state its world."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.simulation.scenario_run import ScenarioSimulation

ROBOT = """thorvaldc: 1
name: rover
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.2 m, width: 800 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
"""
SENSORS = """\
  lidar: {type: sensor/lidar_2d, mount: frame.front_center}
  imu: {type: sensor/imu, mount: frame.rear_center}
  gnss: {type: sensor/gnss_antenna, mount: {parent: frame, xyz: [0.3 m, 0.2 m, 0.1 m]}}
"""
ALL_SENSORS = f"""\
{SENSORS}\
  tower: {{type: sensor/lidar_3d, mount: {{parent: frame, xyz: [0, 0, 0.4 m]}}}}
  camera: {{type: sensor/camera, mount: {{parent: frame, xyz: [0.4 m, 0.2 m, 0.1 m]}}}}
"""


def simulation(
    folder: Path,
    keys: str = "",
    modules: str = SENSORS,
    *,
    sensors: str = "sensors: {errors: 0}\n",
    duration: float = 5.0,
) -> ScenarioSimulation:
    """Returns the simulation of a scenario with the robot ``rover`` and more keys."""
    (folder / "rover.yaml").write_text(ROBOT + modules)
    text = "thorvaldc: 1\nscenario: trial\nrobots: {rover: {robot: rover.yaml}}\n"
    text += f"duration: {duration}\n"
    (folder / "trial.yaml").write_text(text + sensors + keys)
    compilation = compile_file(folder / "trial.yaml")
    assert compilation.scenario is not None, [d.message for d in compilation.report]
    return ScenarioSimulation(compilation.scenario, emit(compilation.scenario.fleet, ["mjcf"]))
