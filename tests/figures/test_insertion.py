"""The figure of an insertion, of a machine with many short modes."""

from itertools import combinations

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation

from forcectl.analysis.insertion import InsertionTruth
from forcectl.analysis.transitions import Stay
from forcectl.figures.insertion import insertion_figure


@pytest.mark.parametrize("shortest", [0.005, 0.1, 1.0])
def test_names_of_modes_do_not_overlap_each_other_or_the_title(shortest: float) -> None:
    time = np.linspace(0.0, 20.0, 201)
    begins = np.cumsum([0.0] + [shortest, 5.0 * shortest] * 9)
    stays = [Stay(f"mode_with_a_name_{k}", begin, begin, None, 0) for k, begin in enumerate(begins)]
    truth = InsertionTruth(time, *np.zeros((3, 201)), np.zeros((201, 3)))
    figure = insertion_figure(truth, xr.Dataset(), stays, "A title that goes from the left to the right of the figure")
    FigureCanvasAgg(figure).draw()
    names = [child for child in figure.axes[0].get_children() if isinstance(child, Annotation)]
    assert [name.get_text() for name in names] == [stay.mode for stay in stays]
    boxes = [text.get_window_extent() for text in [*names, figure._suptitle]]
    assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    assert figure.axes[0].get_window_extent().height > 40.0  # [px]: names do not push the curves out
