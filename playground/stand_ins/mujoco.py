"""A stand-in for the Python package ``mujoco`` in a browser, on MuJoCo's WebAssembly build.

It has what ``thorvaldc.simulation.physics`` uses.  Arrays are views of the memory of WebAssembly,
which move when the memory grows: they are made again then.  The worker registers the module of the
WebAssembly build as ``mujoco_wasm``, with the function ``steps(model, data, number)``.
"""

from __future__ import annotations

import array
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco_wasm
from pyodide.ffi import to_js

_COLUMNS = {
    "actuator_biasprm": 10,
    "actuator_gainprm": 10,
    "actuator_trnid": 2,
    "actuator_forcerange": 2,
    "actuator_ctrlrange": 2,
    "dof_solimp": 5,
    "geom_size": 3,
    "geom_pos": 3,
    "xpos": 3,
    "xquat": 4,
}
"""Columns of the arrays with two dimensions."""


class _Array:
    """An array of MuJoCo, or a row of one, with the methods of numpy that are used."""

    __slots__ = ("_columns", "_view")

    def __init__(self, view: Any, columns: int = 1) -> None:
        self._view, self._columns = view, columns

    def _place(self, key: Any) -> int | tuple[int, int]:
        columns = self._columns
        if isinstance(key, tuple):
            row, column = key
            if isinstance(column, slice):
                start, end, _ = column.indices(columns)
                return row * columns + start, row * columns + end
            return int(row * columns + column)
        if isinstance(key, slice):
            start, end, _ = key.indices(len(self))
            return start * columns, end * columns
        return int(key) if columns == 1 else (int(key) * columns, (int(key) + 1) * columns)

    def __getitem__(self, key: Any) -> Any:
        place = self._place(key)
        if isinstance(place, tuple):
            return _Array(self._view.subarray(*place))
        return self._view[place]

    def __setitem__(self, key: Any, value: Any) -> None:
        place = self._place(key)
        if isinstance(place, tuple):
            row = self._view.subarray(*place)
            values = value if isinstance(value, Sequence | _Array) else [value] * len(row)
            row.assign(array.array("d", values))
        else:
            self._view[place] = value

    def __len__(self) -> int:
        return len(self._view) // self._columns

    def __iter__(self) -> Iterator[Any]:
        return iter(self.tolist() if self._columns == 1 else [self[i] for i in range(len(self))])

    def tolist(self) -> list[Any]:
        values: list[Any] = self._view.to_py().tolist()
        if self._columns == 1:
            return values
        return [values[i : i + self._columns] for i in range(0, len(values), self._columns)]

    def max(self) -> Any:
        return max(self.tolist())

    def dot(self, other: _Array) -> float:
        return float(sum(a * b for a, b in zip(self.tolist(), other.tolist(), strict=True)))


class _Structure:
    """A structure of MuJoCo: ``mjModel`` or ``mjData``."""

    _js: Any
    _arrays: dict[str, _Array]

    def __init__(self, js: Any) -> None:
        self.__dict__["_js"] = js
        self.__dict__["_arrays"] = {}

    def __getattr__(self, name: str) -> Any:
        kept = self._arrays.get(name)
        if kept is not None and kept._view.byteLength:  # 0 after the memory has moved
            return kept
        value = getattr(self._js, name)
        if hasattr(value, "subarray"):
            value = self._arrays[name] = _Array(value, _COLUMNS.get(name, 1))
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._js, name, value)

    def __del__(self) -> None:
        self._js.delete()


class _Enumeration:
    def __init__(self, js: Any) -> None:
        self._js = js

    def __getattr__(self, name: str) -> int:
        value = int(getattr(self._js, name).value)
        self.__dict__[name] = value
        return value


mjtObj = _Enumeration(mujoco_wasm.mjtObj)
mjtDisableBit = _Enumeration(mujoco_wasm.mjtDisableBit)


class MjSpec:
    """A scene that is not compiled yet."""

    def __init__(self, js: Any, files: Any) -> None:
        self._js, self._files, self.compiler = js, files, js.compiler

    @classmethod
    def from_string(
        cls,
        xml: str,
        include: Mapping[str, bytes] | None = None,
        assets: Mapping[str, bytes] | None = None,
    ) -> MjSpec:
        files = mujoco_wasm.MjVFS.new()
        for name, data in {**(include or {}), **(assets or {})}.items():
            files.addBuffer(name, to_js(data))
        try:
            return cls(mujoco_wasm.parseXMLString(xml, files), files)
        except Exception as error:
            raise ValueError(str(error)) from error

    @classmethod
    def from_file(cls, path: str) -> MjSpec:
        xml = Path(path).read_text(encoding="utf-8")
        assets: dict[str, bytes] = {}
        for name in re.findall(r'\bfile="([^"]+)"', xml):
            file = Path(path).parent / name
            data = file.read_bytes()
            # MuJoCo knows files in memory by the last part of their paths.
            if assets.setdefault(file.name, data) != data:
                raise ValueError(f"two files have the name {file.name}")
        return cls.from_string(xml, assets=assets)

    def compile(self) -> _Structure:
        try:
            return _Structure(mujoco_wasm.mj_compile(self._js, self._files))
        except Exception as error:
            raise ValueError(str(error)) from error
        finally:
            self._js.delete()
            self._files.delete()


def MjData(model: _Structure) -> _Structure:
    return _Structure(mujoco_wasm.MjData.new(model._js))


def mj_name2id(model: _Structure, kind: int, name: str) -> int:
    return int(mujoco_wasm.mj_name2id(model._js, kind, name))


def mj_id2name(model: _Structure, kind: int, index: int) -> str:
    return str(mujoco_wasm.mj_id2name(model._js, kind, index))


def mj_resetDataKeyframe(model: _Structure, data: _Structure, key: int) -> None:
    mujoco_wasm.mj_resetDataKeyframe(model._js, data._js, key)


def mj_resetData(model: _Structure, data: _Structure) -> None:
    mujoco_wasm.mj_resetData(model._js, data._js)


def mj_forward(model: _Structure, data: _Structure) -> None:
    mujoco_wasm.mj_forward(model._js, data._js)


def mj_step(model: _Structure, data: _Structure, nstep: int = 1) -> None:
    mujoco_wasm.steps(model._js, data._js, nstep)


def get_mju_user_warning() -> None:
    """The worker receives the warnings of MuJoCo."""


def set_mju_user_warning(warn: Callable[[str], None] | None) -> None:
    """The worker receives the warnings of MuJoCo."""
