"""A run: its folder, checkpoints, options and their flags, progress, environment."""

from gsut.run.block_options import MOST_BLOCKS, BlockOptions
from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.run.environment import describe_environment, peak_rss_mb
from gsut.run.fitted import for_degree, for_views, is_open, of_preset
from gsut.run.folder import (
    BLOCKS,
    ENVIRONMENT,
    HISTORY,
    METRICS,
    OPTIONS,
    PAGE,
    PLAN,
    REFINED,
    RENDERS,
    REPORT,
    SCENE,
    TRANSFORMS,
    RunFolder,
    read_plan,
)
from gsut.run.memory import check_fits, free_memory, release_memory, size_text
from gsut.run.option_fields import (
    MOST_WHOLE,
    add_option_flags,
    check_options,
    choices_in,
    default_text,
    describe_options,
    flag_name,
    given_options,
    option,
    option_info,
    parse_size,
    show_every_option,
)
from gsut.run.options import AUTO, COMMON_OPTIONS, PRESETS, TrainOptions
from gsut.run.progress import Progress
from gsut.run.recipe import recipe
from gsut.run.scene_options import SceneOptions
from gsut.run.staged_progress import StagedProgress, StageFollower, count_down
from gsut.run.stopwatch import Stopwatch
from gsut.run.verdict import Verdict, combine_verdicts, judge_pictures

__all__ = [
    "AUTO",
    "BLOCKS",
    "COMMON_OPTIONS",
    "ENVIRONMENT",
    "HISTORY",
    "METRICS",
    "MOST_BLOCKS",
    "MOST_WHOLE",
    "OPTIONS",
    "PAGE",
    "PLAN",
    "PRESETS",
    "REFINED",
    "RENDERS",
    "REPORT",
    "SCENE",
    "TRANSFORMS",
    "BlockOptions",
    "Progress",
    "RunFolder",
    "SceneOptions",
    "StageFollower",
    "StagedProgress",
    "Stopwatch",
    "TrainOptions",
    "Verdict",
    "add_option_flags",
    "check_fits",
    "check_options",
    "choices_in",
    "combine_verdicts",
    "count_down",
    "default_text",
    "describe_environment",
    "describe_options",
    "flag_name",
    "for_degree",
    "for_views",
    "free_memory",
    "given_options",
    "is_open",
    "judge_pictures",
    "of_preset",
    "option",
    "option_info",
    "parse_size",
    "peak_rss_mb",
    "read_checkpoint",
    "read_plan",
    "recipe",
    "release_memory",
    "show_every_option",
    "size_text",
    "write_checkpoint",
]
