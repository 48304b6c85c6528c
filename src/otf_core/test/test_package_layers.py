# SPDX-License-Identifier: Apache-2.0
"""Layers of otf_core: every module is in a package, and imports lead to lower layers only."""

import ast
import runpy
from functools import cache
from pathlib import Path

from source_trees import ROOT, parsed

ROOT_MODULES = (
    '__init__',
    'arrays',
    'aside',
    'blocks',
    'config',
    'documents',
    'errors',
    'threads',
    'version',
)
"""Modules outside the packages: used everywhere, and the public names, loaded lazily."""
LAYERS = (
    ('cli',),
    ('api',),
    ('reports',),
    ('checking', 'history'),
    ('planning',),
    ('diagnosis',),
    ('calibration',),
    ('budget', 'comparison', 'contradictions', 'sim'),
    ('inputs', 'solving'),
    ('effects', 'pieces', 'exports', 'fleet'),
    ('bags', 'live', 'noise', 'prediction', 'tracking'),
    ('model',),
    ('files',),
)
"""From the top down."""
SUBPACKAGES = {
    'diagnosis': (('diagnosis',), ('diagnosis.engine', 'diagnosis.place')),
    'planning': (('planning',), ('planning.nc',)),
}
"""Layers inside packages that have subpackages."""
FORBIDDEN = [
    ('diagnosis', 'sim'),
    ('planning', 'sim'),
    ('reports', 'sim'),
    ('diagnosis.engine', 'diagnosis.place'),
    ('diagnosis.place', 'diagnosis.engine'),
]
LAYER_OF = {package: k for k, layer in enumerate(LAYERS) for package in layer}


def module_of(file):
    """Dotted name below the package."""
    return '.'.join(file.relative_to(ROOT).with_suffix('').parts)


MODULES = {module_of(f): f for f in sorted(ROOT.rglob('*.py'))}


def imports_of(module):
    """Modules of the package that a module imports, dotted names below it."""
    for node in ast.walk(parsed(MODULES[module])):
        if isinstance(node, ast.ImportFrom) and node.module.split('.')[0] == 'otf_core':
            base = node.module.split('.')[1:]
            for alias in node.names:
                inner = '.'.join([*base, alias.name])
                yield inner if inner in MODULES else '.'.join(base)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith('otf_core.'):
                    yield alias.name.partition('.')[2]


@cache
def imported():
    """What every module imports."""
    return {module: list(imports_of(module)) for module in MODULES}


def package_of(module):
    """Outermost package of a module."""
    return module.partition('.')[0]


def subpackage_of(module):
    """Package of a module, or its subpackage where that has a layer of its own."""
    parts = module.split('.')
    nested = '.'.join(parts[:2])
    return (
        nested if any(nested in layer for f in SUBPACKAGES.values() for layer in f) else parts[0]
    )


def test_every_package_has_a_layer():
    packages = {package_of(m) for m in MODULES if '.' in m}
    assert packages == set(LAYER_OF)
    assert {m for m in MODULES if '.' not in m} == set(ROOT_MODULES)
    assert len(LAYERS) <= 13


def test_imports_lead_down():
    up = []
    for module, names in imported().items():
        package = package_of(module)
        for other in names:
            target = package_of(other)
            if target != package and not {package, target, other} & {*ROOT_MODULES, ''}:
                up += [f'{module} imports {other}'] * (LAYER_OF[target] <= LAYER_OF[package])
    assert not up


def test_imports_lead_down_inside_a_package():
    up = []
    for module, names in imported().items():
        layers = SUBPACKAGES.get(package_of(module), ())
        level = {package: k for k, layer in enumerate(layers) for package in layer}
        own = subpackage_of(module)
        for other in names:
            target = subpackage_of(other)
            if target != own and target in level:
                up += [f'{module} imports {other}'] * (level[target] <= level[own])
    assert not up


def test_packages_that_never_import_each_other():
    assert not [
        f'{module} imports {other}'
        for a, b in FORBIDDEN
        for module, names in imported().items()
        for other in names
        if f'{module}.'.startswith(f'{a}.') and f'{other}.'.startswith(f'{b}.')
    ]


def test_figure_of_the_packages_is_that_of_the_imports():
    root = Path(__file__).parents[3]
    drawn = runpy.run_path(str(root / 'tools/house.py'))['picture']()
    assert (root / 'docs/images/house.svg').read_text(encoding='utf-8') == drawn
