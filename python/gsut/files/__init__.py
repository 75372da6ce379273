"""The one door for files: every reader and writer, bounded, in one sentence when it fails."""

from gsut.files.archives import open_archive, unpack_gzip, write_archive
from gsut.files.arrays import Array, read_npy, read_npz, write_npy, write_npz
from gsut.files.errors import FileError, WriteError, reading
from gsut.files.kinds import ENDINGS, find_kind, split_numbers
from gsut.files.names import check_name, claim_name, refuse_existing, to_file_name
from gsut.files.opening import (
    check_regular,
    decode_text,
    open_binary,
    open_text,
    read_bytes,
    read_package_file,
    read_text,
)
from gsut.files.pictures import open_image, read_picture, read_picture_bytes, write_picture
from gsut.files.registry import list_readers, register_reader
from gsut.files.shapes import Number, check_shape
from gsut.files.values import (
    format_json,
    parse_json,
    parse_yaml,
    read_json,
    read_rows,
    read_table,
    read_yaml,
    to_plain,
    write_json,
)
from gsut.files.writing import (
    UNFINISHED,
    append_text,
    copy_file,
    create_file,
    remove_unfinished,
    staging_folder,
    whole_file,
    whole_folder,
    write_file,
)
