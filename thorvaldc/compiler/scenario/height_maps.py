"""Reads height maps: the ground of a scenario from an image (PNG), a GeoTIFF or a mesh (STL).

A contained worker process reads the files; ``answer`` is its service.  A request has the format of
the file, and the edge lengths and the height that the document states, or ``None``.  An answer has

- ``center``, ``size``, ``columns``: see ``HeightMap``; its data are the heights as float32, row by
  row
- or ``text``, ``hint`` and ``key``: why the file is refused, and the key of the document that is
  missing or has no effect.

Formats: PNG 3rd edition (W3C), sections 4 and 11; GeoTIFF 1.1 (OGC 19-008r4), `ModelPixelScaleTag`;
`GDAL_NODATA` of GDAL's GeoTIFF driver.
"""

from __future__ import annotations

import io
import math
import os
import posixpath
import sys
from array import array
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from thorvaldc.compiler.shapes import mesh_formats
from thorvaldc.compiler.source.input_file import report_missing
from thorvaldc.compiler.source.node import insertion, removal
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import Report, plain
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import HeightMap
from thorvaldc.model.stl import stl_triangles

FORMATS = ("png", "tif", "tiff", "stl")
_IMAGES = {"png": "PNG", "tif": "TIFF", "tiff": "TIFF"}
MAX_POINTS = 1_000_000
"""Greatest number of points of the grid of a height map."""
_MAX_MESH_POINTS = 250_000
_LEAST_CELL = 0.05
"""Least distance (m) of the points of a grid that is made from a mesh."""
_MAX_FILE_BYTES = 64 << 20
_EXTENTS = (1.0, 10_000.0)
"""Least and greatest edge length (m) of a height map."""
_MAX_HEIGHT = 1000.0
_EXAMPLES = {"size": "[30 m, 20 m]", "height": "1.5 m"}
"""Keys that a file can need or exclude, with examples."""
_PIXEL_SCALE, _NO_DATA = 33550, 42113
"""Numbers of TIFF tags."""


def read_height_map(
    ground: Section, folder: Path, files: dict[str, Path], report: Report
) -> HeightMap | None:
    """Reads the height map of the section ``ground`` of a scenario.

    Returns ``None`` and reports an error if there is none.

    Parameters
    ----------
    ground : a section with the type `map`.
    folder : folder to which the path of the file is relative.
    files : the function adds the file, by its name in spans.
    report : collects the diagnostics.
    """
    node, named = ground.node, ground.node.get("file")
    if named is None:
        hint = insertion("add `file: field.tif`", node, "file", "field.tif", is_example=True)
        report.add("missing-key", "a map has no `file`", node.where, hint=hint)
        return None
    path = folder / str(named.value)
    if not os.path.isfile(path):
        report_missing("height-map", folder, named, FORMATS, report)
        return None
    display = posixpath.normpath(
        posixpath.join(posixpath.dirname(named.span.file), str(named.value))
    )
    files[display] = path
    answer, data = _read(path, ground)
    if "text" not in answer:
        heights = array("f", data)
        if sys.byteorder == "big":
            heights.byteswap()
        count, (x, y), (length, width) = answer["columns"], answer["center"], answer["size"]
        rows = tuple(tuple(heights[i : i + count]) for i in range(0, len(heights), count))
        return HeightMap((x, y), (length, width), rows)
    span, key = named.span, answer.get("key", "")
    advice: str | None = answer["hint"]
    if key in _EXAMPLES:
        entry = node.get(key)
        if entry is None:
            example = f"{key}: {_EXAMPLES[key]}"
            advice = insertion(
                f"add it, as in `{example}`", node, key, _EXAMPLES[key], is_example=True
            )
        else:
            span, advice = entry.where, removal(f"remove `{key}`", node, key)
    report.add("height-map", f"`{display}` {answer['text']}", span, hint=advice)
    return None


def _read(path: Path, ground: Section) -> tuple[dict[str, Any], bytes]:
    """Returns the answer of the worker process for a file, or why it cannot be asked."""
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        hint = f"use one of {', '.join(FORMATS)}"
        return {"text": f"has the format `{suffix}`, which is not read", "hint": hint}, b""
    if suffix in _IMAGES and find_spec("PIL") is None:
        text = "is an image, which needs Pillow; it is not installed"
        return {"text": text, "hint": f"{install_command('video')}; or use an STL mesh"}, b""
    try:
        data = read_bounded(path, _MAX_FILE_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        return {"text": f"cannot be read: {reason}", "hint": None}, b""
    keys = {key: ground[key] if ground.node.get(key) is not None else None for key in _EXAMPLES}
    return _ask({"format": suffix, **keys}, data)


def _ask(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    from thorvaldc.compiler.sandbox.worker_process import (
        WorkerLimitError,
        WorkerLimits,
        limited_worker,
    )

    is_image = request["format"] in _IMAGES
    path = [os.path.abspath(folder) for folder in sys.path] if is_image else []
    imports = ["PIL.Image", "PIL.PngImagePlugin", "PIL.TiffImagePlugin"] if is_image else []
    limits = WorkerLimits(wall_seconds=60.0, processor_seconds=30, memory_bytes=1 << 30)
    with limited_worker(__name__, limits, path=path, imports=imports) as worker:
        try:
            return worker.ask(request, data)
        except WorkerLimitError as error:
            return {"text": str(error), "hint": "reduce it to the area of the drive"}, b""


# -- worker process ----------------------------------------------------------------


class _MapError(Exception):
    """Raised if a height map is refused.

    - ``text``, ``hint``: message without the name of the file, and hint.
    - ``key``: key of the document that is missing, or that has no effect.
    """

    def __init__(self, text: str, hint: str | None = None, key: str = "") -> None:
        super().__init__(text)
        self.text, self.hint, self.key = text, hint, key


def answer(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the height map of a request, or why it is refused."""
    try:
        if request["format"] == "stl":
            center, size, columns, heights = _read_mesh(data, request)
        else:
            center = (0.0, 0.0)
            size, columns, heights = _read_image(data, request)
        _check_extent(size, heights)
    except (_MapError, mesh_formats.MeshError) as error:
        key = error.key if isinstance(error, _MapError) else ""
        return {"text": error.text, "hint": error.hint, "key": key}, b""
    low = min(heights)
    above = array("f", (height - low for height in heights))
    if sys.byteorder == "big":
        above.byteswap()
    return {"center": center, "size": size, "columns": columns}, above.tobytes()


def _check_extent(size: tuple[float, float], heights: list[float]) -> None:
    least, most = _EXTENTS
    if not all(least <= edge <= most for edge in size):
        raise _MapError(
            f"has {plain(size[0])} m x {plain(size[1])} m; {plain(least)} m to {plain(most)} m are"
            " read",
            "a GeoTIFF in degrees needs a projection in metres (gdalwarp -t_srs), a mesh is in "
            "metres",
        )
    rise = max(heights) - min(heights)
    if not 0.0 < rise <= _MAX_HEIGHT:
        raise _MapError(
            f"has heights that differ by {plain(rise)} m; up to {plain(_MAX_HEIGHT)} m are read",
            "ground without heights is `type: plane`" if rise == 0.0 else None,
        )


def _refuse(key: str, value: Any, where: str) -> None:
    """Raises ``_MapError`` if a document states a value that the file states, too."""
    if value is not None:
        raise _MapError(f"states its own `{key}`: {where}", key=key)


def _needed(key: str, value: Any) -> Any:
    if value is None:
        raise _MapError(f"does not state its `{key}`", key=key)
    return value


def _read_image(
    data: bytes, request: dict[str, Any]
) -> tuple[tuple[float, float], int, list[float]]:
    """Returns the size (m), the columns and the heights (m) of an image, with increasing y.

    The points of the grid are the centres of the pixels.
    """
    from PIL import Image, UnidentifiedImageError

    name = _IMAGES[request["format"]]
    Image.MAX_IMAGE_PIXELS = None  # _check_points has a lower limit
    try:
        with Image.open(io.BytesIO(data), formats=[name]) as image:
            columns, lines = image.size
            _check_points(columns, lines)
            tags = dict(getattr(image, "tag_v2", {}))
            if image.mode not in ("L", "I", "F") and not image.mode.startswith("I;16"):
                raise _MapError(
                    f"has pixels of the mode {image.mode}",
                    "save it with one channel of grey, with 8 or 16 bits, or with 32-bit floats",
                )
            most = 255 if image.mode == "L" else 65535
            # Pillow 12 renames the method, and warns about the former name.
            read: Any = getattr(image, "get_flattened_data", None) or image.getdata
            values = [float(value) for value in read()]
    except (_MapError, MemoryError):
        raise
    except Exception as error:  # The readers of Pillow raise exceptions of many types.
        if isinstance(error, UnidentifiedImageError):
            raise _MapError(f"is not a {name} image") from error
        shown = " ".join(str(error).split())[:200] or type(error).__name__
        raise _MapError(f"cannot be read as {name}: {shown}") from error
    no_data = str(tags.get(_NO_DATA, "nan")).strip("\0 ")
    missing = float(no_data) if _is_number(no_data) else math.nan
    left_out = [value for value in values if value == missing or not math.isfinite(value)]
    if left_out:
        raise _MapError(
            f"has {len(left_out)} of {len(values)} pixels without a height",
            "cut it to the area with heights, or fill them (gdal_fillnodata)",
        )
    if name == "PNG":
        scale = _needed("height", request["height"]) / most
        values = [value * scale for value in values]
    else:
        _refuse("height", request["height"], "the values of a TIFF are heights in m")
    pixel = tags.get(_PIXEL_SCALE)
    if pixel is not None:
        _refuse("size", request["size"], "the tag ModelPixelScale")
        size = (float(pixel[0]) * (columns - 1), float(pixel[1]) * (lines - 1))
    else:
        size = tuple(_needed("size", request["size"]))
    rows = [values[i : i + columns] for i in range(0, len(values), columns)]
    return size, columns, [value for row in reversed(rows) for value in row]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_points(columns: int, lines: int) -> None:
    if min(columns, lines) < 2 or columns * lines > MAX_POINTS:
        raise _MapError(
            f"has {columns} x {lines} pixels; it must have at least 2 x 2, and at most "
            f"{MAX_POINTS} pixels",
            "cut it to the area of the drive, or reduce its resolution",
        )


def _read_mesh(
    data: bytes, request: dict[str, Any]
) -> tuple[tuple[float, float], tuple[float, float], int, list[float]]:
    """Returns the centre and size (m), the columns and the heights (m) of the surface of a mesh.

    The height of a point is that of the highest triangle above or below it, or that of the lowest
    point of the surface if there is none.
    """
    _refuse("size", request["size"], "a mesh is in metres")
    _refuse("height", request["height"], "a mesh is in metres")
    checked = mesh_formats.check_mesh("stl", data, (1.0, 1.0, 1.0), False)
    triangles = [*stl_triangles(checked.data)]
    lows, highs = zip(
        *((min(axis), max(axis)) for axis in zip(*(p for t in triangles for p in t), strict=True)),
        strict=True,
    )
    size = (highs[0] - lows[0], highs[1] - lows[1])
    _check_extent(size, [lows[2], highs[2]])
    cell = max(_LEAST_CELL, math.sqrt(size[0] * size[1] / _MAX_MESH_POINTS))
    columns, lines = (max(2, math.ceil(edge / cell)) + 1 for edge in size)
    steps = (size[0] / (columns - 1), size[1] / (lines - 1))
    heights = [-math.inf] * (columns * lines)
    for triangle in triangles:
        places = [
            ((p[0] - lows[0]) / steps[0], (p[1] - lows[1]) / steps[1], p[2]) for p in triangle
        ]
        for i, j, z in _points_in(places, columns, lines):
            k = j * columns + i
            heights[k] = max(heights[k], z)
    low = min((height for height in heights if height > -math.inf), default=lows[2])
    center = ((lows[0] + highs[0]) / 2, (lows[1] + highs[1]) / 2)
    return center, size, columns, [max(height, low) for height in heights]


def _points_in(
    triangle: list[tuple[float, float, float]], columns: int, lines: int
) -> Iterator[tuple[int, int, float]]:
    """Yields the column and line of each point of a grid in a triangle, and the height there.

    The triangle has x and y in columns and lines of the grid, and its heights (m).
    """
    (xa, ya, za), (xb, yb, zb), (xc, yc, zc) = triangle
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if area == 0.0:
        return  # an upright wall
    near = 1e-6
    for j in range(
        max(0, math.ceil(min(ya, yb, yc) - near)),
        min(lines - 1, math.floor(max(ya, yb, yc) + near)) + 1,
    ):
        for i in range(
            max(0, math.ceil(min(xa, xb, xc) - near)),
            min(columns - 1, math.floor(max(xa, xb, xc) + near)) + 1,
        ):
            b = ((i - xa) * (yc - ya) - (xc - xa) * (j - ya)) / area
            c = ((xb - xa) * (j - ya) - (i - xa) * (yb - ya)) / area
            if b >= -near and c >= -near and b + c <= 1.0 + near:
                yield i, j, za + b * (zb - za) + c * (zc - za)
