"""Tests of extras without an inertia, and with meshes that cannot be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.compiler.extras.xacro_files import BOX, HEAD, STL, TRIANGLES, Loaded, load
from thorvaldc.model import Box, Cylinder
from thorvaldc.model.stl import binary_stl

# The tetrahedron of TRIANGLES has the volume 1/6 and the centre (1/4, 1/4, 1/4).
MESH = '<geometry><mesh filename="m.stl"/></geometry>'
MASS = '<inertial><mass value="2"/></inertial>'


def load_with_mesh(folder: Path, body: str, entry: str = "", stl: bytes = STL) -> Loaded:
    text = f"{HEAD}{body}</robot>\n"
    return load(folder, f"- {{xacro: a.xacro{entry}}}", a_xacro=text, m_stl=stl)


@pytest.mark.parametrize("tag", ["visual", "collision"])
def test_a_mass_without_inertia_gets_that_of_a_closed_mesh(tmp_path: Path, tag: str) -> None:
    shape = f'<{tag}><origin xyz="1 0 0"/>{MESH}</{tag}>'
    loaded = load_with_mesh(tmp_path, f'<link name="a">{MASS}{shape}</link>')
    assert loaded.codes == ["extra-inertia-computed"]
    assert "0.167 m^3 with 12 kg/m^3 are 2 kg" in loaded.only.message
    inertial = loaded.link("a").inertial
    assert inertial is not None
    assert inertial.mass == 2.0
    assert inertial.com == pytest.approx((1.25, 0.25, 0.25))
    assert inertial.inertia == pytest.approx((0.15, 0.15, 0.15, 0.025, 0.025, 0.025))


def test_a_stated_center_of_mass_is_kept(tmp_path: Path) -> None:
    inertial = MASS.replace("<mass", '<origin xyz="0 0 0.5"/><mass')
    loaded = load_with_mesh(tmp_path, f'<link name="a">{inertial}{BOX}</link>')
    computed = loaded.link("a").inertial
    assert computed is not None
    assert computed.com == (0.0, 0.0, 0.5)
    assert computed.inertia == pytest.approx((13 / 6, 10 / 6, 5 / 6, 0, 0, 0))


def test_a_density_gives_mass_to_links_without_inertial(tmp_path: Path) -> None:
    stated = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    body = (
        f'<link name="a"><visual>{MESH}</visual></link>\n<link name="frame_only"/>'
        f'<link name="b">{stated}<visual>{MESH}</visual></link>'
    )
    loaded = load_with_mesh(tmp_path, body, ", density: 6 g/cm^3")
    assert loaded.codes == ["extra-inertia-computed"]
    masses = {link.name: link.inertial and link.inertial.mass for link in loaded.parts.links}
    assert masses == {"a": 1000.0, "frame_only": None, "b": 2.0}
    without = load_with_mesh(tmp_path, body)
    assert without.codes == []
    assert without.link("a").inertial is None


def test_an_open_mesh_has_no_mass(tmp_path: Path) -> None:
    link = f'<link name="a">{MASS}<visual>{MESH}</visual></link>'
    opened = binary_stl(TRIANGLES[:3])
    loaded = load_with_mesh(tmp_path, link, stl=opened)
    assert loaded.codes == ["extra-element"]
    assert "closed meshes" in (loaded.only.hint or "")
    loaded = load_with_mesh(tmp_path, link.replace(MASS, ""), ", density: 1000", opened)
    assert loaded.codes == ["extra-mesh-open"]
    assert loaded.link("a").inertial is None


def test_the_visual_mesh_is_used_where_the_collision_mesh_is_open(tmp_path: Path) -> None:
    shapes = f"<visual>{MESH}</visual><collision>{MESH.replace('m.stl', 'open.stl')}</collision>"
    (tmp_path / "open.stl").write_bytes(binary_stl(TRIANGLES[:3]))
    loaded = load_with_mesh(tmp_path, f'<link name="a">{MASS}{shapes}</link>')
    assert "visual shapes" in loaded.only.message


@pytest.mark.parametrize("density", ["0", "-1 kg/m^3"])
def test_an_impossible_density(tmp_path: Path, density: str) -> None:
    loaded = load_with_mesh(tmp_path, '<link name="a"/>', f", density: {density}")
    assert "extra-number" in loaded.codes


def test_a_broken_mesh_for_the_eye_is_replaced_by_the_collision_shapes(tmp_path: Path) -> None:
    shapes = (
        f'<visual>{MESH}<material name="red"/></visual>'
        '<collision><origin xyz="0 0 1"/><geometry><cylinder radius="0.1" length="0.2"/>'
        "</geometry></collision>"
    )
    loaded = load_with_mesh(tmp_path, f'<link name="a">{shapes}</link>', stl=b"<COLLADA")
    assert "extra-visual-mesh" in loaded.codes
    assert not loaded.report.has_errors
    (visual,) = loaded.link("a").visuals
    assert visual.shape == Cylinder(0.1, 0.2)
    assert visual.pose.xyz == (0.0, 0.0, 1.0)
    assert loaded.parts.meshes == ()


def test_a_broken_mesh_without_collision_shapes_becomes_a_small_box(tmp_path: Path) -> None:
    body = f'<link name="a"><visual><origin xyz="1 0 0"/>{MESH}</visual></link>'
    loaded = load_with_mesh(tmp_path, body, ", density: 1000", stl=b"x")
    assert loaded.codes == ["extra-visual-mesh"]
    (visual,) = loaded.link("a").visuals
    assert visual.shape == Box((0.05, 0.05, 0.05))
    assert visual.pose.xyz == (1.0, 0.0, 0.0)
    assert loaded.link("a").inertial is None  # the box is not the shape of the link


def test_a_broken_mesh_that_collides_is_an_error(tmp_path: Path) -> None:
    body = f'<link name="a"><visual>{MESH}</visual><collision>{MESH}</collision></link>'
    loaded = load_with_mesh(tmp_path, body, stl=b"x")
    assert loaded.report.has_errors
    assert sorted(loaded.codes) == ["extra-visual-mesh", "mesh-invalid"]
