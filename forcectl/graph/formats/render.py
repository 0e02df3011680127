"""A block graph in every format; none needs another program."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from forcectl.errors import unknown
from forcectl.graph.formats.html import to_html
from forcectl.graph.formats.mermaid import to_mermaid
from forcectl.graph.formats.svg import to_svg
from forcectl.graph.model import BlockGraph

FORMATS = ("dot", "html", "mermaid", "pdf", "png", "svg")
_SUFFIXES = {".gv": "dot", ".htm": "html", ".mmd": "mermaid"}


def render(graph: BlockGraph, format: str, path: str | os.PathLike[str] | None = None) -> str | bytes:
    """The graph in a format; also written to `path` when given.

    Returns:
        Text for dot, html, mermaid and svg; bytes for png and pdf.

    Raises:
        BadInputError: an unknown format.
    """
    if format not in FORMATS:
        raise unknown("format", format, FORMATS)
    content = _writer(format)(graph)
    if path is not None:
        Path(path).write_bytes(content.encode() if isinstance(content, str) else content)
    return content


def format_of(path: str | os.PathLike[str]) -> str:
    """The format that a file name asks for.

    Raises:
        BadInputError: when its ending is none of a known format.
    """
    suffix = Path(path).suffix.lower()
    name = _SUFFIXES.get(suffix, suffix[1:])
    if name not in FORMATS:
        raise unknown("format", name, FORMATS)
    return name


def _writer(format: str) -> Callable[[BlockGraph], str | bytes]:
    if format in ("pdf", "png"):
        # Matplotlib takes half a second to import, which the other formats need not wait for.
        from forcectl.graph.formats.print import to_pdf, to_png

        return to_pdf if format == "pdf" else to_png
    if format == "dot":
        from forcectl.graph.formats.dot import to_dot  # pydot is for those who ask for DOT

        return to_dot
    return {"html": to_html, "mermaid": to_mermaid, "svg": to_svg}[format]
