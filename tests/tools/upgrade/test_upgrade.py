"""``thorvaldc upgrade``: every rule through the command, and what it does to files."""

from __future__ import annotations

import json
import os
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
from thorvaldc.diagnostics import Fix, Report
from thorvaldc.schema import KINDS, inlined, old_words
from thorvaldc.schema.old_words import OldWord
from thorvaldc.tools.upgrade.document import BYTE_ORDER_MARK, Document
from thorvaldc.tools.upgrade.file_upgrade import read_document, upgrade_file

ROOT = Path(__file__).resolve().parents[3]
STATED = GOOD.replace("name: good", "name: good\ndriver: {homing: on_arming, arming: required}")

OLD = STATED.replace("arming: required", "'timeout': 1 s,  arming: never")
PRESENT = OLD.replace("'timeout'", "command_timeout").replace("never", "automatic")
"""A file with the words of ``renamed``, and what it becomes."""


@pytest.fixture
def renamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that the language never had, in place of a word that gets a new name later."""
    words = (
        OldWord(("robot",), ("driver", "timeout"), new="command_timeout"),
        OldWord(("robot",), ("driver", "arming"), new="automatic", value="never"),
    )
    monkeypatch.setattr(old_words, "OLD_WORDS", (*old_words.OLD_WORDS, *words))


@pytest.fixture
def old(tmp_path: Path, renamed: None) -> Path:
    file = tmp_path / "robots" / "robot.yaml"
    file.parent.mkdir()
    file.write_text(OLD, encoding="utf-8")
    return file


# -- decisions ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "place", "message", "stated"),
    [
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


def test_decisions_of_many_files_are_one_message(thorvaldc: Command) -> None:
    for number in range(5):
        Path(f"r{number}.yaml").write_text(STATED + "base_calculator: random_pairs\n", "utf-8")
    result = thorvaldc("upgrade", *(f"r{number}.yaml" for number in range(5)))
    assert result.err.count("note[TV976]") == 1
    assert "(5 places)" in result.err


# -- words that have a new name -----------------------------------------------------------------


def test_a_renamed_word_is_written(thorvaldc: Command, old: Path) -> None:
    result = thorvaldc("check", str(old))
    assert "`driver` has no key `timeout`" in result.out
    assert "it is `command_timeout` now; `thorvaldc upgrade FILE` writes it" in result.out
    assert thorvaldc("upgrade", str(old)).out == f"{old}: upgraded: 2 changes\n"
    assert old.read_text(encoding="utf-8") == PRESENT
    assert thorvaldc("check", str(old)).status == 0
    result = thorvaldc("upgrade", str(old))
    assert (result.status, result.out) == (0, f"{old}: nothing to change\n")


def test_a_word_beside_its_new_name_is_a_decision(thorvaldc: Command, renamed: None) -> None:
    text = STATED.replace("arming:", "timeout: 1 s, command_timeout: 2 s, arming:")
    Path("robot.yaml").write_text(text, encoding="utf-8")
    result = thorvaldc("upgrade", "robot.yaml")
    assert "keep one of `timeout` and `command_timeout`" in result.err
    assert Path("robot.yaml").read_text(encoding="utf-8") == text


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


def test_a_dry_run_shows_the_difference(thorvaldc: Command, old: Path) -> None:
    result = thorvaldc("upgrade", "--dry-run", str(old))
    assert result.status == 1
    assert result.out.startswith(f"--- {old}\n+++ {old}\n@@")
    assert "arming: never" in result.out
    assert "arming: automatic" in result.out
    assert result.err == f"{old}: would be upgraded: 2 changes\n"
    assert old.read_text(encoding="utf-8") == OLD
    old.write_text(PRESENT, encoding="utf-8")
    result = thorvaldc("upgrade", "--dry-run", str(old))
    assert (result.status, result.out) == (0, "")


def test_the_result_as_json(thorvaldc: Command, old: Path) -> None:
    output = json.loads(thorvaldc("upgrade", "--dry-run", "--json", str(old)).out)
    (upgraded,) = output["upgrades"]
    assert upgraded["file"] == str(old)
    assert upgraded["changes"] == 2
    assert upgraded["difference"].startswith(f"--- {old}\n+++ {old}\n@@")
    assert not upgraded["written"]
    assert old.read_text(encoding="utf-8") == OLD
    Path("robot.yaml").write_text(GOOD + "base_calculator: random_pairs\n", encoding="utf-8")
    output = json.loads(thorvaldc("upgrade", "--json", str(old), "robot.yaml").out)
    assert [upgraded["difference"] for upgraded in output["upgrades"]] == ["", ""]
    assert [upgraded["written"] for upgraded in output["upgrades"]] == [True, False]
    assert {d["code"] for d in output["diagnostics"]} == {"TV976"}
    assert old.read_text(encoding="utf-8") == PRESENT


def test_a_dry_run_is_a_patch(
    thorvaldc: Command, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old.write_text(OLD.rstrip("\n"), encoding="utf-8")
    monkeypatch.chdir(old.parent)
    patch = thorvaldc("upgrade", "--dry-run", "robot.yaml").out
    subprocess.run(["git", "apply", "-p0"], input=patch, text=True, check=True)
    assert old.read_text(encoding="utf-8") == PRESENT.rstrip("\n")


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


def test_a_link_stays_a_link(thorvaldc: Command, old: Path, tmp_path: Path) -> None:
    link = old.parents[1] / "linked" / "robot.yaml"
    link.parent.mkdir(parents=True)
    link.symlink_to(old)
    assert thorvaldc("upgrade", str(link)).status == 0
    assert link.is_symlink()
    assert old.read_text(encoding="utf-8") == PRESENT


def test_a_full_disk_leaves_the_file(thorvaldc: Command, old: Path) -> None:
    Path("good.yaml").write_text(STATED, encoding="utf-8")
    with full_disk(100):
        result = thorvaldc("upgrade", str(old), "good.yaml")
    assert result.status == 3
    assert f"error: {old}: File too large; it is unchanged\n" in result.err
    assert result.out == "good.yaml: nothing to change\n"
    with full_disk(100):
        result = thorvaldc("upgrade", "--json", str(old))
    assert result.status == 3
    assert [upgraded["written"] for upgraded in json.loads(result.out)["upgrades"]] == [False]
    assert old.read_text(encoding="utf-8") == OLD
    assert [path.name for path in old.parent.iterdir()] == ["robot.yaml"]


def test_ctrl_c_while_a_file_is_written_leaves_it(
    thorvaldc: Command, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(new: Path, old: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert thorvaldc("upgrade", str(old)).status == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert old.read_text(encoding="utf-8") == OLD
    assert [path.name for path in old.parent.iterdir()] == ["robot.yaml"]


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write every file")
def test_a_file_that_must_not_be_written(thorvaldc: Command, old: Path) -> None:
    old.chmod(0o444)
    result = thorvaldc("upgrade", str(old))
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
    result = upgrade_file(path)
    assert not result.is_changed
    assert not result.report.errors
    assert result.after is not None
    assert result.after.data == path.read_bytes()


@pytest.mark.parametrize("mark", [b"", BYTE_ORDER_MARK])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_line_ends_and_byte_order_marks_stay(old: Path, mark: bytes, line_end: str) -> None:
    old.write_bytes(mark + OLD.replace("\n", line_end).encode())
    after = upgrade_file(old).after
    assert after is not None
    assert after.data == mark + PRESENT.replace("\n", line_end).encode()


COMMENTS = st.lists(st.sampled_from(["", "# a: b", "    # 'x", "# never"]), max_size=3)
QUOTES = st.sampled_from(["", "'", '"'])


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_upgraded_twice_is_upgraded_once(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Only the words change, and the second time nothing does."""
    words = (OldWord(("robot",), ("driver", "timeout"), new="command_timeout"),)
    lines = []
    for line in OLD.splitlines():
        lines += [*data.draw(COMMENTS), line]
    quote = data.draw(QUOTES)
    text = "\n".join(lines).replace("'timeout'", f"{quote}timeout{quote}")
    file = tmp_path_factory.mktemp("robots") / "robot.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(old_words, "OLD_WORDS", words)
        first = upgrade_file(file)
        assert first.after is not None
        assert not first.report.errors
        once = first.after.text
        assert once == text.replace(f"{quote}timeout{quote}", "command_timeout")
        file.write_text(once, encoding="utf-8")
        second = upgrade_file(file)
    assert not second.is_changed
    assert second.after is not None
    assert second.after.text == once


# -- changes of a text --------------------------------------------------------------------------


def test_changes_of_an_alias_and_changes_that_break_the_file(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("thorvaldc: 1\nname: abc\n", encoding="utf-8")
    document = read_document(file, Report())
    assert isinstance(document, Document)
    span = document.root.get("name").span  # type: ignore[union-attr]
    changed = document.changed([Fix(span, "xyz"), Fix(span, "xyz")])
    assert changed is not None
    assert changed.text == "thorvaldc: 1\nname: xyz\n"
    assert document.changed([Fix(span, "[")]) is None


# -- the documentation --------------------------------------------------------------------------


def test_the_page_lists_every_word() -> None:
    page = (ROOT / "docs" / "upgrade.md").read_text(encoding="utf-8")
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
