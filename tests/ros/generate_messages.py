"""Builds the message packages that the ROS 2 wheels do not contain: tf2_msgs,
can_msgs and control_msgs.

    python tests/ros/generate_messages.py .venv-ros/jazzy

A ROS 2 installation has these packages; the wheels that the tests use do not.  The packages are
built from the field lists below with the generators of the wheels, and installed into the virtual
environment.  Needs cmake, ninja and a C++ compiler.  Takes half a minute for each distribution.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

PACKAGES = {
    "tf2_msgs": (
        "geometry_msgs",
        {"TFMessage": "geometry_msgs/TransformStamped[] transforms\n"},
    ),
    "can_msgs": (
        "std_msgs",
        {
            "Frame": "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\n"
            "bool is_error\nuint8 dlc\nuint8[8] data\n"
        },
    ),
    "control_msgs": (
        "std_msgs",
        {
            "InterfaceValue": "string[] interface_names\nfloat64[] values\n",
            "DynamicInterfaceGroupValues": "std_msgs/Header header\nstring[] interface_groups\n"
            "InterfaceValue[] interface_values\n",
        },
    ),
}
"""Dependency of each package, and the fields of its messages."""
BUILD_PATH = re.compile(r"/opt/python/[^;\"]*?/include/python[0-9.]+")
BUILD_NUMPY = re.compile(r"/opt/python/[^;\"]*?/numpy/_core/include")
PACKAGE_XML = """\
<package format="3">
  <name>{name}</name><version>0.0.0</version><description>For tests</description>
  <maintainer email="unknown@example.org">unknown</maintainer><license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>{dependency}</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""
CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package({dependency} REQUIRED)
rosidl_generate_interfaces({name} {messages} DEPENDENCIES {dependency})
ament_package()
"""


def main(environment: Path) -> None:
    python = environment / "bin/python"
    code = "import numpy; print(numpy.get_include())"
    numpy = subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout
    for path in (environment / "share").rglob("*.cmake"):
        # The wheels contain paths of the machine on which they were built.
        text = path.read_text("utf-8")
        changed = BUILD_NUMPY.sub(numpy.strip(), text)
        changed = BUILD_PATH.sub(sysconfig.get_paths()["include"], changed)
        if changed != text:
            path.write_text(changed, "utf-8")
    variables = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    variables["AMENT_PREFIX_PATH"] = str(environment)
    variables["PATH"] = f"{environment / 'bin'}{os.pathsep}{variables['PATH']}"
    for name, (dependency, messages) in PACKAGES.items():
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder)
            (source / "msg").mkdir()
            for message, fields in messages.items():
                (source / "msg" / f"{message}.msg").write_text(fields, "utf-8")
            (source / "package.xml").write_text(
                PACKAGE_XML.format(name=name, dependency=dependency), "utf-8"
            )
            files = " ".join(f'"msg/{message}.msg"' for message in messages)
            (source / "CMakeLists.txt").write_text(
                CMAKE.format(name=name, dependency=dependency, messages=files), "utf-8"
            )
            configure = ["cmake", "-G", "Ninja", "-S", folder, "-B", f"{folder}/build"]
            configure += ["--no-warn-unused-cli"]
            configure += [f"-DCMAKE_PREFIX_PATH={environment}", "-Wno-dev"]
            configure += [f"-DCMAKE_INSTALL_PREFIX={environment}"]
            configure += [f"-DPython3_EXECUTABLE={python}", f"-DPYTHON_EXECUTABLE={python}"]
            for command in (configure, ["ninja", "-C", f"{folder}/build", "install"]):
                subprocess.run(
                    command, check=True, env=variables, stdout=subprocess.DEVNULL, text=True
                )


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
