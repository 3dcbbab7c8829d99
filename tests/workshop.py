"""A folder to build robots in: documents as text in, what the compiler makes of them out."""

from __future__ import annotations

import textwrap
from pathlib import Path

from thorvaldc.compiler.compilation import Compilation
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Robot

# Modules with round numbers, for results that can be worked out by hand.  A wheel and
# what carries it have their mass in one point each (small spheres).
MODULES = {
    "t/plate": """
        description: A body of 100 kg, its mass in the middle, with free places.
        params:
          mass: {quantity: mass, default: 100 kg, description: Of it., source: "chosen: round"}
        links:
          body:
            parts:
              - shape: {box: [1, 0.8, 0.1]}
                mass: ${mass}
                source: "chosen: round"
        ports:
          front: {kind: clamp, link: body, xyz: [0.5, 0, 0]}
          rear: {kind: clamp, link: body, xyz: [-0.5, 0, 0], rpy: [0, 0, 180 deg]}
        free_mount: {kind: clamp, link: body}
    """,
    "t/leg": """
        description: A wheel below a clamp, its axle to the left and behind if need be.
        category: leg
        params:
          radius: {quantity: length, default: 0.2, description: Wheel., source: "chosen: round"}
          drop: {quantity: length, default: 0.4, description: To axle., source: "chosen: round"}
          aside: {quantity: length, default: 0, description: Offset., source: "chosen: round"}
          trail: {quantity: length, default: 0, description: Offset., source: "chosen: round"}
          turns:
            type: text
            default: "no"
            choices: ["no", steers, swivels]
            description: How it turns about z.
            source: "chosen: round"
          driven: {type: boolean, default: true, description: Motor., source: "chosen: round"}
          limit: {quantity: angle, default: 180 deg, description: Of it., source: "chosen: round"}
          torque: {quantity: torque, default: 50, description: Motor., source: "chosen: round"}
        mount: {kinds: [clamp, carriage], link: post}
        links:
          post:
            parts:
              - {shape: {sphere: {radius: 0.02}}, mass: 2 kg, source: "chosen: round"}
          fork:
            parts:
              - {shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}
          tyre:
            parts:
              - shape: {cylinder: {radius: "${radius}", length: 0.1}}
                rpy: [90 deg, 0, 0]
                mass: 5 kg
                source: "chosen: round"
        joints:
          fixed: {when: "${turns == 'no'}", type: fixed, parent: post, child: fork}
          steering:
            when: ${turns == 'steers'}
            type: revolute
            role: steering
            parent: post
            child: fork
            axis: [0, 0, 1]
            lower: ${-limit}
            upper: ${limit}
          swivel:
            when: ${turns == 'swivels'}
            type: continuous
            role: swivel
            parent: post
            child: fork
            axis: [0, 0, 1]
          axle:
            type: continuous
            role: "${'propulsion' if driven else 'wheel'}"
            parent: fork
            child: tyre
            xyz: ["${-trail}", "${aside}", "${-drop}"]
            axis: [0, 1, 0]
        motors:
          propulsion:
            when: ${driven}
            joint: axle
            role: propulsion
            gear_ratio: 10:1
            encoder_ppr: 1000
            motor_max_speed: 100 rad/s
            max_acceleration: 5 rad/s^2
            max_torque: ${torque}
            rotor_inertia: 1e-4 kg m^2
            source: "chosen: round"
          steering:
            when: ${turns == 'steers'}
            joint: steering
            role: steering
            gear_ratio: 20:1
            encoder_ppr: 1000
            motor_max_speed: 100 rad/s
            max_acceleration: 5 rad/s^2
            max_torque: 60 N m
            source: "chosen: round"
        wheel:
          link: tyre
          radius: ${radius}
          width: 0.1
          friction: 0.8
          rolling_resistance: 0.01
          source: "chosen: round"
    """,
    "t/block": """
        description: A box that may lie anywhere.
        params:
          mass: {quantity: mass, default: 10 kg, description: Of it., source: "chosen: round"}
          size:
            type: list
            quantity: length
            default: [0.1, 0.1, 0.1]
            description: Edges.
            source: "chosen: round"
        mount: {kinds: [clamp], link: box}
        links:
          box:
            parts:
              - {shape: {box: "${size}"}, mass: "${mass}", source: "chosen: round"}
        free_mount: {kind: clamp, link: box}
    """,
}

CART = """
    body: {type: t/plate}
    fl: {type: t/leg, mount: {parent: body, xyz: [0.5, 0.4, 0]}}
    fr: {type: t/leg, mount: {parent: body, xyz: [0.5, -0.4, 0]}}
    rl: {type: t/leg, mount: {parent: body, xyz: [-0.5, 0.4, 0]}}
    rr: {type: t/leg, mount: {parent: body, xyz: [-0.5, -0.4, 0]}}
"""


class Workshop:
    """``folder/robot.yaml`` and module documents under ``folder/my_modules``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in MODULES.items():
            self.module(name, text)

    def write(self, path: str, text: str) -> Path:
        file = self.folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text).lstrip("\n"), encoding="utf-8")
        return file

    def module(self, name: str, text: str) -> None:
        """A module document under its type's name; version and description may be left out."""
        text = textwrap.dedent(text).lstrip("\n")
        if "description:" not in text.split("params:")[0].split("links:")[0]:
            text = "description: For a test.\n" + text
        self.write(f"my_modules/{name}/module.yaml", "thorvaldc: 1\n" + text)

    def robot_file(self, modules: str, head: str = "", path: str = "robot.yaml") -> Path:
        up = "../" * path.count("/")
        return self.write(
            path,
            f"thorvaldc: 1\nname: robot\nlibrary: [{up}my_modules]\n{textwrap.dedent(head)}"
            f"modules:\n{textwrap.indent(textwrap.dedent(modules).strip(), '  ')}\n",
        )

    def compile(self, modules: str, head: str = "") -> Compilation:
        return compile_file(self.robot_file(modules, head))

    def robot(self, modules: str, head: str = "", warned: tuple[str, ...] = ()) -> Robot:
        """The model, of a robot without errors and warned only of what is ``warned``."""
        done = self.compile(modules, head)
        assert isinstance(done.model, Robot), "\n".join(said(done))
        others = {d.code.name for d in done.report} - {*EXPECTED, *warned}
        assert not others, "\n".join(said(done))
        return done.model

    def part(self, module: str, params: str = "") -> Robot:
        """A cart that carries ``part``, of the module document in ``module``."""
        self.module("t/part", module)
        given = f", params: {{{params}}}" if params else ""
        return self.robot(f"{CART}    part: {{type: t/part, mount: body.front{given}}}")

    def faults(self, modules: str, head: str = "") -> list[Diagnostic]:
        return list(self.compile(modules, head).report)

    def part_faults(self, module: str, params: str = "", mount: str = "body.front") -> list[str]:
        """The codes that ``part`` gives rise to, without those of weight and drive."""
        self.module("t/part", module)
        given = f", params: {{{params}}}" if params else ""
        found = self.faults(f"{CART}    part: {{type: t/part, mount: {mount}{given}}}")
        return [d.code.name for d in found if d.code.name not in EXPECTED]


# What a cart of fixed wheels without controllers, or without motors, is told anyway.
EXPECTED = ("robot-without-controller", "motor-without-controller", "skid-steering", "no-drive")


def said(done: Compilation) -> list[str]:
    return [f"{d.span}: {d.code.name}: {d.message}" for d in done.report]


# A mesh file of the least size.
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
