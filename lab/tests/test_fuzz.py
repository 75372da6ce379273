"""A few rounds of `lab/run fuzz`: damaged files of any format are read or refused in a sentence."""

from lab import fuzz

ROUNDS = 4


def test_every_reader_takes_or_refuses_damaged_files(tmp_path):
    files, count = fuzz.fuzz(tmp_path, seconds=60.0, seed=0, rounds=ROUNDS)
    assert files >= 40
    assert count == ROUNDS * files
