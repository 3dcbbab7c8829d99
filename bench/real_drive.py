"""Consistency of the odometry over the log of a real drive, for which a tracker gives the pose.

The folder with the log is ``REAL_DRIVES``, by default the one beside a checkout of the project.
Logs are those of others and no part of the project: without them there is no figure.

``tricycle.txt`` is the log of a tricycle with a driven and steered front wheel.  The parameters
are a least-squares fit to this same log, so that the errors are smaller than those of a drive.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.consistency import logarithm
from bench.figure import ROOT, Figure
from bench.robots import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.odometry import Odometry
from thorvaldc.runtime.se2 import ORIGIN, Pose2

GROUP = "long"

TRICYCLE = Path(
    os.environ.get("REAL_DRIVES", ROOT.parent / "shared" / "data" / "real"), "tricycle.txt"
)
WHEELBASE = 1.568
METRES_PER_TURN = 0.010938
TURN, STEERING_TURN = 5000, 8192
"""Counts per turn of the motor and of the steering encoder."""
STEERING_RATIO, STEERING_OFFSET = 0.5694, -0.0533
TRACKER = Pose2(1.8012, -0.0269, 0.0063)
"""Pose of the tracker in ``base_link``, which is in the middle of the rear axle."""
TRACKER_NOISE = (0.01, 0.01, math.radians(0.18))
"""Standard deviations (m, rad) of the tracker."""
RADIUS = 0.1
"""Any radius (m) of the front wheel: the log has distances."""
_LINE = re.compile(r"time: (\S+) ticks: (\d+) (\d+) .* tracker_pose: (\S+) (\S+) (\S+)")


def figures() -> Iterator[Figure]:
    if not TRICYCLE.exists():
        return
    rows = [tuple(map(float, row)) for row in _LINE.findall(TRICYCLE.read_text(encoding="utf-8"))]
    fixed = {"driven": False, "steered": False, "encoder": False}
    wheels = [
        wheel("front", WHEELBASE, 0.0, radius=RADIUS),
        *(wheel(f"rear{y}", 0.0, y, radius=RADIUS, **fixed) for y in (0.4, -0.4)),
    ]
    odometry = Odometry(General(BaseGeometry.from_wheels(wheels)), (1.0, 1.0))
    start, position, travelled = rows[0][0], 0.0, 0.0
    last = first = None
    distances, squares = [], []
    for time, steering, count, *pose in rows:
        tracked = Pose2(*pose).moved(ORIGIN.relative_to(TRACKER))
        if last is not None:
            # The counter of 32 bits overflows.
            counts = (count - last + 2**31) % 2**32 - 2**31
            step = counts / TURN * METRES_PER_TURN
            position, travelled = position + step, travelled + abs(step)
        last = count
        turns = (steering - STEERING_TURN * (steering > STEERING_TURN / 2)) / STEERING_TURN
        angle = STEERING_RATIO * math.tau * turns + STEERING_OFFSET
        still = [0.0] * 3
        states = JointStates(
            time - start, still, [angle, 0.0, 0.0], still, [position / RADIUS, 0.0, 0.0]
        )
        odometry.update(states, time - start)
        if first is None:
            first = tracked
            continue
        true = tracked.relative_to(first)
        turned = math.remainder(true.yaw - odometry.pose.yaw, math.tau)
        true = Pose2(true.x, true.y, odometry.pose.yaw + turned)
        error = logarithm(true.relative_to(odometry.pose))
        covariance = np.array(odometry.covariance) + 2.0 * np.diag(np.square(TRACKER_NOISE))
        squares.append(float(error @ np.linalg.solve(covariance, error)) / 3.0)
        distances.append(math.hypot(true.x - odometry.pose.x, true.y - odometry.pose.y))
    how = (
        f"{rows[-1][0] - start:.0f} s and {travelled:.1f} m of a tricycle, parameters fitted to the"
        f" same log; it ends {distances[-1]:.3f} m off, at most {max(distances):.3f} m"
    )
    yield Figure("pose NEES/3, real tricycle", sum(squares) / len(squares), "", None, "lower", how)
    yield Figure(
        "pose error, real tricycle",
        math.sqrt(sum(d * d for d in distances) / len(distances)),
        "m",
        None,
        "lower",
        how,
    )
