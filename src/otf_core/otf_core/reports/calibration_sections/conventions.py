# SPDX-License-Identifier: Apache-2.0
"""What the numbers mean and where they come from: effects, conventions, versions."""

from __future__ import annotations

import platform
from dataclasses import asdict

import numpy as np
import scipy

from otf_core.calibration.result import GAUGE, CalibrationResult
from otf_core.effects.stated_effect import FOUND, effects_to_list, format_effects
from otf_core.prediction.absorbed import offset_words
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.condition_tables import measured
from otf_core.reports.section import Section, Table
from otf_core.reports.wording import dof_words, listed
from otf_core.version import __version__

CONVENTION = (
    'error = actual minus nominal, of the target relative to the table, in machine '
    'coordinates; u standard uncertainty (k = 1), U expanded uncertainty (k = 2, about 95 %)'
)
FILES = (
    'files: position in m; value, u and U in m for EX, EY, EZ, in rad for EA, EB, EC and '
    'squareness'
)
PLACE_OF_B = (
    'place of b in the chain as stated, not verifiable: it decides what is called squareness, '
    'straightness and positioning, and no data show it'
)


def effects_section(facts: Facts) -> Section | None:
    """What was found and done about effects; None where nobody asked for them."""
    stated, sentence = facts.result.effects, facts.result.effects_sentence
    said = (sentence,) if sentence else ()
    if not stated:
        return Section('effects', 'Effects', said, text=(*said, '')) if said else None
    rows = []
    for one in stated:
        how = 'found by a diagnosis' if one.how == FOUND else 'named in a file'
        for name, value in one.parameters.items():
            u = one.u.get(name)
            known = 'as given' if u is None else f'{u:.3g}'
            unit = one.units.get(name, '')
            rows.append((one.effect.replace('_', ' '), how, name, f'{value:.5g}', known, unit))
    words = (
        *said,
        'These effects were taken off the runs first, so the tables do not hold them. Without '
        'them the tables are in the folder plain beside this report.',
    )
    head = ('Effect', 'How', 'Parameter', 'Value', 'u, k = 1', 'Unit (SI)')
    table = Table(head, tuple(rows), numbers=(3, 4))
    data = {'effects': effects_to_list(stated)}
    return Section('effects', 'Effects taken off', words, data, (table,),
                   (*said, format_effects(stated), ''))  # fmt: skip


def reference_words(result: CalibrationResult) -> str:
    """Which point the values are those of, for one target offset or several."""
    offsets = list(dict.fromkeys(offset_words(run.target_offset) for run in result.runs))
    where = (
        f'the target was at the offset {offsets[0]} from it'
        if len(offsets) == 1
        else f'the targets were at the offsets {listed(offsets)} from it'
    )
    bound = result.offset_bound.sentence
    holds = (
        f'{bound[:1].upper()}{bound[1:]}; all other values hold at any target offset'
        if bound
        else 'All values that were determined hold at any target offset'
    )
    return (
        f'Reference point of straightness, positioning and squareness, about which rotations act, '
        f'is the machine zero that the axes carry along; {where} (all axes at zero). {holds}.'
    )


def conventions_section(facts: Facts) -> Section:
    """Conventions and gauge in words: signs, reference points, what u and U are."""
    machine, origin = facts.machine, facts.result.origin
    carried = {
        'table': ', '.join(machine.chain.table_side) or 'none',
        'target': ', '.join(machine.chain.target_side) or 'none',
    }
    k, dof = facts.result.headline.k, facts.by_name['grid'].dof
    words = (
        'Names are those of ISO 230-1: E, the direction of the error, the axis that moves; EXX is '
        'the positioning error of X, EYX its straightness in Y, EAX its rotation about X.',
        'Sign: an error is actual minus nominal position of the target relative to the table, in '
        'the right-handed machine frame; rotations are right-handed. A correction has the '
        'opposite sign.',
        f'Kinematic chain {machine.chain}, from workpiece to tool: axes that carry the table: '
        f'{carried["table"]}; axes that carry the target: {carried["target"]}. '
        f'{PLACE_OF_B[:1].upper()}{PLACE_OF_B[1:]}.',
        reference_words(facts.result),
        f'Gauge: {GAUGE}. At these reference positions U is zero by definition: U is that of a '
        f'difference to the reference.',
        'The volumetric error is stated without the best-fitting rigid motion of the whole '
        'volume, which belongs to the choice of the machine frame.',
        'Results hold at the temperature of the measurement; they are not reduced to 20 °C.',
        f'U is the expanded uncertainty for a coverage of about 95 %, U = k u by JCGM 100 (GUM); '
        f'k = {k:.3g} (effective degrees of freedom {dof_words(dof)}; with 60 or fewer k is '
        f"Student's t); bands are pointwise. "
        f'The full covariance stands in error_tables.json (JCGM 102).',
    )
    date = f'measured {measured(origin)}, ' if measured(origin) else ''
    text = (
        CONVENTION,
        FILES,
        reference_words(facts.result),
        f'{PLACE_OF_B}.',
        f'{date}calibrated by otf_core {__version__}',
        '',
    )
    return Section('conventions', 'Conventions and gauge', words, {'gauge': GAUGE}, text=text)


def provenance_section(facts: Facts) -> Section:
    """Versions, hashes, configuration, and how to repeat it."""
    result, about = facts.result, facts.provenance
    rows = [
        ('run id', result.run_id),
        ('written', str(about['written'])),
        ('software', f'otf_core {about["software"]["version"]}, numpy {np.__version__}, scipy '
         f'{scipy.__version__}, Python {platform.python_version()}'),
        ('command', f'{about["verb"]}, method {about["method"]}'),
    ]  # fmt: skip
    rows += [(f'SHA-256 of run {r["name"]}', r['sha256']) for r in about.get('runs', [])]
    rows += [
        (f'SHA-256 of machine.yaml, {m["name"]}', m['sha256'] or 'not read from a file')
        for m in about.get('machines', [])
    ]
    settings = tuple((name, f'{value}') for name, value in asdict(result.config).items())
    words = ['How to repeat it: ' + repeat_command(facts)]
    tables = (
        Table(('', ''), tuple(rows), title='Provenance'),
        Table(('Parameter', 'Value (SI)'), settings, folded='Parameters of the method'),
    )
    return Section('provenance', 'Versions and how to repeat it', tuple(words),
                   {'run_id': result.run_id, 'provenance': dict(about)}, tables)  # fmt: skip


def repeat_command(facts: Facts) -> str:
    """The command that gives the same tables from the same recordings."""
    bags = ' '.join(o.name or 'BAG' for o in facts.result.origin) or 'BAG'
    config = facts.result.config
    given = [
        f'--{name.replace("_", "-")} {value}'
        for name, value in asdict(config).items()
        if value != getattr(type(config)(), name)
    ]
    method = facts.provenance['method']
    options = ' '.join([f'--method {method}', *given])
    return (
        f'./otf calibrate {bags} --machine machine.yaml --out DIR {options}; the same bags, '
        f'machine.yaml and version give the same tables and the same run id.'
    )
