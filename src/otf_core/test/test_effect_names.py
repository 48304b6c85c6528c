# SPDX-License-Identifier: Apache-2.0
"""No effect is named outside the catalogue: the other packages read what it says about itself."""

import ast
import re
from pathlib import Path

from source_trees import parsed

import otf_core
from otf_core.effects import REGISTRY
from otf_core.model.sections import DECLARABLE

ROOT = Path(otf_core.__file__).parents[2]
HOMONYMS = set(REGISTRY) & {*DECLARABLE, 'target_offset'}
"""Keys of machine.yaml that are spelled like the effect they declare."""
KEYS_OF_OTHERS = {'sections.py', 'cause_names.py'}
"""Names that machine.yaml may hold; the one table of which inputs and ways to act belong to which
name."""
SOURCES = sorted(
    f for f in ROOT.rglob('*.py')
    if f.name not in KEYS_OF_OTHERS
    and not {'test', 'tests', 'build', 'install'} & set(f.relative_to(ROOT).parts)
    and f.parent.name != 'catalogue'
    and f.name != 'effects_page.py'
)  # fmt: skip


def docstrings(tree):
    """Strings that stand alone: docstrings and descriptions of constants."""
    return {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}


def test_no_effect_is_named_outside_the_catalogue():
    def named(tree):
        exempt = docstrings(tree)
        for node in ast.walk(tree):
            if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
                continue
            words = {w for w in re.findall(r'\w+', node.value) if '_' in w} | {node.value}
            if id(node) not in exempt and words & set(REGISTRY) - HOMONYMS:
                yield f'line {node.lineno}: {words & set(REGISTRY)}'

    found = {str(file.relative_to(ROOT)): list(named(parsed(file))) for file in SOURCES}
    assert len(found) > 300
    assert not {name: lines for name, lines in found.items() if lines}


def test_no_effect_is_taken_from_the_registry_by_a_fixed_name():
    taken = [
        f'{file.name}, line {node.lineno}' for file in SOURCES for node in ast.walk(parsed(file))
        if isinstance(node, ast.Subscript) and getattr(node.value, 'id', '') == 'REGISTRY'
        and isinstance(node.slice, ast.Constant)
    ]  # fmt: skip
    assert not taken
