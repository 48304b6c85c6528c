# SPDX-License-Identifier: Apache-2.0
"""What stands in the descriptions of the public names runs and says the truth."""

import doctest
import inspect
import re
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest

import otf_core
from otf_core import cli

ROOT = Path(__file__).resolve().parents[4]
SESSION = (
    *('load_machine', 'read_bag', 'write_bag', 'calibrate', 'write_calibration', 'predict'),
    *('diagnose', 'summary', 'plan', 'write_plan', 'simulate', 'load_tables'),
)
"""Each goes on with what those before it left; all others need no more than that."""
OTHERS = tuple(name for name in otf_core.__all__ if name not in SESSION)


@pytest.fixture(scope='module')
def session(tmp_path_factory):
    """Names and files that the examples leave, and what failed in the description of each."""
    folder = tmp_path_factory.mktemp('session')
    (folder / 'bags').symlink_to(ROOT / 'bags')
    left, wrong = {'otf_core': otf_core, 'np': np}, {}
    runner = doctest.DocTestRunner()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in (*SESSION, *OTHERS):
            text = inspect.getdoc(getattr(otf_core, name))
            test = doctest.DocTestParser().get_doctest(text, left, name, None, 0)
            said = []
            done = runner.run(test, out=said.append, clear_globs=False)
            left.update(test.globs)
            wrong[name] = (done.attempted, ''.join(said))
    return folder, left, wrong


@pytest.mark.parametrize('name', otf_core.__all__)
def test_example_says_the_truth(session, name):
    attempted, said = session[2][name]
    assert not said
    makers = [f for f in SESSION if returned_by(f) is getattr(otf_core, name)]
    assert attempted or any(session[2][maker][0] for maker in makers), 'no example'


def returned_by(name):
    public = {n: getattr(otf_core, n) for n in otf_core.__all__}
    return get_type_hints(getattr(otf_core, name), localns=public).get('return')


def test_a_result_and_its_file_predict_the_same(session):
    folder, left, _ = session
    points = np.array([[0.1, 0.1, -0.2], [-0.15, 0.0, -0.1], [0.2, 0.2, -0.3]])
    a = otf_core.predict(left['result'], points)
    b = otf_core.predict(folder / 'results/error_tables.json', points)
    c = otf_core.predict(otf_core.load_tables(folder / 'results/error_tables.json'), points)
    for other in (b, c):
        np.testing.assert_array_equal(a.error, other.error)
        np.testing.assert_array_equal(a.u, other.u)
        assert a.notes == other.notes and a.correlated


def test_tables_alone_predict_the_same_errors_without_covariance(session):
    result, points = session[1]['result'], [[0.1, 0.1, -0.2]]
    alone = otf_core.predict(result.tables, points)
    np.testing.assert_array_equal(alone.error, otf_core.predict(result, points).error)
    assert not alone.correlated


def without_date(file):
    return re.sub(r'"written": "[^"]*"', '', file.read_text())


def test_the_command_writes_the_same_tables(session, monkeypatch):
    folder = session[0]
    monkeypatch.chdir(folder)
    place = 'bags/y-carries-the-table'
    words = ['calibrate', f'{place}/bag', '--machine', f'{place}/machine.yaml', '--out', 'told']
    assert cli.main(words) == 0
    for name in ('error_tables.json', 'error_tables.csv'):
        assert without_date(folder / 'told' / name) == without_date(folder / 'results' / name)
    told, left = (folder / place / 'residuals.npz' for place in ('told', 'results'))
    assert told.read_bytes() == left.read_bytes()


def test_a_run_that_was_written_is_read_again_to_the_last_bit(session):
    folder, left, _ = session
    again = otf_core.read_bag(folder / 'copy', left['machine'])
    np.testing.assert_array_equal(again.samples.xyz, left['recording'].samples.xyz)
    np.testing.assert_array_equal(again.path.points, left['recording'].path.points)


def test_the_simulated_run_tells_the_truth_it_was_made_of(session):
    run = session[1]['run']
    corner = run.recording.path.points[0]
    true_error = otf_core.predict(run.truth, [corner]).error[0]
    seen = run.T_machine_tracker.apply(run.recording.samples.xyz[:200]).mean(axis=0)
    assert np.linalg.norm(seen - corner - true_error) < 6e-6  # 5 um of backlash, noise of 200
    assert np.linalg.norm(seen - corner) > 1e-6


def test_written_results_are_not_overwritten_unless_asked(session):
    folder, left, _ = session
    with pytest.raises(otf_core.ConfigError, match='holds files already'):
        otf_core.write_calibration(left['result'], folder / 'results')
    otf_core.write_calibration(left['result'], folder / 'results', overwrite=True)
    with pytest.raises(otf_core.ConfigError, match="'gcode' is unknown; possible: sinumerik"):
        otf_core.write_plan(left['report'], folder / 'other', dialect='gcode')
    assert not (folder / 'other').exists()
