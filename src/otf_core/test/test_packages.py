# SPDX-License-Identifier: Apache-2.0
"""Every package is described as REP 149, format 3, has it."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

SRC = Path(__file__).resolve().parents[2]
PACKAGES = sorted(p.parent for p in SRC.glob('*/package.xml'))
ORDER = (
    'name', 'version', 'description', 'maintainer', 'license', 'url', 'author', 'build_depend',
    'build_export_depend', 'buildtool_depend', 'buildtool_export_depend', 'exec_depend', 'depend',
    'doc_depend', 'test_depend', 'conflict', 'replace', 'group_depend', 'member_of_group',
    'export',
)  # fmt: skip
"""Elements of REP 149 (format 3); those that are required once or more stand first."""
MAIL = re.compile(r'[-.\w]+@[-\w]+(\.[-\w]+)+')


@pytest.fixture(params=PACKAGES, ids=lambda p: p.name)
def package(request):
    return request.param


@pytest.fixture
def described(package):
    return ElementTree.parse(package / 'package.xml').getroot()


def test_description_is_of_format_3(package, described):
    assert (described.tag, described.get('format')) == ('package', '3')
    tags = [element.tag for element in described]
    assert set(tags) <= set(ORDER), set(tags) - set(ORDER)
    for tag in ('name', 'version', 'description', 'export'):
        assert tags.count(tag) == 1, tag
    assert described.findtext('name') == package.name
    assert re.fullmatch(r'\d+\.\d+\.\d+', described.findtext('version'))
    maintainers = described.findall('maintainer')
    assert maintainers and all(MAIL.fullmatch(m.get('email')) for m in maintainers)
    depends = [(e.tag, e.text) for e in described if e.tag.endswith('depend')]
    assert len(depends) == len(set(depends)) and all(
        re.fullmatch(r'[-\w]+', t) for _, t in depends
    )
    assert described.find('export').findtext('build_type') in ('ament_python', 'ament_cmake')
