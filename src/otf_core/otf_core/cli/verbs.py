# SPDX-License-Identifier: Apache-2.0
"""The offline verbs: what each does in one line, and how it is called; imports nothing.

``./otf`` reads this file without the package, so that its help needs no set-up.
"""

from __future__ import annotations

VERBS = {
    'check': 'Check in seconds whether a recording is usable, before the tracker is dismounted.',
    'info': 'Identify a recording, machine.yaml or result: schema, headline, provenance.',
    'doctor': 'Check this installation and state how to repair it.',
    'calibrate': 'Determine error tables from recorded bags.',
    'diagnose': 'Find where and why a real run departs from its simulation.',
    'predict': 'Predict volumetric errors at points from error tables: the mean of forward and '
    'backward travel.',
    'compare': 'Compare error tables or direct measurements, motion by motion.',
    'report': 'Write the page of a result file, as the verb that wrote the file does.',
    'export': 'Write error tables in the format of a control or another program.',
    'import': 'Read error tables of another system: lattice, Etalon exchange format, ISG CSV.',
    'fleet': 'Process many recordings, here or on other hosts; a bad bag affects no other.',
    'history': 'Evaluate the drift of machines over their calibrations, and when to recalibrate.',
    'noise': 'Determine the tracker noise from the standstills of a bag.',
    'plan': 'Plan a path, forecast what it can determine, write an NC program.',
    'simulate': 'Write the bag of a simulated run.',
    'completion': 'Print a script that lets a shell complete verbs, options and choices.',
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
    'report': ('otf report tables/error_tables.json --out page',),
    'export': ('otf export tables --format linuxcnc --out mill.ini',),
    'import': ('otf import lattice.csv --machine machine.yaml --out tables',),
    'fleet': (
        'otf fleet calibrate --list runs.csv --out plant --workers 8',
        'otf fleet diagnose --list runs.csv --out gaps --scheduler tcp://host:8786',
    ),
    'history': (
        'otf history store --add tables',
        "otf history store --event 'ball screw of X replaced' --at 2026-11-02",
        'otf history store --limit 5 --out page',
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
    'completion': ('otf completion bash > ~/.local/share/bash-completion/completions/otf',),
}
