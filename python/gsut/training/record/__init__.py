"""What a training writes, and how a finished run is read again."""

from gsut.training.record.results import (
    describe_place,
    list_scene_comments,
    measure,
    measure_training,
    write_findings,
    write_results,
)
from gsut.training.record.trained_run import (
    TrainedRun,
    find_run_movers,
    list_changed_data,
    load_run,
    open_trained,
    read_light,
    read_scene,
    read_trained,
)
from gsut.training.record.training_record import TrainingRecord
