# SPDX-License-Identifier: Apache-2.0
"""Effects that the catalogue does not hold, to be hidden, scaled and drawn; none is registered.

Those written out here are causes outside the catalogue, to which the right answer is 'unknown'.
Some have the very shape of a decoy, which the diagnosis tries so as not to force a gap into the
catalogue: these are easier. ``Nature`` makes an effect of any form in ``forms``. All depend on
what happened before, so they are evaluated on all samples of a run at once.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from otf_core.arrays import Array
from otf_core.blind.depends import PLACES, SENSES, SPEED, EffectInputs, depends_on
from otf_core.blind.forms import (
    DEPARTED_FORMS,
    FOLLOWING_FORMS,
    NAMELESS_FORMS,
    SENSOR,
    Nameless,
    View,
    view_of,
)
from otf_core.effects import Effect, Shape, State, Terms
from otf_core.effects.drawing import Axes, Drawn, Number, Trial, Uniform
from otf_core.model.frames import XYZ

_MOMENT = Number('t0', Uniform(0.15, 0.85), of_duration=True)


class UnknownEffect(Effect):
    """An effect outside the registry; its size is the coefficient vector (A_X, A_Y, A_Z)."""

    signature: ClassVar[str] = ''
    typical: ClassVar[str] = '1 um to 10 um'
    source: ClassVar[str] = 'made for the blind trial'
    needs: ClassVar[str] = ''
    vector: ClassVar[tuple[str, ...]] = ('A_X', 'A_Y', 'A_Z')
    size: ClassVar[float] = 1e-6
    """Of the vector that is drawn, before the trial scales it."""
    trial: ClassVar[Trial] = Trial(())
    """How its shape is drawn."""
    has_decoy: ClassVar[bool] = False
    """True if a decoy of the diagnosis has the same formula."""
    stands_for: ClassVar[frozenset[str]] = frozenset()
    """Causes of the catalogue whose name is right for it; none for an unknown one."""
    depends: ClassVar[EffectInputs] = EffectInputs()
    """What it depends on; no groups where no smooth function of inputs comes near."""

    @property
    def drawn(self) -> tuple[Drawn, ...]:
        """How a trial draws all its parameters."""
        return (*self.trial.drawn, Axes('A', self.size))

    def depends_on(self, state: State, parameters: Shape) -> EffectInputs:
        """What it depends on as drawn."""
        return self.depends

    @abstractmethod
    def factor(self, state: State, shape: Shape) -> Array:
        """Displacement per unit of A, shape (n,), or (n, 3) axis by axis."""

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return A_X, A_Y, A_Z."""
        factor = self.factor(state, shape)
        factor = factor[:, None] if factor.ndim == 1 else factor
        columns = factor[:, :, None] * np.eye(3)
        return Terms(self.vector, ('m',) * 3, XYZ, columns)

    def displacement(self, state: State, parameters: Shape) -> Array:
        """Displacement of all samples at once, shape (n, 3), m."""
        return self.block_displacement(state, self.complete_shape(parameters), parameters)


class MachineStep(UnknownEffect):
    """The target jumps against the table: a bolt gives way, somebody touches the target."""

    name: ClassVar[str] = 'unknown_machine_step'
    has_decoy: ClassVar[bool] = True
    cause: ClassVar[str] = 'something moves by a jolt'
    depends: ClassVar[EffectInputs] = depends_on('time')
    equation: ClassVar[str] = 'A [t > t0]'
    shape_names: ClassVar[tuple[str, ...]] = ('t0',)
    shape_units: ClassVar[tuple[str, ...]] = ('s',)
    trial: ClassVar[Trial] = Trial((_MOMENT,))

    def factor(self, state: State, shape: Shape) -> Array:
        """One after t0."""
        return (state.time > shape['t0']).astype(float)


class TrackerStep(UnknownEffect):
    """The tracker turns by a jolt; A is the shift of a point 1 m away."""

    name: ClassVar[str] = 'unknown_tracker_step'
    has_decoy: ClassVar[bool] = True
    cause: ClassVar[str] = 'somebody knocks against the tracker'
    depends: ClassVar[EffectInputs] = depends_on('time')
    equation: ClassVar[str] = '(A / 1 m) x r [t > t0]'
    shape_names: ClassVar[tuple[str, ...]] = ('t0',)
    shape_units: ClassVar[tuple[str, ...]] = ('s',)
    size: ClassVar[float] = 2e-6
    trial: ClassVar[Trial] = Trial((_MOMENT,))

    def factor(self, state: State, shape: Shape) -> Array:
        """Not used: the terms are turns."""
        return (state.time > shape['t0']).astype(float)

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return A_X, A_Y, A_Z: turns about the axes, rad."""
        after = self.factor(state, shape)[:, None]
        columns = np.stack([after * np.cross(e, state.beam) for e in np.eye(3)], axis=2)
        return Terms(self.vector, ('rad',) * 3, XYZ, columns)


class SlowSwing(UnknownEffect):
    """The structure swings slowly: an air conditioner or a chiller that switches."""

    name: ClassVar[str] = 'unknown_slow_swing'
    has_decoy: ClassVar[bool] = True
    cause: ClassVar[str] = 'air conditioning, chiller'
    depends: ClassVar[EffectInputs] = depends_on('time')
    equation: ClassVar[str] = 'A sin(2 pi (t - t0) / period)'
    shape_names: ClassVar[tuple[str, ...]] = ('period', 't0')
    shape_units: ClassVar[tuple[str, ...]] = ('s', 's')
    trial: ClassVar[Trial] = Trial(
        (Number('period', Uniform(30.0, 120.0)), Number('t0', Uniform(1.0, 60.0)))
    )

    def factor(self, state: State, shape: Shape) -> Array:
        """Sine of time."""
        return np.asarray(np.sin(2.0 * np.pi * (state.time - shape['t0']) / shape['period']))


class LocalBump(UnknownEffect):
    """A place in the volume where the machine is off: a dent in a guideway, a loose cover."""

    name: ClassVar[str] = 'unknown_local_bump'
    cause: ClassVar[str] = 'a dent, a chip under the cover'
    depends: ClassVar[EffectInputs] = depends_on(*PLACES)
    equation: ClassVar[str] = 'A exp(-|q - q0|^2 / (2 w^2))'
    shape_names: ClassVar[tuple[str, ...]] = ('x', 'y', 'z', 'width')
    shape_units: ClassVar[tuple[str, ...]] = ('', '', '', 'm')
    trial: ClassVar[Trial] = Trial(
        (*(Number(k, Uniform(0.2, 0.8)) for k in 'xyz'), Number('width', Uniform(0.04, 0.12)))
    )

    def factor(self, state: State, shape: Shape) -> Array:
        """Bell curve about a place given in shares of the ranges."""
        low, high = state.machine.lower, state.machine.upper
        centre = low + np.array([shape[k] for k in 'xyz']) * (high - low)
        distance = np.linalg.norm(state.q - centre, axis=1)
        return np.asarray(np.exp(-0.5 * (distance / shape['width']) ** 2))


class StickSlip(UnknownEffect):
    """Sawtooth over the travel of each axis: it sticks, then slips."""

    name: ClassVar[str] = 'unknown_stick_slip'
    cause: ClassVar[str] = 'friction in the guideways'
    equation: ClassVar[str] = 'A_a (2 frac(s_a / p) - 1) e_a, s_a travel so far'
    shape_names: ClassVar[tuple[str, ...]] = ('period',)
    shape_units: ClassVar[tuple[str, ...]] = ('m',)
    trial: ClassVar[Trial] = Trial((Number('period', Uniform(0.03, 0.12)),))

    def factor(self, state: State, shape: Shape) -> Array:
        """Sawtooth, axis by axis."""
        step = np.abs(np.diff(state.q, axis=0, prepend=state.q[:1]))
        return np.asarray(2.0 * np.mod(np.cumsum(step, axis=0) / shape['period'], 1.0) - 1.0)


class FeedOffset(UnknownEffect):
    """Offset that grows with the square of the feed: coolant or air drag, oil film."""

    name: ClassVar[str] = 'unknown_feed_offset'
    cause: ClassVar[str] = 'slides float up on their oil film'
    depends: ClassVar[EffectInputs] = depends_on(SPEED)
    equation: ClassVar[str] = 'A (v / 0.2 m/s)^2'

    def factor(self, state: State, shape: Shape) -> Array:
        """Square of the feed."""
        return np.asarray((state.speed / 0.2) ** 2)


class InertiaNod(UnknownEffect):
    """The head nods with acceleration: forwards when braking, backwards when speeding up."""

    name: ClassVar[str] = 'unknown_inertia_nod'
    cause: ClassVar[str] = 'a soft head or column'
    depends: ClassVar[EffectInputs] = depends_on('acceleration', besides=['since_stop'])
    equation: ClassVar[str] = 'A times the sign of the acceleration along the path'

    def factor(self, state: State, shape: Shape) -> Array:
        """Sign of the change of speed."""
        change = np.gradient(state.speed, state.time)
        return np.where(np.abs(change) > 0.1, np.sign(change), 0.0)


class DirectionPair(UnknownEffect):
    """Shift that depends on whether two axes travel in the same or in opposite sense."""

    name: ClassVar[str] = 'unknown_direction_pair'
    cause: ClassVar[str] = 'the frame racks when two drives push against each other'
    depends: ClassVar[EffectInputs] = depends_on('sense_x', 'sense_y')
    equation: ClassVar[str] = 'A sign(d_X) sign(d_Y) where both move'

    def factor(self, state: State, shape: Shape) -> Array:
        """Product of the senses of travel of X and Y."""
        moves = np.abs(state.direction) > 1e-6
        sign = np.where(moves, np.sign(state.direction), 0.0)
        return np.asarray(sign[:, 0] * sign[:, 1])


class BallPassage(UnknownEffect):
    """A slide lifts by a little whenever a ball of its guide enters the load zone."""

    name: ClassVar[str] = 'unknown_ball_passage'
    cause: ClassVar[str] = 'recirculating balls of a linear guide'
    equation: ClassVar[str] = 'A_a |sin(pi q_a / p)| e_b, b the axis after a'
    shape_names: ClassVar[tuple[str, ...]] = ('p',)
    shape_units: ClassVar[tuple[str, ...]] = ('m',)
    trial: ClassVar[Trial] = Trial((Number('p', Uniform(0.004, 0.02)),))

    def depends_on(self, state: State, parameters: Shape) -> EffectInputs:
        """Position of every axis whose slide lifts."""
        return depends_on(
            *(p for p, n in zip(PLACES, self.vector, strict=True) if parameters.get(n))
        )

    def factor(self, state: State, shape: Shape) -> Array:
        """Lift of every slide."""
        return np.asarray(np.abs(np.sin(np.pi * state.q / shape['p'])))

    def terms(self, state: State, shape: Shape) -> Terms:
        """Return A_X, A_Y, A_Z: lifts of the slides of X, Y, Z along Y, Z, X."""
        columns = self.factor(state, shape)[:, None, :] * np.roll(np.eye(3), 1, axis=0)
        return Terms(self.vector, ('m',) * 3, state.machine.axis_names, columns)


class AxisBrake(UnknownEffect):
    """An axis that stands is clamped, and the clamp shifts its slide."""

    name: ClassVar[str] = 'unknown_axis_brake'
    cause: ClassVar[str] = 'a brake or a clamp that closes while its axis stands'
    equation: ClassVar[str] = 'A_a [axis a stands] e_a'

    def depends_on(self, state: State, parameters: Shape) -> EffectInputs:
        """Whether each axis that has a brake moves."""
        return depends_on(
            *(s for s, n in zip(SENSES, self.vector, strict=True) if parameters.get(n))
        )

    def factor(self, state: State, shape: Shape) -> Array:
        """One for every axis that stands."""
        stands = (np.abs(state.direction) < 1e-6) | (state.speed == 0)[:, None]
        return np.asarray(stands.astype(float))


class HeatPlume(UnknownEffect):
    """The beam is bent where it passes through warm air that rises from a motor."""

    name: ClassVar[str] = 'unknown_heat_plume'
    cause: ClassVar[str] = 'a hot motor beside the beam'
    depends: ClassVar[EffectInputs] = depends_on('azimuth', 'elevation')
    equation: ClassVar[str] = 'A r / 1 m exp(-angle(r, r0)^2 / (2 w^2)), r the beam'
    shape_names: ClassVar[tuple[str, ...]] = ('x', 'y', 'z', 'width')
    shape_units: ClassVar[tuple[str, ...]] = ('', '', '', 'rad')
    trial: ClassVar[Trial] = Trial(
        (
            *(Number(k, Uniform(0.2, 0.8)) for k in 'xyz'),
            Number('width', Uniform(0.05, 0.15)),
        )
    )

    def factor(self, state: State, shape: Shape) -> Array:
        """Bell curve about the beam to a place given in shares of the ranges, times range."""
        low, high = state.machine.lower, state.machine.upper
        place = low + np.array([shape[k] for k in 'xyz']) * (high - low)
        middle = place - (state.q - state.beam)
        length, reach = (np.linalg.norm(v, axis=1) for v in (state.beam, middle))
        cosine = np.einsum('ij,ij->i', state.beam, middle) / (length * reach)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.asarray(length * np.exp(-0.5 * (angle / shape['width']) ** 2))


WRITTEN_OUT: tuple[UnknownEffect, ...] = (
    MachineStep(),
    TrackerStep(),
    SlowSwing(),
    LocalBump(),
    StickSlip(),
    FeedOffset(),
    InertiaNod(),
    DirectionPair(),
    BallPassage(),
    AxisBrake(),
    HeatPlume(),
)


_SIZE = 1e-6
_ANY = EffectInputs()
_SEEDS = Uniform(1.0, 1e9)


class Nature(UnknownEffect):
    """A form as an effect with one coefficient A; ``draw`` is the seed of what the form draws.

    Parameters
    ----------
    form : callable(View)
        Displacement (n, 3), m, or that and what it depends on.
    depends : EffectInputs
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
        depends: EffectInputs = _ANY,
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
        displacement = self.form(view_of(state, shape['draw']))
        return displacement if isinstance(displacement, tuple) else (displacement, self.depends)

    def factor(self, state: State, shape: Shape) -> Array:
        """Displacement per unit of A."""
        return self._made(state, shape)[0]

    def depends_on(self, state: State, parameters: Shape) -> EffectInputs:
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
    n.name: n
    for n in (Nature(form, names, depends_on(SENSOR)) for form, names in FOLLOWING_FORMS.items())
}
"""Known causes that follow a signal recorded beside the samples."""
UNKNOWN_EFFECTS: dict[str, UnknownEffect] = {
    effect.name: effect for effect in (*WRITTEN_OUT, *(Nature(form) for form in NAMELESS_FORMS))
}
"""Effects whose right answer is 'unknown'."""
OUTSIDE = {**DEPARTED, **FOLLOWING, **UNKNOWN_EFFECTS}
"""All that the catalogue lacks."""
