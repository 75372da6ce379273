"""The one kit for reports: a page, its tables and embedded pictures, and plots in one style."""

from gsut.page.chart import Chart, limits_of
from gsut.page.page import (
    bytes_address,
    duration_text,
    html_table,
    number_text,
    picture_address,
    render_page,
    sections_page,
)
from gsut.page.plots import (
    GRID,
    INK,
    LINE,
    MUTED,
    SERIES,
    TITLE,
    plot_figure,
    png_address,
    svg_text,
)

__all__ = [
    "GRID",
    "INK",
    "LINE",
    "MUTED",
    "SERIES",
    "TITLE",
    "Chart",
    "bytes_address",
    "duration_text",
    "html_table",
    "limits_of",
    "number_text",
    "picture_address",
    "plot_figure",
    "png_address",
    "render_page",
    "sections_page",
    "svg_text",
]
