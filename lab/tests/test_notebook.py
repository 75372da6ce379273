"""The notebook: each page says what was asked, when, at which commit and what was decided."""

import re

from lab.bench.figures import ROOT

NOTEBOOK = sorted((ROOT / "lab" / "notebook").glob("*.md"))


def test_notebook_pages_state_question_date_commit_and_decision():
    pages = [path for path in NOTEBOOK if path.name != "README.md"]
    assert len(pages) >= 10
    for path in pages:
        text = path.read_text()
        assert re.match(r"# .+\?\n", text), path.name
        assert re.search(r"\b20\d\d-\d\d-\d\d\b", text) and " commit " in " ".join(text.split()), (
            path.name
        )
        assert "\nDecision" in text, path.name
