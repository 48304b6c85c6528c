# SPDX-License-Identifier: Apache-2.0
"""Forms of nature as effects that a trial can hide, scale and draw; none is registered."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.departed_forms import DEPARTED_FORMS, FOLLOWING_FORMS
from otf_core.blind.depends import Depends, on
from otf_core.blind.nameless_forms import NAMELESS_FORMS, Nameless
from otf_core.blind.unknown_effects import WRITTEN_OUT, UnknownEffect
from otf_core.blind.view import SENSOR, View, view_of
from otf_core.effects import Shape, State, Terms
from otf_core.effects.drawing import Drawn, Number, Trial, Uniform

_SIZE = 1e-6
_ANY = Depends()
_SEEDS = Uniform(1.0, 1e9)


class Nature(UnknownEffect):
    """A form as an effect with one coefficient A; ``draw`` is the seed of what the form draws.

    Parameters
    ----------
    form : callable(View)
        Displacement (n, 3), m, or that and what it depends on.
    depends : Depends
        Where the form does not say it.
    """

    cause: ClassVar[str] = 'nature'
    equation: ClassVar[str] = 'see its form'
    shape_names: ClassVar[tuple[str, ...]] = ('draw',)
    shape_units: ClassVar[tuple[str, ...]] = ('',)
    vector: ClassVar[tuple[str, ...]] = ('A',)
    trial: ClassVar[Trial] = Trial((Number('draw', _SEEDS),))

    def __init__(
        self,
        form: Callable[[View], Array | Nameless],
        stands_for: frozenset[str] = frozenset(),
        depends: Depends = _ANY,
    ) -> None:
        self.form = form
        prefix = 'departed' if stands_for else 'unknown'
        name = f'{prefix}_{form.__name__}'
        vars(self).update(name=name, stands_for=stands_for, depends=depends)

    @property
    def drawn(self) -> tuple[Drawn, ...]:
        """How a trial draws all its parameters."""
        return (*self.trial.drawn, Number('A', _SIZE))

    def _made(self, state: State, shape: Shape) -> Nameless:
        made = self.form(view_of(state, shape['draw']))
        return made if isinstance(made, tuple) else (made, self.depends)

    def factor(self, state: State, shape: Shape) -> Array:
        """Displacement per unit of A."""
        return self._made(state, shape)[0]

    def depends_on(self, state: State, parameters: Shape) -> Depends:
        """As the form says."""
        return self._made(state, parameters)[1]

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return A."""
        return Terms(('A',), ('m',), ('',), np.asarray(self.factor(state, shape))[:, :, None])


DEPARTED: dict[str, UnknownEffect] = {
    n.name: n for n in (Nature(form, names) for form, names in DEPARTED_FORMS.items())
}
"""Known causes in other forms."""
FOLLOWING: dict[str, UnknownEffect] = {
    n.name: n for n in (Nature(form, names, on(SENSOR)) for form, names in FOLLOWING_FORMS.items())
}
"""Known causes that follow a signal recorded beside the samples."""
UNKNOWN_EFFECTS: dict[str, UnknownEffect] = {
    effect.name: effect for effect in (*WRITTEN_OUT, *(Nature(form) for form in NAMELESS_FORMS))
}
"""Effects whose right answer is 'unknown'."""
OUTSIDE = {**DEPARTED, **FOLLOWING, **UNKNOWN_EFFECTS}
"""All that the catalogue lacks."""
