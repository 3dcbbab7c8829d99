"""The files that colcon installs."""

import os
from glob import glob

from setuptools import setup

package_name = "{{ package }}"


def folder(name):
    """Return a folder that is installed, with its files."""
    files = [path for path in glob(f"{name}/*") if os.path.isfile(path)]
    return (f"share/{package_name}/{name}", sorted(files))


setup(
    name=package_name,
    version="{{ settings.version }}",
    packages=[{{ "package_name" if has_driver else "" }}],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml", "README.md"]),
        # % for name in folders
        folder("{{ name }}"),
        # % endfor
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer={{ maintainer[0] | quoted }},
    maintainer_email={{ maintainer[1] | quoted }},
    description={{ title | quoted }},
    license={{ (settings.license or "unspecified") | quoted }},
    extras_require={"test": ["pytest"]},
    # % if has_driver
    entry_points={
        "console_scripts": [
            "base_driver = {{ package }}.base_driver:main",
            "joint_guard = {{ package }}.base_driver:guard",
        ]
    },
    # % endif
)
