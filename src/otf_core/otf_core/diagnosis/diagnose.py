# SPDX-License-Identifier: Apache-2.0
"""Where and why a real run departs from its simulation.

The calibration that the user gets, without reversal, which is a cause like any other; what it
leaves of noise alone; a search for effects that explain the rest; their size on legs they were
not fitted on; where the gap lies; the calibration with the causes taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from otf_core.arrays import Array
from otf_core.aside import Aside
from otf_core.calibration.assembly import assemble
from otf_core.calibration.calibrate import (
    ExaminedRecordings,
    SolvedRecordings,
    solve_recordings,
)
from otf_core.calibration.calibration_result import CalibrationResult
from otf_core.calibration.with_effects import calibrate_with_file
from otf_core.config import AUTO, CalibrationConfig
from otf_core.contradictions.examine import WARNING_LEFT_OUT, share_in_whole_pieces
from otf_core.diagnosis.answer import gap_of, known_words, named_causes, qualify_moves, sentence_of
from otf_core.diagnosis.cause_parameters import FittedCause, fitted_causes
from otf_core.diagnosis.corrected_calibration import (
    CausesToRemove,
    CauseWords,
    calibrate_without_causes,
    pair_with_corrected,
)
from otf_core.diagnosis.engine.diagnosed_rows import (
    held_by,
    remove_steady_vibration,
    rows_of_axes,
    rows_to_diagnose,
    straight_rows,
)
from otf_core.diagnosis.engine.gap_sizes import SIMULATED_U, chance_of_misfit, simulated_um
from otf_core.diagnosis.engine.residual_rows import Rows
from otf_core.diagnosis.engine.search import (
    SearchResult,
    Visibility,
    search_catalogue,
    spectral_lines,
)
from otf_core.diagnosis.place.groups import RunView, noise_factor
from otf_core.diagnosis.place.where import Where, where_and_shape
from otf_core.diagnosis.result import AnyCause, Diagnosis, FigureData, Gap, NamedCause
from otf_core.diagnosis.weighing import (
    Explanation,
    Unnamed,
    WeighedExplanation,
    explain,
    judge,
    run_views,
)
from otf_core.effects import EVERY, ROTARY, Effect, catalogue
from otf_core.effects.catalogue.machine import direction_dependent_tables
from otf_core.errors import ConfigError
from otf_core.live.stages import Progress, silent
from otf_core.model.chain import displacement, nominal_position
from otf_core.model.evaluation import driven_positions, mean_length, without_rigid_motion
from otf_core.pieces.finding import Finding, incomplete_path
from otf_core.pieces.runs import Recording, Run, reduce_recording
from otf_core.solving.joint import JointSolution, Start, solve_robustly
from otf_core.solving.unknowns import Basis
from otf_core.threads import limit_to_one_thread

ALL_SAMPLES = 100.0
"""Robust deviations: the largest ``outlier_limit``, beyond all but reflections."""
MOST_PIECES = 12_000
"""Pieces of all runs together beyond which they are made longer: time and memory of a diagnosis
are in proportion to their number."""
WORTH_IT = 1.2
"""Factor on the length from which it pays: longer pieces mean solving the runs again."""
PER_NODE = 3.0
"""Pieces between two table nodes at least, so that waves between nodes are seen."""


@limit_to_one_thread
def diagnose(
    recordings: Sequence[Recording],
    exclude: Sequence[str] = (),
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    own: Sequence[Effect] = (),
    *,
    same_station: bool = False,
) -> Diagnosis:
    """Diagnose runs of one machine.

    Parameters
    ----------
    recordings : sequence of Recording
        No time relation between samples and path is needed.
    exclude : sequence of str
        Effects taken out of the catalogue.
    config : CalibrationConfig, optional
        Of the calibration.
    progress : callable(stage, fraction), optional
        Called as work goes on, stage 'aligning', 'solving', 'diagnosing' or 'correcting'.
    own : sequence of Effect
        Causes of one's own, tried beside the catalogue.
    same_station : bool
        The tracker was not moved between the recordings.

    Raises
    ------
    InputError
        As ``calibrate_recordings``.
    """
    config = config or CalibrationConfig()
    progress = progress or silent
    solved = solve_recordings(recordings, config, progress, same_station=same_station)
    assembled = partial(assemble, solved.solution, config, solved.findings)
    with Aside(assembled, (solved.solution, config, solved.findings), later=True) as aside:
        if recordings[0].machine.rotary_names:
            again = partial(solve_recordings, recordings, same_station=same_station)
            searched = _search_axes(solved, again, exclude, config, progress, own)
        else:
            searched = _search(recordings, solved, exclude, config, progress, own)
        progress('diagnosing', 0.65)
        explained = explain(searched.rows, searched.found.causes, searched.simulated_um)
        progress('diagnosing', 0.7)
        weighed = _weigh(searched, explained)
        progress('diagnosing', 0.95)
        plain = aside.result()
    progress('correcting', 0.0)
    bases = searched.rows.done.unknowns.bases
    causes = _causes_to_take_off(weighed.fitted, bases, solved)
    corrected = calibrate_without_causes(solved, causes, config) if weighed.fitted else None
    return _answer(
        recordings, solved, searched.found, weighed,
        lambda sentence: pair_with_corrected(plain, corrected, causes, config, sentence),
    )  # fmt: skip


@dataclass(frozen=True)
class _WithoutReversal:
    """What is diagnosed: a solution without reversal, which is a cause like any other.

    Attributes
    ----------
    runs : list of Run
        As they were kept.
    nodes : mapping of axis to ndarray, m
        Table nodes.
    """

    runs: list[Run]
    solution: JointSolution
    nodes: dict[str, Array]

    @classmethod
    def of(cls, solved: SolvedRecordings) -> _WithoutReversal:
        """Solution without reversal of solved recordings."""
        return cls(*solved.solution.plain, solved.nodes)


def _piece_length(runs: Sequence[Run], config: CalibrationConfig) -> float:
    """Length of the pieces to diagnose, m: as of the calibration, longer where they are many."""
    pieces = sum(len(run.pieces) for run in runs)
    pitch = min(axis.table_pitch for axis in runs[0].machine.axes.values())
    longer = min(config.piece_length * pieces / MOST_PIECES, pitch / PER_NODE)
    return longer if longer > WORTH_IT * config.piece_length else config.piece_length


def _without_reversal(
    recordings: Sequence[Recording],
    solved: SolvedRecordings,
    config: CalibrationConfig,
    length: float,
) -> _WithoutReversal:
    """What is diagnosed of recordings, in pieces of a length, m.

    Where whole pieces were left out, which is no matter of stray samples, all are kept, so that
    they are in the gap, however large. Where a run was cut at a step, it stays whole: the step is
    in the gap, too.
    """
    observed = _WithoutReversal.of(solved)
    plain = replace(config, reversal='none', piece_length=length)
    whole = len(solved.runs) == len(recordings)
    pairs = zip(solved.runs, observed.runs, strict=True)
    if any(share_in_whole_pieces(run, kept) > WARNING_LEFT_OUT for run, kept in pairs):
        plain = replace(plain, outlier_limit=ALL_SAMPLES)
    elif whole:
        same = length == config.piece_length
        return observed if same else _in_longer_pieces(observed, plain)
    return _WithoutReversal.of(solve_recordings(recordings, plain, repair=whole))


def _in_longer_pieces(observed: _WithoutReversal, config: CalibrationConfig) -> _WithoutReversal:
    """The same runs in pieces of ``config``, solved with the same functions of the motions."""
    joint, nodes = observed.solution, observed.nodes
    runs = [
        replace(reduce_recording(run.recording, run.alignment, nodes, config), late=run.late)
        for run in observed.runs
    ]
    start = Start.after(runs[0].machine, joint)
    return _WithoutReversal(*solve_robustly(runs, joint.unknowns, config, silent, start), nodes)


@dataclass(frozen=True)
class _Searched:
    """Rows, what is found in them, and the residual of their simulation.

    Attributes
    ----------
    exclude : sequence of str
        Effects taken out of the catalogue.
    speed : float, m/s
        Slower is a standstill.
    """

    rows: Rows
    found: SearchResult
    simulated_um: float
    exclude: Sequence[str]
    speed: float


def _search(
    recordings: Sequence[Recording],
    solved: SolvedRecordings,
    exclude: Sequence[str],
    config: CalibrationConfig,
    progress: Progress,
    own: Sequence[Effect],
) -> _Searched:
    """Search what the calibration leaves for effects."""
    length = _piece_length(solved.runs, config)
    observed = _without_reversal(recordings, solved, config, length)
    config = replace(config, piece_length=length)
    nodes, solution = observed.nodes, observed.solution
    progress('diagnosing', 0.0)
    rows = rows_to_diagnose(observed.runs, solution, nodes, config, exclude)
    rows.prepare()
    straight = partial(straight_rows, joint=solution, nodes=nodes, config=config, exclude=exclude)
    calm = partial(remove_steady_vibration, config=config)
    progress('diagnosing', 0.2)
    simulated = simulated_um(rows)
    lines = spectral_lines(rows)
    result = search_catalogue(rows, exclude, own, lines)
    progress('diagnosing', 0.5)
    for changed in (straight, calm, straight):  # loud noise may have hidden straight lines
        other = changed(rows, result.causes)
        if other is not None:
            rows, result = other, search_catalogue(other, exclude, own, lines)
    return _Searched(rows, result, simulated, exclude, config.standstill_speed)


def _search_axes(
    solved: SolvedRecordings,
    again: Callable[[CalibrationConfig, Progress], SolvedRecordings],
    exclude: Sequence[str],
    config: CalibrationConfig,
    progress: Progress,
    own: Sequence[Effect],
) -> _Searched:
    """The same of a machine with rotary axes; ``again`` solves its recordings."""
    observed, without = solved, replace(config, reversal='none')
    if len(solved.solution.joint.unknowns.blocks) > len(
        solved.solution.plain[1].unknowns.blocks
    ):  # reversal and lags are causes like any other
        observed = again(without, progress)
    progress('diagnosing', 0.0)
    rows = rows_of_axes(observed, without)
    offered = catalogue(rows.observed[0].machine)
    # of reversal that changes along an axis the constant part is named
    exclude = (*exclude, *(n for n in EVERY if n not in offered), direction_dependent_tables.name)
    of_rotary = [e for n, e in ROTARY.items() if n not in exclude]
    found = search_catalogue(rows, exclude, (*of_rotary, *own), ())
    progress('diagnosing', 0.5)
    return _Searched(rows, found, simulated_um(rows), exclude, config.rest_speed)


@dataclass(frozen=True)
class _Weighed:
    """Causes after what else could be, and where the gap lies.

    Attributes
    ----------
    shown : tuple of RunView
        For figures, one for every run.
    """

    judged: WeighedExplanation
    fitted: tuple[FittedCause, ...]
    gap: Gap
    causes: tuple[NamedCause, ...]
    where: Where
    shape: str
    shown: tuple[RunView, ...]
    p_value: float


def _weigh(searched: _Searched, explained: Explanation) -> _Weighed:
    """Weigh the causes found, name those that stay, and tell where the gap lies."""
    rows = searched.rows
    judged = judge(rows, explained, searched.speed, searched.exclude)
    explained, nameless = judged.explained, judged.nameless
    besides = nameless.structures if nameless and explained.causes else ()
    every = fitted_causes([*explained.causes, *(s.cause for s in besides), *explained.small], rows)
    fitted, gap = every[: len(explained.causes)], gap_of(explained, judged.noise)
    causes = named_causes(explained, fitted, judged.noise_cause, gap, rows.states)
    views = run_views(rows, explained)
    where, shape = where_and_shape(
        views,
        project=rows.project,
        known=known_words(causes, nameless.said if nameless else None),
        certain=nameless is None,
        simulated=1e-6 * gap.simulated_um,
    )
    shown = _shown_views(views, explained)
    p_value = chance_of_misfit(
        gap.measured_um, searched.simulated_um, SIMULATED_U * searched.simulated_um, len(rows.fold)
    )
    return _Weighed(judged, tuple(fitted), gap, causes, where, shape, shown, p_value)


def _causes_to_take_off(
    fitted: Sequence[FittedCause], bases: dict[str, Basis], examined: ExaminedRecordings
) -> CausesToRemove:
    """Causes with their parameters, for every examined run, less what fine functions hold."""
    followed = [held_by(part.cause.option, bases) for part in fitted]
    off = [part for part, held in zip(fitted, followed, strict=True) if not held]
    return CausesToRemove(
        tuple(
            CauseWords(
                part.cause.confidence, part.cause.indistinguishable, _name_words(part), part.axes
            )
            for part in off
        ),
        tuple(tuple(part.applied(k) for part in off) for k in examined.source),
        tuple(_name_words(part) for part, held in zip(fitted, followed, strict=True) if held),
    )


def _name_words(part: FittedCause) -> str:
    """Name of a cause with its axes."""
    name = part.cause.option.effect.name.replace('_', ' ')
    return f'{name} of {" and ".join(part.axes)}' if part.axes else name


def _answer(
    recordings: Sequence[Recording],
    examined: ExaminedRecordings,
    found: SearchResult,
    weighed: _Weighed,
    beside: Callable[[str], CalibrationResult],
) -> Diagnosis:
    """Put everything into words; ``beside`` makes the calibration for a sentence."""
    calibration = beside(_sentence(weighed))
    return _stated(
        recordings,
        found,
        weighed,
        calibration,
        qualify_moves(examined.findings, _said(weighed)),
        _table_change_um(calibration),
        _conditions(examined, calibration.plain),
    )


def _said(weighed: _Weighed) -> Unnamed | None:
    """What is known of a cause without a name."""
    nameless = weighed.judged.nameless
    return nameless.said if nameless else None


def _sentence(weighed: _Weighed) -> str:
    judged = weighed.judged
    return sentence_of(judged.verdict, weighed.gap, weighed.causes, judged.noise, _said(weighed))


def _stated(
    recordings: Sequence[Recording],
    found: SearchResult,
    weighed: _Weighed,
    calibration: CalibrationResult,
    contradictions: tuple[Finding, ...] = (),
    table_change_um: float = 0.0,
    conditions: Mapping[str, str] = MappingProxyType({}),
) -> Diagnosis:
    """Put everything into words."""
    visible, judged = found.visible, weighed.judged
    explained, nameless, causes = judged.explained, judged.nameless, weighed.causes
    applied = tuple(
        tuple(part.applied(k) for part in weighed.fitted) for k in range(len(weighed.shown))
    )
    return Diagnosis(
        runs=tuple(r.name or f'run {k}' for k, r in enumerate(recordings, start=1)),
        verdict=judged.verdict,
        sentence=_sentence(weighed),
        gap=weighed.gap,
        causes=causes,
        unexplained_um=weighed.gap.after_um,
        unexplained_where=judged.left if explained.causes else weighed.shape,
        not_visible=_not_visible(visible, causes),
        where=weighed.where,
        considered=found.considered,
        smallest_found_um={
            n: 1e6 * v.smallest for n, v in visible.items() if np.isfinite(v.smallest)
        },
        contradictions=(*incomplete_path(calibration.plain.fit.coverage), *contradictions),
        table_change_um=table_change_um,
        unnamed=_said(weighed),
        any_cause=AnyCause(weighed.p_value),
        applied=tuple(
            (*own, *(nameless.applied[k] if nameless else ())) for k, own in enumerate(applied)
        ),
        calibration=calibration,
        origin=calibration.plain.origin,
        shown=FigureData(weighed.shown, conditions),
    )


def _shown_views(views: Sequence[RunView], explained: Explanation) -> tuple[RunView, ...]:
    """Views for figures: their noise leaves what the simulation leaves."""
    noise = noise_factor(views, 1e-6 * explained.simulated_um)
    return tuple(view.with_noise(noise) for view in views)


def _not_visible(
    visible: dict[str, Visibility], causes: Sequence[NamedCause]
) -> tuple[tuple[str, str], ...]:
    """Effects that leave no trace in these data, and what would show them."""
    named = {c.effect for c in causes} | {n for c in causes for n in c.indistinguishable_from}
    hidden = [n for n, v in visible.items() if not v.visible and n not in named]
    return tuple((n, EVERY[n].words.shown_by) for n in hidden)


def _table_change_um(calibration: CalibrationResult) -> float:
    tables, other = calibration.plain.tables, calibration.tables
    q = driven_positions(tables)
    change = displacement(other, q) - displacement(tables, q)
    return 1e6 * mean_length(without_rigid_motion(change, nominal_position(tables.machine, q)))


def _conditions(examined: ExaminedRecordings, plain: CalibrationResult) -> dict[str, str]:
    first = examined.runs[0]
    return {
        'machine': first.machine.name,
        'chain': str(first.machine.chain),
        'samples': ', '.join(str(r.samples) for r in plain.runs),
        'path pieces': ', '.join(str(len(r.pieces)) for r in plain.runs),
        'reversal in the calibration': plain.reversal.model,
        'tracker noise, as measured in standstills': str(first.noise),
    }


def calibrate_with_effects(
    recordings: Sequence[Recording],
    effects: str,
    config: CalibrationConfig | None = None,
    progress: Progress | None = None,
    method: str = 'otf',
    *,
    same_station: bool = False,
) -> CalibrationResult:
    """Calibrate on the fly with effects taken off.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs of one machine.
    effects : str
        'auto': what a diagnosis of these runs finds; else an effects.yaml, see
        ``calibrate_with_file``.
    config : CalibrationConfig, optional
    progress : callable(stage, fraction), optional
    method : str
        Only 'otf' can do this: stops hold neither direction nor feed.
    same_station : bool
        The tracker was not moved between the recordings.

    Raises
    ------
    ConfigError
        If the file names what cannot be taken off, or for another method.
    InputError
        As ``calibrate_recordings``.
    """
    if method != 'otf':
        raise ConfigError(
            f'effects {effects}: cannot be removed with the method {method}: at stops there is '
            f'neither feed nor direction of travel; use the method otf'
        )
    if effects != AUTO:
        return calibrate_with_file(
            recordings, effects, config, progress, same_station=same_station
        )
    diagnosis = diagnose(recordings, (), config, progress, same_station=same_station)
    calibration = diagnosis.calibration
    if diagnosis.verdict != 'unknown':
        return calibration
    warned = (calibration.effects_sentence, *calibration.warnings)
    return replace(calibration, warnings=warned)
