"""The paper's odometry test in simulation: ``python examples/odometry_experiment/run.py``.

Drives the scenarios of this folder, before and after a calibration, and prints the table of its
README.  ``--write`` updates the table in the folder, ``--picture`` the picture.
"""

from __future__ import annotations

import io
import math
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import yaml

import thorvaldc
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.simulation.control_loop import ControlLoop, Sample, Segment
from thorvaldc.simulation.physics.sim_base import WheelErrors
from thorvaldc.simulation.records.joint_csv import JointLogWriter, read_log
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.simulation_run import Simulation
from thorvaldc.tools.calibration.calibration_file import overlay
from thorvaldc.tools.calibration.self_calibration import CalibrationResult, calibrate

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parents[1] / "bench" / "random_pairs"))  # as if it were installed
ROBOT = HERE.parent / "6wd6ws_asymmetric" / "robot.yaml"
CASES = {
    "ideal": "ideal sensors and wheels",
    "radii": "wheels 1 % larger or smaller",
    "offsets": "steering zeros 0.5 deg off",
    "rough": "rough ground, bumps of 2 cm",
}
HEAD = "| | true | odometry | end error | random pairs, end error |"
BEGIN, END = "<!-- table -->", "<!-- end -->"
DRAWS = 10
"""Number of runs of the random pairs on the same joint states, each with draws of its own.

The intersection of two almost parallel axles can be anywhere: the end error of one run is chance,
0.02 to 0.23 m with ideal sensors.  The table has the root mean square.
"""


class Row(NamedTuple):
    """The result of a case, in m: path lengths, and end errors of both odometries."""

    name: str
    true: float
    odometry: float
    end_error: float
    random_pairs: float

    @property
    def text(self) -> str:
        return (
            f"| {self.name} | {self.true:.2f} m | {self.odometry:.2f} m "
            f"| {self.end_error:.3f} m | {self.random_pairs:.2f} m |"
        )


def drive(path: Path, name: str) -> tuple[Row, Robot, list[Sample]]:
    """Runs a scenario, and the paper's odometry on the same joint states."""
    from random_pairs_calculator import RandomPairs, RandomPairsOptions

    compilation = thorvaldc.compile(path)
    scenario = compilation.scenario
    if scenario is None:
        raise SystemExit("\n".join(d.message for d in compilation.report.errors))
    robot = scenario.fleet.placements[0].robot
    geometry = BaseGeometry.from_robot(robot)
    draws = [RandomPairsOptions(special_cases=False, seed=seed) for seed in range(1, DRAWS + 1)]
    paper_odometries = [Odometry(RandomPairs(geometry, one), (2.0, 2.0)) for one in draws]
    samples: list[Sample] = []

    def on_tick(loop: ControlLoop) -> None:
        sample = loop.sample()
        samples.append(sample)
        if sample.joints is not None:
            for odometry in paper_odometries:
                odometry.update(sample.joints, sample.time)

    files = thorvaldc.emit(scenario.fleet, ["mjcf"], compilation.report)
    result = ScenarioSimulation(scenario, files).play(compilation.report, (), on_tick)
    run = result.run.robots[0]
    ends = [odometry.pose.relative_to(run.pose_true) for odometry in paper_odometries]
    paper_error = math.hypot(*(length for end in ends for length in end[:2])) / math.sqrt(DRAWS)
    row = Row(name, run.path_true, run.path_odometry, run.end_error, paper_error)
    return row, robot, samples


def calibrated(path: Path, folder: Path) -> Path:
    """Returns a copy of the scenario at ``path`` with a calibrated robot.

    The calibration uses the joint log of another run: the same script, without speed control of
    the drives.  Wrong radii are visible in this log.  Wrong offsets are not, if the driver does
    not know them: the motors hold the wheels at the commanded angles.  So the driver of this
    run knows the true angles, like software before the replacement of the encoders, and
    the log has the readings of the new encoders.
    """
    document: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    radii = {f["wheel"]: 1.0 + f["error"] for f in _faults(document, "radius_error")}
    offsets = {
        f["wheel"]: math.radians(float(f["angle"].split()[0]))
        for f in _faults(document, "steering_offset")
    }
    known = {w: {"steering_offset": f"{math.degrees(a)!r} deg"} for w, a in offsets.items()}
    robot = _compiled(_robot(folder, "known", known))
    log = folder / "joints.csv"
    with log.open("w", encoding="utf-8") as stream:
        _log_script(robot, document, radii, stream)
    uncalibrated = _compiled(ROBOT)
    report = Report()
    joint_log = read_log(log, log.name, uncalibrated, report)
    calibration = None if joint_log is None else calibrate(uncalibrated, joint_log, report)
    if calibration is None:
        raise SystemExit("\n".join(d.message for d in report))
    print(
        f"calibrated by the log of {path.stem}: {_remaining_errors(calibration, radii, offsets)}",
        file=sys.stderr,
    )
    values = yaml.safe_load(overlay(calibration))["wheels"]
    after = _compiled(_robot(folder, "after", values))
    _set_remaining_faults(document, uncalibrated, after, radii, offsets)
    document["robots"] = {"six": {"robot": "after.yaml"}}
    scenario = folder / path.name
    scenario.write_text(yaml.safe_dump(document), encoding="utf-8")
    return scenario


def _faults(document: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [fault for fault in document.get("faults", ()) if fault["type"] == kind]


def _robot(folder: Path, name: str, wheels: dict[str, Any]) -> Path:
    """Writes a copy of the robot file that includes a calibration of ``wheels``."""
    path = folder / f"{name}.yaml"
    (folder / f"{name}_wheels.yaml").write_text(
        yaml.safe_dump({"thorvaldc": 1, "robot": "thorvald_6wd6ws_asymmetric", "wheels": wheels}),
        encoding="utf-8",
    )
    text = ROBOT.read_text(encoding="utf-8")
    path.write_text(f"{text}calibration: {name}_wheels.yaml\n", encoding="utf-8")
    return path


def _compiled(path: Path) -> Robot:
    compilation = thorvaldc.compile(path)
    if not isinstance(compilation.model, Robot):
        raise SystemExit("\n".join(d.message for d in compilation.report.errors))
    return compilation.model


def _log_script(
    robot: Robot, document: dict[str, Any], radii: dict[str, float], stream: Any
) -> None:
    """Drives the scenario's script on a plane and writes the joint log to ``stream``."""
    manoeuvre = []
    for entry in document["script"]:
        at, vx, vy, wz = (
            float(str(entry.get(key, "0")).split()[0]) for key in ("at", "vx", "vy", "wz")
        )
        manoeuvre.append(Segment(at, thorvaldc.Twist(vx, vy, wz)))
    files = thorvaldc.emit(robot, ["mjcf"], Report())
    wheel_errors = {robot.name: WheelErrors.by_name(robot, radii)}
    simulation = Simulation(robot, files, wheel_errors=wheel_errors, open_loop=True)
    duration = float(document["duration"].split()[0])
    simulation.run(duration, manoeuvre, None, JointLogWriter(robot, stream).on_tick)


def _remaining_errors(
    calibration: CalibrationResult, radii: dict[str, float], offsets: dict[str, float]
) -> str:
    """Returns the largest errors of the calibration as text."""
    radius = max(
        (
            abs(w.ratio.value - radii.get(w.name, 1.0))
            for w in calibration.wheels
            if w.ratio is not None and w.ratio.determined
        ),
        default=math.nan,
    )
    offset = max(
        (
            abs(w.offset.value - offsets.get(w.name, 0.0))
            for w in calibration.wheels
            if w.offset is not None and w.offset.determined
        ),
        default=math.nan,
    )
    return f"radii to {100 * radius:.3f} %, offsets to {math.degrees(offset):.3f} deg"


def _set_remaining_faults(
    document: dict[str, Any],
    before: Robot,
    after: Robot,
    radii: dict[str, float],
    offsets: dict[str, float],
) -> None:
    """Sets the scenario's faults to the true errors minus the calibrated ones."""
    faults: list[dict[str, Any]] = []
    for old, new in zip(before.wheels, after.wheels, strict=True):
        ratio = old.radius * radii.get(old.name, 1.0) / new.radius
        faults.append({"type": "radius_error", "wheel": old.name, "error": ratio - 1.0})
        motor = after.actuator_of(new.steering_joint or "")
        angle = offsets.get(old.name, 0.0) - (motor.encoder_offset if motor is not None else 0.0)
        degrees = f"{math.degrees(angle):.9f} deg"
        faults.append({"type": "steering_offset", "wheel": old.name, "angle": degrees})
    document["faults"] = faults


def experiment(case: str) -> tuple[list[Row], Robot, list[Sample]]:
    """Runs a case; returns its rows of the table, and the robot and the samples of the first."""
    path, name = HERE / f"{case}.yaml", CASES[case]
    row, robot, samples = drive(path, name)
    rows = [row]
    if case in ("radii", "offsets"):
        with tempfile.TemporaryDirectory() as folder:
            rows.append(drive(calibrated(path, Path(folder)), f"{name}, calibrated")[0])
    return rows, robot, samples


def main() -> None:
    results = [experiment(case) for case in CASES]
    rows = [row for rows, _, _ in results for row in rows]
    _, robot, samples = results[0]
    text = io.StringIO()
    print(HEAD, "| --- | --- | --- | --- | --- |", *(row.text for row in rows), sep="\n", file=text)
    print(text.getvalue(), end="")
    if "--picture" in sys.argv[1:]:
        from thorvaldc.simulation.pictures.plot import plot

        plot({"six": robot}, {"six": samples}, str(HERE / "run.png"), "6WD6WS, 77 s, 80 m")
    if "--write" in sys.argv[1:]:
        readme = HERE / "README.md"
        old = readme.read_text(encoding="utf-8")
        before, rest = old.split(BEGIN)
        after = rest.split(END)[1]
        readme.write_text(f"{before}{BEGIN}\n{text.getvalue()}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
