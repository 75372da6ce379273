"""The doctor names the usual mistakes, each planted in a copy of a good dataset."""

from collections import Counter

import pytest

from lab.demo_tracer import make_demo_scene
from lab.mistakes import MISTAKES, NAMED, SAID, judge

# Not to be told apart from other mistakes: said to be wrong without a name.
NOT_NAMED = {
    "clock half a frame late", "rotation vectors in degrees", "photographs of another scene",
}  # fmt: skip
# Need more, or larger, images than these.
ELSEWHERE = {
    "photographs undistorted, lens not", "distortion left out", "principal point half a pixel off",
    "half of the poses in another world", "scale of half of the poses times 1.5",
    "scale of the poses drifts to 1.5", "one pose turned by 30 degrees",
}  # fmt: skip


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    return make_demo_scene(folder / "hall", views=20, test_views=2, size=160, progress=False)


def test_each_usual_mistake_is_named(hall, tmp_path):
    rows = judge(hall, tmp_path / "copies", points=[False])
    assert rows[0]["verdict"] == "good", rows[0]["said"]
    verdicts = Counter()
    for row in rows[1:]:
        print(row["verdict"], row["mistake"], row["said"])
        verdicts[row["verdict"]] += 1
        if row["mistake"] not in ELSEWHERE:
            wanted = SAID if row["mistake"] in NOT_NAMED else NAMED
            assert row["verdict"] == wanted, row["mistake"]
    assert verdicts[NAMED] >= 25


def test_one_pose_far_away_is_named(hall, tmp_path):
    (row,) = judge(hall, tmp_path / "c", "one pose far", points=[False])[1:]
    assert row["verdict"] == NAMED
    assert sum("stands farther" in text for text in row["said"]) == 1
    assert any(mistake.path for mistake in MISTAKES)
