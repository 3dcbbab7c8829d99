"""The files that colcon installs."""

import os
from glob import glob

from setuptools import setup

package_name = "thorvald_4wd4ws_wide"


def folder(name):
    """Return a folder that is installed, with its files."""
    files = [path for path in glob(f"{name}/*") if os.path.isfile(path)]
    return (f"share/{package_name}/{name}", sorted(files))


setup(
    name=package_name,
    version="0.0.0",
    packages=[package_name],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml", "README.md"]),
        folder("config"),
        folder("launch"),
        folder("meshes"),
        folder("mjcf"),
        folder("rviz"),
        folder("sdf"),
        folder("urdf"),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="unknown",
    maintainer_email="unknown@example.org",
    description="The robot thorvald_4wd4ws_wide, made by thorvaldc",
    license="unspecified",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "base_driver = thorvald_4wd4ws_wide.base_driver:main",
            "joint_guard = thorvald_4wd4ws_wide.base_driver:guard",
        ]
    },
)
