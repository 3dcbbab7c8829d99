"""Do robots stand in MuJoCo whenever the statics say so, and only then?

Random robots on rockers, bogies, pivoting axles, swing arms and pendulums start in the pose that
the compiler computed. A push turns the body by a small angle per second. A robot stands if after
10 s all its joints and its body have come back to the computed pose.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from bench.figure import Figure
from bench.random_trees import random_tree
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Robot
from thorvaldc.model.facts.stability import load_ranges
from thorvaldc.model.statics.standing import Standing, standing_of
from thorvaldc.model.statics.tip_over import support_of

GROUP = "long"

NUMBER = 80
DURATION = 10.0  # s
PUSH = 0.02  # rad/s
MOVED = math.radians(2.0)
LARGEST_LEAN = math.radians(30.0)


def figures() -> Iterator[Figure]:
    verdicts: Counter[tuple[bool, bool]] = Counter()
    errors = []
    for seed in range(NUMBER):
        trial = judge(seed)
        if trial is None:
            continue
        verdicts[trial[:2]] += 1
        if trial[2] is not None:
            errors.append(trial[2])
    agreed = verdicts[True, True] + verdicts[False, False]
    total = verdicts.total()
    yield Figure(
        "statics and MuJoCo agree who stands",
        agreed / total,
        "",
        0.95,
        "higher",
        f"{total} random trees, {DURATION:g} s after a push of {PUSH:g} rad/s:"
        f" {verdicts[True, True]} stand and {verdicts[False, False]} fall in both,"
        f" {verdicts[True, False]} fall only in MuJoCo, {verdicts[False, True]} only in the"
        " statics",
    )
    yield Figure(
        "wheel loads of standing trees",
        100.0 * float(np.max(errors)),
        "%",
        2.0,
        "lower",
        f"largest difference from MuJoCo over the weight, of {len(errors)} robots;"
        f" median {100.0 * float(np.median(errors)):.2g} %",
    )


def judge(seed: int) -> tuple[bool, bool, float | None] | None:
    """Returns whether a random robot stands by the statics and in MuJoCo, and the load error.

    Returns ``None`` for a robot without passive joints or with its centre of mass outside of its
    wheels. The load error is over the weight; it is ``None`` for a robot that does not stand.
    """
    robot = random_tree(seed)
    standing = standing_of(robot)
    if standing is None or not support_of(robot).stands:
        return None
    if standing.stands and standing.tilt > LARGEST_LEAN:
        return None
    stands, error = simulate(robot, standing)
    return standing.stands, stands, error if standing.stands and stands else None


def simulate(robot: Robot, standing: Standing) -> tuple[bool, float]:
    """Returns whether a robot stands in MuJoCo, and the largest error of a load over the weight."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in emit(robot, ["mjcf"]).items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        model = mujoco.MjModel.from_xml_path(str(Path(folder) / "mjcf" / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    joints = [model.joint(name).qposadr[0] for name in standing.positions]
    data.qvel[3:6] += (PUSH, 0.7 * PUSH, 0.0)
    start = data.qpos[joints].copy()
    up = _up(data)
    while data.time < DURATION:
        mujoco.mj_step(model, data)
    moved = max(np.abs(data.qpos[joints] - start).max(), math.acos(min(1.0, float(up @ _up(data)))))
    force, carried = np.zeros(6), dict.fromkeys((w.link for w in robot.wheels), 0.0)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        names = [model.body(model.geom_bodyid[geom]).name for geom in data.contact[i].geom]
        for name in names:
            if name in carried:
                carried[name] += force[0]
    weight = robot.inertial.mass * 9.81
    errors = [
        max(low - carried[wheel.link], carried[wheel.link] - high, 0.0) / weight
        for wheel, (low, high) in zip(robot.wheels, load_ranges(robot) or (), strict=False)
    ]
    return bool(moved < MOVED), max(errors, default=0.0)


def _up(data: mujoco.MjData) -> np.ndarray:
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), data.qpos[3:7])
    return up


if __name__ == "__main__":  # the trials one by one
    for number in map(int, sys.argv[1:]):
        print(number, judge(number), standing_of(random_tree(number)))
