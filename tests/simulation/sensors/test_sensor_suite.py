"""The sensors of a run: their rates, their names, their errors in equal runs, and their cost."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import thorvaldc
from bench.sensors import stamp
from tests.examples import example_robot
from tests.outside_tools import require
from tests.simulation.sensors.rover import ALL_SENSORS, ROBOT, SENSORS, simulation
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model.sensor_numbers import SENSOR_NUMBERS
from thorvaldc.simulation.pictures import PictureError
from thorvaldc.simulation.records.mcap_writer import McapRecorder

CURVE = "script: [{at: 0, vx: 0.5, wz: 0.3}]\n"


def measured(run: Any) -> list[tuple[str, float, Any]]:
    """Returns name, time and measurement of each sensor in a scenario."""
    result: list[tuple[str, float, Any]] = []
    run.sensors.listeners.append(lambda s, m: result.append((s.name, stamp(m), m)))
    run.play(Report())
    run.sensors.listeners.clear()
    return result


def test_sensors_measure_at_their_rates(tmp_path: Path) -> None:
    run = simulation(tmp_path, CURVE, ALL_SENSORS, duration=2.0)
    times: dict[str, list[float]] = {name: [] for name in run.sensors}
    for name, time, _ in measured(run):
        times[name].append(time)
    rates = {"lidar": 25.0, "imu": 100.0, "gnss": 10.0, "tower": 10.0, "camera": 30.0}
    assert set(times) == {f"rover/{name}" for name in rates}
    for name, rate in rates.items():
        due = np.arange(round(2.0 * rate) + 1) / rate
        assert times[f"rover/{name}"] == pytest.approx(due, abs=0.0026)  # half a step


def test_sensors_do_not_change_the_motion(tmp_path: Path) -> None:
    keys = f"{CURVE}noise: {{wheel_speed: 0.02, seed: 2}}\n"
    hashes = {
        simulation(tmp_path, keys, modules, sensors=sensors).play(Report()).hash
        for modules, sensors in (
            (ALL_SENSORS, ""),
            (ALL_SENSORS, "sensors: {errors: 1}\n"),
            (ALL_SENSORS, "sensors: {errors: 0}\n"),
        )
    }
    assert len(hashes) == 1


def test_equal_runs_have_equal_measurements(tmp_path: Path) -> None:
    run = simulation(tmp_path, CURVE, sensors="sensors: {errors: 1}\n", duration=1.0)
    first, second = measured(run), measured(run)
    assert [repr(m) for _, _, m in first] == [repr(m) for _, _, m in second]


def test_a_run_without_sensors_imports_nothing_for_them(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(
        "thorvaldc: 1\nscenario: s\nduration: 1\n"
        f"robots: {{r: {{robot: {Path('examples/4wd4ws_wide/robot.yaml').resolve()}}}}}\n{CURVE}"
    )
    program = (
        "import sys\nfrom thorvaldc.cli.main import run_command\n"
        "assert run_command() == 0\n"
        "print([m for m in sys.modules if m.startswith('thorvaldc.simulation.sensors')])"
    )
    command = [sys.executable, "-c", program, "scenario", str(tmp_path / "s.yaml")]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def test_the_api_has_the_sensors_of_a_robot() -> None:
    robot = example_robot("4wd4ws_wide")
    files = emit(robot, ["mjcf"])
    run = thorvaldc.Simulation(robot, files)
    assert list(run.sensors) == ["lidar_front", "gnss_main", "gnss_aux", "imu"]
    assert run.sensors["imu"].latest is None
    run.run(1.0, thorvaldc.Twist(0.5, 0.0, 0.0))
    assert stamp(run.sensors["imu"].latest) == 1.0
    exact = thorvaldc.Simulation(robot, files, sensors=thorvaldc.SensorSettings(errors=0.0))
    exact.run(1.0, thorvaldc.Twist(0.5, 0.0, 0.0))
    assert exact.sensors["imu"].latest.angular_velocity.z == pytest.approx(0.0, abs=1e-6)


def test_ideal_joints_have_no_scene_to_measure() -> None:
    with pytest.raises(DiagnosticError, match="ideal joints"):
        _ = thorvaldc.Simulation(example_robot("4wd4ws_wide")).sensors


def test_a_camera_states_its_calibration(tmp_path: Path) -> None:
    run = simulation(tmp_path, "", ALL_SENSORS)
    (info,) = run.sensors["rover/camera"].measure()
    # 69 deg over 1280 pixels
    assert info.k[0] == info.p[0] == pytest.approx(640.0 / np.tan(np.radians(34.5)))


def test_a_camera_draws_images_where_opengl_is(tmp_path: Path) -> None:
    require("OpenGL")
    camera = (
        "  camera: {type: sensor/camera, mount: {parent: frame, xyz: [0.6 m, 0, 0.3 m]},"
        " params: {image_width: 64, image_height: 48}}\n"
    )
    world = "world: {obstacles: {wall: {shape: box, xyz: [3, 0, 0], size: [0.2, 9, 9]}}}\n"
    sensors = "sensors: {images: true}\n"
    pictures = []
    for keys in ("", world):
        suite = simulation(tmp_path, keys, SENSORS + camera, sensors=sensors).sensors
        image, _ = suite["rover/camera"].measure()
        assert (image.height, image.width, image.step) == (48, 64, 192)
        pictures.append(image.data.reshape(48, 64, 3).astype(float))
    # The wall hides the sky, in the upper half of the image.
    assert abs(pictures[0] - pictures[1])[:20].mean() > 20.0


def test_a_ball_is_at_its_pixel(tmp_path: Path) -> None:
    """The image, the calibration and the optical frame agree, for a camera that is turned."""
    require("OpenGL")
    camera = (
        "  camera: {type: sensor/camera, mount: {parent: frame, xyz: [0.6 m, 0.1 m, 0.3 m],"
        " rpy: [20 deg, 10 deg, -15 deg]}, params: {image_width: 320, image_height: 200}}\n"
    )
    centre = np.array([3.0, -0.2, 1.4])
    x, y, z = centre
    # ``xyz`` is the lowest point of an obstacle.
    ball = f"{{shape: sphere, xyz: [{x}, {y}, {z - 0.1}], diameter: 0.2}}"
    pictures = []
    for keys in ("", f"world: {{obstacles: {{ball: {ball}}}}}\n"):
        suite = simulation(tmp_path, keys, camera, sensors="sensors: {images: true}\n").sensors
        image, info = suite["rover/camera"].measure()
        pictures.append(image.data.reshape(200, 320, 3).astype(float))
    position, rotation = suite["rover/camera"].pose()
    across, down, ahead = rotation.T @ (centre - position)
    expected = info.k[2] + info.k[0] * across / ahead, info.k[5] + info.k[4] * down / ahead
    rows, columns = np.nonzero(abs(pictures[0] - pictures[1]).sum(axis=2)[:120] > 30.0)
    assert len(rows) > 100
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx(expected, abs=1.0)
    assert abs(expected[0] - 160.0) > 20.0
    assert abs(expected[1] - 100.0) > 20.0


def test_images_without_opengl_are_an_error_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise PictureError("cannot draw without a display")

    monkeypatch.setattr("thorvaldc.simulation.sensors.camera.choose_opengl_backend", missing)
    run = simulation(tmp_path, "", ALL_SENSORS, sensors="sensors: {images: true}\n")
    with pytest.raises(DiagnosticError, match="cannot draw without a display"):
        _ = run.sensors
    recorder = McapRecorder(tmp_path / "run.mcap", [*run.robots.items()], ())
    with pytest.raises(DiagnosticError, match="cannot draw without a display"):
        run.play(Report(), [recorder])
    recorder.close()
    assert run.play(Report()).hash  # nothing needs the images


def test_a_scenario_without_a_record_measures_nothing(tmp_path: Path) -> None:
    run = simulation(tmp_path, CURVE, duration=0.5)
    run.play(Report())
    assert run.scene is not None
    assert run.scene.sensors is None


def test_a_sensor_does_not_measure_twice_in_a_step(tmp_path: Path) -> None:
    fast = "  imu: {type: sensor/imu, mount: frame.rear_center, params: {rate: 1000 Hz}}\n"
    times = [time for _, time, _ in measured(simulation(tmp_path, CURVE, fast, duration=0.5))]
    assert times == pytest.approx(np.arange(101) * 0.005)


def library_sensor(folder: Path, kind: str, numbers: str) -> Path:
    """Returns the file of a robot with a sensor of its own library."""
    module = folder / "library" / "sensor" / "mine" / "module.yaml"
    module.parent.mkdir(parents=True, exist_ok=True)
    module.write_text(
        "thorvaldc: 1\ndescription: A sensor.\nmount: {kinds: [frame_clamp], link: body}\n"
        "links: {body: {parts: [{shape: {box: [0.1, 0.1, 0.1]}, mass: 1 kg,"
        " source: 'measured: scale'}]}}\n"
        f"sensor:\n  type: {kind}\n  link: body\n  properties: {{{numbers}}}\n"
    )
    mine = "library: [library]\n" + ROBOT + "  mine: {type: sensor/mine, mount: {parent: frame}}\n"
    (folder / "rover.yaml").write_text(mine)
    return folder / "rover.yaml"


@pytest.mark.parametrize(
    ("kind", "numbers", "message"),
    [
        ("lidar_2d", "rate: 0 Hz", "`rate` is 0 Hz; it must be positive"),
        ("lidar_2d", "angular_resolution: 0", "`angular_resolution` is 0 rad; it must be at least"),
        ("lidar_2d", "range: -1 m", "`range` is -1 m; it must be positive"),
        ("lidar_2d", "range: far", "`far` is not a quantity"),
        ("lidar_2d", "range: 25 deg", "`25 deg` is an angle; expected a length"),
        ("lidar_2d", "field_of_view: 270", "`field_of_view` is 270 rad (15469.9 deg); it must"),
        ("lidar_2d", "dropouts: 2", "`dropouts` is 2; it must be at least 0 and at most 1"),
        ("lidar_2d", "rnage: 25 m", "`rnage` is not a number of a lidar_2d"),
        ("lidar_2d", "range: 1 m, minimum_range: 2 m", "`minimum_range` is 2 m; it must be"),
        ("lidar_3d", "layers: 2.5", "`layers` is 2.5; it must be a whole number"),
        ("imu", "rate: 100 m", "`100 m` is a length; expected a frequency"),
        ("gnss", "wander_time: 0 s", "`wander_time` is 0 s; it must be positive"),
        ("camera", "image_width: 0", "`image_width` is 0; it must be at least 1"),
    ],
)
def test_numbers_that_no_sensor_can_have_are_errors(
    tmp_path: Path, kind: str, numbers: str, message: str
) -> None:
    (error,) = compile_file(library_sensor(tmp_path, kind, numbers)).report.errors
    assert message in error.message
    assert (Path(error.span.file).name, error.span.line) == ("module.yaml", 8)
    if numbers.startswith("rnage"):
        assert error.hint == "did you mean `range`?"


def test_properties_for_other_programs_are_allowed(tmp_path: Path) -> None:
    numbers = "range_max: 30 m, power: 8 W, port: 2112, vendor: acme"
    assert not compile_file(library_sensor(tmp_path, "lidar_2d", numbers)).report.has_errors


def test_a_sensor_that_nothing_simulates_is_named(tmp_path: Path) -> None:
    library_sensor(tmp_path, "lidar2d", "range: 25 m")
    (tmp_path / "trial.yaml").write_text(
        "thorvaldc: 1\nscenario: trial\nrobots: {r: {robot: rover.yaml}}\nduration: 1\n"
        "sensors: {errors: 1}\n"
    )
    messages = [d.message for d in compile_file(tmp_path / "trial.yaml").report]
    assert "no simulated sensor has the type of `r/mine` (lidar2d)" in messages


def test_numbers_that_a_module_leaves_out_have_one_default(tmp_path: Path) -> None:
    robot = thorvaldc.load(library_sensor(tmp_path, "camera", "rate: 5 Hz"))
    files = emit(robot, ["mjcf"])
    (info,) = thorvaldc.Simulation(robot, files).sensors["mine"].measure()
    across = 2.0 * np.degrees(np.arctan(info.height / 2.0 / info.k[4]))
    assert f'fovy="{across:.6f}'[:-3] in files["mjcf/robot.xml"].decode()


def test_sensors_that_are_used_first_during_a_run_begin_there() -> None:
    robot = example_robot("4wd4ws_wide")
    run = thorvaldc.Simulation(robot, emit(robot, ["mjcf"]))
    times: list[float] = []

    def ticked(loop: Any) -> None:
        if loop.ticks == 10:
            run.sensors.listeners.append(
                lambda s, m: times.append(stamp(m)) if s.name == "imu" else None
            )

    run.run(0.5, thorvaldc.Twist(0.5, 0.0, 0.0), on_tick=ticked)
    assert times[0] > 0.1
    assert np.diff(times) == pytest.approx(0.01)


def test_two_plays_write_two_records(tmp_path: Path) -> None:
    run = simulation(tmp_path, CURVE, duration=0.5)
    sizes = []
    for name in ("a.mcap", "b.mcap"):
        recorder = McapRecorder(tmp_path / name, [*run.robots.items()], ("truth",))
        run.play(Report(), [recorder])
        recorder.close()
        sizes.append((tmp_path / name).read_bytes())
    assert sizes[0] == sizes[1]


def test_the_page_lists_the_properties_of_each_type() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "sensors.md").read_text()
    for kind, numbers in SENSOR_NUMBERS.items():
        assert f"| `{kind}` | {', '.join(f'`{name}`' for name in numbers)} |" in page
