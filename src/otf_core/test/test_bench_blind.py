# SPDX-License-Identifier: Apache-2.0
"""The blind trial beside the project is right: its nature, the seal of its key, its score."""

import sys
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[3] / 'bench'
pytestmark = pytest.mark.skipif(not BENCH.is_dir(), reason='the benches are not installed')
sys.path.append(str(BENCH))

LIMITS = {'X': (0.0, 0.5), 'Y': (0.0, 0.4), 'Z': (-0.3, 0.0), 'A': (-1.0, 1.0), 'C': (0.0, 5.0)}
CHAINS = (
    'w-b-X-Y-Z-t', 'w-Y-b-X-Z-t', 'w-X-Z-Y-b-t', 'w-b-X-Y-t', 'w-X-b-t', 'w-C-b-t', 'w-C-b-X-t',
    'w-C-A-b-Y-X-Z-t', 'w-b-X-Y-Z-C-A-t',
)  # fmt: skip


def machine_of(chain):
    from blind.nature import Machine

    axes = {}
    for letter in (a for a in chain.split('-') if a not in 'wbt'):
        low, high = LIMITS[letter]
        axes[letter] = {'min': low, 'max': high, 'table_pitch': 0.05}
        if letter in 'AC':
            turn = {'direction': [float(letter == 'A'), 0.0, float(letter == 'C')]}
            axes[letter] |= {'kind': 'rotary', 'centre': [0.02, -0.01, 0.05], **turn}
    return Machine({
        'chain': chain, 'axes': axes, 'target_offset': [0.01, -0.02, -0.15],
        'tracker': {'u_range': 0.5e-6, 'u_angle': 1.5e-6},
    })  # fmt: skip


def positions(machine, count=50):
    low, high = machine.ends(machine.letters)
    return low + np.random.default_rng(4).uniform(size=(count, len(low))) * (high - low)


@pytest.mark.parametrize('chain', CHAINS)
def test_without_errors_the_nominal_path_is_driven(chain):
    machine = machine_of(chain)
    q = positions(machine)
    if not machine.turning:
        travel = np.zeros((len(q), 3))
        travel[:, ['XYZ'.index(a) for a in machine.letters]] = q
        np.testing.assert_allclose(machine.at(q), travel + machine.target('tool')[1], atol=1e-15)
    for axis in machine.turning:  # about its centre, by its angle: the distance is kept
        other = q.copy()
        other[:, machine.column(axis)] = 0.0
        turned, straight = (
            machine.link(p, _none(), 'b', 'w' if axis in machine.table_side else 't')
            for p in (q, other)
        )
        assert np.abs(np.linalg.det(turned[0]) - 1.0).max() < 1e-12
        angle = np.arccos((np.trace(turned[0] @ np.swapaxes(straight[0], 1, 2),
                                    axis1=1, axis2=2) - 1.0) / 2.0)  # fmt: skip
        own = q[:, machine.column(axis)]
        np.testing.assert_allclose(np.cos(angle), np.cos(own), atol=1e-9)


def _none():
    from blind.nature import Errors

    return Errors()


@pytest.mark.parametrize('chain', [c for c in CHAINS if 'A' not in c and 'C' not in c])
def test_small_errors_are_those_of_the_first_order(chain):
    """e(q) = sum of t_a + r_a x L_a and squareness, as INTERFACES section 1 states it."""
    from blind.nature import SIX, SQUARE, draw_errors

    machine = machine_of(chain)
    q, errors = positions(machine), draw_errors(machine, np.random.default_rng(2))
    expected, offset = np.zeros((len(q), 3)), machine.target('tool')[1]
    for axis in machine.letters:
        k = machine.order.index(axis)
        beyond = machine.order[k:] if axis in machine.table_side else machine.order[k + 1 :]
        arm = np.tile(offset, (len(q), 1))
        for other in beyond:
            arm[:, 'XYZ'.index(other)] += q[:, machine.column(other)]
        six = [errors.motions[f'E{d}{axis}'](q[:, machine.column(axis)]) for d in SIX]
        expected += np.stack(six[:3], axis=1) + np.cross(np.stack(six[3:], axis=1), arm)
    assert set(machine.constants) == {n for n, p in SQUARE.items() if set(p) <= set(chain)}
    square = {n: errors.constants.get(n, 0.0) for n in SQUARE}
    y, z = (q[:, machine.column(a)] if a in machine.letters else 0.0 * q[:, 0] for a in 'YZ')
    expected[:, 0] += -square['C0Y'] * y + square['B0Z'] * z
    expected[:, 1] -= square['A0Z'] * z
    found = machine.at(q, errors=errors) - machine.at(q)
    size = np.abs(expected).max()
    assert 1e-5 < size < 1e-3
    assert np.abs(found - expected).max() < 10.0 * 3e-4 * size  # second order in 300 urad


def test_a_program_runs_from_corner_to_corner_on_straight_lines():
    from blind.nature import Part, Program

    machine = machine_of('w-b-X-Y-Z-t')
    corners = np.array([[0.0, 0, 0], [0.4, 0.3, 0], [0.4, 0.3, -0.2], [0, 0, 0]])
    program = Program(machine, Part('tool', corners, np.array([0.2, 0.1, 0.2])))
    time = np.arange(0.0, program.duration, 1e-3)
    q = program(time)
    assert np.abs(q[0] - corners[0]).max() == 0.0 and np.abs(q[-1] - corners[-1]).max() < 1e-12
    speed = np.linalg.norm(np.gradient(q, time, axis=0), axis=1)
    assert speed.max() == pytest.approx(0.2, rel=1e-3)
    push = np.gradient(np.gradient(q, time, axis=0), time, axis=0)
    assert 1.9 < np.abs(push).max() < 2.1  # of every axis
    on_first = q[program.way(time)[2] == 0]
    assert np.abs(on_first[:, 1] - 0.75 * on_first[:, 0]).max() < 1e-12


def test_a_changed_key_is_refused(tmp_path):
    from blind.draw import KEY, open_key, seal

    digest = seal(tmp_path, {'seed': 3, 'cells': []})
    assert open_key(tmp_path) == {'seed': 3, 'cells': []} and len(digest) == 64
    text = (tmp_path / KEY).read_text()
    (tmp_path / KEY).write_text(text.replace('3', '4'))
    with pytest.raises(ValueError, match='not the key that was sealed'):
        open_key(tmp_path)


def part(form, **more):
    from blind.effects import FORMS

    return {'form': form, 'names': sorted(FORMS[form].names), 'size_um': 2.0, 'raw_um': 3.0,
            'snr': 40.0, 'parameters': {'axis': 3.0, 'size': 1e-5}, **more}  # fmt: skip


def entry(kind, *hidden):
    return {'cell': '000', 'kind': kind, 'turn': 0, 'hidden': list(hidden), 'measured_um': 5.0,
            'simulated_um': 3.0, 'bends_um': 0.0, 'heavy_tails': False}  # fmt: skip


def answer(verdict, *causes, **more):
    gap = {'before_um': 4.0, 'after_um': 1.0, 'shrink_interval_percent': [60.0, 90.0]}
    named = [
        {'effect': name, 'confidence': sure, 'indistinguishable_from': list(others),
         'parameters': {}, 'u': {}}
        for name, sure, *others in causes
    ]  # fmt: skip
    return {'verdict': verdict, 'causes': named, 'gap': gap, 'not_visible': [], **more}


NAMED = 'one effect: named, or said to be not visible'
DRIFT, LAG, PLAY = 'thermal_structure_drift', 'servo_mismatch', 'backlash'


@pytest.mark.parametrize(
    ('asked', 'said', 'result', 'foreign'),
    [
        (('none',), ('none',), 'quiet', 0),
        (('none',), ('unknown',), 'false alarm', 0),
        (('none',), ('explained', (PLAY, 0.8)), 'false alarm', 1),
        (('one', PLAY), ('explained', (PLAY, 0.9)), 'right', 0),
        (('one', PLAY), ('explained', (LAG, 0.6, PLAY)), 'listed', 0),
        (('one', PLAY), ('explained', (DRIFT, 0.6), (PLAY, 0.9)), 'wrong', 1),
        (('one', PLAY), ('none',), 'unseen', 0),
        (('one', PLAY), ('unknown',), 'called unknown', 0),
        (('other form', 'other_drift_late'), ('explained', (DRIFT, 1.0)), 'right', 0),
        (('mixture', PLAY, DRIFT), ('explained', (DRIFT, 1.0)), 'half', 0),
        (('mixture', PLAY, DRIFT), ('explained', (DRIFT, 1.0), (PLAY, 1.0)), 'right', 0),
        (('amid small', PLAY, DRIFT), ('explained', (PLAY, 1.0), (LAG, 0.4)), 'right', 1),
        (('small', PLAY), ('explained', (LAG, 0.5)), 'quiet', 1),
        (('small', PLAY), ('explained', (LAG, 0.95)), 'false alarm', 1),
        (('unknown', 'unknown_slow_swing'), ('unknown',), 'unknown', 0),
        (('unknown', 'unknown_slow_swing'), ('explained', (DRIFT, 0.9)), 'forced', 1),
        (('left out', PLAY), ('unknown',), 'unknown', 0),
        (('rotary two', 'turning_play', 'turning_late'), ('explained', (LAG, 1.0)), 'half', 0),
    ],
)
def test_answers_count_as_they_should(asked, said, result, foreign):
    from blind.score import judge

    kind, *forms = asked
    found = judge(entry(kind, *map(part, forms)), answer(*said))
    assert (found.result, len(found.foreign)) == (result, foreign)
    assert found.gap == (4.0, 4.0) and found.left == 0.25


def test_what_leaves_no_trace_is_right_as_not_visible():
    from blind.score import judge

    hidden = entry('one', part('tracker_scale', size_um=0.01, snr=0.3))
    listed = answer('none', not_visible=[{'effect': 'tracker_scale', 'needs': 'a length'}])
    assert judge(hidden, listed).result == 'not visible'
    assert judge(hidden, answer('none')).result == 'silent'


def test_parameters_inputs_and_shares_are_counted():
    from blind.score import as_markdown, interval, judge, rows

    said = answer('explained', (PLAY, 0.9))
    said['causes'][0] |= {'parameters': {'B_X': 5e-6, 'B_Y': 1e-7, 'held': 0.0},
                          'u': {'B_X': 1e-6, 'B_Y': 2e-7}}  # fmt: skip
    true = part(PLAY, parameters={'B_X': 4e-6, 'held': 0.0})
    one = judge(entry('one', true), said, 95.0)
    assert one.deviations == pytest.approx((1.0, 0.5))
    unnamed = {'depends_on': ['time'], 'before_um': 4.0, 'after_um': 3.0,
               'shrink_interval_percent': [10.0, 40.0]}  # fmt: skip
    hidden = entry('unknown', part('unknown_slow_swing'))
    other = judge(hidden, answer('unknown', unnamed=unnamed))
    assert other.inputs is True and other.left == 0.75
    table = {name: (hits, of) for name, hits, of in rows([one, other])}
    assert (
        table['one effect: named, or said to be not visible']
        == table['no catalogue: called unknown']
        == (1, 1)
    )
    assert table['parameters within 2 u'] == (2, 2) and table['command failed'] == (0, 2)
    assert table['interval of the shrink holds the truth'] == (0, 1)
    assert (
        '| one effect: named, or said to be not visible | 1 of 1 (100 %) | 2 % to 100 % |'
        in as_markdown(rows([one]))
    )
    assert interval(0, 68) == pytest.approx((0.0, 0.053), abs=1e-3)
