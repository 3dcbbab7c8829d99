"""Robots that stop on a slope in MuJoCo, compared with the closed form of the model."""

from __future__ import annotations

import math

import pytest

from bench.stopping_slope import CASES, ROVER, WEAK, Case, stopping_distances

pytest.importorskip("mujoco")


@pytest.mark.parametrize(
    "case",
    [
        Case("1wd1ws_front", 12.0, True),
        Case(ROVER, 14.0, True),
        Case(WEAK, 12.0, False),
        Case("4wd4ws_wide", 25.0, True),
    ],
    ids=["one of three", "two of four", "weak motors", "four of four"],
)
def test_the_closed_form_agrees_with_mujoco(case: Case) -> None:
    assert case in CASES
    model, measured = stopping_distances(case)
    assert model == pytest.approx(measured, rel=0.1)


def test_a_robot_that_cannot_brake_does_not_stop() -> None:
    # On 15 deg it turns aside first, and chance decides whether it comes to rest across the slope.
    assert stopping_distances(Case("1wd1ws_rear", 16.0, False)) == (math.inf, math.inf)
