# SPDX-License-Identifier: Apache-2.0
"""Optimised plans: best grid in a given time, inside the margin, everything seen; confirmed."""

from types import SimpleNamespace

import numpy as np
import pytest
from core_cells import some_machine

from otf_core.config import ForecastConfig, PlannerConfig
from otf_core.errors import ConfigError
from otf_core.model.motions import MOTIONS, SQUARENESS
from otf_core.planning.findings import chain_shows
from otf_core.planning.forecast import Setup, forecast
from otf_core.planning.path_optimiser import Walks, plan_for_time, plan_for_uncertainty

CONFIG = PlannerConfig(feed=0.2, corner_dwell=0.1, end_dwell=1.0, margin=0.01)
JUDGED = ForecastConfig(rate=100.0, grid=5)
BUDGET = 100.0


@pytest.fixture(scope='module')
def best():
    """Machine, set-up, optimiser and the best plan for ``BUDGET``."""
    machine = some_machine('w-Y-b-X-Z-t', offset=(0.0, 0.0, -0.15))
    setup = Setup.of(machine, config=JUDGED)
    optimiser = Walks(setup, CONFIG)
    found = plan_for_time(optimiser.attempt, BUDGET)
    return SimpleNamespace(
        machine=machine, setup=setup, optimiser=optimiser, plan=found.plan, found=found
    )


def test_time_is_used_up_and_not_exceeded(best):
    assert 0.97 * BUDGET < best.found.forecast.duration <= BUDGET
    assert best.setup.seconds(best.plan.parts[0]) <= BUDGET


def test_plan_keeps_margin_feed_and_dwells(best):
    points = best.plan.path.points
    assert np.all(points >= best.machine.lower + CONFIG.margin - 1e-12)
    assert np.all(points <= best.machine.upper - CONFIG.margin + 1e-12)
    assert best.plan.feed.max() <= CONFIG.feed
    assert best.plan.dwell[0] == best.plan.dwell[-1] == CONFIG.end_dwell
    assert set(best.plan.dwell[1:-1]) == {CONFIG.corner_dwell}
    assert best.plan.path.leg_lengths.min() > 0.05


def test_every_error_that_the_chain_shows_is_determined_at_every_node(best):
    hidden = {n for n in MOTIONS if not chain_shows(best.machine, n)}
    assert set(best.found.forecast.not_identifiable) == hidden
    assert best.found.forecast.loose_nodes == {}
    assert set(best.optimiser.visible) == {*SQUARENESS, *MOTIONS} - hidden


def test_walk_judges_as_the_forecast_does(best):
    """Sums of the normal matrices of lines are those of the whole drive."""
    walk = best.optimiser.walk(BUDGET, 2)
    found = forecast(best.optimiser.plan(walk), best.setup)
    mean = float(np.mean(np.sum(found.grid_u_free**2, axis=1)))
    assert walk.variance * best.setup.limit**2 == pytest.approx(mean, rel=0.02)
    assert best.optimiser.cost.shape == (351, len(best.optimiser.feeds))


def test_ideal_share_uses_the_time_and_cannot_be_bettered(best, monkeypatch):
    lines = best.optimiser
    monkeypatch.setattr('otf_core.planning.path_optimiser.ITERATIONS', 300)
    weight = lines.allocate(BUDGET)
    assert float(np.sum(weight * lines.cost)) == pytest.approx(BUDGET)
    gain = lines.judge(lines.total(weight))[1]
    # equivalence theorem: no line is worth more per second than the mean
    mean = float(np.sum(weight * gain)) / BUDGET
    assert (gain / lines.cost).max() < 1.05 * mean


def test_first_order_gain_of_a_line_is_the_derivative(best):
    lines = best.optimiser
    matrix = lines.total(lines.allocate(BUDGET))
    before, gain = lines.judge(matrix)
    for line in (0, 100, 350):
        step = 1e-3 * lines.information[line * len(lines.feeds)]
        change = before - lines.judge(matrix + step)[0]
        assert change == pytest.approx(1e-3 * gain[line, 0], rel=0.01)


def test_too_short_a_time_says_what_suffices_and_it_does(best):
    with pytest.raises(
        ConfigError, match=r'time_budget: 4 s is too short .* (\d+) s suffice'
    ) as e:
        plan_for_time(best.optimiser.attempt, 4.0)
    enough = float(str(e.value).split(' s suffice')[0].split()[-1])
    assert plan_for_time(best.optimiser.attempt, enough + 1).forecast.loose_nodes == {}
    with pytest.raises(ConfigError, match='no plan is longer'):
        plan_for_time(best.optimiser.attempt, 1e6)


def test_wanted_uncertainty_is_reached_in_a_short_time(best):
    wanted = best.found.forecast.mean_grid_u
    own = best.optimiser
    found = plan_for_uncertainty(own.attempt, wanted, own.guess(wanted))
    assert found.forecast.mean_grid_u <= wanted
    assert found.forecast.duration < 1.15 * BUDGET
