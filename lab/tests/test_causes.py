"""Planted causes of bad trainings: what they change, and which answers are wrong."""

import numpy as np

import gsut
from lab.proving.capture import capture
from lab.proving.causes import CAUSES, GOOD, NOTHING, copy_changed, find_wrong_cause, name_cause
from lab.proving.misfires import find_misfires
from lab.proving.page import count_causes
from lab.proving.writing import TRUTH, make_capture

SEED = 5


def test_planted_causes_change_pictures_poses_or_lens(tmp_path):
    data = make_capture(capture(SEED, tiny=True), tmp_path) / TRUTH
    exact = gsut.load_dataset(data, test_every=0)
    changed = {}
    for name, cause in CAUSES.items():
        copy_changed(data, tmp_path / name, cause.plant, np.random.default_rng(0))
        scene = gsut.load_dataset(tmp_path / name, test_every=0)
        same = range(len(exact.views)) if len(scene.views) == len(exact.views) else ()
        changed[name] = {
            "views": len(scene.views) != len(exact.views),
            "pictures": any((scene.image(i) != exact.image(i)).any() for i in same),
            "poses": any((scene.views[i].camera_from_world
                          != exact.views[i].camera_from_world).any() for i in same),
            "lens": (scene.cameras[0].params != exact.cameras[0].params).any(),
        }  # fmt: skip
    found = {name: [what for what, is_so in how.items() if is_so] for name, how in changed.items()}
    assert found == {
        NOTHING: [], "few steps": [], "few Gaussians": [], "few views": ["views"],
        "walking movers": ["pictures"], "small movers": ["pictures"],
        "middle movers": ["pictures"], "large movers": ["pictures"],
        "wrong poses": ["poses"], "wrong lens": ["lens"],
    }  # fmt: skip


def test_cause_that_a_verdict_names_is_right_or_a_misfire():
    reasons = ["training views are soft, too (70 % of their detail): steps and Gaussians are few"]
    said = name_cause({"level": "usable", "reasons": reasons})
    assert name_cause({"level": "good", "reasons": ["a.png is worst"]}) == GOOD
    assert name_cause({"level": "good", "reasons": ["3 % show what moved past"]}) == "movers"
    rows = [{"cause_few steps": said, "cause_few views": said, "cause_wrong lens": GOOD}]
    assert [find_wrong_cause(rows[0], name) for name in CAUSES] == [None] * 3 + [said] + [None] * 6
    assert [m.kind for m in find_misfires(rows[0])] == ["cause not named"]
    assert count_causes(rows) == [
        ("few steps", said, 1, True), ("few views", said, 1, False), ("wrong lens", GOOD, 1, True)
    ]  # fmt: skip
