"""Loads mesh files.

Binary STL files and OBJ files are copied without conversion, because URDF readers and MuJoCo can
read both formats.  Text STL files are converted to binary STL, because MuJoCo reads only binary
STL.  Mesh files of all other formats are converted to binary STL, so that no backend needs to
convert a mesh.

A contained worker process reads the files (``mesh_formats``).  Only the meshes of the built-in
library, which are a part of this program, are read without it.
"""

from __future__ import annotations

import functools
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from thorvaldc.compiler.shapes import mesh_formats
from thorvaldc.compiler.source.input_file import missing_file_hint, near_path
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.readable_folders import is_below, real_folders
from thorvaldc.diagnostics import Report, Span, plain
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.model import Mesh, Vec3

# Robots with meshes of the built-in library alone need no worker process.
if TYPE_CHECKING:
    from thorvaldc.compiler.sandbox.worker_process import Worker

MAX_FILE_BYTES = 64 * 1024 * 1024
# Largest size of a mesh (m). A mesh file with a larger mesh probably has the unit mm.
MAX_EXTENT = 20.0
CONVERTED = ("dae", "glb", "gltf", "off", "ply")
FORMATS = ("stl", "obj", *CONVERTED)
LIMITS: dict[str, Any] = {"wall_seconds": 20.0, "processor_seconds": 10, "memory_bytes": 512 << 20}
"""Limits of a worker process, see ``WorkerLimits``."""
_MAX_NEEDED_FILES = 16  # files to which one mesh file may refer


def load_mesh(
    path: Path,
    span: Span,
    report: Report,
    *,
    display: str,
    scale: Vec3 = (1.0, 1.0, 1.0),
    collides: bool = False,
    is_builtin: bool = False,
    named_in: tuple[Path, Node] | None = None,
) -> Mesh | None:
    """Reads a mesh file.

    Returns ``None`` and reports an error if the mesh file cannot be read or is not valid.  The name
    of the mesh contains a hash of the file content, so that different mesh files with the same file
    name have different mesh names.  A mesh file is read again only if the size or the modification
    time of the file has changed.

    Parameters
    ----------
    path : path of the mesh file.
    span : span of the file name in the document.
    report : collects the diagnostics.
    display : name of the file in messages.
    scale : scale factors of the mesh along x, y and z.  The factors are used only to check the
        mesh.
    collides : whether the mesh is used for collisions, and must not be flat.
    is_builtin : whether the file is a part of this program, and needs no worker process.
    named_in : folder to which the path is relative, and the YAML node that contains the path, if
        the mesh file is named in a YAML document.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        report.add(
            "mesh-format",
            f"mesh file `{display}` has the format `{suffix}`, which is not read",
            span,
            hint=f"use one of {', '.join(FORMATS)}; STL and OBJ are copied unchanged",
        )
        return None
    try:
        status = path.stat()
        is_missing = not path.is_file()
    except (OSError, ValueError):
        is_missing = True
    if is_missing:
        hint = "paths are relative to the file that names them; check spelling and case"
        similar = near_path(path.parent, path.name, FORMATS)
        if similar is not None:
            hint = f"a similar file exists beside it: `{similar}`"
        if named_in is not None:
            hint = missing_file_hint(*named_in, FORMATS, hint)
        report.add("mesh-missing", f"mesh file `{display}` does not exist", span, hint=hint)
        return None
    try:
        mesh, checked = _read(path, status.st_mtime_ns, status.st_size, scale, collides, is_builtin)
    except mesh_formats.MeshError as error:
        report.add(error.code, f"mesh file `{display}` {error.text}", span, hint=error.hint)
        return None
    if checked.size > MAX_EXTENT:
        report.add(
            "mesh-size",
            f"mesh file `{display}` is {plain(checked.size)} m long; at most {MAX_EXTENT:g} m "
            "are plausible",
            span,
            hint="meshes are in metres; for a mesh in millimetres, set scale 0.001",
        )
    return mesh


@contextmanager
def shared_mesh_workers() -> Iterator[dict[bool, Worker]]:
    """Within this context, one worker process reads all STL and OBJ files, one all other meshes.

    They end with the outermost context.
    """
    outer = _workers.get()
    if outer is not None:
        yield outer
        return
    workers: dict[bool, Worker] = {}
    token = _workers.set(workers)
    try:
        yield workers
    finally:
        _workers.reset(token)
        for worker in workers.values():
            worker.close()


_workers: ContextVar[dict[bool, Worker] | None] = ContextVar("mesh workers", default=None)


@functools.lru_cache(maxsize=512)
def _read(
    path: Path, mtime_ns: int, size: int, scale: Vec3, collides: bool, is_builtin: bool
) -> tuple[Mesh, mesh_formats.CheckedMesh]:
    """Reads, checks and converts a mesh file.

    Raises ``MeshError``.  The meshes are cached.  ``mtime_ns`` is the modification time of the file
    (ns).  A mesh file with a new modification time is read again.
    """
    if size > MAX_FILE_BYTES:
        raise mesh_formats.too_large(
            f"has {size / 1e6:.0f} MB; at most {MAX_FILE_BYTES / 1e6:.0f} are read"
        )
    data = _content(path)
    if data.startswith(b"version https://git-lfs"):
        text = "is a Git LFS pointer, not the mesh"
        raise mesh_formats.MeshError("mesh-invalid", text, "fetch it: git lfs pull")
    suffix = path.suffix.lower().lstrip(".")
    if is_builtin and suffix not in CONVERTED:
        checked = mesh_formats.check_mesh(suffix, data, scale, collides)
    else:
        checked = _read_in_worker(path, suffix, data, scale, collides)
    digest = hashlib.sha256(checked.data).hexdigest()
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem).strip("_") or "mesh"
    return Mesh(f"{stem}_{digest[:8]}.{checked.suffix}", digest, checked.data), checked


def _content(path: Path) -> bytes:
    try:
        return read_bounded(path, MAX_FILE_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise mesh_formats.MeshError(
            "mesh-missing", f"cannot be read: {reason}", "check the file's permissions"
        ) from error


def _read_in_worker(
    path: Path, suffix: str, data: bytes, scale: Vec3, collides: bool
) -> mesh_formats.CheckedMesh:
    """Reads a mesh in a worker process, with the files that it refers to."""
    from thorvaldc.compiler.sandbox.worker_process import WorkerLimitError

    converts = suffix in CONVERTED
    if converts and find_spec("trimesh") is None:
        raise mesh_formats.MeshError(
            "mesh-format",
            f"has the format `{suffix}`, which needs trimesh; it is not installed",
            "install trimesh and pycollada, or convert the mesh to STL",
        )
    files = {path.name: data}
    while True:
        request = {
            "format": suffix,
            "scale": scale,
            "collides": collides,
            "files": [(name, len(content)) for name, content in files.items()],
        }
        with shared_mesh_workers() as workers:
            try:
                worker = _worker(workers, converts)
                answer, data = worker.ask(request, b"".join(files.values()))
            except WorkerLimitError as error:
                raise mesh_formats.too_large(str(error)) from error
        if "code" in answer:
            raise mesh_formats.MeshError(answer["code"], answer["text"], answer["hint"])
        if "needs" not in answer:
            return mesh_formats.CheckedMesh(data, **answer)
        files[answer["needs"]] = _needed_file(path, answer["needs"], files)


def _worker(workers: dict[bool, Worker], converts: bool) -> Worker:
    """Returns the worker process for STL and OBJ files, or for formats that are converted."""
    from thorvaldc.compiler.sandbox.worker_process import WorkerLimits, limited_worker

    if converts not in workers:
        path = [os.path.abspath(folder) for folder in sys.path] if converts else []
        imports = [
            name for name in mesh_formats.IMPORTS if converts and find_spec(name) is not None
        ]
        workers[converts] = limited_worker(
            "thorvaldc.compiler.shapes.mesh_formats",
            WorkerLimits(**LIMITS),
            path=path,
            imports=imports,
        )
    return workers[converts]


def _needed_file(mesh: Path, name: str, files: dict[str, bytes]) -> bytes:
    """Reads a file to which a mesh file refers.  It must be below the folder of the mesh file."""
    needed = mesh.parent / unquote(name)
    shown = name if len(name) < 100 else f"{name[:100]}..."
    if not is_below(needed, real_folders([mesh.parent])):
        text = f"refers to the file `{shown}`, which is not below its folder"
        raise mesh_formats.MeshError("mesh-invalid", text, "put the file beside the mesh")
    try:
        data = _content(needed)
    except mesh_formats.MeshError as error:
        text = f"refers to the file `{shown}`, which {error.text}"
        raise mesh_formats.MeshError(
            "mesh-invalid", text, "put the file beside the mesh"
        ) from error
    if len(files) > _MAX_NEEDED_FILES or len(data) + len(b"".join(files.values())) > MAX_FILE_BYTES:
        raise mesh_formats.too_large(
            f"has more than {MAX_FILE_BYTES / 1e6:.0f} MB with its other files"
        )
    return data
