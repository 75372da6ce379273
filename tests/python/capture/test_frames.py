"""Videos in: frames by sharpness and motion, time stamps, rotation, files that are broken."""

import json
import os
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
from gsut.capture import capture, find_changed_inputs
from gsut.capture.ahead import make_pool
from gsut.capture.choose import (
    CandidateSearch,
    add_candidates,
    choose_frames,
    find_blurred,
    look_at,
)
from gsut.capture.frames import extract_frames
from gsut.capture.video import Video, is_video, read_stream_start
from small_videos import (
    HEIGHT,
    WIDTH,
    coded_otherwise,
    damage_packets,
    encode_film,
    frames_of_noise,
    stretch_second_half,
    texture,
    turn_by_quarter,
    view,
    walk,
    walk_past,
    write_stamps,
    write_video,
)


def candidates(pictures):
    with make_pool() as pool:
        search = CandidateSearch(pool)
        for number, picture in enumerate(pictures):
            search.add(look_at(number, number / 30, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)))
        return search.finish()


def test_frames_are_chosen_by_how_far_the_view_moved():
    ground = texture()
    # Stands for 40 frames, walks for 40, stands again.
    places = [50.0] * 40 + [50 + 4.0 * i for i in range(40)] + [206.0] * 40
    found = candidates(view(ground, x) for x in places)
    moving = [c.number for c in found if 38 <= c.number <= 82]
    assert len(moving) >= len(found) - 1  # the first one stands
    way = sum(c.moved for c in found) * np.hypot(WIDTH, HEIGHT)
    assert way == pytest.approx(156, rel=0.1)
    chosen = choose_frames(found, 10)
    assert len(chosen) == 10 == len(set(chosen))
    gaps = np.diff([found[i].number for i in chosen][1:])
    assert gaps.max() <= 2 * gaps.min() + 1


@pytest.mark.parametrize(("total", "count", "few"), [(17, None, 17), (300, None, 20), (30, 25, 25)])
def test_slide_show_gives_as_many_frames_as_are_needed(total, count, few):
    ground = texture()
    with make_pool() as pool:
        search = CandidateSearch(pool)
        for number in range(total):
            picture = view(ground, 50.0 + 10.0 * (number > total // 2))
            search.add(look_at(number, float(number), cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)))
        found = search.finish()
    assert len(found) < 4
    more = add_candidates(found, search.frames, count)
    assert len(more) == few == len({c.number for c in more})
    assert {c.number for c in found} <= {c.number for c in more}
    assert max(np.diff([c.number for c in more])) <= 3 * total / few
    assert sum(c.moved for c in more) == pytest.approx(sum(c.moved for c in found))
    assert len(choose_frames(more, count)) == few


def test_few_frames_are_used_and_said(tmp_path):
    ground = texture()
    pictures = [view(ground, 50.0 + 60.0 * (i > 8)) for i in range(17)]
    video = write_video(tmp_path / "show.mp4", pictures)
    assert "which is few" in extract_frames(video, tmp_path / "all").notes[0]
    asked = extract_frames(video, tmp_path / "asked", count=40)
    assert len(asked.figures["frames"]) == 17
    assert "not the 40 of --frames" in asked.notes[0]


def test_the_sharpest_frame_about_a_place_is_chosen():
    ground = texture()
    pictures = [view(ground, 50 + 1.0 * i, blur=0.0 if i % 3 == 1 else 3.0) for i in range(90)]
    found = candidates(pictures)
    assert len(found) > 10
    assert np.mean([c.number % 3 == 1 for c in found]) > 0.9


def test_blurred_frames_are_marked():
    ground = texture()
    found = candidates(view(ground, 50 + 9.0 * i, blur=4.0 * (i == 12)) for i in range(24))
    assert [c.number for c, b in zip(found, find_blurred(found), strict=True) if b] == [12]


def test_a_cut_and_a_blank_wall_give_candidates():
    ground = texture()
    pictures = [view(ground, 50.0)] * 5 + [view(ground, 900.0, 700.0)] * 5
    assert [c.number for c in candidates(pictures)] == [0, 5]
    grey = [np.full((HEIGHT, WIDTH, 3), 128, np.uint8)] * 61
    assert 4 <= len(candidates(grey)) <= 9  # two to four a second


def test_video_becomes_a_folder_with_times(tmp_path):
    video = walk(tmp_path / "walk.mp4")
    told = []
    capture = extract_frames(video, tmp_path / "out", on_progress=lambda *row: told.append(row[:3]))
    rows = capture.figures["frames"]
    assert 15 <= len(rows) <= 60 and capture.notes == []
    for row in rows:
        assert row["name"] == f"f{row['number']:05d}.jpg"
        assert row["time"] == pytest.approx(row["number"] / 30, abs=1e-4)
        picture = cv2.imread(str(capture.path / "images" / row["name"]))
        assert picture.shape == (HEIGHT, WIDTH, 3)
    assert (capture.path / "strip.jpg").is_file()
    assert told[-1] == ("frames", len(rows), len(rows))
    assert capture.figures["seconds"] == pytest.approx(59 / 30, abs=0.1)


def test_finished_folder_is_kept_and_a_missing_frame_made_again(tmp_path):
    video = walk(tmp_path / "walk.mp4", frames=30)
    first = extract_frames(video, tmp_path / "out", count=10)
    assert len(first.figures["frames"]) == 10
    file = first.path / "images" / first.figures["frames"][3]["name"]
    before = file.stat().st_mtime_ns
    extract_frames(video, tmp_path / "out", count=10)
    assert file.stat().st_mtime_ns == before
    file.unlink()
    extract_frames(video, tmp_path / "out", count=10)
    assert file.is_file()
    fewer = extract_frames(video, tmp_path / "out", count=5)
    assert len(list((fewer.path / "images").iterdir())) == 5


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_rotation_flag_is_honoured(tmp_path, turns):
    video = walk(tmp_path / "walk.mp4", frames=20)
    turn_by_quarter(video, turns=turns)
    upright = np.rot90(view(texture(), 50.0), k=-turns)
    with Video(video) as source:
        assert (source.height, source.width) == upright.shape[:2]
    capture = extract_frames(video, tmp_path / "out")
    picture = cv2.imread(str(capture.path / "images" / capture.figures["frames"][0]["name"]))
    assert picture.shape == upright.shape
    assert np.abs(picture.astype(int) - upright).mean() < 12  # lossy


def test_variable_frame_rate_keeps_the_times_and_names_count_time(tmp_path):
    video = walk(tmp_path / "walk.mp4", frames=40, step=9.0)
    stretch_second_half(video)
    rows = extract_frames(video, tmp_path / "out").figures["frames"]
    expected = [n / 30 if n <= 20 else 20 / 30 + (n - 20) / 15 for n in (r["number"] for r in rows)]
    np.testing.assert_allclose([r["time"] for r in rows], expected, atol=2e-3)
    numbers = np.array([int(r["name"][1:-4]) for r in rows])
    times = np.array([r["time"] for r in rows])
    scale = numbers[-1] / times[-1]
    assert np.abs(numbers - scale * times).max() <= 1


def test_frames_of_one_time_stamp_are_timed_by_the_frame_rate_and_said(tmp_path):
    film = walk_past(tmp_path / "walk.mp4")
    video = write_stamps(tmp_path / "walk.mkv", film, lambda number: 0)
    capture = extract_frames(video, tmp_path / "frames")
    times = [row["time"] for row in capture.figures["frames"]]
    assert len(times) > 5 and (np.diff(times) > 0).all()
    assert any("time stamps of 23 frames of walk.mkv do not rise" in n for n in capture.notes)


def test_time_stamps_that_jump_are_said(tmp_path):
    film = walk_past(tmp_path / "walk.mp4")
    video = write_stamps(tmp_path / "walk.mkv", film, lambda i: 512 * (i + 90_000 * (i >= 12)))
    capture = extract_frames(video, tmp_path / "frames")
    assert any("the time stamps of walk.mkv jump: 24 frames" in note for note in capture.notes)
    assert not any("cut off" in note for note in capture.notes)


def test_bad_videos_say_what_to_do(tmp_path):
    ground = texture()
    with pytest.raises(gsut.InputError, match="no such file"):
        Video(tmp_path / "absent.mp4")
    few = write_video(tmp_path / "few.mp4", (view(ground, 50 + 9 * i) for i in range(4)))
    with pytest.raises(gsut.InputError, match=r"has 4 frames; film for ten seconds"):
        extract_frames(few, tmp_path / "out")
    still = write_video(tmp_path / "still.mp4", [view(ground, 50.0)] * 40)
    with pytest.raises(gsut.InputError, match=r"one still picture: in 1 s.*walk with the camera"):
        extract_frames(still, tmp_path / "out")
    text = tmp_path / "text.mp4"
    text.write_text("no video at all")
    with pytest.raises(gsut.InputError, match=r"its codec is not known here; convert it: ffmpeg"):
        extract_frames(text, tmp_path / "out")
    with pytest.raises(gsut.InputError, match="--frames takes 2 or more, found 1"):
        extract_frames(few, tmp_path / "out", count=1)
    for name, change in (("other", coded_otherwise), ("noise", frames_of_noise)):
        broken = change(walk(tmp_path / f"{name}.mp4", frames=10))
        with pytest.raises(gsut.InputError, match=r"damaged, or its codec is not known here"):
            extract_frames(broken, tmp_path / "out")
    cut = tmp_path / "cut.mp4"
    cut.write_bytes((few.read_bytes())[:2000])
    with pytest.raises(gsut.InputError, match="cut off before its index"):
        extract_frames(cut, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_film_whose_index_lists_a_frame_that_is_not_shown_is_whole(shared, tmp_path):
    film = shared / "data" / "captures" / "teddybear_film" / "teddybear.mp4"
    if not film.is_file():
        pytest.skip(f"{film} is absent")
    assert Video(film).frame_count == 10
    assert not any("cut off" in n for n in extract_frames(film, tmp_path / "out").notes)


def test_video_that_ends_in_the_middle_is_used_and_said(tmp_path):
    video = walk(tmp_path / "walk.avi")  # its index is at the end, and not needed
    data = video.read_bytes()
    video.write_bytes(data[: len(data) // 2])
    capture = extract_frames(video, tmp_path / "out")
    note, of_last = capture.notes
    assert "are damaged and left out (1 of" in of_last
    assert "of 60 frames" in note and "cut off" in note
    assert capture.figures["frames_seen"] < 40
    assert json.loads((capture.path / "capture.json").read_text())["notes"] == [note, of_last]


@pytest.mark.parametrize(
    ("codec", "name"),
    [("mpeg4", "a.mp4"), ("libx264", "a.mp4"), ("libvpx-vp9", "a.webm"), ("libx265", "a.mp4")],
)
def test_frames_of_a_film_damaged_inside_are_left_out_and_said(codec, name, tmp_path):
    ground = texture()
    whole = encode_film(tmp_path / name, codec, (view(ground, 50 + 3 * i) for i in range(60)))
    film = damage_packets(tmp_path / f"bad-{name}", whole, (29, 31))
    with Video(whole) as source:
        true = {round(30 * t): decode() for _, t, decode in source.read_frames()}
        assert len(true) == 60 and not source.damaged
    with Video(film) as source:
        read = {round(30 * t): decode() for _, t, decode in source.read_frames()}
        assert min(source.damaged) > 0.8 and max(source.damaged) < 1.7
    sound = {number: picture for number, picture in read.items() if picture is not None}
    assert len(sound) >= 24 and {0, 59} <= set(sound)
    assert all((picture == true[number]).all() for number, picture in sound.items())
    if codec == "mpeg4":
        notes = "\n".join(extract_frames(film, tmp_path / "out").notes)
        assert (
            "frames of bad-a.mp4 between 1.0 and 1.2 s are damaged and left out (7 of 60)" in notes
        )


def test_of_films_pasted_into_one_file_the_first_is_read_and_said(tmp_path):
    film = write_video(tmp_path / "both.mp4", draw_walk(20))
    film.write_bytes(2 * film.read_bytes())
    with Video(film) as both:
        assert sum(1 for _ in both.read_frames()) == 20
        (note,) = both.list_notes(20)
    assert "both.mp4 is 2 films pasted together, of which the first is read" in note


def draw_walk(count):
    return [view(texture(), 50 + 12.0 * i) for i in range(count)]


@pytest.mark.parametrize(("ratio", "size"), [((4, 3), (427, 240)), ((8, 9), (320, 270))])
def test_film_of_pixels_that_are_not_square_is_stretched_with_a_note(ratio, size, tmp_path):
    film = encode_film(tmp_path / "film.mp4", "libx264", draw_walk(3), ratio=Fraction(*ratio))
    with Video(film) as video:
        pictures = [decode() for _, _, decode in video.read_frames()]
        assert (video.width, video.height) == size
        assert [picture.shape for picture in pictures] == 3 * [(size[1], size[0], 3)]
        (note,) = video.list_notes(3)
    assert f"stretched to square ones ({size[0]} x {size[1]})" in note


@pytest.mark.parametrize(("curve", "name"), [(16, "PQ"), (18, "HLG")])
def test_film_for_bright_screens_is_noted(curve, name, tmp_path):
    film = encode_film(tmp_path / "film.mp4", "libx264", draw_walk(3), curve=curve)
    with Video(film) as video:
        assert len(list(video.read_frames())) == 3
        (note,) = video.list_notes(3)
    assert f"film.mp4 is an HDR film ({name})" in note


def test_interlaced_film_is_noted(tmp_path):
    film = encode_film(tmp_path / "film.mp4", "libx264", draw_walk(3), flags="+ilme+ildct")
    with Video(film) as video:
        assert len(list(video.read_frames())) == 3
        (note,) = video.list_notes(3)
    assert "3 of 3 frames of film.mp4 are interlaced" in note and "bwdif" in note


def test_a_cut_is_said_and_a_fast_walk_or_a_flash_is_none(tmp_path):
    ground = texture()
    walked = [view(ground, 50 + 12.0 * i) for i in range(40)]
    flash = [np.full_like(p, 255) if i == 20 else p for i, p in enumerate(walked)]
    turned = np.ascontiguousarray(np.rot90(ground, 2))
    cut = walked[:20] + [view(turned, 90 + 12.0 * i) for i in range(20)]
    for name, pictures, is_cut in (("walk", walked, 0), ("flash", flash, 0), ("cut", cut, 1)):
        film = write_video(tmp_path / f"{name}.mp4", pictures)
        notes = extract_frames(film, tmp_path / name).notes
        assert (
            sum(f"{name}.mp4 is cut at 0.7 s" in n for n in notes)
            == is_cut
            == sum("is cut" in n for n in notes)
        )


@pytest.mark.parametrize(
    "name", [os.fsdecode(b"caf\xe9.mp4"), "http:a.mp4", "concat:a|b.mp4", "pipe:.mp4", "-a%03d.mp4"]
)
def test_video_of_any_name_is_a_file(name, tmp_path, monkeypatch):
    walk_past(tmp_path / "a.mp4", 8)
    (tmp_path / "a.mp4").rename(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert len(extract_frames(name, "out").figures["frames"]) == 8
    assert read_stream_start(Path(name), 0, 2)[0].shape[0] == 2


def test_videos_are_told_by_their_names():
    assert is_video("GH010001.MP4") and is_video("a/b.mov") and not is_video("photos")


def test_changed_inputs_are_named_whatever_their_number(tmp_path):
    films = [walk(tmp_path / name, 16, 9.0) for name in ("a.mp4", "b.mp4")]
    shots = tmp_path / "shots"
    shots.mkdir()
    for number in range(3):
        cv2.imwrite(str(shots / f"{number}.png"), view(texture(), 90.0 * number))
    for number, inputs in enumerate((films[:1], films, [shots], [*films, shots])):
        out = tmp_path / str(number)
        assert find_changed_inputs(inputs, out) == ""
        capture(inputs, out)
        assert find_changed_inputs(inputs, out) == ""
    walk(films[1], 17, 9.0)
    (shots / "0.png").unlink()
    cv2.imwrite(str(shots / "3.png"), view(texture(), 300.0))
    assert find_changed_inputs(films, tmp_path / "1") == f"changed: {films[1]}"
    added, removed = shots / "3.png", shots / "0.png"
    of_shots = f"added: {added}; removed: {removed}"
    assert find_changed_inputs([shots], tmp_path / "2") == of_shots
    both = f"changed: {films[1]}; {of_shots}"
    assert find_changed_inputs([*films, shots], tmp_path / "3") == both
    assert find_changed_inputs([tmp_path / "gone.mp4"], tmp_path / "0") == ""
