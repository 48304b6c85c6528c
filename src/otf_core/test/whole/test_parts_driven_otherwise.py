# SPDX-License-Identifier: Apache-2.0
"""Parts of a machine with rotary axes that are driven otherwise than published."""

from dataclasses import replace

import numpy as np
import pytest
from rotary_cells import machine, parts, plan_of

from otf_core.calibration.calibrate import calibrate_recordings
from otf_core.config import SimulationConfig
from otf_core.model.axis_path import nominal_track
from otf_core.model.chain import displacement
from otf_core.model.evaluation import evenly_spread
from otf_core.model.observation import Samples
from otf_core.pieces.runs import Recording
from otf_core.sim.cell import simulate
from otf_core.solving.tabulate import remove_rigid_motions
from otf_core.tracking.curve_matching import match
from otf_core.tracking.curves import Lines

PUBLISHED = [part.of(machine()) for part in parts()]
TOOL, LONG, FIRST, SECOND, THIRD = PUBLISHED


def other(part, *pieces):
    """A part driven along other corners."""
    return replace(part, positions=np.concatenate([part.positions[own] for own in pieces]))


def backward(part):
    return other(part, slice(None, None, -1))


def driven(paths, rate=20.0):
    return simulate(machine(), plan_of(paths), SimulationConfig(seed=5, rate=rate))


PROGRAMS = {
    'one part backward': ([TOOL, LONG, backward(FIRST)], 1.0),
    'all backward': ([backward(FIRST), backward(LONG), backward(TOOL)], 1.0),
    'parts exchanged': ([FIRST, TOOL, LONG], 1.0),
    'a part twice': ([TOOL, TOOL, LONG, FIRST], 1.0),
    'restarted from an earlier corner': (
        [TOOL, LONG, other(FIRST, slice(0, 9), slice(3, None))],
        1.0,
    ),
    'a leg left out': ([TOOL, LONG, other(FIRST, slice(0, 6), slice(7, None))], 0.95),
}


@pytest.mark.parametrize('name', PROGRAMS)
def test_every_sample_is_where_the_axes_were(name):
    program, coverage = PROGRAMS[name]
    run, published = driven(program), PUBLISHED[:3]
    found = match(run.samples, machine(), published)
    assert found.coverage == pytest.approx(coverage, abs=0.05)
    assert max(part.distance for part in found.parts) < 5e-5
    on = found.leg >= 0
    assert on.mean() > 0.9
    lines, leg = Lines.of(found.shape), found.leg[on].astype(np.int64)
    points = found.T_machine_tracker.apply(run.samples.xyz[on])
    along = np.clip(lines.along(points, leg), 0.0, lines.length[leg])
    away = np.linalg.norm(points - lines.at(along, leg), axis=1)
    assert np.median(away) < 5e-5 and away.max() < 2e-3
    moved = np.diff(leg)[np.diff(run.samples.stamp_ns[on]) < 1e9]
    assert np.mean(moved >= 0) > 0.99  # the driven path is in order of time
    assert np.abs(found.places['nest-1'] - run.places['nest-1']).max() < 2e-4


def test_tables_are_as_good_as_those_of_the_run_driven_as_planned():
    m = machine()
    program = [
        backward(LONG),
        TOOL,
        other(FIRST, slice(0, 9), slice(3, None)),
        other(SECOND, slice(0, 6), slice(7, None)),
        THIRD,
    ]
    shares = {}
    for name, paths in (('planned', PUBLISHED), ('otherwise', program)):
        run = driven(paths, rate=30.0)
        keep = np.ones(len(run.samples), dtype=bool)
        if name == 'otherwise':  # the beam is lost for some seconds
            middle = len(keep) // 2
            keep[middle : middle + 200] = False
        samples = Samples(run.samples.stamp_ns[keep], run.samples.xyz[keep])
        path = nominal_track(m, PUBLISHED)
        recording = Recording(samples, path, m, name)
        result = calibrate_recordings([recording])
        assert not result.failed_gates
        odd = any('not driven as planned' in w for w in result.warnings)
        assert odd == (name == 'otherwise')
        q = evenly_spread(m.lower, m.upper, 400)
        error = displacement(run.truth, q)
        left = displacement(result.tables, q) - error
        rms = [
            np.sqrt(np.mean(remove_rigid_motions(m, q, v.reshape(-1, 1)) ** 2))
            for v in (left, error)
        ]
        shares[name] = rms[0] / rms[1]
    assert shares['planned'] < 0.1
    assert shares['otherwise'] < 1.5 * shares['planned']
