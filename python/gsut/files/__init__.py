"""The one door for files: every reader and writer, bounded, in one sentence when it fails."""

from gsut.files.archives import open_archive, unpack_gzip, write_archive
from gsut.files.arrays import Array, read_npy, read_npz, write_npy, write_npz
from gsut.files.errors import FileError, OpenError, WriteError, reading
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

__all__ = [
    "ENDINGS",
    "UNFINISHED",
    "Array",
    "FileError",
    "Number",
    "OpenError",
    "WriteError",
    "append_text",
    "check_name",
    "check_regular",
    "check_shape",
    "claim_name",
    "copy_file",
    "create_file",
    "decode_text",
    "find_kind",
    "format_json",
    "list_readers",
    "open_archive",
    "open_binary",
    "open_image",
    "open_text",
    "parse_json",
    "parse_yaml",
    "read_bytes",
    "read_json",
    "read_npy",
    "read_npz",
    "read_package_file",
    "read_picture",
    "read_picture_bytes",
    "read_rows",
    "read_text",
    "read_yaml",
    "reading",
    "refuse_existing",
    "register_reader",
    "remove_unfinished",
    "split_numbers",
    "staging_folder",
    "to_file_name",
    "to_plain",
    "unpack_gzip",
    "whole_file",
    "whole_folder",
    "write_archive",
    "write_file",
    "write_json",
    "write_npy",
    "write_npz",
    "write_picture",
]
