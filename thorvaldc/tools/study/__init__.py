"""Runs studies: samples designs, evaluates each design, keeps the results.

- ``study_definition``, ``study_compilation``: the study file and the designs that it selects.
- ``design_evaluation``, ``dask_cluster``: one design; many, in processes or on a cluster.
- ``study_run``: the designs in order, and the journal of their results.
- ``study_results``, ``study_report``: the results as a table and as a web page.
"""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("study", "", "Find the best designs of a robot among many."),
    CommandEntry(
        "study run", "study_commands:run_study", "Evaluate the designs of a study, or continue."
    ),
    CommandEntry(
        "study show", "study_commands:show_study", "Show the best designs, or ask in SQL."
    ),
    CommandEntry("study report", "study_commands:write_report", "Write the results as a web page."),
    CommandEntry(
        "study best", "study_commands:write_best", "Write the robot file of the best design."
    ),
)

DOCUMENTS = {"study": "study_compilation:compile_study"}
