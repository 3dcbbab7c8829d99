"""Archives with modules: good ones, hostile ones and random ones."""

from __future__ import annotations

import contextlib
import gzip
import io
import random
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from tests.slow import mostly_slow
from tests.tools.library_fetch.conftest import Vendor, plate
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.tools.library_fetch import archive_file, library_stage

FILE = "top/plate/module.yaml"
MODULE = plate().encode()


def tar(*members: tarfile.TarInfo | str, data: bytes = MODULE) -> bytes:
    """A .tar.gz file with a module and further members; a text is the path of a file."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz", format=tarfile.PAX_FORMAT) as archive:
        for member in (FILE, *members):
            info = tarfile.TarInfo(member) if isinstance(member, str) else member
            info.size = len(data) if info.isreg() else 0
            archive.addfile(info, io.BytesIO(data))
    return buffer.getvalue()


def special(kind: bytes, target: str = "/etc/passwd") -> tarfile.TarInfo:
    info = tarfile.TarInfo("special")
    info.type, info.linkname = kind, target
    return info


def packed(*members: zipfile.ZipInfo | str, data: bytes = MODULE) -> bytes:
    """A .zip file with a module and further members."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for member in (FILE, *members):
            archive.writestr(member, data)
    return buffer.getvalue()


def zip_link() -> zipfile.ZipInfo:
    info = zipfile.ZipInfo("special")
    info.external_attr = 0o120777 << 16
    return info


def encrypted() -> bytes:
    data = bytearray(packed())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + offset] |= 1
    return bytes(data)


GOOD = {"tar": tar(), "zip": packed()}
HOSTILE: dict[str, tuple[bytes, str]] = {
    "absolute path": (tar("/tmp/evil"), "which is not allowed"),
    "parent": (tar("../evil"), "which is not allowed"),
    "parent inside": (tar("top/../../evil"), "which is not allowed"),
    "backslash": (tar("..\\evil"), "which is not allowed"),
    "line break": (tar("a\nb"), "which is not allowed"),
    "git hooks": (tar("top/.GIT/config"), "in a folder `.git`"),
    "long path": (tar("a/" * 150 + "b"), "more than 200 bytes"),
    "twice": (tar(FILE), "two files at the path"),
    "file in a file": (tar(f"{FILE}/x"), "two files at the path"),
    "symbolic link": (tar(special(tarfile.SYMTYPE)), "a link or a device"),
    "hard link": (tar(special(tarfile.LNKTYPE)), "a link or a device"),
    "device": (tar(special(tarfile.CHRTYPE)), "a link or a device"),
    "pipe": (tar(special(tarfile.FIFOTYPE)), "a link or a device"),
    "sparse": (tar(special(tarfile.GNUTYPE_SPARSE)), "error[TV704]"),
    "cut": (GOOD["tar"][:-40], "it is damaged"),
    "no tar": (gzip.compress(b"x" * 5000), "it is damaged"),
    "no modules": (gzip.compress(b"\0" * 10240), "it has no modules"),
    "no archive": (b"hello", "it is no archive"),
    "empty": (b"", "it is no archive"),
    "zip absolute path": (packed("/tmp/evil"), "which is not allowed"),
    "zip parent": (packed("../evil"), "which is not allowed"),
    "zip link": (packed(zip_link()), "a link or a device"),
    "zip encrypted": (encrypted(), "is encrypted"),
    "zip cut": (GOOD["zip"][:-30], "it is damaged"),
}


@pytest.fixture
def fetch(thorvaldc: Command, vendor: Vendor) -> Callable[[bytes], str]:
    """Fetches an archive; returns the messages, and checks that nothing else was written."""

    def run(data: bytes, name: str = "agri") -> str:
        before = {path for path in Path().rglob("*") if "cache" not in path.parts}
        Path(name).write_bytes(data)
        vendor.robot(f"{{archive: {name}}}")
        called = thorvaldc("modules", "fetch", "robot.yaml")
        after = {path for path in Path().rglob("*") if "cache" not in path.parts}
        assert after - before <= {Path(name), Path("robot.lock.yaml")}
        assert all(not path.is_symlink() for path in vendor.cache.rglob("*"))
        if called.status:
            assert called.status == 1
            assert "robot.yaml:1:11: error[TV7" in called.err
            assert list(vendor.cache.glob("thorvaldc/libraries/*")) == []
        return called.err

    return run


@pytest.mark.parametrize("kind", list(GOOD))
def test_archives_become_libraries(
    kind: str, thorvaldc: Command, vendor: Vendor, fetch: Callable[[bytes], str]
) -> None:
    assert fetch(GOOD[kind]) == ""
    Path("agri").unlink()
    assert thorvaldc("check", "robot.yaml").status == 0
    (file,) = vendor.cached()
    assert file.read_bytes() == MODULE


def test_equal_files_have_one_place(vendor: Vendor, fetch: Callable[..., str]) -> None:
    for kind, data in GOOD.items():
        assert fetch(data, name=f"agri_{kind}") == ""
    assert len(vendor.cached()) == 1


@pytest.mark.parametrize("name", list(HOSTILE))
def test_hostile_archives(name: str, fetch: Callable[[bytes], str]) -> None:
    data, expected = HOSTILE[name]
    assert expected in fetch(data)


@pytest.mark.parametrize("form", [tar, packed])
def test_large_archives(
    form: Callable[..., bytes], fetch: Callable[[bytes], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library_stage, "MAX_BYTES", 1_000_000)
    assert "it is too large" in fetch(form("zeros", data=bytes(2_000_000)))
    monkeypatch.setattr(library_stage, "MAX_FILES", 10)
    assert "it is too large" in fetch(form(*(f"file{n}" for n in range(20))))
    monkeypatch.setattr(archive_file, "MAX_BYTES", 100)
    assert "it cannot be read: it has more than" in fetch(form())


def test_what_lies_outside_of_the_folder_is_bounded(
    fetch: Callable[[bytes], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A header of tar can be as long as the archive."""
    monkeypatch.setattr(archive_file, "MAX_BYTES", 100_000)
    info = tarfile.TarInfo("x")
    info.pax_headers = {"comment": "0" * 1_000_000}
    assert "it is damaged: it has too many bytes" in fetch(tar(info))


def test_a_replaced_archive_is_an_error(
    thorvaldc: Command, vendor: Vendor, fetch: Callable[[bytes], str]
) -> None:
    assert fetch(GOOD["tar"]) == ""
    for path in vendor.cached():
        path.unlink()
    Path("agri").write_bytes(tar("more"))
    called = thorvaldc("modules", "fetch", "robot.yaml")
    assert "error[TV703] library-changed: `agri`: the content has changed" in called.err
    assert thorvaldc("modules", "fetch", "--update", "robot.yaml").status == 0
    assert thorvaldc("check", "robot.yaml").status == 0


@pytest.mark.parametrize(
    ("archive", "expected"),
    [
        ("nothing.zip", "No such file"),
        ("'file:///nothing.zip'", "No such file"),
        ("'https://127.0.0.1:1/agri.zip'", "refused"),
        ("'http://127.0.0.1:1/agri.zip'", "error[TV205]"),
        ("'data:text/plain,x'", "error[TV205]"),
        ("/dev/zero", "a device"),
        (".", "Is a directory"),
    ],
)
def test_unreadable_archives(
    archive: str, expected: str, thorvaldc: Command, vendor: Vendor
) -> None:
    vendor.robot(f"{{archive: {archive}}}")
    called = thorvaldc("modules", "fetch", "robot.yaml")
    assert called.status == 1
    assert expected in called.err
    assert "robot.yaml:1:" in called.err


@pytest.mark.parametrize("first", mostly_slow(range(0, 1000, 100)))
def test_changed_archives_are_read_or_refused(
    first: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    plain = gzip.decompress(GOOD["tar"])
    for number in range(first, first + 100):
        rng = random.Random(number)
        data = bytearray((plain, GOOD["tar"], GOOD["zip"])[number % 3])
        for _ in range(rng.choice((1, 1, 2, 5))):
            data[rng.randrange(min(len(data), 600))] = rng.randrange(256)
        whole = gzip.compress(bytes(data)) if number % 3 == 0 else bytes(data)
        (tmp_path / "agri").write_bytes(whole)
        with contextlib.suppress(DiagnosticError), library_stage.new_stage("") as stage:
            archive_file.unpack("agri", tmp_path, stage)
            stage.keep()
        assert {path.name for path in tmp_path.iterdir()} == {"agri", "cache"}
