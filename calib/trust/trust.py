"""Judges how far from the axis a solved lens can be trusted, and whether at all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

import gsut
from calib.boards import Board
from calib.camera import CameraSolution, to_gsut_camera, unproject_pixels
from calib.trust.uncertainty import spread_pixels

TRUSTED_SIGMA_PX = 1.0  # standard deviation of a projected point: at most the size of a pixel
HOPELESS = 3.0  # times a good lens' residuals, above which another does not fit the camera
# Share of the corners that may lie beyond the lens' one-to-one domain before it is refused: the
# rest of the image remains usable, cut inside the domain.
_MOST_BEYOND = 0.05
_MARGIN = np.radians(0.5)  # distance from a fold or pole, where the inverse loses its digits
_RING = np.radians(2.0)  # width of the rings in which the uncertainty is judged
_SECTORS = 12  # of azimuth, each of which a splined lens needs boards in
_STEPS = 150  # along each azimuth of the trusted region's outline: a few pixels each


@dataclass
class Trust:
    """The field in which a lens can be trusted.

    Args:
        valid_angle: radians from the axis up to which it may be used.
        reach: radians to the outermost inlier corner.
        domain: radians to the lens' first fold or pole (smallest over azimuths); pi: none.
        sigma: (rows, columns) pixels, from `map_uncertainty`.
        without_ray: share of the image's pixels beyond the lens' domain.
        refusal: why the lens must not be used; empty if it may.
        notes: sentences on what limits it.
    """

    valid_angle: float
    reach: float
    domain: float
    sigma: np.ndarray
    without_ray: float
    refusal: str = ""
    notes: list[str] = field(default_factory=list)


def judge(camera: CameraSolution, board: Board, sigma: np.ndarray) -> Trust:
    """Judges a solved lens by its domain, its boards and its uncertainty.

    The valid field angle is the smallest of: the angle that the boards reached (for a splined lens,
    in which one direction teaches nothing about another, where they reached least); the first fold
    or pole, less a margin; the first ring whose median uncertainty is above TRUSTED_SIGMA_PX.
    """
    angles = camera.measure_field_angles(board)
    reach = float(np.max(angles[~camera.outliers]))
    pixels = spread_pixels(camera.width, camera.height)
    try:
        domain = float(to_gsut_camera(camera).max_angle)
        angle_map = measure_field_angle(unproject_pixels(camera, pixels.reshape(-1, 2))).reshape(
            pixels.shape[:2]
        )
    except gsut.InputError as error:
        return Trust(0.0, reach, 0.0, sigma, 1.0, refusal=f"the fit is no lens: {error}")
    trust = Trust(reach, reach, domain, sigma, float(np.mean(~np.isfinite(angle_map))))
    degrees = np.degrees
    beyond = float(np.mean(angles[~camera.outliers] >= domain))
    if beyond > _MOST_BEYOND:
        trust.valid_angle = domain - _MARGIN
        trust.refusal = (
            f"the {camera.lens} fit of {camera.name} has a pole or fold at "
            f"{degrees(domain):.1f} degrees, inside the image: {100 * beyond:.0f} % of the boards' "
            f"corners, up to {degrees(reach):.1f} degrees, lie beyond it, where one pixel has two "
            "rays, although the residuals look good; use --lens fisheye, splined or auto"
        )
        return trust
    if trust.without_ray > 0:
        trust.notes.append(
            f"{camera.name}: the {camera.lens} lens folds or has a pole at "
            f"{degrees(domain):.1f} degrees, inside the image: {100 * trust.without_ray:.0f} % of "
            "the image has no ray and is masked"
        )
    if domain - _MARGIN < trust.valid_angle:
        trust.valid_angle = domain - _MARGIN
        trust.notes.append(
            f"{camera.name}: boards reached {degrees(reach):.1f} degrees, but the lens is cut at "
            f"{degrees(trust.valid_angle):.1f} because of it; a fisheye or splined lens may keep "
            "more"
        )
    if camera.lens == "splined":
        covered = _find_covered_angle(camera, angles)
        if covered < trust.valid_angle:
            trust.valid_angle = covered
            trust.notes.append(
                f"{camera.name}: boards reached {degrees(reach):.1f} degrees, but not in every "
                f"direction: beyond {degrees(covered):.1f} degrees there is one without any, where "
                "a splined lens knows nothing; show the board all around, or use --lens auto"
            )
    certain = _find_certain_angle(angle_map, sigma, trust.valid_angle)
    if certain < trust.valid_angle:
        trust.valid_angle = certain
        trust.notes.append(
            f"{camera.name}: beyond {degrees(certain):.1f} degrees the lens is uncertain by more "
            f"than {TRUSTED_SIGMA_PX:g} px; show the board there to trust it further"
        )
    if trust.valid_angle <= 0:
        trust.refusal = (
            f"the {camera.lens} lens of {camera.name} is uncertain by more than "
            f"{TRUSTED_SIGMA_PX:g} px even at its axis: take more photographs, with the board "
            "tilted and near every edge, or use a lens with fewer parameters"
        )
    return trust


def measure_field_angle(directions: np.ndarray) -> np.ndarray:
    """Measures the radians between the axis and directions (..., 3)."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.arctan2(np.hypot(x, y), z)


def _find_covered_angle(camera: CameraSolution, angles: np.ndarray) -> float:
    """Finds the radians that boards reached in the sector of azimuth where they reached least."""
    good = ~camera.outliers
    offset = camera.corners[good] - camera.params[2:4]
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1.0
    sector = np.minimum((turn * _SECTORS).astype(int), _SECTORS - 1)
    reach = np.zeros(_SECTORS)
    np.maximum.at(reach, sector, angles[good])
    return float(reach.min())


def _find_certain_angle(angle_map: np.ndarray, sigma: np.ndarray, limit: float) -> float:
    """Finds the radians to the first ring whose median sigma is too large."""
    if not np.isfinite(sigma).any():
        return limit
    for inner in np.arange(0.0, limit, _RING):
        ring = (angle_map >= inner) & (angle_map < inner + _RING) & np.isfinite(sigma)
        if ring.any() and np.median(sigma[ring]) > TRUSTED_SIGMA_PX:
            return float(inner)
    return limit


def trace_trusted_outline(
    camera: CameraSolution, valid_angle: float, azimuths: int = 90
) -> np.ndarray:
    """Traces the closed polygon (azimuths + 1, 2) of pixels within `valid_angle` of the axis.

    Walks outwards from the centre of projection to the last pixel inside both image and angle.
    """
    centre = np.clip(camera.params[2:4], 0, [camera.width - 1, camera.height - 1])
    directions = np.linspace(0, 2 * np.pi, azimuths, endpoint=False)
    unit = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    longest = np.hypot(camera.width, camera.height)
    distance = np.linspace(0, longest, _STEPS)
    pixels = centre + unit[:, None] * distance[None, :, None]
    angle = measure_field_angle(unproject_pixels(camera, pixels.reshape(-1, 2))).reshape(
        azimuths, _STEPS
    )
    inside = np.all((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1]), axis=2)
    good = inside & (angle <= valid_angle)
    good[:, 0] = True
    last = np.argmin(np.concatenate([good, np.zeros((azimuths, 1), bool)], axis=1), axis=1) - 1
    outline = pixels[np.arange(azimuths), last]
    return np.concatenate([outline, outline[:1]])
