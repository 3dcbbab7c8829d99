"""The results of a study: the table of designs, its best designs, and what the variables matter.

The table is a Parquet file, written and read by DuckDB.  Here it is shown as text; the web page is
in ``study_report``.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.scenario.scenario_compilation import metric_units
from thorvaldc.compiler.source.node import Value
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_unit
from thorvaldc.diagnostics.files import read_json
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model import quantities as si
from thorvaldc.model.facts.robot_facts import fact_quantity
from thorvaldc.tools.study import study_definition as definition
from thorvaldc.tools.study.study_definition import Design, Study, Variable

RESULTS = Path("study")
TABLE = "designs.parquet"
DESCRIPTION = "study.json"

Row = tuple[int, str, Design, dict[str, Any]]
"""Number, key, values and result of a design."""


def results_folder(name: str, output: str) -> Path:
    """Returns the folder with the results of a study: ``output``, or ``study/NAME``."""
    return Path(output) if output else RESULTS / name


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
        with definition.required("duckdb").connect() as connection:
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
    record |= {o.name: o.value_of(result) for o in study.objectives}
    return record | {name: result["metrics"].get(name) for name, _ in study.scenarios}


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
    return value if isinstance(value, str) else definition.value_key(value)


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
        "objectives": {objective.name: objective.goal for objective in study.objectives},
    }


@dataclass(frozen=True, slots=True)
class StatusCount:
    """Number of the designs with a status and a code, and the first of them with its message."""

    status: str
    code: str
    count: int
    sample: int
    message: str


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

    def designs(self) -> list[dict[str, Any]]:
        """Returns the rows of the table in the order of the designs."""
        names, rows = self.query("SELECT * FROM designs ORDER BY sample")
        return [dict(zip(names, row, strict=True)) for row in rows]

    def counts(self, condition: str = "true") -> list[StatusCount]:
        """Returns the statuses and codes of the designs with a condition in SQL.

        They are in the order of their first designs.
        """
        _, rows = self.query(
            "SELECT status, code, count(*), min(sample), arg_min(message, sample) FROM designs"
            f" WHERE {condition} GROUP BY status, code ORDER BY 4"
        )
        return [StatusCount(*row) for row in rows]

    def query(self, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Returns the names of the columns and the rows of an SQL query.

        The table is ``designs``.  A query reads and writes no files.  Raises ``ValueError`` if the
        query has an error or the file is no table.
        """
        duckdb = definition.required("duckdb")
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


@dataclass(frozen=True, slots=True)
class Column:
    """A variable, constraint or objective.

    - ``kind``: ``variable``, ``constraint`` or ``objective``.
    - ``unit``: SI unit, or empty if it is unknown or 1.
    - ``goal``: ``minimise``, ``maximise``, or empty.
    """

    name: str
    kind: str
    unit: str
    goal: str = ""

    @property
    def title(self) -> str:
        """The name with the unit, such as ``energy (J)``."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


def columns_of(study: Study) -> list[Column]:
    """Returns the columns of the variables, constraints and objectives of a study."""
    columns = [Column(v.name, "variable", variable_unit(v)) for v in study.variables]
    columns += [Column(c.name, "constraint", fact_quantity(c.fact).unit) for c in study.constraints]
    return columns + objective_columns(study)


def objective_columns(study: Study) -> list[Column]:
    """Returns the columns of the objectives of a study."""
    columns = []
    for objective in study.objectives:
        metric = objective.metric.rpartition(".")[2]
        unit = fact_quantity(objective.fact).unit if objective.fact else metric_units()[metric]
        columns.append(Column(objective.name, "objective", unit, objective.goal))
    return columns


def variable_unit(variable: Variable) -> str:
    """Returns the SI unit of the values of a variable, or an empty text."""
    unit = variable.unit
    if variable.choices:
        units = {str(choice).lstrip("+-.0123456789eE").strip() for choice in variable.choices}
        unit = units.pop() if len(units) == 1 else ""
    try:
        dimension = parse_unit(unit).dimension if unit else ()
    except UnitError:
        return ""
    for quantity in QUANTITIES.values():
        if dimension == quantity.dimensions[0]:
            return si.unit_of(quantity.name)
    return ""


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


LEAST_SAMPLES = 16
"""Least number of complete base samples for indices."""
CONFIDENCE = 0.95
RESAMPLES = 500
"""Number of bootstrap resamples for the intervals."""

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SobolIndex:
    """Share of the variance of an objective that one variable causes.

    - ``first_order``: share that the variable causes alone.
    - ``total``: share that it causes alone and together with other variables.  A variable with 0
      does not matter.
    - ``first_order_interval``, ``total_interval``: bootstrap intervals of 95 % confidence.
    """

    variable: str
    first_order: float
    first_order_interval: Interval
    total: float
    total_interval: Interval


@dataclass(frozen=True, slots=True)
class ObjectiveSensitivity:
    """Indices of all variables for an objective.

    - ``samples``: number of base samples that were used, a power of two.
    - ``incomplete``: number of base samples of which a design has no value.
    - ``indices``: empty if there are too few samples, or if the objective has the same value in all
      designs.
    - ``is_constant``: whether the objective has the same value in all designs.
    """

    objective: str
    samples: int
    incomplete: int
    indices: tuple[SobolIndex, ...]
    is_constant: bool = False


def sensitivities(table: StudyTable) -> list[ObjectiveSensitivity]:
    """Returns the indices for each objective, or an empty list for another method.

    The indices are those of Saltelli et al., "Variance based sensitivity analysis of model output",
    2010, as implemented by scipy.  They use the first complete base samples, as many as the largest
    power of two.  Equal tables give equal indices.  Raises ``MissingPackageError`` if scipy is not
    installed.
    """
    description = table.description
    if description.get("method") != "saltelli":
        return []
    variables, objectives = description["variables"], list(description["objectives"])
    names = ", ".join(f'"{name}"' for name in objectives)
    _, rows = table.query(f"SELECT sample, status, {names} FROM designs ORDER BY sample")
    size = len(variables) + 2
    result = []
    for column, objective in enumerate(objectives, 2):
        groups: dict[int, list[float]] = {}
        for row in rows:
            group = groups.setdefault((row[0] - 1) // size, [])
            if row[1] == "ok" and row[column] is not None:
                group.append(row[column])
        complete = [values for values in groups.values() if len(values) == size]
        result.append(_sensitivity(objective, variables, complete, len(groups) - len(complete)))
    return result


def _sensitivity(
    objective: str, variables: Sequence[str], groups: Sequence[Sequence[float]], incomplete: int
) -> ObjectiveSensitivity:
    """``groups``: values of A, B and each AB of the complete base samples."""
    count = 1 << len(groups).bit_length() - 1 if groups else 0
    if count < LEAST_SAMPLES:
        return ObjectiveSensitivity(objective, count, incomplete, ())
    values = [list(column) for column in zip(*groups[:count], strict=True)]
    if all(value == values[0][0] for column in values for value in column):
        return ObjectiveSensitivity(objective, count, incomplete, (), is_constant=True)
    first, total, intervals = _indices(values)
    indices = tuple(
        SobolIndex(name, first[i], intervals[0][i], total[i], intervals[1][i])
        for i, name in enumerate(variables)
    )
    return ObjectiveSensitivity(objective, count, incomplete, indices)


def _indices(values: list[list[float]]) -> tuple[list[float], list[float], list[list[Interval]]]:
    """Returns the first-order and total indices, and the intervals of both."""
    stats = definition.required("scipy.stats")
    import numpy as np

    outputs = np.array(values)
    count = outputs.shape[1]

    def both(chosen: Any) -> Any:
        pair = {"f_A": outputs[:1, chosen], "f_B": outputs[1:2, chosen]}
        with np.errstate(invalid="ignore", divide="ignore"):  # equal values in a resample
            indices = stats.sobol_indices(func={**pair, "f_AB": outputs[2:, None, chosen]}, n=count)
        shape = (2, outputs.shape[0] - 2)
        return np.stack([indices.first_order, indices.total_order]).reshape(shape)

    best = both(np.arange(count))
    random = np.random.default_rng(0)
    resampled = [both(random.integers(0, count, count)) for _ in range(RESAMPLES)]
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.nanquantile(np.array(resampled), [tail, 1.0 - tail], axis=0)
    intervals = [
        list(zip(lows, highs, strict=True))
        for lows, highs in zip(low.tolist(), high.tolist(), strict=True)
    ]
    return best[0].tolist(), best[1].tolist(), intervals


def sensitivity_notes(shares: ObjectiveSensitivity) -> list[str]:
    """Returns what a reader must know about the indices of an objective, as sentences."""
    notes = []
    if shares.is_constant:
        notes.append(f"{shares.objective} has the same value in all designs.")
    elif not shares.indices:
        notes.append(
            f"{shares.objective}: {shares.samples} complete base samples are too few for indices;"
            f" {LEAST_SAMPLES} are needed."
        )
    if shares.incomplete:
        notes.append(
            f"{shares.objective}: {shares.incomplete} base samples are left out, because a design"
            " of them has no value."
        )
    return notes


MOST_ROWS = 20


def summary(table: StudyTable) -> dict[str, Any]:
    """Returns the counts by status and the best designs as JSON values.

    The designs with the status ``ok`` are ordered by the objective.  With several objectives, the
    designs of the front come first, ordered by the first objective.
    """
    description = table.description
    designs = table.designs()
    counts = Counter(design["status"] for design in designs)
    goals = description["objectives"]
    passed = [
        design
        for design in designs
        if design["status"] == "ok" and all(design[name] is not None for name in goals)
    ]
    points = [
        [-design[name] if goal == "maximise" else design[name] for name, goal in goals.items()]
        for design in passed
    ]
    on_front = set(front(points))
    order = sorted(range(len(passed)), key=lambda i: (i not in on_front, points[i]))
    best = [{**passed[index], "front": index in on_front} for index in order]
    result = {
        "study": description["study"],
        "designs": len(designs),
        "statuses": {status: counts[status] for status in definition.STATUSES if counts[status]},
        "objectives": goals,
        "best": best,
    }
    shares = sensitivities(table)
    return {**result, "sensitivity": [asdict(each) for each in shares]} if shares else result


def summary_text(table: StudyTable, width: int | None) -> str:
    """Returns the counts by status and a table of the best designs.

    ``width``: number of columns of the terminal, or ``None`` for one line per design.
    """
    result, description = summary(table), table.description
    counts = ", ".join(f"{count} {status}" for status, count in result["statuses"].items())
    lines = [f"{result['study']}: {result['designs']} designs: {counts or 'none'}"]
    for reason in table.counts("status = 'error'" if result["best"] else "true"):
        code, more = reason.code and f" {reason.code}", reason.count - 1
        others = f" (and {more} more)" if more else ""
        lines.append(f"design {reason.sample}: {reason.status}{code}: {reason.message}{others}")
    goals = result["objectives"]
    names = [*description["variables"], *description["constraints"], *goals]
    is_front = len(goals) > 1
    titles = [f"{name} ({goals[name]})" if name in goals else name for name in names]
    shown = result["best"][:MOST_ROWS]
    if shown:
        table_rows = [("sample", *titles, *(["front"] if is_front else []))]
        for design in shown:
            mark = ["*" if design["front"] else ""] if is_front else []
            cells = [cell_text(design[name]) for name in names]
            table_rows.append((str(design["sample"]), *cells, *mark))
        lines += [text_table(table_rows, width), "SI units, angles in rad"]
        if is_front:
            count = sum(1 for design in result["best"] if design["front"])
            lines.append(f"*: {count} designs that no other design surpasses in every objective")
    else:
        lines.append("no design meets every constraint and passes every scenario")
    return "\n".join(lines + _sensitivity_lines(sensitivities(table), width))


def _sensitivity_lines(shares: list[ObjectiveSensitivity], width: int | None) -> list[str]:
    lines = []
    if any(each.indices for each in shares):
        lines += ["", *text_table(sensitivity_rows(shares), width).splitlines()]
        lines.append("shares of the variance of the objective, with intervals of 95 % confidence")
    return lines + [note for each in shares for note in sensitivity_notes(each)]


def sensitivity_rows(shares: list[ObjectiveSensitivity]) -> list[tuple[str, ...]]:
    """Returns the table of indices: titles, then a row for each objective and variable.

    The variables of an objective are ordered by their total index.
    """
    table_rows: list[tuple[str, ...]] = [("objective", "variable", "alone", "with others")]
    for each in shares:
        for index in sorted(each.indices, key=lambda index: -index.total):
            first = _share(index.first_order, index.first_order_interval)
            total = _share(index.total, index.total_interval)
            table_rows.append((each.objective, index.variable, first, total))
    return table_rows


def _share(value: float, interval: Interval) -> str:
    low, high = interval
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def shown_unit(unit: str, values: Iterable[Any]) -> tuple[str, float]:
    """Returns the unit in which people read values of an SI unit, and its number per SI unit.

    Angles are read in degrees.  Lengths are read in mm, or in m if one of them reaches 10 m.
    """
    if unit == "rad":
        return "deg", math.degrees(1.0)
    if unit == "m" and all(abs(v) < 10.0 for v in values if isinstance(v, float)):
        return "mm", 1000.0
    return unit, 1.0


def quantity_text(value: float, unit: str) -> str:
    """Returns a value of an SI unit in the unit in which people read it."""
    shown, factor = shown_unit(unit, [value])
    return f"{cell_text(value * factor)} {shown}".rstrip()


def cell_text(value: Any) -> str:
    """Returns a value of the table for people: numbers with 4 digits, whole from 10,000 on."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.4g}" if abs(value) < 1e4 or abs(value) >= 1e7 else f"{value:.0f}"
