"""The terminal: names and texts of files cannot move its cursor, colour it or forge a line."""

import io
import json
import shutil
import sys
import unicodedata
import warnings

import pytest

import gsut
from gsut.cli import main
from gsut.run import Progress
from gsut.terminal import TerminalStream, escape_controls, say
from small_datasets import write_nerfstudio

# Title, colours, cursor, C1's CSI, a line gone over, the direction of text, a forged line.
HOSTILE = "a\x1b]0;title\x07\x1b[31m\x9b2J\r\b\x7f\u202e\u2066\u2028\ngsut: error: forged"


def test_every_control_character_but_tab_and_line_feed_is_escaped():
    orders = [c for c in map(chr, range(0x300)) if unicodedata.category(c) == "Cc"]
    orders += [c for c in map(chr, range(0x2000, 0x2070)) if unicodedata.bidirectional(c) in
               ("LRE", "RLE", "PDF", "LRO", "RLO", "LRI", "RLI", "FSI", "PDI", "B")]  # fmt: skip
    assert len(orders) >= 65 + 10
    for one in orders:
        shown = escape_controls(one)
        assert shown == (one if one in "\t\n" else f"\\u{ord(one):04x}")
    plain = "Ä 漢字 👩‍🚀 \u2009 °"
    assert escape_controls(plain) == plain


def test_stream_keeps_a_bar_s_return_and_escapes_the_rest():
    out = io.StringIO()
    print("\r 50% a\rb", file=TerminalStream(out))
    assert out.getvalue() == "\r 50% a\\u000db\n"


def test_messages_are_one_line(capsys):
    say("note: a\nb\u2028c")
    assert capsys.readouterr().err == "gsut: note: a b c\n"


def test_bar_and_notes_of_the_api_escape_names():
    file = io.StringIO()
    with Progress(file=file) as bars:
        bars.note(HOSTILE)
        for done in range(3):
            bars.show("reading", done, 2, HOSTILE)
    check(file.getvalue())


def check(text: str) -> None:
    """The text gives the terminal no order, forges no line, and shows the name."""
    orders = set(text) & {chr(code) for code in (*range(9), *range(11, 32), *range(127, 160))}
    assert orders <= {"\r"} and not set(text) & set("\u202e\u2066\u2028")
    assert not any(line.startswith("gsut: error: forged") for line in text.split("\n"))
    assert "\\u001b]0;title\\u0007" in text or repr("\x1b]0;title\x07")[1:-1] in text


@pytest.fixture
def dataset(tmp_path):
    """A dataset whose second image is missing and whose names and texts are hostile."""
    folder = write_nerfstudio(tmp_path / "data")
    file = folder / "transforms.json"
    values = json.loads(file.read_text())
    first = values["frames"][0]
    name = f"images/{HOSTILE.replace('/', '')}.png"
    shutil.move(folder / first["file_path"], folder / name)
    first["file_path"] = name
    values["frames"][1]["file_path"] = f"images/missing-{HOSTILE}.png"
    file.write_text(json.dumps(values))
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ["doctor", "{data}"],
        ["doctor", "{data}", "--json"],
        ["data", "convert", "{data}", "{out}", "--to", "colmap"],
        ["train", "{data}", "-o", "{out}", "--steps", "1", "--force"],
        ["depth", "{data}/" + HOSTILE, "-o", "{out}"],
        ["camera", "convert", "{data}/" + HOSTILE, "opencv8"],
        [HOSTILE],
    ],
)
def test_commands_escape_the_names_of_files(dataset, tmp_path, capfd, words):
    given = sys.stdout, sys.stderr
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main([word.format(data=dataset, out=tmp_path / "out") for word in words])
    assert (sys.stdout, sys.stderr) == given
    out, err = capfd.readouterr()
    check(out + err)
    if "--json" in words:
        assert any(HOSTILE in each["what"] for each in json.loads(out))


def test_warnings_of_python_are_escaped(capsys, monkeypatch):
    monkeypatch.setattr(
        gsut.cli.doctor, "run", lambda _: warnings.warn(HOSTILE, stacklevel=1) or 0, raising=True
    )
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["doctor", "x"]) == 0
    check(capsys.readouterr().err)
