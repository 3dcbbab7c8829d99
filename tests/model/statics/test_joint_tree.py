"""The tree of links and joints."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from tests.robots import SPAN
from thorvaldc.model import Inertial, Joint, Link, Pose
from thorvaldc.model.statics.joint_tree import JointTree

BODY = Inertial(1.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1, 0.0, 0.0, 0.0))


def tree_of(*branches: str, types: dict[str, str] | None = None) -> JointTree:
    """Links of 1 kg with names of one letter; each link of a branch is 1 m above the one before."""
    links = dict.fromkeys("".join(branches))
    joints = dict.fromkeys(pair for branch in branches for pair in pairwise(branch))
    return JointTree(
        [Link(name, "m", BODY, (), (), SPAN) for name in links],
        [
            Joint(f"{b}_j", "m", (types or {}).get(b, "fixed"), a, b, Pose((0.0, 0.0, 1.0)), SPAN)
            for a, b in joints
        ],
    )


def test_links_above_and_below() -> None:
    tree = tree_of("abcd")
    assert tree.pose["d"].xyz == (0.0, 0.0, 3.0)
    assert [joint.child for joint in tree.joints_above("c")] == ["c", "b"]
    assert tree.links_below("b") == ["b", "c", "d"]


def test_inertia_of_some_links_and_of_all() -> None:
    tree = tree_of("abc")
    assert tree.inertial().mass == 3.0
    assert tree.inertial().com == (0.0, 0.0, 1.0)
    assert tree.inertial(["b", "c"]).com == (0.0, 0.0, 1.5)
    assert tree.inertial(["b", "c"]).inertia[0] == pytest.approx(0.2 + 2 * 0.25)
    assert tree.inertial(lift=0.5).com == (0.0, 0.0, 1.5)


def test_depth_first_in_model_order() -> None:
    tree = tree_of("abc", "ad", "be")
    assert tree.order == ["a", "b", "c", "e", "d"]
    assert tree.links_below("a") == ["a", "b", "d", "c", "e"]


def test_carriers_are_the_nearest_movable_joints() -> None:
    tree = tree_of("abcd", "ae", types={"b": "revolute", "d": "prismatic", "e": "continuous"})
    assert [joint.child for joint in tree.moving] == ["b", "d", "e"]
    assert tree.carrier == {"a": 0, "b": 1, "c": 1, "d": 2, "e": 3}
    assert tree.moving_parent == [0, 0, 1, 0]


def test_links_that_are_not_connected_do_not_count() -> None:
    tree = tree_of("ab", "cd")
    assert set(tree.pose) == {"a", "b"}
    assert tree.inertial().mass == 2.0


def test_poses_at_joint_positions() -> None:
    tree = tree_of("abc", types={"b": "prismatic", "c": "revolute"})
    axis = tree.joints["b_j"].axis
    moved = tree.at({"b_j": 0.25, "c_j": math.pi / 2})
    assert moved.pose["b"].xyz == pytest.approx(
        (0.25 * axis[0], 0.25 * axis[1], 1.0 + 0.25 * axis[2])
    )
    assert moved.pose["c"].quat[0] == pytest.approx(math.cos(math.pi / 4))
    assert tree.pose["b"].xyz == (0.0, 0.0, 1.0)
