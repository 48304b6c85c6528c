# SPDX-License-Identifier: Apache-2.0
"""README and docs against the software: parameters, links, commands."""

import re
import shlex
import sys
from pathlib import Path

import pytest
import yaml

from otf_core.cli import _parser
from otf_core.files.strict_yaml import Fields
from otf_core.model.machine import machine_from_dict

ROOT = Path(__file__).resolve().parents[3]
PAGES = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    ROOT / 'CHANGELOG.md',
    *sorted((ROOT / 'docs').rglob('*.md')),
]
NAMES = [str(p.relative_to(ROOT)) for p in PAGES]


def test_tables_of_presets_and_options_are_those_of_the_software(monkeypatch):
    """What the tool adds to the path is taken off again."""
    monkeypatch.setattr(sys, 'path', [*sys.path, str(ROOT / 'tools')])
    import page_tables

    for page in page_tables.TABLES:
        text = page.read_text(encoding='utf-8')
        assert page_tables.with_tables(page) == text, 'run python3 tools/page_tables.py'


def test_page_of_machine_yaml_names_every_key_that_is_read(monkeypatch):
    """Every example on the page is read, on a trunnion and together."""
    page = (ROOT / 'docs/machine.md').read_text(encoding='utf-8')
    blocks = [yaml.safe_load(b) for b in re.findall(r'^```yaml\n(.*?)^```', page, re.M | re.S)]
    whole = yaml.safe_load((ROOT / 'examples/trunnion.yaml').read_text(encoding='utf-8'))
    first, *others = blocks
    machine_from_dict(first)
    asked = set()
    for ask in ('take', 'has'):
        original = getattr(Fields, ask)

        def recorded(self, key, original=original):
            asked.add(key)
            return original(self, key)

        monkeypatch.setattr(Fields, ask, recorded)
    for example in others:
        machine_from_dict({**whole, **example})
        whole |= example
    machine = machine_from_dict(whole)
    named = {*machine.axes, *machine.scalars, *map(str, machine.motions), 'column', 'fixture'}
    named |= {*whole['targets'], *whole['signals']}
    assert {'half_angle', 'u_facing', 'acts_on', 'warm_up_s'} <= asked
    assert not {k for k in asked - named if f'`{k}`' not in page and f'{k}:' not in page}


def test_readme_is_read_in_two_minutes():
    assert len(PAGES[0].read_text(encoding='utf-8').splitlines()) <= 130


@pytest.mark.parametrize('page', PAGES, ids=NAMES)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding='utf-8')
    targets = re.findall(r'\]\(([^)#]+)[^)]*\)', text) + re.findall(r'src="([^"]+)"', text)
    for target in targets:
        assert target.startswith('http') or (page.parent / target).exists(), target


def anchors(page):
    """Names that GitHub gives to the headings of a page."""
    text = re.sub(r'```.*?```', '', page.read_text(encoding='utf-8'), flags=re.DOTALL)
    heads = (
        re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', h) for h in re.findall(r'^#+ (.*)$', text, re.M)
    )
    return {re.sub(r'[^\w -]', '', head.lower()).replace(' ', '-') for head in heads}


@pytest.mark.parametrize('page', PAGES, ids=NAMES)
def test_links_lead_to_headings(page):
    for target, anchor in re.findall(
        r'\]\(([^)#\s]*)#([^)]+)\)', page.read_text(encoding='utf-8')
    ):
        if not target.startswith('http') and (not target or target.endswith('.md')):
            assert anchor in anchors(page.parent / target if target else page), (target, anchor)


def test_quality_of_service_is_that_of_the_nodes():
    source = (ROOT / 'src/otf_ros/otf_ros/qos.py').read_text(encoding='utf-8')
    table = (ROOT / 'docs/graph.md').read_text(encoding='utf-8')
    made = re.findall(r'^([A-Z]+) = _profile\((\d+), DurabilityPolicy\.(\w+)(.*)\)', source, re.M)
    assert len(made) >= 9
    for name, depth, durability, rest in made:
        (row,) = re.findall(rf'^\| `{name}` \|.*$', table, re.M)
        _, _, _, depth_said, durability_said, _, _ = row.split('|')
        assert depth_said.strip() == depth, name
        effort = ', best effort' if 'BEST_EFFORT' in rest else ''
        assert durability_said.strip() == durability.lower().replace('_', ' ') + effort, name


@pytest.mark.parametrize('page', PAGES, ids=NAMES)
def test_named_commands_exist(page):
    verbs = next(a for a in _parser()._actions if a.dest == 'verb').choices
    known = {*verbs, 'demo', 'test', 'env', 'emulate-tracker', 'blind'}
    found = set(re.findall(r'\./otf ([a-z-]+)', page.read_text(encoding='utf-8')))
    assert found <= known


def test_commands_of_tutorial_and_commands_are_command_lines():
    for name in ('tutorial', 'tutorial-five-axes', 'commands'):
        text = (ROOT / f'docs/{name}.md').read_text(encoding='utf-8')
        blocks = ''.join(re.findall(r'```\n(.*?)```', text, re.DOTALL))
        lines = re.findall(r'^\./otf (.*?)(?: >.*)?$', blocks, re.MULTILINE)
        assert len(lines) >= 3
        for line in lines:
            verb, *_ = words = shlex.split(line)
            assert _parser().parse_args(words).verb == verb


@pytest.mark.parametrize('page', PAGES, ids=NAMES)
def test_named_files_exist(page):
    text = page.read_text(encoding='utf-8')
    for name in re.findall(r'\b((?:bench|src|tools|bags)/[\w./-]+\.\w+)', text):
        assert (ROOT / name).exists(), name
