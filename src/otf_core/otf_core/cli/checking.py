# SPDX-License-Identifier: Apache-2.0
"""Verbs that answer in seconds: check, info, doctor."""

from __future__ import annotations

import argparse
import dataclasses

from otf_core.cli.options import given_of, parameters
from otf_core.cli.output import answer
from otf_core.cli.progress import progress_of
from otf_core.config import CalibrationConfig
from otf_core.errors import ConfigError, InputError

LOOKED_AT = ('match_tolerance', 'standstill_speed')


def run_check(arguments: argparse.Namespace) -> int:
    """Say whether a recording is usable."""
    config = parameters(CalibrationConfig, arguments, LOOKED_AT)
    from otf_core.checking.checks import check, format_check
    from otf_core.model.machine import load_machine

    machine = load_machine(arguments.machine) if arguments.machine else None
    path = arguments.path[-1] if arguments.path else None
    with progress_of(arguments, 'checking'):
        report = check(arguments.bag, machine, config, given_of(arguments, path))
    answer(arguments, format_check(report), report.to_dict())
    return 0 if report.usable else InputError.exit_code


def run_doctor(arguments: argparse.Namespace) -> int:
    """Say what is wrong with an installation."""
    from otf_core.installation.doctor import ERROR, OK, examine

    states = examine()
    lines = [f'{s.severity:<9}{s.part:<12}{s.what}{f": {s.do}" if s.do else ""}' for s in states]
    wrong = [s for s in states if s.severity != OK]
    lines += ['', f'{len(wrong)} things to look at' if wrong else 'nothing is wrong']
    healthy = all(s.severity != ERROR for s in states)
    parts = [dataclasses.asdict(s) for s in states]
    answer(arguments, '\n'.join(lines), {'healthy': healthy, 'parts': parts})
    return 0 if healthy else ConfigError.exit_code


def run_info(arguments: argparse.Namespace) -> int:
    """Say what a file is and says."""
    from otf_core.info.explain import explain

    kind, found = explain(arguments.file)
    width = max([len(name) for name, _ in found.rows] + [0])
    lines = [f'{arguments.file}: {kind.name}', kind.what, '']
    lines += [f'{name:<{width}}  {text}' for name, text in found.rows]
    about = {'file': arguments.file, 'kind': kind.name, 'what': kind.what}
    answer(arguments, '\n'.join(lines), {**about, 'facts': dict(found.facts)})
    return 0
