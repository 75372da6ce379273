"""Writes everything that a run found, with its notes and verdict."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gsut.data.rigs import write_rig
from gsut.files import write_file
from gsut.sfm.core import Mapping
from gsut.sfm.lens import compare_lens, describe_zooms
from gsut.sfm.report.output import FIGURES, list_figures, write_dataset, write_models
from gsut.sfm.report.page import write_report
from gsut.sfm.report.verdict import judge_solution, list_notes
from gsut.sfm.rig import COVARIANCE_OF, write_lens_pair

RIG = "rig.json"


def write_poses(mapping: Mapping, folder: Path, made_from: str) -> dict[str, Any]:
    """Writes dataset, rig, poses.json and report.html; returns the content of poses.json.

    Args:
        made_from: digest of all that the poses depend on.
    """
    solution, found, log = mapping.solved, mapping.found, mapping.log
    is_lens_known = found.figures["lens"] == "known"
    log.note(*compare_lens(mapping))
    log.note(*describe_zooms(found.zooms))
    log.note(*write_models(found.models, mapping.photographs, folder))
    log.note(*list_notes(mapping, found.agreement, is_lens_known=is_lens_known))
    verdict = judge_solution(solution, mapping.features, found.agreement, found)
    look_alikes = found.look_alikes
    found.figures |= {
        "matches_in_points": found.agreement,
        "models": [int(model.num_registered) for model in found.models],
        "verdict": verdict.as_dict(),
        "made_from": made_from,
        "look_alikes": None if look_alikes is None else look_alikes.to_figures(),
    }
    log.note(*write_dataset(solution, mapping.photographs, folder))
    if found.rig is not None:
        found.figures |= {"rig": found.rig.figures, "covariance_of": COVARIANCE_OF}
        if found.rig.figures.get("found"):
            write_lens_pair(found.rig)
        write_rig(found.rig.rig, folder / RIG)
    log.watch.record_lap("writing")
    seconds, cpu_seconds = (
        {stage: times[clock] for stage, times in log.watch.seconds.items()} for clock in (0, 1)
    )
    cpu_seconds["total"] = sum(cpu_seconds.values())
    found.figures["cpu_seconds"] = cpu_seconds
    values = list_figures(solution, seconds, log.notes, found.figures)
    write_report(folder, solution, values)
    write_file(folder / FIGURES, json.dumps(values, indent=1) + "\n")
    return values
