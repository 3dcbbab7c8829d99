"""The installed service under a real systemd: boot, restarts, the watchdog and the end.

A container has the file system of this computer, with a layer that the test throws away, and a
network of its own.  Its bus is simulated: the program at the place of the environment replaces the
CAN interface; the unit is the one that `thorvaldc install` writes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import pytest

from tests.child_process import ChildProcess
from tests.outside_tools import require

ROOT = Path(__file__).parents[3]
BOOT = """\
set -e
cd "$FOLDER"
mount --make-rprivate /
mkdir -p layer system results
mount -t tmpfs tmpfs layer
mkdir layer/upper layer/work
mount -t overlay overlay -o lowerdir=/,upperdir=layer/upper,workdir=layer/work system
mkdir -p system/opt/{thorvaldc-env/bin,source,python,packages,results}
# Services of this computer do not start in the container.
mount -t tmpfs tmpfs system/etc/systemd/system
cp program system/opt/thorvaldc-env/bin/thorvaldc
cp asking system/opt/thorvaldc-env/bin/asking
cp session.service system/etc/systemd/system/session.service
mkdir -p system/etc/systemd/system.conf.d
# No CAN interface appears, and the unit waits for one as long as for a start.
printf '[Manager]\\nDefaultTimeoutStartSec=5s\\n' >system/etc/systemd/system.conf.d/test.conf
container="systemd-nspawn --quiet --directory=system --private-network --register=no --keep-unit
  --link-journal=no --bind=$FOLDER/results:/opt/results --bind-ro=$SOURCE:/opt/source
  --bind-ro=$PYTHON:/opt/python --bind-ro=$PACKAGES:/opt/packages --console=pipe"
$container /bin/true
touch results/boots
exec $container --boot -- --unit=session.service
"""
PYTHON = f"/opt/python/bin/python{sys.version_info.major}.{sys.version_info.minor}"
ENVIRONMENT = "PYTHONPATH=/opt/source:/opt/packages PYTHONDONTWRITEBYTECODE=1"
PROGRAM = f"""\
#!/bin/bash
export {ENVIRONMENT}
exec {PYTHON} -m thorvaldc "${{@//socketcan:can_main/sim:/run/can.sock}}"
"""
# Its CAN interface is the simulated bus, so that an installation asks the devices there.
ASKING = f"""\
#!/bin/bash
export {ENVIRONMENT}
exec {PYTHON} -c 'import sys
from thorvaldc.cli.main import run
from thorvaldc.model.robot_computer import CanAdapter
CanAdapter.spec = property(lambda adapter: "sim:/run/can.sock")
sys.exit(run())' "$@"
"""
SESSION = f"""\
[Unit]
SuccessAction=exit
FailureAction=exit
[Service]
Type=oneshot
TimeoutStartSec=900
Environment={ENVIRONMENT}
ExecStart={PYTHON} -m tests.tools.computer.service_session /opt/results/record.json
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What happened in the container."""
    require("systemd-nspawn")
    if os.geteuid() != 0:
        pytest.skip("a container needs the superuser")
    folder = tmp_path_factory.mktemp("container")
    for name, text in (("program", PROGRAM), ("asking", ASKING)):
        (folder / name).write_text(text, encoding="utf-8")
        (folder / name).chmod(0o755)
    (folder / "session.service").write_text(SESSION, encoding="utf-8")
    paths = {
        "FOLDER": folder,
        "SOURCE": ROOT,
        "PYTHON": sys.base_prefix,
        "PACKAGES": sysconfig.get_paths()["purelib"],
    }
    environment = {**os.environ, "BOOT": BOOT, **{k: str(path) for k, path in paths.items()}}
    container = ChildProcess(
        ["bash", "-c", 'exec unshare --mount bash -c "$BOOT"'],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        output, _ = container.communicate(timeout=900)
    finally:
        container.end()
    if not (folder / "results/boots").exists():
        pytest.skip("this computer starts no container")
    file = folder / "results/record.json"
    assert file.exists(), output
    happened: dict[str, Any] = json.loads(file.read_bytes())
    assert "error" not in happened, (happened["error"], happened["journal"], output)
    return happened


pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("container")]


def test_the_file_of_another_robot_is_refused(record: dict[str, Any]) -> None:
    status, text = record["other"]
    assert status == 1
    assert "error[TV862] bus-wrong-robot: the device with the id 1 on the bus `main` is" in text
    assert "other.yaml:13:" in text
    assert record["changed"] == []
    status, text = record["same"]
    assert (status, "note: 5 of 5 devices on the bus `main` are as in the file" in text) == (
        0,
        True,
    )


def test_the_service_starts_disarmed_as_its_user(record: dict[str, Any]) -> None:
    status, text = record["install"]
    assert (status, "does not start" in text) == (0, False)
    assert record["process"][1].split() == ["robot", "FF", "20"]
    started = record["started"]
    assert (started["armed"], started["moved"], started["fault"]) == (False, False, "")
    assert record["status"][0] == 0
    assert "service active (running)" in record["status"][1]


def test_an_installation_disturbs_no_driver(record: dict[str, Any]) -> None:
    """Armed, the robot keeps its version; disarmed, its bus belongs to the driver."""
    status, text = record["armed"]
    assert (status, "the robot is armed: thorvaldc call" in text) == (3, True)
    status, text = record["running"]
    assert status == 0
    assert "were not compared with the file: another `thorvaldc can` or `thorvaldc run`" in text


def test_a_file_with_errors_leaves_the_last_build_in_use(record: dict[str, Any]) -> None:
    assert record["restart"][0] == 0
    assert "modulse" in record["errors"][1]


def test_each_end_of_the_driver_stops_the_wheels(record: dict[str, Any]) -> None:
    """Killed or stopped five times, some with frozen reports, the robot is at rest, and starts
    disarmed without moving."""
    ends = record["ends"]
    assert [end["how"] for end in ends] == ["SIGKILL", "SIGKILL", "SIGSTOP", "SIGSTOP", "SIGKILL"]
    assert [(end["armed"], end["moved"]) for end in ends] == [(False, False)] * 5
    assert record["at_last"] == {"result": "signal", "speed": 0.0}
    assert record["failed"][0] == 1
    assert "service failed" in record["failed"][1]


def test_a_removal_leaves_nothing(record: dict[str, Any]) -> None:
    assert (record["uninstall"][0], record["left"]) == (0, [])
