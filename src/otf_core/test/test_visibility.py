# SPDX-License-Identifier: Apache-2.0
"""What is tried in a run and what of it the run can show at all."""

from dataclasses import replace

import numpy as np
import pytest
from engine_cells import dense_base, holding, noise, options_of, solved_rows, trace_of

from otf_core.diagnosis.engine.search import (
    Cause,
    Visibility,
    effects_without,
    search_catalogue,
    shapes_from_lines,
    tried_effects,
)
from otf_core.diagnosis.engine.spectral import SpectralLine
from otf_core.effects import REGISTRY, Effect, Terms
from otf_core.noise.noise_model import MODEL_FLOOR, Misfit, NoiseModel
from otf_core.solving.whitener import Whitener


def along_x(size):
    """An effect of one coefficient: displacement along X of sizes that depend on the state."""

    def terms(state, shape):
        column = np.asarray(size(state), float)[:, None] * np.eye(3)[0]
        return Terms.of(['c'], 'm', column[:, :, None])

    return Effect(terms, 'made')


def hat(position, node, pitch):
    return np.clip(1.0 - np.abs(position - node) / pitch, 0.0, None)


TABLE_SPACE = {
    'a shift': along_x(lambda s: np.ones(len(s))),
    'a squareness': along_x(lambda s: s.q[:, 1]),
    'a hat of EXX': along_x(lambda s: hat(s.q[:, 0], 0.1, 0.1)),
    'a hat of EXZ': along_x(lambda s: hat(s.q[:, 2], -0.1, 0.1)),
}
OUTSIDE = {
    'the sense of travel': along_x(lambda s: np.sign(s.direction[:, 0])),
    'a fast wave in time': along_x(lambda s: np.sin(s.time)),
    'a product of positions': along_x(lambda s: np.sin(40 * s.q[:, 0]) * np.sin(50 * s.q[:, 1])),
}


def sight(effect, rows=None):
    return tried_effects(rows or solved_rows(), [effect], {})[1][effect.name]


@pytest.mark.parametrize('effect', TABLE_SPACE.values(), ids=TABLE_SPACE)
def test_what_tables_and_poses_follow_is_not_visible(effect):
    seen = sight(effect)
    assert not seen.visible
    assert seen.share < 0.02
    assert seen.smallest > 1e-5


@pytest.mark.parametrize('effect', OUTSIDE.values(), ids=OUTSIDE)
def test_what_they_cannot_follow_is_visible(effect):
    seen = sight(effect)
    assert seen.visible
    assert seen.share > 0.5
    assert seen.smallest < 1e-6


def test_an_effect_that_does_not_move_the_target_leaves_nothing():
    assert sight(along_x(lambda s: 0.0 * s.time)) == Visibility(0.0, np.inf)
    assert not Visibility(0.0, np.inf).visible


@pytest.mark.parametrize(
    ('share', 'smallest_um', 'visible'),
    [(0.101, 4.99, True), (0.099, 4.99, False), (0.101, 5.01, False), (1.0, 0.01, True)],
)
def test_limits_of_visibility(share, smallest_um, visible):
    assert Visibility(share, 1e-6 * smallest_um).visible is visible


# ---------------------------------------------------------------- the smallest that is found


@pytest.mark.parametrize('effect', OUTSIDE.values(), ids=OUTSIDE)
def test_smallest_effect_is_five_standard_deviations(effect):
    """Of that size it takes 25 off the sum of squares; by least squares with tables and poses."""
    rows = solved_rows()
    tried, visible = tried_effects(rows, [effect], {})
    (option,) = (t.source.option(t.takes[0]) for t in tried['made'])
    rms = np.sqrt(
        np.mean(option.plain[np.abs(option.plain) > 0.02 * np.abs(option.plain).max()] ** 2)
    )
    trace = trace_of(Cause(option, 0.0, 0.0, ()), c=visible['made'].smallest / rms)
    white = rows.whiten(np.column_stack([trace, option.plain[:, 0]]))
    without = np.linalg.lstsq(dense_base(rows), white[:, 0], rcond=None)[1][0]
    stacked = np.column_stack([dense_base(rows), white[:, 1]])
    coefficients = np.linalg.lstsq(stacked, white[:, 0], rcond=None)[0]
    with_it = np.sum((white[:, 0] - stacked @ coefficients) ** 2)
    assert without - with_it == pytest.approx(25.0, rel=1e-3)


def with_noise(factor):
    """The rows in noise of a multiple of the assumed one."""
    rows = solved_rows()
    misfit = Misfit(factor * MODEL_FLOOR)
    whiteners = []
    for run, solved in zip(rows.runs, rows.done.runs, strict=True):
        louder = NoiseModel(*(c.times(factor**2, factor**2, 1.0) for c in run.noise))
        whiteners.append(Whitener.of(solved.system, run.pieces, louder, misfit))
    return replace(rows, whiteners=tuple(whiteners))


@pytest.mark.parametrize('name', ['backlash', 'cross_coupling', 'tracker_angles'])
def test_twice_the_noise_makes_the_smallest_twice_as_large(name):
    once, twice = (sight(REGISTRY[name], rows) for rows in (with_noise(1.0), with_noise(2.0)))
    assert twice.smallest / once.smallest == pytest.approx(2.0, rel=0.01)
    assert twice.share == pytest.approx(once.share, rel=0.01)


def test_a_unit_does_not_change_what_is_seen():
    """The same displacement per mm instead of per m."""
    effect = OUTSIDE['the sense of travel']
    small = along_x(lambda s: 1e-3 * np.sign(s.direction[:, 0]))
    assert sight(small).smallest == pytest.approx(sight(effect).smallest, rel=1e-9)
    assert sight(small).share == pytest.approx(sight(effect).share, rel=1e-9)


# ---------------------------------------------------------------- what is tried


def test_spectral_lines_become_shapes_from_their_score_on():
    lines = [
        SpectralLine('vibration', REGISTRY['vibration'].wave, 7.0, 8.1),
        SpectralLine('vibration', REGISTRY['vibration'].wave, 9.0, 7.9),
        SpectralLine('cyclic_error', REGISTRY['cyclic_error'].wave, 0.02, 50.0),
        SpectralLine('cyclic_error', REGISTRY['cyclic_error'].wave, 0.03, 8.1),
        SpectralLine('cyclic_error', REGISTRY['cyclic_error'].wave, 0.04, 1.0),
    ]
    assert shapes_from_lines(lines) == {
        'vibration': [{'frequency': 7.0}],
        'cyclic_error': [{'period': 0.02}, {'period': 0.03}],
    }


def test_without_a_line_a_wave_is_not_tried_but_its_sight_is_known():
    effects = [REGISTRY[n] for n in ('vibration', 'cyclic_error')]
    tried, visible = tried_effects(solved_rows(), effects, {'vibration': [], 'cyclic_error': []})
    assert tried == {'vibration': [], 'cyclic_error': []}
    assert all(np.isfinite(v.smallest) for v in visible.values())
    tried, _ = tried_effects(solved_rows(), effects, {'vibration': [{'frequency': 3.0}]})
    assert {t.shape['frequency'] for t in tried['vibration']} == {3.0}


def test_excluded_effects_and_noise_are_not_tried():
    left = {e.name for e in effects_without(['backlash', 'vibration'])}
    assert left == set(REGISTRY) - {'backlash', 'vibration', 'tracker_noise'}


def test_catalogue_finds_what_was_put_in_unless_it_is_excluded():
    names = ('table_tilt', 'tracker_scale', 'servo_mismatch')
    others = [n for n in REGISTRY if n not in names]
    option = options_of(REGISTRY['table_tilt'])[0]
    trace = 20e-6 / option.size[0] * option.plain[:, 0]
    found = search_catalogue(holding(trace + noise(31)), others)
    assert found.causes[0].option.effect.name == 'table_tilt'
    assert set(found.visible) == set(names)  # no shapes from outside the catalogue
    found = search_catalogue(holding(trace + noise(31)), [*others, 'table_tilt'])
    assert 'table_tilt' not in {c.option.effect.name for c in found.causes}
    assert set(found.visible) == set(names) - {'table_tilt'}
