"""`gsut doctor`: what is wrong with a dataset, in words."""

from __future__ import annotations

import argparse
import dataclasses

from gsut.cli._flags import add_json, print_result

HELP = "what is wrong with a dataset, in words"
DESCRIPTION = (
    "Looks for everything in a dataset that would stop or spoil training. The exit status is 2 if "
    "training cannot start."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="the dataset")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.check import doctor, format_findings

    findings = doctor(arguments.data)
    rows = [dataclasses.asdict(finding) for finding in findings]
    print_result(arguments, rows, [format_findings(findings)])
    return 2 if any(finding.severity == "error" for finding in findings) else 0
