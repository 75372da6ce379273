"""Every reader against every mutation: Gaussians that can be drawn, or one sentence; no bombs."""

import re
import struct
import tracemalloc
import warnings

import numpy as np
import pytest

from formats.scene_cases import plain_scene
from gsut import InputError, formats
from gsut.formats import WriteSettings
from tolerances import HOSTILE_BYTES

COUNT = 300
READ = {each.name: each for each in formats.list_formats() if each.read is not None}
HUGE = 4_000_000_000


def words(data, value):
    """Counts in text headers and in binary ones replaced."""
    text = re.sub(rb"\b%d\b" % COUNT, b"%d" % value, data)
    return text.replace(struct.pack("<I", COUNT), struct.pack("<I", value % 2**32))


def with_floats(data, value):
    """Every ninth word of the second half is another float."""
    changed = bytearray(data)
    for place in range(len(data) // 2 & ~3, len(data) - 4, 36):
        changed[place : place + 4] = struct.pack("<f", value)
    return bytes(changed)


MUTATIONS = {
    "empty": lambda data: b"",
    "text": lambda data: b"hello, this is no scene\n" * 40,
    "zeros": lambda data: bytes(len(data)),
    "its head": lambda data: data[:96],
    "its head and zeros": lambda data: data[: len(data) // 3] + bytes(2 * len(data) // 3),
    "without its end": lambda data: data[:-7],
    "twice": lambda data: data + data,
    "backwards": lambda data: data[::-1],
    "count huge": lambda data: words(data, HUGE),
    "count 0": lambda data: words(data, 0),
    "count one more": lambda data: words(data, COUNT + 1),
    "NaN": lambda data: with_floats(data, float("nan")),
    "infinity": lambda data: with_floats(data, float("inf")),
    "largest floats": lambda data: with_floats(data, 3e38),
    "minus signs": lambda data: data.replace(b'":', b'":-'),
    "brackets": lambda data: data.replace(b"[", b"[[[["),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """name of a format -> content of a file of it."""
    folder, made = tmp_path_factory.mktemp("whole"), {}

    def content(chosen):
        if chosen.name == "USD":
            pytest.importorskip("pxr", reason="usd-core reads and writes USD")
        if chosen.name not in made:
            path = folder / f"a{chosen.suffixes[0]}"
            formats.save_gaussians(path, plain_scene(np.random.default_rng(1), COUNT))
            made[chosen.name] = path.read_bytes()
        return made[chosen.name]

    return content


def read_or_refused(path):
    """Reads; what is read can be drawn, what is not is refused by the file's name."""
    tracemalloc.start()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = formats.load_gaussians(path)
        assert formats.find_drawable(found).all()
        assert len(found) <= 2 * COUNT
        return "read"
    except InputError as error:
        assert path.name in str(error) and "\n" not in str(error).strip()
        return "refused"
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < HOSTILE_BYTES


@pytest.mark.parametrize("chosen", READ.values(), ids=lambda each: each.name)
def test_every_mutation_is_read_or_refused_in_a_sentence(tmp_path, whole, chosen):
    data, outcomes = whole(chosen), {}
    for name, mutate in MUTATIONS.items():
        if chosen.name == "USD" and name not in ("empty", "text", "zeros", "its head"):
            continue  # Pixar's library may take minutes over its own damaged files
        path = tmp_path / f"mutated{chosen.suffixes[0]}"
        path.write_bytes(mutate(data))
        outcomes[name] = read_or_refused(path)
    assert len(outcomes) == (4 if chosen.name == "USD" else len(MUTATIONS))
    assert outcomes["text"] == "refused" or chosen.name == "splat"  # 960 bytes are 30 splats
    assert outcomes["empty"] == "refused"


@pytest.mark.parametrize("version", [3, 4])
def test_spz_streams_that_swell_are_not_unpacked(tmp_path, version):
    if version == 4:
        zstandard = pytest.importorskip("zstandard", reason="zstandard compresses SPZ 4")
    path = tmp_path / "bomb.spz"
    g = plain_scene(np.random.default_rng(1), COUNT)
    formats.save_gaussians(path, g, WriteSettings(spz_version=version))
    if version == 4:
        data = bytearray(path.read_bytes())
        bomb = zstandard.ZstdCompressor().compress(bytes(10**8))
        table = struct.unpack_from("<I", data, 16)[0]
        struct.pack_into("<QQ", data, table, len(bomb), 10**8)
        path.write_bytes(bytes(data) + bomb)
    else:
        import gzip

        path.write_bytes(gzip.compress(bytes(10**7)))
    assert read_or_refused(path) == "refused"
