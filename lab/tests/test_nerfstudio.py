"""A dataset that gsut writes, in nerfstudio's own parser, where a Python has it: same rays."""

import os
import subprocess

import numpy as np
import pytest

import gsut
from gsut.data import Frame, write_transforms
from gsut.data.points import format_points_ply
from gsut.render.pictures import to_uint8, write_png
from lab_tolerances import NERFSTUDIO_RAYS
from rendered_dataset import poses, truth

# A Python of its own: nerfstudio asks for versions that these tests have not.
PYTHON = os.environ.get("GSUT_NERFSTUDIO_PYTHON")
pytestmark = pytest.mark.skipif(
    PYTHON is None, reason="GSUT_NERFSTUDIO_PYTHON does not name a Python with nerfstudio"
)
PARSE = """
import sys
from pathlib import Path
import numpy as np
import torch
from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig

parser = NerfstudioDataParserConfig(data=Path(sys.argv[1]), load_3D_points=True).setup()
pixels = torch.tensor(np.load(sys.argv[2]))
out = {}
for split in ("train", "val", "test"):
    found = parser.get_dataparser_outputs(split)
    out[split] = [path.name for path in found.image_filenames]
    rays = found.cameras.generate_rays(torch.zeros(len(pixels), 1, dtype=torch.long), pixels)
    turn, scale = found.dataparser_transform.numpy(), found.dataparser_scale
    out[split + "_rays"] = rays.directions.numpy() @ turn[:, :3]
    out[split + "_at"] = (rays.origins[0].numpy() / scale - turn[:, 3]) @ turn[:, :3]
    if "points3D_xyz" in found.metadata:  # read by Open3D
        points = found.metadata["points3D_xyz"].numpy()
        out[split + "_points"] = (points / scale - turn[:, 3]) @ turn[:, :3]
np.savez(sys.argv[3], **out)
"""
LENSES = (
    gsut.Camera("pinhole", [50, 51, 31, 25], 64, 48),
    gsut.Camera("opencv5", [50, 51, 31, 25, -0.1, 0.02, 1e-3, -2e-3, 0.0], 64, 48),
    gsut.Camera("kannala_brandt", [30, 31, 32, 24, 0.02, -0.01, 0.002, 0.0], 64, 48),
    gsut.Camera("equirectangular", [], 64, 32),
)


@pytest.mark.parametrize("camera", LENSES, ids=[lens.model for lens in LENSES])
def test_splits_poses_rays_and_points_are_those_that_were_written(tmp_path, rng, camera):
    frames = []
    for number, pose in enumerate(poses()):
        path = tmp_path / "images" / f"{number}.png"
        path.parent.mkdir(exist_ok=True)
        write_png(path, to_uint8(gsut.render(truth(rng), camera, pose).image))
        frames.append(Frame(f"images/{path.name}", path, camera, np.linalg.inv(pose)))
    points = rng.normal(size=(50, 3))
    (tmp_path / "points.ply").write_bytes(format_points_ply(points, np.zeros((50, 3), np.uint8)))
    test = [f"images/{number}.png" for number in (0, 6)]
    write_transforms(tmp_path / "transforms.json", frames, points_file="points.ply", test=test)
    y, x = np.mgrid[8 : camera.height - 8 : 4, 8 : camera.width - 8 : 4] + 0.5
    np.save(tmp_path / "pixels.npy", np.stack([y.ravel(), x.ravel()], 1).astype(np.float32))
    words = [tmp_path, tmp_path / "pixels.npy", tmp_path / "out.npz"]
    subprocess.run([PYTHON, "-c", PARSE, *map(str, words)], check=True)
    found = np.load(tmp_path / "out.npz")
    assert list(found["val"]) == list(found["test"]) == ["0.png", "6.png"]
    assert len(found["train"]) == 10
    rays, _ = camera.unproject(np.stack([x.ravel(), y.ravel()], 1))
    for split in ("train", "val", "test"):
        pose = poses()[int(found[split][0].split(".")[0])]
        directions = rays @ pose[:3, :3]
        np.testing.assert_allclose(found[f"{split}_rays"], directions, atol=NERFSTUDIO_RAYS)
        center = -pose[:3, :3].T @ pose[:3, 3]
        np.testing.assert_allclose(found[f"{split}_at"], center, atol=NERFSTUDIO_RAYS)
        if f"{split}_points" in found:
            np.testing.assert_allclose(found[f"{split}_points"], points, atol=NERFSTUDIO_RAYS)
