"""A run: its folder, checkpoints, options, progress, verdict, environment."""

from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.run.environment import describe_environment, measure_peak_rss
from gsut.run.folder import RunFile, RunFolder, read_plan
from gsut.run.memory import (
    PROGRAM_BYTES,
    check_fits,
    format_size,
    free_memory,
    limit_memory,
    release_memory,
)
from gsut.run.options import BlockOptions, SceneOptions, TrainOptions
from gsut.run.progress import SHARES, Progress
from gsut.run.staged_progress import StagedProgress, StageFollower
from gsut.run.stopwatch import Stopwatch
from gsut.run.verdict import Verdict
