# SPDX-License-Identifier: Apache-2.0
"""Conventions and gauge in words: signs, reference points, what u and U are."""

from __future__ import annotations

from otf_core.calibration.result import GAUGE, CalibrationResult
from otf_core.prediction.absorbed import offset_words
from otf_core.reports.calibration_facts import Facts
from otf_core.reports.circumstances import measured
from otf_core.reports.quantities import dof_words, listed
from otf_core.reports.section import Section
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


def section(facts: Facts) -> Section:
    """Return the section."""
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
