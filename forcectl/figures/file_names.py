"""Names of variants, and of tests, as parts of file names."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Iterable

_LONGEST, _LONGEST_ALONE = 60, 100  # letters
# Signs that distinguish variants, and their words.
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
        plain = _plain(plain.encode("ascii", "ignore").decode(), "", "-")
        first = plain[:_LONGEST].strip("-._") or "variant"
        part, number = first, 1
        while part.lower() in taken:
            number += 1
            part = f"{first}-{number}"
        taken.add(part.lower())
        found[name] = part
    return found


def file_name(text: str, prefix: str = "") -> str:
    """A text as a part of a file name, independent of others: one that loses signs gets a hash of the text.

    Args:
        text: any.
        prefix: of the name; an empty text has none.
    """
    plain = _plain(text, "=+-", "_")
    if plain != text or len(plain) > _LONGEST_ALONE:
        plain = f"{plain[:_LONGEST_ALONE]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return prefix + plain if plain else ""


def _plain(text: str, kept: str, other: str) -> str:
    """Letters, digits, `.`, `_` and the signs that are kept; others become `other`."""
    return re.sub(f"[^A-Za-z0-9._{kept}]+", other, text)
