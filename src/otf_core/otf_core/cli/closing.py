# SPDX-License-Identifier: Apache-2.0
"""Verb that closes the circle against a real control: loop."""

from __future__ import annotations

import argparse
import dataclasses

from otf_core.cli.options import AddVerb, add_out, add_parameters, output_folder, parameters
from otf_core.cli.output import QUALITY_GATE_FAILED, answer_from, note
from otf_core.config import LoopConfig, PlannerConfig, SimulationConfig

WAYS = ('axes', 'volume', 'program')


def add_closing_verbs(verb: AddVerb) -> None:
    """Add loop."""
    sub = verb('loop', run_loop)
    sub.add_argument('--machine', required=True, help='machine.yaml')
    add_out(sub, 'folder for loop.json, calibration, bags and the files given to the control')
    sub.add_argument(
        '--compensate', choices=WAYS, default='volume',
        help='axes: a .comp file per joint; volume: external offsets at the current position; '
        'program: a corrected NC program (default volume)',
    )  # fmt: skip
    sub.add_argument(
        '--diagnose', action='store_true', help='also diagnose the fitted run (diagnosis/; slow)'
    )
    add_parameters(sub, LoopConfig)


def run_loop(arguments: argparse.Namespace) -> int:
    """The whole circle on LinuxCNC."""
    asked = parameters(LoopConfig, arguments)
    given = dataclasses.asdict(asked)
    planning = PlannerConfig(passes=1, feed=given.pop('feed'), corner_dwell=0.05, end_dwell=2.0)
    out = output_folder(arguments, arguments.machine)
    from otf_core.loop.circle import go_round
    from otf_core.loop.control import find_control
    from otf_core.model.machine import load_machine
    from otf_core.planning.path_creation import plan_path
    from otf_core.reports.loop import failed_gates, format_loop, write_loop

    machine = load_machine(arguments.machine)
    find_control()
    plan = plan_path(machine, planning)

    def progress(text: str) -> None:
        if not arguments.quiet:
            note(f'otf loop: {text}')

    circle = go_round(
        machine,
        plan,
        arguments.compensate,
        SimulationConfig(**given),
        progress,
    )
    with out.filled('loop') as folder:
        files = write_loop(circle, folder)
        if arguments.diagnose:
            from otf_core.diagnosis.diagnose import diagnose
            from otf_core.reports.diagnosis import write_diagnosis
            from otf_core.sim.twin import twin_recording

            progress('diagnoses')
            found = diagnose([circle.recordings['fit']], twin_recording)
            files += write_diagnosis(found, folder / 'diagnosis')
        names = [f.relative_to(folder) for f in files]
    answer_from(arguments, format_loop(circle), [out.path / n for n in names], 'loop.json')
    gates = failed_gates(circle)
    for gate in gates:
        note(f'otf loop: quality gate failed: {gate}')
    return QUALITY_GATE_FAILED if gates else 0
