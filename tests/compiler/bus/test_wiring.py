"""Buses that many compilations of one robot share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import GOOD
from thorvaldc.compiler.bus import assemble_buses
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model.model_json import to_json

FOREIGN = """\
foreign_devices:
  sprayer: {frames: {state: {cob_id: 0x300, direction: report, rate: 10 Hz}}}
"""
ROBOT = GOOD
VARIANTS = {
    "the same": ROBOT,
    "no battery": ROBOT.replace("0.07]}", "0.07]}, params: {with_battery: false}"),
    "another line of the battery": ROBOT.replace("  battery:", "\n  battery:"),
    "another frame": ROBOT.replace("width: 0.9 m", "width: 1.05 m"),
    "another node id": ROBOT.replace("can: 4", "can: 9"),
    "another encoder": ROBOT.replace("can: 4", "can: 4, params: {encoder_ppr: 4096}"),
    "another bitrate": ROBOT + "buses: {main: {bitrate: 1 Mbit/s}}\n",
    "another rate": ROBOT + "driver: {rate: 25 Hz}\n",
    "a lower speed": ROBOT + "driver: {max_linear_velocity: 0.5 m/s}\n",
    "another line": ROBOT.replace("  fl:", "\n  fl:"),
    "a duplicate id": ROBOT.replace("can: 4", "can: 3"),
    "a foreign device": ROBOT + FOREIGN,
}


def compiled(path: Path, text: str) -> tuple[str, list[str]]:
    path.write_text(text, encoding="utf-8")
    compilation = compile_file(path)
    model = "" if compilation.model is None else to_json(compilation.model)
    return model, [f"{d.span}: {d.message}" for d in compilation.report]


def test_remembered_buses_are_those_of_each_robot(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    expected = {name: compiled(path, text) for name, text in VARIANTS.items()}
    assert len({model for model, _ in expected.values()}) == len(VARIANTS)
    assert [name for name, (model, _) in expected.items() if not model] == ["a duplicate id"]
    with assemble_buses.remembered_buses():
        for _ in range(2):
            for name, text in VARIANTS.items():
                assert compiled(path, text) == expected[name], name


def test_buses_are_built_again_only_when_their_devices_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []
    build_buses = assemble_buses.build_buses

    def counted(*arguments: object, **options: object) -> object:
        built.append(arguments)
        return build_buses(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(assemble_buses, "build_buses", counted)
    path = tmp_path / "robot.yaml"
    with assemble_buses.remembered_buses():
        for width in (0.8, 0.9, 1.0, 1.1):
            compiled(path, ROBOT.replace("width: 0.9", f"width: {width}"))
        assert len(built) == 1
        compiled(path, VARIANTS["another node id"])
        assert len(built) == 2
        for _ in range(2):  # each compilation reports the error
            compiled(path, VARIANTS["a duplicate id"])
        assert len(built) == 4
    compiled(path, ROBOT)
    assert len(built) == 5
