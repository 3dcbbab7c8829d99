"""``thorvaldc upgrade``: every rule through the command, and what it does to files."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.conftest import GOOD, Command
from tests.examples import FOLDER
from tests.full_disk import full_disk
from tests.slow import mostly_slow
from thorvaldc.compiler.scaffolding import presets, robot_text
from thorvaldc.diagnostics import Fix, Report
from thorvaldc.schema import KINDS, inlined, old_words
from thorvaldc.schema.old_words import OldWord
from thorvaldc.tools.upgrade.document import BYTE_ORDER_MARK, Document
from thorvaldc.tools.upgrade.file_upgrade import read_document, upgrade_file
from thorvaldc.tools.upgrade.rules import RULES, Context

ROOT = Path(__file__).resolve().parents[3]
STATED = GOOD.replace("name: good", "name: good\ndriver: {homing: on_arming, arming: required}")

# A beam as it was before expressions had dimensions.
BEAM = """\
thorvaldc: 1
description: A beam.   # of the workshop
mount: {kinds: [frame_clamp], link: beam}
params:
  length: {quantity: length, description: Length., minimum: 100 mm}   # the robot states it
  wall: {quantity: length, default: 2 mm, description: Wall., source: "chosen: usual"}
let:
  per_metre: ${2700 * pi * wall * (60 mm - wall)}   # kg/m
  rim: 0.4   # kg/m
links:
  beam:
    parts:
      # the aluminium
      - shape: {box: ["${length}", 0.1, 0.1]}
        mass: ${per_metre * length}
        source: "estimated: tube"
      - {mass: "${max(0.3, 2.0 * length)}", com: [0, 0, 0], inertia: [0.1, 0.1, 0.1, 0, 0, 0],
         source: "estimated: fittings"}
      - {mass: '${rim * length}', com: [0, 0, 0], inertia: [0.1, 0.1, 0.1, 0, 0, 0],
         source: "estimated: rim"}
"""
PRESENT_BEAM = (
    BEAM.replace("${2700 * pi", "${2700 kg/m^3 * pi")
    .replace("${max(0.3, 2.0 * length)}", "${max(0.3 kg, 2.0 kg/m * length)}")
    .replace("rim: 0.4 ", "rim: 0.4 kg/m ")
)


@pytest.fixture
def beam(tmp_path: Path) -> Path:
    file = tmp_path / "my_modules" / "frame" / "beam" / "module.yaml"
    file.parent.mkdir(parents=True)
    file.write_text(BEAM, encoding="utf-8")
    return file


# -- dimensions ---------------------------------------------------------------------------------


def test_numbers_get_the_units_that_keep_the_value(thorvaldc: Command, beam: Path) -> None:
    result = thorvaldc("upgrade", str(beam))
    assert result.status == 0, result.err
    assert result.out == f"{beam}: upgraded: dimensions (3 changes)\n"
    assert beam.read_text(encoding="utf-8") == PRESENT_BEAM
    result = thorvaldc("upgrade", str(beam))
    assert (result.status, result.out) == (0, f"{beam}: nothing to change\n")
    assert beam.read_text(encoding="utf-8") == PRESENT_BEAM


def test_objects_of_a_controller_get_units_with_a_robot(thorvaldc: Command, tmp_path: Path) -> None:
    """Its expressions have values only where motors are wired to it.  With the old expressions the
    robot has the CAN files that it has with those of the library."""
    name = "controller/cia402_propulsion_steering/module.yaml"
    present = (ROOT / "modules" / name).read_text(encoding="utf-8")
    old = present
    for new, before in (
        ("max_velocity / propulsion_count * 1 s}", "max_velocity / propulsion_count}"),
        ("propulsion.motor_max_speed / 1 rpm}", "propulsion.motor_max_speed * 30 / pi}"),
        ("cycle / 1 ms}", "cycle * 1000}"),
    ):
        assert new in old
        old = old.replace(new, before)
    module = tmp_path / "modules" / name
    module.parent.mkdir(parents=True)
    module.write_text(old, encoding="utf-8")
    chosen = "defaults: {drive: {controller: controller/cia402_propulsion_steering}}\n"
    Path("robot.yaml").write_text(STATED + chosen, encoding="utf-8")
    assert thorvaldc("build", "robot.yaml", "--target", "can", "-o", "before").status == 0
    Path("robot.yaml").write_text(STATED + chosen + "library: [modules]\n", encoding="utf-8")
    assert thorvaldc("check", "robot.yaml").status == 1
    assert thorvaldc("upgrade", "robot.yaml", str(module)).status == 0
    assert "${propulsion.motor_max_speed * 30 s / pi}" in module.read_text(encoding="utf-8")
    assert thorvaldc("build", "robot.yaml", "--target", "can", "-o", "after").status == 0
    before, after = (
        {p.name: p.read_bytes() for p in Path(folder, "can").rglob("*") if p.is_file()}
        for folder in ("before", "after")
    )
    assert before == after


def test_a_wrong_name_in_an_expression_is_left_to_a_person(thorvaldc: Command, beam: Path) -> None:
    old = PRESENT_BEAM.replace("mass: ${per_metre * length}", "mass: ${length}")
    beam.write_text(old, encoding="utf-8")
    result = thorvaldc("upgrade", str(beam))
    assert result.status == 1
    assert "error[TV211] wrong-dimension: `${length}` is a length; expected a mass" in result.err
    assert beam.read_text(encoding="utf-8") == old


def test_a_value_in_a_wrong_unit_is_not_replaced(thorvaldc: Command, beam: Path) -> None:
    """The hint proposes `5 kg`, which is not what an older program read."""
    old = PRESENT_BEAM.replace("mass: ${per_metre * length}", "mass: 5 m")
    beam.write_text(old, encoding="utf-8")
    thorvaldc("upgrade", str(beam))
    assert beam.read_text(encoding="utf-8") == old


# -- decisions ----------------------------------------------------------------------------------

SOURCES = "driver: {homing: on_arming, arming: required, twist_sources: {rows: {priority: 20}}}"
NOISE = "driver: {homing: on_arming, arming: required, noise: {speed_ratio: 1 %, angle: 1 deg}}"
MOTOR = "motors:\n  spin: {joint: axle, gear_ratio: 42:1, source: 'chosen: x'}\n"


@pytest.mark.parametrize(
    ("text", "place", "message", "stated"),
    [
        (STATED.replace("homing: on_arming, ", ""), "3:1", "home position when the robot", STATED),
        (GOOD, "2:1", "home position when the robot is armed", STATED),
        (STATED.replace(", arming: required", ""), "3:1", "moves only after it was armed", STATED),
        (
            STATED.replace("driver: {homing: on_arming, arming: required}", SOURCES),
            "3:63",
            "a source commands zero before it moves",
            STATED.replace(
                "driver: {homing: on_arming, arming: required}",
                SOURCES.replace("priority: 20", "priority: 20, first_command: zero"),
            ),
        ),
        (
            STATED.replace("driver: {homing: on_arming, arming: required}", NOISE),
            "3:47",
            "`speed_ratio` may last for the whole drive",
            STATED.replace(
                "driver: {homing: on_arming, arming: required}",
                NOISE.replace(
                    "1 deg", "1 deg, radius_error: 0.2 %, steering_offset_error: 0.1 deg"
                ),
            ),
        ),
        (
            STATED + "  spare: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0, 1]}}\n",
            "11:3",
            "several batteries",
            STATED + "  spare: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0, 1]},"
            " params: {with_battery: false}}\n",
        ),
        (
            STATED.replace("can: 1}\n  fr", "can: 1, params: {leg_drop: 290 mm}}\n  fr"),
            "6:80",
            "`leg_drop` is not a word of the language any more",
            STATED.replace("can: 1}\n  fr", "can: 1, params: {height: 650 mm}}\n  fr"),
        ),
        (
            STATED + "base_calculator: random_pairs\n",
            "11:18",
            "`random_pairs` is not a word of the language any more",
            STATED + "base_calculator: general\n",
        ),
    ],
)
def test_what_a_person_decides_is_named_until_it_is_stated(
    thorvaldc: Command, text: str, place: str, message: str, stated: str
) -> None:
    file = Path("robot.yaml")
    file.write_text(text, encoding="utf-8")
    result = thorvaldc("upgrade", "robot.yaml")
    assert result.status == 0
    assert f"robot.yaml:{place}: note[TV976] upgrade-decision: " in result.err
    assert message in result.err
    assert file.read_text(encoding="utf-8") == text
    file.write_text(stated, encoding="utf-8")
    result = thorvaldc("upgrade", "robot.yaml")
    assert (result.status, result.err) == (0, "")
    assert result.out == "robot.yaml: nothing to change\n"


@pytest.mark.parametrize("preset", presets())
def test_a_new_robot_needs_no_decision(thorvaldc: Command, preset: str) -> None:
    text = robot_text("mine", preset)
    Path("robot.yaml").write_text(text, encoding="utf-8")
    assert thorvaldc("upgrade", "--dry-run", "robot.yaml").status == 0
    assert thorvaldc("upgrade", "robot.yaml").err == ""
    without = re.sub("\\ndriver: .*", "", text)
    Path("robot.yaml").write_text(without, encoding="utf-8")
    decisions = thorvaldc("upgrade", "robot.yaml").err
    assert ("homing" in decisions) == ("steered_drive" in text)
    assert "arming" in decisions


def test_a_motor_states_its_brake(thorvaldc: Command, beam: Path) -> None:
    beam.write_text(PRESENT_BEAM + MOTOR, encoding="utf-8")
    result = thorvaldc("upgrade", str(beam))
    assert "a motor without power and without a brake is released" in result.err
    assert "or `brake: none`" in result.err
    beam.write_text(PRESENT_BEAM + MOTOR.replace("42:1", "42:1, brake: none"), encoding="utf-8")
    assert "without a brake" not in thorvaldc("upgrade", str(beam)).err


def test_decisions_of_many_files_are_one_message(thorvaldc: Command) -> None:
    for number in range(5):
        Path(f"r{number}.yaml").write_text(STATED.replace("homing: on_arming, ", ""), "utf-8")
    result = thorvaldc("upgrade", *(f"r{number}.yaml" for number in range(5)))
    assert result.err.count("note[TV976]") == 1
    assert "(5 places)" in result.err


# -- words that have a new name -----------------------------------------------------------------


@pytest.fixture
def renamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that the language never had, in place of a word that gets a new name later."""
    words = (
        OldWord(("robot",), ("driver", "timeout"), new="command_timeout"),
        OldWord(("robot",), ("driver", "arming"), new="automatic", value="never"),
    )
    monkeypatch.setattr(old_words, "OLD_WORDS", (*old_words.OLD_WORDS, *words))


def test_a_renamed_word_is_written(thorvaldc: Command, renamed: None) -> None:
    old = STATED.replace("arming: required", "'timeout': 1 s,  arming: never")
    file = Path("robot.yaml")
    file.write_text(old, encoding="utf-8")
    result = thorvaldc("check", "robot.yaml")
    assert "`driver` has no key `timeout`" in result.out
    assert "it is `command_timeout` now; `thorvaldc upgrade FILE` writes it" in result.out
    assert thorvaldc("upgrade", "robot.yaml").out == (
        "robot.yaml: upgraded: old words (2 changes)\n"
    )
    assert file.read_text(encoding="utf-8") == (
        old.replace("'timeout'", "command_timeout").replace("never", "automatic")
    )
    assert thorvaldc("check", "robot.yaml").status == 0


def test_a_word_beside_its_new_name_is_a_decision(thorvaldc: Command, renamed: None) -> None:
    old = STATED.replace("arming:", "timeout: 1 s, command_timeout: 2 s, arming:")
    Path("robot.yaml").write_text(old, encoding="utf-8")
    result = thorvaldc("upgrade", "robot.yaml")
    assert "keep one of `timeout` and `command_timeout`" in result.err
    assert Path("robot.yaml").read_text(encoding="utf-8") == old


def test_a_unit_is_upgraded_with_what_its_design_states(thorvaldc: Command) -> None:
    Path("design.yaml").write_text(STATED, encoding="utf-8")
    head = "thorvaldc: 1\nextends: design.yaml\nname: second\n"
    Path("unit.yaml").write_text(head + "modules.fr.can: 7\n", encoding="utf-8")
    unchanged = thorvaldc("upgrade", "unit.yaml")
    assert (unchanged.status, unchanged.err) == (0, "")
    text = head + "modules.fl.params.leg_drop: 290 mm\n"
    Path("unit.yaml").write_text(text, encoding="utf-8")
    result = thorvaldc("upgrade", "unit.yaml")
    assert "unit.yaml:4:1: note[TV976]" in result.err
    assert "`leg_drop` is not a word of the language any more" in result.err


def test_check_says_what_stands_in_place_of_a_word(thorvaldc: Command) -> None:
    text = GOOD.replace("can: 1}\n  fr", "can: 1, params: {leg_drop: 290 mm}}\n  fr")
    Path("robot.yaml").write_text(text, encoding="utf-8")
    assert (
        "write `height`, from the mount down to the ground" in thorvaldc("check", "robot.yaml").out
    )
    Path("robot.yaml").write_text(GOOD + "base_calculator: random_pairs\n", encoding="utf-8")
    assert "this calculator is a package of its own" in thorvaldc("check", "robot.yaml").out


# -- versions and files -------------------------------------------------------------------------


@pytest.mark.parametrize("options", [(), ("--dry-run",)])
def test_a_newer_version_says_so(thorvaldc: Command, options: tuple[str, ...]) -> None:
    text = GOOD.replace("thorvaldc: 1", "thorvaldc: 2")
    Path("robot.yaml").write_text(text, encoding="utf-8")
    result = thorvaldc("upgrade", "robot.yaml", *options)
    assert result.status == 1
    assert (
        "robot.yaml:1:12: error[TV209] language-version: the file is in version 2 of the language;"
        " this program reads 1" in result.err
    )
    assert "hint: install a newer thorvaldc" in result.err
    assert Path("robot.yaml").read_text(encoding="utf-8") == text


def test_a_dry_run_shows_the_difference(thorvaldc: Command, beam: Path) -> None:
    result = thorvaldc("upgrade", "--dry-run", str(beam))
    assert result.status == 1
    assert result.out.startswith(f"--- {beam}\n+++ {beam}\n@@")
    assert "\n-  rim: 0.4   # kg/m\n" in result.out
    assert "\n+  rim: 0.4 kg/m   # kg/m\n" in result.out
    assert result.err == f"{beam}: would be upgraded: dimensions (3 changes)\n"
    assert beam.read_text(encoding="utf-8") == BEAM
    beam.write_text(PRESENT_BEAM, encoding="utf-8")
    result = thorvaldc("upgrade", "--dry-run", str(beam))
    assert (result.status, result.out) == (0, "")


def test_the_result_as_json(thorvaldc: Command, beam: Path) -> None:
    output = json.loads(thorvaldc("upgrade", "--dry-run", "--json", str(beam)).out)
    (upgraded,) = output["upgrades"]
    assert upgraded["file"] == str(beam)
    assert upgraded["changes"] == {"dimensions": 3}
    assert upgraded["difference"].startswith(f"--- {beam}\n+++ {beam}\n@@")
    assert not upgraded["written"]
    assert beam.read_text(encoding="utf-8") == BEAM
    Path("robot.yaml").write_text(GOOD, encoding="utf-8")
    output = json.loads(thorvaldc("upgrade", "--json", str(beam), "robot.yaml").out)
    assert [upgraded["difference"] for upgraded in output["upgrades"]] == ["", ""]
    assert [upgraded["written"] for upgraded in output["upgrades"]] == [True, False]
    assert {d["code"] for d in output["diagnostics"]} == {"TV976"}
    assert beam.read_text(encoding="utf-8") == PRESENT_BEAM


def test_a_dry_run_is_a_patch(
    thorvaldc: Command, beam: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beam.write_text(BEAM.rstrip("\n"), encoding="utf-8")
    monkeypatch.chdir(beam.parent)
    patch = thorvaldc("upgrade", "--dry-run", "module.yaml").out
    subprocess.run(["git", "apply", "-p0"], input=patch, text=True, check=True)
    assert beam.read_text(encoding="utf-8") == PRESENT_BEAM.rstrip("\n")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"thorvaldc: 1\nname: [\n", "error[TV101]"),
        (b"\x00\x01\x02", "error[TV1"),
        (b"\xff\xfet\x00", "the file is UTF-16"),
        (b"<robot name='r'/>", "error[TV218]"),
        (b"", "is empty"),
        (b"a: 1\n", "is no document of thorvaldc"),
        (b"- 1\n", "is no document of thorvaldc"),
        (b"thorvaldc_lock: 1\naddresses: {}\n", "this is a lock file"),
        (b'{"format": "thorvaldc-model", "version": 10}', "is no document of thorvaldc"),
        (b"thorvaldc: 1\nname: r\nmodules: 3\n", ""),
        (b"thorvaldc: 1\nstudy: [1, {a: 2}]\n", ""),
    ],
)
def test_files_that_are_none_are_left_alone(thorvaldc: Command, data: bytes, message: str) -> None:
    file = Path("some.yaml")
    file.write_bytes(data)
    result = thorvaldc("upgrade", "some.yaml")
    assert result.status == (1 if message else 0)
    assert message in result.err
    assert "Traceback" not in result.err
    assert file.read_bytes() == data


def test_folders_and_missing_files(thorvaldc: Command, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    result = thorvaldc("upgrade", "folder", "none.yaml", "loop.yaml", "good.yaml")
    assert result.status == 1
    assert "error[TV902] file-is-a-directory" in result.err
    assert "error[TV901] file-not-found" in result.err
    assert "`loop.yaml` cannot be read" in result.err
    assert "3 errors in 4 files" in result.err
    assert result.out.startswith("good.yaml: nothing to change")


def test_a_link_stays_a_link(thorvaldc: Command, beam: Path, tmp_path: Path) -> None:
    link = beam.parents[1] / "linked" / "module.yaml"
    link.parent.mkdir(parents=True)
    link.symlink_to(beam)
    assert thorvaldc("upgrade", str(link)).status == 0
    assert link.is_symlink()
    assert beam.read_text(encoding="utf-8") == PRESENT_BEAM


def test_a_full_disk_leaves_the_file(thorvaldc: Command, beam: Path) -> None:
    Path("good.yaml").write_text(STATED, encoding="utf-8")
    with full_disk(100):
        result = thorvaldc("upgrade", str(beam), "good.yaml")
    assert result.status == 3
    assert f"error: {beam}: File too large; it is unchanged\n" in result.err
    assert result.out == "good.yaml: nothing to change\n"
    with full_disk(100):
        result = thorvaldc("upgrade", "--json", str(beam))
    assert result.status == 3
    assert [upgraded["written"] for upgraded in json.loads(result.out)["upgrades"]] == [False]
    assert beam.read_text(encoding="utf-8") == BEAM
    assert [path.name for path in beam.parent.iterdir()] == ["module.yaml"]


def test_ctrl_c_while_a_file_is_written_leaves_it(
    thorvaldc: Command, beam: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(new: Path, old: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert thorvaldc("upgrade", str(beam)).status == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert beam.read_text(encoding="utf-8") == BEAM
    assert [path.name for path in beam.parent.iterdir()] == ["module.yaml"]


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write every file")
def test_a_file_that_must_not_be_written(thorvaldc: Command, beam: Path) -> None:
    beam.chmod(0o444)
    result = thorvaldc("upgrade", str(beam))
    assert result.status == 3
    assert "Permission denied; it is unchanged" in result.err


# -- what stays as it is ------------------------------------------------------------------------

KIND_OF = {
    path: document.kind
    for folder in (ROOT / "modules", FOLDER)
    for path in sorted(folder.rglob("*.yaml"))
    if (document := read_document(path, Report())) is not None
}
FIRST_OF_KIND = {kind: path for path, kind in reversed(KIND_OF.items())}.values()
DOCUMENTS = [*FIRST_OF_KIND, *(path for path in KIND_OF if path not in FIRST_OF_KIND)]


def test_every_kind_of_document_has_examples() -> None:
    kinds = set(KIND_OF.values())
    assert kinds >= {"robot", "module", "fleet", "scenario", "study", "calibration"}


@pytest.mark.parametrize(
    "path",
    mostly_slow(DOCUMENTS, quick=len(FIRST_OF_KIND), slow=0),
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_a_file_of_the_present_language_is_not_changed(path: Path) -> None:
    result = upgrade_file(path, Context())
    assert not result.is_changed
    assert not result.report.errors
    assert result.after is not None
    assert result.after.data == path.read_bytes()


@pytest.mark.parametrize("mark", [b"", BYTE_ORDER_MARK])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_line_ends_and_byte_order_marks_stay(beam: Path, mark: bytes, line_end: str) -> None:
    beam.write_bytes(mark + BEAM.replace("\n", line_end).encode())
    after = upgrade_file(beam, Context()).after
    assert after is not None
    assert after.data == mark + PRESENT_BEAM.replace("\n", line_end).encode()


COMMENTS = st.lists(st.sampled_from(["", "# a: b", "    # 'x", "# ${1 * length}"]), max_size=3)
NUMBERS = st.integers(1, 10**6) | st.floats(1e-3, 1e6).map(lambda x: round(x, 3))
QUOTES = st.sampled_from(["", "'", '"'])


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_upgraded_twice_is_upgraded_once(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Only the numbers of the expressions get something, and the second time nothing changes."""
    folder = tmp_path_factory.mktemp("modules") / "frame" / "beam"
    folder.mkdir(parents=True)
    lines = []
    for line in BEAM.splitlines():
        lines += [*data.draw(COMMENTS), line]
    text = "\n".join(lines)
    quote, number = data.draw(QUOTES), data.draw(NUMBERS)
    text = text.replace("${per_metre * length}", f"{quote}${{{number} * length + 1}}{quote}")
    file = folder / "module.yaml"
    file.write_text(text, encoding="utf-8")
    first = upgrade_file(file, Context())
    assert first.after is not None
    assert not first.report.errors
    once = first.after.text
    units = (" kg/m^3", " kg/m", " kg")
    assert without(once, units) == without(text, units)
    file.write_text(once, encoding="utf-8")
    second = upgrade_file(file, Context())
    assert not second.is_changed
    assert second.after is not None
    assert second.after.text == once


def without(text: str, words: tuple[str, ...]) -> str:
    for word in words:
        text = text.replace(word, "")
    return text


# -- changes of a text --------------------------------------------------------------------------


def test_changes_that_overlap_and_changes_that_break_the_file(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("thorvaldc: 1\nname: abc\n", encoding="utf-8")
    document = read_document(file, Report())
    assert isinstance(document, Document)
    span = document.root.get("name").span  # type: ignore[union-attr]
    part = span._replace(end_column=span.column + 1)
    changed = document.changed([Fix(span, "xyz"), Fix(part, "q")])
    assert changed is not None
    assert changed.text == "thorvaldc: 1\nname: xyz\n"
    assert document.changed([Fix(span, "[")]) is None
    assert document.changed([Fix(span, "abc")]) is None


# -- the documentation --------------------------------------------------------------------------


def test_the_page_lists_every_rule() -> None:
    page = (ROOT / "docs" / "upgrade.md").read_text(encoding="utf-8")
    for rule in RULES:
        assert f"| {rule.name} |" in page
    for word in old_words.OLD_WORDS:
        assert (word.value or word.path[-1]) in page


# -- every change of the language has a rule ----------------------------------------------------

KEYS = Path(__file__).with_name("keys_of_0_1_0.txt")


def schema_words(schema: Any, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Yields the keys, kinds of quantities and allowed words of a schema, one in a line."""
    if not isinstance(schema, dict):
        return
    quantity = schema.get("x-quantity")
    kinds = " or ".join(sorted([quantity] if isinstance(quantity, str) else quantity or ()))
    yield " ".join((".".join(path), kinds)).rstrip()
    for word in schema.get("enum", ()):
        yield f"{'.'.join(path)} = {word}"
    for key, inner in schema.get("properties", {}).items():
        yield from schema_words(inner, (*path, key))
    for name in ("additionalProperties", "items"):
        yield from schema_words(schema.get(name), (*path, "*"))


def present_words() -> list[str]:
    return sorted({word for kind in KINDS for word in schema_words(inlined(kind), (kind,))})


def test_a_word_that_the_language_had_is_there_or_has_a_rule() -> None:
    """A key that is renamed or removed, and one of another quantity, needs a row of ``OLD_WORDS``.
    New keys need none; ``python -m tests.tools.upgrade.test_upgrade`` adds them to the list."""
    present = set(present_words())
    for word in KEYS.read_text(encoding="utf-8").splitlines():
        path = word.split(" ")[0].split(".")
        value = word.partition(" = ")[2]
        parents = (path[1:end] for end in range(2, len(path) + 1))  # a key goes with its mapping
        has_rule = any(any(old_words.old_keys(path[0], parent)) for parent in parents) or (
            value and old_words.old_value(path[0], path[1:], value) is not None
        )
        assert word in present or has_rule, f"`{word}` is gone: add it to OLD_WORDS"


if __name__ == "__main__":
    known = set(KEYS.read_text(encoding="utf-8").splitlines()) if KEYS.exists() else set()
    KEYS.write_text("\n".join(sorted(known | set(present_words()))) + "\n", encoding="utf-8")
