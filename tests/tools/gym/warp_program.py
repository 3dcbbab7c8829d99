"""Plays environments on MuJoCo Warp and with MuJoCo; the Python with Warp runs this program.

Arguments: files.  Prints a JSON object with the differences for each file.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from gymnasium.vector import SyncVectorEnv

from thorvaldc.tools.gym import environments

NUMBER, STEPS = 3, 14


def distance(step: Any) -> float:
    moved: float = step.after.pose_true.x - step.before.pose_true.x
    return moved - step.collisions


def compare(file: str) -> dict[str, Any]:
    """The largest differences until a collision, after which small ones grow.

    Those of observations are relative to the bounds of their space.
    """
    options: dict[str, Any] = {"reward": distance, "spread": (0.1, 0.1, 0.2), "duration": 1.0}
    batch = environments.make_batch(file, NUMBER, physics="warp", device="cpu", **options)
    single = SyncVectorEnv([lambda: environments.make(file, **options)] * NUMBER)
    scale = single.single_observation_space.high
    rng = np.random.default_rng(5)
    largest = {"first": np.abs(batch.reset(seed=3)[0] - single.reset(seed=3)[0]).max()}
    ends, collisions = 0, np.zeros(NUMBER)
    for _ in range(STEPS):
        actions = rng.uniform(-0.5, 0.5, batch.action_space.shape).astype(np.float32)
        actions[:, 0] = 1.0
        here, there = batch.step(actions), single.step(actions)
        assert all((here[i] == there[i]).all() for i in (2, 3)), "ends of episodes"
        started = [result[4]["collisions"][collisions == 0] > 0 for result in (here, there)]
        assert (started[0] == started[1]).all(), "the first collision"
        free = there[4]["collisions"] == 0
        differences = {
            "observation": (here[0] - there[0]) / scale,
            "reward": here[1] - there[1],
            "pose": here[4]["true_pose"] - there[4]["true_pose"],
        }
        for name, difference in differences.items():
            last = np.abs(difference[free]).max(initial=0.0)
            largest[name] = max(last, largest.get(name, 0.0))
        ends += int(there[3].sum())
        collisions = there[4]["collisions"] * ~there[3]
        largest["collisions"] = max(largest.get("collisions", 0), collisions.max())
    return {"ends": ends, **{name: float(value) for name, value in largest.items()}}


if __name__ == "__main__":
    print(json.dumps({file: compare(file) for file in sys.argv[1:]}))
