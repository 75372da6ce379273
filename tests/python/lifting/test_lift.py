"""Lifting of labels and other numbers of pixels onto Gaussians, and its command."""

import json

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut.cli import main
from gsut.lifting import Lifted, MapFolder
from random_scenes import fisheye, gaussians_in_view, random_pose
from rendered_dataset import truth, write_dataset

SIZE = 48


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """A folder with images, the Gaussians that drew them, and label maps of all views."""
    folder = tmp_path_factory.mktemp("lift")
    write_dataset(folder / "data", np.random.default_rng(5))
    gaussians = truth(np.random.default_rng(5))
    gsut.save_gaussians(folder / "scene.ply", gaussians)
    scene = gsut.load_dataset(folder / "data")
    (folder / "maps").mkdir()
    for index, view in enumerate(scene.views):
        winner = draw_halves(gaussians, scene.camera(index), view.motion)
        cv2.imwrite(str(folder / "maps" / f"{index:03d}.png"), winner)
    return folder, scene, gaussians


def draw_halves(gaussians, camera, place):
    """The label that a pixel shows: 4 left of the middle, 9 right of it, 255 where nothing is."""
    right = (gaussians.means[:, :1] > 0).astype(np.float32)
    drawn = gsut.render(gaussians, camera, place, features=right)
    share = drawn.features[..., 0] / np.maximum(drawn.alpha, 1e-9)
    return np.where(drawn.alpha < 0.5, 255, np.where(share > 0.5, 9, 4)).astype(np.uint8)


def read_maps(folder, scene):
    return MapFolder(folder / "maps", scene)


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_sums_of_a_map_are_the_gradient_to_features_bit_by_bit(rng, rolling):
    camera, pose = fisheye(SIZE), random_pose(rng)
    place = pose
    if rolling:
        ends = [gsut.exp_pose(np.full(6, sign * 0.01)) @ pose for sign in (-1.0, 1.0)]
        place = gsut.CameraMotion(*ends, gsut.Shutter("top_to_bottom"))
    g = gaussians_in_view(rng, camera, pose, 500, sh_degree=0).to_dtype(np.float32)
    values = rng.normal(size=(SIZE, SIZE, 21)).astype(np.float32)
    drawn = gsut.render(g, camera, place, features=np.zeros((len(g), 21)))
    dimage = np.zeros((SIZE, SIZE, 3), np.float32)
    expected = gsut.render_backward(drawn, dimage, dfeatures=values).features
    assert np.any(expected != 0)
    for threads in (1, 2):
        gsut.set_num_threads(threads)
        sums = np.zeros((len(g), 21), np.float32)
        gsut.render(g, camera, place).add_map(values, sums)
        assert np.array_equal(sums, expected)


def test_constant_map_is_lifted_and_shown_as_that_constant(dataset):
    _, scene, gaussians = dataset
    maps = {view.name: np.full((SIZE, SIZE), 3.25) for view in scene.views}
    maps[scene.views[1].name][:, : SIZE // 2] = np.nan  # unknown
    lifted = gsut.lift(gaussians, scene, maps)
    seen = lifted.weights > 0
    assert seen.mean() > 0.9
    assert np.abs(lifted.features[seen] - 3.25).max() < 3.25 * tolerances.RENDER_IMAGE_RMS
    shown = lifted.render(gaussians, scene.camera(0), scene.views[0].motion)
    known = np.isfinite(shown)
    assert 0.2 < known.mean() < 1.0  # nothing is beside the ball
    assert np.abs(shown[known] - 3.25).max() < 3.25 * tolerances.RENDER_IMAGE_RMS


def test_labels_by_majority_are_right_on_views_that_were_not_lifted(dataset):
    folder, scene, gaussians = dataset
    maps = read_maps(folder, scene)
    lifted = gsut.lift(gaussians, scene, maps, labels=True, unknown=255)
    assert lifted.ids.tolist() == [4, 9]
    seen = lifted.weights > 0
    expected = np.where(gaussians.means[:, 0] > 0, 9, 4)
    assert np.mean(lifted.labels[seen] == expected[seen]) > 0.9
    assert np.all(lifted.labels[~seen] == -1)
    index = scene.test_indices[0]
    shown = lifted.render(gaussians, scene.camera(index), scene.views[index].motion)
    known = maps[scene.views[index].name] != 255
    assert np.mean((shown == maps[scene.views[index].name])[known]) > 0.9


def test_lift_of_maps_that_cannot_be_is_refused_with_the_views_name(dataset):
    _, scene, gaussians = dataset
    name = scene.views[scene.train_indices[0]].name
    cases = [
        ({name: np.zeros((5, 7))}, {}, f"the map of {name} is 7 x 5, its image 48 x 48"),
        ({"other": np.zeros((SIZE, SIZE))}, {}, "none of the 10 views has a map"),
        ({name: np.zeros((SIZE, SIZE))}, {"labels": True}, "needs integers"),
        ({name: np.zeros((SIZE, SIZE, 513))}, {}, "1 to 512 values a pixel, found 513"),
        (
            {name: np.arange(SIZE * SIZE).reshape(SIZE, SIZE)},
            {"labels": True},
            "labels beyond 512 different ones",
        ),
        ({name: np.full((SIZE, SIZE), -1)}, {"labels": True}, "no pixel of any map has a label"),
    ]
    for maps, options, message in cases:
        with pytest.raises(gsut.InputError, match=message):
            gsut.lift(gaussians, scene, maps, **options)
    drawn = gsut.render(gaussians, scene.camera(0), scene.views[0].motion, dtype="float64")
    with pytest.raises(gsut.InputError, match="renders in float32"):
        drawn.add_map(np.zeros((SIZE, SIZE, 1)), np.zeros((len(gaussians), 1), np.float32))


def test_file_of_lifted_values_comes_back_and_damaged_ones_are_refused(tmp_path):
    lifted = Lifted(
        np.eye(3, 2, dtype=np.float32), np.arange(3, dtype=np.float32), np.array([2, 7])
    )
    lifted.save(tmp_path / "a.npz")
    found = Lifted.load(tmp_path / "a.npz")
    assert np.array_equal(found.features, lifted.features)
    assert found.labels.tolist() == [-1, 7, 2]
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    np.savez(tmp_path / "short.npz", features=np.zeros((3, 2)), weights=np.zeros(2))
    np.savez(tmp_path / "nan.npz", features=np.full((3, 2), np.nan), weights=np.zeros(3))
    bad = {
        "cut": "no file of `gsut lift`", "other": "it holds points",
        "short": r"weights: .* shape \(2,\), expected \(3\)", "nan": "holds NaN",
        "absent": "no such file",
    }  # fmt: skip
    for name, message in bad.items():
        with pytest.raises(gsut.InputError, match=message):
            Lifted.load(tmp_path / f"{name}.npz")
    with pytest.raises(gsut.InputError, match=r"written as \.npz"):
        lifted.save(tmp_path / "a.ply")


def test_lift_and_render_commands_write_labels_that_meet_the_held_out_maps(
    dataset, tmp_path, capsys
):
    folder, scene, _ = dataset
    data, file, maps = (str(folder / name) for name in ("data", "scene.ply", "maps"))
    out = str(tmp_path / "labels.npz")
    words = ["lift", data, file, maps, "--labels", "--unknown", "255", "-o", out]
    assert main([*words, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert (figures["labels"], figures["maps"]) == (2, len(scene.views))
    assert figures["right"] > 0.9
    assert main(words) == 2  # the file exists
    assert "labels.npz" in capsys.readouterr().err
    pictures = tmp_path / "pictures"
    words = ["render", file, "--data", data, "--path", "test", "-o", str(pictures)]
    assert main([*words, "--lifted", out]) == 0
    written = sorted((pictures / "lifted").iterdir())
    assert len(written) == len(scene.test_indices)
    shown = cv2.imread(str(written[0]), cv2.IMREAD_UNCHANGED)
    true = cv2.imread(str(folder / "maps" / "000.png"), cv2.IMREAD_UNCHANGED)
    assert shown.dtype == np.uint16
    assert set(np.unique(shown).tolist()) <= {4, 9, 65535}
    assert np.mean((shown == true)[true != 255]) > 0.9
    capsys.readouterr()
    film = str(tmp_path / "a.mp4")
    (tmp_path / "empty").mkdir()
    refused = [
        (["lift", data, file, str(tmp_path / "none"), "-o", film + ".npz"], "no such folder"),
        (
            ["lift", data, file, str(tmp_path / "empty"), "-o", film + ".npz"],
            "has no map of a view",
        ),
        (["lift", data, file, maps, "-o", film], "written as .npz"),
        (["lift", data, file, maps, "--unknown", "1", "-o", film + ".npz"], "add --labels"),
        (["render", file, "-o", film, "--lifted", out], "a film has no lifted values"),
    ]
    for words, message in refused:
        assert main(words) == 2, words
        assert message in capsys.readouterr().err


def test_lift_command_prints_the_error_of_numbers_on_held_out_views(dataset, tmp_path, capsys):
    folder, scene, _ = dataset
    (tmp_path / "warm").mkdir()
    for index in range(len(scene.views)):
        np.save(tmp_path / "warm" / f"{index:03d}.npy", np.full((SIZE, SIZE), 21.5))
    words = ["lift", str(folder / "data"), str(folder / "scene.ply"), str(tmp_path / "warm")]
    assert main([*words, "-o", str(tmp_path / "warm.npz")]) == 0
    assert "off by" in capsys.readouterr().out
    np.save(tmp_path / "warm" / "001.npy", np.full((SIZE, SIZE, 2), 21.5))
    assert main([*words, "-o", str(tmp_path / "other.npz")]) == 2
    assert "the map of" in capsys.readouterr().err
