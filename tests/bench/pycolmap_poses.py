"""Maps images by pycolmap, run by a Python of its own for `./run bench poses`.

It imports nothing of gsut: `PYTHON pycolmap_poses.py REQUEST.json ANSWER.json`.
"""

import importlib
import json
import sys
import time
from pathlib import Path
from typing import Any

MISSING = 3  # exit status where this Python has no pycolmap


def map_images(request: dict) -> dict:
    """Finds poses; returns them with seconds and processor seconds of each stage.

    Args:
        request: "images" (folder), "names", "work" (empty folder), "threads"; "single":
            one camera took all; "model" and "params" (COLMAP's) of the known lens, or None:
            SIMPLE_RADIAL, estimated.
    """
    pycolmap: Any = importlib.import_module("pycolmap")
    work = Path(request["work"])
    database, known = work / "database.db", request["model"] is not None
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = request["model"] if known else "SIMPLE_RADIAL"
    if known:
        reader.camera_params = ",".join(repr(value) for value in request["params"])
    seconds, cpu_seconds = {}, {}
    begin = time.perf_counter(), time.process_time()

    def lap(stage: str) -> None:
        nonlocal begin
        now = time.perf_counter(), time.process_time()
        seconds[stage], cpu_seconds[stage] = now[0] - begin[0], now[1] - begin[1]
        begin = now

    modes = pycolmap.CameraMode
    extraction = pycolmap.FeatureExtractionOptions()
    matching = pycolmap.FeatureMatchingOptions()
    mapping = pycolmap.IncrementalPipelineOptions()
    for options in (extraction, matching, mapping):
        options.num_threads = request["threads"]
    pycolmap.extract_features(
        database, request["images"], image_names=request["names"],
        camera_mode=modes.SINGLE if request["single"] else modes.PER_IMAGE, reader_options=reader,
        extraction_options=extraction, device=pycolmap.Device.cpu,
    )  # fmt: skip
    lap("features")
    pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
    lap("matching")
    mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = not known
    models = pycolmap.incremental_mapping(database, request["images"], work, options=mapping)
    lap("mapping")
    best = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    poses = {}
    for image in best.images.values() if best is not None else ():
        if image.has_pose:
            poses[image.name] = image.cam_from_world().matrix().tolist()
    return {
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "poses": poses,
        "version": pycolmap.__version__,
    }


def main() -> int:
    """Reads the request and writes the answer."""
    try:
        importlib.import_module("pycolmap")
    except ImportError:
        return MISSING
    request = json.loads(Path(sys.argv[1]).read_text())
    Path(sys.argv[2]).write_text(json.dumps(map_images(request)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
