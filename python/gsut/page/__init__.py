"""The one kit for reports: a page, its tables and embedded pictures, and plots in one style."""

from gsut.page.chart import Chart, Style
from gsut.page.page import (
    build_page,
    build_table,
    embed_bytes,
    embed_picture,
    format_duration,
    format_number,
    paint_values,
    render_template,
)
from gsut.page.plots import RING_DEGREES, ImageChart, plot_map, plot_residuals
