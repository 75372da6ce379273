"""A model carries its response, order and primitive: through files, rows and merges."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.edit import merge_gaussians
from gsut.formats import open_ply
from gsut.formats.ply import read_comments
from random_scenes import random_gaussians

# A kind of rule, a name that is not the default, the default, and what the formats say of it.
RULES = [("response", "extinction", "maximum"), ("order", "ray", "distance")]
PRIMITIVE = ("primitive", "triangle", "gaussian")
with_each_rule = pytest.mark.parametrize(("kind", "name", "default"), RULES)
with_each_rule_and_primitive = pytest.mark.parametrize(
    ("kind", "name", "default"), [*RULES, PRIMITIVE]
)


def make_model(rng, primitive="gaussian", **rule):
    return dataclasses.replace(random_gaussians(rng, 40), **rule).to_primitive(primitive)


@with_each_rule_and_primitive
def test_rule_stays_with_rows_copies_types_and_origins(rng, kind, name, default):
    g = make_model(rng, **{kind: name})
    moved = g.translate((1e6, 0, 0))
    for same in (g[3:5], g.copy(), g.to_dtype(np.float64), moved, moved.with_origin((0, 0, 0))):
        assert getattr(same, kind) == name
    assert getattr(make_model(rng), kind) == default
    with pytest.raises(InputError, match=f'{kind} "beta" is unknown; known: {default}, '):
        dataclasses.replace(g, **{kind: "beta"})


@with_each_rule_and_primitive
def test_save_ply_names_the_rule_and_load_ply_reads_it(rng, tmp_path, kind, name, default):
    g, path = make_model(rng, **{kind: name}), tmp_path / "scene.ply"
    gsut.save_gaussians(path, g)
    assert f"gsut: {kind} {name}" in read_comments(path)
    found = gsut.load_gaussians(path)
    assert getattr(found, kind) == getattr(open_ply(path, memory=1), kind) == name
    assert found.means.tobytes() == g.means.tobytes()
    gsut.save_gaussians(path, dataclasses.replace(g, **{kind: default}))
    assert not any(kind in comment for comment in read_comments(path))
    assert getattr(gsut.load_gaussians(path), kind) == default


@with_each_rule_and_primitive
def test_load_ply_of_an_unknown_rule_is_refused(rng, tmp_path, kind, name, default):
    path = tmp_path / "scene.ply"
    gsut.save_gaussians(path, make_model(rng, **{kind: name}))
    path.write_bytes(path.read_bytes().replace(f"{kind} {name}".encode(), f"{kind} rye".encode()))
    with pytest.raises(InputError, match=rf"scene\.ply: .* known: {default}"):
        gsut.load_gaussians(path)


@with_each_rule
def test_save_gltf_names_the_rule_and_an_unknown_one_is_refused(rng, tmp_path, kind, name, default):
    path = tmp_path / "scene.glb"
    assert not gsut.save_gaussians(path, make_model(rng, **{kind: name})).left_out
    assert getattr(gsut.load_gaussians(path), kind) == name
    wrong = "?" * len(name)
    path.write_bytes(path.read_bytes().replace(f'"{name}"'.encode(), f'"{wrong}"'.encode()))
    with pytest.raises(InputError, match=rf"scene\.glb: extras .*\?\?.* known: {default}"):
        gsut.load_gaussians(path)
    extras = f'{{"gsut: {kind}":"{wrong}"}}'.encode()
    other = b'["another\'s"]'.ljust(len(extras))
    path.write_bytes(path.read_bytes().replace(extras, other))
    assert getattr(gsut.load_gaussians(path), kind) == default


def test_save_gltf_keeps_response_and_order_together(rng, tmp_path):
    gsut.save_gaussians(tmp_path / "scene.glb", make_model(rng, response="extinction", order="z"))
    found = gsut.load_gaussians(tmp_path / "scene.glb")
    assert (found.response, found.order) == ("extinction", "z")


@pytest.mark.parametrize("suffix", [".splat", ".compressed.ply"])
@with_each_rule
def test_save_other_formats_say_that_the_rule_is_lost(rng, tmp_path, suffix, kind, name, default):
    path = tmp_path / f"scene{suffix}"
    left_out = gsut.save_gaussians(path, make_model(rng, **{kind: name})).left_out
    assert any(f"the {kind} {name}: " in each and f"by the {default}" in each for each in left_out)
    assert getattr(gsut.load_gaussians(path), kind) == default
    left_out = gsut.save_gaussians(path, make_model(rng)).left_out
    assert not any(f"the {kind} " in each for each in left_out)


@with_each_rule_and_primitive
def test_merge_of_two_rules_is_refused(rng, kind, name, default):
    two = [make_model(rng, **{kind: name}), make_model(rng)]
    with pytest.raises(InputError, match=f"one {kind}, found {name}, {default}"):
        merge_gaussians(two)
    assert getattr(merge_gaussians([two[0], two[0]]), kind) == name
