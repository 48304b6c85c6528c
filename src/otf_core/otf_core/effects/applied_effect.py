# SPDX-License-Identifier: Apache-2.0
"""Effects with their parameters: what a simulation adds, what a diagnosis found."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.effects.base import Effect, Shape


@dataclass(frozen=True)
class AppliedEffect:
    """An effect of a certain size.

    Attributes
    ----------
    parameters : mapping of str to float
        Coefficients and shape by name, in the units of the effect; what is missing is zero or
        the default.
    """

    effect: Effect
    parameters: Shape
