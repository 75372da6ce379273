"""Finds the rolling shutters of a video's two lenses, once their images are on a rig."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import SolveError
from gsut.sfm.mapping import Mapping, RigFit
from gsut.sfm.rig.fit import put_on_rig
from gsut.sfm.rig.motion import list_readings
from gsut.sfm.shutter import VideoShutter, correct_readout, estimate_rates, find_line_order
from gsut.sfm.solution import ReadoutMotion, Solution


def find_rig_shutter(mapping: Mapping) -> Mapping:
    """Finds how the lenses of a rig that was found read their lines, from the flow of the video.

    One pose a frame leaves the images less freedom to bend with the motion than poses of their own,
    so that shutters show here which do not show image by image. Does nothing where the shutter is
    said, or was found already.

    Returns:
        The run with the solution and rig that move, and the figures.
    """
    solution, fit = mapping.solved, mapping.found.rig
    flows, options = mapping.photographs.flows, mapping.options
    cameras = mapping.photographs.rig_cameras
    if (
        fit is None
        or cameras is None
        or solution.shutter is not None
        or options.shutter != "auto"
        or not flows
    ):
        return mapping
    velocities = estimate_rates(solution, flows)
    order, signs = find_line_order(mapping, velocities, None)
    if signs is not None:
        mapping = mapping.add_findings({"shutter_signs": signs})
    if order is None:
        return mapping
    readouts = np.ones(len(solution.names)) if order.lines is None else order.lines.readouts

    def place(time: float, sigma: float = 0.0) -> tuple[Solution, RigFit]:
        moving = dataclasses.replace(
            solution, shutter=order.shutter, lines=order.lines,
            velocities=time * readouts[:, None] * velocities[0],
        )  # fmt: skip
        return put_on_rig(mapping.replace(solution=moving), fit.rig, True, rate_sigma=sigma)

    try:
        readout = correct_readout(
            mapping, velocities, order.first, lambda time: place(time)[0], None
        )
        if readout is None:
            return mapping
        moved, found = place(readout.time, ReadoutMotion.sigma)
    except SolveError:
        return mapping
    if moved.num_registered < solution.num_registered:
        return mapping
    readings = list_readings(moved, cameras, readout.time)
    kept = ("file", "found", "scale_from_frames", "scale_spread_percent", "residual_alone_px")
    found = dataclasses.replace(
        found,
        rig=dataclasses.replace(found.rig, readings=readings),
        figures={**found.figures, **{key: fit.figures[key] for key in kept}},
    )
    mapping.log.note(VideoShutter(moved, readout).describe())
    figures = {
        "shutter": order.shutter.direction,
        "readout": {"seconds": readout.time, "sigma_seconds": readout.sigma},
    }
    return mapping.replace(solution=moved).add_findings(figures, rig=found)
