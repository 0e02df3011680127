"""Text of files that a user names, read up to a maximum length."""

from __future__ import annotations

import errno
from pathlib import Path

MOST_CHARACTERS = 500_000  # largest length of a YAML file
_LARGEST_TABLE = 1_000_000_000  # [bytes]


def yaml_text(path: Path) -> str:
    """The text of a YAML file, cut off after one character more than allowed.

    Raises:
        OSError: it cannot be read, or is no regular file: reading a pipe may block, and a device may never end.
        UnicodeDecodeError: it is not UTF-8.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "is no file", str(path))
    with path.open(encoding="utf-8") as file:
        return file.read(MOST_CHARACTERS + 1)


def table_text(path: Path) -> str:
    """The text of a CSV file.

    Raises:
        OSError: it cannot be read, or has more than 1 GB.
        UnicodeDecodeError: it is not UTF-8.
    """
    if path.stat().st_size > _LARGEST_TABLE:
        raise OSError(errno.EFBIG, "it has more than 1 GB", str(path))
    return path.read_text(encoding="utf-8-sig")  # spreadsheets put a byte order mark in front
