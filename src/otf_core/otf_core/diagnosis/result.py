# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says, and its form as gap.json (INTERFACES section 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from otf_core.diagnosis.place.where import Where

SCHEMA = 'otf-gap/1'
VERDICTS = ('none', 'explained', 'partly_explained', 'unknown')


@dataclass(frozen=True)
class Gap:
    """Size of the gap, micrometres root mean square per path piece.

    Attributes
    ----------
    measured_um, simulated_um : float
        Residual of the real run and of its simulation through the same pipeline.
    before_um, after_um : float
        sqrt(max(0, measured^2 - simulated^2)) without and with the causes; ``after`` is judged on
        legs that the causes were not fitted on.
    shrink_percent : float
    shrink_interval_percent : tuple of two floats
        95 % interval over legs.
    """

    measured_um: float
    simulated_um: float
    before_um: float
    after_um: float
    shrink_percent: float
    shrink_interval_percent: tuple[float, float]


@dataclass(frozen=True)
class NamedCause:
    """An effect that was found.

    Attributes
    ----------
    effect : str
    axes : tuple of str
    parameters, u : mapping of str to float
        Fitted parameters in SI units with their standard uncertainties (shape parameters have
        none).
    units : mapping of str to str
    before_um, after_um, shrink_percent : float
        Gap without and with this cause, those found before it being in both.
    confidence : float
    indistinguishable_from : tuple of str
    """

    effect: str
    axes: tuple[str, ...]
    parameters: Mapping[str, float]
    u: Mapping[str, float]
    units: Mapping[str, str]
    before_um: float
    after_um: float
    shrink_percent: float
    confidence: float
    indistinguishable_from: tuple[str, ...]


@dataclass(frozen=True)
class Diagnosis:
    """Answer to: where and why does the real run depart from its simulation.

    Attributes
    ----------
    runs : tuple of str
    verdict : str
        One of ``VERDICTS``.
    sentence : str
        The verdict in words.
    gap : Gap
    causes : tuple of NamedCause
        First the cause that shrinks the gap most.
    unexplained_um : float
    unexplained_where : str
    not_visible : tuple of (effect, needs)
    where : Where
    considered : tuple of (effect, log odds)
        Ranking of the last round of the search.
    table_change_um : float
        Mean change of the predicted volumetric error on a lattice when the causes are in the
        calibration.
    """

    runs: tuple[str, ...]
    verdict: str
    sentence: str
    gap: Gap
    causes: tuple[NamedCause, ...]
    unexplained_um: float
    unexplained_where: str
    not_visible: tuple[tuple[str, str], ...]
    where: Where
    considered: tuple[tuple[str, float], ...] = ()
    table_change_um: float = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as plain data in the layout of gap.json."""
        return {
            'schema': SCHEMA,
            'runs': list(self.runs),
            'verdict': self.verdict,
            'sentence': self.sentence,
            'gap': asdict(self.gap),
            'causes': [asdict(c) for c in self.causes],
            'unexplained': {'rms_um': self.unexplained_um, 'where': self.unexplained_where},
            'not_visible': [{'effect': e, 'needs': n} for e, n in self.not_visible],
            'where': asdict(self.where),
            'considered': [{'effect': e, 'log_odds': s} for e, s in self.considered],
            'table_change_um': self.table_change_um,
            **self.extra,
        }


def format_diagnosis(diagnosis: Diagnosis) -> str:
    """Return the text for a terminal."""
    gap = diagnosis.gap
    lines = [
        f'verdict: {diagnosis.verdict}',
        diagnosis.sentence,
        f'residual {gap.measured_um:.2f} um, simulated {gap.simulated_um:.2f} um; gap '
        f'{gap.before_um:.2f} um -> {gap.after_um:.2f} um',
        '',
    ]
    for cause in diagnosis.causes:
        axes = f' ({", ".join(cause.axes)})' if cause.axes else ''
        lines.append(
            f'cause {cause.effect}{axes}: gap {cause.before_um:.2f} um -> '
            f'{cause.after_um:.2f} um, confidence {100 * cause.confidence:.0f} %'
        )
        for name, value in cause.parameters.items():
            u = f' +/- {cause.u[name]:.2g} (k = 1)' if name in cause.u else ''
            lines.append(f'    {name} = {value:.4g}{u} {cause.units.get(name, "")}'.rstrip())
        if cause.indistinguishable_from:
            lines.append(f'    not told from {", ".join(cause.indistinguishable_from)}')
    lines += ['', diagnosis.where.summary, f'unexplained: {diagnosis.unexplained_where}', '']
    lines += [f'not visible: {e}; needs {n}' for e, n in diagnosis.not_visible]
    return '\n'.join(lines)
