"""Layouts of datasets: each module lists its `LAYOUTS`; those with a "_" have none."""

from gsut.data.layouts._layout import (
    Layout,
    find_foreign_files,
    find_layout,
    list_layouts,
    require_pictures,
)
from gsut.data.layouts.description import describe_recording, replace_parts
from gsut.data.layouts.folder import (
    DEPTH_FOLDERS,
    find_image_folder,
    find_images,
    find_lens_file,
    find_lens_files,
)
