# SPDX-License-Identifier: Apache-2.0
"""The page of a round against a control, in the order of the clauses of ISO/TR 16907:2015.

Determination of the errors (clause 7), their representation (9), application in the control (10),
validation of the compensation (11), documentation (12). What it does not hold is said: the machine
is simulated, without load and without change of temperature.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from otf_core.calibration.result import CalibrationResult
from otf_core.model.path import NominalPath
from otf_core.reports.page import Heading, page_html
from otf_core.reports.section import Section, State, Table

STANDARD = 'ISO/TR 16907:2015'
REPRESENTED = {
    'axes': (
        'a table of actual positions per axis: positioning along the middle lines of the volume',
        'LinuxCNC .comp files, COMP_FILE_TYPE 0, one per joint, read at its start',
        'actual positions: the control moves the motors by nominal minus actual',
    ),
    'volume': (
        'errors on a lattice over the volume, trilinear between its points, at the measured '
        'target offset',
        'external offsets of LinuxCNC, set about every millisecond for the present position',
        'errors (actual minus nominal): the component sets the offsets to minus their values',
    ),
    'program': (
        'errors at the ends of the parts into which the lines of the program are cut',
        'an NC program whose points are moved; nothing is set in the control',
        'errors (actual minus nominal): the points are moved by minus their values',
    ),
}
"""What represents the errors, how it is applied, and the sign, by way."""
Row = tuple[str, str]


def _facts(rows: Sequence[Row]) -> tuple[Table, ...]:
    return (Table(('', ''), tuple(rows)),)


def _determination(result: CalibrationResult, path: NominalPath) -> Section:
    machine, fit = result.tables.machine, result.fit
    ranges = ', '.join(
        f'{name} {1e3 * axis.min:g} to {1e3 * axis.max:g} mm'
        for name, axis in machine.axes.items()
    )
    offset = ', '.join(f'{1e3 * v:g}' for v in machine.target_offset)
    return Section(
        'determination',
        f'Determination of the errors ({STANDARD}, 7)',
        tables=_facts(
            (
                ('machine', f'{machine.name}, chain {machine.chain}'),
                ('ranges', ranges),
                ('target offset', f'({offset}) mm'),
                ('measured by', 'a simulated laser tracker, on the fly, with a clock of its own'),
                ('path', f'{len(path.leg_lengths)} lines, {path.length:.2f} m'),
                ('samples', f'{fit.used} of {fit.samples} used'),
                ('model', 'rigid bodies: 18 error motions and 3 squareness errors'),
                ('run', result.run_id),
            )
        ),
    )


def _compensation(way: str, files: Iterable[str]) -> tuple[Section, Section]:
    represented, applied, sign = REPRESENTED[way]
    return (
        Section(
            'representation',
            f'Representation for the compensation ({STANDARD}, 9)',
            tables=_facts((('represented as', represented), ('sign', sign))),
        ),
        Section(
            'application',
            f'Application in the control ({STANDARD}, 10)',
            tables=_facts(
                (
                    ('control', 'LinuxCNC, servo period 1 ms'),
                    ('applied as', applied),
                    ('files (control/)', ', '.join(sorted(files))),
                )
            ),
        ),
    )


def _validation(data: Mapping[str, Any]) -> Section:
    rows = [
        (
            f'{number}',
            *(', '.join(f'{1e3 * v:.1f}' for v in line[end]) for end in ('start', 'end')),
            *(f'{line[when]["mean_um"]:.2f}' for when in ('before', 'after')),
            *(f'{line[when]["largest_um"]:.2f}' for when in ('before', 'after')),
        )
        for number, line in enumerate(data['lines'], start=1)
    ]
    head = ('line', 'from (mm)', 'to (mm)', 'mean before (um)', 'after', 'largest before (um)',
            'after')  # fmt: skip
    left, seen = data['left_um'], data['seen_by_tracker']
    return Section(
        'validation',
        f'Validation of the compensation ({STANDARD}, 11)',
        (
            f'{len(rows)} lines drawn anew through the volume, none of them one that was fitted, '
            f'were driven without and with the compensation. The volumetric error is the length '
            f'of actual minus nominal position of the target, once a millimetre, best rigid '
            f'motion taken out; true, since the machine is simulated.',
            f'Mean {data["before_um"]:.2f} um before, {data["after_um"]:.2f} um after; forecast '
            f'{data["forecast_um"]:.2f} um with the standard uncertainty of the tables in it.',
            f'Of what is left the tables do not know {left["of_tables"]:.2f} um, the format '
            f'cannot hold {left["of_export"]:.2f} um, and the control does not bring '
            f'{left["of_control"]:.2f} um to the motors.',
            f'As a tracker sees it, across the lines, its noise in both: '
            f'{seen["before_um"]:.2f} um before, {seen["after_um"]:.2f} um after.',
        ),
        tables=(Table(head, tuple(rows), (3, 4, 5, 6)),),
    )


def _documentation(data: Mapping[str, Any], gates: Sequence[str]) -> Section:
    block = data['provenance']
    software = f'{block["software"]["name"]} {block["software"]["version"]}'
    return Section(
        'documentation',
        f'Documentation ({STANDARD}, 12)',
        tables=_facts(
            (
                ('written', str(block['written'])),
                ('software', software),
                ('convention', str(block['convention'])),
                ('uncertainty', str(block['coverage'])),
                ('conditions', 'no load, no change of temperature: the machine is simulated'),
                ('quality gates', '; '.join(gates) or 'all passed'),
                ('beside this page', 'loop.json, calibration/, bags/, control/'),
            )
        ),
    )


def loop_page(
    data: Mapping[str, Any],
    result: CalibrationResult,
    path: NominalPath,
    files: Iterable[str],
    gates: Sequence[str],
) -> str:
    """Return the page: self-contained HTML.

    Parameters
    ----------
    data : mapping
        loop.json.
    result : CalibrationResult
    path : NominalPath
        That was fitted.
    files : iterable of str
        Names of what the control was given.
    gates : sequence of str
        Quality gates that failed.
    """
    way, fall = str(data['compensate']), f'{data["fall_percent"]:.1f} % less'
    tiles = (
        ('before', f'{data["before_um"]:.2f} um', 'mean volumetric error'),
        ('after', f'{data["after_um"]:.2f} um', fall),
        ('forecast', f'{data["forecast_um"]:.2f} um', 'of the export, u of the tables in it'),
    )
    heading = Heading(
        f'Compensation of {result.tables.machine.name} by {way}',
        '; '.join(gates)
        or 'Volumetric error on lines that were not fitted, before and after the compensation.',
        (State('quality gate failed', 'bad') if gates else State(fall, 'good'),),
        tiles,
    )
    sections = [Section('loop', ''), _determination(result, path), *_compensation(way, files)]
    return page_html(heading, [*sections, _validation(data), _documentation(data, gates)])
