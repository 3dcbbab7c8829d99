"""The state of an episode at one instant, from which it goes on as it did, to the last bit.

The objects of an episode stay the same: the state has the values of their attributes and the
contents of their containers, and ``restore`` puts them back.  So objects of the compiled runtime
need no copy, and a program may keep a robot's control loop.
"""

from __future__ import annotations

import copy
import functools
import random
from collections import deque
from collections.abc import Callable, Iterator
from enum import Enum
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

_LARGE = ("mesh_", "hfield_", "tex_", "skin_", "flex_")
"""Names of arrays of a MuJoCo model that are shapes, which no episode changes, begin with these."""
_CONSTANT: tuple[type, ...] = (
    *(int, float, complex, str, bytes, type(None), range, slice, Enum, type),
    *(FunctionType, BuiltinFunctionType, MethodType, ModuleType, MujocoScene),
)
_CONSTANT_PACKAGES = ("thorvaldc.model", "thorvaldc.simulation.sensors", "mujoco", "re")
"""Objects of these packages do not change, or are the scene's own."""
_WITHOUT_ATTRIBUTES = 1 << 8  # Py_TPFLAGS_IMMUTABLETYPE: a type of C
_MISSING = object()

Restore = Callable[[], object]


class EpisodeState:
    """The state of an episode: the robots, their drivers, the scene and the sensors.

    ``Episode.save`` returns it, ``Episode.reset(state=...)`` continues from it, as often as wanted.
    It belongs to the episode that has saved it.
    """

    def __init__(
        self, owner: object, time: float, parts: tuple[Any, ...], scene: MujocoScene | None
    ) -> None:
        if scene is not None and type(scene) is not MujocoScene:
            raise DiagnosticError("simulation-scene", "a world of a batch cannot be saved")
        self.owner = owner
        self.time = time
        """Simulated time (s) of the last control cycle."""
        self.parts = parts
        self._steps = [*_restores(parts)]
        if scene is not None:
            self._steps.append(_scene_restore(scene))

    def __repr__(self) -> str:
        return f"<EpisodeState at {self.time:g} s>"

    def restore(self) -> None:
        """Puts all objects of the episode into this state."""
        for step in self._steps:
            step()


@functools.cache
def _model_arrays(kind: Any) -> tuple[str, ...]:
    names = (name for name in dir(kind) if not name.startswith(("_", *_LARGE)))
    return tuple(name for name in names if isinstance(getattr(kind, name), property))


def _scene_restore(scene: MujocoScene) -> Restore:
    data, steps, diverged = copy.copy(scene.data), scene.steps, scene.diverged
    # Faults, zones and motors without power change arrays of the model.
    present = (getattr(scene.model, name) for name in _model_arrays(scene.model.__class__))
    arrays = [(array, array.copy()) for array in present if type(array).__name__ == "ndarray"]

    def restore() -> None:
        import mujoco

        mujoco.mj_copyData(scene.data, scene.model, data)
        scene.steps, scene.diverged = steps, diverged
        for array, values in arrays:
            array[:] = values

    return restore


def _restores(content: object) -> Iterator[Restore]:
    """Yields a function for each object that can change, which restores its present values.

    Raises ``DiagnosticError`` if the values of an object are not known.
    """
    seen: set[int] = set()
    pending: list[Any] = [content]
    while pending:
        obj = pending.pop()
        kind = type(obj)
        if id(obj) in seen or isinstance(obj, _CONSTANT):
            continue
        seen.add(id(obj))
        if kind.__name__.startswith("__mypyc_lambda"):  # a function of the compiled runtime
            continue
        if isinstance(obj, (tuple, frozenset)):
            pending += obj
        elif isinstance(obj, (list, deque)):
            pending += obj
            yield _sequence_restore(obj)
        elif isinstance(obj, (dict, set)):
            pending += obj if isinstance(obj, set) else [*obj, *obj.values()]
            yield _collection_restore(obj)
        elif isinstance(obj, random.Random):
            yield functools.partial(obj.setstate, obj.getstate())
        elif kind.__name__ == "ndarray":
            if obj.base is None:  # else a view of the scene
                yield functools.partial(obj.__setitem__, ..., obj.copy())
        elif kind.__name__ == "Generator" and kind.__module__.startswith("numpy"):
            bits = obj.bit_generator
            yield functools.partial(setattr, bits, "state", bits.state)
        elif not kind.__module__.startswith(_CONSTANT_PACKAGES):
            if kind.__flags__ & _WITHOUT_ATTRIBUTES and kind is not object:
                message = f"a part of the driver cannot be saved: a {kind.__name__}"
                raise DiagnosticError("simulation-scene", message)
            values = {name: getattr(obj, name, _MISSING) for name in _names(obj)}
            pending += (value for value in values.values() if value is not _MISSING)
            yield _object_restore(obj, values)


def _names(obj: object) -> set[str]:
    """Returns the names of the attributes of an object: slots, of compiled classes, and others."""
    names = set(getattr(obj, "__dict__", ()))
    for part in type(obj).__mro__:
        slots = vars(part).get("__slots__", ())
        names |= {slots} if isinstance(slots, str) else {*slots}
        names |= {*vars(part).get("__mypyc_attrs__", ())}
    return names - {"__dict__", "__weakref__"}


def _sequence_restore(obj: list[Any] | deque[Any]) -> Restore:
    values = [*obj]

    def restore() -> None:
        obj.clear()
        obj.extend(values)

    return restore


def _collection_restore(obj: dict[Any, Any] | set[Any]) -> Restore:
    values = obj.copy()

    def restore() -> None:
        obj.clear()
        obj.update(values)

    return restore


def _object_restore(obj: object, values: dict[str, Any]) -> Restore:
    def restore() -> None:
        for name in _names(obj) - values.keys():
            delattr(obj, name)
        for name, value in values.items():
            present = getattr(obj, name, _MISSING)
            if value is _MISSING and present is not _MISSING:
                delattr(obj, name)
            elif present is not value:
                object.__setattr__(obj, name, value)

    return restore
