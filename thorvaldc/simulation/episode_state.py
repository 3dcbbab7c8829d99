"""The state of an episode at one instant, from which it goes on as it did, to the last bit."""

from __future__ import annotations

import copy
import io
import pickle
from types import FunctionType, ModuleType
from typing import Any

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

_CHANGED = (
    *("geom_friction", "dof_frictionloss", "dof_solimp"),
    *("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
)
"""Arrays of the MuJoCo model that faults, zones and motors without power change."""
_SHARED_PACKAGES = ("thorvaldc.model", "thorvaldc.simulation.sensors", "mujoco")
"""Objects of these packages are not copied: they do not change, or are the scene's own."""


class EpisodeState:
    """The state of an episode: the robots, their drivers and the scene.

    ``Episode.save`` returns it, ``Episode.reset(state=...)`` continues from it, as often as wanted.
    It belongs to the episode that has saved it.
    """

    def __init__(self, owner: object, time: float, content: object, scene: MujocoScene | None):
        if scene is not None and type(scene) is not MujocoScene:
            raise DiagnosticError("simulation-scene", "a world of a batch cannot be saved")
        self.owner = owner
        self.time = time
        """Simulated time (s) of the last control cycle."""
        stream = io.BytesIO()
        pickler = _Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL)
        try:
            pickler.dump(content)
        except (TypeError, AttributeError, pickle.PicklingError) as error:
            message = f"a part of the driver cannot be saved: {error}"
            raise DiagnosticError("simulation-scene", message) from error
        self._bytes, self._references = stream.getvalue(), pickler.references
        self._scene: tuple[Any, dict[str, Any], int, bool] | None = None
        if scene is not None:
            arrays = {name: getattr(scene.model, name).copy() for name in _CHANGED}
            self._scene = copy.copy(scene.data), arrays, scene.steps, scene.diverged

    def __repr__(self) -> str:
        return f"<EpisodeState at {self.time:g} s>"

    def restore(self, scene: MujocoScene | None) -> Any:
        """Puts the scene into this state, and returns a copy of the content."""
        if scene is not None and self._scene is not None:
            import mujoco

            data, arrays, scene.steps, scene.diverged = self._scene
            mujoco.mj_copyData(scene.data, scene.model, data)
            for name, array in arrays.items():
                getattr(scene.model, name)[:] = array
        unpickler = pickle.Unpickler(io.BytesIO(self._bytes))
        unpickler.persistent_load = self._references.__getitem__  # type: ignore[method-assign]
        return unpickler.load()


class _Pickler(pickle.Pickler):
    """Copies what changes in an episode, and refers to everything else."""

    def __init__(self, stream: io.BytesIO, protocol: int) -> None:
        super().__init__(stream, protocol)
        self.references: list[object] = []
        self._numbers: dict[int, int] = {}

    def persistent_id(self, obj: Any) -> int | None:
        kind = type(obj)
        is_shared = (
            kind in (FunctionType, ModuleType)
            or kind.__module__.startswith(_SHARED_PACKAGES)
            or isinstance(obj, MujocoScene)
            or (kind.__name__ == "ndarray" and obj.base is not None)  # a view of the scene
        )
        if not is_shared:
            return None
        if id(obj) not in self._numbers:
            self._numbers[id(obj)] = len(self.references)
            self.references.append(obj)
        return self._numbers[id(obj)]

    def reducer_override(self, obj: Any) -> Any:
        """Copies an instance of a compiled class, and the attributes of an interpreted subclass."""
        kind = type(obj)
        if not isinstance(obj, type) and any("__mypyc_attrs__" in vars(c) for c in kind.__mro__):
            names = {n for c in kind.__mro__ for n in vars(c).get("__mypyc_attrs__", ())}
            state = {n: getattr(obj, n) for n in names if hasattr(obj, n)}
            return _rebuilt, (kind,), {**state, **getattr(obj, "__dict__", {})}, None, None, _fill
        return NotImplemented


def _rebuilt(kind: Any) -> Any:
    return kind.__new__(kind)


def _fill(obj: object, state: dict[str, Any]) -> None:
    for name, value in state.items():
        object.__setattr__(obj, name, value)
