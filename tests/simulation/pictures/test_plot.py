"""Plots: the curves and shapes in the figure."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.examples import FOLDER, example_robot
from tests.slow import mostly_slow
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Fleet
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.pictures import PictureError
from thorvaldc.simulation.pictures.plot import check_plotting, draw, footprint, plot

ROBOT = example_robot("4wd4ws_slim")


def drive(count: int = 50, x: float = 0.1) -> list[Sample]:
    """A run whose estimated path is 10 % too short."""
    return [
        Sample(
            0.1 * k,
            Twist(1.0, 0.0, 0.3),
            Twist(0.9, 0.0, 0.2),
            Twist(0.8, 0.0, 0.1),
            Twist(0.7, 0.1, 0.0),
            Pose2(0.9 * x * k, 0.0, 0.0),
            Pose2(x * k, 0.0, 0.0),
            None,
        )
        for k in range(count)
    ]


def lines(axes: Any) -> dict[str, Sequence[float]]:
    return {line.get_label(): list(line.get_ydata()) for line in axes.lines}


def test_velocities_are_those_of_the_samples() -> None:
    _, *graphs = draw({"a": ROBOT}, {"a": drive()}, "a").axes
    assert [axes.get_ylabel() for axes in graphs] == ["vx (m/s)", "vy (m/s)", "wz (rad/s)"]
    expected = {
        "commanded": (1.0, 0.0, 0.3),
        "within limits": (0.9, 0.0, 0.2),
        "estimated": (0.8, 0.0, 0.1),
        "true": (0.7, 0.1, 0.0),
    }
    for k, axes in enumerate(graphs):
        assert {name: set(values) for name, values in lines(axes).items()} == {
            name: {twist[k]} for name, twist in expected.items()
        }


def test_paths_on_a_1_m_grid_with_the_robot_to_scale() -> None:
    ground = draw({"a": ROBOT}, {"a": drive()}, "a").axes[0]
    true, estimated = (list(line.get_xdata()) for line in ground.lines)
    assert true[-1] == pytest.approx(4.9)
    assert estimated[-1] == pytest.approx(0.9 * 4.9)
    assert "end error 490 mm" in ground.get_title()
    grid = ground.xaxis.get_minorticklocs()
    assert all(tick == pytest.approx(round(tick)) for tick in grid)
    assert ground.get_aspect() == 1.0
    box = max((p.get_extents() for p in ground.patches), key=lambda b: b.width)
    wheels = [w.x for w in ROBOT.wheels]
    length = max(wheels) - min(wheels) + 2 * ROBOT.wheels[0].radius
    scale = ground.transData.transform((1.0, 0.0)) - ground.transData.transform((0.0, 0.0))
    assert box.width / scale[0] == pytest.approx(length, rel=0.02)


def test_a_footprint_covers_the_wheels() -> None:
    xs = [float(x) for part in footprint(ROBOT) for x in part.outline[:, 0]]
    reach = max(w.x + w.radius for w in ROBOT.wheels)
    assert max(xs) == pytest.approx(reach, abs=0.01)


def test_long_paths_and_diverged_runs() -> None:
    long = draw({"a": ROBOT}, {"a": drive(50, 100.0)}, "a").axes[0]
    assert "grid 100 m" in long.get_xlabel()
    wild = [*drive(), *drive(2, math.inf)[1:], *drive(3, 1e9)[1:]]
    ground = draw({"a": ROBOT}, {"a": wild}, "a").axes[0]
    assert max(ground.lines[0].get_xdata()) == pytest.approx(4.9)
    assert draw({"a": ROBOT}, {"a": []}, "a").axes  # a run without samples


@pytest.mark.slow
def test_a_large_fleet_shows_the_velocities_of_some() -> None:
    names = [f"r{k}" for k in range(8)]
    figure = draw(dict.fromkeys(names, ROBOT), dict.fromkeys(names, drive(3)), "many")
    assert len(figure.axes) == 1 + 3 * 6
    assert len(figure.axes[0].lines) == 16
    assert "6 of 8 robots" in figure.axes[-1].get_xlabel()


@pytest.mark.parametrize("kind", mostly_slow(["png", "svg", "pdf"]))
def test_equal_runs_give_equal_bytes(tmp_path: Path, kind: str) -> None:
    files = []
    for name in ("one", "two"):
        path = tmp_path / f"{name}.{kind}"
        plot({"a": ROBOT}, {"a": drive(5)}, str(path), "a")
        files.append(path.read_bytes())
    assert files[0] == files[1]
    assert files[0].startswith({"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[kind])


def test_without_matplotlib_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(PictureError, match=re.escape(install_command("plot"))):
        check_plotting()


def test_the_world_of_a_scenario_is_under_the_paths() -> None:
    compilation = compile_file(FOLDER / "scenarios" / "field_edge.yaml")
    assert isinstance(compilation.model, Fleet)
    world = compilation.model.world
    assert world is not None
    robots = {p.name: p.robot for p in compilation.model.placements}
    samples: dict[str, list[Sample]] = {name: [] for name in robots}
    plain, ground = draw(robots, samples, "plain").axes[0], draw(robots, samples, "", world).axes[0]
    assert len(ground.patches) - len(plain.patches) == len(world.blocks) + len(world.zones)
    assert "rises by 4 deg" in [text.get_text() for text in ground.texts]
    crate = next(block for block in world.blocks if block.name == "crate")
    centres = [patch.get_path().get_extents().get_points().mean(axis=0) for patch in ground.patches]
    assert any(math.dist(centre, crate.pose.xyz[:2]) < 0.01 for centre in centres)
