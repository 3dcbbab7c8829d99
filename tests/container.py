"""A container that boots a real systemd, in which a session of a test runs.

It has the file system of this computer, with a layer that the test throws away, and a network of
its own.  The program at the place of the environment starts the sources of this checkout.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.child_process import ChildProcess
from tests.outside_tools import require

ROOT = Path(__file__).resolve().parents[1]
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
"""Has a simulated bus in the place of the CAN interface."""
ASKING = f"""\
#!/bin/bash
export {ENVIRONMENT}
exec {PYTHON} -c 'import sys
from thorvaldc.cli.main import run
from thorvaldc.model.robot_computer import CanAdapter
CanAdapter.spec = property(lambda adapter: "sim:/run/can.sock")
sys.exit(run())' "$@"
"""
"""Its CAN interface is the simulated bus, so that an installation asks the devices there."""
SESSION = f"""\
[Unit]
SuccessAction=exit
FailureAction=exit
[Service]
Type=oneshot
TimeoutStartSec=900
Environment={ENVIRONMENT}
ExecStart={PYTHON} -m %s /opt/results/record.json
"""


def in_container(module: str, folder: Path) -> dict[str, Any]:
    """Returns what ``main`` of a module has recorded in a container.

    ``folder``: an empty one.  Skips the test where no container starts.
    """
    require("systemd-nspawn")
    if os.geteuid() != 0:
        pytest.skip("a container needs the superuser")
    for name, text in (("program", PROGRAM), ("asking", ASKING)):
        (folder / name).write_text(text, encoding="utf-8")
        (folder / name).chmod(0o755)
    (folder / "session.service").write_text(SESSION % module, encoding="utf-8")
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


def record_session(session: Callable[[dict[str, Any]], None], unit: str) -> None:
    """In the container: runs a session, and writes what it records to the first argument.

    ``unit``: a service whose journal belongs to an error.
    """
    record: dict[str, Any] = {}
    try:
        session(record)
    except BaseException:
        record["error"] = traceback.format_exc()
        command = ["journalctl", "--unit", unit, "--no-pager", "--lines", "60"]
        journal = subprocess.run(command, capture_output=True, text=True, check=False)
        record["journal"] = journal.stdout
    Path(sys.argv[1]).write_text(json.dumps(record), encoding="utf-8")
