# SPDX-License-Identifier: Apache-2.0
"""Types of arrays in annotations; shapes and units stand in the docstrings. Loads no numpy."""

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Array: TypeAlias = 'NDArray[np.float64]'
Index: TypeAlias = 'NDArray[np.int64]'
