"""Types of arrays of numbers. Shapes are in the docstrings of what uses them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Signal = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
