"""The types of arrays, for annotations; comments at each use give the shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]  # drawn values
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
BoolArray = NDArray[np.bool_]
ColourArray = NDArray[np.uint32]  # 0xRRGGBBAA
Records = NDArray[np.void]  # structured: a row for each contact, plane or body
