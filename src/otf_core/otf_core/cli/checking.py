# SPDX-License-Identifier: Apache-2.0
"""Verbs that answer in seconds: check."""

from __future__ import annotations

import argparse

from otf_core.cli.options import parameters
from otf_core.cli.output import answer
from otf_core.config import CalibrationConfig
from otf_core.errors import InputError

LOOKED_AT = ('match_tolerance', 'standstill_speed')


def run_check(arguments: argparse.Namespace) -> int:
    """Say whether a recording is usable."""
    config = parameters(CalibrationConfig, arguments, LOOKED_AT)
    from otf_core.checking.check import check
    from otf_core.model.machine import load_machine
    from otf_core.reports.check import format_check

    machine = load_machine(arguments.machine) if arguments.machine else None
    report = check(arguments.bag, machine, config)
    answer(arguments, format_check(report), report.to_dict())
    return 0 if report.usable else InputError.exit_code
