"""Plots the paths of a run, with its world, and the commanded, estimated and true velocities.

The plots correspond to figures 8 and 9 of Grimstad and From (2018).
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from thorvaldc.diagnostics.files import write_file
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Robot, World, Zone
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.runtime.se2 import Pose2
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.pictures import PictureError

if TYPE_CHECKING:
    from thorvaldc.simulation.pictures.surfaces import Points

FORMATS = ("png", "svg", "pdf")
TRUE, ESTIMATED, COMMANDED, LIMITED = "#1b7837", "#d95f02", "#9a9a9a", "#4575b4"
MOST_ROBOTS = 6
"""Largest number of robots whose velocities are drawn.  Paths are drawn for all robots."""
_OUT_OF_RANGE = 1e6  # m, m/s: the plot ends before the first larger value (divergence)


def check_plotting() -> None:
    """Raises ``PictureError`` if matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise PictureError(
            f"a plot needs matplotlib, which is not installed: {install_command('plot')}"
        ) from None


def plot(
    robots: Mapping[str, Robot],
    samples: Mapping[str, Sequence[Sample]],
    path: str,
    title: str,
    world: World | None = None,
) -> None:
    """Draws the plots of a run, with its world, to a file whose suffix is one of ``FORMATS``.

    ``samples`` has the samples of all ticks by robot name.  Equal runs give files with equal
    bytes.  Raises ``PictureError`` if matplotlib is not installed.  Raises ``OSError`` if the file
    cannot be written.
    """
    check_plotting()
    import matplotlib

    figure = draw(robots, samples, title, world)
    file_format = path.rsplit(".", 1)[-1].lower()
    # Without the metadata (date, version of matplotlib), equal runs give files with equal bytes.
    metadata: dict[str, dict[str, None]] = {
        "png": {"Software": None},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    with matplotlib.rc_context({"svg.hashsalt": "thorvaldc"}):
        file = io.BytesIO()
        figure.savefig(file, dpi=130, format=file_format, metadata=metadata[file_format])
    write_file(Path(path), file.getvalue())


def draw(
    robots: Mapping[str, Robot],
    samples: Mapping[str, Sequence[Sample]],
    title: str,
    world: World | None = None,
) -> Any:
    """Returns the plots of a run as a matplotlib figure that does not require a display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    finite = {name: _finite(list(run)) for name, run in samples.items()}
    shown = [name for name in finite if finite[name]][:MOST_ROBOTS]
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
    _draw_paths(ground, robots, finite)
    if world is not None:
        draw_world(ground, world, next(iter(robots.values())))
    for name, axes in zip(shown, columns, strict=True):
        _draw_velocities(axes, finite[name])
        if len(robots) > 1:
            axes[0].set_title(name)
    if columns:
        lines, labels = columns[0][0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower right", ncols=4, fontsize=9)
    if len(finite) > len(shown) == MOST_ROBOTS:
        columns[-1][-1].set_xlabel(f"time (s); {MOST_ROBOTS} of {len(finite)} robots")
    return figure


def _finite(samples: list[Sample]) -> list[Sample]:
    """Returns the samples from before a divergence of the simulation."""
    for k, sample in enumerate(samples):
        values = (*sample.pose_true, *sample.pose_estimated, *sample.true, *sample.estimated)
        if not all(abs(value) < _OUT_OF_RANGE for value in values):
            return samples[:k]
    return samples


# -- paths (figure 8) -----------------------------------------------------------------


def _draw_paths(
    axes: Any, robots: Mapping[str, Robot], samples: Mapping[str, list[Sample]]
) -> None:
    from matplotlib.ticker import MultipleLocator

    largest_error = 0.0
    for order, (name, run) in enumerate(samples.items()):
        if not run:
            continue
        true, estimated = [s.pose_true for s in run], [s.pose_estimated for s in run]
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
        parts = footprint(robots[name], run[-1])
        _draw_robot(axes, footprint(robots[name], run[0]), true[0], 0.25)
        _draw_robot(axes, parts, true[-1], 1.0)
        _draw_outline(axes, parts, estimated[-1])
        if len(samples) > 1:
            axes.annotate(name, true[-1][:2], ha="center", va="center", fontsize=8)
        largest_error = max(largest_error, math.dist(true[-1][:2], estimated[-1][:2]))
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
    axes.set_title(f"paths; end error {largest_error * 1000:.3g} mm; robot to scale")
    if any(samples.values()):
        axes.legend(loc="best")


class Part(NamedTuple):
    """A visual shape of a robot, seen from above.

    * ``outline``: corners of the outline (m) in ``base_link``, with the shape (n, 2).
    * ``color``: colour of the shape, red, green, blue and opacity in 0..1.
    * ``top``: height of the highest point of the shape (m).
    """

    outline: Points
    color: tuple[float, float, float, float]
    top: float


def footprint(robot: Robot, sample: Sample | None = None) -> list[Part]:
    """Returns the visual shapes of a robot, seen from above, from the lowest to the highest.

    The wheels are drawn at the steering angles in ``sample``.
    """
    from thorvaldc.simulation.pictures.surfaces import outline_from_above

    positions: dict[str, float] = {}
    if sample is not None and sample.joints is not None:
        for wheel, angle in zip(robot.wheels, sample.joints.angles, strict=True):
            if wheel.steering_joint is not None:
                positions[wheel.steering_joint] = angle
    poses = JointTree(robot.links, robot.joints, positions).pose
    parts: list[Part] = []
    for link in robot.links:
        for visual in link.visuals:
            pose = poses[link.name] * visual.pose
            outline, top = outline_from_above(robot, visual.shape, pose)
            parts.append(Part(outline, visual.color, top))
    return sorted(parts, key=lambda part: part.top)


def _transformed(outline: Points, pose: Pose2) -> Points:
    import numpy as np

    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    transformed: Points = outline @ np.array([[c, s], [-s, c]]) + np.array([pose.x, pose.y])
    return transformed


def _draw_robot(axes: Any, parts: Sequence[Part], pose: Pose2, opacity: float) -> None:
    from matplotlib.patches import Polygon

    for part in parts:
        axes.add_patch(
            Polygon(
                _transformed(part.outline, pose),
                facecolor=part.color[:3],
                edgecolor="#303030",
                lw=0.3,
                alpha=opacity * part.color[3],
                zorder=1.5 if opacity < 1.0 else 3.0,
            )
        )


def _draw_outline(axes: Any, parts: Sequence[Part], pose: Pose2) -> None:
    import numpy as np
    from matplotlib.patches import Polygon

    from thorvaldc.simulation.pictures.surfaces import convex

    if parts:
        outline = convex(np.vstack([part.outline for part in parts]))
        axes.add_patch(
            Polygon(
                _transformed(outline, pose),
                fill=False,
                edgecolor=ESTIMATED,
                ls=(0, (4, 2)),
                lw=1.0,
            )
        )


# -- velocities (figure 9) -----------------------------------------------------------------


def _draw_velocities(axes: Sequence[Any], samples: Sequence[Sample]) -> None:
    times = [s.time for s in samples]
    rows = (("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"))
    lines = (
        ("commanded", "commanded", COMMANDED, "-", 2.4),
        ("limited", "within limits", LIMITED, "-", 1.0),
        ("true", "true", TRUE, "-", 1.2),
        ("estimated", "estimated", ESTIMATED, (0, (4, 2)), 1.0),
    )
    for axis, (part, unit) in zip(axes, rows, strict=True):
        for twist, label, color, style, width in lines:
            values = [getattr(getattr(s, twist), part) for s in samples]
            steps = "steps-post" if twist == "commanded" else "default"
            axis.plot(times, values, color=color, ls=style, lw=width, label=label, drawstyle=steps)
        low, high = axis.get_ylim()
        if high - low < 0.1:  # do not magnify the noise of a value that stays zero
            middle = (high + low) / 2.0
            axis.set_ylim(middle - 0.05, middle + 0.05)
        axis.set_ylabel(f"{part} ({unit})")
        axis.grid(True, color="#e6e6e6", lw=0.6)
        axis.margins(x=0.0)
    axes[-1].set_xlabel("time (s)")


# -- world -----------------------------------------------------------------------------------------

BODY, ZONE = "#8c6d46", "#c6dbef"
_FLAT = math.radians(0.1)
"""Slope below which no arrow is drawn."""
_CORNERS = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))


def draw_world(axes: Any, world: World, robot: Robot) -> None:
    """Draws the world under the paths; the limits of the axes are left to the paths.

    ``robot``: any robot of the scene, whose meshes bodies may use.
    """
    for zone in world.zones:
        _draw_zone(axes, zone)
    _draw_bodies(axes, world, robot)
    ground = world.ground
    if abs(ground.angle) > _FLAT:
        # The arrow points uphill.
        dx, dy = math.cos(ground.direction), math.sin(ground.direction)
        axes.annotate(
            "",
            xy=(0.08 + 0.04 * dx, 0.92 + 0.04 * dy),
            xytext=(0.08 - 0.04 * dx, 0.92 - 0.04 * dy),
            xycoords="axes fraction",
            arrowprops={"arrowstyle": "-|>", "color": BODY},
        )
        text = f"rises by {math.degrees(ground.angle):.3g} deg"
        axes.text(0.14, 0.92, text, transform=axes.transAxes, va="center", fontsize=8, color=BODY)


def _draw_zone(axes: Any, zone: Zone) -> None:
    from matplotlib.patches import Polygon

    from thorvaldc.simulation.pictures.triangles import zone_text

    corners = [zone.pose.apply((x * zone.size[0], y * zone.size[1], 0.0))[:2] for x, y in _CORNERS]
    axes.add_patch(Polygon(corners, facecolor=ZONE, edgecolor="#6baed6", lw=0.6, zorder=0.5))
    text = zone_text(zone)
    if text:
        axes.text(*zone.pose.xyz[:2], text, fontsize=7, ha="center", va="center", clip_on=True)


def _draw_bodies(axes: Any, world: World, robot: Robot) -> None:
    from matplotlib.patches import Polygon

    from thorvaldc.simulation.pictures.surfaces import outline_from_above

    for block in world.blocks:
        outline, _ = outline_from_above(robot, block.shape, block.pose)
        axes.add_patch(
            Polygon(
                outline,
                facecolor=BODY,
                edgecolor="#303030",
                lw=0.4,
                alpha=0.6,
                zorder=1.0,
            )
        )
