"""Lens files of Metashape, OpenSfM, MATLAB and Open3D against the formulae of their manuals."""

import json

import numpy as np
import pytest

import tolerances as tol
from gsut import InputError
from gsut.lens import Camera, load_camera

FRAME = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>{projection}</projection>
  <width>1920</width>
  <height>1080</height>
  <f>1430.15016509976</f>
  <cx>-24.1342060175983</cx>
  <cy>17.5452248329602</cy>
  <b1>3.5</b1>
  <b2>-4.25145544487403</b2>
  <k1>-0.0118322055927498</k1>
  <k2>0.0293632083518507</k2>
  <k3>-0.0021</k3>
  <k4>0.0003</k4>
  <p1>0.000330080086304322</p1>
  <p2>0.00182154893322038</p2>
</calibration>
"""
# Of exported cameras: the sensors' calibrations, as given and as adjusted.
CHUNK = """<document><chunk><sensors>
 <sensor id="0" label="left" type="frame"><resolution width="640" height="480"/>
  <calibration type="frame" class="initial"><resolution width="640" height="480"/><f>300</f>
  </calibration>
  <calibration type="frame" class="adjusted"><resolution width="640" height="480"/><f>310</f>
   <k1>-0.1</k1></calibration></sensor>
 <sensor id="1" label="ball" type="spherical"><resolution width="200" height="100"/>
  <calibration type="spherical" class="initial"><resolution width="200" height="100"/></calibration>
 </sensor></sensors></chunk></document>
"""


def rays_ahead(rng: np.random.Generator, widest: float) -> np.ndarray:
    angle, azimuth = rng.uniform(0.001, widest, 300), rng.uniform(0, 2 * np.pi, 300)
    sine = np.sin(angle)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(angle)], axis=1)


def metashape_pixels(rays: np.ndarray, projection: str) -> np.ndarray:
    """The manual's appendix: distortion in its own names, b1, b2, offsets from the middle."""
    x, y = (rays[:, :2] / rays[:, 2:]).T
    if projection == "fisheye":
        radius = np.hypot(x, y)
        x, y = (value * np.arctan(radius) / radius for value in (x, y))
    r = np.hypot(x, y)
    k1, k2, k3, k4 = -0.0118322055927498, 0.0293632083518507, -0.0021, 0.0003
    p1, p2 = 0.000330080086304322, 0.00182154893322038
    g = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6 + k4 * r**8
    x, y = (
        x * g + p1 * (r**2 + 2 * x**2) + 2 * p2 * x * y,
        y * g + p2 * (r**2 + 2 * y**2) + 2 * p1 * x * y,
    )
    f, b1, b2 = 1430.15016509976, 3.5, -4.25145544487403
    u = 0.5 * 1920 - 24.1342060175983 + x * f + x * b1 + y * b2
    return np.stack([u, 0.5 * 1080 + 17.5452248329602 + y * f], axis=1)


@pytest.mark.parametrize(
    ("projection", "model"), [("frame", "brown_conrady"), ("fisheye", "brown_fisheye")]
)
def test_metashape_calibration_is_its_manual(tmp_path, rng, projection, model):
    path = tmp_path / "calibration.xml"
    path.write_text(FRAME.format(projection=projection))
    camera = load_camera(path)
    assert (camera.model, camera.width, camera.height) == (model, 1920, 1080)
    rays = rays_ahead(rng, 0.8)
    pixels, valid = camera.project(rays)
    assert valid.all()
    expected = metashape_pixels(rays, projection)
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=tol.CV2_PIXELS)


def test_metashape_cameras_give_the_adjusted_calibration_of_a_sensor(tmp_path):
    path = tmp_path / "cameras.xml"
    path.write_text(CHUNK)
    left = load_camera(path, camera_id="left")
    assert left == load_camera(path, camera_id=0) and left.params[0] == 310
    assert load_camera(path, camera_id=1) == Camera("equirectangular", [], 200, 100)
    with pytest.raises(InputError, match=r"2 sensors; give camera_id, one of 0 \(left\)"):
        load_camera(path)
    with pytest.raises(InputError, match="no sensor 7"):
        load_camera(path, camera_id=7)


def opensfm_pixels(rays: np.ndarray, entry: dict) -> np.ndarray:
    """OpenSfM's documentation: normalised by the longer side, from the middle of the image."""
    kind, unit = entry["projection_type"], max(entry["width"], entry["height"])
    x, y = (rays[:, :2] / rays[:, 2:]).T
    get = entry.get
    if kind.startswith("fisheye"):
        radius = np.hypot(x, y)
        theta = np.arctan2(radius, 1.0)
        g = sum(get(f"k{i}", 0.0) * theta ** (2 * i) for i in range(1, 7)) + 1
        x, y = (value * theta / radius * g for value in (x, y))
        r2 = x**2 + y**2
        s = [get(f"s{i}", 0.0) for i in range(4)]
        prism_x, prism_y = s[0] * r2 + s[1] * r2**2, s[2] * r2 + s[3] * r2**2
        p1, p2 = get("p1", 0.0), get("p2", 0.0)
        x, y = (
            x + 2 * p2 * x * y + p1 * (r2 + 2 * x**2) + prism_x,
            y + 2 * p1 * x * y + p2 * (r2 + 2 * y**2) + prism_y,
        )
    else:
        r2 = x**2 + y**2
        g = 1 + get("k1", 0.0) * r2 + get("k2", 0.0) * r2**2 + get("k3", 0.0) * r2**3
        p1, p2 = get("p1", 0.0), get("p2", 0.0)
        x, y = (
            x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            y * g + 2 * p2 * x * y + p1 * (r2 + 2 * y**2),
        )
    focal = [get("focal_x", get("focal")), get("focal_y", get("focal"))]
    center = [get("c_x", 0.0), get("c_y", 0.0)]
    normalised = np.stack([x, y], axis=1) * focal + center
    return normalised * unit + 0.5 * np.array([entry["width"], entry["height"]])


TWO = {"focal_x": 0.81, "focal_y": 0.82, "c_x": 0.01, "c_y": -0.02}
OPENSFM = [
    ({"focal": 0.9, "k1": -0.1, "k2": 0.02}, "perspective", "opencv4"),
    ({**TWO, "k1": -0.1}, "simple_radial", "opencv4"),
    ({**TWO, "k1": -0.1, "k2": 0.01}, "radial", "opencv4"),
    ({**TWO, "k1": -0.1, "k2": 0.02, "k3": 0.003, "p1": 1e-3, "p2": -2e-3}, "brown", "opencv5"),
    ({"focal": 0.4, "k1": -0.01, "k2": 0.002}, "fisheye", "kannala_brandt"),
    ({**TWO, "k1": 0.01, "k2": -0.002, "k3": 3e-4, "k4": 1e-5}, "fisheye_opencv", "kannala_brandt"),
    ({**TWO, "k1": 0.01, "k2": -0.002, "p1": 1e-3, "p2": -2e-3}, "fisheye62", "fisheye624"),
    ({**TWO, "k1": 0.01, "p1": 1e-3, "s0": 1e-3, "s3": -1e-3}, "fisheye624", "fisheye624"),
]


@pytest.mark.parametrize(("values", "kind", "model"), OPENSFM, ids=[row[1] for row in OPENSFM])
def test_opensfm_camera_is_its_documentation(tmp_path, rng, values, kind, model):
    entry = {"projection_type": kind, "width": 640, "height": 480, **values}
    path = tmp_path / "camera_models.json"
    path.write_text(json.dumps({"v2 a phone": entry}))
    camera = load_camera(path)
    assert camera.model == model
    rays = rays_ahead(rng, 0.6)
    pixels, valid = camera.project(rays)
    assert valid.all()
    np.testing.assert_allclose(pixels, opensfm_pixels(rays, entry), rtol=0, atol=tol.CV2_PIXELS)


def test_opensfm_cameras_are_chosen_by_name(tmp_path):
    sphere = {"projection_type": "spherical", "width": 64, "height": 32}
    dual = {"projection_type": "dual", "width": 64, "height": 32, "focal": 1.0}
    path = tmp_path / "camera_models.json"
    path.write_text(json.dumps({"ball": sphere, "odd": dual}, indent=1))
    assert load_camera(path, camera_id="ball") == Camera("equirectangular", [], 64, 32)
    with pytest.raises(InputError, match="2 cameras; give camera_id, one of ball, odd"):
        load_camera(path)
    with pytest.raises(InputError, match=r"line 8.*'dual' is not supported"):
        load_camera(path, camera_id="odd")


def test_matlab_camera_counts_pixels_from_one(tmp_path):
    values = {
        "FocalLength": [715.27, 710.49], "PrincipalPoint": [565.67, 355.86],
        "ImageSize": [712, 1072], "RadialDistortion": [-0.33, 0.11],
        "TangentialDistortion": [1e-3, -2e-3], "Skew": 0,
    }  # fmt: skip
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(values))
    params = [715.27, 710.49, 565.17, 355.36, -0.33, 0.11, 1e-3, -2e-3, 0.0]
    assert load_camera(path) == Camera("opencv5", params, 1072, 712)
    path.write_text(json.dumps({**values, "Skew": 1.5}))
    skewed = load_camera(path)
    assert skewed.model == "brown_conrady" and skewed.params[4] == 1.5
    np.testing.assert_array_equal(skewed.params[5:], [-0.33, 0.11, 0, 0, 1e-3, -2e-3])


def test_open3d_intrinsics_are_by_columns(tmp_path):
    matrix = [525.0, 0.0, 0.0, 0.0, 526.0, 0.0, 319.5, 239.5, 1.0]
    path = tmp_path / "camera_primesense.json"
    path.write_text(json.dumps({"width": 640, "height": 480, "intrinsic_matrix": matrix}))
    assert load_camera(path) == Camera("pinhole", [525, 526, 320, 240], 640, 480)
