"""Plots of a run: the paths, and what was asked for, estimated and true over time.

The two are figures 8 and 9 of Grimstad and From (2018), for any run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Pose2
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.pictures import PictureError

if TYPE_CHECKING:
    from thorvaldc.simulation.pictures.visible_shapes import Points

FORMATS = ("png", "svg", "pdf")
TRUE, ESTIMATED, COMMANDED, LIMITED = "#1b7837", "#d95f02", "#9a9a9a", "#4575b4"
MOST_ROBOTS = 6
"""Of a large fleet the velocities of so many are drawn; the paths of all."""
_DIRECTIONS = 48
_BEYOND = 1e6  # m, m/s: where a run that left all bounds is cut off


def check_plotting() -> None:
    """Raises ``PictureError`` where matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise PictureError(
            "a plot needs matplotlib, which is not installed: pip install 'thorvaldc[plot]'"
        ) from None


def plot(
    robots: Mapping[str, Robot], samples: Mapping[str, Sequence[Sample]], path: str, title: str
) -> None:
    """Draw the run to a file whose suffix is one of ``FORMATS``.

    ``samples`` are those of each tick, by robot.  The same run gives the same bytes.
    Raises ``PictureError`` (``check_plotting``) and ``OSError``.
    """
    check_plotting()
    import matplotlib

    figure = draw(robots, samples, title)
    kind = path.rsplit(".", 1)[-1].lower()
    undated: dict[str, dict[str, None]] = {
        "png": {"Software": None},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    with matplotlib.rc_context({"svg.hashsalt": "thorvaldc"}):
        figure.savefig(path, dpi=130, format=kind, metadata=undated[kind])


def draw(robots: Mapping[str, Robot], samples: Mapping[str, Sequence[Sample]], title: str) -> Any:
    """The matplotlib figure; it belongs to no window and needs no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sane = {name: _sane(list(seen)) for name, seen in samples.items()}
    shown = [name for name in sane if sane[name]][:MOST_ROBOTS]
    if len(robots) == 1:
        figure = Figure(figsize=(14.0, 7.0), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.0))
        ground = figure.add_subplot(grid[:, 0])
        columns = [[figure.add_subplot(grid[row, 1]) for row in range(3)] for _ in shown]
    else:
        width = max(11.0, 4.5 * len(shown))
        figure = Figure(figsize=(width, 15.0), layout="constrained")
        grid = figure.add_gridspec(4, max(len(shown), 1), height_ratios=(3.6, 1.0, 1.0, 1.0))
        ground = figure.add_subplot(grid[0, :])
        columns = [
            [figure.add_subplot(grid[row + 1, column]) for row in range(3)]
            for column in range(len(shown))
        ]
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    _paths(ground, robots, sane)
    for name, axes in zip(shown, columns, strict=True):
        _velocities(axes, sane[name])
        if len(robots) > 1:
            axes[0].set_title(name)
    if columns:
        lines, labels = columns[0][0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower right", ncols=4, fontsize=9)
    if len(sane) > len(shown) == MOST_ROBOTS:
        columns[-1][-1].set_xlabel(f"time (s); {MOST_ROBOTS} of {len(sane)} robots")
    return figure


def _sane(samples: list[Sample]) -> list[Sample]:
    """The samples up to where a simulation left all bounds."""
    for k, sample in enumerate(samples):
        values = (*sample.pose_true, *sample.pose_estimated, *sample.true, *sample.estimated)
        if not all(abs(value) < _BEYOND for value in values):
            return samples[:k]
    return samples


# -- figure 8 -----------------------------------------------------------------


def _paths(axes: Any, robots: Mapping[str, Robot], samples: Mapping[str, list[Sample]]) -> None:
    from matplotlib.ticker import MultipleLocator

    worst = 0.0
    for order, (name, seen) in enumerate(samples.items()):
        if not seen:
            continue
        true, estimated = ([getattr(s, f"pose_{w}") for s in seen] for w in ("true", "estimated"))
        labels: tuple[str | None, str | None] = ("true", "estimated") if order == 0 else (None,) * 2
        axes.plot([p.x for p in true], [p.y for p in true], color=TRUE, lw=1.8, label=labels[0])
        axes.plot(
            [p.x for p in estimated],
            [p.y for p in estimated],
            color=ESTIMATED,
            lw=1.3,
            ls=(0, (4, 2)),
            label=labels[1],
        )
        parts = footprint(robots[name], seen[-1])
        _draw_robot(axes, footprint(robots[name], seen[0]), true[0], 0.25)
        _draw_robot(axes, parts, true[-1], 1.0)
        _outline(axes, parts, estimated[-1])
        if len(samples) > 1:
            axes.annotate(name, true[-1][:2], ha="center", va="center", fontsize=8)
        worst = max(worst, math.dist(true[-1][:2], estimated[-1][:2]))
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    extent = max(abs(b - a) for a, b in (axes.get_xlim(), axes.get_ylim()))
    cell = 1.0
    while extent / cell > 100.0:
        cell *= 10.0
    label = next(s for s in (1, 2, 5, 10, 20) if extent / (s * cell) <= 16 or s == 20) * cell
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(MultipleLocator(cell))
        axis.set_major_locator(MultipleLocator(label))
    axes.grid(True, which="both", color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel(f"x (m), grid {cell:g} m")
    axes.set_ylabel("y (m)")
    axes.set_title(f"paths; at the end {worst * 1000:.3g} mm apart, robot to scale")
    if any(samples.values()):
        axes.legend(loc="best")


class Part(NamedTuple):
    """A visible shape from above: its outline (n, 2) in ``base_link``, in m, and its colour."""

    outline: Points
    color: tuple[float, float, float, float]
    top: float


def footprint(robot: Robot, sample: Sample | None = None) -> list[Part]:
    """The robot from above, lowest parts first; wheels turned as in the sample."""
    import numpy as np

    from thorvaldc.simulation.pictures.visible_shapes import link_poses, surface

    positions: dict[str, float] = {}
    if sample is not None and sample.joints is not None:
        for wheel, angle in zip(robot.wheels, sample.joints.angles, strict=True):
            if wheel.steering_joint is not None:
                positions[wheel.steering_joint] = angle
    poses = link_poses(robot, positions)
    parts: list[Part] = []
    for link in robot.links:
        for visual in link.visuals:
            pose = poses[link.name] * visual.pose
            local, _ = surface(robot, visual.shape)
            axes = np.array([pose.rotate(e) for e in ((1, 0, 0), (0, 1, 0), (0, 0, 1))])
            points = local @ axes + np.asarray(pose.xyz)
            parts.append(Part(_convex(points[:, :2]), visual.color, float(points[:, 2].max())))
    return sorted(parts, key=lambda part: part.top)


def _convex(points: Points) -> Points:
    """The convex outline: of each direction the point that reaches furthest."""
    import numpy as np

    angles = np.arange(_DIRECTIONS) * math.tau / _DIRECTIONS
    furthest = np.argmax(points @ np.array([np.cos(angles), np.sin(angles)]), axis=0)
    outline: Points = points[furthest]
    return outline


def _placed(outline: Points, pose: Pose2) -> Points:
    import numpy as np

    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    placed: Points = outline @ np.array([[c, s], [-s, c]]) + np.array([pose.x, pose.y])
    return placed


def _draw_robot(axes: Any, parts: Sequence[Part], pose: Pose2, strength: float) -> None:
    from matplotlib.patches import Polygon

    for part in parts:
        axes.add_patch(
            Polygon(
                _placed(part.outline, pose),
                facecolor=part.color[:3],
                edgecolor="#303030",
                lw=0.3,
                alpha=strength * part.color[3],
                zorder=1.5 if strength < 1.0 else 3.0,
            )
        )


def _outline(axes: Any, parts: Sequence[Part], pose: Pose2) -> None:
    import numpy as np
    from matplotlib.patches import Polygon

    if parts:
        around = _convex(np.vstack([part.outline for part in parts]))
        axes.add_patch(
            Polygon(_placed(around, pose), fill=False, edgecolor=ESTIMATED, ls=(0, (4, 2)), lw=1.0)
        )


# -- figure 9 -----------------------------------------------------------------


def _velocities(axes: Sequence[Any], samples: Sequence[Sample]) -> None:
    times = [s.time for s in samples]
    rows = (("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"))
    lines = (
        ("commanded", "commanded", COMMANDED, "-", 2.4),
        ("limited", "within limits", LIMITED, "-", 1.0),
        ("true", "true", TRUE, "-", 1.2),
        ("estimated", "estimated", ESTIMATED, (0, (4, 2)), 1.0),
    )
    for axis, (part, unit) in zip(axes, rows, strict=True):
        for of, label, color, style, width in lines:
            values = [getattr(getattr(s, of), part) for s in samples]
            steps = "steps-post" if of == "commanded" else "default"
            axis.plot(times, values, color=color, ls=style, lw=width, label=label, drawstyle=steps)
        low, high = axis.get_ylim()
        if high - low < 0.1:  # so that noise of nothing does not fill the picture
            middle = (high + low) / 2.0
            axis.set_ylim(middle - 0.05, middle + 0.05)
        axis.set_ylabel(f"{part} ({unit})")
        axis.grid(True, color="#e6e6e6", lw=0.6)
        axis.margins(x=0.0)
    axes[-1].set_xlabel("time (s)")
