"""The training loop: growth, densification, fine-tuning, and what a run writes."""

from gsut.training.compact_run import (
    CompactOptions,
    RunCompactor,
    count_for_bytes,
    write_compacted_run,
)
from gsut.training.complexity import Complexity, choose_complexity, choose_degree, with_most
from gsut.training.finetuning import finetune, finetune_options
from gsut.training.for_viewers import VIEWER_STEPS, ForViewers, tune_for_viewers
from gsut.training.from_start import FROM_START
from gsut.training.loop import TrainingLoop
from gsut.training.photometric_poses import grow_poses
from gsut.training.record import TrainingRecord
from gsut.training.results import (
    measure,
    measure_training,
    notes_on_place,
    scene_comments,
    write_findings,
    write_results,
)
from gsut.training.start import (
    about_cameras,
    plain_background,
    prepare_scene,
    refine_first_poses,
    seed_first,
    size_note,
    without_blurred,
)
from gsut.training.time_left import track_training
from gsut.training.trained_run import (
    TrainedRun,
    load_run,
    open_trained,
    read_light,
    read_scene,
    read_trained,
)

__all__ = [
    "FROM_START",
    "VIEWER_STEPS",
    "CompactOptions",
    "Complexity",
    "ForViewers",
    "RunCompactor",
    "TrainedRun",
    "TrainingLoop",
    "TrainingRecord",
    "about_cameras",
    "choose_complexity",
    "choose_degree",
    "count_for_bytes",
    "finetune",
    "finetune_options",
    "grow_poses",
    "load_run",
    "measure",
    "measure_training",
    "notes_on_place",
    "open_trained",
    "plain_background",
    "prepare_scene",
    "read_light",
    "read_scene",
    "read_trained",
    "refine_first_poses",
    "scene_comments",
    "seed_first",
    "size_note",
    "track_training",
    "tune_for_viewers",
    "with_most",
    "without_blurred",
    "write_compacted_run",
    "write_findings",
    "write_results",
]
