"""The environments with the wheels of ROS 2, in which the tests run the real node.

``python3 tests/ros/environments.py`` makes the environments ``.venv-ros/jazzy`` and
``.venv-ros/kilted`` with the versions of ``locks/``, as ``.ci/run`` does.  The wheels exist for
Linux on x86_64 only.  They are for tests; the users of the node have the ROS 2 of their
distribution.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENTS = ROOT / ".venv-ros"
DISTROS = ("jazzy", "kilted")


def python_of(distro: str) -> str:
    """Returns the Python with the ROS 2 of a distribution; the test is skipped without it.

    Where ``CI`` is set, a missing environment is an error on computers that the wheels fit.
    """
    import pytest

    from tests.outside_tools import path_in_environment

    if not fits():
        pytest.skip("the wheels of ROS 2 exist for Linux on x86_64 only")
    return path_in_environment(
        ENVIRONMENTS / distro / "bin" / "python",
        f"there is no .venv-ros/{distro} (python3 tests/ros/environments.py makes it)",
    )


def each_distro(*, both: bool = False) -> Any:
    """Runs a test with each distribution; only the first one is in the quick group, and the second
    one in that of CI if ``both`` is true.

    The tests of a distribution run in one process: they wait more than they compute, and two
    processes at a time do not delay each other.
    """
    import pytest

    cases = []
    for distro in DISTROS:
        marks = [pytest.mark.xdist_group(f"ros-{distro}")]
        if distro != DISTROS[0]:
            marks.append(pytest.mark.slow if both else pytest.mark.exhaustive)
        cases.append(pytest.param(distro, marks=marks))
    return pytest.mark.parametrize("distro", cases)


def require_messages(distro: str, package: str) -> None:
    """Skips the test where a message package was not built (``generate_messages.py``)."""
    from tests.outside_tools import without

    python_of(distro)
    if not any((ENVIRONMENTS / distro / "lib").glob(f"python3*/site-packages/{package}")):
        without(
            f"{package} is not in .venv-ros/{distro} (tests/ros/generate_messages.py builds it)"
        )


def fits() -> bool:
    """Whether the wheels fit this computer."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def variables(folder: Path) -> dict[str, str]:
    """Returns the environment variables of a ROS process of a test with the folder ``folder``.

    Each worker of pytest has a domain of its own, so that tests do not hear each other.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    domain = 1 + (7 * os.getppid() + int(worker)) % 100
    own = {
        "PYTHONPATH": str(ROOT),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_LOG_DIR": str(folder / "ros_log"),
        "XDG_RUNTIME_DIR": str(folder),
    }
    return {**os.environ, **own}


def make() -> None:
    """Makes the environments of all distributions."""
    import generate_messages  # the folder of this script is on the path

    for distro in DISTROS:
        folder = ENVIRONMENTS / distro
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        lock = f"locks/{distro}.txt"
        subprocess.run(
            [
                *(str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet"),
                *("--disable-pip-version-check", "--requirement", lock),
            ],
            check=True,
            cwd=ROOT,
            env={**os.environ, "PIP_CONSTRAINT": lock, "PIP_BUILD_CONSTRAINT": lock},
        )
        generate_messages.main(folder)


if __name__ == "__main__":
    if fits():
        make()
    else:
        print(f"no ROS 2 for the tests: there are no wheels for {platform.machine()}")
