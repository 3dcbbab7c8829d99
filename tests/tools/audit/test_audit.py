"""``thorvaldc audit``: a robot without contradictions, and the same robot with each of them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import Command, thorvaldc
from thorvaldc.tools.audit.audit_run import audit

__all__ = ["thorvaldc"]
CART = Path(__file__).parent / "robots/cart"


@pytest.fixture
def cart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the cart, in the working folder."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(CART, tmp_path / "cart")
    return tmp_path / "cart"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count(old) >= 1, f"{path} does not contain {old!r}"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def findings(*names: str) -> list[tuple[str, str, int]]:
    return [
        (d.code.name, d.span.file if d.span else "", d.span.line if d.span else 0)
        for d in audit(names).report.sorted()
    ]


def test_a_robot_without_contradictions(cart: Path) -> None:
    result = audit(["cart"])
    assert list(result.report) == []
    assert [d.name for d in result.evidence.descriptions] == ["cart.urdf.xacro"]
    assert len(result.evidence.sections) >= 2


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        (
            "urdf/wheel.xacro",
            'name="wheel_radius" value="0.1"',
            'name="wheel_radius" value="0.097"',
            ("audit-wheel-radius", "cart/config/controllers.yaml", 11),
        ),
        (
            "urdf/cart.urdf.xacro",
            'y="0.25"',
            'y="0.27"',
            ("audit-wheel-separation", "cart/config/controllers.yaml", 10),
        ),
        (
            "urdf/cart.urdf.xacro",
            '<joint name="left_wheel_joint">',
            '<joint name="wheel_left_joint">',
            ("audit-joint-unknown", "cart/urdf/cart.urdf.xacro", 17),
        ),
    ],
)
def test_a_contradiction(
    cart: Path, file: str, old: str, new: str, expected: tuple[str, str, int]
) -> None:
    change(cart / file, old, new)
    assert findings("cart") == [expected]


def test_exit_status_and_formats(thorvaldc: Command, cart: Path) -> None:
    assert thorvaldc("audit", "cart").status == 0
    change(cart / "config/controllers.yaml", "wheel_radius: 0.1", "wheel_radius: 0.11")
    assert thorvaldc("audit", "cart").status == 0
    assert thorvaldc("audit", "cart", "--strict").status == 1
    output = thorvaldc("audit", "cart", "--format", "json")
    (diagnostic,) = json.loads(output.out)["diagnostics"]
    assert diagnostic["code"] == "TV943"
    assert "drives 9.1 % less far than its odometry says" in diagnostic["message"]
    assert "TV943" in thorvaldc("audit", "cart", "--format", "sarif").out
    github = thorvaldc("audit", "cart", "--format", "github").out
    assert "file=cart/config/controllers.yaml,line=11" in github
    change(cart / "config/controllers.yaml", "[left_wheel_joint]", "[left_joint]")
    assert thorvaldc("audit", "cart").status == 1
    assert thorvaldc("audit", "missing").status == 1
    assert thorvaldc("audit").status == 2
