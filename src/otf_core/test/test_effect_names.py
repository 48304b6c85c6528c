# SPDX-License-Identifier: Apache-2.0
"""No effect is named outside its own file: the other rooms read what it says about itself."""

import ast
import re
from pathlib import Path

import pytest

import otf_core
from otf_core.effects import REGISTRY
from otf_core.model.declared import KEYS

ROOT = Path(otf_core.__file__).parents[2]
HOMONYMS = set(REGISTRY) & {*KEYS, 'target_offset'}
"""Keys of machine.yaml that are spelled like the effect they declare."""
KEYS_OF_OTHERS = {'declared_signals.py', 'departed_forms.py', 'depends.py'}
"""Names that machine.yaml may hold; names that count as right in a blind trial, which shares
nothing with the effects."""
SOURCES = sorted(
    f for f in ROOT.rglob('*.py')
    if f.name not in KEYS_OF_OTHERS
    and not {'test', 'tests', 'build', 'install'} & set(f.relative_to(ROOT).parts)
    and not (f.parent.name == 'effects' and f.stem in (*REGISTRY, 'catalogue'))
)  # fmt: skip


def docstrings(tree):
    """Strings that stand alone: docstrings and descriptions of constants."""
    return {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}


@pytest.mark.parametrize('file', SOURCES, ids=[str(f.relative_to(ROOT)) for f in SOURCES])
def test_no_effect_is_named_outside_its_own_file(file):
    tree = ast.parse(file.read_text())
    exempt = docstrings(tree)
    texts = [
        n for n in ast.walk(tree)
        if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in exempt
    ]  # fmt: skip
    for node in texts:
        whole = node.value in REGISTRY
        words = {w for w in re.findall(r'\w+', node.value) if '_' in w} & set(REGISTRY)
        named = words | ({node.value} if whole else set())
        assert not named - HOMONYMS, f'line {node.lineno}: {named}'


@pytest.mark.parametrize('file', SOURCES, ids=[str(f.relative_to(ROOT)) for f in SOURCES])
def test_no_effect_is_taken_from_the_registry_by_a_fixed_name(file):
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Subscript) and getattr(node.value, 'id', '') == 'REGISTRY':
            assert not isinstance(node.slice, ast.Constant), f'line {node.lineno}'
