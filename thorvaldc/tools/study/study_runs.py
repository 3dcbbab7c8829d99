"""What the commands ``thorvaldc study`` have in common: the study and the folder of its results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import typer

from thorvaldc.cli.compiling import compile_and_show
from thorvaldc.cli.diagnostic_output import message
from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.options import library_folders
from thorvaldc.tools.study.design_evaluation import StudyInputs
from thorvaldc.tools.study.sample_points import MissingPackageError
from thorvaldc.tools.study.study_definition import Study
from thorvaldc.tools.study.study_execution import StudyRun

if TYPE_CHECKING:
    from thorvaldc.tools.study.dask_cluster import DaskCluster

RESULTS = Path("study")


def results_folder(name: str, output: str) -> Path:
    """Returns the folder with the results of a study: ``output``, or ``study/NAME``."""
    return Path(output) if output else RESULTS / name


def plan_study(file: str, library: Sequence[str], trust: bool) -> StudyRun | None:
    """Compiles a study file and selects its designs.

    Prints the errors of the study file and returns ``None`` if it has any.  Raises
    ``typer.BadParameter`` if the file is no study.
    """
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return None
    study = compilation.tool_document
    if not isinstance(study, Study):
        raise typer.BadParameter(f"{file} is no study", param_hint="'STUDY'")
    text = study.robot.read_text(encoding="utf-8")
    inputs = StudyInputs(study, text, tuple(library_folders(library)), trust)
    inputs = replace(inputs, files=tuple(compilation.files.values()))
    try:
        return StudyRun(inputs)
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None


def parse_scheduler(text: str) -> str:
    """Returns the address of a Dask scheduler, or an empty text without one.

    Raises ``typer.BadParameter`` unless it is ``tcp://HOST:PORT`` or ``tls://HOST:PORT``, and
    ``OutsideError`` if Dask is not installed.
    """
    if not text:
        return ""
    try:
        parts = urlsplit(text)
        if parts.scheme in ("tcp", "tls") and parts.hostname and parts.port and not parts.path:
            _check_cluster_packages()
            return text
    except ValueError:  # of the port
        pass
    raise typer.BadParameter(
        f"{text} is no address such as tcp://host:8786", param_hint="'--scheduler'"
    )


def _check_cluster_packages() -> None:
    from thorvaldc.tools.study.dask_cluster import ClusterError, load_distributed

    try:
        load_distributed()
    except ClusterError as error:
        raise OutsideError(str(error)) from None


@contextmanager
def open_cluster(address: str, run: StudyRun) -> Iterator[DaskCluster | None]:
    """Opens the Dask cluster of an address, or none without an address.

    Raises ``OutsideError`` if the cluster cannot evaluate the study.
    """
    if not address:
        yield None
        return
    # Dask is imported only for a study on a cluster.
    from thorvaldc.tools.study.dask_cluster import ClusterError, DaskCluster

    try:
        with DaskCluster(address, run.inputs.files, message) as cluster:
            yield cluster
    except ClusterError as error:
        raise OutsideError(str(error)) from None
