"""The array type of the package."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""A float64 array of any shape; docstrings state the shape in parentheses, such as (4, 4)."""
