"""Packs calibrated lenses into python/gsut/lens/profiles.json.xz, which `gsut camera find` reads.

    python .ci/pack_lens_profiles.py profiles.jsonl.gz python/gsut/lens/profiles.json.xz

The input has one JSON object a line, with values of the JSON files of the public repository
gyroflow/lens_profiles under short names: brand, model, lens, setting, note, official, w, h, fps,
stretch, fx, fy, cx, cy, k, rms, images, radial_limit, readout_ms, digital_lens, sizes. It puts
pixel centres at integers; the output at halves. Texts that recur are written once. Profiles with a
focal length that is not positive are left out.
"""

from __future__ import annotations

import gzip
import json
import lzma
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ORIGIN = "https://github.com/gyroflow/lens_profiles, commit 886fc61"
LICENCE = "CC0 1.0 (https://creativecommons.org/publicdomain/zero/1.0/)"
TEXTS = ("brand", "model", "lens", "setting", "note", "digital_lens")
COLUMNS = (
    *TEXTS, "official", "width", "height", "fps", "params", "rms", "images", "radial_limit",
    "readout_ms", "sizes",
)  # fmt: skip


def pack(profiles: Iterable[dict[str, Any]]) -> bytes:
    """Returns the bytes of the packed file."""
    texts: dict[str, int] = {}
    rows = [make_row(p, texts) for p in profiles if min(p["fx"], p["fy"]) > 0]
    values = {
        "origin": ORIGIN, "licence": LICENCE, "columns": COLUMNS, "texts": list(texts),
        **{name: [row[name] for row in rows] for name in COLUMNS},
    }  # fmt: skip
    text = json.dumps(values, ensure_ascii=False, separators=(",", ":"))
    return lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME)


def make_row(p: dict[str, Any], texts: dict[str, int]) -> dict[str, Any]:
    # Anamorphic profiles describe the stretched picture; the camera stores the unstretched one.
    across, down = p["stretch"]
    params = [
        p["fx"] / across, p["fy"] / down, (p["cx"] + 0.5) / across, (p["cy"] + 0.5) / down,
    ]  # fmt: skip
    return {
        **{name: texts.setdefault(p[name] or "", len(texts)) for name in TEXTS},
        "official": int(p["official"]),
        "width": round(p["w"] / across),
        "height": round(p["h"] / down),
        "fps": round_to(p["fps"], 5),
        "params": [*(round_to(v, 6) for v in params), *(round_to(v, 5) for v in p["k"])],
        "rms": round_to(p["rms"], 3),
        "images": p["images"],
        "radial_limit": round_to(p["radial_limit"], 4) or None,
        "readout_ms": round_to(p["readout_ms"], 4) or None,
        "sizes": p["sizes"],
    }


def round_to(value: float | None, digits: int) -> float | None:
    """To so many significant digits."""
    return None if value is None else float(f"{value:.{digits}g}")


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    with gzip.open(source, "rt", encoding="utf-8") as lines:
        target.write_bytes(pack(map(json.loads, lines)))
