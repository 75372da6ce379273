"""The core as WebAssembly: the bits of native code without vectors, its errors, its sources."""

import importlib.util
import json
import sys

import numpy as np
import pytest

import gsut
from core_in_node import (
    CORE,
    ROOT,
    digest,
    draw_in_browser,
    draw_in_node,
    draw_natively,
    hold_least_isa,
    run_node,
)
from gsut import _core
from random_scenes import (
    fisheye,
    gaussians_in_view,
    list_models,
    random_pose,
    rng_of,
    small_camera,
)
from tolerances.view import CORE_LINES


@pytest.fixture
def scalar():
    yield from hold_least_isa()


def test_core_every_central_lens_has_the_bits_of_native_scalar(tmp_path, scalar):
    jobs = []
    for model in list_models():
        for example in range(len(_core.camera_examples(model))):
            camera = small_camera(model, example, 96)
            if not camera.is_central:
                continue
            rng = rng_of(f"{model}{example}")
            pose = random_pose(rng)
            degree = len(jobs) % 4
            found = gaussians_in_view(rng, camera, pose, 200, sh_degree=degree)
            jobs.append((found, camera, pose, pose, "global"))
    images = [draw_natively(*job) for job in jobs]
    for job, image, native in zip(jobs, draw_in_node(tmp_path, jobs), images, strict=True):
        np.testing.assert_array_equal(image, native, err_msg=job[1].model)
    firsts = [[job[1].model for job in jobs].index(name) for name in {j[1].model for j in jobs}]
    digests = draw_in_browser(tmp_path, [jobs[row] for row in firsts])
    assert digests == [digest(images[row]) for row in firsts]


def test_core_lines_are_those_of_native_scalar_but_for_the_c_library(tmp_path, scalar):
    camera, rng = fisheye(64, degrees=170.0), rng_of("lines")
    pose = random_pose(rng)
    twist = np.array([0.02, 0, 0, 0.1, 0.05, 0])
    start, end = gsut.exp_pose(-twist) @ pose, gsut.exp_pose(twist) @ pose
    jobs = [(gaussians_in_view(rng, camera, pose, 100), camera, start, end, "top_to_bottom")]
    for model in ("cahvore", "orthographic"):
        lens = small_camera(model, 0, 96)
        jobs.append((gaussians_in_view(rng, lens, pose, 100), lens, pose, pose, "global"))
    for job, image in zip(jobs, draw_in_node(tmp_path, jobs), strict=True):
        np.testing.assert_allclose(image, draw_natively(*job), atol=CORE_LINES)


def test_core_wrong_values_are_refused_in_words(tmp_path):
    cases = {
        "core.makeCamera({ model: 'pinhol', params: [1], width: 3, height: 3 })": "known: ",
        "core.makeCamera({ model: 'pinhole', params: [1], width: 3, height: 3 })": "parameters",
        "core.makeCamera({ model: 'pinhole', params: [1, 1, 1, NaN], width: 3, height: 3 })": "",
        "core.readCamera('{ nothing', 'a.cameramodel')": "a.cameramodel, line 1",
        "core.describeCamera(7)": "there is no object 7",
        "core.render(core.makeCamera({ model: 'pinhole', params: [9, 9, 4, 4], width: 8,"
        " height: 8 }), { width: 8, height: 8, start: new Array(16).fill(0) })": "no Gaussians",
    }  # fmt: skip
    script = "const {Core} = require(process.argv[2] + '/core.js'); (async () => {" + (
        "const core = await Core.load(require('zlib').gunzipSync("
        "require('fs').readFileSync(process.argv[2] + '/core.wasm.gz'))); const words = [];"
    )
    for expression in cases:
        script += (
            f"try {{ {expression}; words.push(null); }} catch (e) {{ words.push(e.message); }}"
        )
    (tmp_path / "cases.js").write_text(script + "console.log(JSON.stringify(words)); })();")
    done = run_node(tmp_path / "cases.js", CORE)
    words = json.loads(done.stdout)
    assert len(words) == len(cases)
    for expected, found in zip(cases.values(), words, strict=True):
        assert found is not None and expected in found


def test_core_was_made_from_these_sources():
    spec = importlib.util.spec_from_file_location("sources", ROOT / "lab/list_wasm_sources.py")
    listing = importlib.util.module_from_spec(spec)
    sys.modules["sources"] = listing
    spec.loader.exec_module(listing)
    rows = [line.split() for line in (CORE / "core.sources").read_text().splitlines()]
    assert len(rows) > 100
    changed = [
        name
        for digits, name in rows
        if not (ROOT / name).is_file()
        or listing.hash_code((ROOT / name).read_text(encoding="utf-8")) != digits
    ]
    listed = {name for _, name in rows}
    for path in (ROOT / "cpp/gsut/cameras").glob("[mf]*/*.h"):
        if str(path.relative_to(ROOT)) not in listed:
            changed.append(str(path.relative_to(ROOT)))
    assert not changed, f"lab/run wasm makes core.wasm.gz again; changed: {', '.join(changed)}"
