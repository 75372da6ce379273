"""Every reader of binary files against every kind of malformed file, bounded in time and memory."""

import os
import subprocess
import sys

import pytest

from malformed import READERS

EVERY = 23  # of the places where a number is replaced


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
@pytest.mark.parametrize("name", READERS)
def test_malformed_file_of_any_kind_is_read_rightly_or_refused_in_a_sentence(name, tmp_path):
    command = [sys.executable, "-m", "malformed", name, str(tmp_path), str(EVERY)]
    place = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, check=False, env=place
    )
    rows = [line.partition("\t") for line in done.stdout.splitlines()]
    assert rows[0][2] == "read", done.stderr
    wrong = [f"{kind}: {said or 'ended the process'}" for kind, _, said in rows
             if said not in ("read", "refused")]  # fmt: skip
    assert not wrong, "\n".join(wrong[:20])
    assert done.returncode == 0, done.stderr
    assert len(rows) > 30
    if name not in ("subtitles", "sensors of a film"):  # of which what can be read is
        assert {said for _, _, said in rows} >= {"refused"}
