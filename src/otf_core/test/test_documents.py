# SPDX-License-Identifier: Apache-2.0
"""Documents: what is written is read again; what is missing or ill-typed is refused by path."""

import json
import math
import runpy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from otf_core.arrays import Array, Index
from otf_core.documents import Document, schema_rows, stated
from otf_core.errors import InputError

TOOL = Path(__file__).resolve().parents[3] / 'tools' / 'schema_page.py'


@dataclass(frozen=True)
class Node(Document):
    """A node."""

    value: Array = stated('values', 'm', shape=('n', 3), unknown=True)
    u: float = stated('standard uncertainty', 'm', least=0.0)
    note: str | None = stated('a remark', default=None, sparse=True)


@dataclass(frozen=True)
class Whole(Document):
    """A document."""

    kind: Literal['a', 'b'] = stated('which')
    nodes: Mapping[str, Node] = stated('by name')
    pair: tuple[int, float] = stated('two numbers', unknown=True)
    flags: tuple[bool, ...] = stated('flags', default=())
    counts: Index = stated('counts', shape=(2,), factory=lambda: np.zeros(2, np.int64))
    aside: object = None


WHOLE = Whole('a', {'X': Node(np.array([[1.0, math.nan, 3.0]]), 1e-6)}, (2, math.inf), (True,))


def changed(path, value):
    data = json.loads(json.dumps(WHOLE.to_dict(), allow_nan=False))
    *inner, last = path
    part = data
    for key in inner:
        part = part[key]
    if value is None:
        del part[last]
    else:
        part[last] = value
    return data


def test_what_is_written_is_read_again_and_unknown_fields_are_ignored():
    data = json.loads(json.dumps(WHOLE.to_dict(), allow_nan=False)) | {'more': 1}
    again = Whole.from_dict(data)
    assert again.to_dict() == WHOLE.to_dict()
    assert 'aside' not in data and 'note' not in data['nodes']['X']
    assert np.isnan(again.nodes['X'].value[0, 1]) and math.isnan(again.pair[1])
    assert again.counts.dtype == np.int64


@pytest.mark.parametrize(
    ('path', 'value', 'words'),
    [
        (['kind'], None, 'f: kind: missing'),
        (['kind'], 'c', "f: kind: expected 'a' or 'b'"),
        (['nodes', 'X', 'u'], None, 'f: nodes: X: u: missing'),
        (['nodes', 'X', 'u'], -1.0, 'f: nodes: X: u: must be at least 0'),
        (['nodes', 'X', 'u'], True, 'f: nodes: X: u: expected a finite number'),
        (['nodes', 'X', 'u'], math.nan, 'f: nodes: X: u: expected a finite number'),
        (['nodes', 'X', 'value'], [[1.0, 2.0]], 'f: nodes: X: value: entry 0: has length 2'),
        (['nodes', 'X', 'note'], 5, 'f: nodes: X: note: expected a text'),
        (['nodes'], [1], 'f: nodes: expected a mapping'),
        (['pair'], [1], 'f: pair: expected a list'),
        (['pair'], [1.5, 1.0], 'f: pair: entry 0: expected a whole number'),
        (['flags'], [1], 'f: flags: entry 0: expected true or false'),
    ],
)
def test_what_is_missing_or_ill_typed_is_refused_by_its_path(path, value, words):
    with pytest.raises(InputError) as raised:
        Whole.from_dict(changed(path, value), 'f')
    assert words in str(raised.value)


def test_the_page_of_fields_is_fresh():
    if not TOOL.exists():
        pytest.skip('no tools beside an installed package')
    made = runpy.run_path(str(TOOL))
    page = made['PAGE'].read_text(encoding='utf-8')
    assert made['schema_page']() == page, 'run python3 tools/schema_page.py'


def test_schema_names_every_stated_field_with_unit_and_meaning():
    rows = list(schema_rows(Whole))
    assert ('nodes.NAME.value', 'array (n, 3)', 'm', 'values') in rows
    assert ('nodes.NAME.note', 'or null, text', '', 'a remark') in rows
    assert ('kind', 'a \\| b', '', 'which') in rows
    assert [row[0] for row in rows][-1] == 'counts'
