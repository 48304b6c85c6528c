# SPDX-License-Identifier: Apache-2.0
"""Something else as a rival of the causes that are named."""

from types import SimpleNamespace

import numpy as np
import pytest
from engine_cells import holding, noise, solved_rows
from scipy.stats import multivariate_normal

from otf_core.diagnosis.engine.empirical_structure import Rival, rival_of, together, try_structures
from otf_core.diagnosis.engine.evidence import SPREADS
from otf_core.diagnosis.engine.search import search, tried_effects
from otf_core.effects import REGISTRY


def held(displacement):
    """Rows that hold noise and a displacement of the pieces."""
    rows = solved_rows()
    parts = [
        np.einsum('cpk,pk->cp', run.system.axes, displacement(state)).ravel()
        for run, state in zip(rows.done.runs, rows.states, strict=True)
    ]
    return holding(noise(7) + np.concatenate(parts))


def found_in(rows, *names):
    return search(rows, tried_effects(rows, [REGISTRY[n] for n in names], {})[0])[0]


def drift(s):
    return (6e-6 * (1 - np.exp(-2.0 * s.time / s.end)))[:, None] * [0.3, 0.2, 1.0]


def sagging(s):
    u = 2 * s.q[:, 0] / s.machine.upper[0] - 1
    return (8e-6 * s.time / s.end * np.exp(-2 * u**2))[:, None] * [0, 0, 1]


def test_a_right_cause_has_no_rival():
    rows = held(drift)
    causes = found_in(rows, 'thermal_structure_drift')
    assert rival_of(causes, try_structures(rows)).confidence(causes[0]) > 0.999


def test_a_cause_that_only_follows_something_else_is_doubted():
    rows = held(sagging)
    causes = found_in(rows, 'thermal_structure_drift')
    assert causes and causes[0].confidence > 0.99  # the only one in its catalogue
    rival = rival_of(causes, try_structures(rows))
    assert set(rival.inputs) == {'time', 'x'}
    assert rival.confidence(causes[0]) < 1e-3


def test_a_shift_of_all_places_gives_way_where_the_place_matters_as_well():
    def growing(s):
        away = 1.0 + s.q[:, 2] / (s.machine.upper[2] - s.machine.lower[2])
        return (12e-6 * np.sqrt(s.time / s.end) * away)[:, None] * [0, 0, 1]

    rows = held(growing)
    causes = found_in(rows, 'thermal_structure_drift')
    rival = rival_of(causes, try_structures(rows))
    assert 'time' in rival.inputs and len(rival.inputs) == 2 and rival.wins


@pytest.mark.parametrize(
    ('own', 'score', 'odds', 'stated'),
    [
        (1.0, 200.0, -np.inf, 1.0),
        (1.0, 9.0, -np.inf, 0.5),  # just enough to be named at all
        (0.5, 200.0, 0.0, 0.25),  # as likely another effect, as likely something else
        (1.0, 9.0, 0.0, 1 / 3),
    ],
)
def test_confidence_counts_effects_something_else_and_nothing(own, score, odds, stated):
    cause = SimpleNamespace(confidence=own, score=score)
    assert Rival(odds).confidence(cause) == pytest.approx(stated, abs=1e-9)


def test_evidence_of_causes_together_is_that_of_the_normal_distribution():
    rows = held(drift)
    causes = found_in(rows, 'backlash', 'thermal_structure_drift')
    (cause,) = causes
    option, rng = cause.option, np.random.default_rng(2)
    some = rng.choice(len(rows.residual), 40, replace=False)  # a hand-sized problem
    small = type(cause)(
        type(option)(**{**vars(option), 'own': option.own[some], 'white': option.white[some]}),
        0.0, 1.0, (),
    )  # fmt: skip
    y = rows.residual[some]
    part = type('Rows', (), {'residual': y})
    none = multivariate_normal(np.zeros(40), np.eye(40)).logpdf(y)
    odds = []
    for spread in SPREADS:
        columns = small.option.own * (spread / option.size)
        odds.append(multivariate_normal(np.zeros(40), np.eye(40) + columns @ columns.T).logpdf(y))
    wanted = np.log(np.mean(np.exp(np.array(odds) - none)))
    assert together([small], part, 1.0) == pytest.approx(wanted, rel=1e-6, abs=1e-8)
