# SPDX-License-Identifier: Apache-2.0
"""Command-line options that several verbs share, and the parameters of ``--config FILE``."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from otf_core.config import (
    CalibrationConfig,
    DiagnosisConfig,
    ForecastConfig,
    ParameterInfo,
    Parameters,
    PlannerConfig,
    ReadingConfig,
    SimulationConfig,
    WritingConfig,
)
from otf_core.errors import ConfigError

if TYPE_CHECKING:
    from otf_core.files.output_folder import OutputFolder
    from otf_core.inputs.recordings import ReadingOptions

FEED, FEED_UNIT = 60000.0, 'mm/min'
"""The option ``--feed`` is in this unit, so many of it in 1 m/s; all else is SI."""

CONFIG_KEYS: dict[str, tuple[ParameterInfo, ...]] = {
    'calibrate': (*CalibrationConfig.infos(), *ReadingConfig.infos(), *WritingConfig.infos()),
    'diagnose': (*CalibrationConfig.infos(), *ReadingConfig.infos(), *DiagnosisConfig.infos()),
    'check': (
        *CalibrationConfig.infos('match_tolerance', 'standstill_speed'),
        *ReadingConfig.infos(),
    ),
    'noise': (
        *CalibrationConfig.infos('standstill_speed'),
        *ReadingConfig.infos('topic', 'recover'),
    ),
    'plan': (*PlannerConfig.infos(), *ForecastConfig.infos()),
    'simulate': (*SimulationConfig.infos(), *PlannerConfig.infos()),
}
"""What ``--config`` may state, by verb."""

Handler = Callable[[argparse.Namespace], int]
AddVerb = Callable[[str, Handler], argparse.ArgumentParser]
"""Adds a verb and returns its parser."""


def add_sign(sub: argparse.ArgumentParser) -> None:
    """Add --sign of values that are read."""
    sub.add_argument(
        '--sign', choices=('error', 'correction'),
        help='what the values of another system are (default: errors, and said)',
    )  # fmt: skip


def add_out(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --out and --overwrite."""
    parser.add_argument('--out', required=True, help=text)
    parser.add_argument(
        '--overwrite',
        action='store_true',
        help='replace existing results; no other file is deleted',
    )


def add_reading(parser: argparse.ArgumentParser, *, path: bool = True) -> None:
    """Add the options that say how recordings are read."""
    if path:
        parser.add_argument(
            '--path', action='append', metavar='FILE',
            help='path in place of that in the recording: plan.json, CSV x,y,z or NC program; '
            'once, or once per recording',
        )  # fmt: skip
    parser.add_argument(
        '--columns', metavar='LIST',
        help='columns of a text table, e.g. time_s,-,x_mm,y_mm,z_mm (default: its header)',
    )  # fmt: skip
    parser.add_argument(
        '--rate', type=float, metavar='HZ', help='sampling rate of a text table without times'
    )
    parser.add_argument(
        '--time-format', metavar='FORMAT',
        help='form of the times in a text table, e.g. "%%d.%%m.%%Y %%H:%%M:%%S.%%f"',
    )  # fmt: skip


def reading_options(arguments: argparse.Namespace, path: str | None = None) -> ReadingOptions:
    """How recordings are read, by the options and --config."""
    from otf_core.inputs.recordings import ReadingOptions

    config = parameters(ReadingConfig, arguments)
    return ReadingOptions(
        path=path,
        topic=config.topic or None,
        path_topic=config.path_topic or None,
        columns=arguments.columns,
        rate=arguments.rate,
        recover=config.recover,
        time_format=arguments.time_format,
    )


def output_folder(arguments: argparse.Namespace, *inputs: str, **words: str) -> OutputFolder:
    """Check --out before any work; ``inputs`` are files and folders that the verb reads."""
    from otf_core.files.output_folder import OutputFolder

    return OutputFolder(arguments.out, overwrite=arguments.overwrite, inputs=inputs, **words)


def add_config(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add --config; the names that it may state stand at the end of the help."""
    parser.add_argument('--config', metavar='FILE', help='YAML file of name: value, in SI units')
    names = ', '.join(info.name for info in CONFIG_KEYS.get(verb, ()))
    if names:
        words = textwrap.fill(names, 76)
        parser.add_argument_group('names in --config', words)


def read_config(file: str, verb: str) -> dict[str, Any]:
    """Return what a --config file states for a verb, by name.

    Raises
    ------
    ConfigError
        Names the file and the key that is unknown, not for this verb, mistyped or out of range.
    """
    from otf_core.files.strict_yaml import Fields, read_yaml

    known = {info.name: info for info in CONFIG_KEYS[verb]}
    fields, values = Fields(read_yaml(file), file), {}
    for name in fields.keys:
        if name not in known:
            others = [v for v, keys in CONFIG_KEYS.items() if name in {info.name for info in keys}]
            kind = f'a key of otf {", ".join(others)} only' if others else 'unknown key'
            fields.fail(name, f'{kind}; known to otf {verb}: {", ".join(known)}')
        try:
            values[name] = known[name].check(fields.take(name))
        except ConfigError as error:
            raise ConfigError(f'{file}: {error}') from None
        except (OverflowError, ValueError):  # Python writes no number of thousands of digits
            fields.fail(name, 'the number is too large')
    if values.get('own_causes'):
        values['own_causes'] = str(Path(file).parent / values['own_causes'])
    return values


def add_parameters(parser: argparse.ArgumentParser, kind: type[Parameters], *only: str) -> None:
    """Add the parameters of a dataclass, or ``only`` some, as options."""
    for info in kind.infos(*only):
        factor, unit = (FEED, FEED_UNIT) if info.name == 'feed' else (1, info.unit)
        in_unit = f'{unit}, ' if unit else ''
        parser.add_argument(
            _option(info.name),
            type=type(info.default),
            metavar='N' if isinstance(info.default, int) else 'VALUE',
            help=f'{info.meaning} ({in_unit}default {info.default * factor:g})',
        )


def _option(name: str) -> str:
    return '--' + name.replace('_', '-')


def given(arguments: argparse.Namespace, kind: type[Parameters]) -> dict[str, Any]:
    """Return the parameters of a dataclass that an option, else --config, states; SI units.

    Raises
    ------
    ConfigError
        Names the option that is out of range, in its own unit.
    """
    values = {}
    for info in kind.infos():
        stated = getattr(arguments, info.name, None)
        if stated is None and info.name in arguments.config_values:
            values[info.name] = arguments.config_values[info.name]
        elif stated is not None:
            factor = FEED if info.name == 'feed' else 1
            try:
                values[info.name] = info.check(stated if factor == 1 else stated / factor)
            except ConfigError as error:
                problem = str(error)[len(info.name) :]
                if factor != 1 and info.low is not None and info.high is not None:
                    problem = (
                        f': {stated:g} is out of range, {info.low * factor:g} to '
                        f'{info.high * factor:g} {FEED_UNIT} are possible'
                    )
                raise ConfigError(_option(info.name) + problem) from None
    return values


def parameters(kind: type[Any], arguments: argparse.Namespace) -> Any:
    """Build a parameter dataclass from the options and --config; ConfigError names them."""
    return kind(**given(arguments, kind))
