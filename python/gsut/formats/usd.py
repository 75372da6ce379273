"""USD files with a ParticleField3DGaussianSplat (OpenUSD 26), by Pixar's library."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import register_reader, whole_file
from gsut.formats._axes import place_in_world, turn_half
from gsut.formats._format import Format, SceneFile, WriteSettings, Written, check_claim
from gsut.formats._quantize import logits_from_opacity, normalize_quats, opacity_from_logits
from gsut.gaussians import Gaussians
from gsut.run import limit_memory

_SCHEMA = "ParticleField3DGaussianSplat"
_HARMONICS = "radiance:sphericalHarmonicsCoefficients"
_DEGREE = "radiance:sphericalHarmonicsDegree"
# Bytes that reading any file may take, and times its size: the library takes what a file claims.
_FREE_BYTES = 1 << 30
_MOST_TIMES = 64


def _import_library() -> tuple[Any, ...]:
    try:
        from pxr import Gf, Tf, Usd, UsdGeom, UsdVol, Vt

        UsdVol.ParticleField3DGaussianSplat  # noqa: B018  # since OpenUSD 26
    except (ImportError, AttributeError):
        raise InputError(
            "USD needs Pixar's library, 26 or later, which Python lacks here: pip install usd-core"
        ) from None
    return Gf, Tf, Usd, UsdGeom, UsdVol, Vt


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    _, _, usd, geometry, volume, vt = _import_library()
    g = turn_half(gaussians)
    packed = path.suffix.lower() == ".usdz"
    with whole_file(path) as temporary, TemporaryDirectory(prefix="gsut-") as folder:
        layer = Path(folder) / f"{path.stem}.usdc" if packed else temporary
        stage = usd.Stage.CreateNew(str(layer))
        geometry.SetStageUpAxis(stage, geometry.Tokens.y)
        geometry.SetStageMetersPerUnit(stage, 1.0)
        field = volume.ParticleField3DGaussianSplat.Define(stage, "/Gaussians")
        stage.SetDefaultPrim(field.GetPrim())
        field.CreatePositionsAttr(vt.Vec3fArray.FromNumpy(g.means))
        xyzw = normalize_quats(g.quats)[:, [1, 2, 3, 0]].astype(np.float32)  # as in memory
        field.CreateOrientationsAttr(vt.QuatfArray.FromNumpy(np.ascontiguousarray(xyzw)))
        field.CreateScalesAttr(vt.Vec3fArray.FromNumpy(np.exp(g.log_scales)))
        field.CreateOpacitiesAttr(vt.FloatArray.FromNumpy(opacity_from_logits(g.opacity_logits)))
        harmonics = vt.Vec3fArray.FromNumpy(g.sh.reshape(-1, 3))
        field.CreateRadianceSphericalHarmonicsCoefficientsAttr(harmonics)
        field.CreateRadianceSphericalHarmonicsDegreeAttr(g.sh_degree)
        reach = 3 * np.exp(g.log_scales.max(axis=1, keepdims=True))
        box = np.stack([(g.means - reach).min(axis=0), (g.means + reach).max(axis=0)])
        field.CreateExtentAttr(vt.Vec3fArray.FromNumpy(box.astype(np.float32)))
        field.CreateSortingModeHintAttr("cameraDistance")
        field.CreateProjectionModeHintAttr("perspective")
        stage.GetRootLayer().Save()
        if packed:
            from pxr import Sdf

            package = Sdf.ZipFileWriter.CreateNew(str(temporary))
            package.AddFile(str(layer), layer.name)
            package.Save()
    left_out = ("USD cannot say that a scene is antialiased",) if settings.antialiased else ()
    return Written(None, {}, left_out)


@register_reader("USD", ".usdc", ".usda", ".usd", ".usdz")
def _read(path: Path) -> SceneFile:
    _, tf, usd, geometry, _, _ = _import_library()
    try:
        with limit_memory(_FREE_BYTES + _MOST_TIMES * path.stat().st_size):
            return _read_stage(path, usd.Stage.Open(str(path)), geometry)
    except (tf.ErrorException, MemoryError) as error:
        quoted = str(error).partition(": '")[2].partition("'\n")[0].removesuffix("'")
        why = " ".join((quoted or str(error)).split())
        raise InputError(f"{path}: no USD file, or damaged: {why}") from None


def _read_stage(path: Path, stage: Any, geometry: Any) -> SceneFile:
    found = [prim for prim in stage.Traverse() if prim.GetTypeName() == _SCHEMA]
    if len(found) != 1:
        raise InputError(f"{path}: {len(found)} prims of type {_SCHEMA}; gsut reads one")
    place = np.array(geometry.XformCache().GetLocalToWorldTransform(found[0])).T  # rows to columns
    g = place_in_world(_decode_gaussians(path, found[0]), place, f"{path}: {found[0].GetPath()}")
    # gsut's own have y up; what has z up is left as it is.
    up = geometry.GetStageUpAxis(stage)
    return SceneFile(turn_half(g) if up == geometry.Tokens.y else g)


def _decode_gaussians(path: Path, prim: Any) -> Gaussians:
    def read_values(name: str, width: int) -> np.ndarray:
        """Reads the attribute in float or, if that is empty, in half precision."""
        both = [prim.GetAttribute(each).Get() for each in (name, f"{name}h")]
        filled = [each for each in both if each is not None and len(each)]
        if not filled:
            raise InputError(f"{path}: {prim.GetPath()} has no {name}")
        return np.array(filled[0], np.float32).reshape(-1, width)

    means = read_values("positions", 3)
    count = len(means)
    check_claim(path, count, path.stat().st_size)
    degree = prim.GetAttribute(_DEGREE).Get()
    arrays = {
        "orientations": read_values("orientations", 4),
        "scales": read_values("scales", 3),
        "opacities": read_values("opacities", 1),
    }
    sh = read_values(_HARMONICS, 3)
    lengths = {name: len(array) for name, array in arrays.items()}
    if degree not in (0, 1, 2, 3) or len(sh) != count * (degree + 1) ** 2:
        raise InputError(
            f"{path}: {len(sh):,} harmonics of degree {degree} for {count:,} Gaussians; "
            f"(degree + 1)^2 each are needed, degree 0 to 3"
        )
    if set(lengths.values()) != {count}:
        raise InputError(f"{path}: {count:,} positions, but {lengths}")
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(arrays["scales"])
    return Gaussians(
        means,
        arrays["orientations"][:, [3, 0, 1, 2]],
        log_scales,
        logits_from_opacity(arrays["opacities"][:, 0]),
        sh.reshape(count, -1, 3),
    )


FORMAT = Format("USD", (".usdc", ".usda", ".usd", ".usdz"), _write, _read, lambda head: True)
