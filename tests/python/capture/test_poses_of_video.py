"""`gsut poses VIDEO`: frames are chosen first, and their times stand in what is written."""

import json

import pytest

import gsut
from gsut.cli import main
from gsut.sfm.photographs.listing import find_photographs
from small_videos import walk_past


@pytest.mark.threads
def test_video_becomes_poses_with_time_stamps(tmp_path, capsys):
    video, data = walk_past(tmp_path / "walk.mp4"), tmp_path / "data"
    gsut.save_camera(
        gsut.Camera("pinhole", [300.0, 300.0, 160.0, 120.0], 320, 240), tmp_path / "lens.yaml"
    )
    words = ["poses", str(video), "-o", str(data), "--camera", str(tmp_path / "lens.yaml")]
    assert main([*words, "--frames", "6", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["registered"] == 6
    rows = json.loads((data / "capture/capture.json").read_text())["frames"]
    times = {f"capture/images/{row['name']}": row["time"] for row in rows}
    frames = json.loads((data / "transforms.json").read_text())["frames"]
    assert {row["file_path"]: row["timestamp"] for row in frames} == times
    assert "the pictures chosen" in (data / "report.html").read_text()
    found = find_photographs(data / "capture", None)
    assert found.times == {row["name"]: row["time"] for row in rows}
