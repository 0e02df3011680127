"""docs/references.md explains every starred equation and every numbered paper."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "references.md").read_text(encoding="utf-8")
ROOMS = ("forcectl", "diagrams", "models", "experiments", "docs", "benchmarks")


def found(pattern: str) -> set[str]:
    """What the pattern matches in the sources and the other pages."""
    texts = (p for room in ROOMS for p in (ROOT / room).rglob("*") if p.suffix in {".py", ".md", ".yaml"})
    return {
        match for path in texts if path.name != "references.md"
        for match in re.findall(pattern, path.read_text(encoding="utf-8"))
    }  # fmt: skip


def listed(equation: str) -> bool:
    """Whether a first column names the equation or a range that holds it, such as (4.24) to (4.27)."""
    chapter, number = re.fullmatch(r"\((\d)\.(\d+)[a-z]?\)", equation).groups()
    first = [line.split("|")[1] for line in PAGE.splitlines() if line.startswith("|")]
    for column in first:
        if equation in column or f"({chapter}.{number})" in column:
            return True
        for low, high in re.findall(rf"\({chapter}\.(\d+)\) to \({chapter}\.(\d+)\)", column):
            if int(low) <= int(number) <= int(high):
                return True
    return False


def test_every_starred_equation_is_listed():
    starred = found(r"(\(\d\.\d+[a-z]?\))\\?\*(?![\w(\d])")
    assert len(starred) > 10
    assert [equation for equation in sorted(starred) if not listed(equation)] == []


def test_every_numbered_paper_is_listed():
    numbered = found(r"\[([1-9]\d{1,2})\](?!\()")
    assert {"56", "57"} <= numbered
    assert [number for number in sorted(numbered) if f"| [{number}] |" not in PAGE] == []
