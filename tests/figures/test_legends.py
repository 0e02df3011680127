"""Names of variants in the figures of analyses."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from forcectl.analysis.transitions import Stay
from forcectl.figures.force import as_svg
from forcectl.figures.of_variants import alignment_figure, kept_force_figure, surface_alignment_figure
from forcectl.figures.transitions import transition_figure
from forcectl.figures.wrench_errors import error_figure

TIME, STAY = np.linspace(0.0, 1.0, 11), Stay("rest", 0.0, 1.0, None, 0)
OF_VARIANTS: dict[str, Callable[[list[str]], Any]] = {
    "alignment": lambda names: alignment_figure(dict.fromkeys(names, (TIME, TIME, TIME)), 0.2),
    "kept force": lambda names: kept_force_figure(dict.fromkeys(names, (TIME,) * 4), (1.0, 2.0)),
    "surface alignment": lambda names: surface_alignment_figure(dict.fromkeys(names, (TIME,) * 4), (0.2, 0.5)),
    "transitions": lambda names: transition_figure({name: [STAY] for name in names}, ["rest"]),
    "wrench errors": lambda names: error_figure({name: {"z [N]": TIME} for name in names}),
}


@pytest.mark.parametrize("kind", OF_VARIANTS)
def test_names_of_variants_are_no_formulas_and_may_be_missing(kind: str) -> None:
    as_svg(OF_VARIANTS[kind](["costs 5 $_$", "two"]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as one of a legend without entries
        as_svg(OF_VARIANTS[kind]([""]))
