"""The table of the designs of a study: a Parquet file, written and read by DuckDB."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.scenario.scenario_reader import metric_units
from thorvaldc.compiler.source.node import Value
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics.foreign_json import read_json
from thorvaldc.tools.study.sample_points import Design, MissingPackageError
from thorvaldc.tools.study.study_definition import Objective, Study, Variable, value_key

TABLE = "designs.parquet"
DESCRIPTION = "study.json"

Row = tuple[int, str, Design, dict[str, Any]]
"""Number, key, values and result of a design."""


def load_duckdb() -> Any:
    """Returns the package duckdb.  Raises ``MissingPackageError`` if it is not installed."""
    try:
        import duckdb
    except ImportError:
        raise MissingPackageError("duckdb") from None
    return duckdb


def write_table(study: Study, rows: Sequence[Row], folder: Path) -> None:
    """Writes the table of designs and the description of its columns to a folder.

    Each file is either written completely or not changed.  Equal rows give equal bytes.
    """
    variables = {variable.name: _sql_type(variable) for variable in study.variables}
    metrics = ", ".join(f'"{name}" DOUBLE' for name in metric_units())
    columns = {
        "sample": "INTEGER",
        **dict.fromkeys(("key", "status", "code", "message"), "VARCHAR"),
        **variables,
        **{constraint.name: "DOUBLE" for constraint in study.constraints},
        **{objective.name: "DOUBLE" for objective in study.objectives},
        **{name: f"STRUCT({metrics})" for name, _ in study.scenarios},
    }
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as temporary:
        lines, table = Path(temporary) / "designs.jsonl", Path(temporary) / TABLE
        with lines.open("w", encoding="utf-8") as file:
            for row in rows:
                file.write(json.dumps(_record(study, row, variables), ensure_ascii=False) + "\n")
        with load_duckdb().connect() as connection:
            connection.execute("SET threads = 1")
            connection.execute("SET enable_progress_bar = false")
            types = ", ".join(f'"{name}" {kind}' for name, kind in columns.items())
            connection.execute(f"CREATE TABLE designs ({types})")
            fields = ", ".join(f"'{name}': '{kind}'" for name, kind in columns.items())
            connection.execute(
                "INSERT INTO designs SELECT * FROM"
                f" read_json({_text(lines)}, format = 'newline_delimited', columns = {{{fields}}})"
            )
            connection.execute(
                f"COPY (SELECT * FROM designs ORDER BY sample) TO {_text(table)} (FORMAT parquet)"
            )
        description = Path(temporary) / DESCRIPTION
        description.write_text(json.dumps(_description(study), indent=1) + "\n", encoding="utf-8")
        os.replace(description, folder / DESCRIPTION)
        os.replace(table, folder / TABLE)


def _text(path: Path) -> str:
    """Returns a path as a text of SQL."""
    return "'" + str(path).replace("'", "''") + "'"


def _record(study: Study, row: Row, types: dict[str, str]) -> dict[str, Any]:
    number, key, design, result = row
    record = {"sample": number, "key": key}
    record |= {name: result[name] for name in ("status", "code", "message")}
    for variable, value in zip(study.variables, design, strict=True):
        is_number = types[variable.name] == "DOUBLE"
        record[variable.name] = si_value(value) if is_number else _word(value)
    record |= {c.name: result["facts"].get(c.fact) for c in study.constraints}
    record |= {o.name: objective_value(o, result) for o in study.objectives}
    return record | {name: result["metrics"].get(name) for name, _ in study.scenarios}


def objective_value(objective: Objective, result: dict[str, Any]) -> float | None:
    """Returns the value of an objective from the result of a design, or ``None`` without one."""
    if objective.fact:
        value = result["facts"].get(objective.fact)
    else:
        scenario, _, metric = objective.metric.partition(".")
        value = (result["metrics"].get(scenario) or {}).get(metric)
    return None if value is None else float(value)


def si_value(value: Value) -> float | None:
    """Returns a number or quantity in SI units, and ``None`` for another value."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return float(value)
    try:
        return parse_any(str(value))
    except UnitError:
        return None


def _word(value: Value) -> str:
    return value if isinstance(value, str) else value_key(value)


def _sql_type(variable: Variable) -> str:
    has_numbers = all(si_value(value) is not None for value in variable.tested_values())
    return "DOUBLE" if has_numbers else "VARCHAR"


def _description(study: Study) -> dict[str, Any]:
    return {
        "study": study.name,
        "description": study.description,
        "method": study.samples.method,
        "variables": [variable.name for variable in study.variables],
        "constraints": [constraint.name for constraint in study.constraints],
        "scenarios": [name for name, _ in study.scenarios],
        "objectives": {
            objective.name: "maximise" if objective.maximise else "minimise"
            for objective in study.objectives
        },
    }


@dataclass(frozen=True, slots=True)
class StudyTable:
    """The table of designs in a folder.

    - ``path``: path of the Parquet file.
    - ``description``: content of ``study.json``.
    """

    path: Path
    description: dict[str, Any]

    @classmethod
    def open(cls, folder: Path) -> StudyTable:
        """Opens the table in a folder.  Raises ``OSError`` or ``ValueError`` if there is none."""
        description = read_json((folder / DESCRIPTION).read_text(encoding="utf-8"))
        parts = ("study", "variables", "constraints", "scenarios", "objectives")
        if not isinstance(description, dict) or not all(part in description for part in parts):
            raise ValueError(f"{folder / DESCRIPTION} does not describe a study")
        return cls(folder / TABLE, description)

    def query(self, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Returns the names of the columns and the rows of an SQL query.

        The table is ``designs``.  A query reads and writes no files.  Raises ``ValueError`` if the
        query has an error or the file is no table.
        """
        duckdb = load_duckdb()
        with duckdb.connect() as connection:
            try:
                connection.execute("SET enable_progress_bar = false")  # it would go to stdout
                connection.execute(
                    f"CREATE TABLE designs AS SELECT * FROM read_parquet({_text(self.path)})"
                )
                connection.execute("SET enable_external_access = false")
                result = connection.execute(sql)
                if result.description is None:
                    return [], []
                return [column[0] for column in result.description], result.fetchall()
            except duckdb.Error as error:
                raise ValueError(str(error).split("\n")[0]) from None


def front(points: Sequence[Sequence[float]]) -> list[int]:
    """Returns the indices of the points that no other point dominates.

    A point dominates another one if it is smaller in one coordinate and not greater in any.
    """
    order = sorted(range(len(points)), key=lambda index: tuple(points[index]))
    best: list[int] = []
    for index in order:
        point = points[index]
        # In lexicographic order, only an earlier point can dominate.
        if not any(
            points[other] != point
            and all(a <= b for a, b in zip(points[other], point, strict=True))
            for other in best
        ):
            best.append(index)
    return sorted(best)
