"""`./run bench refine`: its rows, resuming a broken run, and the basin."""

import json
import types

import numpy as np
import pytest

import gsut
from gsut.refine.trust import measure_lens_distance
from random_scenes import fisheye, gaussians_in_view, random_pose
from room_dataset import write_room
from tests.bench import refine_bench as module
from tests.bench.__main__ import main
from tests.bench.refine_basin import colors_row
from tests.bench.refine_bench import RefineBenchOptions, refine_bench
from tests.bench.refine_disturb import Disturbance, disturbed


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench_refine") / "data"
    return write_room(path, np.random.default_rng(7))


def options_for(folder, **changes):
    values = {"steps": 20, "gaussians": 300, "cases": ["small"], "basin": [1.0], "basin_seeds": 1}
    return RefineBenchOptions(str(folder), **(values | changes))


def test_a_broken_run_is_resumed_without_measuring_again(folder, monkeypatch):
    seen = []
    options = options_for(folder)
    rows, basin = refine_bench(options, lambda text: None, lambda rows: seen.append(list(rows)))
    names = [(row["disturbed"], row["training"]) for row in rows]
    small = "0.5 deg, 2 cm"
    assert names == [("nothing", "plain"), (small, "plain"), (small, "refined")]
    assert [(row["basin"], row["degrees"]) for row in basin] == [("tracks", 1.0), ("colours", 1.0)]
    assert [len(each) for each in seen] == [1, 2, 3, 4, 5]
    assert rows[0]["rotation_degrees"] < 1e-6 < rows[1]["rotation_degrees"]
    assert rows[1]["psnr_to_truth"] == rows[1]["psnr"] - rows[0]["psnr"]

    def forbidden(*arguments, **keywords):
        raise AssertionError("a finished row was measured again")

    monkeypatch.setattr(module, "train", forbidden)
    kept = json.loads(json.dumps([*rows, *basin]))
    seen.clear()
    again, basin_again = refine_bench(
        options, lambda text: None, lambda rows: seen.append(list(rows)), kept
    )
    assert [*again, *basin_again] == kept
    assert [len(each) for each in seen] == [5] * 5  # killed now, nothing would be lost
    # Rows of other settings do not count.
    with pytest.raises(AssertionError, match="measured again"):
        refine_bench(options_for(folder, steps=21), lambda text: None, finished=kept)


def test_colours_bring_back_views_that_are_hardly_off_and_none_from_far(rng):
    camera = fisheye(64)
    pose = random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 400, opacity=1.0)
    image = np.round(255 * np.clip(gsut.render(g, camera, pose).image, 0, 1)).astype(np.uint8)

    scene = types.SimpleNamespace(
        test_indices=[0],
        views=[gsut.View("a", "a", 0, pose)],
        camera=lambda index: camera,
        image=lambda index: image,
        mask=lambda index: camera.rays()[1],
    )
    near, far = (colors_row(g, scene, degrees, 0, 3) for degrees in (0.5, 90.0))
    assert (near["share"], near["poses"], far["share"]) == (1.0, 3, 0.0)


def test_lens_is_judged_by_where_its_rays_go(folder):
    scene = gsut.load_dataset(folder)
    (true,) = scene.file_cameras
    (longer,) = disturbed(scene, Disturbance("focal", focal=0.01), 0).file_cameras
    assert measure_lens_distance(true, true) == 0.0
    rays, valid = true.rays()
    pixels, _ = true.project(rays[valid])
    expected = 0.01 * np.sqrt(np.mean(np.sum((pixels - true.params[2:4]) ** 2, axis=1)))
    np.testing.assert_allclose(measure_lens_distance(longer, true), expected, rtol=1e-9)


def test_command_resumes_prints_and_draws(folder, tmp_path, capsys):
    rows, plot = tmp_path / "rows.json", tmp_path / "basin.svg"
    command = ["refine", str(folder), "--steps", "20", "--gaussians", "300"]
    command += ["--cases", "lens", "--basin", "1,2", "--no-tracks"]
    assert main([*command, "--json", str(rows), "--plot", str(plot)]) == 0
    first = capsys.readouterr().out
    assert "focal 2 %, k1 20 %" in first
    assert "come back" in first
    assert b"held-out photograph" in plot.read_bytes()
    assert main([*command, "--json", str(rows), "--resume"]) == 0
    assert capsys.readouterr().out == first
    assert main([*command, "--resume"]) == 2
    assert "name that file" in capsys.readouterr().err
    rows.write_text("{}")
    assert main([*command, "--json", str(rows), "--resume"]) == 2
    assert "no rows of a benchmark" in capsys.readouterr().err
