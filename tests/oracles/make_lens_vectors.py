"""Makes lens_vectors.json: pixels of the example lenses by pycolmap and libmrcal.

Run by hand when a lens or an example is added; the tests read the file only. Needs pycolmap,
libmrcal (mrcal_project.cpp beside this file, built as its first lines say) and gsut itself:

    python make_lens_vectors.py path/to/mrcal_project lens_vectors.json
"""

import json
import subprocess
import sys

import numpy as np
import pycolmap

from gsut import _core

POINTS = 48
# gsut's lens -> COLMAP's model and its parameters.
COLMAP = {
    "division": ("DIVISION", lambda p: p),
    "equirectangular": ("EQUIRECTANGULAR", None),
    "extended_unified": ("EUCM", lambda p: p),
    "fisheye624": ("RAD_TAN_THIN_PRISM_FISHEYE", lambda p: p),
    "fov": ("FOV", lambda p: p),
    "thin_prism_fisheye": ("THIN_PRISM_FISHEYE", lambda p: p),
    "unified": ("EUCM", lambda p: [*p, 1.0]),
}
# gsut's lens -> libmrcal's model; its pixel (0, 0) is gsut's (0.5, 0.5).
MRCAL = {
    "cahvor": "LENSMODEL_CAHVOR",
    "cahvore": "LENSMODEL_CAHVORE",
    "latlon": "LENSMODEL_LATLON",
    "lonlat": "LENSMODEL_LONLAT",
    "stereographic": "LENSMODEL_STEREOGRAPHIC",
    "splined_stereographic": "LENSMODEL_SPLINED_STEREOGRAPHIC",
}
# These stop at 90 degrees where gsut goes on.
FRONT_ONLY = ("fov", "fisheye624", "thin_prism_fisheye")


def directions(rng, max_angle):
    """Evenly in angle, all azimuths, lengths 0.5 to 3; none within 0.2 rad of a pole."""
    found = []
    while len(found) < POINTS:
        angle, azimuth = rng.uniform(0, max_angle), rng.uniform(0, 2 * np.pi)
        ray = np.array(
            [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
        )
        if max(abs(ray[0]), abs(ray[1])) < np.cos(0.2):
            found.append(ray * rng.uniform(0.5, 3.0))
    return np.array(found)


def colmap_pixels(model, params, width, height, points):
    name, convert = COLMAP[model]
    values = [width, height] if convert is None else convert(list(params))
    camera = pycolmap.Camera(model=name, width=width, height=height, params=values)
    nothing = np.full(2, np.nan)
    found = [camera.img_from_cam(point) for point in points]
    return np.array([nothing if pixel is None else pixel for pixel in found])


def mrcal_pixels(program, model, params, points):
    name, values = MRCAL[model], np.array(params)
    if model == "splined_stereographic":
        order, nx, ny, fov = (int(value) for value in values[:4])
        name += f"_order={order}_Nx={nx}_Ny={ny}_fov_x_deg={fov}"
        values = values[4:]
    if model == "cahvore":
        name += f"_linearity={values[-1]:.2f}"
        values = values[:-1]
    values[2:4] -= 0.5
    rows = [[len(values)], values.tolist(), [len(points)], points.ravel().tolist()]
    text = "\n".join([name, *(" ".join(map(repr, row)) for row in rows)])
    answer = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return np.array(answer.stdout.split(), float).reshape(-1, 2) + 0.5


def main():
    rng = np.random.default_rng(7)
    vectors = []
    # cahvore came later and is drawn last: the others stay as they are.
    for model in sorted((*COLMAP, *MRCAL), key=lambda model: (model == "cahvore", model)):
        for _, params, width, height in _core.camera_examples(model):
            limit = 0.98 * _core.Camera(model, params, width, height).max_angle
            if model in FRONT_ONLY:
                limit = min(limit, np.radians(88))
            points = directions(rng, limit)
            if model == "cahvore":
                # Its image depends on the distance; libmrcal takes every point at distance 1.
                points /= np.linalg.norm(points, axis=1, keepdims=True)
            if model in COLMAP:
                oracle = f"pycolmap {pycolmap.__version__}"
                pixels = colmap_pixels(model, params, width, height, points)
            else:
                oracle, pixels = "libmrcal 2.2", mrcal_pixels(sys.argv[1], model, params, points)
            keep = np.isfinite(pixels).all(axis=1)
            # Of the splined lens, gsut leaves out what lies beyond the control points.
            keep &= _core.Camera(model, params, width, height).project(points)[1]
            print(model, width, oracle, keep.sum(), "of", POINTS)
            vectors.append(
                {
                    "model": model,
                    "params": list(params),
                    "width": width,
                    "height": height,
                    "oracle": oracle,
                    "points": points[keep].tolist(),
                    "pixels": pixels[keep].tolist(),
                }
            )
    with open(sys.argv[2], "w", encoding="utf-8") as out:
        out.write("[\n" + ",\n".join(json.dumps(vector) for vector in vectors) + "\n]\n")


if __name__ == "__main__":
    main()
