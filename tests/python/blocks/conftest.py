"""One run in blocks that this folder's tests share."""

import pytest

from small_blocks import small_scene, train


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A folder with a dataset, "data", and a run on it in 3 blocks and two rounds, "run"."""
    folder = tmp_path_factory.mktemp("blocks")
    train(small_scene(folder / "data"), folder / "run", report=True)
    return folder
