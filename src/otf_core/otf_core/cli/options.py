# SPDX-License-Identifier: Apache-2.0
"""Command-line options of the parameter dataclasses, in the units machine users use."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from otf_core.config import ParameterInfo, Parameters
from otf_core.errors import ConfigError

if TYPE_CHECKING:
    from otf_core.files.output_folder import OutputFolder
    from otf_core.inputs.recordings import ReadingOptions

CLI_UNITS = {'feed': ('MM_PER_MIN', 60000.0)}
"""Options stated in another unit than the parameter, as machine users do: name, factor."""

Handler = Callable[[argparse.Namespace], int]
AddVerb = Callable[[str, Handler], argparse.ArgumentParser]
"""Adds a verb and returns its parser."""


def _option(name: str) -> str:
    return '--' + name.replace('_', '-')


def _add_parameter(group: Any, info: ParameterInfo) -> None:
    kind = type(info.default)
    unit, factor = CLI_UNITS.get(info.name, (kind.__name__.upper(), 1))
    bounds = ''
    if info.low is not None and info.high is not None:
        bounds = f', {info.low * factor:g} to {info.high * factor:g}'
    stated = info.unit if factor == 1 else 'mm/min'
    default = info.default if isinstance(info.default, str) else info.default * factor
    text = f'{info.meaning} ({stated or kind.__name__}{bounds}; default {default})'
    group.add_argument(
        _option(info.name),
        dest=info.name,
        type=kind,
        choices=info.choices or None,
        metavar=None if info.choices else unit,
        help=text.replace('%', '%%'),
    )


def refuse_rotary(machine: Any, verb: str) -> None:
    """Refuse a machine with rotary axes where a command is for linear axes alone."""
    if machine.rotary_names:
        raise ConfigError(
            f'{verb}: not available for machines with rotary axes ({machine.name}, chain '
            f'{machine.chain}); available are calibrate, check, compare, diagnose, export, '
            f'fleet calibrate, history, plan, predict, info, noise and simulate'
        )


def add_out(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --out and --overwrite."""
    parser.add_argument('--out', required=True, help=text)
    parser.add_argument(
        '--overwrite',
        action='store_true',
        help='replace existing results; other files are never deleted',
    )


def add_verbose(parser: argparse.ArgumentParser, where: str) -> None:
    """Add --verbose: all numbers on the terminal too, which otherwise stand in a file."""
    parser.add_argument('--verbose', action='store_true', help=f'print all numbers, as in {where}')


def add_reading(parser: argparse.ArgumentParser, *, path: bool = True) -> None:
    """Add the options that say how recordings are read."""
    group = parser.add_argument_group('how recordings are read')
    if path:
        group.add_argument(
            '--path', action='append', metavar='FILE',
            help='plan.json, CSV x,y,z of the corner points, or the NC program that was driven, '
            'if the recording contains no path or to replace it; once for all recordings, or '
            'once per recording',
        )  # fmt: skip
        group.add_argument('--path-topic', metavar='NAME', help='topic of the path in a bag')
    group.add_argument(
        '--topic', metavar='NAME',
        help='topic of the samples in a bag: PointStamped, PoseStamped, TransformStamped or '
        'Odometry, in any frame',
    )  # fmt: skip
    group.add_argument(
        '--columns', metavar='LIST',
        help='content of the columns of a text table, e.g. time_s,-,x_mm,y_mm,z_mm (default: '
        'as in its header)',
    )  # fmt: skip
    group.add_argument(
        '--rate', type=float, metavar='HZ', help='sampling rate of a text table without times'
    )
    group.add_argument('--recover', action='store_true', help='skip damaged parts inside a bag')


def reading_options(arguments: argparse.Namespace, path: str | None = None) -> ReadingOptions:
    """How recordings are read, by the options."""
    from otf_core.inputs.recordings import ReadingOptions

    return ReadingOptions(
        path=path,
        topic=arguments.topic,
        path_topic=getattr(arguments, 'path_topic', None),
        columns=arguments.columns,
        rate=arguments.rate,
        recover=arguments.recover,
        signals=tuple(getattr(arguments, 'signal', ())),
    )


def output_folder(arguments: argparse.Namespace, *inputs: str, **words: str) -> OutputFolder:
    """Check --out before any work; ``inputs`` are files and folders that the verb reads."""
    from otf_core.files.output_folder import OutputFolder

    return OutputFolder(arguments.out, overwrite=arguments.overwrite, inputs=inputs, **words)


def add_parameters(
    parser: argparse.ArgumentParser, kind: type[Parameters], only: Sequence[str] = ()
) -> None:
    """Add the parameters of a dataclass, or ``only`` some, as options."""
    group = parser.add_argument_group((kind.__doc__ or '').split('.')[0].lower())
    for info in kind.infos():
        if not only or info.name in only:
            _add_parameter(group, info)


def _scaled(info: ParameterInfo, value: float, scale: float) -> Any:
    """Value of an option in its own unit; ConfigError in that unit too."""
    try:
        return info.check(value / scale)
    except ConfigError:
        if info.low is None or info.high is None:
            raise
        unit = CLI_UNITS[info.name][0].lower().replace('_per_', '/')
        raise ConfigError(
            f'{info.name}: {value:g} is out of range, {info.low * scale:g} to '
            f'{info.high * scale:g} {unit} are possible'
        ) from None


def parameters(kind: type[Any], arguments: argparse.Namespace, only: Sequence[str] = ()) -> Any:
    """Build a parameter dataclass from the options that were given; ConfigError names them."""
    given = {}
    for info in kind.infos():
        if only and info.name not in only:
            continue
        value = getattr(arguments, info.name)
        if value is None:
            continue
        try:
            scale = CLI_UNITS.get(info.name, ('', 1))[1]
            given[info.name] = info.check(value) if scale == 1 else _scaled(info, value, scale)
        except ConfigError as error:
            raise ConfigError(f'{_option(info.name)}{str(error)[len(info.name) :]}') from None
    return kind(**given)
