"""Refines poses and lens against the Gaussians, and finds the pose of one photograph."""

from gsut.refine.alignment import evaluate_aligned
from gsut.refine.localization import Localized, localize_image
from gsut.refine.photograph import localize
from gsut.refine.pose import RefinedPose, refine_pose
from gsut.refine.pose_files import read_refined, write_refined
from gsut.refine.refiner import TrainingRefiner, check_refinable
from gsut.refine.tracks import TracksResult, refine_by_tracks
