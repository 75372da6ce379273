"""Films: what codecs make of the frames, sizes, and names that are refused."""

import av
import numpy as np
import pytest

import gsut
from gsut.render import is_film
from gsut.render.films import FILM_SUFFIXES
from tolerances.view import FILM_PSNR_DB

COUNT, HEIGHT, WIDTH = 6, 49, 65


def frames():
    """Smooth saturated colours that move: chroma is stored at half the size."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    for k in range(COUNT):
        waves = (np.sin((columns + 4 * k) / 9), np.cos((rows - 3 * k) / 8), np.sin(columns / 12))
        yield (128 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)


def decoded(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        return stream.codec_context.name, float(stream.average_rate), pictures


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", "h264"), (".webm", "vp9"), (".gif", "gif")])
def test_film_holds_the_frames(tmp_path, suffix, codec):
    path = tmp_path / f"film{suffix}"
    assert gsut.write_video(path, frames(), 25) == COUNT
    name, rate, pictures = decoded(path)
    assert (name, rate, len(pictures)) == (codec, 25, COUNT)
    for found, truth in zip(pictures, frames(), strict=True):
        assert found.shape == (HEIGHT - 1, WIDTH - 1, 3)  # codecs hold even sizes
        assert gsut.psnr(found / 255, truth[:-1, :-1] / 255) > FILM_PSNR_DB[suffix]
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_mp4_begins_with_its_index_and_says_its_colours(tmp_path):
    path = tmp_path / "film.mp4"
    gsut.write_video(path, frames(), 30)
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    with av.open(str(path)) as container:
        context = container.streams.video[0].codec_context
        assert (context.pix_fmt, context.colorspace, context.color_range) == ("yuv420p", 1, 1)


@pytest.mark.parametrize("name", ["film.avi", "film.mov", "scene.ply", "images"])
def test_name_of_no_film_is_refused(tmp_path, name):
    with pytest.raises(gsut.InputError, match=r"\.mp4, \.webm, \.gif"):
        gsut.write_video(tmp_path / name, frames(), 30)
    assert list(tmp_path.iterdir()) == []


def test_folder_is_told_from_a_film(tmp_path):
    assert not is_film(tmp_path / "images")
    (tmp_path / "images.v2").mkdir()
    assert not is_film(tmp_path / "images.v2")
    assert all(is_film(tmp_path / f"a{suffix.upper()}") for suffix in FILM_SUFFIXES)


def test_frames_that_make_no_film_leave_no_file(tmp_path):
    path = tmp_path / "film.mp4"
    with pytest.raises(gsut.InputError, match="at least one frame"):
        gsut.write_video(path, iter(()), 30)
    sizes = [np.zeros((8, 8, 3), np.uint8), np.zeros((8, 10, 3), np.uint8)]
    with pytest.raises(gsut.InputError, match="one size, found 8 x 8 and 10 x 8"):
        gsut.write_video(path, sizes, 30)
    with pytest.raises(gsut.InputError, match="at most 50"):
        gsut.write_video(tmp_path / "film.gif", frames(), 60)
    assert list(tmp_path.iterdir()) == []
