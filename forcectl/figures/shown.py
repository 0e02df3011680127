"""A figure that a notebook shows by itself."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure that a notebook shows, whether `matplotlib.pyplot` has drawn in it before or not.

    A notebook can show Matplotlib's own figures from the first use of a function of pyplot on.
    """

    def _repr_png_(self) -> bytes:
        page = io.BytesIO()
        self.savefig(page, format="png", bbox_inches="tight")
        return page.getvalue()
