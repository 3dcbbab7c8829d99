"""The hook of hatchling that compiles the modules of a control cycle with mypyc into a wheel.

The binaries come from the same source as the interpreted modules, and lie beside them in the wheel.
Python prefers a binary.  ADR 31 has the reasons and the costs.

Values of ``THORVALDC_COMPILE`` for the build of a wheel: ``1`` compiles or fails, ``0`` does not
compile.  Without the variable, a source distribution is compiled if there is a compiler, and a
checkout is not.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).resolve().parents[1]
VARIABLE = "THORVALDC_COMPILE"
TOOLS = ["mypy>=2.4", "setuptools>=75"]
"""mypy contains mypyc; setuptools runs the C compiler."""
ROOMS = ("runtime", "can", "model", "diagnostics", "simulation", "schema", "compiler")
"""Rooms whose types the compiled modules use."""
GROUP = "thorvaldc_tick"
"""Prefix of the library that contains the machine code of all modules."""
RUNTIME_MODULES = (
    "model/sums",
    "runtime/se2",
    "runtime/motion_supervision",
    "runtime/base_interface",
    "runtime/calculators/base_geometry",
    "runtime/calculators/twist_fit",
    "runtime/calculators/wheel_contradictions",
    "runtime/calculators/wheel_causes",
    "runtime/calculators/wheel_mixture",
    "runtime/calculators/twist_estimator",
    "runtime/calculators/base_calculator",
    "runtime/calculators/steering_branch",
    "runtime/calculators/reachable_twists",
    "runtime/calculators/general",
    "runtime/calculators/differential",
    "runtime/twist_ramp",
    "runtime/filter_covariance",
    "runtime/odometry",
    "runtime/permission",
    "runtime/multiplexer",
    "runtime/pace",
    "runtime/driver",
    "can/frame",
    "can/frame_bits",
    "runtime/can_base/signal_codec",
    "runtime/can_base/bus_connection",
    "runtime/can_base/motor_controller",
    "runtime/can_base/cia402_driver",
    "runtime/can_base/roboteq_driver",
    "runtime/can_base/stop_ladder",
    "runtime/can_base/base_state_machine",
    "runtime/can_base/can_base",
)
SIMULATION_MODULES = (
    "simulation/physics/drive_servos",
    "simulation/physics/mujoco_scene",
    "simulation/physics/sim_base",
    "simulation/physics/mujoco_base",
    "simulation/physics/scenario_base",
    "simulation/control_loop",
)
MODULES = RUNTIME_MODULES + SIMULATION_MODULES
"""Modules that a control cycle runs, without the folder of the package and the suffix.

What mypyc asks of them:

- A variable of the type ``float`` converts an integer: what must stay an integer is
  ``int | float``.  A tuple of floats has no identity.
- A class value that subclasses replace is a ``ClassVar`` or a property; compiled code would read
  that of the base class.  Classes that plug-ins or interpreted modules extend carry ``mypyc_attr``
  (``runtime/mypyc_marks.py``), and dataclasses that they extend stay interpreted.  A compiled class
  has one base class, and others only with the mark ``trait``.
- A compiled dataclass has no types of its fields at run time, by which ``model.json`` is read, and
  a frozen one cannot be copied or pickled.  ``model`` and ``simulation_result`` stay interpreted.
- Tests cannot replace methods and attributes of compiled objects.  ``frame_receiver``,
  ``node_watchdog``, ``battery_and_io_drivers`` and ``run_time_parameters`` stay interpreted.
- Constants are ``Final``, which saves a search in a dictionary, except tuples of floats: mypyc 2.4
  takes these for unset in another module.  A list from numpy is assigned to a name with a type.
  ``zip`` has no arguments by name in a loop of every cycle.
"""

# A fused multiply-add rounds once, where Python rounds twice: the numbers would depend on the
# processor.  `-g0`: debug symbols are several times as large as the code.
FLAGS = ["-O2", "-g0", "-ffp-contract=off"]


class CompilationError(Exception):
    """The modules were not compiled; the text says why."""


def compile_modules(package: Path, modules: Sequence[str], out: Path) -> list[Path]:
    """Compiles modules of a package folder; returns the binaries, relative to ``out``.

    Raises ``CompilationError``.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # A copy of the rooms without the rest: the API of the package imports all rooms for type
        # checkers, and mypy would check numpy and trimesh for some minutes.
        for room in ROOMS:
            shutil.copytree(package / room, folder / "thorvaldc" / room)
        (folder / "thorvaldc/__init__.py").touch()
        command = [sys.executable, str(Path(__file__).resolve()), str(out.resolve()), *modules]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            lines = (run.stdout + run.stderr).splitlines()
            errors = [line for line in lines if " error: " in line or "error:" in line.lower()]
            raise CompilationError("\n".join(errors or lines[-20:]))
    binaries = sorted(path.relative_to(out) for path in out.rglob("*") if path.is_file())
    if len(binaries) != len(modules) + 1:  # and the library with the code of all
        raise CompilationError(f"{len(binaries)} binaries of {len(modules)} modules")
    return binaries


_DOCUMENTED = (ast.FunctionDef, ast.ClassDef)
_DOCSTRING = r'PyDoc_STR\((NULL|"(?:[^"\\]|\\.)*")\)'
_METHOD = re.compile(r"(\(PyCFunction\)CPyPy_(\w+),\s+[\w| ]+, )" + _DOCSTRING)
_CLASS = re.compile(r"(CPyType_(\w+)_template_ = \{[^}]*?\.tp_doc = )" + _DOCSTRING)
"""Entries of the generated C code with the signature of a method, or of a class, as docstring."""


def _with_docstrings(sources: Iterable[Path], modules: Sequence[str]) -> None:
    """Adds the docstrings, for ``help``, to C code in which mypyc writes only the signatures."""
    docstrings: dict[str, str] = {}
    for module in modules:
        body = ast.parse(Path(f"thorvaldc/{module}.py").read_text("utf-8")).body
        nodes = [((node.name,), node) for node in body if isinstance(node, _DOCUMENTED)]
        for outer in (node for node in body if isinstance(node, ast.ClassDef)):
            for node in (node for node in outer.body if isinstance(node, _DOCUMENTED)):
                # A method of a named tuple is an object of a class with the name of both.
                nodes.append(((outer.name, node.name), node))
                nodes.append(((f"{node.name}_{outer.name}_obj",), node))
        for names, node in nodes:
            parts = ["thorvaldc", *module.split("/")]
            for start in range(len(parts)):  # mypyc shortens a name as far as it stays unique
                docstrings["___".join([*parts[start:], *names])] = ast.get_docstring(node) or ""

    def documented(match: re.Match[str]) -> str:
        signature = "" if match[3] == "NULL" else match[3][1:-1]
        text = docstrings.get(match[2], "").encode()
        literal = "".join(f"\\{byte:03o}" for byte in text)  # no byte can end the text
        return f'{match[1]}PyDoc_STR("{signature}{literal}")'

    for source in sources:
        code = source.read_text("utf-8")
        source.write_text(_CLASS.sub(documented, _METHOD.sub(documented, code)), "utf-8")


def _build(out: str, modules: Sequence[str]) -> None:
    """Compiles the modules below the present folder; a process of its own, as mypyc expects it."""
    from mypyc.build import mypycify
    from setuptools import Distribution, Extension
    from setuptools.command.build_ext import build_ext

    class _ParallelBuild(build_ext):
        """Runs a C compiler for each processor; setuptools alone runs one after the other."""

        def build_extension(self, ext: Extension) -> None:
            def objects_of(source: str) -> list[str]:
                objects: list[str] = self.compiler.compile(
                    [source],
                    output_dir=self.build_temp,
                    include_dirs=ext.include_dirs,
                    extra_postargs=ext.extra_compile_args,
                )
                return objects

            with ThreadPoolExecutor(os.cpu_count()) as pool:
                for objects in pool.map(objects_of, ext.sources):
                    ext.extra_objects += objects
            ext.sources = []
            super().build_extension(ext)

    extensions = mypycify(
        [
            *("--ignore-missing-imports", "--no-site-packages", "--cache-dir", os.devnull),
            *(f"thorvaldc/{module}.py" for module in modules),
        ],
        opt_level="2",
        debug_level="0",
        group_name=GROUP,
        multi_file=True,
        target_dir="c",
    )
    for extension in extensions:
        extension.extra_compile_args += FLAGS
    _with_docstrings(Path("c").rglob("*.c"), modules)
    command = _ParallelBuild(Distribution({"ext_modules": extensions}))
    command.build_lib, command.build_temp = out, "objects"
    command.ensure_finalized()
    command.run()


def find_compiler() -> str:
    """Returns the path of the C compiler of this Python, or an empty text."""
    names = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[:1]
    return next(filter(None, map(shutil.which, [*names, "cc", "gcc", "clang"])), "")


class CustomBuildHook(BuildHookInterface[Any]):
    """Adds the binaries to a wheel that is not editable."""

    def dependencies(self) -> list[str]:
        return TOOLS if self._wanted() else []

    def _wanted(self) -> bool:
        wish = os.environ.get(VARIABLE, "")
        is_source_distribution = (Path(self.root) / "PKG-INFO").is_file()
        return wish == "1" or (wish != "0" and is_source_distribution and bool(find_compiler()))

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        if not self._wanted():
            reason = "no C compiler was found" if not find_compiler() else f"{VARIABLE}=1 does it"
            self.app.display_info(f"The runtime is not compiled: {reason}.")
            return
        self._folder = tempfile.TemporaryDirectory()
        out = Path(self._folder.name)
        try:
            is_whole = (Path(self.root) / "thorvaldc").is_dir()
            modules = MODULES if is_whole else RUNTIME_MODULES
            binaries = compile_modules(ROOT / "thorvaldc", modules, out)
        except CompilationError as error:
            self._folder.cleanup()
            if os.environ.get(VARIABLE) == "1":
                raise
            self.app.display_warning(f"The runtime is not compiled:\n{error}")
            return
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["force_include"].update({str(out / path): str(path) for path in binaries})

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if hasattr(self, "_folder"):
            self._folder.cleanup()


if __name__ == "__main__":
    _build(sys.argv[1], sys.argv[2:])
