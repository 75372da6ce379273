"""`lab/run gsplat CHECKOUT`: gsplat's own tests through `patch_gsplat`, on a CPU.

Those that gsut's functions can answer are copied, with the CPU in place of the GPU and fewer
Gaussians, and run against the checkout's gsplat. A test that asks for what gsut refuses, or for an
operator of gsplat's CUDA library, counts as refused, with the reason; any other failure as failed.
"""

from __future__ import annotations

import argparse
import collections
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
# Of gsplat's tests/core (before 1.6: tests): what compares rasterization, projections, harmonics,
# relocation and strategies.
FILES = (
    "test_basic.py",
    "test_ftheta.py",
    "test_mcmc_perturb.py",
    "test_rasterization.py",
    "test_relocation.py",
    "test_strategy.py",
)
# Text of its tests -> text that runs on a CPU in reasonable time.
_REPLACED = (
    ("cuda:0", "cpu"),
    ('"cuda"', '"cpu"'),
    ("not torch.cuda.is_available()", "False"),
    ("10_000", "300"),
)
_PLUGIN = "gsut_gsplat_plugin"
# What a test says that asks for what gsut does not have.
_REFUSALS = (("InputError: ",), ("_OpNamespace", "has no attribute"), ("No", "CUDA"),
             ("not", "CUDA"), ("not", "cuda"))  # fmt: skip
_LONGEST = 100  # characters of a reason


class Outcome(NamedTuple):
    """What became of one test."""

    file: str
    name: str
    kind: str  # "passed", "refused", "failed" or "skipped"
    reason: str


def find_tests(checkout: Path) -> Path:
    """Finds the folder of the tests of a checkout of gsplat.

    Raises:
        SystemExit: there is none, with what was expected.
    """
    if not (checkout / "gsplat" / "__init__.py").is_file():
        raise SystemExit(f"{checkout} has no gsplat/__init__.py: give the folder of a checkout")
    for folder in (checkout / "tests" / "core", checkout / "tests"):
        if any((folder / name).is_file() for name in FILES):
            return folder
    raise SystemExit(f"{checkout} has none of {', '.join(FILES)} in tests or tests/core")


def copy_tests(checkout: Path, folder: Path) -> list[Path]:
    """Copies all Python files of the checkout's tests for a CPU; returns those to run."""
    chosen = find_tests(checkout)
    for source in sorted((checkout / "tests").rglob("*.py")):
        text = source.read_text("utf-8")
        for gpu, cpu in _REPLACED:
            text = text.replace(gpu, cpu)
        copy = folder / source.relative_to(checkout)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(text, "utf-8")
    there = [folder / (chosen / name).relative_to(checkout) for name in FILES]
    return [copy for copy in there if copy.is_file()]


def read_report(path: Path) -> list[Outcome]:
    """Reads the outcomes of a run of pytest from its JUnit report."""
    found = []
    for case in ElementTree.parse(path).iter("testcase"):
        file = case.get("classname", "").split(".")[-1] or case.get("name", "")
        kind, reason = "passed", ""
        for child in case:
            text = f"{child.get('message') or ''}\n{child.text or ''}"
            if child.tag == "skipped":
                kind, reason = "skipped", child.get("message") or ""
            elif child.tag in ("failure", "error"):
                kind, reason = judge_failure(text)
        found.append(Outcome(file, case.get("name", ""), kind, reason[:_LONGEST]))
    return found


def judge_failure(text: str) -> tuple[str, str]:
    """Tells what gsut refuses from what it does wrong; the reason is one line."""
    for words in _REFUSALS:
        for line in text.splitlines():
            if all(word in line for word in words):
                return "refused", line[line.find(words[0]) :].removeprefix("InputError:").strip()
    return "failed", text.strip().splitlines()[0] if text.strip() else "no message"


def describe(outcomes: Sequence[Outcome]) -> str:
    """Describes outcomes: a line a file, then the reasons with their numbers."""
    kinds = ("passed", "refused", "failed", "skipped")
    lines = [f"{'file':28s}{'run':>6s}" + "".join(f"{kind:>9s}" for kind in kinds)]
    for file in dict.fromkeys(outcome.file for outcome in outcomes):
        of_file = collections.Counter(o.kind for o in outcomes if o.file == file)
        run = sum(of_file.values()) - of_file["skipped"]
        lines.append(f"{file:28s}{run:6d}" + "".join(f"{of_file[kind]:9d}" for kind in kinds))
    for kind in kinds[1:]:
        reasons = collections.Counter(o.reason for o in outcomes if o.kind == kind)
        lines += [f"{kind} {number}: {reason}" for reason, number in reasons.most_common()]
    return "\n".join(lines)


def run_tests(checkout: Path) -> list[Outcome]:
    """Runs the chosen tests of a checkout in a process of their own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = copy_tests(checkout.resolve(), folder)
        (folder / f"{_PLUGIN}.py").write_text(
            f"import sys\nsys.path.append({str(ROOT)!r})\n"
            f"from importlib.util import module_from_spec, spec_from_file_location\n"
            f"spec = spec_from_file_location('gsut_run', {str(Path(__file__))!r})\n"
            "module = module_from_spec(spec)\nspec.loader.exec_module(module)\nmodule.patch()\n",
            "utf-8",
        )
        report = folder / "report.xml"
        command = [
            sys.executable, "-m", "pytest", "-q", "-p", _PLUGIN, "-p", "no:cacheprovider",
            "--continue-on-collection-errors", "--rootdir", name, f"--junitxml={report}",
            *map(str, files),
        ]  # fmt: skip
        path = os.pathsep.join([name, str(checkout.resolve())])
        done = subprocess.run(
            command, cwd=name, env={**os.environ, "PYTHONPATH": path}, capture_output=True,
            text=True,
        )  # fmt: skip
        if not report.is_file():
            raise SystemExit(f"pytest wrote no report:\n{done.stdout}{done.stderr}")
        return read_report(report)


def patch() -> None:
    """Puts gsut's functions into gsplat, before its tests are imported."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("find_torch", ROOT / "tests" / "find_torch.py")
    assert spec is not None and spec.loader is not None
    finder = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(finder)
    torch = finder.find_torch()
    from gsut.torch import patch_gsplat

    patch_gsplat()
    gsplat = importlib.import_module("gsplat")
    for name in ("has_3dgs", "has_3dgut"):  # what the checkout was built with
        if hasattr(gsplat, name):
            setattr(gsplat, name, lambda: True)
    torch.cuda.synchronize = torch.cuda.empty_cache = lambda *_: None


def main(words: Sequence[str] | None = None) -> int:
    """Runs the tests and prints what became of them; 1 if any failed or none passed."""
    parser = argparse.ArgumentParser(prog="lab/run gsplat", description=__doc__)
    parser.add_argument("checkout", type=Path, help="folder of a checkout of gsplat")
    outcomes = run_tests(parser.parse_args(words).checkout)
    print(describe(outcomes))
    kinds = {outcome.kind for outcome in outcomes}
    return int("failed" in kinds or "passed" not in kinds)


if __name__ == "__main__":
    sys.exit(main())
