# SPDX-License-Identifier: Apache-2.0
"""Plan after a diagnosis: what it asks, which paths answer, what is refused."""

import json

import pytest
from core_cells import some_machine

from otf_core.config import PlannerConfig
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import write_effects
from otf_core.errors import ConfigError
from otf_core.planning.follow_up import OpenQuestion, answer_of_pieces, open_questions, plan_after
from otf_core.planning.forecast import MeasuredRun, Setup, forecast, joint_rows
from otf_core.planning.path_creation import plan_path

MACHINE = some_machine(pitch=0.1)
LAG = AppliedEffect(REGISTRY['servo_mismatch'], {'T_X': 1.6e-5, 'T_Y': -8e-6})


def diagnosed(folder, rivals=('backlash',), hidden=('tracker_scale',)):
    """A folder as a diagnosis writes it."""
    causes = [{'effect': 'servo_mismatch', 'indistinguishable_from': list(rivals)}]
    content = {'causes': causes, 'not_visible': [{'effect': e, 'needs': ''} for e in hidden]}
    (folder / 'gap.json').write_text(json.dumps(content))
    write_effects(folder / 'effects.yaml', [LAG], MACHINE)
    return folder


def test_questions_are_rivals_and_what_was_not_visible(tmp_path):
    rival, hidden = open_questions(diagnosed(tmp_path), MACHINE)
    assert (rival.effect, rival.rival, rival.cause) == ('servo_mismatch', 'backlash', LAG)
    assert (hidden.effect, hidden.rival, hidden.cause) == ('tracker_scale', '', None)


def test_faint_lag_is_told_from_play_by_a_second_feed():
    setup = Setup.of(MACHINE)
    asked = [OpenQuestion('servo_mismatch', 'backlash', LAG)]
    plan, (answer,), _ = plan_after(asked, setup, PlannerConfig(levels=2), None)
    assert answer.sure and len(set(plan.feed.tolist())) >= 2
    assert answer.to_dict()['probability'] > 0.99


def test_time_that_no_path_keeps_is_refused_with_the_shortest():
    with pytest.raises(ConfigError, match=r'the shortest takes \d+ s'):
        plan_after([OpenQuestion('tracker_scale')], Setup.of(MACHINE), PlannerConfig(), 1.0)


def as_measured(plan, place):
    """Entry of gap.json for a run."""
    path, feed = plan.path.points.tolist(), plan.feed.tolist()
    return {'path': path, 'feed': feed, 'tracker_place': list(place)}


def test_a_run_that_was_measured_adds_to_what_a_further_one_says():
    """Twice the same run: twice the information, and more as both share their tables."""
    setup = Setup.of(MACHINE)
    plan = plan_path(MACHINE, PlannerConfig(levels=2))
    before = MeasuredRun.of(as_measured(plan, setup.place), 'gap.json')
    planned = forecast(plan, setup)
    question = OpenQuestion('servo_mismatch', 'backlash', LAG)
    alone, both = (
        answer_of_pieces(joint_rows(planned, known, 1e-4), question).log_odds
        for known in ([], [before.observed(setup)])
    )
    assert both > 1.9 * alone > 0.0
