# SPDX-License-Identifier: Apache-2.0
"""Types of arrays in annotations; shapes and units stand in the docstrings. Loads no numpy."""

from typing import TYPE_CHECKING, ForwardRef, TypeAlias

if TYPE_CHECKING:
    import numpy
    import numpy.typing

    Array: TypeAlias = numpy.typing.NDArray[numpy.float64]
    Index: TypeAlias = numpy.typing.NDArray[numpy.int64]
    Flags: TypeAlias = numpy.typing.NDArray[numpy.bool_]
else:
    Array = ForwardRef('numpy.typing.NDArray[numpy.float64]')
    Index = ForwardRef('numpy.typing.NDArray[numpy.int64]')
    Flags = ForwardRef('numpy.typing.NDArray[numpy.bool_]')
