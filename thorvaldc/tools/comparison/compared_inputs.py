"""Reads the inputs of a comparison: robot files, fleet files, builds and git revisions."""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import DiagnosticError, Label, Report, Span, did_you_mean
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import is_model_file, load_model

# The tree of a git revision is written to a temporary folder, without a change of the working tree
# or the index, so that the compiler reads the robot file of the revision with the modules, extras,
# meshes and calibration of the same revision.

MOST_FILES = 50_000
MOST_BYTES = 1_000_000_000
TIMEOUT = 60.0  # s, for each call of git
# Environment variables with which git would use another repository or index.
_VARIABLES = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_PREFIX", "GIT_COMMON_DIR")


@dataclass(frozen=True)
class RevisionFile:
    """A file of a git revision in a temporary folder.

    Attributes
    ----------
    path : path of the file in the temporary folder.
    root : the temporary folder with the whole tree of the revision.
    repository : top folder of the repository.
    name : path of the file in the repository.
    """

    path: Path
    root: Path
    repository: Path
    name: str


def split_revision(text: str) -> tuple[str, str] | None:
    """Returns the revision and the path of a text such as ``HEAD~1:robot.yaml``.

    Returns ``None`` if the text is the name of an existing file, or has no colon.
    """
    revision, colon, path = text.partition(":")
    if not colon or os.path.exists(text):
        return None
    return revision, path


@contextmanager
def exported_revision(revision: str, path: str, folder: Path) -> Iterator[RevisionFile]:
    """Writes the tree of a revision to a temporary folder, which is removed afterwards.

    ``path``: path from the top folder of the repository, as in git; if there is no such file, from
    ``folder``.  ``folder``: a folder of the repository.  Raises ``DiagnosticError`` if git, the
    repository, the revision or the file does not exist, or if the tree is too large.
    """
    repository = Path(_git(folder, "rev-parse", "--show-toplevel", code="git-unavailable"))
    commit = _commit(folder, revision)
    listing = _git(repository, "ls-tree", "-r", "-l", "-z", "--full-tree", commit)
    name = _name_in_tree(listing, revision, path, folder, repository)
    with tempfile.TemporaryDirectory(prefix="thorvaldc-revision-") as temporary:
        root = Path(temporary).resolve() / "tree"
        root.mkdir()
        # A second index lets git write the tree as in a checkout, and leaves the index as it is.
        index = {"GIT_INDEX_FILE": str(Path(temporary) / "index")}
        _git(repository, "read-tree", commit, variables=index)
        _git(repository, "checkout-index", "-a", "-f", f"--prefix={root}/", variables=index)
        yield RevisionFile(root / name, root, repository, name)


def is_revision(text: str, folder: Path) -> bool:
    """Returns whether a text names a commit of the repository of a folder, such as ``HEAD``."""
    try:
        return bool(text) and bool(_commit(folder, text))
    except DiagnosticError:
        return False


def _commit(folder: Path, revision: str) -> str:
    """Returns the hash of a revision."""
    try:
        return _git(
            folder, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}"
        )
    except DiagnosticError as error:
        if error.diagnostic.code.name != "git-failed":
            raise
    try:
        names = _git(folder, "for-each-ref", "--format=%(refname:short)", "--count=1000")
    except DiagnosticError:
        names = ""
    hint = did_you_mean(revision, ["HEAD", *names.split()], "`git log --oneline` shows revisions")
    raise DiagnosticError(
        "git-revision-unknown", f"the repository has no revision `{revision}`", hint=hint
    )


def _name_in_tree(listing: str, revision: str, path: str, folder: Path, repository: Path) -> str:
    """Returns the path of a file in the tree of a revision."""
    size_of: dict[str, int] = {}
    for entry in filter(None, listing.split("\0")):
        head, _, name = entry.partition("\t")
        size = head.split()[-1]
        size_of[name] = int(size) if size.isdigit() else 0
    below = os.path.relpath(folder.resolve(), repository.resolve())
    relative = os.path.normpath(os.path.join(below, path)).replace(os.sep, "/")
    candidates = (
        [relative] if path.startswith(("./", "../")) else [os.path.normpath(path), relative]
    )
    matching_name = next((name for name in candidates if name in size_of), None)
    if matching_name is None:
        raise DiagnosticError(
            "git-file-missing",
            f"the revision `{revision}` has no file `{path}`",
            hint=did_you_mean(path, size_of, "the path starts at the top folder of the repository"),
        )
    sizes = list(size_of.values())
    if len(sizes) > MOST_FILES or sum(sizes) > MOST_BYTES:
        raise DiagnosticError(
            "git-failed",
            f"the revision `{revision}` has {len(sizes)} files with"
            f" {sum(sizes) / 1e6:.0f} MB; at most {MOST_FILES} files with"
            f" {MOST_BYTES / 1e6:.0f} MB are read",
            hint=f"check it out: git worktree add ../before {revision}; then compare the files",
        )
    return matching_name


def _git(
    folder: Path, *arguments: str, variables: dict[str, str] | None = None, code: str = "git-failed"
) -> str:
    """Calls git and returns its output without the line break at the end.

    Raises ``DiagnosticError`` if git cannot be called or fails.
    """
    environment = {key: value for key, value in os.environ.items() if key not in _VARIABLES}
    # git asks no questions and writes no lock files for optional work.
    environment.update(GIT_TERMINAL_PROMPT="0", GIT_OPTIONAL_LOCKS="0", LC_ALL="C")
    environment.update(variables or {})
    try:
        result = subprocess.run(
            ["git", "-c", "core.quotePath=false", *arguments],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=TIMEOUT,
            check=False,
        )
    except FileNotFoundError:
        raise DiagnosticError(
            "git-unavailable",
            "the program git is not installed",
            hint="install git, or compare two files",
        ) from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DiagnosticError("git-failed", f"git {arguments[0]} failed: {error}") from None
    if result.returncode == 0:
        return result.stdout.decode("utf-8", "surrogateescape").rstrip("\n")
    lines = result.stderr.decode("utf-8", "replace").strip().splitlines()
    reason = (lines[0] if lines else f"exit status {result.returncode}").removeprefix("fatal: ")
    if "not a git repository" in reason:
        raise DiagnosticError(
            "git-unavailable",
            f"{folder.resolve()} is not in a git repository",
            hint="call the command in a folder of the repository",
        )
    raise DiagnosticError(code, f"git {arguments[0]} failed: {reason}")


MAX_MESH_BYTES = 64_000_000


def read_input(
    name: str, temporary: ExitStack, library: Sequence[Path] = (), *, trust: bool = False
) -> Compilation:
    """Reads one input of a comparison, and returns it with its diagnostics.

    ``name``: a robot file, a fleet file, a build folder, a ``model.json`` or a file of a git
    revision such as ``HEAD~1:robot.yaml``.  ``temporary``: the files of a revision are removed when
    this stack is closed; until then, excerpts of them can be shown.  ``library``: additional
    folders with modules.
    """
    try:
        revision = split_revision(name)
        if revision is None:
            return _read(Path(name), library, trust)
        file = temporary.enter_context(exported_revision(*revision, Path.cwd()))
        inside = [_in_revision(each, file.repository, file.root) for each in library]
        compared = _read(file.path, inside, trust)
        _rename_files(compared, file.root, f"{revision[0]}:")
    except DiagnosticError as error:
        compared = Compilation()
        compared.report.put(error.diagnostic)
    return compared


def revision_hint(before: str, after: str) -> str | None:
    """Returns the hint if one input is a git revision without the file, such as ``HEAD``."""
    for revision, file in ((before, after), (after, before)):
        if os.path.exists(revision) or not os.path.isfile(file):
            continue
        if is_revision(revision, Path.cwd()):
            path = Path(file).as_posix()
            return f"write `{revision}:{path}` for the file in the revision `{revision}`"
    return None


def _read(path: Path, library: Sequence[Path], trust: bool) -> Compilation:
    if path.is_dir() or is_model_file(path) or path.suffix == ".json":
        folder = path if path.is_dir() else path.parent
        return Compilation(_with_meshes(load_model(path), folder / "meshes"))
    return compile_file(path, library=library, trust=trust)


def _with_meshes(model: Robot | Fleet, folder: Path) -> Robot | Fleet:
    """Returns the model of a build with the bytes of its mesh files, as far as they are there."""
    if isinstance(model, Fleet):
        placements = (
            replace(p, robot=_robot_with_meshes(p.robot, folder)) for p in model.placements
        )
        return replace(model, placements=tuple(placements))
    return _robot_with_meshes(model, folder)


def _robot_with_meshes(robot: Robot, folder: Path) -> Robot:
    meshes = []
    for mesh in robot.meshes:
        data = b""
        with contextlib.suppress(OSError):
            # A name of a mesh is not a path: nothing outside of the folder is read.
            data = read_bounded(folder / Path(mesh.name).name, MAX_MESH_BYTES)
        is_same = hashlib.sha256(data).hexdigest() == mesh.sha256
        meshes.append(replace(mesh, data=data if is_same else b""))
    return replace(robot, meshes=tuple(meshes))


def _in_revision(folder: Path, repository: Path, root: Path) -> Path:
    """Returns the folder of the revision for a library folder of the repository."""
    try:
        inside = root / folder.resolve().relative_to(repository.resolve())
    except ValueError:
        return folder
    return inside if inside.is_dir() else folder


def _rename_files(compared: Compilation, root: Path, prefix: str) -> None:
    """Replaces paths of the temporary folder by the names of the files in the revision."""

    def named(path: str) -> str:
        return path.replace(f"{root}{os.sep}", prefix).replace(str(root), prefix)

    def at(span: Span) -> Span:
        return Span(named(span.file), *span[1:])

    report = Report()
    for diagnostic in compared.report:
        report.put(
            replace(
                diagnostic,
                message=named(diagnostic.message),
                span=at(diagnostic.span) if diagnostic.span is not None else None,
                labels=tuple(Label(at(label.span), label.text) for label in diagnostic.labels),
                # A file of a revision cannot be changed.
                fixes=(),
            )
        )
    compared.report = report
    compared.sources = {named(name): path for name, path in compared.sources.items()}
