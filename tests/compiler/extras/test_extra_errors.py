"""Tests of the diagnostics of invalid extras, with their lines and labels."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.compiler.extras.xacro_files import (
    BOX,
    ENDS,
    HEAD,
    INERTIAL,
    SENSOR,
    inertia,
    joint,
    link_with,
    load,
    load_one,
    mesh,
)
from tests.slow import one_quick_of


@pytest.mark.parametrize(
    ("body", "code", "line", "words"),
    one_quick_of(
        4,
        [
            ("<link name='a'>\n<visual></link>", "extra-xml", 4, "mismatched"),
            ("<link\n name='${1 +}'/>", "extra-expansion", 3, "1 +"),
            ("<link/>\n<link name='a'><visual name='${x}'/></link>", "extra-expansion", 4, "'x'"),
            (
                "<xacro:if value='maybe'>\n<link name='a'/></xacro:if>",
                "extra-expansion",
                3,
                "maybe",
            ),
            ("\n<xacro:lazer name='a'/>", "extra-expansion", 4, "lazer"),
            ("\n<xacro:include filename='none.xacro'/>", "extra-expansion", 4, "none.xacro"),
            ("<link name='$(arg size)'/>", "extra-argument", 3, "`size`"),
            ("<link name='$(env HOME)'/>", "extra-environment", 3, "HOME"),
            ("<link name='${open(1)}'/>", "extra-expansion", 3, "open"),
            ("<link/>", "extra-element", 3, "name"),
            ("<link name='a'><visual/></link>", "extra-element", 3, "geometry"),
            ("<link name='a'><visual><geometry/></visual></link>", "extra-element", 3, "geometry"),
            (
                "<link name='a'><visual><geometry>\n<capsule r='1'/></geometry></visual></link>",
                "extra-element",
                4,
                "capsule",
            ),
            ("<link name='a'/><link name='a'/>", "extra-name-duplicate", 3, "`a`"),
            (f"<link name='frame_body'>\n{BOX}</link>", "extra-name-duplicate", 3, "frame_body"),
            (joint(ENDS, name="frame_mount"), "extra-name-duplicate", 4, "frame_mount"),
            (joint("<child link='a'/>"), "extra-element", 4, "parent"),
            (
                joint("<parent link='frame_boddy'/><child link='a'/>"),
                "extra-link-unknown",
                4,
                "frame_boddy",
            ),
            (joint(ENDS + "<mimic joint='x'/>", "continuous"), "extra-link-unknown", 4, "`x`"),
            (
                joint("<parent link='a'/><child link='frame_body'/>"),
                "extra-two-parents",
                4,
                "frame_body",
            ),
            (
                joint(ENDS) + f"\n<joint name='k' type='fixed'>{ENDS}</joint>",
                "extra-two-parents",
                6,
                "`a`",
            ),
            (joint("<parent link='a'/><child link='a'/>"), "extra-cycle", 4, "a -> a"),
            (joint(ENDS, "floating"), "extra-joint-type", 4, "floating"),
            (joint(ENDS, "ball"), "extra-joint-type", 4, "ball"),
            (joint(ENDS, ""), "extra-joint-type", 4, "no type"),
            (joint(ENDS, "revolute"), "extra-joint-limits", 4, "limit"),
            (
                joint(ENDS + "\n<limit lower='1' upper='0' effort='1' velocity='1'/>", "revolute"),
                "extra-joint-limits",
                6,
                "1",
            ),
            (
                joint(ENDS + "\n<limit effort='-1' velocity='1'/>", "prismatic"),
                "extra-joint-limits",
                6,
                "-1",
            ),
            (joint(ENDS + "\n<axis xyz='0 0 0'/>", "continuous"), "extra-number", 6, "axis"),
            (joint(ENDS + "\n<origin xyz='0 0'/>"), "extra-number", 6, "2 numbers"),
            (joint(ENDS + "\n<origin xyz='0, 0, 1'/>"), "extra-number", 6, "0,"),
            (joint(ENDS + "\n<origin rpy='0 0 nan'/>"), "extra-number", 6, "nan"),
            (
                "<link name='a'><visual><geometry>\n<box size='1 0 1'/></geometry></visual></link>",
                "extra-number",
                4,
                "0 m",
            ),
            (link_with(inertia("-1")), "extra-inertia", 4, "must be at least 0 kg"),
            (link_with(inertia("1", izz="2.1")), "extra-inertia", 5, "2.1"),
            (link_with(inertia("1", ixy="1.5")), "extra-inertia", 5, "negative"),
            (link_with(inertia("0")), "extra-inertia", 4, "no mass"),
            (link_with(inertia("x")), "extra-number", 4, "`x`"),
            (link_with('<mass value="1"/>'), "extra-element", 3, "inertia"),
            (joint(ENDS, "continuous").replace(INERTIAL, ""), "extra-massless", 3, "no mass"),
            (
                joint(ENDS, "continuous").replace(INERTIAL, "")
                + f"<link name='b'>{INERTIAL}</link><joint name='k' type='continuous'>"
                "<parent link='a'/><child link='b'/></joint>",
                "extra-massless",
                3,
                "no mass",
            ),
            ("<link name='a'>\n<visul/></link>", "extra-left-out", 4, "visul"),
            ("<link name='a'/><macro name='x'/>", "extra-left-out", 3, "macro"),
            ("<link name='a' nome='b'/>", "extra-left-out", 3, "nome"),
            (
                "<link name='a'>" + BOX.replace("</v", "<material name='x'/></v") + "</link>",
                "extra-material",
                3,
                "`x`",
            ),
            (
                "<link name='a'>"
                + BOX.replace("</v", "<material>\n<color rgba='255 0 0 1'/></material></v")
                + "</link>",
                "extra-number",
                4,
                "between 0 and 1",
            ),
            (mesh("\nnone.stl"), "extra-visual-mesh", 3, "none.stl"),
            (mesh("\nnone.stl").replace("visual", "collision"), "mesh-missing", 3, "none.stl"),
            (mesh("http://x.y/none.stl"), "mesh-missing", 3, "http"),
            (mesh("a.blend"), "extra-visual-mesh", 3, "blend"),
            (mesh("a.blend").replace("visual", "collision"), "mesh-format", 3, "blend"),
        ],
    ),
)
def test_an_error_has_its_code_and_line(
    tmp_path: Path, body: str, code: str, line: int, words: str
) -> None:
    loaded = load_one(tmp_path, body)
    assert loaded.codes[0] == code, [d.message for d in loaded.report]
    first = next(iter(loaded.report))
    assert first.span is not None
    assert (first.span.file, first.span.line) == ("a.xacro", line)
    assert words in first.message
    assert str(tmp_path) not in first.message + (first.hint or "")


def test_an_error_in_a_macro_has_a_label_at_the_call(tmp_path: Path) -> None:
    inner = (
        HEAD + '\n<xacro:macro name="m" params="n">\n' + mesh("none.stl") + "</xacro:macro></robot>"
    )
    outer = HEAD + '<xacro:include filename="m.xacro"/>\n<xacro:m n="1"/></robot>'
    loaded = load(tmp_path, "- xacro: a.xacro", a_xacro=outer, m_xacro=inner)
    assert loaded.codes == ["extra-visual-mesh"]
    assert str(loaded.only.span).startswith("m.xacro:5:")
    loaded = load(
        tmp_path,
        "- xacro: a.xacro",
        a_xacro=outer,
        m_xacro=inner.replace("none.stl", "${1/0}"),
    )
    assert loaded.codes == ["extra-expansion"]
    assert str(loaded.only.span).startswith("m.xacro:5:")
    assert ("a.xacro", 4) in [(label.span.file, label.span.line) for label in loaded.only.labels]


def test_an_error_in_a_property_has_a_label_at_its_definition(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, '<xacro:property name="w" value="${2 * q}"/>\n<link name="${w}"/>')
    assert loaded.codes == ["extra-expansion"]
    assert loaded.only.span is not None
    assert loaded.only.span.line == 4
    assert any(label.span.line == 3 and "`w`" in label.text for label in loaded.only.labels)


def test_a_macro_called_without_its_prefix(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, '<link name="a"/><xacro:macro name="lidar"/><lidar/>')
    assert loaded.codes == ["extra-left-out"]
    assert "<xacro:lidar" in (loaded.only.hint or "")


def test_a_file_of_macros_gets_a_hint_with_a_call(tmp_path: Path) -> None:
    loaded = load(tmp_path, "- xacro: laser.xacro", laser_xacro=SENSOR)
    assert loaded.codes == ["extra-empty"]
    assert '<xacro:laser name="..." parent="..."><origin .../></xacro:laser>' in (
        loaded.only.hint or ""
    )


def test_an_unused_argument_is_a_warning(tmp_path: Path) -> None:
    loaded = load_one(
        tmp_path,
        '<xacro:arg name="height" default="1"/><link name="a_$(arg height)"/>',
        ", args: {heigth: 2}",
    )
    assert loaded.codes == ["extra-argument-unused"]
    assert loaded.only.hint == "did you mean `height`?"
    assert loaded.only.span is not None
    assert loaded.only.span.file == "robot.yaml"


def test_an_environment_variable_is_missing_or_unused(tmp_path: Path) -> None:
    body = '<link name="a_$(env ROS_VERSION)"/>'
    missing = load_one(tmp_path, body, ", env: {ROS_VERSON: 2}").only
    assert "env: {ROS_VERSION: ...}" in (missing.hint or "")
    unused = load_one(tmp_path, body, ", env: {ROS_VERSION: 2, ROS_DISTRO: x}").only
    assert unused.code.name == "extra-argument-unused"
    assert "environment variable `ROS_DISTRO`" in unused.message


def test_placement_of_a_file_without_root_links_is_a_warning(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, joint(ENDS), ", xyz: [0, 0, 1]")
    assert loaded.codes == ["extra-placement-unused"]


def test_an_unknown_parent(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, '<link name="a"/>', ", parent: frame_boddy")
    assert loaded.codes == ["extra-parent"]
    assert loaded.only.hint == "did you mean `frame_body`?"


def test_a_missing_xacro_file_and_package_folder(tmp_path: Path) -> None:
    loaded = load(
        tmp_path,
        "[{xacro: none.xacro}, {xacro: a.xacro, packages: {p: none}}]",
        a_xacro=HEAD + "<link name='a'/></robot>",
    )
    assert loaded.codes == ["extra-missing", "extra-package"]


def test_a_file_without_a_robot_element(tmp_path: Path) -> None:
    loaded = load(tmp_path, "- xacro: a.xacro", a_xacro="<sdf version='1.6'/>")
    assert loaded.codes == ["extra-xml"]
    assert "<sdf>" in loaded.only.message
    loaded = load(tmp_path, "- xacro: a.xacro", a_xacro=b"\x00\xff nothing")
    assert loaded.codes == ["extra-xml"]


def test_one_run_reports_the_errors_of_all_files(tmp_path: Path) -> None:
    loaded = load(
        tmp_path,
        "[{xacro: a.xacro}, {xacro: b.xacro}, {xacro: c.xacro}]",
        a_xacro=HEAD + "<link name='${x}'/></robot>",
        b_xacro=HEAD
        + link_with(inertia("-1"))
        + joint(ENDS, "ball").replace("`a`", "`b`")
        + "</robot>",
        c_xacro=HEAD + "<link name='c'/></robot>",
    )
    assert loaded.codes[0] == "extra-expansion"
    assert {"extra-inertia", "extra-joint-type"} <= set(loaded.codes)
    assert [link.name for link in loaded.parts.links][-1] == "c"
