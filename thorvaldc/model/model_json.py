"""The model as JSON text and back, and its JSON Schema, from the type hints of the dataclasses.

The page ``docs/model.md`` describes the JSON format and its versions. A dataclass of the model
becomes a JSON object with all fields of the dataclass. A tuple or a source span becomes a JSON
list. The JSON object of a ``Shape`` has the name of its class in the field ``kind``.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import json
import math
import re
import types
import typing
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, cast

from thorvaldc.diagnostics import DiagnosticError, Span, did_you_mean
from thorvaldc.diagnostics.files import read_bounded, read_json
from thorvaldc.diagnostics.installation import program_version
from thorvaldc.model import (
    Actuator,
    Bus,
    Fleet,
    FrameDefinition,
    Joint,
    JointServo,
    Node,
    ObjectValue,
    Robot,
    RosSettings,
    Shape,
    Signal,
)
from thorvaldc.model.bus import OBJECT_TYPES
from thorvaldc.model.quantities import field_types, quantity_at
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.settings import DISTROS, DRIVER, EKF

FORMAT = "thorvaldc-model"
VERSION = 15
"""Version of the JSON format, increased with every change of the model's fields.

The page ``docs/model.md`` lists all versions of the JSON format.
"""
MAX_BYTES = 64_000_000
"""Limit of the size of a file ``model.json``; that of a fleet of a hundred robots has 20 MB."""
_BEGINNING = re.compile(rb'\s*\{\s*"format"\s*:\s*"' + FORMAT.encode() + b'"')
_BEGINNING_BYTES = 1000
KINDS: dict[str, type[Robot | Fleet]] = {"Robot": Robot, "Fleet": Fleet}
SHAPES: dict[str, type] = {shape.__name__: shape for shape in typing.get_args(Shape)}
_SHAPE_CLASSES = frozenset(SHAPES.values())

# The JSON text omits the bytes of a mesh, because the build folder contains the mesh file, and the
# object dictionary of an EDS, which only simulations of the robot file need.
_OMITTED = {("Mesh", "data"), ("Node", "described")}
_NAMES = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    type(None): "null",
    list: "a list",
    dict: "an object",
}


class ModelFormatError(ValueError):
    """The JSON text is not a robot or fleet model in the supported version of the format.

    - ``reason``: cause of the error.
    - ``path``: position in the model, such as ``robot.wheels[2]``, or empty if the whole file is
      wrong.
    - ``version``: version of the file, if this program reads another one.
    """

    def __init__(self, reason: str, path: str = "", version: int | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.version = version
        self.path = path

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}" if self.path else self.reason


@functools.cache
def type_hints(cls: type) -> dict[str, Any]:
    """Return the type of each field of a model class, by field name.

    Fields that are left out of the JSON text are not returned.
    """
    hints = field_types(cls)
    return {name: hints[name] for name in hints if (cls.__name__, name) not in _OMITTED}


# -- writing ------------------------------------------------------------------------------


def _members(value: Any) -> Any:
    """Return what the JSON encoder writes for a dataclass of the model."""
    cls: Any = type(value)
    members = {name: getattr(value, name) for name in type_hints(cls)}
    if cls in _SHAPE_CLASSES:
        members["kind"] = cls.__name__
    return members


_ENCODER = json.JSONEncoder(
    default=_members,
    ensure_ascii=False,
    separators=(",", ":"),
    allow_nan=False,
    check_circular=False,  # a model is a tree
)


@once_per_model
def to_json(model: Robot | Fleet) -> str:
    """Return the model of a robot or a fleet as JSON text, without the bytes of mesh files.

    The function ``from_json`` converts the JSON text back to an equal model. Raises ``ValueError``
    if a number of the model is infinite or NaN, because JSON cannot express such a number.
    """
    kind = type(model).__name__
    head = {"format": FORMAT, "version": VERSION, "kind": kind, "model": model}
    return _ENCODER.encode(head) + "\n"


def model_hash(model: Robot | Fleet) -> str:
    """Return the SHA-256 of the ``model.json`` of a model, which also its build contains."""
    return hashlib.sha256(to_json(model).encode()).hexdigest()


# -- reading ------------------------------------------------------------------------------

_WORDS: dict[tuple[type, str], tuple[str, ...]] = {
    (Actuator, "role"): ("propulsion", "steering"),
    (FrameDefinition, "mapping"): tuple(OBJECT_TYPES),
    (Joint, "type"): ("fixed", "revolute", "continuous", "prismatic"),
    (JointServo, "interface"): ("position", "velocity"),
    (ObjectValue, "type"): tuple(OBJECT_TYPES),
    (RosSettings, "distro"): DISTROS,
    (RosSettings, "odom_tf"): (DRIVER, EKF),
}
"""Fields whose text, or last text of each item, must be one of some words."""

_UINT32 = 2**32 - 1
_RANGES: dict[tuple[type, str], tuple[int, int]] = {
    (Actuator, "encoder_ppr"): (1, _UINT32),
    (Bus, "bitrate"): (1, 1_000_000),
    (Bus, "master_id"): (1, 127),
    (FrameDefinition, "cob_id"): (0, 0x1FFFFFFF),
    (FrameDefinition, "length"): (0, 8),
    (FrameDefinition, "pdo"): (1, 512),
    (Node, "id"): (0, 0x7FF),
    (ObjectValue, "index"): (0, 0xFFFF),
    (ObjectValue, "subindex"): (0, 0xFF),
    (Signal, "start"): (0, 63),
    (Signal, "length"): (1, 64),
}
"""Least and greatest value of whole numbers that a CAN bus limits."""

_Decoder = Callable[[Any, str], Any]
"""A decoder converts a JSON value at a path to a value of the model.

A decoder raises ``ModelFormatError`` if the JSON value has a wrong type.
"""


@functools.cache
def _decoder(hint: Any) -> _Decoder:
    """Return a decoder: a function that converts JSON values to a type of the model."""
    if isinstance(hint, type) and issubclass(hint, tuple):  # a named tuple, which is a list
        items = _tuple_decoder(list(map(_decoder, typing.get_type_hints(hint).values())))
        return lambda value, path: hint(*items(value, path))
    if dataclasses.is_dataclass(hint):
        return _object_decoder(cast(type, hint))
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is typing.Annotated:
        return _decoder(arguments[0])
    if typing.get_origin(hint) is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return _list_decoder(_decoder(arguments[0]))
        return _tuple_decoder([_decoder(argument) for argument in arguments])
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        members = [member for member in arguments if member is not type(None)]
        if set(members) == set(SHAPES.values()):
            return _decode_shape
        if len(members) > 1:
            return _plain_decoder(tuple(members))
        decode = _decoder(members[0])
        return lambda value, path: None if value is None else decode(value, path)
    return _plain_decoder((hint,))


def _object_decoder(cls: type) -> _Decoder:
    decoders = {name: _decoder(hint) for name, hint in type_hints(cls).items()}
    for (owner, name), words in _WORDS.items():
        if owner is cls:
            decoders[name] = _word_decoder(decoders[name], words)
    for (owner, name), limits in _RANGES.items():
        if owner is cls:
            decoders[name] = _range_decoder(decoders[name], *limits)

    def decode(value: Any, path: str) -> Any:
        _require(value, dict, path)
        if value.keys() != decoders.keys():
            _report_fields(value, list(decoders), path)
        if cls is FrameDefinition and value["extended"] is False:
            _range_decoder(decoders["cob_id"], 0, 0x7FF)(value["cob_id"], f"{path}.cob_id")
        return cls(
            **{name: decode(value[name], f"{path}.{name}") for name, decode in decoders.items()}
        )

    return decode


def _word_decoder(decode: _Decoder, words: tuple[str, ...]) -> _Decoder:
    def decode_word(value: Any, path: str) -> Any:
        decoded = decode(value, path)
        for word in (decoded,) if isinstance(decoded, str) else [item[-1] for item in decoded]:
            if word not in words:
                expected = ", ".join(words)
                raise ModelFormatError(f"expected one of {expected}, found {_text(word)}", path)
        return decoded

    return decode_word


def _range_decoder(decode: _Decoder, least: int, most: int) -> _Decoder:
    def decode_number(value: Any, path: str) -> Any:
        number = decode(value, path)
        if number is not None and not least <= number <= most:
            reason = f"expected a number from {least} to {most}, found {_text(value)}"
            raise ModelFormatError(reason, path)
        return number

    return decode_number


def _report_fields(value: dict[str, Any], fields: list[str], path: str) -> None:
    """Raise ``ModelFormatError`` for the first missing or unknown field of a JSON object."""
    for name in fields:
        if name not in value:
            raise ModelFormatError(f"the field `{name}` is missing", path)
    for name in value:
        if name not in fields:
            hint = did_you_mean(name, fields)
            suffix = f" ({hint})" if hint else ""
            raise ModelFormatError(f"there is no field `{name}`{suffix}", path)


def _decode_shape(value: Any, path: str) -> Any:
    _require(value, dict, path)
    if "kind" not in value:
        raise ModelFormatError("the field `kind` is missing", path)
    kind = value["kind"]
    if not isinstance(kind, str) or kind not in SHAPES:
        expected = ", ".join(SHAPES)
        raise ModelFormatError(f"expected one of {expected}, found {_text(kind)}", f"{path}.kind")
    fields = {name: member for name, member in value.items() if name != "kind"}
    return _decoder(SHAPES[kind])(fields, path)


def _list_decoder(decode: _Decoder) -> _Decoder:
    def decode_list(value: Any, path: str) -> tuple[Any, ...]:
        _require(value, list, path)
        return tuple([decode(item, f"{path}[{i}]") for i, item in enumerate(value)])

    return decode_list


def _tuple_decoder(decoders: list[_Decoder]) -> _Decoder:
    def decode_tuple(value: Any, path: str) -> tuple[Any, ...]:
        _require(value, list, path)
        if len(value) != len(decoders):
            raise ModelFormatError(f"expected {len(decoders)} values, found {len(value)}", path)
        return tuple(
            [
                decode(item, f"{path}[{i}]")
                for i, (decode, item) in enumerate(zip(decoders, value, strict=True))
            ]
        )

    return decode_tuple


def _plain_decoder(allowed: tuple[type, ...]) -> _Decoder:
    """Return a decoder that accepts only JSON values of the types in ``allowed``: numbers, texts or
    booleans.

    A JSON integer is accepted for a field of the type float.
    """
    only_float = allowed == (float,)

    def decode_plain(value: Any, path: str) -> Any:
        if type(value) is float and not math.isfinite(value):
            raise ModelFormatError(f"expected a finite number, found {value}", path)
        if type(value) in allowed:
            return value
        if only_float and type(value) is int:
            try:
                return float(value)
            except OverflowError:
                raise ModelFormatError("the number is too large", path) from None
        expected = " or ".join(_NAMES[member] for member in allowed)
        raise ModelFormatError(f"expected {expected}, found {_text(value)}", path)

    return decode_plain


def _require(value: Any, expected: type, path: str) -> None:
    if type(value) is not expected:
        raise ModelFormatError(f"expected {_NAMES[expected]}, found {_text(value)}", path)


def _text(value: Any) -> str:
    """Return a JSON value as text for an error message.

    For a JSON list or object, the function returns the name of the type. Other JSON values are cut
    after 40 characters.
    """
    if isinstance(value, list | dict):
        return _NAMES[type(value)]
    return json.dumps(value, ensure_ascii=False)[:40]


def from_json(text: str) -> Robot | Fleet:
    """Return the model from a JSON text that ``to_json`` has written.

    Raises ``ModelFormatError`` for an invalid text:

    - The text is not JSON.
    - The JSON text has another format or another version.
    - A field is missing or unknown.
    - A value has the wrong type.
    """
    try:
        head = read_json(text)
    except ValueError as error:
        raise ModelFormatError(f"not a {FORMAT} file: not JSON ({error})") from error
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise ModelFormatError(f"not a {FORMAT} file")
    version = head.get("version")
    if type(version) is not int or version != VERSION:
        known = version if type(version) is int else None
        reason = f"version {_text(version)}; this program reads {VERSION}"
        raise ModelFormatError(reason, version=known)
    _report_fields(head, ["format", "version", "kind", "model"], "")
    kind = head["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        expected = " or ".join(KINDS)
        raise ModelFormatError(f"expected {expected}, found {_text(kind)}", "kind")
    decode = _decoder(cast(Hashable, KINDS[kind]))
    return cast(Robot | Fleet, decode(head["model"], kind.lower()))


def typed_value(hint: Any, value: Any, path: str = "") -> Any:
    """Return a JSON value as a value of a type that a field of the model can have.

    Raises ``ModelFormatError``, with the position ``path``, if the value has another type.
    """
    return _decoder(hint)(value, path)


def is_model_file(path: Path | str) -> bool:
    """Return whether a file contains a model, whatever its name is.

    Looks only at the beginning, where ``to_json`` writes the format, also if another program has
    formatted the file again.
    """
    try:
        return _BEGINNING.match(read_bounded(path, _BEGINNING_BYTES, cut=True)) is not None
    except OSError:
        return False


def load_model(path: Path) -> Robot | Fleet:
    """Return the model from a file, or from the file ``model.json`` of a build folder.

    Raises ``DiagnosticError`` (``model-unreadable``) if the file cannot be read.
    """
    if path.is_dir():
        path /= "model.json"
    try:
        return from_json(read_bounded(path, MAX_BYTES).decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise DiagnosticError(
            "model-unreadable",
            f"cannot read {path}: {getattr(error, 'strerror', None) or 'not UTF-8 text'}",
            hint="build the robot first: thorvaldc build",
        ) from error
    except ModelFormatError as error:
        hint = "build the robot again"
        if error.version is not None:
            hint = _program_hint(path, error.version)
        raise DiagnosticError("model-unreadable", f"{path}: {error}", hint=hint) from error


def _program_hint(path: Path, version: int) -> str:
    """Returns which program reads a model of another version.

    The manifest of the build names the program that wrote the model.  Before 0.1.0, all programs
    had one name.
    """
    own, writer = program_version(), ""
    with contextlib.suppress(OSError, ValueError):
        manifest = read_json(read_bounded(path.with_name("manifest.json"), MAX_BYTES))
        if isinstance(manifest, dict):
            writer = str(manifest.get("compiler", ""))[:60]
    again = f"build the robot again with this thorvaldc {own}: thorvaldc build FILE"
    if writer and writer != f"thorvaldc {own}":
        return f"{again}; or use {writer}, which wrote the file"
    if version > VERSION:
        return f"a thorvaldc newer than {own} wrote the file: install it, or {again}"
    return again


# -- JSON Schema ----------------------------------------------------------------------------

_PLAIN = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    type(None): "null",
}


def model_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``model.json``, with a definition for each class of the model."""
    definitions: dict[str, Any] = {}
    roots = [_schema_of(cls, definitions) for cls in KINDS.values()]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "The model of a robot or a fleet, as `model.json` of a build",
        "description": "All values are in SI; quaternions are (w, x, y, z).",
        "type": "object",
        "properties": {
            "format": {"const": FORMAT},
            "version": {"const": VERSION, "description": "Increased when the fields change."},
            "kind": {"enum": list(KINDS)},
            "model": {"type": "object"},
        },
        "required": ["format", "version", "kind", "model"],
        "additionalProperties": False,
        "allOf": [
            {
                "if": {"properties": {"kind": {"const": kind}}},
                "then": {"properties": {"model": root}},
            }
            for kind, root in zip(KINDS, roots, strict=True)
        ],
        "$defs": dict(sorted(definitions.items())),
    }


def model_schema_text() -> str:
    """Return the JSON Schema of ``model.json`` as JSON text."""
    return json.dumps(model_schema(), indent=2, ensure_ascii=False) + "\n"


def _schema_of(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a Python type.

    The schema of a model class is stored in ``definitions``, and the function returns a ``$ref`` to
    the stored schema.
    """
    if typing.get_origin(hint) is typing.Annotated:
        return _schema_of(hint.__origin__, definitions)
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if hint is Span or dataclasses.is_dataclass(hint):
        name = hint.__name__  # type: ignore[union-attr]
        if name not in definitions:
            if hint is Span:
                definitions[name] = _span_schema()
            else:
                definitions[name] = _class_schema(typing.cast(type, hint), definitions)
        return {"$ref": f"#/$defs/{name}"}
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return {"type": "array", "items": _schema_of(arguments[0], definitions)}
        return _list_schema([_schema_of(argument, definitions) for argument in arguments])
    if typing.get_origin(hint) not in (typing.Union, types.UnionType):
        raise TypeError(f"a field of the model cannot have the type {hint}")
    members = [_schema_of(argument, definitions) for argument in arguments]
    if all(list(member) == ["type"] for member in members):
        return {"type": [member["type"] for member in members]}
    return {"anyOf": members}


def _class_schema(cls: type, definitions: dict[str, Any]) -> dict[str, Any]:
    properties = {name: _schema_of(hint, definitions) for name, hint in type_hints(cls).items()}
    for name, schema in properties.items():
        quantity = quantity_at(cls, [name])
        if quantity is not None and quantity.unit and "$ref" not in schema:
            schema["x-quantity"] = quantity.kind
    if cls in SHAPES.values():
        properties["kind"] = {"const": cls.__name__}
    return {
        "description": _description(cls),
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _span_schema() -> dict[str, Any]:
    hints = typing.get_type_hints(Span)
    return {
        "description": f"{_description(Span)}\n\nA list of {', '.join(hints)}.",
        **_list_schema([{"type": _PLAIN[hint]} for hint in hints.values()]),
    }


def _list_schema(items: list[dict[str, Any]]) -> dict[str, Any]:
    count = len(items)
    return {
        "type": "array",
        "prefixItems": items,
        "items": False,
        "minItems": count,
        "maxItems": count,
    }


def _description(cls: type) -> str:
    """Return the docstring of a model class, with each paragraph and each list item on one line."""
    text = inspect.cleandoc(cls.__doc__ or "").replace("``", "`").replace("`None`", "`null`")
    return re.sub(r"(?<!\n)\n(?!\n|- )\s*", " ", text)
