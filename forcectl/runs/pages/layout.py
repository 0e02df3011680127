"""The common base of all HTML reports: one file that needs no network, its style, and tables that a click sorts.

A template begins with `{% extends "page.html.j2" %}` and fills the blocks `title`, `style` and `content`.
"""

from __future__ import annotations

from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader


def rendered(package: str, template: str, **content: Any) -> str:
    """Render a page.

    Args:
        package: Python package whose folder `templates` holds the template.
        template: name of its file.
        content: values of the template; texts are escaped.
    """
    loader = ChoiceLoader([PackageLoader(package), PackageLoader("forcectl.runs.pages")])
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template(template).render(**content)
