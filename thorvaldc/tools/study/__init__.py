"""Studies: many designs of one robot, compiled, compared and driven, and the best of them.

- ``study_document``, ``designs``: the study file, and the designs that it selects or searches.
- ``evaluation``: one design; many, in this process or on the workers of Dask.
- ``study``: the public class, the designs in order, and the journal of their results.
- ``study_results``, ``study_figures``: the table of designs, its best ones, and plots.
"""

from typing import TYPE_CHECKING, Any

from thorvaldc.tool_folders import CommandEntry

if TYPE_CHECKING:
    from thorvaldc.tools.study.study import Study as Study

COMMANDS = (
    CommandEntry("study", "", "Find the best designs of a robot among many."),
    CommandEntry(
        "study run", "study_commands:run_study", "Evaluate the designs of a study, or continue."
    ),
    CommandEntry("study show", "study_commands:show_study", "Show the best designs, or plots."),
    CommandEntry(
        "study best", "study_commands:write_best", "Write the robot file of the best design."
    ),
)

DOCUMENTS = {"study": "study_document:compile_study"}


def __getattr__(name: str) -> Any:
    if name != "Study":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from thorvaldc.tools.study.study import Study

    return Study
