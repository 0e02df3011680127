"""Pages of the documentation, and the code in them."""

import re
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[2]
PAGES = [_ROOT / "README.md", _ROOT / "CONTRIBUTING.md", *sorted((_ROOT / "docs").glob("*.md"))]


def page_text(page: str) -> str:
    """The text of a page, by the name of its file."""
    return next(path for path in PAGES if path.name == page).read_text(encoding="utf-8")


def blocks(text: str, kind: str) -> list[str]:
    """The blocks of a page that are of a kind, such as yaml."""
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def run_python(page: str) -> dict[str, Any]:
    """Run the Python of a page, one block after the other; the names that it leaves."""
    names: dict[str, Any] = {}
    for code in blocks(page_text(page), "python"):
        exec(compile(code, f"docs/{page}", "exec"), names)
    return names
