# SPDX-License-Identifier: Apache-2.0
"""Every interface is built, and says the unit of its numbers."""

import re
from pathlib import Path

import pytest

import otf_msgs.action
import otf_msgs.msg
import otf_msgs.srv

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(p for kind in ('msg', 'srv', 'action') for p in (ROOT / kind).glob('*.*'))
NUMBER = re.compile(r'(float|u?int)\d+(\[\d*\])?\s+[a-z]\w*\s')


@pytest.mark.parametrize('file', FILES, ids=lambda p: p.name)
def test_interface_is_built_and_its_numbers_have_units(file):
    assert hasattr(getattr(otf_msgs, file.parent.name), file.stem)
    for line in file.read_text(encoding='utf-8').splitlines():
        if NUMBER.match(line):
            assert re.search(r'# \[[^]]+\]', line), line
