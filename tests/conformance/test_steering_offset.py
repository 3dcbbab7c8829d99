"""A calibrated steering offset on the bus: the signals include it once, in files and driver."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cantools
import pytest
import yaml

from tests.backend_files import files_of
from tests.examples import FOLDER
from tests.runtime.can_base.simulated_rig import FORWARD, Rig
from tests.simulation.bus.robots import CIA402
from thorvaldc.backends.can import Can
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot

OFFSETS = {"fl": math.radians(0.8), "fr": math.radians(-1.5)}


def text_of(kind: str) -> str:
    if kind == "cia402":
        return CIA402
    text = (FOLDER / "4wd4ws_wide" / "robot.yaml").read_text(encoding="utf-8")
    assert "../" not in text
    return text


@pytest.fixture(scope="module", params=["roboteq", "cia402"])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The robot without and with its calibration."""
    folder: Path = tmp_path_factory.mktemp(request.param)
    text = text_of(request.param)
    (folder / "plain.yaml").write_text(text, encoding="utf-8")
    (folder / "robot.yaml").write_text(text + "\ncalibration: calibration.yaml\n", encoding="utf-8")
    plain = compile_file(folder / "plain.yaml").model
    assert isinstance(plain, Robot)
    wheels = "".join(
        f"  {wheel}_wheel: {{steering_offset: {offset!r} rad}}\n"
        for wheel, offset in OFFSETS.items()
    )
    values = f"thorvaldc: 1\nrobot: {plain.name}\nwheels:\n{wheels}"
    (folder / "calibration.yaml").write_text(values, encoding="utf-8")
    done = compile_file(folder / "robot.yaml")
    assert isinstance(done.model, Robot), [d.message for d in done.report]
    assert not done.report.errors
    return plain, done.model


def offset_of(robot: Robot, joint: str) -> float:
    return next(a.encoder_offset for a in robot.actuators if a.joint == joint)


def test_only_angles_of_calibrated_joints_have_an_offset(
    pair: tuple[Robot, Robot],
) -> None:
    plain, calibrated = pair
    moved = 0
    for before, after in zip(plain.buses[0].frames, calibrated.buses[0].frames, strict=True):
        for old, new in zip(before.signals, after.signals, strict=True):
            if new.joint is None or new.unit != "rad" or not offset_of(calibrated, new.joint):
                assert new == old
                continue
            moved += 1
            offset = offset_of(calibrated, new.joint)
            assert new.offset == pytest.approx(old.offset + offset)
            assert new.scale == old.scale
            if after.producer == "master":
                joint = calibrated.joint(new.joint)
                assert joint.lower is not None
                assert joint.upper is not None
                # The controller counts in its encoder's angle.
                assert new.minimum == pytest.approx(joint.lower + offset)
                assert new.maximum == pytest.approx(joint.upper + offset)
    assert moved == 2 * len(OFFSETS), "command and report of each"


def test_every_bus_file_has_the_offset(pair: tuple[Robot, Robot]) -> None:
    _, robot = pair
    files = {path: data.decode("cp1252") for path, data in files_of(Can, robot).items()}
    database = cantools.database.load_string(files["can/robot.dbc"], "dbc")
    canmap = json.loads(files["can/canmap.json"])
    nodes = yaml.safe_load(files["can/bus.yml"])["nodes"]
    checked = 0
    for bus in canmap["buses"]:
        for node in bus["nodes"]:
            for number, channel in enumerate(node["channels"]):
                offset = offset_of(robot, channel["joint"]) if channel["actuator"] else 0.0
                for signal in channel.get("signals", []):
                    angle = signal["unit"] == "rad"
                    assert signal["offset"] == (pytest.approx(offset) if angle else 0.0)
                    read = database.get_message_by_name(signal["frame"])
                    assert read.get_signal_by_name(signal["signal"]).offset == signal["offset"]
                    macro = f"{signal['frame']}_{signal['signal']}_offset".upper()
                    assert (macro in files["can/robot_can.h"]) == bool(angle and offset)
                    checked += bool(angle and offset)
                estimate = nodes.get(node["name"], {}).get("channels")
                if estimate and offset:
                    axis = estimate[number]
                    assert axis["offset_pos_from_dev"] == pytest.approx(offset)
                    # The command is target * scale + offset, in the drive's counts.
                    zero = 0.0 * axis["scale_pos_to_dev"] + axis["offset_pos_to_dev"]
                    assert zero * axis["scale_pos_from_dev"] == pytest.approx(-offset)
    assert checked == 2 * len(OFFSETS)


def angles(rig: Rig) -> dict[str, tuple[float, float]]:
    """Reported and true angle of each steering joint."""
    values = {}
    for connection in rig.base.connections:
        for controller in connection.controllers:
            for axis in controller.axes:
                if axis.steering:
                    motor = rig.simulated.motors[axis.actuator.name].read(rig.now)
                    values[axis.joint] = axis.position, motor.position
    return values


@pytest.mark.slow
def test_calibrated_robot_drives_straight_with_wrong_encoder_zeros(
    pair: tuple[Robot, Robot],
) -> None:
    """The encoder zeros of the simulated drives are those of the calibration."""
    _, calibrated = pair
    rig = Rig(calibrated)
    rig.drive(FORWARD, 1.5)
    for joint, (reported, true) in angles(rig).items():
        assert reported == pytest.approx(true, abs=2e-3), joint
        assert true == pytest.approx(0.0, abs=5e-3), joint


@pytest.mark.slow
def test_without_calibration_the_wheels_are_off_by_the_offset(
    pair: tuple[Robot, Robot],
) -> None:
    plain, calibrated = pair
    rig = Rig(plain, drives=calibrated)
    rig.drive(FORWARD, 1.5)
    for joint, (reported, true) in angles(rig).items():
        assert true - reported == pytest.approx(offset_of(calibrated, joint), abs=2e-3), joint
        assert reported == pytest.approx(0.0, abs=5e-3), joint
