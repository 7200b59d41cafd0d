"""A report as a picture: one bar a figure with the range of its rounds, grouped by unit. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from bench.report import Figure, Report

#: figures that lie further apart than this are drawn on a logarithmic scale
_DECADES: Final = 50


class PlotError(Exception):
    """There is no picture, and why."""


def plot(report: Report, path: Path) -> None:
    """Write a picture of ``report``; the kind follows from the name (.svg, .png, .pdf). Raises PlotError."""
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure as Canvas
    except ImportError:
        raise PlotError("matplotlib is not installed, which --plot needs: python -m pip install -e '.[plot]'") from None
    mpl.rcParams["svg.fonttype"] = "none"  # text stays text
    groups: dict[str, list[Figure]] = {}
    for figure in report.figures:
        groups.setdefault(figure.unit, []).append(figure)
    heights = [1 + len(figures) for figures in groups.values()] or [1]
    canvas = Canvas(figsize=(10, 1 + 0.3 * sum(heights)), layout="constrained")
    panels = canvas.subplots(len(heights), 1, squeeze=False, gridspec_kw={"height_ratios": heights})
    for (unit, figures), panel in zip(groups.items(), panels[:, 0], strict=False):
        _bars(panel, unit, figures)
    canvas.suptitle(f"{report.name}, {report.taken}\n{report.about.get('processor')}", fontsize=10)
    try:
        canvas.savefig(path)
    except (OSError, ValueError) as error:
        raise PlotError(f"{path} cannot be written: {error}") from None


def _bars(panel: Any, unit: str, figures: list[Figure]) -> None:
    names = [f.name for f in figures]
    values = [f.value for f in figures]
    below = [max(0.0, f.value - min(f.rounds, default=f.value)) for f in figures]
    above = [max(0.0, max(f.rounds, default=f.value) - f.value) for f in figures]
    panel.barh(names, values, xerr=(below, above), height=0.7, color="#4c78a8", ecolor="#333333", capsize=2)
    for row, figure in enumerate(figures):
        if figure.goal is not None:
            panel.plot([figure.goal] * 2, [row - 0.4, row + 0.4], color="#d62728", linewidth=2)
    if min(values) > 0 and max(values) > _DECADES * min(values):
        panel.set_xscale("log")
    panel.invert_yaxis()
    panel.set_xlabel(unit or "ratio")
    panel.tick_params(labelsize=8)
