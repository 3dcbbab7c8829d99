"""`modules fetch` brings a tag of a repository into the cache, where other commands read it."""

from __future__ import annotations

import contextlib
import glob
import io
import json
import os
import re
import shutil
import threading
from pathlib import Path

import pytest
import yaml

from tests.cli.conftest import GOOD, Command
from tests.full_disk import full_disk
from tests.repository import commit_all, git
from tests.tools.library_fetch.conftest import NAME, PART, Vendor
from thorvaldc.compiler.pipeline import compile_file, load
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.diagnostics import Report
from thorvaldc.tools.language_server.module_view import ModuleView
from thorvaldc.tools.library_fetch import git_repository

LOCK = Path("robot.lock.yaml")


def pins() -> list[dict[str, str]]:
    return list(yaml.safe_load(LOCK.read_text())["libraries"])


def plate_mass() -> float:
    """Mass (kg) of the plate on the robot."""
    (link,) = (link for link in load("robot.yaml").links if link.name.startswith("plate"))
    assert link.inertial is not None
    return link.inertial.mass


def test_a_tag_is_fetched_once_and_then_used_without_the_repository(
    thorvaldc: Command, vendor: Vendor
) -> None:
    assert "TV702" in thorvaldc("check", "robot.yaml").out
    fetched = thorvaldc("modules", "fetch", "robot.yaml")
    assert (fetched.status, fetched.err) == (0, "")
    assert "vendor@v1.2: 1 module, such as top/plate" in fetched.out
    commit = git(vendor.folder, "rev-parse", "HEAD").strip()
    (pin,) = pins()
    assert {**pin, "sha256": ""} == {
        "git": vendor.url,
        "tag": "v1.2",
        "folder": "modules",
        "commit": commit,
        "sha256": "",
    }
    assert [path.name for path in vendor.cached()] == ["module.yaml"]
    shutil.rmtree(vendor.folder)
    assert thorvaldc("check", "robot.yaml").status == 0
    assert thorvaldc("build", "robot.yaml", "-o", "out").status == 0
    assert pins() == [pin], "a build keeps the pins"
    assert thorvaldc("build", "--check", "robot.yaml", "-o", "out").status == 0
    assert "is in the cache" in thorvaldc("modules", "fetch", "robot.yaml").out
    assert plate_mass() == 2.0


def test_no_output_names_the_cache(thorvaldc: Command, vendor: Vendor) -> None:
    thorvaldc("modules", "fetch", "robot.yaml")
    assert thorvaldc("build", "robot.yaml", "-o", "out").status == 0
    texts = [path.read_bytes() for path in Path("out").rglob("*") if path.is_file()]
    assert not any(str(vendor.cache).encode() in text for text in texts)
    assert "<vendor@v1.2>/top/plate/module.yaml" in compile_file("robot.yaml").sources


def test_an_error_in_a_fetched_module_has_a_readable_place(
    thorvaldc: Command, vendor: Vendor
) -> None:
    (vendor.folder / NAME).write_text("thorvaldc: 1\nmont: {}\n", encoding="utf-8")
    vendor.commit("v1.2")
    thorvaldc("modules", "fetch", "robot.yaml")
    shown = thorvaldc("check", "robot.yaml").out
    assert "robot.yaml:11:3: error[TV201] unknown-key" in shown, "the user cannot change the module"
    assert "<vendor@v1.2>/top/plate/module.yaml:2:1" in shown
    assert "2 | mont: {}" in shown, "the excerpt"


def test_a_moved_tag_is_an_error_until_the_user_accepts_it(
    thorvaldc: Command, vendor: Vendor
) -> None:
    thorvaldc("modules", "fetch", "robot.yaml")
    (old,) = pins()
    vendor.release("v1.2", 3.0)
    assert thorvaldc("check", "robot.yaml").status == 0, "the pinned content is in the cache"
    shutil.rmtree(vendor.cache)
    moved = thorvaldc("modules", "fetch", "robot.yaml")
    assert moved.status == 1
    assert "robot.yaml:1:11: error[TV703] library-changed: `vendor@v1.2`: the tag has" in moved.err
    assert (pins(), vendor.cached()) == ([old], [])
    assert thorvaldc("modules", "fetch", "--update", "robot.yaml").status == 0
    assert pins()[0]["commit"] != old["commit"]
    assert plate_mass() == 3.0


@pytest.mark.parametrize("change", ["content", "new file", "link", "removed"])
def test_a_change_in_the_cache_is_an_error(change: str, thorvaldc: Command, vendor: Vendor) -> None:
    thorvaldc("modules", "fetch", "robot.yaml")
    assert thorvaldc("check", "robot.yaml").status == 0
    (file,) = vendor.cached()
    if change == "content":
        file.chmod(0o644)
        file.write_text(file.read_text().replace("2.0 kg", "3.0 kg"))
    elif change == "new file":
        file.with_name("more.txt").touch()
    elif change == "link":
        file.with_name("link").symlink_to("/etc")
    else:
        file.unlink()
    shown = thorvaldc("check", "robot.yaml").out
    assert "robot.yaml:1:11: error[TV703]" in shown
    assert "run `thorvaldc modules fetch robot.yaml`" in shown
    assert "TV301" not in shown, "the unknown modules follow"
    assert thorvaldc("modules", "fetch", "robot.yaml").status == 0
    assert thorvaldc("check", "robot.yaml").status == 0


def test_the_library_of_a_design_is_pinned_beside_it(thorvaldc: Command, vendor: Vendor) -> None:
    Path("unit.yaml").write_text("thorvaldc: 1\nextends: robot.yaml\nname: unit\n")
    assert thorvaldc("modules", "fetch", "unit.yaml").status == 0
    assert LOCK.exists()
    assert not Path("unit.lock.yaml").exists()
    assert thorvaldc("check", "unit.yaml", "robot.yaml").status == 0
    assert thorvaldc("build", "unit.yaml", "-o", "out").status == 0


def test_fetching_keeps_the_node_ids(thorvaldc: Command, vendor: Vendor) -> None:
    text = Path("robot.yaml").read_text(encoding="utf-8").replace(", can: 4", "")
    Path("robot.yaml").write_text(text, encoding="utf-8")
    thorvaldc("modules", "fetch", "robot.yaml")
    thorvaldc("build", "robot.yaml", "-o", "out")
    before = LOCK.read_text()
    assert "rr.controller: 4" in before
    vendor.release("v1.2", 4.0)
    thorvaldc("modules", "fetch", "--update", "robot.yaml")
    after = LOCK.read_text()
    assert after != before
    assert after.partition("addresses:")[2] == before.partition("addresses:")[2]


@pytest.mark.parametrize("text", ["[", "thorvaldc_lock: 2\n", "thorvaldc_lock: 1\nlibraries: x\n"])
def test_a_broken_lock_file_is_not_replaced(text: str, thorvaldc: Command, vendor: Vendor) -> None:
    LOCK.write_text(text)
    for command in (["check"], ["modules", "fetch"]):
        called = thorvaldc(*command, "robot.yaml")
        assert called.status == 1
        assert "robot.lock.yaml:" in called.out + called.err
    assert LOCK.read_text() == text


@pytest.mark.parametrize(
    ("library", "expected"),
    [
        ('{git: "URL", tag: v1.3, folder: modules}', "it has no tag `v1.3`"),
        ('{git: "URL", tag: v1.2, folder: moduls}', "`folder: modules`"),
        ('{git: "URL/nothing", tag: v1.2}', "git fetch failed"),
        ('{git: "URL", tag: main}', "it has no tag `main`"),
        ('{git: "URL", tag: v1..2}', "it has no tag `v1..2`"),
        ('{git: "ext::touch touched", tag: v1}', "error[TV205]"),
        ('{git: "--upload-pack=touch touched", tag: v1}', "error[TV205]"),
        ('{git: "ssh://-oProxyCommand=touch%20touched/x", tag: v1}', "error[TV205]"),
        ('{git: "URL", tag: "--upload-pack=touch touched"}', "error[TV205]"),
        ('{git: "URL", tag: 1.2}', "error[TV203]"),
        ('{git: "URL"}', "error[TV202]"),
        ('{git: "URL", tag: v1, archive: x.zip}', "error[TV2"),
    ],
)
def test_what_cannot_be_fetched_has_a_line(
    library: str, expected: str, thorvaldc: Command, vendor: Vendor
) -> None:
    vendor.robot(library.replace("URL", vendor.url))
    called = thorvaldc("modules", "fetch", "robot.yaml")
    assert called.status == 1
    assert expected in called.err
    assert "robot.yaml:1:" in called.err
    assert not LOCK.exists()
    assert not Path("touched").exists()
    assert list(vendor.cache.glob("thorvaldc/libraries/*")) == []


@pytest.mark.parametrize("kind", ["link", "submodule", "lfs"])
def test_what_a_library_does_not_need_is_refused(
    kind: str, thorvaldc: Command, vendor: Vendor
) -> None:
    folder = vendor.folder / "modules"
    if kind == "link":
        (folder / "passwords").symlink_to("/etc/passwd")
    elif kind == "submodule":
        (folder / "inner").mkdir()
        commit_all(folder / "inner")
    else:
        pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0\n"
        (folder / "body.stl").write_text(pointer)
    vendor.commit("v1.2")
    refused = thorvaldc("modules", "fetch", "robot.yaml")
    assert refused.status == 1
    assert "robot.yaml:1:11: error[TV704]" in refused.err
    assert vendor.cached() == []


def test_what_is_outside_of_the_folder_does_not_matter(thorvaldc: Command, vendor: Vendor) -> None:
    (vendor.folder / "latest").symlink_to("modules")
    vendor.commit("v1.2")
    assert thorvaldc("modules", "fetch", "robot.yaml").status == 0


def test_nothing_of_the_repository_runs(
    thorvaldc: Command, vendor: Vendor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hooks of the user's template, and filters and text conversions of the repository."""
    hooks = tmp_path / "hooks"
    hooks.mkdir()
    for name in ("post-checkout", "reference-transaction", "post-merge"):
        (hooks / name).write_text("#!/bin/sh\ntouch $HOME/touched\n")
        (hooks / name).chmod(0o755)
    config = tmp_path / "config"
    config.write_text(
        f"[core]\n hooksPath = {hooks}\n autocrlf = true\n"
        '[filter "run"]\n smudge = touch touched\n clean = cat\n'
    )
    (vendor.folder / ".gitattributes").write_text("* text filter=run export-subst\n")
    vendor.commit("v1.2")
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", str(config))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert thorvaldc("modules", "fetch", "robot.yaml").status == 0
    assert not list(tmp_path.rglob("touched"))
    (file,) = vendor.cached()
    assert file.read_bytes() == (vendor.folder / NAME).read_bytes()


def test_a_tree_of_trees_ends(
    thorvaldc: Command, vendor: Vendor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten folders with ten folders each, and so on, are few objects and many files."""
    monkeypatch.setattr(git_repository, "_MAX_SIZE", 10_000_000)
    blob = git(vendor.folder, "hash-object", "-w", NAME).strip()
    tree, kind = blob, "100644 blob"
    for _ in range(7):
        listing = "".join(f"{kind} {tree}\tf{n}\n" for n in range(10))
        tree = git(vendor.folder, "mktree", text=listing).strip()
        kind = "040000 tree"
    commit = git(vendor.folder, "commit-tree", "-m", "bomb", tree).strip()
    git(vendor.folder, "tag", "--force", "v1.2", commit)
    refused = thorvaldc("modules", "fetch", "robot.yaml")
    assert refused.status == 1
    assert "error[TV704]" in refused.err


def test_git_has_limits(
    thorvaldc: Command, vendor: Vendor, monkeypatch: pytest.MonkeyPatch
) -> None:
    (vendor.folder / "noise").write_bytes(os.urandom(3_000_000))
    vendor.commit("v1.2")
    monkeypatch.setattr(git_repository, "_MAX_SIZE", 1_000_000)
    assert "git needs more than" in thorvaldc("modules", "fetch", "robot.yaml").err
    monkeypatch.setattr(git_repository, "TIMEOUT", 0.0)
    assert "git takes more than" in thorvaldc("modules", "fetch", "robot.yaml").err
    assert not LOCK.exists()


def test_a_missing_git_is_named(
    thorvaldc: Command, vendor: Vendor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    called = thorvaldc("modules", "fetch", "robot.yaml")
    assert "error[TV970] git-unavailable" in called.err
    assert "robot.yaml:1:11" in called.err


def test_a_full_disk_leaves_the_old_state(thorvaldc: Command, vendor: Vendor) -> None:
    with full_disk(100):
        called = thorvaldc("modules", "fetch", "robot.yaml")
    assert called.status in (1, 3)
    assert "robot.yaml" in called.err or "error:" in called.err
    assert not LOCK.exists()
    assert list(vendor.cache.glob("thorvaldc/libraries/*")) == []
    assert thorvaldc("modules", "fetch", "robot.yaml").status == 0


def test_an_interrupt_leaves_the_old_state(
    thorvaldc: Command, vendor: Vendor, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(git_repository, "_size", interrupt)
    assert thorvaldc("modules", "fetch", "robot.yaml").status == 130
    assert not LOCK.exists()
    assert list(vendor.cache.glob("thorvaldc/libraries/*")) == []


def test_two_robots_fetch_at_once(thorvaldc: Command, vendor: Vendor) -> None:
    from thorvaldc.cli.diagnostic_output import DiagnosticOutput
    from thorvaldc.tools.library_fetch.fetch_command import fetch_libraries

    names = [f"robot{number}.yaml" for number in range(4)]
    for name in names:
        shutil.copy("robot.yaml", name)
    errors: list[int] = []

    def run(name: str) -> None:
        output = DiagnosticOutput("json", io.StringIO())
        fetch_libraries(Path(name), False, output)
        errors.append(len(output._all.errors))

    threads = [threading.Thread(target=run, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == [0] * len(names)
    assert thorvaldc("check", *names).status == 0
    assert len(vendor.cached()) == 1


def test_a_fleet_names_robots_with_libraries(thorvaldc: Command, vendor: Vendor) -> None:
    robots = "{a: {robot: robot.yaml}, b: {robot: good.yaml, xyz: [0, 5 m, 0]}}"
    Path("fleet.yaml").write_text(f"thorvaldc: 1\nname: f\nrobots: {robots}\n")
    assert thorvaldc("modules", "fetch", "fleet.yaml").status == 0
    assert thorvaldc("check", "fleet.yaml").status == 0
    assert len(pins()) == 1


def test_files_without_libraries(thorvaldc: Command, vendor: Vendor) -> None:
    called = thorvaldc("modules", "fetch", "good.yaml")
    assert (called.status, called.out) == (0, "no robot names a repository or an archive\n")
    assert "file-not-found" in thorvaldc("modules", "fetch", "nothing.yaml").err
    assert thorvaldc("modules", "fetch", "nothing.yaml").status == 1


def test_modules_list_shows_origin_and_version(thorvaldc: Command, vendor: Vendor) -> None:
    assert "TV702" in thorvaldc("modules", "list", "robot.yaml").err
    thorvaldc("modules", "fetch", "robot.yaml")
    (pin,) = pins()
    shown = thorvaldc("modules", "list", "robot.yaml").out
    assert "<vendor@v1.2>: A plate of the vendor." in shown
    assert f"\n<vendor@v1.2>  {vendor.url}, commit {pin['commit'][:12]}\n" in shown
    listed = json.loads(thorvaldc("modules", "list", "robot.yaml", "--json").out)
    by_type = {module["type"]: module for module in listed}
    assert by_type["top/plate"]["library"] == "<vendor@v1.2>"
    assert by_type["top/plate"]["origin"] == pin
    assert by_type["drive/standard"]["library"] == "<library>"
    assert "origin" not in by_type["drive/standard"]
    fetched = json.loads(thorvaldc("modules", "fetch", "--json", "robot.yaml").out)
    assert fetched["libraries"] == [pin]


def test_modules_of_a_fetched_library_are_shown_and_checked(
    thorvaldc: Command, vendor: Vendor
) -> None:
    assert "TV702" in thorvaldc("modules", "show", "top/plate", "robot.yaml").err
    assert thorvaldc("modules", "check", "robot.yaml").status == 1
    thorvaldc("modules", "fetch", "robot.yaml")
    shown = thorvaldc("modules", "show", "top/plate", "robot.yaml")
    assert "A plate of the vendor." in shown.out
    assert "2 kg" in shown.out
    assert thorvaldc("modules", "show", "top/plate").status == 2
    checked = thorvaldc("modules", "check", "robot.yaml")
    assert (checked.status, checked.out) == (0, "robot.yaml: 1 module\n")
    (vendor.folder / NAME).write_text("thorvaldc: 1\nmont: {}\n", encoding="utf-8")
    vendor.commit("v1.2")
    shutil.rmtree(vendor.cache)
    thorvaldc("modules", "fetch", "--update", "robot.yaml")
    checked = thorvaldc("modules", "check", "robot.yaml")
    assert checked.status == 1
    assert "<vendor@v1.2>/top/plate/module.yaml:2:1: error[TV201]" in checked.out


def test_the_source_of_a_number_has_a_readable_place(thorvaldc: Command, vendor: Vendor) -> None:
    thorvaldc("modules", "fetch", "robot.yaml")
    shown = thorvaldc("why", "robot.yaml", "links.plate_body.inertial.mass").out
    assert "  <vendor@v1.2>/top/plate/module.yaml:7:" in shown
    assert str(vendor.cache) not in shown


def test_an_editor_reads_fetched_modules(thorvaldc: Command, vendor: Vendor) -> None:
    thorvaldc("modules", "fetch", "robot.yaml")
    for path in (Path("robot.yaml"), Path("robot.yaml").resolve()):
        tree = read_file(path, path.name, Report())
        assert "top/plate" in ModuleView("robot", path, tree, ()).library.names()


def test_a_new_project_is_a_library_for_others(thorvaldc: Command, vendor: Vendor) -> None:
    """The template of a repository: made, checked as in its CI, tagged, fetched and built."""
    assert thorvaldc("new", "farm", "--project").status == 0
    with contextlib.chdir("farm"):
        script = yaml.safe_load(Path(".gitlab-ci.yml").read_text())["check"]["script"]
        for line in script[1:4]:
            words = [path for word in line.split()[1:] for path in glob.glob(word) or [word]]
            assert thorvaldc(*words).status == 0, line
    commit_all(Path("farm"))
    git(Path("farm"), "tag", "v1.0")
    readme = Path("farm/README.md").read_text()
    (entry,) = re.findall(r"`library: \[(.*)\]`", readme)
    vendor.robot(entry.replace("https://...", Path("farm").resolve().as_uri()))
    assert thorvaldc("modules", "fetch", "robot.yaml").status == 0
    assert thorvaldc("build", "robot.yaml", "-o", "out").status == 0
    assert plate_mass() == 2.0


def test_the_first_library_of_the_list_has_precedence(thorvaldc: Command, vendor: Vendor) -> None:
    own = Path("own/top/plate/module.yaml")
    own.parent.mkdir(parents=True)
    own.write_text((vendor.folder / NAME).read_text().replace("2.0 kg", "7.0 kg"))
    thorvaldc("modules", "fetch", "robot.yaml")
    entry = Path("robot.yaml").read_text().splitlines()[0]
    for library, mass in (
        (entry.replace("[", "[own, "), 7.0),
        (entry.replace("}]", "}, own]"), 2.0),
    ):
        Path("robot.yaml").write_text(f"{library}\n{GOOD}{PART}", encoding="utf-8")
        assert plate_mass() == mass
