"""What people put into a folder: content decides whether it is a photograph, a film or a mask."""

import struct
import sys

import av
import cv2
import numpy as np
import pytest

import gsut
import small_videos
from gsut.capture import folders
from gsut.capture.folders import list_folder
from gsut.capture.streams import is_woven
from gsut.capture.track import read_film_facts
from gsut.capture.video import Video
from gsut.data.images import MaskLookup
from gsut.files import ENDINGS, find_kind, split_numbers

RNG = np.random.default_rng(20261128)
PICTURE = cv2.resize(RNG.integers(0, 256, (12, 16, 3), np.uint8), (160, 120))


def picture(path, kind=".jpg", shift=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(kind, np.roll(PICTURE, shift, axis=1))[1].tobytes())
    return path


def names_of(folder):
    taken = gsut.capture([folder], folder.with_name(folder.name + "-taken"))
    return [row["name"] for row in taken.figures["frames"]], taken


@pytest.mark.parametrize(
    ("name", "start", "kind"),
    [
        ("a.jpg", b"\xff\xd8\xff\xe0", "picture"),
        ("a", b"\xff\xd8\xff\xe0", "picture"),
        ("a.mp4", b"\x89PNG\r\n\x1a\n", "picture"),
        ("a.jpg", b"\0\0\0\x18ftypheic", "heif"),
        ("a.heic", b"\xff\xd8\xff\xe0", "picture"),
        ("a.png", b"\0\0\0\x18ftypisom", "video"),
        ("a.mp4", b"damaged", "video"),
        ("a.ts", b"import x\n" * 60, ""),
        ("a.ts", (b"G" + b"\0" * 187) * 4, "video"),
        ("a.bin", (b"\0\0\0\0G" + b"\0" * 187) * 4, "video"),
        ("a.mpg", b"\0\0\1\xba", "video"),
        ("a.dng", b"II*\0", "raw"),
        ("a.tif", b"II*\0", "picture"),
        ("a.txt", b"hello", ""),
        ("a.jpg", b"", "picture"),
    ],
)
def test_first_bytes_decide_over_the_name(tmp_path, name, start, kind):
    (tmp_path / name).write_bytes(start)
    assert find_kind(tmp_path / name) == kind


def test_kind_of_what_is_not_there_is_that_of_its_ending(tmp_path):
    assert [find_kind(tmp_path / f"a{end}") for end in (".MP4", ".JFIF", ".x")] == [
        "video", "picture", "",
    ]  # fmt: skip
    (tmp_path / "b.mp4").mkdir()
    assert find_kind(tmp_path / "b.mp4") == ""
    assert len({end for ends in ENDINGS.values() for end in ends}) == sum(
        map(len, ENDINGS.values())
    )


def test_names_sort_as_people_count():
    names = ["img10.jpg", "img2.jpg", "img02.jpg", "10/a", "9/a", "img.jpg", "a" * 9, "7" * 5000]
    ordered = sorted(names, key=split_numbers)
    assert ordered.index("img2.jpg") < ordered.index("img10.jpg")
    assert ordered.index("9/a") < ordered.index("10/a") < ordered.index("7" * 5000)


def test_photographs_are_taken_in_the_order_of_their_numbers(tmp_path):
    for number in range(1, 12):
        picture(tmp_path / "in" / f"p{number}.jpg", shift=number)
    assert names_of(tmp_path / "in")[0] == [f"p{number}.jpg" for number in range(1, 12)]


@pytest.mark.parametrize("form", ["{}_mask.png", "{}.mask.png", "mask_{}.png", "{}-masks.PNG"])
def test_masks_beside_photographs_are_their_masks(tmp_path, form):
    for number in range(3):
        photo = picture(tmp_path / "in" / f"IMG_{number}.jpg", shift=number)
        mask = np.zeros((120, 160), np.uint8)
        mask[20:] = 255
        (photo.parent / form.format(photo.stem)).write_bytes(cv2.imencode(".png", mask)[1])
    names, taken = names_of(tmp_path / "in")
    assert names == [f"IMG_{number}.jpg" for number in range(3)]
    masks = [(taken.path / row["mask"]).resolve() for row in taken.figures["frames"]]
    assert masks == [tmp_path / "in" / form.format(f"IMG_{number}") for number in range(3)]


def test_photograph_called_mask_without_another_is_a_photograph(tmp_path):
    picture(tmp_path / "venice_mask.jpg")
    picture(tmp_path / "b.jpg")
    assert [path.name for path in list_folder(tmp_path).photographs] == ["b.jpg", "venice_mask.jpg"]


@pytest.mark.parametrize(
    "name",
    ["@eaDir/0.jpg/SYNOPHOTO_THUMB_XL.jpg", "._0.jpg", ".thumbnails/0.jpg", "__MACOSX/0.jpg",
     "#recycle/9.jpg", "$RECYCLE.BIN/9.jpg", "Thumbs/0.jpg", "masks/0.png"],
)  # fmt: skip
@pytest.mark.parametrize("inner", ["", "images/"])
def test_previews_and_leftovers_are_no_photographs(tmp_path, name, inner):
    for number in range(2):
        picture(tmp_path / f"{inner}{number}.jpg", shift=number)
    picture(tmp_path / inner / name, shift=9)
    found = list_folder(tmp_path)
    assert [path.name for path in found.photographs] == ["0.jpg", "1.jpg"]


def test_memory_card_s_folders_are_of_one_camera(tmp_path):
    for number in range(4):
        picture(tmp_path / "in" / f"{100 + number // 2}MEDIA" / f"DJI_{number}.JPG", shift=number)
    names, taken = names_of(tmp_path / "in")
    assert names == [f"{100 + n // 2}MEDIA-DJI_{n}.JPG" for n in range(4)]
    assert "cameras" not in taken.figures


@pytest.mark.parametrize("copy", ["a (1).jpg", "a - Copy.jpg", "a copy 2.jpg", "a - Kopie.jpg"])
def test_copies_are_left_out_and_named_and_others_kept(tmp_path, copy):
    data = picture(tmp_path / "in/a.jpg").read_bytes()
    (tmp_path / "in" / copy).write_bytes(data)
    picture(tmp_path / "in/b (1).jpg", shift=5)
    picture(tmp_path / "in/b.jpg", shift=6)
    names, taken = names_of(tmp_path / "in")
    assert names == ["a.jpg", "b (1).jpg", "b.jpg"]
    assert any("1 copies of others" in note and copy in note for note in taken.figures["notes"])


def test_edited_copies_are_left_out_beside_what_was_edited(tmp_path):
    names = ["IMG_0042.jpg", "IMG_E0042.jpg", "IMG_E0043.jpg", "a.jpg", "a-edited.jpg", "a~2.jpg"]
    for number, name in enumerate(names):
        picture(tmp_path / name, shift=number)
    taken = [path.name for path in list_folder(tmp_path).photographs]
    assert taken == ["IMG_0042.jpg", "IMG_E0043.jpg", "a.jpg"]


def test_film_is_read_from_its_largest_stream(tmp_path):
    with av.open(str(tmp_path / "a.mp4"), "w") as film:
        for side in (32, 64):
            stream = film.add_stream("mpeg4", rate=30)
            stream.width = stream.height = side
        for stream in film.streams.video:
            frame = av.VideoFrame(stream.width, stream.height, "yuv420p")
            film.mux([*stream.encode(frame), *stream.encode()])
    with Video(tmp_path / "a.mp4") as video:
        assert next(decode() for _, _, decode in video.read_frames()).shape == (64, 64, 3)


@pytest.mark.parametrize("ending", [".jfif", ".jpe", ".insp", ""])
def test_jpeg_of_any_ending_is_taken(tmp_path, ending):
    for number in range(2):
        picture(tmp_path / "in" / f"{number}{ending}", shift=number)
    names, taken = names_of(tmp_path / "in")
    assert len(names) == 2
    for row in taken.figures["frames"]:
        path = taken.path / row["path"]
        assert path.suffix in ENDINGS["picture"] and cv2.imread(str(path)) is not None


def test_heic_called_jpg_is_written_again(tmp_path):
    heif = pytest.importorskip("pillow_heif")
    from PIL import Image

    (tmp_path / "in").mkdir()
    for number in range(2):
        image = Image.fromarray(np.roll(PICTURE, number, axis=1))
        heif.from_pillow(image).save(str(tmp_path / f"in/{number}.heic"), quality=90)
        (tmp_path / f"in/{number}.heic").rename(tmp_path / f"in/{number}.jpg")
    _, taken = names_of(tmp_path / "in")
    for row in taken.figures["frames"]:
        assert cv2.imread(str(taken.path / row["path"])) is not None


def test_films_beside_photographs_are_counted(tmp_path):
    for number in range(3):
        picture(tmp_path / "in" / f"{number}.jpg", shift=number)
    (tmp_path / "in/film.mp4").write_bytes(b"\0\0\0\x18ftypisom")
    names, taken = names_of(tmp_path / "in")
    assert len(names) == 3
    assert any("3 photographs; left out: 1 films" in note for note in taken.figures["notes"])


def test_empty_folder_lists_what_lies_there(tmp_path):
    (tmp_path / "a.docx").write_bytes(b"PK")
    with pytest.raises(gsut.InputError, match=r"no photographs here \(found 1 x .docx\)"):
        gsut.capture([tmp_path], tmp_path / "out")


def test_woven_lines_are_found_and_whole_pictures_are_not():
    still = cv2.resize(RNG.integers(0, 256, (60, 80, 3), np.uint8), (320, 240))
    moved = np.roll(still, 9, axis=1)
    woven = still.copy()
    woven[1::2] = moved[1::2]
    noise = RNG.integers(0, 256, (240, 320, 3), np.uint8)
    assert [is_woven(picture) for picture in (woven, still, noise)] == [True, False, False]


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("GPS(8.5,47.25,19) BAROMETER:19.5", (47.25, 8.5, 19.5)),
        ("GPS (8.5, 47.25, 430)", (47.25, 8.5, 430.0)),
        ("[latitude: 47.25] [longitude: 8.5] [rel_alt: 1.0 abs_alt: 430.0]", (47.25, 8.5, 430.0)),
    ],
)
def test_positions_of_subtitles_are_read(tmp_path, line, place):
    film = tmp_path / "DJI_1.mp4"
    film.write_bytes(b"")
    cue = "{0}\n00:00:0{0},000 --> 00:00:0{1},000\nHOME(8.0,47.0) 2026.01.01\n{2}\n\n"
    film.with_suffix(".SRT").write_text("".join(cue.format(i, i + 1, line) for i in range(1, 4)))
    facts = read_film_facts(film)
    np.testing.assert_array_equal(facts.track[:, 1:], [place] * 3)
    assert facts.notes == ()


def test_subtitles_without_positions_are_named(tmp_path):
    film = tmp_path / "talk.mp4"
    film.write_bytes(b"")
    film.with_suffix(".srt").write_text("1\n00:00:01,000 --> 00:00:02,000\nHello\n\n")
    assert "talk.srt" in read_film_facts(film).notes[0]


def test_folder_of_films_alone_is_its_films(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for number in (10, 9):
        (tmp_path / f"in/GX{number}.MP4").write_bytes(b"\0\0\0\x18ftypisom")
    taken, module = [], sys.modules["gsut.capture.inputs"]
    monkeypatch.setattr(module, "_take_pictures", lambda paths, *_: taken.extend(paths))
    monkeypatch.setattr(module, "prepare_panoramas", lambda found, _: found)
    gsut.capture([tmp_path / "in"], tmp_path / "out")
    assert [path.name for path in taken] == ["GX9.MP4", "GX10.MP4"]


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirrored", [False, True])
def test_film_is_shown_as_its_display_matrix_says(tmp_path, quarters, mirrored):
    path = small_videos.walk(tmp_path / "a.mp4", 3)
    with Video(path) as video:
        plain = next(decode() for _, _, decode in video.read_frames())
    data = bytearray(path.read_bytes())
    at = data.find(b"tkhd") + 4 + 40
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]  # clockwise, after the mirror
    side = -1 if mirrored else 1
    matrix = (side * cos << 16, side * sin << 16, 0, -sin << 16, cos << 16, 0, 0, 0, 1 << 30)
    data[at : at + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(data)
    with Video(path) as video:
        shown = next(decode() for _, _, decode in video.read_frames())
    wanted = np.rot90(plain[:, ::-1] if mirrored else plain, -quarters)
    np.testing.assert_array_equal(shown, wanted)


def test_small_copies_of_films_are_passed_over(tmp_path):
    for name in ("GX01.MP4", "GX01.LRV", "b_Proxy.mov", "LRV_1.insv"):
        (tmp_path / name).write_bytes(b"\0\0\0\x18ftypisom")
    assert [path.name for path in list_folder(tmp_path).films] == ["GX01.MP4"]
    (tmp_path / "GX01.MP4").unlink()
    assert len(list_folder(tmp_path).films) == 3


def test_raw_and_heic_beside_the_same_jpeg_are_left_out(tmp_path):
    for number in range(3):
        picture(tmp_path / f"{number}.jpg", shift=number)
    for name in ("0.cr2", "1.HEIC", "2.NEF", "3.NEF", "4.heic"):
        (tmp_path / name).write_bytes(b"x")
    found = list_folder(tmp_path)
    names = [path.name for path in found.photographs]
    assert names == ["0.jpg", "1.jpg", "2.jpg", "3.NEF", "4.heic"]
    assert "3 of the same in another format" in found.describe_rest()


def test_mask_of_all_pictures_is_named_as_masks(tmp_path):
    mask = picture(tmp_path / "one.png", ".png")
    assert MaskLookup(mask).find("a/b.jpg") == mask
    assert MaskLookup(tmp_path / "masks").find("a/b.jpg") is None


def test_folder_of_too_many_files_is_refused_before_they_are_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "_MOST_FILES", 3)
    monkeypatch.setattr(folders, "find_kind", lambda path: pytest.fail(f"{path} is opened"))
    for number in range(4):
        picture(tmp_path / f"{number}.jpg")
    with pytest.raises(gsut.InputError, match="holds more than 3 files and folders; give"):
        list_folder(tmp_path)
