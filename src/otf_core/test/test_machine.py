# SPDX-License-Identifier: Apache-2.0
"""Machine descriptions: good ones are read as they stand, every wrong one names file and key."""

import pytest

from otf_core.errors import ConfigError
from otf_core.model.machine import load_machine, machine_from_dict

GOOD = """name: cell-600
chain: w-b-X-Y-Z-t
axes:
  X: {min: 0.0, max: 0.6, table_pitch: 0.03}
  Y: {min: 0.0, max: 0.5, table_pitch: 0.04}
  Z: {min: -0.4, max: 0.0, table_pitch: 0.05}
target_offset: [0.01, 0.02, -0.15]
tracker:
  u_range: 0.5e-6
  u_angle: 2.0e-6
"""


@pytest.fixture
def read(tmp_path):
    """Read a text as machine.yaml."""

    def reader(text):
        file = tmp_path / 'machine.yaml'
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_machine(file)

    return reader


def test_values_are_read_as_they_stand(read):
    machine = read(GOOD)
    assert machine.name == 'cell-600'
    assert str(machine.chain) == 'w-b-X-Y-Z-t'
    assert machine.lower.tolist() == [0.0, 0.0, -0.4]
    assert machine.upper.tolist() == [0.6, 0.5, 0.0]
    assert [machine.axes[a].table_pitch for a in 'XYZ'] == [0.03, 0.04, 0.05]
    assert machine.target_offset.tolist() == [0.01, 0.02, -0.15]
    assert (machine.tracker.u_range, machine.tracker.u_angle) == (0.5e-6, 2e-6)


@pytest.mark.parametrize('number', ['5e-07', '5E-7', '.5e-6', '0.5e-6', '0.0000005', '+5e-7'])
def test_every_way_to_write_a_small_number_is_a_number(read, number):
    assert read(GOOD.replace('0.5e-6', number)).tracker.u_range == float(number)


@pytest.mark.parametrize(
    ('wrong', 'meant'), [('chian', 'chain'), ('Name', 'name'), ('target_ofset', 'target_offset')]
)
def test_a_key_that_is_misspelt_is_named_with_the_one_that_is_meant(read, wrong, meant):
    with pytest.raises(ConfigError, match=rf'machine.yaml: {wrong}: .*{meant}'):
        read(GOOD.replace(f'{meant}:', f'{wrong}:', 1))


@pytest.mark.parametrize(
    ('old', 'new', 'key'),
    [
        ('name: cell-600\n', '', 'name: missing'),
        ('  u_angle: 2.0e-6\n', '', 'tracker: u_angle: missing'),
        (', table_pitch: 0.04', '', 'axes: Y: table_pitch: missing'),
        ('  Z: {', '  W: {', 'axes: Z: missing'),
        ('name: cell-600', 'name: cell-600\nfeeed: 3', 'feeed: unknown'),
        ('max: 0.5,', 'max: 0.5, maximum: 1,', 'axes: Y: maximum: unknown'),
        ('name: cell-600', 'name: a\nname: b', "'name' appears twice"),
        ('min: 0.0, max: 0.6', 'min: 0.0, min: 0.0, max: 0.6', "'min' appears twice"),
        ('name: cell-600', 'name: 600', 'name: expected text'),
        ('name: cell-600', r'name: "a\nG0 X100"', 'name: expected one line without control'),
        ('max: 0.6', 'max: 0.6 m', 'axes: X: max:'),
        ('table_pitch: 0.03', "table_pitch: '0.03'", 'axes: X: table_pitch:'),
        ('max: 0.6', 'max: true', 'axes: X: max:'),
        ('max: 0.6', 'max: 600', 'axes: X: max:'),
        ('max: 0.6', 'max: .nan', 'axes: X: max: nan'),
        ('min: 0.0, max: 0.6', 'min: 0.6, max: 0.6', 'axes: X: max:'),
        ('table_pitch: 0.03', 'table_pitch: 0', 'axes: X: table_pitch:'),
        ('table_pitch: 0.03', 'table_pitch: 30', 'axes: X: table_pitch: 30'),
        ('[0.01, 0.02, -0.15]', '[0.01, 0.02]', 'target_offset: expected a list of 3'),
        ('[0.01, 0.02, -0.15]', '[0.01, 0.02, .nan]', 'target_offset: nan'),
        ('[0.01, 0.02, -0.15]', '[10, 20, -150]', 'target_offset: [10.0, 20.0, -150.0] m'),
        ('0.5e-6', '0', 'tracker: u_range:'),
        ('0.5e-6', '0.5', 'tracker: u_range:'),
        ('0.5e-6', '0.5 um', 'tracker: u_range:'),
        (
            'tracker:\n  u_range: 0.5e-6\n  u_angle: 2.0e-6\n',
            'tracker: 3\n',
            'tracker: expected a',
        ),
    ],
)
def test_wrong_content_names_file_and_key(read, old, new, key):
    assert GOOD.count(old) == 1
    with pytest.raises(ConfigError) as caught:
        read(GOOD.replace(old, new))
    message = str(caught.value)
    assert 'machine.yaml: ' in message
    assert key in message
    assert '\n' not in message


@pytest.mark.parametrize(
    'chain',
    ['w-b-X-Y-Z-Z-t', 'w-b-X-Y-Y-t', 'b-w-X-Y-Z-t', 'w-X-Y-Z-t', 'w-b-b-X-Y-Z-t',
     'X-b-Y-Z', 'w-b-X-Y-Z-t-', 'w-b-x-y-z-t', 'w b X Y Z t', 'w-b-X-Y-Z-C-C-t',
     'w-A-B-b-X-Y-Z-C-t', 'wbXYZt', 'w-t'],
)  # fmt: skip
def test_chain_that_is_none_is_refused_with_its_text(read, chain):
    with pytest.raises(ConfigError, match=r'machine\.yaml: chain: ') as caught:
        read(GOOD.replace('w-b-X-Y-Z-t', chain))
    assert f"'{chain}'" in str(caught.value)


@pytest.mark.parametrize(
    'text',
    [
        *('', '[]', 'a: [', 'a: b: c', '\ta: 1', GOOD + '---\n' + GOOD, 'a: *b', 'name: "x'),
        *(b'\xff\xfe\x00\x01', b'name: \xe4\n', '[' * 3000),
        GOOD.replace('cell-600', '{{ cell_name }}'),  # template that was not filled in
        GOOD.replace('name:', '? [name]\n:'),
        GOOD.replace('cell-600', '2023-13-45'),  # no such month
        GOOD.replace('cell-600', '!!int x'),
        GOOD.replace('axes:', 'axes: !!map [1]\nmore:'),
        GOOD.replace('max: 0.6', 'max: 1' + 400 * '0'),
        GOOD.replace('cell-600', '!!python/object/apply:os.getcwd []'),
    ],
)
def test_what_is_no_yaml_of_a_machine_is_refused_with_the_file(read, text):
    with pytest.raises(ConfigError, match=r'machine\.yaml'):
        read(text)


FIVE = """\
name: u5
chain: w-C-A-b-Y-X-Z-t
axes:
  X: {min: -0.3, max: 0.3, table_pitch: 0.03}
  Y: {min: -0.25, max: 0.25, table_pitch: 0.03}
  Z: {min: 0.0, max: 0.6, table_pitch: 0.03}
  A: {kind: rotary, min: -0.5, max: 1.9, table_pitch: 0.1, direction: [2, 0, 0], centre: [0, 0, 0.05]}
  C: {kind: rotary, min: 0, max: 6.2832, table_pitch: 0.2, direction: [0, 0, 1], centre: [0, 0, 0], endless: true}
target_offset: [0.0, 0.0, -0.15]
tracker: {u_range: 0.5e-6, u_angle: 2.0e-6, link: b}
targets:
  tool: {u: 5.0e-6}
  nest-1: {link: w, place: [0.2, 0.03, 0.1], u: 1.0e-3}
"""  # noqa: E501


def test_five_axes_are_read_and_written_back(read):
    machine = read(FIVE)
    assert machine.axis_names == ('X', 'Y', 'Z', 'A', 'C')
    assert machine.rotary_names == ('A', 'C')
    assert machine.axes['A'].direction == (1.0, 0.0, 0.0)
    assert machine.location == ('Y0A', 'Z0A', 'B0A', 'C0A', 'X0C', 'Y0C', 'A0C', 'B0C')
    assert len(machine.motions) == 30
    assert machine.targets['tool'].place == (0.0, 0.0, -0.15)
    assert machine.targets['tool'].u == 5e-6
    assert machine_from_dict(machine.to_dict()).to_dict() == machine.to_dict()


@pytest.mark.parametrize(
    ('old', 'new', 'words'),
    [
        ('max: 6.2832', 'max: 360', r'C: max: .*degrees.* 6\.28319'),
        ('table_pitch: 0.1,', 'table_pitch: 5,', 'axes: A: table_pitch: .*degrees'),
        ('kind: rotary, min: -0.5', 'min: -0.5', 'axes: A: kind: missing'),
        ('[2, 0, 0]', '[0, 0, 0]', 'axes: A: direction:'),
        (', centre: [0, 0, 0.05]', '', 'axes: A: centre: missing'),
        ('endless: true', 'endless: 1', 'axes: C: endless:'),
        ('max: 6.2832', 'max: 3.1', 'axes: C: max:'),
        ('[0, 0, 0.05]', '[0, 0, 50.0]', 'axes: A: centre: .*mm'),
        ('w-C-A-b', 'w-C-b', 'axes: A: .* w-C-b-Y-X-Z-t'),
        ('min: -0.3, max', 'kind: rotary, min: -0.3, max', "axes: X: kind: must be 'linear'"),
        ('link: b', 'link: t', 'tracker: link:'),
        ('link: w', 'link: b', 'targets: nest-1: link:'),
        ('u: 1.0e-3', 'u: 1.0', 'targets: nest-1: u:'),
        ('place: [0.2', 'place: [200', 'targets: nest-1: place: .*unit'),
        ('tool: {u', 'tool: {link: w, u', "targets: tool: place: the target 'tool'"),
        ('w-C-A-b', 'w-C-A-B-b', '3 rotary axes'),
        ('u: 1.0e-3}', 'u: 1.0e-3, height: 1}', 'targets: nest-1: height:'),
        ('u: 1.0e-3}', 'u: 1.0e-3, facings: 2.5}', 'facings: .* 2.5'),
        ('u: 1.0e-3}', 'u: 1.0e-3, facings: 90}', 'facings: 90 is out of range'),
        ('u: 1.0e-3}', 'u: 0.0, facings: 3}', 'nest-1: facings:'),
        ('u: 1.0e-3}', 'u: 1.0e-3, u_facing: 1.0e-6}', 'u_facing:'),
        ('u: 5.0e-6}', 'u: 5.0e-6, facings: 3}', 'tool: facings:'),
    ],
)  # fmt: skip
def test_mistakes_in_rotary_axes_and_targets_name_the_key(read, old, new, words):
    assert FIVE.count(old) == 1
    with pytest.raises(ConfigError, match=words):
        read(FIVE.replace(old, new))
