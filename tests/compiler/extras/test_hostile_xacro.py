"""Tests of hostile xacro files: none reads secrets, writes, starts programs or reaches others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest

from tests.compiler.extras.xacro_files import HEAD, STL, load, load_one, mesh
from tests.slow import mostly_slow
from thorvaldc.compiler.extras.xacro_expand import (
    DisplayPaths,
    ExpandedFile,
    ExpansionRequest,
    expand,
)
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot

SECRET = "squeamish"
CLASSES = "().__class__.__base__.__subclasses__()"
# xacro itself forbids names with two underscores, but not inside a lambda.
OS = f"(lambda: [c for c in {CLASSES} if c.__name__ == '_wrap_close'][0].__init__.__globals__)()"
VARS = "python.vars(python.type)"
SUBCLASSES = f"{VARS}['__subclasses__']({VARS}['mro'](str)[-1])"

EXPRESSIONS = [
    "().__class__",
    CLASSES,
    f"(lambda: {CLASSES})()",
    f"{OS}['system']('touch {{out}}')",
    f"{OS}['environ']['SECRET_TOKEN']",
    f"{OS}['kill']({OS}['getppid'](), 9)",
    f"{OS}['unlink']('{{kept}}')",
    f"{OS}['rename']('{{kept}}', '{{out}}')",
    f"{OS}['open']('{{out}}', 65)",
    f"{OS}['popen']('cat {{secret}}').read()",
    "(lambda: xacro.load_yaml.__globals__)()['os'].system('touch {out}')",
    "(lambda f: f.__code__)(lambda: 1)",
    "(lambda f: f.__closure__)(xacro.warning)",
    "[g.gi_frame for g in [(x for x in [1])]][0].f_back.f_globals",
    "(x for x in [1]).gi_frame.f_builtins",
    "(x for x in [1]).gi_code.co_consts",
    "xacro.warning.func_globals",
    "[c for c in str.mro()]",
    f"{SUBCLASSES}",
    f"[c for c in {SUBCLASSES} if 'wrap_close' in str(c)]",
    "python.vars(xacro)",
    "python.type('C', (), dict(a=1))",
    "python.type(1).mro()",
    "xacro.parent",
    "xacro.update(dict(warning=1))",
    "xacro.root['python']",
    "dict.update(xacro, dict(warning=1))",
    "dict.__subclasses__()",
    "str.__init_subclass__",
    "math.__loader__",
    "__builtins__",
    "__import__('os').system('touch {out}')",
    "(lambda __x: __x)(1)",
    "dict(__class__=1)",
    "(y := ().__class__)",
    "[(yield 1)]",
    "b'abc'.decode('utf-8')",
    "'abc'.encode('zlib_codec')",
    "open('{secret}').read()",
    "eval('1')",
    "exec('1')",
    "getattr(1, 'real')",
    "globals()",
    "breakpoint()",
    "input()",
    "xacro.load_yaml('{secret}')",
    "load_yaml('{secret}')",
    "xacro.load_yaml('../outside/secret.yaml')",
    "xacro.load_yaml('link.yaml')",
    "xacro.load_yaml('/proc/self/environ')",
    "xacro.load_yaml('/proc/self/maps')",
    "xacro.load_yaml('hostile.yaml')",
    "xacro.load_yaml('object.yaml')",
]
FORMATS = {  # a `}` would end the expression, so a property brings it in
    "{0.__class__}": "text.format(1)",
    "{0.__globals__[os].environ[SECRET_TOKEN]}": "text.format(xacro.load_yaml)",
    "{:{0.__class__}}": "text.format(1)",
    "{x.__class__}": "text.format_map(dict(x=1))",
    "{x.denominator.real}": "str.format(text, x=1)",
    "{0.real}": "(lambda f: f(text, 1))(str.format)",
    "{0.imag}": "list(map(str.format, [text], [1]))",
    "{1.real}": "(text + '').format(1, 2)",
}
EVALS = [  # in `$(eval ...)` xacro gives all builtins, and a property brings in the brackets
    "open('{secret}').read()",
    "exec('import os')",
    "getattr(1, 'real')",
    "eval('1+1')",
    "f'{(1).__class__}'",
    "f'{1:{(1).mro}}'",
    "(lambda: (1)._x)()",
    "globals()",
    "vars()",
    "compile('1', '', 'eval')",
    "__import__('os')",
    "(1).real.as_integer_ratio.fget",
    "[c for c in str.mro()]",
    "(lambda f: f.gi_frame)(x for x in [1])",
]
BODIES = {
    "a condition": '<xacro:if value="${().__class__}"/>',
    "a default of an argument": '<xacro:arg name="a" default="${().__class__}"/>',
    "a default of a parameter": '<xacro:macro name="m" params="a:=${().__class__}"/><xacro:m/>',
    "a parameter": '<xacro:macro name="m" params="a"/><xacro:m a="${().__class__}"/>',
    "a property": '<xacro:property name="p" value="${().__class__}"/><link name="${p}"/>',
    "an eager property": '<xacro:property name="p" value="${().__class__}" lazy_eval="false"/>',
    "a name of a property": '<xacro:property name="${().__class__}" value="1"/>',
    "an element": '<xacro:element xacro:name="${().__class__}"/>',
    "an attribute": '<link><xacro:attribute name="name" value="${().__class__}"/></link>',
    "a call": '<xacro:call macro="${().__class__}"/>',
    "a text": "<gazebo>${().__class__}</gazebo>",
    "a comment": "<!-- xacro:eval-comments --><!-- ${().__class__} -->",
    "an include": '<xacro:include filename="{secret}"/>',
    "an optional include": '<xacro:include filename="{secret}" optional="true"/>',
    "a URL": '<xacro:include filename="file://{secret}"/>',
    "an include of a link": '<xacro:include filename="link.yaml"/>',
    "an environment variable": '<link name="$(env SECRET_TOKEN)"/>',
    "a folder that is no package": '<link name="$(find outside)"/>',
}

BODIES |= {
    f"${{{expression}}}": f"<link name={quoteattr('${' + expression + '}')}/>"
    for expression in EXPRESSIONS
}
for key, call in [*((e, "$(eval ${text})") for e in EVALS), *FORMATS.items()]:
    value = call if call.startswith("$") else "${" + call + "}"
    BODIES[f"{value} with {key}"] = (
        f"<xacro:property name='text' value={quoteattr(key)}/><link name={quoteattr(value)}/>"
    )


def attack(folder: Path, bodies: Sequence[str], *, trust: bool = False) -> list[ExpandedFile]:
    """Expands one xacro file for each body, in a folder beside a folder with a secret."""
    inside, outside = folder / "robot", folder / "outside"
    inside.mkdir()
    outside.mkdir()
    (outside / "secret.yaml").write_text(f"token: {SECRET}\n", encoding="utf-8")
    (inside / "kept.txt").write_text("kept", encoding="utf-8")
    (inside / "link.yaml").symlink_to(outside / "secret.yaml")
    (inside / "hostile.yaml").write_text("a: !radians '().__class__'\n", encoding="utf-8")
    (inside / "object.yaml").write_text("!!python/object/apply:os.getpid []\n", encoding="utf-8")
    requests = []
    for number, body in enumerate(bodies):
        for name, path in (
            ("{out}", inside / "out.txt"),
            ("{kept}", inside / "kept.txt"),
            ("{secret}", outside / "secret.yaml"),
        ):
            body = body.replace(name, str(path))
        file = inside / f"f{number}.xacro"
        file.write_text(f"{HEAD}{body}</robot>\n", encoding="utf-8")
        requests.append(ExpansionRequest(file, {}, {}))
    return expand(requests, DisplayPaths(inside, "", {}), trust=trust)


@pytest.fixture(scope="module")
def attacks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ExpandedFile]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SECRET_TOKEN", SECRET)
        folder = tmp_path_factory.mktemp("attacks")
        results = attack(folder, list(BODIES.values()))
    assert (folder / "robot" / "kept.txt").read_text(encoding="utf-8") == "kept"
    files = {f.name for f in (folder / "robot").iterdir()}
    assert files == {"kept.txt", "link.yaml", "hostile.yaml", "object.yaml"} | {
        f"f{n}.xacro" for n in range(len(BODIES))
    }
    assert [f.name for f in (folder / "outside").iterdir()] == ["secret.yaml"]
    return dict(zip(BODIES, results, strict=True))


@pytest.mark.parametrize("name", BODIES)
def test_a_hostile_file_is_refused(attacks: dict[str, ExpandedFile], name: str) -> None:
    result = attacks[name]
    assert result.failure is not None, result.elements
    assert result.failure.kind in ("forbidden", "expression", "package", "environment")
    assert result.failure.span is not None
    assert result.failure.span.line in (2, 3)  # the robot's line for a comment
    assert SECRET not in repr(result)


@pytest.mark.parametrize(
    ("body", "effect"),
    [
        (f"<link name={quoteattr('${' + OS + '}')}/>", "environ"),
        ("<link name=\"${xacro.load_yaml('{secret}').token}\"/>", SECRET),
        ("<link name=\"${xacro.load_yaml('link.yaml').token}\"/>", SECRET),
        ("<link name='${python.vars(python.type)}'/>", "__subclasses__"),
        (
            "<xacro:property name='text' value=\"open('{secret}').read()\"/>"
            "<link name='$(eval ${text})'/>",
            SECRET,
        ),
        (
            "<xacro:property name='text' value='{0.__globals__[os].environ}'/>"
            "<link name='${text.format(xacro.load_yaml)}'/>",
            "LC_ALL",
        ),
    ],
)
def test_the_same_works_if_the_user_trusts_the_file(tmp_path: Path, body: str, effect: str) -> None:
    (trusted,) = attack(tmp_path, [body], trust=True)
    assert trusted.failure is None
    assert effect in trusted.elements[0].attributes["name"]
    (tmp_path / "again").mkdir()
    (refused,) = attack(tmp_path / "again", [body])
    assert refused.failure is not None
    assert refused.failure.kind in ("forbidden", "expression")


def test_a_pattern_finds_no_files_outside(tmp_path: Path) -> None:
    (result,) = attack(tmp_path, ['<xacro:include filename="../outside/*.yaml"/>'])
    assert SECRET not in repr(result)
    assert result.elements == ()


def test_an_optional_environment_variable_is_never_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", SECRET)
    (result,) = attack(tmp_path, ['<link name="$(optenv SECRET_TOKEN none)"/>'])
    assert result.elements[0].attributes["name"] == "none"


def test_the_diagnostic_names_line_reason_and_option(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, "\n<link name='${().__class__}'/>")
    assert loaded.codes == ["extra-forbidden"]
    assert "`().__class__` uses the attribute `__class__`" in loaded.only.message
    assert loaded.only.span.line == 4
    assert loaded.only.span.file == "a.xacro"
    assert "--trust" in (loaded.only.hint or "")


def test_only_the_caller_can_trust_a_file(tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    text = (
        "thorvaldc: 1\nname: robot\nmodules:\n"
        "  frame: {type: frame/tube_rectangular, params: {length: 1.1, width: 0.9}}\n"
    )
    for port in ("front_left", "front_right", "rear_left", "rear_right"):
        text += f"  m_{port}: {{type: assembly/steered_drive, mount: frame.{port}}}\n"
    text += "extras:\n  - {xacro: a.xacro}\n"
    robot.write_text(text, encoding="utf-8")
    body = "<link name='${(lambda: ().__class__ and \"mast\")()}'/></robot>"
    (tmp_path / "a.xacro").write_text(HEAD + body, encoding="utf-8")
    assert [d.code.name for d in compile_file(robot).report] == ["extra-forbidden"]
    trusted = compile_file(robot, trust=True).model
    assert isinstance(trusted, Robot)
    assert "mast" in [link.name for link in trusted.links]
    for stated in ("trust: true\n" + text, text.replace("a.xacro}", "a.xacro, trust: true}")):
        robot.write_text(stated, encoding="utf-8")
        assert compile_file(robot).model is None


def test_a_robot_file_opens_no_folder_outside_of_its_own(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.yaml").write_text(f"token: {SECRET}\n", encoding="utf-8")
    body = f"{HEAD}<link name=\"${{xacro.load_yaml('$(find p)/secret.yaml').token}}\"/></robot>"
    entries = "- {xacro: a.xacro, packages: {p: ../outside}}"
    assert load(tmp_path / "robot", entries, a_xacro=body).codes == ["extra-forbidden"]
    (outside / "package.xml").write_text("<package/>", encoding="utf-8")
    loaded = load(tmp_path / "robot", entries, a_xacro=body)
    assert [link.name for link in loaded.parts.links] == [SECRET]


# Expressions in the style of published descriptions, with the text that xacro gives without rules.
LEGITIMATE = {
    "${radians(90)}": "1.5707963267948966",
    "${pi/2 - math.pi/4}": "0.7853981633974483",
    "${-2*math.pi}": "-6.283185307179586",
    "${[1, 2, 3][1]}": "2",
    "${dict(a=1, b=2)['b']}": "2",
    "${dict(a=1).get('c', 5)}": "5",
    "${'a' in dict(a=1)}": "True",
    "${'left' if 1 > 2 else 'right'}": "right",
    "${'1 2 3'.split(' ')[1]}": "2",
    "${'x_y'.replace('_', '-').upper()}": "X-Y",
    "${'_'.join(['a', 'b'])}": "a_b",
    "${name.startswith('fl') and not name.endswith('x')}": "True",
    "${'%s_%.2f' % (name, 0.5)}": "fl_wheel_0.50",
    "${text.format(1.23456, k='v')}": "1.23 v",
    "${config.wheel.radius * 2}": "0.4",
    "${config['wheel']['names'][0]}": "a",
    "${config.wheel.names[1]}": "b",
    "${config.wheel.angle}": "1.5707963267948966",
    "${config.wheel.get('missing', 7)}": "7",
    "${list(config.wheel.keys())}": "['radius', 'names', 'angle']",
    "${len(config.wheel.names)}": "2",
    "${[n + '_x' for n in config.wheel.names]}": "['a_x', 'b_x']",
    "${list(map(lambda i: i * 2, [1, 2]))}": "[2, 4]",
    "${max(1, 2) + min(3, 4)}": "5",
    "${python.abs(-2) + python.sum([1, 2])}": "5",
    "${python.sorted([3, 1])}": "[1, 3]",
    "${python.list(python.zip([1], [2]))}": "[(1, 2)]",
    "${python.isinstance(1, int)}": "True",
    "${python.type('a') == str}": "True",
    "${xacro.dotify(dict(a=dict(b=3))).a.b}": "3",
    "${xacro.tokenize('1,2;3')}": "['1', '2', '3']",
    "${xacro.arg('side')}": "left",
    "${round(sqrt(2) * cos(0.1), 3)}": "1.407",
    "${float('1.5') + int('2')}": "3.5",
    "${1 if '$(arg side)' == 'left' else -1}": "1",
    "${(3).real + 2.5.imag}": "3.0",
    "${'abc'[::-1]}": "cba",
    "${1 < 2 <= 2 and (1, 2) != (2, 1)}": "True",
    "${5 // 2 + 5 % 2 + 2 ** 3}": "11",
    "$(arg side)": "left",
    "$(eval 2 * pi)": "6.283185307179586",
    "$(eval side)": "left",
    "$(eval ${call})": "3",
    "$(optenv NOTHING here)": "here",
    "$(cwd)": "",
}
PRELUDE = (
    "<xacro:property name='name' value='fl_wheel'/>"
    "<xacro:property name='text' value='{:.2f} {k}'/>"
    "<xacro:property name='call' value='len([1, 2, 3])'/>"
    "<xacro:arg name='side' default='left'/>"
    "<xacro:property name='config' value=\"${xacro.load_yaml('config.yaml')}\"/>"
)


def test_expressions_of_published_descriptions_are_evaluated(tmp_path: Path) -> None:
    config = "wheel: {radius: 0.2, names: [a, b], angle: !degrees 90}\n"
    (tmp_path / "config.yaml").write_text(config, encoding="utf-8")
    links = "".join(f"<link name={quoteattr('=' + text)}/>" for text in LEGITIMATE)
    (tmp_path / "a.xacro").write_text(f"{HEAD}{PRELUDE}{links}</robot>", encoding="utf-8")
    requests = [ExpansionRequest(tmp_path / "a.xacro", {}, {})]
    texts = []
    for trust in (True, False):
        (expanded,) = expand(requests, DisplayPaths(tmp_path, "", {}), trust=trust)
        assert expanded.failure is None
        texts.append(
            [element.attributes["name"].removeprefix("=") for element in expanded.elements]
        )
    assert texts[0] == texts[1]
    for text, expected in zip(texts[1], LEGITIMATE.values(), strict=True):
        assert text == (expected or str(tmp_path))


@pytest.mark.parametrize("kind", mostly_slow(["collision", "visual"]))
@pytest.mark.parametrize("path", ["file://{outside}/m.stl", "../outside/m.stl", "link.stl"])
def test_meshes_of_other_folders_are_not_read(tmp_path: Path, path: str, kind: str) -> None:
    inside, outside = tmp_path / "robot", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (outside / "m.stl").write_bytes(STL)
    (inside / "link.stl").symlink_to(outside / "m.stl")
    body = mesh(path.format(outside=outside)).replace("visual", kind)
    loaded = load_one(inside, body)
    assert loaded.codes == ["extra-visual-mesh" if kind == "visual" else "extra-forbidden"]
    assert "m.stl` is outside of the folders" in loaded.only.message.replace("link.stl", "m.stl")
    assert "--trust" in (loaded.only.hint or "")
    assert loaded.parts.meshes == ()
    missing = load_one(inside, mesh(f"file://{outside}/none.stl"))
    assert "none.stl` does not exist" in missing.only.message
    # A folder with a `package.xml`, which the robot file names, may be read.
    (outside / "package.xml").write_text("<package><name>p</name></package>", encoding="utf-8")
    loaded = load_one(inside, body, f", packages: {{p: {outside}}}")
    assert loaded.codes == []
    assert len(loaded.parts.meshes) == 1
