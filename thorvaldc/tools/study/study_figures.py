"""The plots of a study as a web page, drawn by Optuna with Plotly."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.tools.study.designs import required
from thorvaldc.tools.study.study import Study
from thorvaldc.tools.study.study_results import summary_text

if TYPE_CHECKING:
    from pandas import DataFrame


def figures_page(study: Study, table: DataFrame, folder: Path) -> str:
    """Returns a page with the summary of a study and the plots of its objectives, for any browser.

    The page needs no network.
    """
    required("plotly")
    visualization, optuna_study = required("optuna.visualization"), study.optuna_study(folder)
    goals = table.attrs["objectives"]
    figures: list[Any] = []
    if 1 < len(goals) < 4:
        figures.append(visualization.plot_pareto_front(optuna_study, target_names=list(goals)))
    for index, name in enumerate(goals):
        shown: dict[str, Any] = {
            "target": lambda trial, index=index: trial.values[index],
            "target_name": name,
        }
        figures.append(visualization.plot_slice(optuna_study, **shown))
        figures.append(visualization.plot_parallel_coordinate(optuna_study, **shown))
    parts = [
        figure.to_html(full_html=False, include_plotlyjs=index == 0)
        for index, figure in enumerate(figures)
    ]
    title, text = escape(f"Study {table.attrs['study']}"), escape(summary_text(table))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title></head>'
        f'<body style="font-family: sans-serif"><h1>{title}</h1><pre>{text}</pre>'
        f"{''.join(parts)}</body></html>\n"
    )
