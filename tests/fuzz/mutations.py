"""Changes of files: of their bytes, their lines, their values and their structure.

A change is a function of a random generator and the content of a file.  Equal generators make
equal changes.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import json
import random
import re
import struct
from collections.abc import Callable
from typing import Any

import yaml

from thorvaldc.commissioning.plan import plan_from_json

Random = random.Random
Mutation = Callable[[Random, bytes], bytes]

# -- bytes --------------------------------------------------------------------------------

FLOATS = (0.0, -0.0, -1.0, 1e-30, 1e38, -3.4e38, float("inf"), float("-inf"), float("nan"))
SIZES = (0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)


def unchanged(rng: Random, data: bytes) -> bytes:
    """Returns a file that is hostile as it is."""
    return data


def flip_bits(rng: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut(rng: Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def cut_start(rng: Random, data: bytes) -> bytes:
    return data[rng.randrange(min(len(data), 200) + 1) :]


def delete_range(rng: Random, data: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.randrange(1, 40) :]


def repeat_range(rng: Random, data: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    part = data[start : start + rng.randrange(1, 400)]
    return data[:start] + part * rng.choice((2, 3, 100, 1000)) + data[start:]


def swap_ranges(rng: Random, data: bytes) -> bytes:
    a, b, c, d = sorted(rng.randrange(len(data) + 1) for _ in range(4))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def insert_bytes(rng: Random, data: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    piece = rng.choice((b"\0", b"\0" * 100, b"\xff", b"\x1b[2J", rng.randbytes(rng.randrange(40))))
    return data[:start] + piece + data[start:]


def set_number(rng: Random, data: bytes) -> bytes:
    """Writes a float or a size of a binary file."""
    form, values = rng.choice((("<f", FLOATS), ("<d", FLOATS), ("<I", SIZES), ("<Q", SIZES)))
    value: Any = rng.choice(values)
    if isinstance(value, int):
        value &= 2 ** (8 * struct.calcsize(form)) - 1
    packed = struct.pack(form, value)
    start = rng.randrange(len(data) + 1)
    if rng.random() < 0.5:
        start = rng.randrange(min(len(data), 120) + 1)  # the head of a file has its sizes
    return data[:start] + packed + data[start + len(packed) :]


def empty(rng: Random, data: bytes) -> bytes:
    return rng.choice((b"", b"\n", b" ", b"\0", b"{}", b"[]", b"null", b"---\n", b"<", b"<robot/>"))


def pad(rng: Random, data: bytes) -> bytes:
    """Adds bytes at the end; a megabyte is more than a document may have."""
    return data + rng.choice((b"\0", b" ", b"\n", b"x", b"#")) * rng.choice((1, 1000, 1_100_000))


BYTE_MUTATIONS: tuple[Mutation, ...] = (
    *(flip_bits, flip_bits, cut, cut, cut_start, delete_range, repeat_range, swap_ranges),
    *(insert_bytes, set_number, set_number, set_number, empty, pad),
)

# -- text ---------------------------------------------------------------------------------

LONG = "x" * 100_000
NUMBERS = (
    *("0", "-0.0", "-1", "1e-308", "1e-400", "1e308", "1e999", "-1e999", "nan", ".nan", "inf"),
    *("-.inf", "NaN", "Infinity", "99999999999999999999", "-2147483649", "4294967296", "0x7f"),
    *("1_000", "010", "0b1", "1e", "--1", "1,5", "1.2.3", "٣", "1e5", "1e9", "1000000"),
    *("9" * 5000, "1e" + "9" * 400, "0." + "0" * 5000 + "1"),
)
WORDS = (
    *(
        "",
        "null",
        "~",
        "true",
        "on",
        "[]",
        "{}",
        "[[",
        "{a: ",
        "*a",
        "&a",
        "!!python/object:os",
        "!x",
    ),
    *("'", '"', '"\\', "|", ">", "%", "@", "`", "# ", ": ", "- ", "? ", "<<", "---", "...", "\t"),
    *(
        "\x00",
        "\x07",
        "\x1b[31m",
        "\u2028",
        "\u00a0",
        "\ufeff",
        "é",
        "日本",
        "\U0001f916",
        "a\u0301",
    ),
    *("${x}", "${1/0}", "${9**9**9}", "$(find x)", "$(env HOME)", "${'a'*10**9}", "%s%n", "{0}"),
    *("5 kg", "5 mm", "90 deg", "42:1", "1/0", "none", "auto", "frame", "fl", "robot.yaml", "."),
    *("../../../../etc/passwd", "/dev/zero", "zero", "pipe", "loop", "folder", "missing.yaml", "/"),
    *("x" * 300, LONG, "a/" * 3000, "&lt;", "]]>", "<!--", "&a;", "<![CDATA["),
)
_TOKEN = re.compile(rb"[A-Za-z0-9_./+-]+")
_NUMBER = re.compile(rb"(?<![A-Za-z_])[-+]?[0-9][0-9.eE+-]*")


def _replaced(rng: Random, data: bytes, pattern: re.Pattern[bytes], text: str) -> bytes:
    matches = list(pattern.finditer(data))
    if not matches:
        return data + text.encode("utf-8", "surrogatepass")
    match = rng.choice(matches)
    return data[: match.start()] + text.encode("utf-8", "surrogatepass") + data[match.end() :]


def replace_number(rng: Random, data: bytes) -> bytes:
    return _replaced(rng, data, _NUMBER, rng.choice(NUMBERS))


def replace_word(rng: Random, data: bytes) -> bytes:
    return _replaced(rng, data, _TOKEN, rng.choice(WORDS + NUMBERS))


def exchange_words(rng: Random, data: bytes) -> bytes:
    """Writes a word of the file at the place of another one."""
    words = _TOKEN.findall(data)
    return _replaced(rng, data, _TOKEN, rng.choice(words).decode("ascii")) if words else data


def change_lines(rng: Random, data: bytes) -> bytes:
    lines = data.splitlines(True) or [b""]
    first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    act = rng.choice(("swap", "repeat", "delete", "many", "indent"))
    if act == "swap":
        lines[first], lines[second] = lines[second], lines[first]
    elif act == "repeat":
        lines.insert(second, lines[first])
    elif act == "delete":
        del lines[first]
    elif act == "many":
        lines[first] *= rng.choice((50, 3000))
    else:
        lines[first] = rng.choice((b" ", b"  ", b"\t")) + lines[first]
    return b"".join(lines)


def change_encoding(rng: Random, data: bytes) -> bytes:
    text = data.decode("utf-8", "replace")
    form = rng.choice(
        ("utf-16", "utf-16-le", "utf-32", "bom", "latin-1", "crlf", "cr", "surrogate")
    )
    if form == "bom":
        return b"\xef\xbb\xbf" * rng.choice((1, 2)) + data
    if form == "latin-1":
        return _replaced(rng, data, _TOKEN, "x").replace(b"x", b"\xe9", 1)
    if form == "crlf":
        return data.replace(b"\n", b"\r\n")
    if form == "cr":
        return data.replace(b"\n", b"\r")
    if form == "surrogate":
        return _replaced(rng, data, _TOKEN, "\udc80")
    return text.encode(form)


def nest(rng: Random, data: bytes) -> bytes:
    depth = rng.choice((10, 60, 1000, 100_000))
    opening, closing = rng.choice(
        ((b"[", b"]"), (b"{a: ", b"}"), (b'{"a":', b"}"), (b"<a>", b"</a>"))
    )
    bomb = opening * depth + b"1" + closing * depth
    start = rng.choice(list(_TOKEN.finditer(data)) or [re.match(b"", data)])
    assert start is not None
    return rng.choice((bomb, data[: start.start()] + bomb + data[start.end() :]))


TEXT_MUTATIONS: tuple[Mutation, ...] = (
    *(replace_number, replace_number, replace_word, replace_word, exchange_words, exchange_words),
    *(
        change_lines,
        change_lines,
        change_encoding,
        nest,
        flip_bits,
        cut,
        delete_range,
        insert_bytes,
    ),
    *(empty, pad, repeat_range),
)

# -- structure ----------------------------------------------------------------------------

PATHS = ("zero", "pipe", "loop", "folder", "missing.yaml", ".", "..", "/", "/dev/null", "", "a\0b")
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 255, 2**31, 2**63, -(2**63) - 1, 10**30, 10**400),
    *(0.0, -0.5, 1e-300, 1e300, 1.5, "", "x", "none", "auto", "5 kg", "5 mm", "-5 mm", "1e300 m"),
    *("90 deg", "42:1", "${x}", "${1/0}", "fl", "frame", [], {}, [[]], [0, 0, 0], [1, 2], {"a": 1}),
    *(
        {"type": "frame/open"},
        ["a", "b", "c"],
        {"parent": "fl"},
        LONG,
        "日本",
        "a\nb",
        [None] * 999,
    ),
)


def _holders(tree: Any) -> list[tuple[Any, Any]]:
    """Returns every value in a tree as its mapping or list and its key or index."""
    holders: list[tuple[Any, Any]] = []
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(entries):
        holders.append((tree, key))
        if isinstance(value, dict | list):
            holders.extend(_holders(value))
    return holders


def change_tree(rng: Random, tree: Any) -> Any:
    """Changes values, keys and branches of a tree of mappings and lists in place."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        holders = _holders(tree) if isinstance(tree, dict | list) else []
        if not holders:
            return rng.choice(VALUES)
        holder, key = rng.choice(holders)
        act = rng.choice(("set", "set", "set", "path", "remove", "rename", "add", "copy", "wrap"))
        if act == "set":
            holder[key] = copy.deepcopy(rng.choice(VALUES))
        elif act == "path":
            holder[key] = rng.choice(PATHS)
        elif act == "remove":
            del holder[key]
        elif act == "rename" and isinstance(holder, dict):
            holder[rng.choice(WORDS)] = holder.pop(key)
        elif act == "add" and isinstance(holder, dict):
            holder[rng.choice(WORDS)] = copy.deepcopy(rng.choice(VALUES))
        elif act == "wrap":
            holder[key] = rng.choice(([holder[key]], {"x": holder[key]}, [holder[key]] * 40))
        else:
            source, name = rng.choice(holders)
            holder[key] = copy.deepcopy(source[name])
    return tree


def change_document(rng: Random, data: bytes) -> bytes:
    """Changes the tree of a YAML or JSON document; writes it as JSON, which is also YAML."""
    try:
        if b"*" in data and b"&" in data:  # an alias could expand to billions of values
            return replace_word(rng, data)
        tree = json.loads(data) if data.lstrip()[:1] == b"{" else yaml.safe_load(data)
    except (ValueError, yaml.YAMLError, RecursionError):
        return replace_word(rng, data)
    changed = change_tree(rng, copy.deepcopy(tree))
    return json.dumps(changed, ensure_ascii=rng.random() < 0.5, indent=1).encode(
        "utf-8", "surrogatepass"
    )


def yaml_bomb(rng: Random, data: bytes) -> bytes:
    """Adds aliases that expand to billions of values, or that refer to themselves."""
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    bomb = rng.choice(
        ("\n".join(rows), "b: &b [*b]", "b: &b {<<: *b}", "b: {<<: [*a, *a]}", "&a a: *a")
    )
    return rng.choice((data + b"\n" + bomb.encode(), bomb.encode() + b"\n" + data))


YAML_MUTATIONS: tuple[Mutation, ...] = (
    *(change_document,) * 8,
    *TEXT_MUTATIONS,
    yaml_bomb,
)
JSON_MUTATIONS: tuple[Mutation, ...] = (*(change_document,) * 12, *TEXT_MUTATIONS)

_XML_VALUE = re.compile(rb'(?<=")[^"<>]*(?=")')


def replace_attribute(rng: Random, data: bytes) -> bytes:
    text = rng.choice(
        NUMBERS + WORDS + ("1 2", "nan nan nan", "1 2 3 4", "0 0 0", "1e30 1e30 1e30")
    )
    return _replaced(rng, data, _XML_VALUE, text.replace('"', "&quot;"))


def xml_bomb(rng: Random, data: bytes) -> bytes:
    entities = ['<!ENTITY a0 "xxxxxxxxxx">']
    entities += [f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10)]
    entities += ['<!ENTITY f SYSTEM "file:///etc/passwd">', '<!ENTITY z SYSTEM "zero">']
    head = f"<!DOCTYPE robot [{''.join(entities)}]>".encode()
    use = rng.choice((b"&a9;", b"&f;", b"&z;"))
    return head + _replaced(rng, re.sub(rb"^<\?xml.*?\?>", b"", data), _XML_VALUE, use.decode())


def repeat_element(rng: Random, data: bytes) -> bytes:
    """Repeats, nests or removes an element."""
    elements = list(re.finditer(rb"<(\w[\w:]*)[^<>]*?(/>|>(?:[^<]|<(?!/\1))*?</\1>)", data))
    if not elements:
        return data
    element = rng.choice(elements)
    text = rng.choice((b"", element[0] * 2, element[0] * 3000, b"<a>" + element[0] + b"</a>"))
    return data[: element.start()] + text + data[element.end() :]


XML_MUTATIONS: tuple[Mutation, ...] = (
    *(replace_attribute,) * 6,
    *(repeat_element,) * 3,
    xml_bomb,
    *TEXT_MUTATIONS,
)


def change_glb(rng: Random, data: bytes) -> bytes:
    """Changes the JSON chunk of a binary glTF file, with correct sizes in its heads."""
    (size,) = struct.unpack_from("<I", data, 12)
    text = change_document(rng, data[20 : 20 + size])
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    total = 20 + len(text) + len(rest)
    return data[:8] + struct.pack("<II", total, len(text)) + data[16:20] + text + rest


def change_journal(rng: Random, data: bytes) -> bytes:
    """Changes the records of a journal; the chain and the hash of its plan are right again."""
    lines = data.splitlines()
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(lines))
        with contextlib.suppress(Exception):  # the changed record has no hash any more
            record = json.loads(lines[at])
            record.pop("chain")
            record = change_tree(rng, record)
            if "plan" in record and rng.random() < 0.8:
                record["hash"] = plan_from_json(record["plan"]).hash
            text = json.dumps(record, separators=(",", ":")).encode()[:-1]
            lines[at] = text + b',"chain":"}'
    link = b""
    for at, line in enumerate(lines):
        text, found, _ = line.rpartition(b',"chain":"')
        if found:
            link = hashlib.sha256(link + text).hexdigest()[:32].encode()
            lines[at] = b'%s,"chain":"%s"}' % (text, link)
    return b"\n".join(lines) + b"\n"


JOURNAL_MUTATIONS: tuple[Mutation, ...] = (*(change_journal,) * 12, change_lines, *TEXT_MUTATIONS)


def add_columns(rng: Random, data: bytes) -> bytes:
    """Gives every line of a table more columns, or takes columns away."""
    act = rng.choice(("more", "many", "fewer", "semicolons", "quotes"))
    lines = data.splitlines()
    if act == "more":
        lines = [line + b",1" for line in lines]
    elif act == "many":
        lines = [line + b",1" * 20_000 for line in lines[:3]]
    elif act == "fewer":
        at = rng.randrange(1, 6)
        lines = [b",".join(line.split(b",")[:at]) for line in lines]
    elif act == "semicolons":
        lines = [line.replace(b",", rng.choice((b";", b"\t"))) for line in lines]
    else:
        lines = [b'"' + line.replace(b",", b'","') + b'"' for line in lines]
    return b"\n".join(lines) + b"\n"


CSV_MUTATIONS: tuple[Mutation, ...] = (*TEXT_MUTATIONS, *(add_columns,) * 2, *(replace_number,) * 4)
