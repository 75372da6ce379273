"""The public names of gsut, module by module: what docs/api.md lists and the tests check."""

import importlib

import gsut

# Submodules whose names are all public, in the order of docs/api.md.
WHOLE = ("poses", "rendering", "loop", "edit", "metrics", "machine")
# Public names of folders whose doors hold names for other folders, too.
OF_FOLDERS = {
    "lens": [
        "camera_models", "find_lenses", "LensProfile", "fit_camera", "convert_camera",
        "Conversion", "camera_from_info", "info_from_camera",
    ],
    "surface": [
        "MeshOptions", "fuse_depth", "render_depth_maps", "DepthMap", "points_from_depth",
    ],
    "formats": ["save_ply", "load_ply"],
}  # fmt: skip


def list_public_names() -> dict[str, list[str]]:
    """Returns the public names by module, as in {"gsut": [...], "gsut.lens": [...]}."""
    names = {"gsut": list(gsut.__all__)}
    names |= {f"gsut.{folder}": found for folder, found in OF_FOLDERS.items()}
    for name in WHOLE:
        module = importlib.import_module(f"gsut.{name}")
        names[f"gsut.{name}"] = list(module.__all__)
    return names
