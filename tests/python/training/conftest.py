"""The rendered scene that most tests of training share."""

import numpy as np
import pytest

import gsut
from rendered_dataset import write_dataset


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """The folder of a dataset with points and a test split."""
    folder = tmp_path_factory.mktemp("training") / "data"
    return write_dataset(folder, np.random.default_rng(20260821))


@pytest.fixture(scope="session")
def scene(dataset):
    return gsut.load_dataset(dataset)
