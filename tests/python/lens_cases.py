"""The lenses that the camera tests loop over, and the points they look at."""

import json

import numpy as np

from gsut import _core
from gsut.lens.camera import Camera, camera_models

# Lenses that OpenCV has too.
OPENCV = ["kannala_brandt", "opencv12", "opencv14", "opencv4", "opencv5", "opencv8", "pinhole"]
_RATIONAL = (0.12, -0.05, 3e-3, -2e-3, 0.01, 0.08, -0.02, 5e-3)
_BARREL = (-0.2, 0.05, 1e-3, 2e-3, 0.01, 0.02, -0.01, 0.005)
# Beside the real lenses that each model's file carries: folds, poles, strong terms.
HARD_LENSES = [
    ("pinhole", [0.5, 1.5, 7.3, 2.1], 15, 5),
    ("opencv4", [305, 306.2, 243.7, 177.4, -0.3, 0.1, 0.016, -0.011], 480, 360),
    ("opencv5", [305, 306.2, 243.7, 177.4, -0.3, 0.1, 0.0016, -0.0011, -0.014], 480, 360),
    ("opencv5", [300, 300, 240, 180, 0, 0, 0.02, -0.03, 0], 480, 360),
    ("opencv8", [500, 500, 320, 240, 0, 0, 0, 0, 0, -0.25, 0, 0], 640, 480),
    ("opencv8", [500, 500, 320, 240, 0.3, 0.1, 1e-3, 2e-3, 0, -0.05, -0.1, 0], 640, 480),
    ("opencv12", [60, 58, 32.3, 23.6, *_RATIONAL, 2e-3, -1e-3, -1.5e-3, 8e-4], 64, 48),
    ("opencv14", [500, 510, 320, 240, *_BARREL, 0.01, -2e-3, 0.02, 3e-3, 0.2, -0.3], 640, 480),
    ("kannala_brandt", [134.61, 134.88, 241.3, 238.9], 480, 480),
    ("kannala_brandt", [300, 310, 320, 240, -0.2], 640, 480),
    ("kannala_brandt", [26, 25.5, 31.7, 24.2, 0.05, -0.01, 0.003, -0.0005, 1e-5, -1e-6], 64, 48),
    ("unified", [190, 191, 320, 240, 0.0], 640, 480),
    ("unified", [190, 191, 320, 240, 0.5], 640, 480),
    ("unified", [190, 191, 320, 240, 1.0], 640, 480),
    ("extended_unified", [190, 191, 320, 240, 0.4, 0.3], 640, 480),
    ("extended_unified", [190, 191, 320, 240, 0.9, 3.0], 640, 480),
    ("double_sphere", [190, 191, 320, 240, -0.6, 0.2], 640, 480),
    ("double_sphere", [190, 191, 320, 240, 0.9, 0.6], 640, 480),
    ("double_sphere", [190, 191, 320, 240, 0.0, 0.5], 640, 480),
    ("division", [300, 305, 320, 240, 0.0], 640, 480),
    ("division", [300, 305, 320, 240, 0.6], 640, 480),
    ("division", [300, 305, 320, 240, -2.0], 640, 480),
    ("fov", [300, 305, 320, 240, 3.0], 640, 480),
    ("fov", [300, 305, 320, 240, 1e-5], 640, 480),
    ("mei", [300, 305, 320, 240, 2.0, 1.0, 0.01, 0.001, 1e-3, -2e-3], 640, 480),
    ("mei", [300, 305, 320, 240, 0.0, 0.0, -0.2, 0.01, 0.0, 0.0], 640, 480),
    ("mei", [300, 305, 320, 240, 0.0, 1.4, 0.0, 0.0, 0.0, 0.0], 640, 480),
    (
        "thin_prism_fisheye",
        [90, 91, 128, 120, 0.1, -0.05, 5e-3, -6e-3, 0.01, 0, 0.02, 0.01],
        256,
        240,
    ),
    ("fisheye624", [90, 91, 128, 120, *[0.0] * 12], 256, 240),
    ("equirectangular", [], 64, 32),
    ("equirectangular", [], 101, 77),
    ("cahvor", [300, 305, 320, 240, 0.2, -0.3, 0.01, -0.1, 0.02], 640, 480),
    ("stereographic", [9.0, 3.0, 20.0, 20.0], 64, 48),
]


def all_lenses() -> list[Camera]:
    """Every real lens of every model whose rays meet in one point, then the hard ones."""
    return [camera for camera in real_lenses() if camera.is_central] + [
        Camera(*lens) for lens in HARD_LENSES
    ]


def real_lenses() -> list[Camera]:
    """Every real lens of every model; see test_lines.py for those whose rays do not meet."""
    return examples(*camera_models())


def traits(model: str) -> _core.LensTraits:
    """What the lens' file says of it."""
    return _core.camera_traits(model)


def centre(camera: Camera) -> np.ndarray:
    """(2,) the image of the axis, in pixels."""
    return camera.project(np.array([[0.0, 0.0, 1.0]]))[0][0]


def circle(angle: float, count: int) -> np.ndarray:
    """(count, 3) unit rays at this angle from the axis, evenly around it."""
    phi = np.linspace(0, 2 * np.pi, count, endpoint=False)
    z = np.full(count, np.cos(angle))
    return np.stack([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), z], axis=1)


def polar_grid(max_angle: float, azimuths: int = 64, angles: int = 200) -> np.ndarray:
    """(N, 3) unit rays: the axis, very near it, then circles evenly up to max_angle."""
    near = [angle for angle in (0.0, *10.0 ** np.arange(-12, -1)) if angle < max_angle]
    far = np.linspace(min(0.01, max_angle), max_angle, angles)
    return np.concatenate([circle(angle, azimuths) for angle in (*near, *far)])


def examples(*models: str) -> list[Camera]:
    """The lenses that the files of these models carry as their examples."""
    return [
        Camera(model, params, width, height)
        for model in models
        for _, params, width, height in _core.camera_examples(model)
    ]


# Lens files that gsut reads and does not write: 128 x 96, fx 90, fy 91.25, k1 0.25.
FOREIGN_FILES = {
    name: json.dumps(values, indent=1)
    for name, values in {
        "aria.json": {"cameras": {"camera-rgb": {
            "model": "KANNALA_BRANDT_K3", "size": [128, 96],
            "params": [90.0, 91.25, 63.5, 47.5, 0.25, 0.0, 0.0, 0.0],
        }}},
        "matlab.json": {
            "ImageSize": [96, 128], "FocalLength": [90.0, 91.25], "PrincipalPoint": [64.5, 48.5],
            "RadialDistortion": [0.25, 0.0, 0.0], "TangentialDistortion": [0.0, 0.0], "Skew": 0.0,
        },
        "camera_models.json": {"camera": {
            "projection_type": "brown", "width": 128, "height": 96, "focal_x": 90 / 128,
            "focal_y": 91.25 / 128, "c_x": 0.0, "c_y": 0.0, "k1": 0.25, "k2": 0.0,
        }},
    }.items()
} | {
    "calibration.xml": "<calibration>\n <projection>frame</projection>\n <width>128</width>\n"
    " <height>96</height>\n <f>91.25</f>\n <b1>-1.25</b1>\n <cx>0.0</cx>\n <cy>0.0</cy>\n"
    " <k1>0.25</k1>\n</calibration>\n",
    "calib_results.txt": "5 -90.0 0.0 1e-3 0.0 0.0\n\n3 1.0 1.0 1.0\n\n47.5 63.625\n\n"
    "1.0 0.0 0.0\n\n96 128\n",
}  # fmt: skip
