"""Every registered reader takes or refuses every kind of wrong file, in one sentence."""

import gzip
import itertools
import os
import zipfile

import numpy as np
import pytest

import calib
import gsut
from gsut import InputError
from gsut.files import Array, list_readers, open_archive, read_npy, read_npz, unpack_gzip
from reader_examples import EXAMPLES, WITHOUT, import_all
from wrong_files import HUGE, find_fault, list_contents, list_headers, list_pieces, pack

MOST_FILES = 60  # wrong files of a reader, about
POISON = "/dev/zero"  # a device that never ends


def test_every_reader_has_an_example():
    import_all(gsut)
    import_all(calib)
    registered = {reader.name for reader in list_readers()}
    assert len(registered) >= 20
    assert registered - WITHOUT <= EXAMPLES.keys()


@pytest.mark.parametrize("name", EXAMPLES)
def test_wrong_file_of_any_kind_is_read_or_refused_in_a_sentence(name, tmp_path):
    file, read = EXAMPLES[name](tmp_path)
    read()
    whole = file.read_bytes()
    contents, faults = list(list_contents(file, whole)), []
    assert len(contents) >= 10
    contents = contents[:: max(1, len(contents) // MOST_FILES)]  # lab/run attack takes all
    for content in itertools.chain(contents, list_pieces(whole), list_headers(whole)):
        file.write_bytes(content)
        if fault := find_fault(read, str(file.parent)):
            faults.append(f"{content[:200]!r}: {fault}")
    assert faults == []


# Of these a part is never read as a smaller file.
WHOLE = ("cameras.bin", "checkpoint", "COLMAP cameras.bin", "COLMAP images.bin", "compressed PLY",
         "COLMAP points3D.bin", "confidence", "glTF of Gaussians", "laser scan", "mesh PLY",
         "PLY of Gaussians", "SOG", "SPZ", "what was lifted", *({"USD"} - WITHOUT))  # fmt: skip


@pytest.mark.parametrize("name", WHOLE)
def test_file_that_is_cut_off_is_refused(name, tmp_path):
    file, read = EXAMPLES[name](tmp_path)
    whole = file.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 40).astype(int):
        file.write_bytes(whole[:length])
        with pytest.raises(InputError, match=file.name):
            read()


@pytest.mark.parametrize("name", EXAMPLES)
def test_what_is_no_file_is_refused_in_a_sentence(name, tmp_path):
    file, read = EXAMPLES[name](tmp_path)
    places = (file.mkdir, lambda: os.mkfifo(file), lambda: file.symlink_to(POISON),
              lambda: file.symlink_to(file.name), lambda: None)  # fmt: skip
    faults = []
    for make in places:
        if file.is_dir():
            file.rmdir()
        else:
            file.unlink(missing_ok=True)
        make()
        faults.append(find_fault(read))
    assert faults == [""] * len(places)


def test_array_that_claims_more_than_its_file_takes_no_memory(tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(HUGE.replace(b"SHAPE", b"100000000000,").ljust(127) + b"\n")
    with pytest.raises(InputError, match=r"claims an array of shape \(100000000000,\)"):
        read_npy(path)
    packed = pack({"a.npy": bytes(300 << 20)}, compression=zipfile.ZIP_DEFLATED)
    (tmp_path / "a.npz").write_bytes(packed)
    with pytest.raises(InputError, match=r"would unpack from [0-9,]+ to 314,572,800 bytes"):
        read_npz(tmp_path / "a.npz")
    with pytest.raises(InputError, match="more than 1,000 bytes"):
        unpack_gzip(gzip.compress(bytes(5000)), "a.gz", 1000)


@pytest.mark.parametrize(
    ("array", "values", "said"),
    [
        (Array("i"), [0.5], "not whole"),
        (Array("i"), [np.nan], "holds NaN"),
        (Array("i", most=9), [2.0**40], "not -inf to 9"),
        (Array("i"), [2.0**63], "holds numbers from"),
        (Array("f", least=0), [-1], "not 0 to inf"),
        (Array("f"), [1j], "holds complex128, not real numbers"),
        (Array("f", ("N", "N")), np.ones((2, 3)), r"has shape \(2, 3\), expected \("),
        (Array("f", (None, 3)), np.ones((2, 2)), r"expected \(any, 3\)"),
    ],
)
def test_array_of_another_kind_is_refused(array, values, said, tmp_path):
    np.save(tmp_path / "a.npy", np.array(values))
    with pytest.raises(InputError, match=said):
        read_npy(tmp_path / "a.npy", array)


def test_archive_gives_only_plain_members(tmp_path):
    (tmp_path / "a.zip").write_bytes(pack({"a/b": b"x"}))
    with open_archive(tmp_path / "a.zip") as archive:
        assert archive.names == ("a/b",) and archive.read("a/b") == b"x"
    (tmp_path / "a.zip").write_bytes(pack({"a/../../b": b"x"}))
    with pytest.raises(InputError, match="leads elsewhere"), open_archive(tmp_path / "a.zip"):
        pass
