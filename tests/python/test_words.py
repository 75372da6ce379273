"""The style guide's rules that can be counted: tests/words.py finds nothing."""

import ast

import words

# Findings that are allowed: nouns that the field uses as methods, such as `Camera.rays()`, and
# names that torch and gsplat prescribe (`backward`, `rasterization`).
ALLOWED = {"name": 11}
LEAST_COMMENTS = 0.09  # share of lines in .cpp and -inl.h that are comments, in each room


def test_product_follows_the_style_guide():
    found = words.find_all()
    for kind in {f.kind for f in found}:
        rows = [f"{f.path}:{f.line}: {f.text}" for f in found if f.kind == kind]
        assert len(rows) <= ALLOWED.get(kind, 0), "\n".join(rows)


def test_kernels_are_commented():
    rooms = words.list_kernels()
    assert len(rooms) >= 12
    assert sum(len(paths) for paths in rooms.values()) >= 100
    shares = {room: round(words.comment_share(paths), 4) for room, paths in rooms.items()}
    assert {room: share for room, share in shares.items() if share < LEAST_COMMENTS} == {}


def test_each_rule_finds_its_fault():
    tree = ast.parse('A, B = 1, 2\n\n\ndef settled(x):\n    """What is settled."""\n')
    kinds = [
        f.kind for f in (*words.check_functions("a.py", tree), *words.check_constants("a.py", tree))
    ]
    assert kinds == ["name", "docstring", "packed constants"]
    texts = iter([(1, "# as it was told"), (2, "# +0.5 dB on fox"), (3, "# see no_such_file.py")])
    kinds = [f.kind for f in words.check_words("a.py", texts, {"/tests/words.py"})]
    assert kinds == ["banned word", "history", "missing file"]
    texts = iter([(1, "# Rescales the scene."), (2, "# see words.py")])
    assert list(words.check_words("a.py", texts, {"/tests/words.py"})) == []
