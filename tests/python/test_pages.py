"""Pages show names as text, whatever stands in them: markup, quotes or a template's words."""

import ast
import html.parser
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import calib.report.page
import small_run
from gsut.evaluate.report import write_report
from gsut.evaluate.scene_page import write_scene_page
from gsut.page import build_page, render_template
from gsut.page.page import embed_json
from gsut.run.folder import RunFile, RunFolder
from gsut.sfm.report import page

ROOT = Path(__file__).parents[2]
PLAIN = "plain"
HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onmouseover='alert(1)",
    "</title></style><svg onload=alert(1)>",
    "{{ 7 * 7 }}{% raw %}",
    "&lt;b&gt;",
    "<!--<script>",
)
VERDICT = {"level": "good", "what": "it is sharp", "reasons": [], "advice": ""}


class Structure(html.parser.HTMLParser):
    """Collects the tags of a page with the names of their attributes, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[object] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, [name for name, _ in attrs]))

    def handle_data(self, data):
        self.text += data


def make_training_page(folder, name, monkeypatch):
    scene = small_run.scene_from_arrays(folder / "data")
    small_run.install(monkeypatch, scene)
    run = small_run.finished_run(folder / "run", scene)
    metrics = run.read_json(RunFile.METRICS)
    for row in metrics["views"]:
        row["name"] = name
    metrics |= {"notes": [name], "dataset": name, "camera_model": name, "test_views": [name]}
    metrics["verdict"] = VERDICT | {"what": name}
    run.write_json(RunFile.METRICS, metrics)
    environment = run.read_json("environment.json") | {"command": name, "processor": name}
    run.write_json("environment.json", environment)
    write_report(run)
    return (run.path / RunFile.REPORT).read_text()


def make_scene_page(folder, name, monkeypatch):
    (folder / "run").mkdir()
    (folder / "captured.jpg").write_bytes(b"")
    monkeypatch.setattr(sys.modules[write_scene_page.__module__], "STRIP", "captured.jpg")
    run = RunFolder(folder / "run")
    monkeypatch.setattr(RunFolder, "write_text", lambda _, __, text: texts.append(text))
    texts: list[str] = []
    views = [{"psnr": 20.0, "render": f"{name}.png", "truth": f"{name}.jpg"}]
    figures = {"verdict": VERDICT | {"what": name}, "renders": name, "seconds": {name: 3.0}}
    write_scene_page(run, "scene.html", figures, {"views": views}, folder, name, [name])
    return texts[0]


def make_poses_page(folder, name, monkeypatch):
    for plot in ("_plot_scene", "_plot_residuals"):
        monkeypatch.setattr(page, plot, lambda *_: [])
    view = {"registered": False, "name": name}
    values = {
        "registered": 1, "images": 2, "points": 3, "observations": 4, "mean_track_length": 2.0,
        "reprojection_error_px": {"median": 0.1, "rms": 0.2}, "seconds": {name: 1.0},
        "initial_pair": [name, name], "lenses": [{"model": name, "params": []}], "lens": name,
        "verdict": VERDICT | {"what": name}, "views": [view], "notes": [name],
    }  # fmt: skip
    page.write_report(folder, None, values)
    return (folder / page.REPORT).read_text()


def make_boards_page(folder, name, monkeypatch):
    picture = folder / "board.png"
    cv2.imwrite(str(picture), np.zeros((4, 4, 3), np.uint8))
    board = {"columns": 7, "rows": 5, "spacing": name}
    image = {"file": name, "found": False, "reason": name}
    lens = {
        "model": name, "second_lenses": [], "cross_validation": None, "regions": [],
        "images": [image], "boards_found": 1, "boards_total": 1, "outliers": 0,
        "distance_to_reference": 1.0,
        **dict.fromkeys(("rms_2d_px", "rms_axis_px", "valid_angle_degrees", "halves_worst_degrees",
                         "boards_reached_degrees", "lens_domain_degrees")),
    }  # fmt: skip
    values = {
        "board": board, "cameras": {name: lens, f"{name} too": lens}, "lens": name, "solver": name,
        "boards_found": 1, "boards_total": 1, "seconds": 1.0, "rig_rms_2d_px": 1.0,
        "notes": [name], "refused": [name],
    }  # fmt: skip
    monkeypatch.setattr(calib.report.page, "collect_values", lambda _: values)
    monkeypatch.setattr(calib.report.page, "draw_camera", lambda *_: [name])
    shot = SimpleNamespace(path=SimpleNamespace(name=name), camera=name)
    cameras = [SimpleNamespace(name=name)]
    job = SimpleNamespace(out=SimpleNamespace(name=name))
    result = SimpleNamespace(
        cameras=cameras, trusts=[None], halves=[None], board=None, photographs=[shot],
        pictures=[picture], job=job,
    )  # fmt: skip
    return calib.report.page.write_report_page(folder, result).read_text()


PAGES = (
    make_training_page, make_scene_page, make_poses_page,
    make_boards_page,
)  # fmt: skip


@pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)
def test_page_with_hostile_names_shows_them_as_text(tmp_path, monkeypatch, make):
    def build(number, name):
        (tmp_path / str(number)).mkdir()
        with monkeypatch.context() as patch:
            return Structure(make(tmp_path / str(number), name, patch))

    plain = build(0, PLAIN)
    assert PLAIN in plain.text
    for number, name in enumerate(HOSTILE, 1):
        shown = build(number, name)
        assert shown.tags == plain.tags, name
        assert name in shown.text


def test_json_in_a_page_keeps_hostile_names_and_the_script():
    assert json.loads(embed_json(HOSTILE)) == list(HOSTILE) and "<" not in embed_json(HOSTILE)
    part = render_template("<script>const names = {{ names | tojson }};</script>", names=HOSTILE)
    assert build_page("page", [], [part]).count("<") == build_page("page", [], ["x"]).count("<") + 2


def test_templates_of_pages_are_constants():
    """A template made from a name would run it."""
    checked = 0
    for path in [p for folder in ("python", "calib") for p in (ROOT / folder).rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "render_template":
                assert isinstance(node.args[0], ast.Constant | ast.Name), path
                checked += 1
    assert checked >= 10
