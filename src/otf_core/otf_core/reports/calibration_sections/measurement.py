# SPDX-License-Identifier: Apache-2.0
"""The measurement: conditions, residuals, samples, drift, fit; and what the numbers mean."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import scipy
from scipy.special import gammaincc

from otf_core.arrays import Array
from otf_core.budget.budget import NOISE
from otf_core.calibration.calibration_result import CalibrationResult, RunResult
from otf_core.calibration.document import gauge_of
from otf_core.effects.stated_effect import FOUND
from otf_core.model.frames import XYZ
from otf_core.model.path import leg_bounds
from otf_core.model.provenance import moment
from otf_core.prediction.absorbed import offset_words
from otf_core.reports.calibration_facts import (
    CalibrationFacts,
    run_table,
    stated_tables,
)
from otf_core.reports.calibration_sections.first_screen import trackers
from otf_core.reports.drawing.panel import (
    LEVELS,
    Panel,
    Scale,
    heat_classes,
    heat_key,
    heat_step,
    scale_around,
)
from otf_core.reports.drawing.scene import TURNED, Dots, Item, Strokes, box, scene
from otf_core.reports.page import (
    Picture,
    Section,
    Table,
    dof_words,
    join_names,
    micro,
    whole_dof,
)

DRAWN_RUNS = 3
"""Runs that are drawn."""
DRAWN_STRETCHES = 900
"""Parts of a path that are drawn in space."""
NO_DATE = 'the stamps contain no date: they count from another origin'
DRIFT_PARTS, LEGS_PER_PART = 8, 6
"""Parts of a run; legs of a part from which it is used."""
INFORMATION_SHARE = 1e-3
"""Smallest share of the information of a direction that has to be there."""


def conditions_section(facts: CalibrationFacts) -> Section:
    """Conditions and instrument: what was driven, when, with what, and what nobody stated."""
    result, given = facts.result, facts.machine.stated
    tables, words = stated_tables(facts.machine)
    tables += [run_table(n, run) for n, run in enumerate(result.runs, start=1)]
    data = {'instrument': dict(given.instrument), 'conditions': dict(given.conditions)}
    return Section('conditions', 'Conditions and instrument', words, data, tuple(tables))


def path_section(facts: CalibrationFacts) -> Section:
    """The path with what the tables leave: in space and over time."""
    fit = facts.result.fit
    words = (
        f'Mean distance of the measured track from the path: {micro(fit.path_mae_before)} um '
        f'after aligning it, {micro(fit.path_mae_after)} um after compensation; root mean '
        f'square residual {micro(fit.residual_rms)} um. These are the data the tables were '
        f'fitted to.',
    )
    data = {'mae_before': fit.path_mae_before, 'mae_after': fit.path_mae_after,
            'residual_rms': fit.residual_rms}  # fmt: skip
    return Section('path', 'Path and residuals', words, data,
                   draw=lambda: _path_pictures(facts))  # fmt: skip


def _path_pictures(facts: CalibrationFacts) -> Sequence[Picture]:
    runs = facts.result.runs
    pictures = []
    for number, run in enumerate(runs[:DRAWN_RUNS], start=1):
        name = f'Run {number}. ' if len(runs) > 1 else ''
        space = Picture(
            (_path_in_space(facts, run),),
            f'{name}Path coloured by the length of the residual across it, after compensation.',
            hint=TURNED,
            title='In space' if number == 1 else '',
        )
        time = Picture(
            _residual_over_time(run),
            f'{name}One dot per leg of the path: root mean square distance from the path, aligned '
            f'(left) and compensated (right).',
            columns=2,
            title='Over time' if number == 1 else '',
        )
        pictures += [space, time]
    if len(runs) > DRAWN_RUNS:
        pictures.append(Picture((), f'{len(runs) - DRAWN_RUNS} further runs are not drawn.'))
    return pictures


def _path_in_space(facts: CalibrationFacts, run: RunResult) -> str:
    low, high = facts.box
    length = 1e6 * np.linalg.norm(run.residual, axis=0)
    seen = run.T_machine_tracker.apply(run.pieces.xyz)
    low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    items: list[Item] = [*box(low, high), *trackers(facts)]
    if run.pieces.standstill:
        size, points, ends = length, seen, None
    else:
        size, ends = _stretches(run, seen, length)
        points = ends[:, 0]
    step = heat_step(size)
    classes = heat_classes(size, step)
    for level in range(LEVELS):
        own = classes == level
        if own.any():
            kind = f'heat h{level}'
            items.append(Dots(kind, points[own]) if ends is None else Strokes(kind, ends[own]))
    key = heat_key(step, float(size.max()), 'µm')
    return scene(items, low, high, 'path in space, coloured by the residual') + key


def _stretches(run: RunResult, seen: Array, length: Array) -> tuple[Array, Array]:
    """Root mean square residual and ends, (n, 2, 3), of parts of legs."""
    bounds = leg_bounds(run.pieces.leg)
    share = max(1, round(len(length) / DRAWN_STRETCHES))
    sizes, ends = [], []
    for a, b in bounds:
        cuts = np.linspace(a, b, max(1, (b - a) // share) + 1).astype(int)
        for c, d in pairwise(cuts):
            sizes.append(np.sqrt(np.mean(length[c:d] ** 2)))
            ends.append((seen[c], seen[min(d, b - 1)]))
    return np.array(sizes), np.array(ends)


def _residual_over_time(run: RunResult) -> tuple[str, ...]:
    bounds = leg_bounds(run.pieces.leg)
    middle = np.array([run.pieces.time[a:b].mean() for a, b in bounds])
    along = Scale(0.0, max(float(run.pieces.time.max()), 1e-3), 'time since the first sample (s)')
    panels = []
    for values, kind, what in (
        (run.aligned, 'before', 'before compensation'),
        (run.residual, 'after', 'after compensation'),
    ):
        square = np.sum(values**2, axis=0)
        rms = 1e6 * np.sqrt([square[a:b].mean() for a, b in bounds])
        panel = Panel(along, scale_around(rms, 'rms of a leg (µm)', zero=True))
        panels.append(panel.draw([panel.dots(middle, rms, kind)], f'residual {what}', what))
    return tuple(panels)


def data_quality_section(facts: CalibrationFacts) -> Section:
    """What became of the samples: gaps, outliers, excluded, repeated, clock."""
    rows, data = [], []
    for number, run in enumerate(facts.result.runs, start=1):
        pieces, lost = run.pieces, run.lost
        rest = run.samples - pieces.used - pieces.outliers
        rows.append(
            (
                f'{number} {run.name}'.strip(),
                str(run.samples),
                str(pieces.used),
                str(pieces.outliers),
                str(rest),
                str(lost.samples),
                str(lost.gaps),
                f'{lost.longest:.3f}',
                f'{run.rate:.1f}',
            )
        )
        sizes = {'lost': lost.samples, 'gaps': lost.gaps, 'longest_gap': lost.longest}
        data.append({'run': run.name, 'samples': run.samples, 'used': pieces.used,
                     'outliers': pieces.outliers, 'excluded': rest, 'rate': run.rate,
                     **sizes})  # fmt: skip
    head = ('Run', 'Samples', 'Used', 'Outliers', 'Excluded', 'Missing by the stamps', 'Gaps',
            'Longest (s)', 'Rate (Hz)')  # fmt: skip
    clocks = tuple(
        f'Clock of {o.name or "the run"}: '
        + (f'{moment(o.first_ns)} to {moment(o.last_ns)}' if moment(o.first_ns) else NO_DATE)
        + f', {(o.last_ns - o.first_ns) * 1e-9:.3f} s.'
        for o in facts.result.origin
    )
    words = (
        'Excluded: at standstill, near corners and off the path. Repeated samples and those '
        'without a beam are dropped while a recording is read, before they are counted here.',
        *_reading_remarks(facts),
        *clocks,
    )
    table = Table(head, tuple(rows), numbers=tuple(range(1, 9)))
    return Section('data', 'Data quality', words, {'runs': data}, (table,))


def _reading_remarks(facts: CalibrationFacts) -> tuple[str, ...]:
    """What was repaired or left out while recordings were read."""
    lines = [f'While reading {run.name or "the run"}: {remark}.'
            for run in facts.result.runs for remark in run.remarks]  # fmt: skip
    return tuple(lines) or ('Nothing was repaired or left out while reading.',)


def drift(run: RunResult) -> tuple[Array, Array, Array]:
    """Time (n,), s, mean displacement and its standard uncertainty (n, 3), m, by part of a run.

    In parts of the run, equal in time, the mean displacement d of all residuals r = a . d across
    the path is estimated by least squares; legs are the independent units of its uncertainty.
    """
    bounds, pieces = leg_bounds(run.pieces.leg), run.pieces
    gram = np.array([np.einsum('cpi,cpj->ij', *[run.axes[:, a:b]] * 2) for a, b in bounds])
    right = np.array(
        [np.einsum('cpi,cp->i', run.axes[:, a:b], run.residual[:, a:b]) for a, b in bounds]
    )
    middle = np.array([pieces.time[a:b].mean() for a, b in bounds])
    edges = np.linspace(0.0, float(pieces.time.max()) + 1e-9, DRIFT_PARTS + 1)
    changes = []
    for low, high in pairwise(edges):
        own = (middle >= low) & (middle < high)
        total = gram[own].sum(axis=0)
        strength = np.linalg.eigvalsh(total)
        if own.sum() < LEGS_PER_PART or strength[0] <= INFORMATION_SHARE * strength[-1]:
            continue
        value = np.linalg.solve(total, right[own].sum(axis=0))
        rest = right[own] - gram[own] @ value
        cover = np.linalg.inv(total)
        cover = cover @ (rest.T @ rest) @ cover * own.sum() / (own.sum() - 1)
        changes.append((float(middle[own].mean()), value, np.sqrt(np.diag(cover))))
    if not changes:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
    time, value, u = (np.array(part) for part in zip(*changes, strict=True))
    return time, value, u


def drift_section(facts: CalibrationFacts) -> Section:
    """Drift between start and end of a run, as the residuals show it."""
    rows: list[tuple[str, ...]] = []
    data, directions = [], []
    for number, run in enumerate(facts.result.runs, start=1):
        time, value, u = drift(run)
        name = f'{number} {run.name}'.strip()
        if len(time) < 2:
            rows.append((name, 'too few legs', '', '', ''))
            continue
        change, wide = value[-1] - value[0], 2.0 * np.hypot(u[-1], u[0])
        parts = [f'{1e6 * c:.2f} +/- {1e6 * w:.2f}' for c, w in zip(change, wide, strict=True)]
        rows.append((name, *parts, f'{time[-1] - time[0]:.0f}'))
        directions += [f'{a} in run {name}' for a, c, w in zip(XYZ, change, wide, strict=True)
                  if abs(c) > w]  # fmt: skip
        data.append({'run': run.name, 'change': change.tolist(), 'U': wide.tolist(),
                     'time': float(time[-1] - time[0])})  # fmt: skip
    verdict = (
        f'Larger than U: along {join_names(directions)}.' if directions else 'No drift beyond U.'
    )
    words = (
        verdict,
        _moved_words(facts),
        'Change of the mean residual from the first to the last part of the run (closure of start '
        'and end), with U (k = 2). It also contains model errors at the places driven then; a '
        'steady drift shows as a slope in the figure.',
    )
    head = ('Run', 'Along X (um)', 'Along Y (um)', 'Along Z (um)', 'Over (s)')
    table = Table(head, tuple(rows), numbers=(1, 2, 3, 4))
    return Section('drift', 'Drift between start and end', words, {'runs': data}, (table,),
                   draw=lambda: _drift_pictures(facts.result.runs))  # fmt: skip


def _moved_words(facts: CalibrationFacts) -> str:
    """Whether tracker or target moved against the machine in mid-run."""
    result = facts.result
    lines = [w for w in (*result.warnings, *result.failed_gates) if w.startswith('moved: ')]
    return ' '.join(f'{w[:1].upper()}{w[1:]}.' for w in lines) or (
        'No movement: no step of tracker or target was found during a run. Steps below about 5 '
        'um, or at the very start or end, would not be detected.'
    )


def _drift_pictures(runs: Sequence[RunResult]) -> Sequence[Picture]:
    time, value, u = drift(runs[0])
    if len(time) < 2:
        return ()
    along = Scale(0.0, float(runs[0].pieces.time.max()), 'time since the first sample (s)')
    parts = []
    for k, axis in enumerate(XYZ):
        y, wide = 1e6 * value[:, k], 2e6 * u[:, k]
        scale = scale_around(np.concatenate([y - wide, y + wide, [0.0]]), 'mean residual (µm)')
        panel = Panel(along, scale)
        kind = axis.lower()
        marks = [panel.level(0.0, 'soft'), panel.ranges(time, y - wide, y + wide, f'{kind} thin'),
                 panel.line(time, y, kind), panel.dots(time, y, kind)]  # fmt: skip
        parts.append(panel.draw(marks, f'drift along {axis}', f'along {axis}'))
    return [Picture(tuple(parts), 'Mean residual by part of the first run; strokes: U (k = 2).',
                    columns=3)]  # fmt: skip


def fit_section(facts: CalibrationFacts) -> Section:
    """Size and quality of the fit."""
    fit, result = facts.result.fit, facts.result
    budget = result.budget
    dof = dict(zip(budget.names, budget.freedoms.tolist(), strict=True))[NOISE]
    chance = float(gammaincc(0.5 * dof, 0.5 * dof * fit.variance_ratio))
    two, three = component_rms(facts)
    condition = facts.condition_number
    times = [c.correlation_time for run in result.runs for c in run.noise]
    rows = (
        ('samples', f'{fit.samples}'),
        ('samples used', f'{fit.used}, in {fit.pieces} path pieces'),
        ('outliers', f'{fit.outliers} ({100 * fit.outliers / fit.samples:.2f} %)'),
        ('effective degrees of freedom of the noise level (N_eff - rank)', dof_words(dof)),
        ('unknowns after fixing the gauge', f'{fit.unknowns}'),
        ('rank', f'{fit.rank}'),
        ('condition number of the covariance (scaled)', f'{condition:.3g}'),
        (
            's0, ratio of the residuals to the assumed noise',
            f'{math.sqrt(fit.variance_ratio):.3f}',
        ),
        ('chi-square p (probability of larger residuals from noise alone)', f'{chance:.3f}'),
        ('factor on the covariance for the remaining misfit', f'{fit.inflation:.3f}'),
        ('residual rms', f'{micro(fit.residual_rms)} um'),
        ('residual rms in the plane of the beam (a2), across it (a3)', f'{two} um, {three} um'),
        ('correlation time of the noise', _time_range(times)),
        ('iterations', f'{fit.iterations}'),
    )
    data = {
        'samples': fit.samples, 'used': fit.used, 'outliers': fit.outliers, 'pieces': fit.pieces,
        'unknowns': fit.unknowns, 'rank': fit.rank, 'condition': condition,
        's0': math.sqrt(fit.variance_ratio), 'chi_square_p': chance, 'dof': whole_dof(dof),
        'residual_rms': fit.residual_rms,
    }  # fmt: skip
    return Section('fit', 'Fit', (), data, (Table(('', ''), rows),))


def component_rms(facts: CalibrationFacts) -> tuple[str, str]:
    """Root mean square residual of the first two directions across the path, um."""
    rows = np.concatenate([run.residual for run in facts.result.runs], axis=1)
    a, b = (float(np.sqrt(np.mean(row**2))) for row in rows[:2])
    return micro(a), micro(b)


def _time_range(times: list[float]) -> str:
    low, high = (f'{value:.2f}' for value in (min(times), max(times)))
    return f'{low} s' if low == high else f'{low} to {high} s'


# What the numbers mean and where they come from: effects, conventions, versions.

PLACE_OF_B = (
    'position of b in the chain as stated: it defines what is called squareness, straightness '
    'and positioning, and no data can verify it'
)


def effects_section(facts: CalibrationFacts) -> Section | None:
    """What was found and done about effects; None where nobody asked for them."""
    stated, sentence = facts.result.effects, facts.result.effects_sentence
    introduction = (sentence,) if sentence else ()
    if not stated:
        return Section('effects', 'Effects', introduction) if introduction else None
    rows = []
    for one in stated:
        how = 'found by a diagnosis' if one.how == FOUND else 'named in a file'
        for name, value in one.parameters.items():
            u = one.u.get(name)
            known = 'as given' if u is None else f'{u:.3g}'
            unit = one.units.get(name, '')
            rows.append((one.effect.replace('_', ' '), how, name, f'{value:.5g}', known, unit))
    words = (
        *introduction,
        'These effects were removed from the runs first, so the tables do not contain them. The '
        'tables without this correction are in the folder plain beside this report.',
    )
    head = ('Effect', 'How', 'Parameter', 'Value', 'u, k = 1', 'Unit (SI)')
    table = Table(head, tuple(rows), numbers=(3, 4))
    data = {'effects': [one.to_dict() for one in stated]}
    return Section('effects', 'Effects taken off', words, data, (table,))


def reference_words(result: CalibrationResult) -> str:
    """Which point the values are those of, for one target offset or several."""
    offsets = list(dict.fromkeys(offset_words(run.target_offset) for run in result.runs))
    where = (
        f'the target was at the offset {offsets[0]} from it'
        if len(offsets) == 1
        else f'the targets were at the offsets {join_names(offsets)} from it'
    )
    bound = result.offset_bound.sentence
    holds = (
        f'{bound[:1].upper()}{bound[1:]}; all other values apply to any target offset'
        if bound
        else 'All values that were determined apply to any target offset'
    )
    turns = (
        '; motions of a rotary axis act about its centre, as machine.yaml states it'
        if result.tables.location
        else ''
    )
    return (
        f'The reference point of straightness, positioning and squareness, about which '
        f'rotations act, is the machine zero carried along by the axes'
        f'{turns}; {where} (all axes at zero). {holds}.'
    )


def conventions_section(facts: CalibrationFacts) -> Section:
    """Conventions and gauge in words: signs, reference points, what u and U are."""
    machine, gauge = facts.machine, gauge_of(facts.machine)
    table, target = (
        ', '.join(side) or 'none' for side in (machine.chain.table_side, machine.chain.target_side)
    )
    k, dof = facts.result.headline.k, facts.by_name['grid'].dof
    words = (
        'Names are those of ISO 230-1 and ISO 230-7: E, the direction of the error, the axis that '
        'moves; EXX is the positioning error of X, EYX its straightness in Y, EAX its rotation '
        'about X.',
        'Sign: an error is actual minus nominal position of the target relative to the table, in '
        'the right-handed frame of the table: the machine frame, all axes at zero; rotations are '
        'right-handed. A correction has the opposite sign.',
        f'Kinematic chain {machine.chain}, from workpiece to tool: axes that carry the table: '
        f'{table}; axes that carry the target: {target}. '
        f'{PLACE_OF_B[:1].upper()}{PLACE_OF_B[1:]}.',
        reference_words(facts.result),
        f'Gauge: {gauge}. At these reference positions U is zero by definition: U is that of a '
        f'difference to the reference.',
        'The volumetric error is stated without the best-fitting rigid motion of the whole '
        'volume, which depends on the choice of the machine frame.',
        'Results apply to the temperature of the measurement; they are not corrected to 20 °C.',
        f'U is the expanded uncertainty for a coverage of about 95 %, U = k u by JCGM 100 (GUM); '
        f'k = {k:.3g} (effective degrees of freedom {dof_words(dof)}; with 60 or fewer k is '
        f"Student's t); bands are pointwise. "
        f'The full covariance is in error_tables.json (JCGM 102).',
    )
    return Section('conventions', 'Conventions and gauge', words, {'gauge': gauge})


def provenance_section(facts: CalibrationFacts) -> Section:
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


def repeat_command(facts: CalibrationFacts) -> str:
    """The command that gives the same tables from the same recordings."""
    bags = ' '.join(o.name or 'BAG' for o in facts.result.origin) or 'BAG'
    config = facts.result.config
    given = ', '.join(
        f'{name}: {value}'
        for name, value in asdict(config).items()
        if value != getattr(type(config)(), name)
    )
    method = facts.provenance['method']
    options = f'--method {method}' + (f' --config FILE with {given}' if given else '')
    return (
        f'./otf calibrate {bags} --machine machine.yaml --out DIR {options}; the same bags, '
        f'machine.yaml and version give the same tables and the same run id.'
    )
