"""Runs studies: samples designs, evaluates each design, keeps the results.

- ``study_compilation``, ``study_definition``: the study file.
- ``study_execution``: the designs in order, in processes or on a cluster.
- ``study_journal``, ``study_table``: the results on the disk, and as a table.
- ``study_report``: the results as a web page.
"""

DOCUMENTS = {"study": "study_compilation:compile_study"}
