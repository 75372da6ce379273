"""Trains a scene: what comes before the first step, the steps, and what a run writes."""

from gsut.training.first import (
    center_on_cameras,
    choose_complexity,
    choose_degree,
    describe_resizing,
    find_plain_background,
    leave_out_blurred,
    limit_gaussians,
    prepare_scene,
    refine_first_poses,
    seed_first,
)
from gsut.training.loop import TrainingLoop
from gsut.training.photometric_poses import grow_poses
from gsut.training.record import (
    TrainedRun,
    TrainingRecord,
    describe_place,
    list_changed_data,
    list_scene_comments,
    load_run,
    measure,
    measure_training,
    open_trained,
    read_light,
    read_scene,
    read_trained,
    write_findings,
    write_results,
)
from gsut.training.time_left import track_training
from gsut.training.tuning import (
    CompactOptions,
    RunCompactor,
    tune_for_viewers,
    write_compacted_run,
)

__all__ = [
    "CompactOptions",
    "RunCompactor",
    "TrainedRun",
    "TrainingLoop",
    "TrainingRecord",
    "center_on_cameras",
    "choose_complexity",
    "choose_degree",
    "describe_place",
    "describe_resizing",
    "find_plain_background",
    "grow_poses",
    "leave_out_blurred",
    "limit_gaussians",
    "list_changed_data",
    "list_scene_comments",
    "load_run",
    "measure",
    "measure_training",
    "open_trained",
    "prepare_scene",
    "read_light",
    "read_scene",
    "read_trained",
    "refine_first_poses",
    "seed_first",
    "track_training",
    "tune_for_viewers",
    "write_compacted_run",
    "write_findings",
    "write_results",
]
