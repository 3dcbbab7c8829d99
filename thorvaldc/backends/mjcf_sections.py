"""The sections of an MJCF model that all its robots share: options, defaults, assets."""

from __future__ import annotations

import math

from thorvaldc.backends.colors_and_meshes import Palette
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model import Mesh, Robot, Vec3
from thorvaldc.model.statics.wheel_contact import SOLIMP, SOLREF

TIMESTEP = 0.005  # s
# MuJoCo's implicit integrators apply the damping of the motor joints after the contact forces.  A
# robot that accelerates is then ahead of its wheels by 5 ms.  The explicit integrator has no such
# error.  For a joint of inertia I with damping d, a step of h multiplies the joint speed by 1 - d
# h / I: it is stable for d h / I < 2.  So it is used if d h / I of every servo is at most this
# value.  Robots with wheels that must slide get the implicit one: such wheels have no load except
# friction and chatter above 1.
EXPLICIT_DAMPING = 1.5
SAME_AXLE = 1e-3  # m and rad; wheels closer than this are on one axle


class ModelSections:
    """Collects the sections of a model with one or several robots."""

    def __init__(self, name: str, robots: list[Robot], mesh_folders: list[str]) -> None:
        self.model = name
        self.palette = Palette(*robots)
        self.folders = mesh_folders
        self.robots = robots
        self.worldbody = Element("worldbody")
        self.equality = Element("equality")
        self.actuators = Element("actuator")
        self.sensors = Element("sensor")
        self.asset = Element("asset")
        for material, color in self.palette.entries():
            self.asset.add("material", name=material, rgba=color)
        self.meshes: dict[tuple[str, Vec3], str] = {}
        self.taken: dict[str, str] = {}
        # The largest d h / I of all servos (see EXPLICIT_DAMPING).
        self.largest_damping = 0.0

    def root(self) -> Element:
        """Return the whole model, after all robots were written."""
        root = Element("mujoco", model=self.model)
        root.add(
            "compiler",
            angle="radian",
            autolimits=True,
            inertiafromgeom="false",
            balanceinertia=False,
        )
        # MuJoCo's default is dense for fewer than 60 degrees of freedom, but the wheels' rows are
        # mostly zeros.
        explicit = self.largest_damping <= EXPLICIT_DAMPING and not any(map(_slides, self.robots))
        root.add(
            "option",
            timestep=TIMESTEP,
            integrator="Euler" if explicit else "implicitfast",
            cone="elliptic",
            impratio=100,
            jacobian="sparse",
        )
        default = root.add("default")
        default.add("default", class_="visual").add(
            "geom", group=2, contype=0, conaffinity=0, mass=0
        )
        default.add("default", class_="collision").add("geom", group=3, mass=0)
        default.add("default", class_="wheel").add(
            "geom",
            type="ellipsoid",
            group=3,
            mass=0,
            condim=4,
            priority=1,
            solref=SOLREF,
            solimp=SOLIMP,
        )
        sections = (self.asset, self.worldbody, self.equality, self.actuators, self.sensors)
        root.children += [section for section in sections if section.children]
        return root

    def mesh(self, prefix: str, number: int, mesh: Mesh, scale: Vec3) -> str:
        """Return the name of the asset for a mesh at a scale; equal files share one asset."""
        key = (mesh.sha256, scale)
        name = self.meshes.get(key)
        if name is None:
            # Two files may differ only in their extension, and one file may have several scales.
            name = stem = prefix + mesh.name.rsplit(".", 1)[0]
            for count in range(2, len(self.meshes) + 2):
                if name not in self.taken:
                    break
                name = f"{stem}_{count}"
            self.taken[name] = mesh.name
            self.meshes[key] = name
            self.asset.add(
                "mesh",
                name=name,
                file=f"{self.folders[number]}/{mesh.name}",
                scale=None if scale == (1.0, 1.0, 1.0) else scale,
                # All masses are explicit.  MuJoCo's default, a volume, fails for open and flat
                # meshes.
                inertia="shell",
            )
        return name


def _slides(robot: Robot) -> bool:
    """True if wheels that cannot steer are on several axles: in a turn they must slide."""
    fixed = [w for w in robot.wheels if w.steering_joint is None and w.swivel_joint is None]
    for wheel in fixed[1:]:
        c, s = math.cos(fixed[0].heading), math.sin(fixed[0].heading)
        along = c * (wheel.x - fixed[0].x) + s * (wheel.y - fixed[0].y)
        if abs(along) > SAME_AXLE or abs(math.sin(wheel.heading - fixed[0].heading)) > SAME_AXLE:
            return True
    return False
