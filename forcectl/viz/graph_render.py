"""A block graph in every format. SVG, HTML, DOT and Mermaid need no other program; PNG and PDF need a renderer."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from forcectl.errors import BadInputError, RunFailedError, unknown
from forcectl.viz.graph_dot import to_dot
from forcectl.viz.graph_html import to_html
from forcectl.viz.graph_mermaid import to_mermaid
from forcectl.viz.graph_model import BlockGraph
from forcectl.viz.graph_svg import to_svg

_TEXT: dict[str, Callable[[BlockGraph], str]] = {
    "dot": to_dot,
    "html": to_html,
    "mermaid": to_mermaid,
    "svg": to_svg,
}
FORMATS = ("dot", "html", "mermaid", "pdf", "png", "svg")
_SUFFIXES = {".gv": "dot", ".htm": "html", ".mmd": "mermaid"}
_ZOOM = 2.0  # pixels of a PNG per pixel of the SVG


def render(graph: BlockGraph, format: str, path: str | os.PathLike[str] | None = None) -> str | bytes:
    """The graph in a format; also written to `path` when given.

    Returns:
        Text for dot, html, mermaid and svg; bytes for png and pdf.

    Raises:
        BadInputError: an unknown format, or png and pdf where nothing can render them.
        RunFailedError: when the renderer fails.
    """
    if format not in FORMATS:
        raise unknown("format", format, FORMATS)
    content = _TEXT[format](graph) if format in _TEXT else _picture(graph, format)
    if path is not None:
        data = content.encode() if isinstance(content, str) else content
        Path(path).write_bytes(data)
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


def _picture(graph: BlockGraph, format: str) -> bytes:
    """PNG or PDF by the first renderer there is; those that draw our own SVG come first."""
    if format == "png" and (resvg := _optional("resvg_py")):
        return bytes(resvg.svg_to_bytes(svg_string=to_svg(graph), zoom=_ZOOM))
    if cairo := _optional("cairosvg"):
        convert = cairo.svg2png if format == "png" else cairo.svg2pdf
        return bytes(convert(bytestring=to_svg(graph).encode(), **({"scale": _ZOOM} if format == "png" else {})))
    if program := shutil.which("dot"):
        return _run_dot(program, to_dot(graph), format)
    packages = "resvg-py or cairosvg" if format == "png" else "cairosvg"
    raise BadInputError(
        f"format = {format!r}: needs the package {packages}, or Graphviz' program `dot`; "
        "svg, html, dot and mermaid always work"
    )


def _optional(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except (ImportError, OSError):  # cairosvg raises OSError when the cairo library itself is missing
        return None


def _run_dot(program: str, source: str, format: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"graph.{format}"
        command = [program, f"-T{format}", "-Gdpi=144", "-o", str(target)]
        done = subprocess.run(command, input=source.encode(), capture_output=True, check=False)
        if done.returncode or not target.exists():
            message = done.stderr.decode(errors="replace").strip().partition("\n")[0]
            raise RunFailedError(f"{program} failed: {message}")
        return target.read_bytes()
