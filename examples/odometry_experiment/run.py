"""The paper's odometry test in simulation: ``python examples/odometry_experiment/run.py``.

Drives the scenarios of this folder, before and after a calibration, and prints the table of its
README.  ``--write`` puts that and the picture into the folder, for whoever changed
something on purpose.
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
from thorvaldc.runtime.calculators.random_pairs import RandomPairs, RandomPairsOptions
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.manoeuvre import Segment
from thorvaldc.simulation.physics.wheel_errors import WheelErrors
from thorvaldc.simulation.records.joint_csv import JointLogWriter, read_log
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.simulation_run import Simulation
from thorvaldc.tools.calibration.calibration_text import overlay
from thorvaldc.tools.calibration.self_calibration import CalibrationResult, calibrate

HERE = Path(__file__).resolve().parent
ROBOT = HERE.parent / "6wd6ws_asymmetric" / "robot.yaml"
CASES = {
    "ideal": "ideal sensors and wheels",
    "radii": "wheels 1 % larger or smaller",
    "offsets": "steering zeros 0.5 deg off",
    "rough": "rough ground, bumps of 2 cm",
}
HEAD = "| | true | odometry | end error | its random pairs |"
BEGIN, END = "<!-- table -->", "<!-- end -->"


class Row(NamedTuple):
    """How a case ended, in m: ways, and how far estimates are from where the robot stands."""

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
    """A scenario's run, with the paper's odometry on the same joint states beside."""
    done = thorvaldc.compile(path)
    scenario = done.scenario
    if scenario is None:
        raise SystemExit("\n".join(d.message for d in done.report.errors))
    robot = scenario.fleet.placements[0].robot
    paired = RandomPairs(BaseGeometry.from_robot(robot), RandomPairsOptions(special_cases=False))
    beside = Odometry(paired, (2.0, 2.0))
    samples: list[Sample] = []

    def on_tick(loop: ControlLoop) -> None:
        sample = loop.sample()
        samples.append(sample)
        if sample.joints is not None:
            beside.update(sample.joints, sample.time)

    files = thorvaldc.emit(scenario.fleet, ["mjcf"], done.report)
    result = ScenarioSimulation(scenario, files).play(done.report, (), on_tick)
    run = result.run.robots[0]
    pairs = math.hypot(beside.pose.x - run.pose_true.x, beside.pose.y - run.pose_true.y)
    row = Row(name, run.path_true, run.path_odometry, run.end_error, pairs)
    return row, robot, samples


def calibrated(path: Path, folder: Path) -> Path:
    """The scenario at ``path`` with a robot that was calibrated by a log of its own.

    For the log the robot drives the same script, its drives without speed control.  Wrong
    radii show in it.  Offsets do not where whoever drives does not know of them: the motors
    hold the wheels as they are told to.  So it is driven by one who knows where they
    point, as the software before the encoders were changed does; the log has the new encoders'.
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
        _script(robot, document, radii, stream)
    plain = _compiled(ROBOT)
    report = Report()
    read = read_log(log, log.name, plain, report)
    found = None if read is None else calibrate(plain, read, report)
    if found is None:
        raise SystemExit("\n".join(d.message for d in report))
    print(
        f"calibrated by the log of {path.stem}: {_missed(found, radii, offsets)}", file=sys.stderr
    )
    values = yaml.safe_load(overlay(found))["wheels"]
    after = _compiled(_robot(folder, "after", values))
    _leave(document, plain, after, radii, offsets)
    document["robots"] = {"six": {"robot": "after.yaml"}}
    made = folder / path.name
    made.write_text(yaml.safe_dump(document), encoding="utf-8")
    return made


def _faults(document: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [fault for fault in document.get("faults", ()) if fault["type"] == kind]


def _robot(folder: Path, name: str, wheels: dict[str, Any]) -> Path:
    """A copy of the robot that includes a calibration."""
    path = folder / f"{name}.yaml"
    (folder / f"{name}_wheels.yaml").write_text(
        yaml.safe_dump({"thorvaldc": 1, "robot": "thorvald_6wd6ws_asymmetric", "wheels": wheels}),
        encoding="utf-8",
    )
    text = ROBOT.read_text(encoding="utf-8")
    path.write_text(f"{text}calibration: {name}_wheels.yaml\n", encoding="utf-8")
    return path


def _compiled(path: Path) -> Robot:
    done = thorvaldc.compile(path)
    if not isinstance(done.model, Robot):
        raise SystemExit("\n".join(d.message for d in done.report.errors))
    return done.model


def _script(robot: Robot, document: dict[str, Any], radii: dict[str, float], stream: Any) -> None:
    """Drive the scenario's script on a plane and log the joints."""
    plan = []
    for entry in document["script"]:
        at, vx, vy, wz = (
            float(str(entry.get(key, "0")).split()[0]) for key in ("at", "vx", "vy", "wz")
        )
        plan.append(Segment(at, thorvaldc.Twist(vx, vy, wz)))
    files = thorvaldc.emit(robot, ["mjcf"], Report())
    wheel_errors = {robot.name: WheelErrors.by_name(robot, radii)}
    simulation = Simulation(robot, files, wheel_errors=wheel_errors, open_loop=True)
    duration = float(document["duration"].split()[0])
    simulation.run(duration, plan, None, JointLogWriter(robot, stream).on_tick)


def _missed(found: CalibrationResult, radii: dict[str, float], offsets: dict[str, float]) -> str:
    """The largest errors of what was found."""
    radius = max(
        (
            abs(w.ratio.value - radii.get(w.name, 1.0))
            for w in found.wheels
            if w.ratio is not None and w.ratio.determined
        ),
        default=math.nan,
    )
    offset = max(
        (
            abs(w.offset.value - offsets.get(w.name, 0.0))
            for w in found.wheels
            if w.offset is not None and w.offset.determined
        ),
        default=math.nan,
    )
    return f"radii to {100 * radius:.3f} %, offsets to {math.degrees(offset):.3f} deg"


def _leave(
    document: dict[str, Any],
    before: Robot,
    after: Robot,
    radii: dict[str, float],
    offsets: dict[str, float],
) -> None:
    """The faults that are left: what the wheels are, less what the robot now knows."""
    left: list[dict[str, Any]] = []
    for old, new in zip(before.wheels, after.wheels, strict=True):
        ratio = old.radius * radii.get(old.name, 1.0) / new.radius
        left.append({"type": "radius_error", "wheel": old.name, "error": ratio - 1.0})
        known = after.actuator_of(new.steering_joint or "")
        angle = offsets.get(old.name, 0.0) - (known.encoder_offset if known is not None else 0.0)
        degrees = f"{math.degrees(angle):.9f} deg"
        left.append({"type": "steering_offset", "wheel": old.name, "angle": degrees})
    document["faults"] = left


def experiment() -> tuple[list[Row], Robot, list[Sample]]:
    """All cases; the robot and the samples of the first."""
    rows: list[Row] = []
    shown: list[Sample] = []
    for case, name in CASES.items():
        path = HERE / f"{case}.yaml"
        row, driven, samples = drive(path, name)
        rows.append(row)
        if not shown:
            robot, shown = driven, samples
        if case in ("radii", "offsets"):
            with tempfile.TemporaryDirectory() as folder:
                rows.append(drive(calibrated(path, Path(folder)), f"{name}, calibrated")[0])
    return rows, robot, shown


def main() -> None:
    rows, robot, samples = experiment()
    text = io.StringIO()
    print(HEAD, "| --- | --- | --- | --- | --- |", *(row.text for row in rows), sep="\n", file=text)
    print(text.getvalue(), end="")
    if "--write" in sys.argv[1:]:
        from thorvaldc.simulation.pictures.plot import plot

        plot({"six": robot}, {"six": samples}, str(HERE / "run.png"), "6WD6WS, 77 s, 80 m")
        readme = HERE / "README.md"
        old = readme.read_text(encoding="utf-8")
        before, rest = old.split(BEGIN)
        after = rest.split(END)[1]
        readme.write_text(f"{before}{BEGIN}\n{text.getvalue()}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
