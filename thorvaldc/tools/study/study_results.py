"""The table of designs of a study: its best designs, and what the variables matter."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.comparison.difference_text import value_text
from thorvaldc.compiler.source.node import Value
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics import files
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.tools.study.designs import required
from thorvaldc.tools.study.study_document import Design, StudyPlan

if TYPE_CHECKING:
    from pandas import DataFrame

TABLE = "designs.parquet"
STATUSES = ("ok", "constraint", "expectation", "tipped", "diverged", "error")
Row = tuple[int, str, Design, dict[str, Any]]
"""Number, key, values and result of a design."""


def table_of(plan: StudyPlan, rows: Iterable[Row]) -> DataFrame:
    """Returns the table of designs, in SI units; ``attrs`` has the names and the goals."""
    records = []
    numbers = {v.name for v in plan.variables if all(map(_has_number, v.tested_values()))}
    for number, key, design, result in rows:
        record: dict[str, Any] = {"sample": number}
        record |= {name: result[name] for name in ("status", "code", "message")}
        for variable, value in zip(plan.variables, design, strict=True):
            is_number = variable.name in numbers
            record[variable.name] = si_value(value) if is_number else _word(value)
        record |= {c.name: _number(result["facts"].get(c.fact)) for c in plan.constraints}
        record |= {o.name: _number(o.value_of(result)) for o in plan.objectives}
        for scenario, metrics in result["metrics"].items():
            record |= {f"{scenario}.{name}": _number(value) for name, value in metrics.items()}
        records.append(record | {"design": json.dumps(design, ensure_ascii=False), "key": key})
    table: DataFrame = required("pandas").DataFrame.from_records(records)
    table.attrs = {
        "study": plan.name,
        "method": plan.method,
        "identity": plan.identity(),
        "variables": [variable.name for variable in plan.variables],
        "constraints": [constraint.name for constraint in plan.constraints],
        "objectives": {objective.name: objective.goal for objective in plan.objectives},
    }
    return table


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


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


def _has_number(value: Value) -> bool:
    return si_value(value) is not None


def _word(value: Value) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def write_table(table: DataFrame, folder: Path) -> Path:
    """Writes the table to a folder, completely or not at all.  Equal tables give equal bytes."""
    required("pyarrow")
    path = folder / TABLE
    files.write_file(path, table.to_parquet(index=False))
    return path


def read_table(folder: Path) -> DataFrame:
    """Reads the table in a folder.  Raises ``OSError`` or ``ValueError`` if there is none."""
    required("pyarrow")
    table: DataFrame = required("pandas").read_parquet(folder / TABLE)
    if "objectives" not in table.attrs:
        raise ValueError(f"{folder / TABLE} is no table of a study")
    return table


def best_designs(table: DataFrame) -> DataFrame:
    """Returns the designs with the status ``ok`` and all objectives, the best ones first.

    The column ``front`` says whether no other design surpasses the design in every objective.
    With several objectives, the designs of the front come first, ordered by the first objective.
    """
    goals = table.attrs["objectives"]
    passed = table[table["status"] == "ok"].dropna(subset=list(goals))
    signs = [-1.0 if goal == "maximise" else 1.0 for goal in goals.values()]
    points = (passed[list(goals)] * signs).to_numpy().tolist()
    on_front = set(front(points))
    order = sorted(range(len(points)), key=lambda i: (i not in on_front, points[i]))
    passed = passed.iloc[order]
    passed.insert(0, "front", [index in on_front for index in order])
    return passed


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
RESAMPLES = 500
"""Number of bootstrap resamples for the intervals."""


def sensitivities(table: DataFrame) -> list[dict[str, Any]]:
    """Returns the Sobol indices of each variable for each objective; none for another method.

    An entry has the ``objective``, the ``variable``, the share of the variance of the objective
    that the variable causes ``alone`` and ``with_others``, each with a bootstrap interval of 95 %
    confidence, and the numbers of complete and incomplete base samples.  The indices are those of
    Saltelli et al., "Variance based sensitivity analysis of model output", 2010, as implemented by
    scipy.  They use the first complete base samples, as many as the largest power of two; with
    fewer than ``LEAST_SAMPLES``, or for an objective with one value, there are no variables.
    """
    if table.attrs["method"] != "saltelli":
        return []
    import numpy as np

    stats, variables = required("scipy.stats"), table.attrs["variables"]
    entries: list[dict[str, Any]] = []
    numbered = table.set_index("sample").reindex(range(1, table["sample"].max() + 1))
    for objective in table.attrs["objectives"]:
        valid = numbered[objective].where(numbered["status"] == "ok").to_numpy()
        size = len(variables) + 2
        groups = valid[: len(valid) // size * size].reshape(-1, size)
        complete = groups[~np.isnan(groups).any(axis=1)]
        count = 1 << len(complete).bit_length() - 1 if len(complete) else 0
        common = {
            "objective": objective,
            "samples": count,
            "incomplete": len(groups) - len(complete),
        }
        outputs = complete[:count].T
        if count < LEAST_SAMPLES or (outputs == outputs[0, 0]).all():
            entries.append(common)
            continue
        random, everything = np.random.default_rng(0), np.arange(count)
        chosen = [everything, *(random.integers(0, count, count) for _ in range(RESAMPLES))]
        first, total = zip(*(_indices(stats, outputs[:, each]) for each in chosen), strict=True)
        for index, variable in enumerate(variables):
            entry = {**common, "variable": variable}
            for name, shares in (("alone", first), ("with_others", total)):
                resampled = [share[index] for share in shares[1:]]
                interval = np.nanquantile(resampled, [0.025, 0.975]).tolist()
                entry |= {name: float(shares[0][index]), f"{name}_interval": interval}
            entries.append(entry)
    return entries


def _indices(stats: Any, outputs: Any) -> tuple[Any, Any]:
    """Returns the first-order and the total index of each variable."""
    import numpy as np

    values = {"f_A": outputs[:1], "f_B": outputs[1:2], "f_AB": outputs[2:, None]}
    with np.errstate(invalid="ignore", divide="ignore"):  # equal values in a resample
        indices = stats.sobol_indices(func=values, n=outputs.shape[1])
    return indices.first_order.ravel(), indices.total_order.ravel()


MOST_ROWS = 20


def summary(table: DataFrame) -> dict[str, Any]:
    """Returns the counts by status, the best designs and the sensitivities as JSON values."""
    counts = table["status"].value_counts()
    best = best_designs(table).drop(columns=["key", "design"])
    return {
        "study": table.attrs["study"],
        "designs": len(table),
        "statuses": {name: int(counts[name]) for name in STATUSES if name in counts},
        "objectives": table.attrs["objectives"],
        "best": files.finite(best.to_dict("records")),
        **({"sensitivity": shares} if (shares := sensitivities(table)) else {}),
    }


def summary_text(table: DataFrame, width: int | None = None) -> str:
    """Returns the counts, the first messages, the best designs and the sensitivities as text.

    ``width``: number of columns of the terminal, or ``None`` for any.
    """
    goals, best = table.attrs["objectives"], best_designs(table)
    counts = table["status"].value_counts()
    shown = ", ".join(f"{counts[name]} {name}" for name in STATUSES if name in counts)
    lines = [f"{table.attrs['study']}: {len(table)} designs: {shown or 'none'}"]
    failed = table[table["status"] == "error"] if len(best) else table
    for _, group in failed.groupby(["status", "code"], sort=False):
        first, more = group.iloc[0], f" (and {len(group) - 1} more)" if len(group) > 1 else ""
        status = f"{first['status']} {first['code']}".rstrip()
        lines.append(f"design {first['sample']}: {status}: {first['message']}{more}")
    if not len(best):
        return "\n".join([*lines, "no design meets every constraint and passes every scenario"])
    names = [*table.attrs["variables"], *table.attrs["constraints"], *goals]
    titles = [f"{name} ({goals[name]})" if name in goals else name for name in names]
    is_front = len(goals) > 1
    rows = [("sample", *titles, *["front"] * is_front)]
    for _, row in best[:MOST_ROWS].iterrows():
        mark = ["*" if row["front"] else ""] * is_front
        rows.append((str(row["sample"]), *(cell_text(row[name]) for name in names), *mark))
    lines += [text_table(rows, width), "SI units, angles in rad"]
    if is_front:
        count = best["front"].sum()
        lines.append(f"*: {count} designs that no other design surpasses in every objective")
    return "\n".join(lines + _sensitivity_lines(sensitivities(table), width))


def _sensitivity_lines(entries: list[dict[str, Any]], width: int | None) -> list[str]:
    rows = [("objective", "variable", "alone", "with others")]
    for entry in entries:
        if "variable" in entry:
            shares = [
                "{:.2f} ({:.2f} to {:.2f})".format(entry[name], *entry[f"{name}_interval"])
                for name in ("alone", "with_others")
            ]
            rows.append((entry["objective"], entry["variable"], *shares))
    lines = []
    if len(rows) > 1:
        lines += ["", text_table(rows, width)]
        lines.append("shares of the variance of the objective, with intervals of 95 % confidence")
    for entry in entries:
        name, count = entry["objective"], entry["samples"]
        if "variable" not in entry:
            lines.append(
                f"{name} has no indices: its {count} complete base samples are fewer than"
                f" {LEAST_SAMPLES}, or have one value"
            )
        if entry["incomplete"]:
            lines.append(f"{name}: {entry['incomplete']} base samples lack the value of a design")
    return list(dict.fromkeys(lines))


def cell_text(value: Any) -> str:
    """Returns a value of the table for people."""
    if not isinstance(value, float):
        return str(value)
    return "-" if math.isnan(value) else value_text(value, "")
