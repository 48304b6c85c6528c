# SPDX-License-Identifier: Apache-2.0
"""Archives that are installed have the content that they were pinned with."""

import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
ONLY_3_10 = {'exceptiongroup', 'six', 'tomli'}
"""Needed by nothing on later ones; the archives listed are those of 3.11 and later."""


@pytest.fixture
def hashes(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / 'tools'))
    monkeypatch.delitem(sys.modules, 'hashes', raising=False)
    import hashes

    return hashes


def test_archive_of_other_content_is_named_and_an_unknown_one_counted(hashes, tmp_path):
    name, sha256 = next(iter(hashes.known().items()))
    taken = {name: '0' * 64, 'stranger-1.0-py3-none-any.whl': sha256}
    items = [
        {'download_info': {'url': f'https://index/{n}', 'archive_info': {'hash': f'sha256={h}'}}}
        for n, h in taken.items()
    ]
    report = tmp_path / 'report.json'
    report.write_text(json.dumps({'install': items}))
    assert hashes.changed(report) == [name]
    assert hashes.unlisted(report) == ['stranger-1.0-py3-none-any.whl']
    items[0]['download_info']['archive_info']['hash'] = f'sha256={sha256}'
    report.write_text(json.dumps({'install': items[:1]}))
    assert hashes.changed(report) == [] == hashes.unlisted(report)


def test_every_pinned_version_has_a_hash(hashes):
    listed = {
        tuple(re.sub(r'[-_.]+', '-', part).lower() for part in name.split('-')[:2])
        for name in (n.removesuffix('.tar.gz') for n in hashes.known())
    }
    for line in (ROOT / 'requirements/constraints.txt').read_text().splitlines():
        pin, _, marker = line.partition(';')
        if '==' not in pin or '<' in marker:
            continue
        name, version = (re.sub(r'[-_.]+', '-', part.strip()).lower() for part in pin.split('=='))
        if name in ONLY_3_10:
            continue
        assert (name, version) in listed, f'{pin}: python3 tools/hashes.py REPORT.json'
