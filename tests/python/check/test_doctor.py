"""`gsut doctor`: good data stay quiet, and each fault is named with its advice."""

import shutil

import cv2
import numpy as np
import pytest

import small_datasets as small
from gsut.check import Finding, diagnose, format_findings

D = small.OPENGL_FROM_OPENCV


def findings(path, severity=None) -> list[Finding]:
    found = diagnose(path, progress=False)
    return [f for f in found if severity is None or f.severity == severity]


def texts(path, severity=None) -> str:
    return "\n".join(str(finding) for finding in findings(path, severity))


def write(path, change=lambda values: None):
    values = small.transforms()
    change(values)
    return small.write_nerfstudio(path, values)


def change_poses(change):
    def apply(values):
        for frame in values["frames"]:
            frame["transform_matrix"] = change(np.array(frame["transform_matrix"])).tolist()

    return apply


def test_diagnose_good_dataset_has_no_errors_or_warnings(tmp_path):
    found = findings(write(tmp_path))
    assert [str(f) for f in found if f.severity != "info"] == []
    assert any("agree with the pixels" in f.what for f in found)
    assert all(f.where and f.what for f in found)


def test_diagnose_several_errors_are_all_found(tmp_path):
    def change(values):
        values["frames"][1]["transform_matrix"][0][0] = float("nan")
        values["frames"][2]["transform_matrix"][0] = [9, 9, 9, 9]
        values["frames"][3]["camera_model"] = "BOX"

    write(tmp_path, change)
    small.write_png(tmp_path / "images/004.png", np.zeros((9, 9, 3), np.uint8))
    image = tmp_path / "images/005.png"
    image.write_bytes(image.read_bytes()[:-100])
    (tmp_path / "points3D.ply").write_text("ply\n")
    errors = findings(tmp_path, "error")
    assert len(errors) == 6
    joined = "\n".join(map(str, errors))
    for part in ("001.png", "002.png", "BOX", "004.png", "005.png", "points3D.ply"):
        assert part in joined


def test_diagnose_one_broken_lens_is_reported_once(tmp_path):
    write(tmp_path, lambda values: values.update(fl_x=float("inf")))
    errors = findings(tmp_path, "error")
    assert sum("fl_x" in e.what or "fl_x" in e.where for e in errors) == 1


def test_findings_text_counts_and_sorts_errors_first(tmp_path):
    found = [Finding("info", "a", "b"), Finding("error", "c", "d", "e")]
    assert format_findings(found).endswith("1 errors, 0 warnings: training cannot start")
    write(tmp_path)
    (tmp_path / "images/004.png").write_bytes(b"")
    severities = [f.severity for f in findings(tmp_path)]
    assert severities[0] == "error" and severities == sorted(
        severities, key=["error", "warning", "info"].index
    )


@pytest.mark.parametrize("change", [lambda m: m @ D, np.linalg.inv])
def test_diagnose_wrong_pose_convention_is_noticed(change, tmp_path):
    text = texts(write(tmp_path, change_poses(change)))
    assert "may use another convention" in text or "too few points fall into" in text


def place_at(matrix, position):
    matrix[:3, 3] = position
    return matrix


def place_at_frame(values, position, number=3):
    frame = values["frames"][number]
    frame["transform_matrix"] = place_at(np.array(frame["transform_matrix"]), position).tolist()


def add_equal_shutter_poses(values):
    for frame in values["frames"]:
        for key in ("start", "end"):
            frame[f"transform_matrix_{key}"] = frame["transform_matrix"]


FISHEYE = {"camera_model": "OPENCV_FISHEYE", "fl_x": 15.0, "fl_y": 15.0, "k1": -0.2}
# What is changed in transforms.json, and the severity and the words of what is said of it.
NOTICED = {
    "tiny field": (
        lambda v: v.update(fl_x=100 * v["fl_x"], fl_y=100 * v["fl_y"]),
        "warning", ["degrees from corner to corner"],
    ),
    "huge coefficient": (
        lambda v: v.update(camera_model="OPENCV", k1=1e6),
        "warning", ["degrees from corner to corner"],
    ),
    "huge unit": (
        change_poses(lambda m: place_at(m, 1e7 * m[:3, 3])), "warning", ["an unusual scale"],
    ),
    "fl_x alone": (
        lambda v: v.update(fl_x=v["fl_x"] * 1.3),
        "warning", ["focal lengths differ by a factor of 1.2"],
    ),
    "axis at the edge": (
        lambda v: v.update(cx=2.0), "warning", ["the optical axis meets the image at (2.0, 17.5)"],
    ),
    "lens that ends inside the image": (
        lambda v: v.update(FISHEYE),
        "info", ["pixels have no ray (the lens model ends at 74.0 degrees)"],
    ),
    "camera that turns only": (
        change_poses(lambda m: place_at(m, [0, 0, 3])),
        "warning", ["all cameras stand at one place"],
    ),
    "upside down": (change_poses(lambda m: D @ m), "info", ["upside down"]),
    "points that no view sees": (
        change_poses(lambda m: m @ D),
        "error", ["no view sees any of the points"],
    ),
    "rolling shutter": (
        add_equal_shutter_poses, "info", ["10 views have rolling-shutter poses"],
    ),
    "a pose far away": (
        lambda v: place_at_frame(v, [99, 0, 3]),
        "warning", ["stands farther from all other cameras", "003.png"],
    ),
    "two poses far away": (
        lambda v: (
            place_at_frame(v, [99, 0, 3]), place_at_frame(v, [0, -70, 3], 8)
        ),
        "warning", ["stand farther from all other cameras", "003.png, images/008.png"],
    ),
    "no points": (lambda v: v.pop("ply_file_path"), "warning", ["there are no points"]),
}  # fmt: skip


@pytest.mark.parametrize("name", NOTICED)
def test_diagnose_names_what_is_unusual(name, tmp_path):
    change, severity, parts = NOTICED[name]
    text = texts(write(tmp_path, change), severity)
    assert [part for part in parts if part not in text] == []


def test_diagnose_repeated_pose_and_repeated_image_are_named(tmp_path):
    def change(values):
        values["frames"][3]["transform_matrix"] = values["frames"][2]["transform_matrix"]

    write(tmp_path, change)
    shutil.copy(tmp_path / "images/007.png", tmp_path / "images/008.png")
    text = texts(tmp_path, "warning")
    assert "1 pairs of views have the same pose: images/002.png = images/003.png" in text
    assert "1 pairs of equal images: images/007.png = images/008.png" in text
    assert "one in training and one in test" in text


def test_diagnose_blurred_dark_and_bright_images_are_named(tmp_path):
    write(tmp_path)
    noise = np.random.default_rng(1).integers(0, 60, (small.HEIGHT, small.WIDTH, 1))
    poses = small.world_from_cameras()
    sharp = [np.clip(small.render(p).astype(int) // 2 + noise, 0, 255) for p in poses]
    for name, pixels in zip(small.names(), sharp, strict=True):
        small.write_png(tmp_path / name, pixels.astype(np.uint8))
    small.write_png(
        tmp_path / "images/001.png", cv2.GaussianBlur(sharp[1].astype(np.uint8), (0, 0), 4)
    )
    small.write_png(tmp_path / "images/002.png", (sharp[2] // 4).astype(np.uint8))
    small.write_png(tmp_path / "images/003.png", np.clip(sharp[3] * 4, 0, 255).astype(np.uint8))
    text = texts(tmp_path, "warning")
    assert "as sharp as the median image: images/001.png" in text
    assert "brighter or darker than the median view: images/002.png, images/003.png" in text
    assert "over-exposed: images/003.png" in text


def test_diagnose_inverted_mask_is_noticed(tmp_path):
    write(tmp_path, lambda values: values.update(mask_path="mask.png"))
    mask = np.zeros((small.HEIGHT, small.WIDTH), np.uint8)
    mask[:1] = 255
    small.write_png(tmp_path / "mask.png", mask)
    assert "they may be inverted" in texts(tmp_path, "warning")


def test_diagnose_points_of_other_units_are_noticed(tmp_path):
    write(tmp_path)
    xyz, rgb = small.points()
    small.write_ply(tmp_path / "points3D.ply", 1000 * (xyz + np.array([0.3, 0, 0])), rgb)
    # A note only: cameras that turn on the spot see points as far away beside their own extent.
    assert "may have different units" in texts(tmp_path, "info")


@pytest.mark.parametrize(
    ("name", "warnings"),
    [
        ("fox", ["17 of 67 images do not exist"]),
        ("sponza_fisheye_tiny", []),
        ("sponza_fisheye", []),
        ("helmet_distorted_rs", []),
    ],
)
def test_diagnose_shared_dataset_warns_of_its_known_faults_only(shared, name, warnings):
    found = findings(shared / "data" / name)
    assert [f for f in found if f.severity == "error"] == []
    warned = [f.what for f in found if f.severity == "warning"]
    assert len(warned) == len(warnings)
    assert all(part in text for part, text in zip(warnings, warned, strict=True))


def test_diagnose_video_frames_without_poses_says_what_to_do(shared):
    found = findings(shared / "data" / "gopro_max_walk")
    assert [f.severity for f in found] == ["error"]
    assert "no lens file" in found[0].what and "calibrate" in found[0].advice


def test_diagnose_photographs_in_bgr_are_named(tmp_path):
    folder = write(tmp_path)
    assert "red and blue" not in texts(folder)
    for path in sorted((folder / "images").glob("*.png")):
        cv2.imwrite(str(path), cv2.imread(str(path))[..., ::-1])
    assert "with red and blue swapped" in texts(folder, "warning")
