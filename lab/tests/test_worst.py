"""The worst captures of a run: their order, and what the page shows of them."""

import numpy as np

import gsut
from gsut.files import write_picture
from lab.proving.worst import build_worst, draw_places, draw_sheet, list_worst
from lab.proving.writing import TRUTH, find_cache

POSES = {
    "poses_status": 0, "verdict_reasons": [], "shift_degrees": 1.0, "auc_1": 0.5, "registered": 1.0
}  # fmt: skip


def make_row(seed, said, true, auc_5, **others):
    return {"seed": seed, "verdict": said, "true_class": true, "auc_5": auc_5} | POSES | others


def test_worst_captures_come_first():
    rows = [
        make_row(0, "good", "good", 0.9),
        {"seed": 1, "poses_status": 2, "poses_refused": "no pair"},
        make_row(2, "good", "usable", 0.6),
        make_row(3, "good", "usable", 0.5),
        make_row(4, "poor", "good", 0.9),
        make_row(5, "good", "good", 0.9, exact={"1": ["error: the photographs contradict"]}),
        {"seed": 6, "failed": "Traceback: x"},
        make_row(7, "good", "poor", 0.8),
    ]
    assert [row["seed"] for row in list_worst(rows)] == [7, 6, 5, 4, 3, 2, 1]
    assert len(list_worst(9 * rows)) == 10


def test_page_shows_small_pictures_of_the_worst(tmp_path, monkeypatch):
    monkeypatch.setenv("GSUT_PROVING_CACHE", str(tmp_path))
    noise = np.random.default_rng(0).integers(0, 255, (200, 250, 3), np.uint8)
    for seed in range(10):
        folder = find_cache() / f"{seed:07d}" / TRUTH / "images"
        folder.mkdir(parents=True)
        for number in range(6):
            write_picture(folder / f"{number:03d}.png", noise)
    (part,) = build_worst([make_row(seed, "good", "poor", 0.1) for seed in range(10)])
    assert part.count("data:image/jpeg") == 10
    assert len(part) < 300_000  # noise, the dearest pictures
    (part,) = build_worst([make_row(11, "good", "poor", 0.1)])
    assert "not in the cache" in part
    assert build_worst([make_row(0, "good", "good", 0.9)]) == []


def test_places_are_drawn_in_the_frame_that_suits_most_of_them(tmp_path, monkeypatch):
    monkeypatch.setenv("GSUT_PROVING_CACHE", str(tmp_path))
    true = np.random.default_rng(0).uniform(-1, 1, (9, 3))
    found = 3 * true @ gsut.exp_pose([0, 0, 0, 1.0, 2.0, 0.5])[:3, :3].T + 7
    centers = [list(pair) for pair in zip(true.tolist(), found.tolist(), strict=True)]
    plans = [draw_places(centers)]
    centers[4][1] = (found[4] + 2.0).tolist()
    plans.append(draw_places([*centers, [[0.0, 0.0, 0.0], None]]))
    right, wrong = ((plan != plan[..., :1]).any(axis=2).sum() for plan in plans)  # coloured pixels
    assert right < wrong < 2 * right  # one line more
    sheet = draw_sheet([make_row(k, "good", "poor", 0.1, centers=centers) for k in range(3)])
    assert sheet.shape == (264, 840, 3) and sheet.dtype == np.uint8
