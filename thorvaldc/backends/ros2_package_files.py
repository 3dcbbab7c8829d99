"""The files that make a folder an ament_python package: package.xml, setup.py and so on."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Mapping

from thorvaldc.backends.placeholders import fill
from thorvaldc.backends.xml_writer import Element, to_bytes
from thorvaldc.model import Robot

_NEEDED = re.compile(
    r'package="([a-z0-9_]+)"|get_package_share_directory\("([a-z0-9_]+)"\)|node\("([a-z0-9_]+)", "'
)
_RUNTIME = ("ament_index_python", "launch", "launch_ros", "rclpy")
_MESSAGES = ("diagnostic_msgs", "geometry_msgs", "nav_msgs", "rosgraph_msgs", "sensor_msgs")
_MORE_MESSAGES = ("std_msgs", "std_srvs", "tf2_msgs")

SETUP = """\
import os
from glob import glob

from setuptools import setup

package_name = "@PACKAGE@"


def folder(name):
    files = [path for path in glob(f"{name}/*") if os.path.isfile(path)]
    return (f"share/{package_name}/{name}", sorted(files))


setup(
    name=package_name,
    version="0.0.0",
    packages=[@MODULES@],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml", "README.md"]),
@FOLDERS@    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="unknown",
    maintainer_email="unknown@example.org",
    description="@DESCRIPTION@",
    license="unspecified",
@SCRIPTS@)
"""

BASE_DRIVER = '''\
"""Starts the base driver of thorvaldc."""

import sys

try:
    from thorvaldc.ros.base_driver import main
except ModuleNotFoundError as error:
    if not str(error.name).startswith("thorvaldc"):
        raise
    sys.exit(
        f"The Python of this ROS 2, {sys.executable}, has no package thorvaldc; "
        "the README of @PACKAGE@ says how to install it."
    )

if __name__ == "__main__":
    main()
'''


def package_files(
    package: str,
    description: str,
    files: Mapping[str, bytes],
    launch_texts: Iterable[str],
    plugins: Iterable[str] = (),
) -> dict[str, bytes]:
    """Return the files that make the files of a folder an ament_python package, by path.

    - ``files``: the other files of the package. Their folders are installed.
    - ``launch_texts``: text of the launch files. The package depends on the ROS packages that the
      launch files name.
    - ``plugins``: ROS packages that the launch files do not name by themselves.
    """
    depends = set(_RUNTIME) | set(plugins)
    for text in launch_texts:
        for groups in _NEEDED.findall(text):
            depends.add(next(name for name in groups if name))
    has_driver = f"{package}/base_driver.py" in files
    if has_driver:
        depends.update(_MESSAGES, _MORE_MESSAGES)
    depends.discard(package)
    folders = sorted({posixpath.dirname(path) for path in files} - {"", package})
    values = {
        "PACKAGE": package,
        "DESCRIPTION": description,
        "MODULES": "package_name" if has_driver else "",
        "FOLDERS": "".join(f'        folder("{name}"),\n' for name in folders),
        "SCRIPTS": fill(_SCRIPTS, {"PACKAGE": package}) if has_driver else "",
    }
    return {
        "package.xml": _manifest(package, description, sorted(depends)),
        "setup.py": fill(SETUP, values).encode(),
        "setup.cfg": (
            f"[develop]\nscript_dir=$base/lib/{package}\n"
            f"[install]\ninstall_scripts=$base/lib/{package}\n"
        ).encode(),
        f"resource/{package}": b"",
    }


_SCRIPTS = """\
    entry_points={"console_scripts": ["base_driver = @PACKAGE@.base_driver:main"]},
"""


def driver_module(robot: Robot) -> dict[str, bytes]:
    """Return the Python package with the program of the base driver, by path."""
    package = robot.ros.package
    return {
        f"{package}/__init__.py": b"",
        f"{package}/base_driver.py": fill(BASE_DRIVER, {"PACKAGE": package}).encode(),
    }


def _manifest(package: str, description: str, depends: Iterable[str]) -> bytes:
    root = Element("package", format="3")
    root.add("name").text = package
    root.add("version").text = "0.0.0"
    root.add("description").text = description
    root.add("maintainer", email="unknown@example.org").text = "unknown"
    root.add("license").text = "unspecified"
    for name in depends:
        root.add("exec_depend").text = name
    export = root.add("export")
    export.add("build_type").text = "ament_python"
    # Gazebo finds meshes by model://<package>/meshes, relative to this folder.
    export.add("gazebo_ros", gazebo_model_path="${prefix}/..")
    return to_bytes(root)
