"""The report: one self-contained page that holds every figure and picture of a run."""

import html
import html.parser
import json
import re

import numpy as np
import pytest

import small_run
from gsut import InputError
from gsut.evaluate.report import _choose_views, write_report
from gsut.page import format_duration, format_number
from gsut.render import Confidence
from gsut.run import TrainOptions
from gsut.run.folder import RunFile, RunFolder


@pytest.fixture
def run(tmp_path, monkeypatch):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene)
    return small_run.finished_run(tmp_path / "run", scene)


class Page(html.parser.HTMLParser):
    """Collects the addresses that a page refers to and the tags left open."""

    VOID = ("meta", "img", "br", "input", "link")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            assert self.open, f"</{tag}> closes nothing"


def test_report_is_one_file_that_asks_for_nothing_outside(run):
    text = (run.path / RunFile.REPORT).read_text()
    page = Page(text)
    assert len(page.sources) >= 2 * 4 + 3 + 1  # two views, curves, rings
    assert all(source.startswith("data:image/") for source in page.sources)
    assert "link" not in page.tags
    assert not re.search(r"@import|url\(\s*[^d\"')]|https?://", text.replace("data:image", ""))
    assert page.open == []


def test_report_shows_figures_views_options_notes_and_command(run):
    text = html.unescape((run.path / RunFile.REPORT).read_text())
    metrics = run.read_json(RunFile.METRICS)
    environment = run.read_json("environment.json")
    expected = [
        f"{metrics['psnr']:.2f}", f"{metrics['ssim']:.4f}", "images/0.png", "images/3.png",
        "beyond 80°", "kannala_brandt", "images/9.png", environment["command"],
        environment["processor"], metrics["version"], 'class="badge best"', 'class="badge worst"',
    ]  # fmt: skip
    assert [word for word in expected if word not in text] == []


def test_report_without_held_out_views_is_still_made(run):
    metrics = run.read_json(RunFile.METRICS)
    metrics |= {"views": [], "rings": [], "test_views": [], "psnr": None, "ssim": None}
    metrics["psnr_color_corrected"] = metrics["render_ms"] = None
    run.write_json(RunFile.METRICS, metrics)
    (run.path / "history.jsonl").unlink()
    write_report(run)
    assert Page((run.path / RunFile.REPORT).read_text()).open == []


def test_report_of_an_unfinished_run_says_so(tmp_path):
    run = RunFolder.create(tmp_path / "run", TrainOptions(steps=100))
    with pytest.raises(InputError, match="the run is not finished"):
        write_report(run)


@pytest.mark.parametrize("damage", [lambda path: path.unlink(), lambda path: path.write_bytes(b"")])
def test_report_with_a_picture_that_is_gone_or_torn_names_it(run, damage):
    damage(run.renders / "images_0_depth.png")
    with pytest.raises(InputError, match=r"images_0_depth\.png"):
        write_report(run)


def test_choose_views_of_many_hold_best_median_and_worst(rng):
    rows = [{"name": f"{i:03d}", "psnr": float(v)} for i, v in enumerate(rng.permutation(101))]
    chosen = _choose_views(rows)
    marked = {mark: row["psnr"] for row, marks in chosen for mark in marks}
    assert marked == {"worst": 0.0, "median": 50.0, "best": 100.0}
    assert 12 <= len(chosen) <= 14
    assert [row["name"] for row, _ in chosen] == sorted(row["name"] for row, _ in chosen)


def test_numbers_and_durations_read_well():
    assert format_number(1234567.0, 0) == "1\u2009234\u2009567"
    assert format_number(None) == "–"
    assert format_duration(12.34) == "12.3 s"
    assert format_duration(245.0) == "4 min 05 s"
    assert format_duration(3725.0) == "1 h 02 min"


def test_report_of_the_same_run_is_the_same_bytes(run):
    first = (run.path / RunFile.REPORT).read_bytes()
    write_report(run)
    assert (run.path / RunFile.REPORT).read_bytes() == first


def test_metrics_json_is_plain_json(run):
    metrics = json.loads((run.path / RunFile.METRICS).read_text(), parse_constant=pytest.fail)
    assert np.isfinite(metrics["psnr"])


def test_report_shows_how_well_sigmas_hold_once_they_are_measured(run, rng):
    before = (run.path / RunFile.REPORT).read_text()
    assert "How sure a pixel is" not in before
    nothing = np.zeros(len(small_run.GAUSSIANS))
    measured = Confidence.from_sums(small_run.GAUSSIANS, nothing, nothing, nothing)
    measured.save(run.path / RunFile.CONFIDENCE)
    text = write_report(run).read_text()
    assert "sigma of colour not calibrated" in text
    sources = len(Page(text).sources)
    measured.calibrate([rng.exponential(size=500) for _ in range(4)]).save(
        run.path / RunFile.CONFIDENCE
    )
    text = write_report(run).read_text()
    assert re.search(r"one sigma of colour holds \d+ % of the pixels of 4 held-out views", text)
    assert len(Page(text).sources) == sources + 1
