# SPDX-License-Identifier: Apache-2.0
"""Registry of effects: one line each."""

from __future__ import annotations

from otf_core.effects.backlash import Backlash
from otf_core.effects.base import Effect, Shape, State, Terms

REGISTRY: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Backlash(),
    )
}

__all__ = ['REGISTRY', 'Effect', 'Shape', 'State', 'Terms']
