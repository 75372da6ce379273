"""Further training of a finished run: fine-tuning, compaction, and tuning for other viewers."""

from gsut.training.tuning.compact_run import (
    CompactOptions,
    RunCompactor,
    write_compacted_run,
)
from gsut.training.tuning.finetuning import finetune
from gsut.training.tuning.for_viewers import VIEWER_STEPS, tune_for_viewers
from gsut.training.tuning.levels import make_levels
