"""Writes what a wheel links in: a page of licences, and a bill of materials (CycloneDX).

    python .ci/write_inventory.py build/sources PREFIX

The files are PREFIX/licenses/README.txt and PREFIX/sboms/gsut.cdx.json. The libraries are those
whose licence stands in PREFIX/licenses; names, versions, homepages and checksums are those of
Debian's source packages (*.dsc) in build/sources.
"""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import metadata
from pathlib import Path
from typing import NamedTuple

LICENSES = {
    "eigen3": "MPL-2.0",
    "highway": "Apache-2.0 OR BSD-3-Clause",
    "onetbb": "Apache-2.0",
    "ceres-solver": "BSD-3-Clause",
    "pybind11": "BSD-3-Clause",
}


class Library(NamedTuple):
    name: str
    version: str
    homepage: str
    sources: dict[str, str]  # file name to SHA-256


def read_source_package(path: Path) -> Library:
    """Reads a description (.dsc) of a Debian source package."""
    text = path.read_text(encoding="utf-8")
    fields = dict(re.findall(r"^(Source|Version|Homepage): (.*)$", text, re.MULTILINE))
    sums = re.search(r"^Checksums-Sha256:\n((?: .*\n)+)", text, re.MULTILINE)
    if sums is None or len(fields) != 3:
        raise SystemExit(f"{path}: no source, version, homepage or SHA-256 sums")
    sources = {line.split()[2]: line.split()[0] for line in sums[1].splitlines()}
    return Library(fields["Source"], fields["Version"], fields["Homepage"], sources)


def list_libraries(sources: Path, prefix: Path) -> list[Library]:
    """Lists the libraries built into `prefix`, then pybind11, whose headers are compiled in."""
    packages = [read_source_package(path) for path in sorted(sources.glob("*.dsc"))]
    built = [library for library in packages if (prefix / "licenses" / library.name).is_dir()]
    if not built:
        raise SystemExit(f"{prefix}/licenses: no library of {sources}")
    of_python = metadata("pybind11")
    homepage = f"https://github.com/pybind/pybind11/tree/v{of_python['Version']}"
    return [*built, Library("pybind11", of_python["Version"], homepage, {})]


def describe(libraries: list[Library]) -> str:
    """Describes each library, its licence and where its source is."""
    lines = [
        "The module of gsut is linked with these libraries, whose licences lie beside this file.",
        "They are unchanged but for Debian's patches; the sources of each are free at its homepage",
        "and, with the sums below, as Debian's source package of that version.",
    ]
    for library in libraries:
        license = LICENSES[library.name]
        lines += ["", f"{library.name} {library.version}", f"  licence   {license}"]
        lines.append(f"  homepage  {library.homepage}")
        lines += [
            f"  source    {name}  sha256 {digest}" for name, digest in library.sources.items()
        ]
    return "\n".join(lines) + "\n"


def make_component(library: Library) -> dict[str, object]:
    """Returns a library as CycloneDX states a component."""
    kind = "deb/debian" if library.sources else "pypi"
    return {
        "type": "library",
        "name": library.name,
        "version": library.version,
        "licenses": [{"expression": LICENSES[library.name]}],
        "purl": f"pkg:{kind}/{library.name}@{library.version.replace('+', '%2B')}",
        "externalReferences": [{"type": "website", "url": library.homepage}],
        "properties": [
            {"name": f"sha256 of source {name}", "value": digest}
            for name, digest in library.sources.items()
        ],
    }


def main() -> None:
    sources, prefix = (Path(word) for word in sys.argv[1:])
    libraries = list_libraries(sources, prefix)
    (prefix / "sboms").mkdir(exist_ok=True)
    (prefix / "licenses" / "README.txt").write_text(describe(libraries), encoding="utf-8")
    bill = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "components": [make_component(library) for library in libraries],
    }
    path = prefix / "sboms" / "gsut.cdx.json"
    path.write_text(json.dumps(bill, indent=2) + "\n", encoding="utf-8")


main()
