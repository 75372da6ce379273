"""`./run bench formats`: a row a format with its PSNR, and scenes made larger by splitting."""

import numpy as np

import gsut
from gsut import formats
from rendered_dataset import truth, write_dataset
from tests.bench.formats_bench import measure, split
from tolerances import BENCH_SPLIT_SHARE


def test_rows_hold_bytes_and_psnr_of_every_format(tmp_path, rng):
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng))
    named = []
    rows = measure(scene, truth(rng), (0.0, 0.0, 0.0), named.append)
    assert [row["format"] for row in rows] == named
    assert {name.removesuffix(" 3").removesuffix(" 4") for name in named} == {
        each.name for each in formats.formats()
    }
    by_name = {row["format"]: row for row in rows}
    assert by_name["PLY"]["psnr"] == by_name["glTF"]["psnr"] == 99.9
    assert by_name["SPZ 3"]["bytes_each"] < by_name["PLY"]["bytes_each"]
    for name in ("SPZ 3", "SOG", "compressed PLY"):
        assert 30 < by_name[name]["psnr"] < 99.9
    assert "psnr" not in by_name["HTML"] and by_name["HTML"]["write_cpu_s"] > 0


def test_split_gaussians_fill_the_same_space_with_more(rng):
    g = truth(rng, 200)
    more = split(g, 10)
    assert len(more) == 2000 and split(g, 1) is g
    moved = np.linalg.norm(more.means - np.repeat(g.means, 10, axis=0), axis=1)
    assert 0 < np.median(moved) < np.exp(g.log_scales).max()
    volume = np.exp(np.mean(more.log_scales.sum(axis=1) - np.repeat(g.log_scales, 10, 0).sum(1)))
    np.testing.assert_allclose(volume, 0.1, rtol=BENCH_SPLIT_SHARE)
