# SPDX-License-Identifier: Apache-2.0
"""Results of machines with rotary axes side by side: compare, history, fleet."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from test_rotary_exports import five_axes

from otf_core.comparison.compare import compare, load_sources
from otf_core.errors import ConfigError
from otf_core.model.chain import displacement, rotations
from otf_core.model.evaluation import without_rigid_motion
from otf_core.model.tables import MotionTable
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.sim.cell import random_tables

GAUGE = {'gauge': 'one gauge'}
U = 2e-6


@pytest.fixture(scope='module')
def tables():
    """Tables with an uncertainty, those of EBA not seen."""
    found = random_tables(five_axes(), 5e-5, np.random.default_rng(4))
    motions = {m: replace(t, u=np.full(len(t.value), U)) for m, t in found.motions.items()}
    hidden = motions['EBA']
    motions['EBA'] = replace(hidden, value=0.0 * hidden.value, identifiable=False)
    location = {n: replace(v, u=U) for n, v in found.location.items()}
    return replace(found, motions=motions, location=location)


def written(folder, name, tables, **extra):
    file = folder / f'{name}.json'
    file.write_text(json.dumps(tables_to_dict(tables) | GAUGE | extra))
    return file


def changed(tables, ecc=0.0, x0c=0.0):
    table = tables.motions['ECC']
    motions = {**tables.motions, 'ECC': replace(table, value=table.value + ecc * table.position)}
    own = tables.location['X0C']
    location = {**tables.location, 'X0C': replace(own, value=own.value + x0c)}
    return replace(tables, motions=motions, location=location)


def compared(a, b):
    return compare(*load_sources([a, b])[0])


def test_any_gauge_and_range_are_brought_to_one(tables, tmp_path):
    """Constants of motions and lengths of ranges say nothing of the machine."""
    a, motions = written(tmp_path, 'a', tables), dict(tables.motions)
    for k, m in enumerate(('EXX', 'EBZ', 'EXC', 'EAC', 'ECA')):
        motions[m] = replace(motions[m], value=motions[m].value + 1e-5 * (k + 1))
    same = replace(tables, motions=motions)
    found = compared(a, written(tmp_path, 'other', same, gauge='another gauge'))
    own = found.common.motions
    assert max(np.abs(found.errors[m].difference).max() for m in own) < 1e-15
    assert found.common.not_compared == {'EBA': 'a does not determine it'}
    assert {'X0C', 'A0C', 'C0Y'} <= set(found.common.scalars)
    q, volume = found.common.grid, found.volume
    field = displacement(same, q) - displacement(tables, q)
    np.testing.assert_allclose(
        volume.difference, without_rigid_motion(field, volume.position), atol=1e-11
    )
    short = {
        m: t if m.axis != 'C' else MotionTable(t.position[2:], t.value[2:], t.u[2:])
        for m, t in tables.motions.items()
    }
    narrow = compared(a, written(tmp_path, 'narrow', replace(tables, motions=short)))
    low = tables.motions['EXC'].position[2]
    assert narrow.errors['EXC'].position[0] == pytest.approx(low)
    assert max(np.abs(p.difference).max() for p in narrow.errors.values()) < 1e-12


def test_a_shifted_line_is_a_location_error_whichever_table_holds_it(tables, tmp_path):
    """D (x) moves as X0C of D does, or as the motions of C that its displacement makes."""
    machine, size = tables.machine, 2e-5
    motions = dict(tables.motions)
    q = motions['EXC'].position
    turn = rotations(-q, np.array(machine.axes['C'].direction))  # C carries the table
    moved = -(np.eye(3) - turn)[:, :, 0] * size
    for k, m in enumerate(('EXC', 'EYC', 'EZC')):
        motions[m] = replace(motions[m], value=motions[m].value + moved[:, k])
    found = compared(
        written(tmp_path, 'a', changed(tables, x0c=size)),
        written(tmp_path, 'b', replace(tables, motions=motions)),
    )
    assert max(np.abs(p.difference).max() for p in found.errors.values()) < 1e-11


def test_a_direct_measurement_of_an_axis_that_turns(tables, tmp_path):
    machine, table = tables.machine, tables.motions['ECC']
    q, rows = np.degrees(table.position), []
    for number, sense in itertools.product((1, 2), (1, -1)):
        way = 'forward' if sense > 0 else 'backward'
        rows += [
            f'C,{number},{way},{p!r},{1e6 * v!r}'
            for p, v in list(zip(q.tolist(), table.value.tolist(), strict=True))[::sense]
        ]
    file = tmp_path / 'direct.csv'
    file.write_text('\n'.join(['axis,run,direction,position_deg,EC_urad', *rows]) + '\n')
    sources, _ = load_sources([file, written(tmp_path, 'a', tables)])
    found = compare(*sources)
    assert found.common.motions == ('ECC',) and not found.common.scalars
    assert np.abs(found.errors['ECC'].difference).max() < 1e-12
    file.write_text(file.read_text().replace('position_deg', 'position_mm'))
    with pytest.raises(ConfigError, match='column position_deg'):
        load_sources([file], machine)


def test_other_nominal_lines_are_refused(tables, tmp_path):
    machine = tables.machine
    moved = replace(machine.axes['C'], centre=(0.0, 0.0, 0.5))
    other = replace(tables, machine=replace(machine, axes={**machine.axes, 'C': moved}))
    with pytest.raises(ConfigError, match='direction or centre of C'):
        compared(written(tmp_path, 'a', tables), written(tmp_path, 'b', other))
