"""A run: its folder, checkpoints, options and their flags, progress, environment."""

from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.run.environment import describe_environment, peak_rss_mb
from gsut.run.folder import (
    ENVIRONMENT,
    METRICS,
    OPTIONS,
    PAGE,
    REFINED,
    RENDERS,
    REPORT,
    SCENE,
    TRANSFORMS,
    RunFolder,
)
from gsut.run.option_fields import (
    add_option_flags,
    check_options,
    choices_in,
    default_text,
    describe_options,
    flag_name,
    given_options,
    option,
    option_info,
)
from gsut.run.options import AUTO, PRESETS, TrainOptions
from gsut.run.progress import Progress
from gsut.run.stopwatch import Stopwatch
from gsut.run.verdict import Verdict, worst

__all__ = [
    "AUTO",
    "ENVIRONMENT",
    "METRICS",
    "OPTIONS",
    "PAGE",
    "PRESETS",
    "REFINED",
    "RENDERS",
    "REPORT",
    "SCENE",
    "TRANSFORMS",
    "Progress",
    "RunFolder",
    "Stopwatch",
    "TrainOptions",
    "Verdict",
    "add_option_flags",
    "check_options",
    "choices_in",
    "default_text",
    "describe_environment",
    "describe_options",
    "flag_name",
    "given_options",
    "option",
    "option_info",
    "peak_rss_mb",
    "read_checkpoint",
    "worst",
    "write_checkpoint",
]
