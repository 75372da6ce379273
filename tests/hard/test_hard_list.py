"""The list of hard cases: each of the twenty is named by a file of tests."""

import re
from pathlib import Path


def test_every_hard_case_is_named_by_a_file_with_tests():
    named = set()
    for path in Path(__file__).parent.glob("test_hard_*.py"):
        text = path.read_text(encoding="utf-8")
        head = re.match(r'"""Hard cases? ([\d, and]+):', text)
        if head:
            assert "\ndef test_" in text, path.name
            named |= {int(number) for number in re.findall(r"\d+", head[1])}
    assert named == set(range(1, 21))
