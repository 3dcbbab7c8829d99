"""Runs studies: samples designs, evaluates each design, keeps the results.

- ``study_compilation``, ``study_definition``: the study file.
- ``study_execution``: the designs in order, in processes or on a cluster.
- ``study_journal``, ``study_table``: the results on the disk, and as a table.
- ``study_report``: the results as a web page.
"""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("study", "", "Find the best designs of a robot among many."),
    CommandEntry(
        "study run", "run_command:run_study", "Evaluate the designs of a study, or continue."
    ),
    CommandEntry("study show", "show_command:show_study", "Show the best designs, or ask in SQL."),
    CommandEntry("study report", "report_command:write_report", "Write the results as a web page."),
    CommandEntry(
        "study best", "best_command:write_best", "Write the robot file of the best design."
    ),
)

DOCUMENTS = {"study": "study_compilation:compile_study"}
