# SPDX-License-Identifier: Apache-2.0
"""The rooms of the package: every file has one, and imports lead to lower floors only."""

import ast
import runpy
from functools import cache
from pathlib import Path

from source_trees import ROOT, parsed

FACES = (
    '__init__',
    'ahead',
    'arrays',
    'aside',
    'config',
    'errors',
    'memory',
    'threads',
    'version',
)
"""All that lies beside the rooms: what is used everywhere, and the public names, loaded lazily."""
FLOORS = (
    ('api', 'cli'),
    ('info', 'installation', 'reports'),
    ('blind', 'checking', 'history', 'loop', 'validation'),
    ('planning',),
    ('diagnosis',),
    ('calibration',),
    ('budget', 'contradictions', 'rotary', 'sim'),
    ('inputs', 'solving'),
    ('effects', 'pieces', 'comparison', 'exports', 'fleet'),
    ('bags', 'live', 'noise', 'prediction', 'tracking'),
    ('model',),
    ('files',),
)
"""From the top floor down."""
INSIDE = {
    'diagnosis': (('diagnosis',), ('diagnosis.engine', 'diagnosis.place')),
    'planning': (('planning',), ('planning.nc',)),
    'reports': (('reports',), ('reports.drawing',)),
}
"""Floors of rooms that have rooms inside."""
NEVER = [
    ('diagnosis', 'sim'),
    ('planning', 'sim'),
    ('reports', 'sim'),
    ('reports', 'blind'),
    ('validation', 'diagnosis'),
    ('blind', 'diagnosis'),
    ('blind', 'calibration'),
    ('blind', 'solving'),
    ('blind', 'pieces'),
    ('diagnosis.engine', 'diagnosis.place'),
    ('diagnosis.place', 'diagnosis.engine'),
]
FLOOR_OF = {room: k for k, floor in enumerate(FLOORS) for room in floor}


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


def room_of(module):
    """Room of a module: its outermost folder."""
    return module.partition('.')[0]


def inner_room_of(module):
    """Room of a module with the rooms inside rooms told apart."""
    parts = module.split('.')
    nested = '.'.join(parts[:2])
    return nested if any(nested in floor for f in INSIDE.values() for floor in f) else parts[0]


def test_every_room_stands_on_a_floor_and_every_floor_has_its_rooms():
    rooms = {room_of(m) for m in MODULES if '.' in m}
    assert rooms == set(FLOOR_OF)
    assert {m for m in MODULES if '.' not in m} == set(FACES)
    assert len(FLOORS) <= 12


def test_imports_lead_down():
    up = []
    for module, names in imported().items():
        room = room_of(module)
        for other in names:
            target = room_of(other)
            if target != room and not {room, target, other} & {*FACES, ''}:
                up += [f'{module} imports {other}'] * (FLOOR_OF[target] <= FLOOR_OF[room])
    assert not up


def test_imports_lead_down_inside_a_room():
    up = []
    for module, names in imported().items():
        floors = INSIDE.get(room_of(module), ())
        level = {room: k for k, floor in enumerate(floors) for room in floor}
        own = inner_room_of(module)
        for other in names:
            target = inner_room_of(other)
            if target != own and target in level:
                up += [f'{module} imports {other}'] * (level[target] <= level[own])
    assert not up


def test_rooms_that_never_meet():
    assert not [
        f'{module} imports {other}'
        for a, b in NEVER
        for module, names in imported().items()
        for other in names
        if f'{module}.'.startswith(f'{a}.') and f'{other}.'.startswith(f'{b}.')
    ]


def test_picture_of_the_house_is_that_of_the_imports():
    root = Path(__file__).parents[3]
    drawn = runpy.run_path(str(root / 'tools/house.py'))['picture']()
    assert (root / 'docs/images/house.svg').read_text(encoding='utf-8') == drawn
