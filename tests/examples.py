"""Compiled examples; each is compiled once per test run."""

from __future__ import annotations

import functools
import os
import subprocess
from collections.abc import Iterable
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.stl import binary_stl

FOLDER = Path(__file__).parent.parent / "examples"
ROBOTS = tuple(sorted(path.parent.name for path in FOLDER.glob("*/robot.yaml")))
FLEETS = tuple(sorted(path.parent.name for path in FOLDER.glob("*/fleet.yaml")))
FIXED_ROBOTS = ("4wd2ws_tall", "4wd4ws_wide", "lss")
"""Robots that have most features together: steered and fixed wheels, casters, suspension, one and
two motors per controller, two batteries, an IO board, all sensors, a xacro file; CANopen drives of
the CiA 402 profile and others."""


def _sampled_robots() -> tuple[str, ...]:
    choice = os.environ.get("ROBOTS", "")
    if choice == "all":
        return ROBOTS
    if choice:
        return tuple(choice.split(","))
    others = [name for name in ROBOTS if name not in FIXED_ROBOTS]
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=FOLDER, capture_output=True, text=True, check=True
        ).stdout
    except (FileNotFoundError, subprocess.CalledProcessError):  # no git, or no commit
        commit = "0"
    return (*FIXED_ROBOTS, others[int(commit, 16) % len(others)])


SAMPLED_ROBOTS = _sampled_robots()
"""The robots of a test that holds for every robot: the fixed ones, and one that follows from the
commit.  The variable ``ROBOTS`` names others, such as ``car,lss``; with ``all``, as in
``make test-all``, all examples."""


def sampled(names: Iterable[str], fixed: Iterable[str]) -> tuple[str, ...]:
    """Returns the names ``fixed`` of special robots; with ``ROBOTS=all``, all ``names``."""
    return tuple(names if SAMPLED_ROBOTS == ROBOTS else fixed)


os.environ["ROBOTS"] = ",".join(SAMPLED_ROBOTS)  # the same in all processes of a run


@functools.cache
def example_robot(name: str) -> Robot:
    compilation = compile_file(FOLDER / name / "robot.yaml")
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


@functools.cache
def example_fleet(name: str) -> Fleet:
    compilation = compile_file(FOLDER / name / "fleet.yaml")
    assert isinstance(compilation.model, Fleet), [d.message for d in compilation.report]
    return compilation.model


def robot_with_meshes() -> dict[str, bytes]:
    """Returns the files of a robot with an STL and an OBJ mesh of its own, from which masses
    follow, and an expression in a xacro file."""
    corners = [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    triangles = [(corners[a], corners[b], corners[c]) for a, b, c in faces]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    obj = "\n".join(lines + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces])
    xacro = (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="x">'
        '<xacro:property name="h" value="${0.2 + sin(0.5)}"/>'
        + "".join(
            f'<link name="m{i}"><visual><geometry><mesh filename="m{i}.{suffix}"/></geometry>'
            f'</visual><collision><geometry><mesh filename="m{i}.{suffix}"/></geometry></collision>'
            f'</link><joint name="j{i}" type="fixed"><parent link="frame_body"/>'
            f'<child link="m{i}"/><origin xyz="0 0 ${{h + {i}}}"/></joint>'
            for i, suffix in enumerate(("stl", "obj"))
        )
        + "</robot>"
    )
    text = (FOLDER / "4wd4ws_wide" / "robot.yaml").read_text(encoding="utf-8")
    text += "extras:\n  - {xacro: top.xacro, density: 1200 kg/m^3}\n"
    return {
        "robot.yaml": text.encode(),
        "top.xacro": xacro.encode(),
        "m0.stl": binary_stl(triangles),
        "m1.obj": obj.encode(),
    }
