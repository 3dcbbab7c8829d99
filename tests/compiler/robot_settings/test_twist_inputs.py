"""Twist sources and locks in the model and in the parameters of ROS's twist_mux."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import GOOD
from thorvaldc.backends.ros2_parameters import parameter_file, twist_mux
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.model import Robot, TwistInput
from thorvaldc.model.model_json import from_json, to_json
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.se2 import Twist


def compiled(folder: Path, driver: str) -> Compilation:
    (folder / "robot.yaml").write_text(GOOD.replace("name: good\n", f"name: good\n{driver}"))
    return compile_file(folder / "robot.yaml")


def robot(folder: Path, driver: str) -> Robot:
    compilation = compiled(folder, driver)
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


def test_default_sources_are_those_of_the_original_system(tmp_path: Path) -> None:
    model = robot(tmp_path, "driver: {command_timeout: 0.4 s}\n")
    assert model.twist_sources == (
        TwistInput("teleop_joy", "teleop_joy/cmd_vel", 100, 0.4),
        TwistInput("auto_nav", "auto_nav/cmd_vel", 10, 0.4, "ramp"),
    )
    assert model.twist_locks == (
        TwistInput("safety_stop", "safety_stop/lock", 255, 0.0),
        TwistInput("auto_nav_pause", "auto_nav/pause", 50, 0.0),
    )


def test_sources_of_the_file_are_in_the_ros_parameters(tmp_path: Path) -> None:
    model = robot(
        tmp_path,
        "driver:\n"
        "  twist_sources:\n"
        "    auto_nav: {priority: 10, timeout: 1 s, topic: nav2/cmd_vel}\n"
        "    row_following: {priority: 20}\n"
        "  twist_locks: {gate: {priority: 30, timeout: 500 ms}}\n",
    )
    assert [(s.name, s.priority, s.timeout, s.topic) for s in model.twist_sources] == [
        ("teleop_joy", 100, 0.5, "teleop_joy/cmd_vel"),
        ("auto_nav", 10, 1.0, "nav2/cmd_vel"),
        ("row_following", 20, 0.5, "row_following/cmd_vel"),
    ]
    assert model.twist_locks[-1] == TwistInput("gate", "gate/lock", 30, 0.5)
    assert from_json(to_json(model)) == model
    text = parameter_file({"twist_mux": twist_mux(model)})
    assert 'topic: "nav2/cmd_vel"\n        timeout: 1.0\n        priority: 10\n' in text
    assert 'topic: "gate/lock"\n        timeout: 0.5\n        priority: 30\n' in text


@pytest.mark.parametrize(
    ("driver", "code"),
    [
        ("driver: {twist_sources: {a: {timeout: 1 s}}}\n", "missing-key"),
        ("driver: {twist_locks: {a: {timeout: 1 s}}}\n", "missing-key"),
        ("driver: {twist_sources: {a: {priority: 0}}}\n", "out-of-range"),
        ("driver: {twist_sources: {a: {priority: 256}}}\n", "out-of-range"),
        ("driver: {twist_sources: {a: {priority: 5, timeout: 0}}}\n", "size-not-positive"),
        ("driver: {twist_locks: {a: {priority: 5, timeout: -1 s}}}\n", "size-not-positive"),
        ("driver: {twist_sources: {a: {priority: 5, timeout: 1 m}}}\n", "wrong-dimension"),
        ("driver: {twist_sources: {a: {priority: 10}}}\n", "twist-priority-duplicate"),
        ("driver: {twist_sources: {auto_nav: {priority: 100}}}\n", "twist-priority-duplicate"),
        ("driver: {twist_sources: {a: {priority: 5, prio: 1}}}\n", "unknown-key"),
        ("driver: {twist_sources: {a: {priority: 255}}}\n", "twist-priority-lock"),
        ("driver: {twist_sources: {a: {priority: 50}}}\n", "twist-priority-lock"),
        ("driver: {twist_locks: {safety_stop: {priority: 99}}}\n", "twist-priority-lock"),
        ("driver: {twist_locks: {gate: {priority: 100}}}\n", "twist-priority-lock"),
    ],
)
def test_errors_are_reported(tmp_path: Path, driver: str, code: str) -> None:
    compilation = compiled(tmp_path, driver)
    assert [(d.code.name, d.span.line if d.span else 0) for d in compilation.report] == [(code, 3)]
    assert compilation.model is None


def test_source_above_a_stop_lock_is_reported_at_both(tmp_path: Path) -> None:
    driver = "driver:\n  twist_sources: {a: {priority: 210}}\n"
    driver += "  twist_locks: {safety_stop: {priority: 200}}\n"
    (diagnostic,) = compiled(tmp_path, driver).report
    assert diagnostic.span is not None
    assert (diagnostic.span.line, diagnostic.span.column) == (4, 33)
    assert "the stop lock `safety_stop` of the priority 200 would not stop it" in diagnostic.message
    assert "at most 199" in (diagnostic.hint or "")
    assert [label.span.line for label in diagnostic.labels] == [5]


def test_base_driver_and_twist_mux_stop_the_same_sources(tmp_path: Path) -> None:
    """twist_mux masks a source if ``priority < lock_priority`` (velocity_topic_handle)."""
    model = robot(
        tmp_path,
        "driver:\n"
        "  twist_sources: {a: {priority: 254}, b: {priority: 49}, c: {priority: 51}}\n"
        "  twist_locks: {gate: {priority: 30}, fence: {priority: 255}, half: {priority: 150}}\n",
    )
    for lock in model.twist_locks:
        for source in model.twist_sources:
            multiplexer = Multiplexer.from_robot(model)
            multiplexer.publish(source.name, Twist(0.1, 0.0, 0.0), 0.0)
            multiplexer.lock(lock.name, True, 0.0)
            masked_by_ros = source.priority < lock.priority
            assert (multiplexer.select(0.0).source == "") is masked_by_ros, (source, lock)


def test_sources_may_exchange_their_priorities(tmp_path: Path) -> None:
    model = robot(
        tmp_path,
        "driver: {twist_sources: {teleop_joy: {priority: 10}, auto_nav: {priority: 100}}}\n",
    )
    assert {s.name: s.priority for s in model.twist_sources} == {"teleop_joy": 10, "auto_nav": 100}
