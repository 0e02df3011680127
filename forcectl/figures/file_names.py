"""Names of variants as parts of file names."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

_LONGEST = 60  # letters
# Signs that tell variants apart.
_WORDS = ((r"(?<!\w)-(?=[\d.])", " minus "), (r"\+", " plus "), ("%", " pct "), ("[<>]=?", " "), ("=", " "))


def file_names(names: Iterable[str]) -> dict[str, str]:
    """For each name a part of a file name: letters, digits, `.`, `-` and `_`, no two alike in any case.

    Args:
        names: different from each other.
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        plain = unicodedata.normalize("NFKD", name)
        for sign, word in _WORDS:
            plain = re.sub(sign, word, plain)
        plain = re.sub(r"[^A-Za-z0-9._]+", "-", plain.encode("ascii", "ignore").decode())
        first = plain[:_LONGEST].strip("-._") or "variant"
        part, number = first, 1
        while part.lower() in taken:
            number += 1
            part = f"{first}-{number}"
        taken.add(part.lower())
        found[name] = part
    return found
