"""Writes a module.yaml for a rigid part of a robot of others."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.model import Box, Collision, Cylinder, Inertial, Link, Pose, Shape, Sphere, Visual
from thorvaldc.model.spatial import IDENTITY_QUAT
from thorvaldc.tools.importer.robot_text import Names, Value, angle, flow

PORT = "frame_clamp"  # kind of all ports of imported modules


@dataclass
class ModuleText:
    """The content of a module.yaml, and the mesh files beside it.

    - ``sections``: lines of the sections after the links.
    - ``meshes``: path of each mesh file, by its name in the folder of the module.
    """

    description: str
    category: str
    source: str
    carrier: str = ""
    links: dict[str, list[str]] = field(default_factory=dict)
    joints: list[str] = field(default_factory=list)
    sections: list[str] = field(default_factory=list)
    meshes: dict[str, Path] = field(default_factory=dict)
    mass: float = 0.0

    def text(self, is_root: bool) -> str:
        """Returns the text of the file; the root of a robot has no mount."""
        first = next(iter(self.links))
        lines = ["thorvaldc: 1", f"description: {flow(self.description)}"]
        lines.append(f"category: {self.category}")
        if self.mass == 0.0 and not is_root:
            reason = flow("the imported description states no mass for it")
            lines.append(f"accept: [{{code: TV444, reason: {reason}}}]")
        if not is_root:
            lines.append(f"mount: {{kinds: [{PORT}], link: {first}}}")
        lines.append("links:")
        for name, parts in self.links.items():
            lines.append(f"  {name}:" if parts else f"  {name}: {{}}")
            lines += ["    parts:"] if parts else []
            lines += [f"      - {part}" for part in parts]
        if self.joints:
            lines += ["joints:", *(f"  {joint}" for joint in self.joints)]
        lines += self.sections
        lines.append(f"free_mount: {{kind: {PORT}, link: {self.carrier or first}}}")
        return "\n".join(lines) + "\n"

    def add_link(
        self, name: str, link: Link, mesh_files: dict[str, Path], *, collides: bool = True
    ) -> None:
        """Adds a link with its shapes and its mass."""
        collisions = list(link.collisions) if collides else []
        parts = self.links.setdefault(name, [])
        for visual in link.visuals:
            same = Collision(visual.shape, visual.pose)
            entry = self._shape(visual.shape, visual.pose, mesh_files)
            entry["color"] = _color(visual)
            if same in collisions:
                collisions.remove(same)
                entry["collide"] = True
            parts.append(flow(entry))
        for collision in collisions:
            entry = self._shape(collision.shape, collision.pose, mesh_files)
            parts.append(flow({**entry, "show": False, "collide": True}))
        if link.inertial is not None and link.inertial.mass > 0.0:
            self.add_mass(name, link.inertial)

    def add_mass(self, name: str, body: Inertial) -> None:
        self.mass += body.mass
        entry: dict[str, Value] = {"mass": body.mass, "com": [*body.com]}
        entry |= {"inertia": [*body.inertia], "source": f"published: {self.source}"}
        self.links.setdefault(name, []).append(flow(entry))

    def add_joint(self, name: str, kind: str, parent: str, child: str, **values: Value) -> None:
        entry: dict[str, Value] = {"type": kind, "parent": parent, "child": child}
        self.joints.append(f"{name}: {flow(entry | values)}")

    def _shape(self, shape: Shape, pose: Pose, mesh_files: dict[str, Path]) -> dict[str, Value]:
        if isinstance(shape, Box):
            value: dict[str, Value] = {"box": [*shape.size]}
        elif isinstance(shape, Cylinder):
            value = {"cylinder": {"radius": shape.radius, "length": shape.length}}
        elif isinstance(shape, Sphere):
            value = {"sphere": {"radius": shape.radius}}
        else:
            mesh: dict[str, Value] = {"file": self._mesh_name(mesh_files[shape.mesh])}
            if shape.scale != (1.0, 1.0, 1.0):
                mesh["scale"] = [*shape.scale]
            value = {"mesh": mesh}
        return {"shape": value, **placed(pose)}

    def _mesh_name(self, path: Path) -> str:
        for name, known in self.meshes.items():
            if known == path:
                return name
        taken = Names(Path(name).stem for name in self.meshes)
        name = f"meshes/{taken.make(path.stem, 'mesh')}{path.suffix.lower()}"
        self.meshes[name] = path
        return name


def placed(pose: Pose) -> dict[str, Value]:
    """Returns the keys ``xyz`` and ``rpy`` of a pose that is not the identity."""
    keys: dict[str, Value] = {}
    if any(pose.xyz):
        keys["xyz"] = [*pose.xyz]
    if pose.quat != IDENTITY_QUAT:
        keys["rpy"] = [angle(value) for value in pose.rpy()]
    return keys


def _color(visual: Visual) -> str:
    channels = [round(255 * min(max(value, 0.0), 1.0)) for value in visual.color]
    digits = channels if channels[3] < 255 else channels[:3]
    return "#" + "".join(f"{value:02x}" for value in digits)
