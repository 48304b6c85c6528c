# SPDX-License-Identifier: Apache-2.0
"""NC programs of machines with rotary axes, read back by a reader that knows the manuals alone."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from test_nc import numbers, rs274  # noqa: F401  (the fixture)
from test_rotary_paths import FEED, trunnion

from otf_core.model.axis_path import driven_through, seconds_of_legs
from otf_core.model.chain import Sight
from otf_core.planning import chains as paths
from otf_core.planning.nc import DIALECTS, programs

STOPS = {'sinumerik': 'G9', 'fanuc': 'G09', 'linuxcnc': 'G61.1', 'twincat': 'G60'}
OFF = {
    'sinumerik': 'TRAFOOF', 'fanuc': 'G49', 'heidenhain': 'M129', 'twincat': '#TRAFO OFF',
    'linuxcnc': 'IDENTITY KINEMATICS',
}  # fmt: skip
ON = {
    'sinumerik': 'TRAORI', 'fanuc': 'G43.4 H01', 'heidenhain': 'M128', 'twincat': '#TRAFO ON',
    'linuxcnc': 'THE KINEMATICS OF THE ROTARY AXES',
}  # fmt: skip


def driven(name, text, axes):
    """Positions, times and stops after the operator's stop, mm, degrees, s."""
    found, at, waiting = [], dict.fromkeys(axes, 0.0), 0
    for raw in text.splitlines():
        line = re.sub(r'^\d+ ', '', raw) if name == 'heidenhain' else raw
        line = re.sub(r'\(.*[A-Za-z]{2}.*\)|;.*|MSG\(.*\)', '', line).strip()
        if re.match(r'(STOP )?M0?0$', line):
            waiting += 1
            if waiting == 1:
                found.append((dict(at), 0.0, True))
        if 'CYCL DEF 9.1' in line and found:
            found[-1] = (*found[-1][:2], True)
        if not re.search(r'\bG0?1\b|^L ', line):
            continue
        before = dict(at)
        whole = 'G91' in line
        for axis in axes:
            word = re.search(rf'(I?){axis}(=IC\()?=?([-+]?\d+\.\d+)', line)
            if word:
                step = whole or word[1] or word[2]
                at[axis] = float(word[3]) + (at[axis] if step else 0.0)
        feed = float(re.search(r'F([\d.]+)', line)[1])
        seconds = feed if name == 'twincat' else 60.0 / feed
        if name == 'heidenhain':
            step = np.array([at[a] - before[a] for a in axes])
            linear = np.linalg.norm(step[:3])
            seconds *= linear if linear > 0 else np.linalg.norm(step[3:])
        if waiting == 1:
            stop = name != 'heidenhain' and line.startswith(STOPS[name] + ' ')
            found.append((dict(at), seconds, stop))
    return SimpleNamespace(
        q=np.array([[p[a] for a in axes] for p, _, _ in found]),
        seconds=np.array([s for _, s, _ in found[1:]]),
        stop=[s for _, _, s in found[1:]],
    )


def planned(link='b'):
    machine = trunnion(link)
    parts = [
        programs.on_increment(machine, p)
        for p in paths.parts_of(machine, paths.candidate_chains(machine, FEED), FEED)
    ]
    return machine, parts


@pytest.mark.parametrize('link', ['b', 'w'])
@pytest.mark.parametrize('name', DIALECTS)
def test_a_program_drives_the_part_that_is_published(name, link):
    machine, parts = planned(link)
    scale = programs.program_units(machine)
    number, part = next((k, p) for k, p in enumerate(parts) if p.words != 'lines')
    text = programs.part_program(DIALECTS[name], machine, part, number, ['head'])
    found = driven(name, text, machine.axis_names)
    np.testing.assert_allclose(found.q, part.path.positions * scale, atol=2e-6)
    wanted = seconds_of_legs(machine, part.path.positions, FEED.feed)
    near = 0.02 if name == 'heidenhain' else 2e-3
    np.testing.assert_allclose(found.seconds, wanted, rtol=near, atol=6e-4)
    smooth = driven_through(machine, part.path.positions)
    assert found.stop[:-1] == [not own for own in smooth] and found.stop[-1]
    assert OFF[name] in text and ON[name] not in text
    assert f'reflector {part.path.target}'.upper() in text.upper()
    assert DIALECTS[name].unchecked[:20] in text


@pytest.mark.parametrize('name', DIALECTS)
def test_the_verification_holds_the_reflector_at_one_place_with_tcp_on(name):
    machine = trunnion()
    part = paths.verification_part(machine)
    text = programs.verification_program(DIALECTS[name], machine, part, 6, [])
    assert ON[name] in text
    found = driven(name, text, ('X', 'Y', 'Z', 'A', 'C'))
    assert len(np.unique(found.q[:, :3].round(1), axis=0)) == 2  # one place for each rotary axis
    place = 1e3 * Sight.of_tool(machine).nominal(part.path.positions)
    np.testing.assert_allclose(found.q[:, :3], place, atol=1e-3)
    angles = np.degrees(part.path.positions[:, [machine.column(a) for a in 'AC']])
    np.testing.assert_allclose(found.q[:, 3:], angles, atol=1e-3)


def test_linuxcnc_interpreter_drives_a_part_in_its_times(rs274):  # noqa: F811
    machine, parts = planned()
    part = next(p for p in parts if p.path.target == 'a')
    text = programs.part_program(DIALECTS['linuxcnc'], machine, part, 3, ['(x)'])
    done = rs274(text)
    assert done.code == 0, done.error
    stop = [name for name, _ in done.moves].index('PROGRAM_STOP')
    at = [numbers(t) for name, t in done.moves[stop:] if name == 'STRAIGHT_FEED']
    own = np.array(at)[:, [0, 1, 2, 3, 5]]
    wanted = part.path.positions[1:] * programs.program_units(machine)
    np.testing.assert_allclose(own, wanted, atol=1e-3)
