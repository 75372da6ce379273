"""The benchmark of what people bring: a row for each capture, refusals too."""

from lab.bench import captures_bench
from lab.bench.__main__ import PACKAGES
from tests.bench.__main__ import main
from tests.bench.harness import Settings


def test_captures_are_found_with_what_an_eye_saw_and_refusals_are_rows(tmp_path):
    for name in ("garden", "castle/images"):
        (tmp_path / "all" / name).mkdir(parents=True)
        (tmp_path / "all" / name / "1.jpg").write_bytes(b"no photograph")
    film = tmp_path / "all/walk_film/walk.mp4"
    film.parent.mkdir()
    film.write_bytes(b"no film")
    table = "| Capture | Known | Eye |\n|---|---|---|\n| `castle` | 9 mm | **good** |\n"
    (tmp_path / "all/README.md").write_text(table + "| `walk_film/walk.mp4` | - | poor |\n")
    out = tmp_path / "out"
    words = [str(tmp_path / "all"), "--folder", str(out), "--only"]
    cases = list(captures_bench.list_cases(Settings({"folders": (tmp_path / "all",)})))
    assert [(case["capture"], case["_known"], case["_eye"]) for case in cases] == [
        ("castle", "9 mm", "good"), ("garden", None, None), ("walk_film", "-", "poor"),
    ]  # fmt: skip
    assert cases[2]["_source"] == film
    assert main(["captures", *words, "castle"], PACKAGES) == 0
    page = (out / "captures.html").read_text("utf-8")
    assert "refused: none of the 1 photographs can be read" in page and "Eye: good" in page
