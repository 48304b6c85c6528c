# SPDX-License-Identifier: Apache-2.0
"""What every NC dialect of the registry keeps to: its program, read back, drives the plan.

The reader below knows the words of controls from their manuals and nothing of the writers. It
refuses what it does not know, so a new dialect may need its words here.
"""

import re

import numpy as np
import pytest
from core_cells import on_increments, program, small_plan, some_machine

from otf_core.errors import ConfigError
from otf_core.model.plan import Plan
from otf_core.planning.nc import DIALECTS

every_dialect = pytest.mark.parametrize('name', DIALECTS)
NASTY = ['MILL (NEW); 5% [A] {B} Fräse µm', '', 'x' * 200]

# ---------------------------------------------------------------- a small reader

MODES = {
    'mm': {'G21', 'G71', 'G710'},
    'absolute': {'G90'},
    'per minute': {'G94'},
    'no radius compensation': {'G40'},
    'machine zero': {'G53', 'G54'},
}
"""Words and what they switch on; G54 where the operator sets it to zero, as the program asks."""
HARMLESS = {'D0', 'G17', 'G49', 'G80', 'G601', 'G64', 'G359'}
KLARTEXT = {'mm', 'absolute', 'per minute', 'no radius compensation'}
STOPS = {'G9', 'G09', 'G60', 'G61.1'}
"""Words that make one block end with an exact stop."""
MACHINE = {'G53', 'SUPA', 'M91'}
"""Words that make one block a move in machine coordinates."""
STRAIGHT = {'G1', 'G01', 'L'}
WORD = re.compile(r'(?:SUPA|[A-Z][+-]?\d*\.?\d*)(?=\s|$)')
DWELL = re.compile(r'G0?4 [A-Z](\d+\.\d+)|CYCL DEF 9\.1 DWELL (\d+\.\d+)')
NUMBERS = {'X': 0, 'Y': 1, 'Z': 2}


class Reader:
    """Drives a program: places with feed and dwell; anything it does not know is an error."""

    def __init__(self, text):
        self.place, self.modes, self.ended = [None] * 3, set(), False
        self.before, self.moves, self.waited = [], [], False
        for line in text.splitlines():
            self._block(line)
        assert self.ended and self.waited

    def _block(self, line):
        line = re.sub(r'^N?\d+(?: |$)', '', re.sub(r'MSG.*|\(.*?\)|;.*', '', line).rstrip())
        if line in ('', '%') or re.fullmatch(r'O\d{4}|% \w+', line):
            return
        if line.startswith('BEGIN PGM') and line.endswith(' MM'):
            self.modes |= KLARTEXT
        elif line == 'CYCL DEF 9.0 DWELL TIME' or line.startswith('END PGM'):
            pass
        elif line in ('M0', 'M00', 'STOP M0'):
            self.waited, self.before, self.moves = True, self.moves, [[*self.place, None, 0.0]]
        elif line in ('M2', 'M02', 'M30'):
            self.ended = True
        elif dwell := DWELL.fullmatch(line):
            self.moves[-1][4] += float(dwell[1] or dwell[2])
        else:
            self._words(WORD.findall(line), line)

    def _words(self, words, line):
        assert ' '.join(words) == line, line
        assert not self.ended, line
        if not {w[0] for w in words} & set(NUMBERS):
            for word in words:
                switched = {mode for mode, codes in MODES.items() if word in codes}
                assert switched or word in HARMLESS, line
                self.modes |= switched
            return
        assert STRAIGHT & set(words), f'no feed move: {line}'
        assert MACHINE & set(words) or 'machine zero' in self.modes, line
        assert {*MODES} - {'machine zero'} <= self.modes, line
        feed = [float(w[1:]) for w in words if w[0] == 'F']
        for word in words:
            if word[0] in NUMBERS:
                self.place[NUMBERS[word[0]]] = float(word[1:])
            else:
                known = {'R0', 'G90', 'G61', *STRAIGHT, *MACHINE, *STOPS}
                assert word[0] == 'F' or word in known, line
        self.moves.append([*self.place, *feed, 0.0])


def little(points, feed=0.25, dwell=0.25):
    points = np.asarray(points, float)
    count = len(points)
    return Plan.along(points, np.full(count - 1, feed), np.full(count, dwell))


def random_plan(seed):
    """Points anywhere on the increments, some repeated, all feeds and dwells different."""
    rng = np.random.default_rng(seed)
    points = np.round(rng.uniform(-0.9, 0.9, (12, 3)), 6)
    points[5] = points[4]
    points[8, :2] = points[7, :2]
    feed = np.round(rng.uniform(0.01, 0.5, 11), 4)
    return Plan.along(points, feed, np.round(rng.uniform(0.01, 3.0, 12), 3))


# ---------------------------------------------------------------- conformance


@every_dialect
@pytest.mark.parametrize('seed', [None, 1, 2, 3])
def test_program_read_back_drives_the_plan(name, seed):
    machine = some_machine()
    planned = on_increments(machine, small_plan(machine, passes=2))
    plan = planned if seed is None else random_plan(seed)
    done = np.array(Reader(program(DIALECTS[name], plan, NASTY)).moves, dtype=float)
    moves = np.concatenate([[True], np.any(np.diff(plan.path.points, axis=0) != 0, axis=1)])
    np.testing.assert_allclose(done[:, :3], 1e3 * plan.path.points[moves], atol=1e-9)
    np.testing.assert_allclose(done[1:, 3], np.rint(6e4 * plan.feed)[moves[1:]])
    dwell = np.add.reduceat(plan.dwell, np.flatnonzero(moves))
    np.testing.assert_allclose(done[:, 4], dwell, atol=6e-4)


@every_dialect
def test_program_climbs_before_it_crosses_and_waits_at_the_start(name):
    plan = random_plan(4)
    reader = Reader(program(DIALECTS[name], plan, []))
    points, slowest = 1e3 * plan.path.points, np.rint(6e4 * plan.feed).min()
    top = points[:, 2].max()
    climb, cross, sink = np.array([m[:4] for m in reader.before], dtype=float)
    assert np.all(np.isnan(climb[:2])) and climb[2] == pytest.approx(top)
    np.testing.assert_allclose(cross[:3], [*points[0, :2], top])
    np.testing.assert_allclose(sink[:3], points[0])
    assert {climb[3], cross[3], sink[3]} == {slowest}


@every_dialect
def test_what_cannot_be_said_is_refused(name):
    points = np.array([[0.0, 0.0, -0.1], [0.1, 0.05, -0.1], [0.1, 0.05, 0.0125]])
    refused = {
        r'0\.001 mm': little(points + np.array([0, 4e-7, 0])),
        'rounds to 0': little(points, feed=1e-6),
        'beyond': little(points + 100.0),
        'the longest is': little(points, dwell=20000.0),
    }
    for words, plan in refused.items():
        with pytest.raises(ConfigError, match=rf'^{name}: .*{words}'):
            program(DIALECTS[name], plan, [])


@every_dialect
def test_machine_stops_at_corners_and_drives_through_smooth_ones_without_a_dwell(name):
    plan = little([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], dwell=0.0)
    lines = [line for line in program(DIALECTS[name], plan, []).splitlines() if 'F15000' in line]
    lines = lines[-2:]
    if name != 'heidenhain':
        assert [bool(STOPS & set(line.split())) for line in lines] == [False, True]
    assert Reader(program(DIALECTS[name], little([[0, 0, 0], [0.1, 0, 0]]), [])).moves
