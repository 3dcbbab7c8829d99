"""A folder for test robots: writes documents and compiles them."""

from __future__ import annotations

import textwrap
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Robot

# Modules with round numbers, for results that can be computed by hand.  The masses of a wheel and
# of the links above it are small spheres, nearly point masses.
MODULES = {
    "t/plate": """
        description: A body of 100 kg with its centre of mass in the middle and a free mount.
        params:
          mass: {quantity: mass, default: 100 kg, description: Mass., source: "chosen: round"}
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
        description: A wheel below a clamp; its axle may be offset to the left and behind.
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
            description: Rotation about z.
            source: "chosen: round"
          driven: {type: boolean, default: true, description: Motor., source: "chosen: round"}
          limit: {quantity: angle, default: 180 deg, description: Limit., source: "chosen: round"}
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
        description: A box that can be mounted at any pose.
        params:
          mass: {quantity: mass, default: 10 kg, description: Mass., source: "chosen: round"}
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
    """Writes ``folder/robot.yaml`` and modules under ``folder/my_modules``, and compiles them."""

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
        """Writes a module document; adds version and description if they are missing."""
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
        """Returns the model; fails on errors and on warnings other than ``warned``."""
        compilation = self.compile(modules, head)
        assert isinstance(compilation.model, Robot), "\n".join(format_report(compilation))
        unexpected = {d.code.name for d in compilation.report} - {*EXPECTED, *warned}
        assert not unexpected, "\n".join(format_report(compilation))
        return compilation.model

    def part(self, module: str, params: str = "") -> Robot:
        """Returns a cart that carries `part`, whose module document is ``module``."""
        self.module("t/part", module)
        params_text = f", params: {{{params}}}" if params else ""
        return self.robot(f"{CART}    part: {{type: t/part, mount: body.front{params_text}}}")

    def diagnostics(self, modules: str, head: str = "") -> list[Diagnostic]:
        return list(self.compile(modules, head).report)

    def part_codes(self, module: str, params: str = "", mount: str = "body.front") -> list[str]:
        """Returns the codes that `part` causes, without those of every cart."""
        self.module("t/part", module)
        params_text = f", params: {{{params}}}" if params else ""
        diagnostics = self.diagnostics(
            f"{CART}    part: {{type: t/part, mount: {mount}{params_text}}}"
        )
        return [d.code.name for d in diagnostics if d.code.name not in EXPECTED]


# Warnings of every cart with fixed wheels, without controllers, motors or battery, and of parts
# without mass, or with the round masses, sizes and places of examples.
EXPECTED = (
    "robot-without-controller",
    "motor-without-controller",
    "skid-steering",
    "no-drive",
    "battery-missing",
    "module-massless",
    "density-implausible",
    "inertia-too-large",
    "parts-overlap",
    "part-loose",
)


def format_report(compilation: Compilation) -> list[str]:
    return [f"{d.span}: {d.code.name}: {d.message}" for d in compilation.report]


# The smallest mesh file.
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
