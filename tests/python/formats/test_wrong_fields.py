"""Fields of scene files outside their range: refused by the field's name, never read otherwise."""

import re

import numpy as np
import pytest

from formats.scene_cases import plain_scene
from formats.wrong_fields import WRONG
from gsut import InputError, formats

COUNT = 300


@pytest.mark.parametrize(("suffix", "case"), WRONG)
def test_wrong_field_is_refused_by_its_name(tmp_path, suffix, case):
    path = tmp_path / f"a{suffix}"
    formats.save_gaussians(path, plain_scene(np.random.default_rng(1), COUNT))
    spoil, said = WRONG[suffix, case]
    spoil(path)
    with pytest.raises(InputError, match=re.escape(said)):
        formats.load_gaussians(path)
