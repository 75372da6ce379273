"""A lens from a table of pixels and rays."""

import numpy as np
import pytest

import gsut
import small_datasets
import tolerances
from gsut.cli import main

LENSES = [
    gsut.Camera("kannala_brandt", [134.6, 134.9, 241.3, 238.9, 0.035, -0.012, 0.0035, -6e-4],
                480, 480),
    gsut.Camera("opencv4", [305.0, 306.2, 243.7, 177.4, -0.2, 0.05, 1.6e-3, -1.1e-3], 480, 360),
    gsut.Camera("pinhole", [305.0, 306.2, 243.7, 177.4], 480, 360),
]  # fmt: skip


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_fit_of_a_lens_own_rays_gives_the_lens_again(lens, rng):
    pixels = rng.uniform([0, 0], [lens.width, lens.height], (600, 2))
    rays = np.array(lens.unproject(pixels)[0])  # NaN outside the domain: does not count
    known = np.isfinite(rays[:, 0])
    found = gsut.lens.fit_camera(
        pixels, 3 * rays, model=lens.model, width=lens.width, height=lens.height
    )
    off = np.abs(found.project(rays[known])[0] - pixels[known]).max()
    print(f"{lens.model}: {off:.1e} px")
    assert off < tolerances.FIT_OF_OWN_RAYS


def test_fit_by_another_model_is_near(rng):
    lens = LENSES[0]
    pixels = rng.uniform(100, 380, (400, 2))
    rays = lens.unproject(pixels)[0]
    found = gsut.lens.fit_camera(pixels, rays, model="opencv8", width=480, height=480)
    assert np.abs(found.project(rays)[0] - pixels).max() < tolerances.FIT_BY_ANOTHER_MODEL


@pytest.mark.parametrize(
    ("pixels", "rays", "model", "said"),
    [
        (np.ones((9, 2)), np.ones((8, 3)), "pinhole", "9 pixels, but 8 rays"),
        (np.ones((9, 2)), np.full((9, 3), np.nan), "pinhole", "a fit needs 8"),
        (np.ones((9, 2)), np.tile([0.0, 0, 1], (9, 1)), "pinhole", "do not spread"),
    ],
)
def test_table_that_gives_no_lens_is_refused(pixels, rays, model, said):
    with pytest.raises(gsut.InputError, match=said):
        gsut.lens.fit_camera(pixels, rays, model=model, width=10, height=10)


def table_of(lens, rng, count=500):
    pixels = rng.uniform([0, 0], [lens.width, lens.height], (count, 2))
    return pixels, 2 * np.array(lens.unproject(pixels)[0])


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
@pytest.mark.parametrize("kind", ["csv", "csv from 0", "npz"])
def test_file_of_pixels_and_rays_is_a_lens(lens, kind, tmp_path, rng, capsys):
    pixels, rays = table_of(lens, rng)
    path = tmp_path / f"lens.{kind[:3]}"
    if kind == "npz":
        np.savez(path, pixels=pixels, rays=rays, width=lens.width, height=lens.height)
    else:
        zero = kind != "csv"
        rows = np.column_stack([rays, pixels - 0.5 * zero])
        head = f"# width: {lens.width}\n# height = {lens.height}\n"
        head += "# pixel_center: 0\n" if zero else ""
        body = "\n".join(",".join(repr(float(v)) for v in row) for row in rows)
        path.write_text(f"{head}rx,ry,rz,x,y\n{body}\n")
    found = gsut.load_camera(path)
    known = np.isfinite(rays[:, 0])
    assert np.abs(found.project(rays[known])[0] - pixels[known]).max() < tolerances.FIT_OF_OWN_RAYS
    assert main(["camera", "convert", str(path), found.model, "-o", str(tmp_path / "o.yaml")]) == 0


def test_file_of_pixels_and_rays_is_the_lens_of_a_dataset(tmp_path, rng):
    small_datasets.write_folder(tmp_path / "data")
    (lens,) = gsut.load_dataset(tmp_path / "data").cameras
    (tmp_path / "data" / "cameras.txt").unlink()
    pixels, rays = table_of(lens, rng)
    np.savez(tmp_path / "data" / "lens.npz", pixels=pixels, rays=rays, width=lens.width,
             height=lens.height)  # fmt: skip
    (found,) = gsut.load_dataset(tmp_path / "data").cameras
    np.testing.assert_allclose(found.params[:4], lens.params[:4], rtol=1e-6)


def test_file_of_pixels_and_rays_of_no_known_lens_is_refused(tmp_path, rng):
    pixels, rays = table_of(LENSES[2], rng)
    np.savez(
        tmp_path / "a.npz", pixels=pixels, rays=rays[::-1], width=480, height=360, model="pinhole"
    )
    with pytest.raises(gsut.CalibrationError, match=r"fits the table to 0\.5 pixels"):
        gsut.load_camera(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", pixels=pixels, width=480, height=360)
    with pytest.raises(gsut.CalibrationError, match=r"give pixels \(N, 2\), rays"):
        gsut.load_camera(tmp_path / "b.npz")
