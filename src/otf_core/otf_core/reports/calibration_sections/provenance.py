# SPDX-License-Identifier: Apache-2.0
"""Versions, hashes, configuration, and how to repeat it."""

from __future__ import annotations

import platform
from dataclasses import asdict

import numpy as np
import scipy

from otf_core.reports.calibration_facts import Facts
from otf_core.reports.section import Section, Table


def section(facts: Facts) -> Section:
    """Return the section."""
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
    words = ['How to repeat it: ' + repeat(facts)]
    tables = (
        Table(('', ''), tuple(rows), title='Provenance'),
        Table(('Parameter', 'Value (SI)'), settings, folded='Parameters of the method'),
    )
    return Section('provenance', 'Versions and how to repeat it', tuple(words),
                   {'run_id': result.run_id, 'provenance': dict(about)}, tables)  # fmt: skip


def repeat(facts: Facts) -> str:
    """The command that gives the same tables from the same recordings."""
    bags = ' '.join(o.name or 'BAG' for o in facts.result.origin) or 'BAG'
    config = facts.result.config
    given = [
        f'--{name.replace("_", "-")} {value}'
        for name, value in asdict(config).items()
        if value != getattr(type(config)(), name)
    ]
    method = facts.provenance['method']
    options = ' '.join([f'--method {method}', *given])
    return (
        f'./otf calibrate {bags} --machine machine.yaml --out DIR {options}; the same bags, '
        f'machine.yaml and version give the same tables and the same run id.'
    )
