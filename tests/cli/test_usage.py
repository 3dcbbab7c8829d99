"""Wrong usage of any command ends with exit status 2 and one short message."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.cli.test_command_table import PATHS
from tests.slow import one_quick_of
from thorvaldc.cli.main import click_command

SCENARIO = """\
thorvaldc: 1
scenario: s
duration: 1 s
robots: {good: {robot: good.yaml}}
script: [{at: 0 s, vx: 0.1 m/s}]
"""
# Arguments and required options of each command; `good.yaml` stands for most.
ARGUMENTS = {
    "new": ["mine"],
    "scenario": ["s.yaml"],
    "view": ["good.yaml", "--html"],
    "run": ["good.yaml", "--bus", "virtual"],
    "call": ["nobody"],
    **{
        f"can {name}": ["good.yaml", "--bus", "virtual"]
        for name in ("scan", "plan", "flash", "verify", "monitor")
    },
    "calibrate": ["log.csv", "good.yaml"],
    "modules list": [],
    "modules show": ["drive/standard"],
    "modules check": [],
    "modules new": ["tool/mine"],
    "diff": ["good.yaml", "good.yaml"],
    "why": ["good.yaml", "mass"],
    "targets": [],
    "schema": ["robot"],
    "lsp": [],
    "explain": ["TV101"],
}
# Values that an option cannot have, by the metavar of the option.
WRONG_VALUES = {
    "N": ("x", "1.5"),
    "TIME": ("x", "-1", "nan", "1e9", "1 m"),
    "VX,VY,WZ": ("a", "1,2", "nan,0,0", "1,2,3,4"),
    "LENGTH": ("x", "-1", "nan"),
    "BASE": ("x",),
    "ADDRESS": ("x", "tcp://", "tcp://host", "tcp://host:x", "http://host:1"),
    "PERCENT": ("x", "-1", "101"),
    "PORT": ("x", "-1", "70000"),
    "KBIT": ("x", "-1"),
    "WxH": ("x", "0x0", "1000"),
    "VIEW": ("nowhere",),
    "PRESET": ("x",),
    "NAMES": ("x", ""),
    "PATH=VALUES": ("x", "=1"),
    "PATH=VALUE": ("x", "=1"),
    "HOST": ("-oProxyCommand=x", "x@-oProxyCommand=x", "a b", "$(x)", "ssh://x"),
    "OUT.png": ("out.xyz",),
    "OUT.mp4": ("out.xyz",),
    "OUT.csv": ("out.xyz",),
}
# Metavars of options whose value is checked against files, buses or other programs, which is no
# error of usage, and of names of new files.
OTHER_VALUES = {
    *("FILE", "DIR", "OUT", "OUT.html", "OUT.xml", "RECORD", "SET", "TEXT", "HASH", "NAME"),
    *("BUS", "[NAME=]BUS", "SOURCE", "DEVICE", "ENTRIES", "OBJECTIVE", "QUERY", "NODE"),
}
MISSING_FOLDER_IS_NEW = {
    *(("build", "--output"), ("demo", "--output"), ("modules new", "--library")),
    *(("modules from-dbc", "--library"), ("modules from-eds", "--library")),
}


def _wrong_usages() -> list[tuple[str, ...]]:
    cases: list[tuple[str, ...]] = []
    for path in PATHS:
        name = " ".join(path)
        command = click_command(name)
        words = (*path, *ARGUMENTS.get(name, ["good.yaml"]))
        cases.append((*words, "--nonsense"))
        cases += [path] if any(p.required for p in command.params) else []
        takes_many = any(p.nargs == -1 for p in command.params)
        cases += [] if takes_many else [(*words, "one", "too", "many")]
        for option in command.params:
            if option.param_type_name != "option" or option.is_flag:
                continue
            cases.append((*words, option.opts[0]))
            if "|" in option.metavar:
                values: tuple[str, ...] = ("x",)
            elif option.metavar == "DIR" and (name, option.opts[0]) not in MISSING_FOLDER_IS_NEW:
                values = ("nowhere",)
            else:
                values = WRONG_VALUES.get(option.metavar, ())
            cases += [(*words, option.opts[0], value) for value in values]
    return cases


def test_every_kind_of_value_is_known() -> None:
    options = [option for path in PATHS for option in click_command(" ".join(path)).params]
    metavars = {o.metavar for o in options if o.param_type_name == "option" and not o.is_flag}
    plain = {metavar for metavar in metavars if "|" not in metavar}
    assert plain - {*WRONG_VALUES, *OTHER_VALUES} == set()


@pytest.mark.parametrize("path", one_quick_of(4, [(path,) for path in PATHS]), ids=" ".join)
def test_wrong_usage(path: tuple[str, ...], thorvaldc: Command) -> None:
    Path("s.yaml").write_text(SCENARIO, encoding="utf-8")
    before = sorted(Path().iterdir())
    for words in _wrong_usages():
        if words[: len(path)] == path:
            status, out, err = thorvaldc(*words)
            assert (status, out) == (2, ""), words
            *usage, message = err.splitlines()
            assert not usage or usage[0].startswith(f"Usage: thorvaldc {' '.join(path)} "), words
            assert len(usage) in (0, 3), words
            assert message.startswith("Error: "), words
            assert len(message) < 250, words
    assert sorted(Path().iterdir()) == before


@pytest.mark.parametrize(
    "words",
    [("nonsense",), ("--nonsense",), ("can", "nonsense"), ("can", "--nonsense"), ("modules", "x")],
    ids=" ".join,
)
def test_unknown_commands(words: tuple[str, ...], thorvaldc: Command) -> None:
    status, out, err = thorvaldc(*words)
    assert (status, out) == (2, "")
    assert err.splitlines()[-1].startswith("Error: No such ")


@pytest.mark.parametrize(
    "words",
    [
        ("modules", "show", "drive/nothing"),
        ("schema", "nothing"),
        ("explain", "TV000"),
        ("new", "Not A Name"),
        ("teleop",),
        ("teleop", "good.yaml", "--to", "good"),
        ("can", "flash", "good.yaml", "--bus", "virtual", "--resume", "--rollback"),
    ],
    ids=" ".join,
)
def test_wrong_arguments(words: tuple[str, ...], thorvaldc: Command) -> None:
    status, out, err = thorvaldc(*words)
    assert (status, out) == (2, "")
    assert err.splitlines()[-1].startswith("Error: ")


@pytest.mark.parametrize(
    "words",
    [
        *((name, "no.yaml") for name in ("check", "build", "sim", "render", "preview", "view")),
        *((name, "no.yaml") for name in ("scenario", "bus", "faults", "info", "import")),
        ("run", "no.yaml", "--bus", "virtual"),
        ("can", "plan", "no.yaml", "--bus", "virtual"),
        ("can", "monitor", "no.yaml", "--bus", "sim:x"),
        ("calibrate", "no.csv", "good.yaml"),
        ("modules", "new", "tool/mine", "--mesh", "no.stl"),
        ("diff", "good.yaml", "no.yaml"),
        ("why", "no.yaml", "mass"),
        ("audit", "no"),
    ],
    ids=" ".join,
)
def test_a_missing_file_is_an_input_error(words: tuple[str, ...], thorvaldc: Command) -> None:
    status, out, err = thorvaldc(*words)
    assert status == 1, err
    assert "does not exist" in out + err
