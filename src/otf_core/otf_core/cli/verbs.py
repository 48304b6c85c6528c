# SPDX-License-Identifier: Apache-2.0
"""The offline verbs: what each does in one line, and how it is called; imports nothing.

``./otf`` reads this file without the package, so that its help needs no set-up.
"""

from __future__ import annotations

VERBS = {
    'check': 'Is a recording usable? In seconds, before anyone dismounts the tracker.',
    'info': 'What a file or folder of otf is and says.',
    'doctor': 'What is wrong with this installation, and what to do.',
    'calibrate': 'Error tables from recorded bags.',
    'diagnose': 'Where and why a real run departs from its simulation.',
    'predict': 'Volumetric errors at points, from error tables: the mean of forward and backward '
    'travel.',
    'compare': 'Error tables or direct measurements, motion by motion.',
    'export': 'Error tables in the format of a control or a program.',
    'import': 'Error tables from a lattice of volumetric errors in CSV.',
    'fleet': 'Many recordings at once, here or on other hosts; one bad bag ends no other.',
    'history': 'Drift of machines over their calibrations, and when to calibrate again.',
    'loop': 'The whole circle on LinuxCNC: drive, measure, calibrate, compensate, prove it.',
    'noise': 'Tracker noise in the standstills of a bag.',
    'plan': 'Path for a machine, forecast of what it can see, NC program.',
    'simulate': 'Bag of a simulated run.',
    'validate': "The paper's comparisons on simulated cells.",
    'blind': 'Blind trial: draw and seal cells, diagnose them, score.',
    'completion': 'Script that lets a shell complete verbs, options and choices.',
}

EXAMPLES = {
    'check': (
        'otf check run1',
        'otf check run1 --machine machine.yaml --json',
    ),
    'info': (
        'otf info run1',
        'otf info tables/error_tables.json --json',
    ),
    'doctor': ('otf doctor', 'otf doctor --json'),
    'calibrate': (
        'otf calibrate run1 --machine machine.yaml --out tables',
        'otf calibrate run1 run2 --machine machine.yaml --out tables --overwrite',
        'otf calibrate run1 --machine machine.yaml --out tables --effects auto',
    ),
    'diagnose': (
        'otf diagnose run1 --machine machine.yaml --out gap',
        'otf diagnose run1 run2 --machine m1.yaml --machine m2.yaml --out gap --json',
    ),
    'predict': (
        'otf predict --tables tables/error_tables.json --points points.csv --out errors.csv',
    ),
    'compare': (
        'otf compare before/error_tables.json after/error_tables.json --out change',
        'otf compare tables/error_tables.json direct.csv --machine machine.yaml --out direct',
    ),
    'export': ('otf export tables --format linuxcnc --out mill.ini',),
    'import': ('otf import lattice.csv --machine machine.yaml --out tables',),
    'fleet': (
        'otf fleet calibrate --list runs.csv --out plant --workers 8',
        'otf fleet diagnose --list runs.csv --out gaps --scheduler tcp://host:8786',
        'otf fleet blind --trials 80 --seed 5 --out trial --workers 8',
    ),
    'history': (
        'otf history store --add tables',
        "otf history store --event 'ball screw of X replaced' --at 2026-11-02",
        'otf history store --limit 5 --out page',
    ),
    'loop': (
        'otf loop --machine machine.yaml --out loop',
        'otf loop --machine machine.yaml --out loop --compensate axes --seed 3',
    ),
    'noise': ('otf noise run1 --out noise',),
    'plan': (
        'otf plan --machine machine.yaml --out plan --dialect sinumerik',
        'otf plan --machine machine.yaml --out plan --time-budget 600 --feed 9000',
    ),
    'simulate': (
        'otf simulate --machine machine.yaml --out run1 --seed 7',
        'otf simulate --machine machine.yaml --out run2 --path plan/plan.json',
    ),
    'validate': ('otf validate --quick --out validation',),
    'blind': ('otf blind --trials 24 --seed 5 --out trial',),
    'completion': ('otf completion bash > ~/.local/share/bash-completion/completions/otf',),
}
