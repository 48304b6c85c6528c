# SPDX-License-Identifier: Apache-2.0
"""The files of the package, parsed once."""

import ast
from functools import cache
from pathlib import Path

import otf_core

ROOT = Path(next(iter(otf_core.__path__)))


@cache
def parsed(file):
    return ast.parse(file.read_text())


@cache
def package():
    """Every file of the package and its tree."""
    return {file: parsed(file) for file in sorted(ROOT.rglob('*.py'))}
