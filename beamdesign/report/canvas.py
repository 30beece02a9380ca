"""Figures without pyplot: made and saved headless, the same bytes for the same data."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Literal

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from beamdesign.files import write_whole

STYLES = (
    {"color": "black", "linestyle": "-"},
    {"color": "0.45", "linestyle": "-"},
    {"color": "black", "linestyle": "--"},
    {"color": "0.45", "linestyle": ":"},
    {"color": "black", "linestyle": "-."},
)
"""Line styles that stay apart in grey print, in order of use."""


def new_figure(width_mm: float = 170.0, height_mm: float = 110.0) -> Figure:
    """An empty figure on an Agg canvas, laid out so that labels do not overlap."""
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(
    figure: Figure, path_without_suffix: Path, kinds: Sequence[Literal["png", "svg", "pdf"]] = ("png", "svg")
) -> list[Path]:
    """Save a figure, one file per kind, each whole or not at all.

    SVG text stays text, and nothing in a file depends on the day.

    Returns:
        The files written, in the order of `kinds`.
    """
    written = []
    engine = figure.get_layout_engine()
    dates = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with matplotlib.rc_context({"svg.hashsalt": path_without_suffix.name, "svg.fonttype": "none"}):
        for kind in kinds:
            path = path_without_suffix.with_name(f"{path_without_suffix.name}.{kind}")
            picture = BytesIO()
            figure.savefig(picture, format=kind, dpi=150, metadata=dates[kind])
            write_whole(path, picture.getvalue())
            written.append(path)
            figure.set_layout_engine("none")  # laid out by the first file; doing it again costs as much as drawing
    figure.set_layout_engine(engine)
    return written
