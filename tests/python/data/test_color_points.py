"""Points without colours, as those of a LiDAR, get theirs from the photographs that see them."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut.training import TrainingLoop


@pytest.fixture(scope="module")
def few_views(shared):
    scene = gsut.load_dataset(shared / "data" / "sponza_fisheye")
    views = [scene.views[i] for i in scene.train_indices[::6]]
    return scene.replace(
        views=views, train_indices=range(len(views)), test_indices=(),
        points=scene.points[::8], point_colors=scene.point_colors[::8],
    )  # fmt: skip


def test_color_points_agrees_with_the_datasets_colours(few_views):
    hidden = np.array([[0.0, 0.0, 1e4]])
    colors, views = gsut.poses.color_points(few_views, np.concatenate([few_views.points, hidden]))
    assert views[-1] == 0 and np.ptp(colors[-1]) == 0
    seen = views[:-1] > 0
    assert seen.mean() > 0.5
    off = np.abs(colors[:-1].astype(float) - few_views.point_colors).mean(axis=1)
    assert np.median(off[seen]) < tolerances.POINTS_COLOUR_LEVELS


def test_train_colours_points_that_have_none(few_views):
    grey = few_views.replace(point_colors=np.full_like(few_views.point_colors, 128))
    assert not gsut.data.points.has_colors(grey)
    options = gsut.TrainOptions(max_gaussians=2000, sh_degree=0, init="points")
    found = [TrainingLoop(s, options).gaussians.sh[:, 0] for s in (few_views, grey)]
    same = np.corrcoef(found[0].ravel(), found[1].ravel())[0, 1]
    assert same > 0.8
