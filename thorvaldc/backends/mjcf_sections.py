"""The sections of an MJCF model that all robots of the model share: options, defaults and
assets."""

from __future__ import annotations

import math

from thorvaldc.backends.colors_and_meshes import Palette
from thorvaldc.backends.xml_writer import Element
from thorvaldc.model import Mesh, Robot, Vec3
from thorvaldc.model.statics.wheel_contact import SOLIMP, SOLREF

TIMESTEP = 0.005  # s
# Largest d h / I of a servo for which the model uses MuJoCo's explicit integrator. The implicit
# integrators apply the damping of the motor joints after the contact forces. With MuJoCo's implicit
# integrators, an accelerating robot is ahead of its wheels by 5 ms. With MuJoCo's explicit
# integrator, an accelerating robot is not ahead of its wheels. For a joint with the inertia I and
# the damping d, an explicit step of h s multiplies the joint speed by 1 - d h / I. The explicit
# integrator is therefore stable for d h / I < 2, with the joint damping d, the time step h and the
# joint inertia I. MuJoCo models of robots with wheels that must slide use an implicit integrator.
# With the explicit integrator, sliding wheels would chatter if d h / I is above 1, because friction
# is their only load (d: joint damping, h: time step, I: joint inertia).
EXPLICIT_DAMPING = 1.5
SAME_AXLE = 1e-3  # m and rad, largest distance and angle between two wheels on the same axle


class ModelSections:
    """Collects the sections of an MJCF model with one or several robots."""

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
        # Largest ratio d h / I of all servos (d: joint damping, h: time step, I: joint inertia),
        # see EXPLICIT_DAMPING.
        self.largest_damping = 0.0

    def root(self) -> Element:
        """Return the root element ``mujoco`` of the MJCF model.

        The method ``root`` must be called after all robots are written to the MJCF model.
        """
        root = Element("mujoco", model=self.model)
        root.add(
            "compiler",
            angle="radian",
            autolimits=True,
            inertiafromgeom="false",
            balanceinertia=False,
        )
        # MuJoCo uses a dense Jacobian by default for fewer than 60 degrees of freedom. A sparse
        # Jacobian is better for these robots, because the rows of the wheels are mostly zeros.
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
        """Return the name of the MJCF asset for a mesh file with a scale.

        Equal mesh files with the same scale share one asset.
        """
        key = (mesh.sha256, scale)
        name = self.meshes.get(key)
        if name is None:
            # Mesh files can have names that differ only in the extension. A mesh file can be used
            # with several scales. The name of an MJCF asset is therefore made unique.
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
                # MuJoCo does not use the inertia of mesh files, because the MJCF model contains all
                # masses. MuJoCo's default value of the mesh attribute ``inertia`` fails for open
                # and flat meshes.
                inertia="shell",
            )
        return name


def _slides(robot: Robot) -> bool:
    """True if some wheels of a robot must slide sideways when the robot turns.

    Wheels must slide in a turn if the wheels that cannot steer or swivel are on several axles.
    """
    fixed = [w for w in robot.wheels if w.steering_joint is None and w.swivel_joint is None]
    for wheel in fixed[1:]:
        c, s = math.cos(fixed[0].heading), math.sin(fixed[0].heading)
        along = c * (wheel.x - fixed[0].x) + s * (wheel.y - fixed[0].y)
        if abs(along) > SAME_AXLE or abs(math.sin(wheel.heading - fixed[0].heading)) > SAME_AXLE:
            return True
    return False
