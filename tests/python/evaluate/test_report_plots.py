"""The report's charts: what stands in their SVG."""

import base64
import re

import cv2
import numpy as np
import pytest

from gsut.evaluate.report_plots import plot_curve, plot_rings
from gsut.page import ImageChart, plot_residuals
from gsut.page.chart import Chart
from gsut.run import TrainOptions


def svg(address: str) -> str:
    return base64.b64decode(address.removeprefix("data:image/svg+xml;base64,")).decode()


def texts(address: str) -> list[str]:
    return re.findall(r">([^<]+)</text>", svg(address))


def test_a_line_goes_from_corner_to_corner_of_its_axes():
    chart = Chart("a < b", "x", (0.0, 2.0), (1.0, 100.0), log=True)
    chart.draw_line(np.array([0.0, 1.0, 2.0]), np.array([1.0, 10.0, 100.0]))
    (path,) = re.findall(r'd="M([^"]*)" fill="none"', svg(chart.embed()))
    places = np.array([place.split() for place in path.split("L")], float)
    assert np.allclose(places[1], (places[0] + places[2]) / 2)
    assert places[0][0] < places[2][0] and places[0][1] > places[2][1]  # y grows downwards
    assert "a &lt; b" in texts(chart.embed())


def test_a_map_has_one_scale_and_its_points_lie_where_its_segments_do():
    x, y = np.array([0.0, 10.0]), np.array([0.0, 1.0])
    chart = Chart.make_map("map", "m", x, y)
    chart.draw_segments(x[None], y[None])
    chart.draw_points(x, y, np.array([[255, 0, 0], [0, 0, 255]], np.uint8))
    text = svg(chart.embed())
    (path,) = re.findall(r'd="M([^"]*)" stroke="#1668b8"', text)
    ends = np.array([place.split() for place in path.split("L")], float)
    assert (ends[1, 0] - ends[0, 0]) / (ends[0, 1] - ends[1, 1]) == pytest.approx(10, rel=0.01)
    corner, address = re.search(r'<image x="(\d+ ?).*base64,([^"]*)"', text).groups()
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(address), np.uint8), -1)
    top = float(re.search(r'<image x="\d+" y="(\d+)"', text).group(1))
    for end, color in zip(ends, ([0, 0, 255, 255], [255, 0, 0, 255]), strict=True):
        column, row = 2 * (end[0] - float(corner)), 2 * (end[1] - top)
        assert (picture[int(row), int(column)] == color).all()


def test_curves_of_any_history_name_their_axis_and_last_value():
    rows = [
        {"step": n, "seconds": n / 7, "loss": 1 / n, "psnr": 20 + n / 100, "num_gaussians": 900 * n}
        for n in range(1, 101)
    ]
    options = TrainOptions(steps=100)
    for history in (rows, rows[:1], [rows[0] | {"psnr": None, "seconds": 0.0}]):
        for key in ("loss", "psnr", "num_gaussians"):
            words = texts(plot_curve(history, key, "Title", options))
            assert "Title" in words
            assert "steps" in words
    words = texts(plot_curve(rows, "psnr", "PSNR", options))
    assert "21.00" in words and "full size" in words
    assert "80 000" in texts(plot_curve(rows, "num_gaussians", "Gaussians", options))


def test_rings_without_pixels_have_no_bar():
    rings = [
        {"from_degrees": 0.0, "to_degrees": 30.0, "psnr": 31.5, "pixels": 9},
        {"from_degrees": 30.0, "to_degrees": 60.0, "psnr": None, "pixels": 0},
    ]
    words = texts(plot_rings(rings))
    assert "31.50" in words and "0–30°" in words and "30–60°" not in words


def test_a_map_over_an_image_has_its_pixels_its_border_and_its_scale():
    values = np.array([[1.0, 1.0, 10.0], [1.0, np.nan, 10.0]])
    chart = ImageChart("map", (300, 200))
    chart.draw_map(values, cv2.COLORMAP_INFERNO, "px", (1.0, 10.0), log=True)
    chart.draw_border(values > 5, np.isfinite(values), "white")
    text = svg(chart.embed())
    address = re.search(r'<image x="58" y="34" .*?base64,([^"]*)"', text).group(1)
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(address), np.uint8), -1)
    assert picture.shape == (2, 3, 4) and picture[1, 1, 3] == 0
    np.testing.assert_array_equal(picture[0, 0, :3], [4, 0, 0])  # the map's first colour
    np.testing.assert_array_equal(picture[0, 2, :3], [164, 255, 252])  # and its last
    (path,) = re.findall(r'd="([^"]*)" stroke="white"', text)
    assert path.count("M") == 1 and "v" in path  # between 1 and 10, not beside what is unknown
    assert "1" in texts(chart.embed()) and "10   px" in texts(chart.embed())


def test_residuals_leave_their_pixels_enlarged_alike():
    pixels, residuals = np.array([[100.0, 50.0], [200.0, 150.0]]), np.array([[1.0, 0], [0, 0.5]])
    text = svg(plot_residuals("Residuals", (300, 200), pixels, residuals).embed())
    (path,) = re.findall(r'd="([^"]*)" stroke="#1668b8" stroke-width="0.7"', text)
    ends = np.array([place.split() for place in re.split("[ML]", path)[1:]], float).reshape(2, 2, 2)
    moved = ends[:, 1] - ends[:, 0]
    assert moved[0, 0] == pytest.approx(2 * moved[1, 1], rel=0.02) and moved[0, 1] == 0
