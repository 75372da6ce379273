"""Options: their fields, ranges and reasons, as dataclasses and as command-line flags."""

from gsut.run.options.blocks import MOST_BLOCKS, BlockOptions
from gsut.run.options.fields import (
    check_options,
    define_option,
    describe_options,
    format_flag,
    get_info,
    list_choices,
)
from gsut.run.options.flags import (
    add_option_flags,
    collect_given,
)
from gsut.run.options.presets import (
    fit_to_views,
    get_preset_value,
    is_from_preset,
    raise_degree,
)
from gsut.run.options.primitives import FLAT_PRIMITIVES
from gsut.run.options.recipe import PRESETS, Recipe
from gsut.run.options.scene import SceneOptions
from gsut.run.options.train import AUTO, READOUTS, TrainOptions
