"""The intermediate model (IR) of a robot or a fleet of robots, independent of any output format."""

from typing import TYPE_CHECKING

from thorvaldc.model.bus import Bus, Channel, FrameDefinition, Node, ObjectValue, Scalar, Signal
from thorvaldc.model.robot import (
    Actuator,
    Battery,
    Brake,
    Joint,
    JointServo,
    Link,
    Mimic,
    Module,
    Purchase,
    Robot,
    Sensor,
    SourcedMass,
    Tread,
    Wheel,
    wheel_joints,
)
from thorvaldc.model.settings import (
    CalculatorChoice,
    DriverSettings,
    ParameterSet,
    RosSettings,
    TwistInput,
)
from thorvaldc.model.shapes import (
    Box,
    Collision,
    Cylinder,
    Mesh,
    MeshShape,
    Shape,
    Sphere,
    Visual,
)
from thorvaldc.model.spatial import Inertial, Pose, Vec3

# Most commands have one robot without a scene: the classes of a scene are made at their first use.
if TYPE_CHECKING:
    from thorvaldc.model.fleet import (
        Block,
        Fleet,
        Ground,
        HeightMap,
        Placement,
        World,
        Zone,
        robots_by_name,
    )
else:
    _SCENE = {
        "Block",
        "Fleet",
        "Ground",
        "HeightMap",
        "Placement",
        "World",
        "Zone",
        "robots_by_name",
    }

    def __getattr__(name):
        if name not in _SCENE:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return getattr(import_module("thorvaldc.model.fleet"), name)


__all__ = [
    "Actuator",
    "Battery",
    "Block",
    "Box",
    "Brake",
    "Bus",
    "CalculatorChoice",
    "Channel",
    "Collision",
    "Cylinder",
    "DriverSettings",
    "Fleet",
    "FrameDefinition",
    "Ground",
    "HeightMap",
    "Inertial",
    "Joint",
    "JointServo",
    "Link",
    "Mesh",
    "MeshShape",
    "Mimic",
    "Module",
    "Node",
    "ObjectValue",
    "ParameterSet",
    "Placement",
    "Pose",
    "Purchase",
    "Robot",
    "RosSettings",
    "Scalar",
    "Sensor",
    "Shape",
    "Signal",
    "SourcedMass",
    "Sphere",
    "Tread",
    "TwistInput",
    "Vec3",
    "Visual",
    "Wheel",
    "World",
    "Zone",
    "robots_by_name",
    "wheel_joints",
]
