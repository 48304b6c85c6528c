# SPDX-License-Identifier: Apache-2.0
"""The recordings of the contract, what they gave, and how far a result may depart from it.

``python3 tests/contract/golden.py NAME ...`` writes golden results anew, from the code as it is:
only where digits are meant to change, and after ``departures`` has said by how much.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from command import HERE, ROOT, otf, read

SHARE = 0.1
"""Most that a value or a u may depart from the golden one, in u."""
SMALL = 1e-10
"""m or rad: below this nothing counts; u of what the gauge sets is zero but for rounding."""


@dataclass(frozen=True)
class Recording:
    """A command on stored recordings; ``truth`` has the errors that they were simulated with."""

    verb: str
    bags: tuple[str, ...]
    machines: tuple[str, ...]
    options: tuple[str, ...] = ()

    @property
    def words(self):
        """The command but for its name and the folder that it fills."""
        machines = [word for m in self.machines for word in ('--machine', m)]
        return [self.verb, *self.bags, *machines, *self.options]

    @property
    def truth(self):
        """File of the true errors, which may not exist."""
        return Path(self.machines[0]).parent / 'truth.json'


def _recorded(name):
    place = ROOT / 'bags' / name
    return Recording('calibrate', (str(place / 'bag'),), (str(place / 'machine.yaml'),))


def _stored(name, verb='calibrate', bags=('bag',), machines=('machine.yaml',), options=()):
    place = HERE / 'recordings' / name
    whole = (tuple(str(place / f) for f in files) for files in (bags, machines))
    return Recording(verb, *whole, options)


RECORDINGS = {
    'all-axes-carry-the-target': _recorded('all-axes-carry-the-target'),
    'y-carries-the-table': _recorded('y-carries-the-table'),
    'x-and-y-carry-the-table': _recorded('x-and-y-carry-the-table'),
    'trunnion': _recorded('trunnion'),
    'head': _stored('head'),
    'rotary-table': _stored('rotary-table'),
    'standstill': _stored('standstill', options=('--method', 'standstill')),
    'two-targets': _stored(
        'two-targets', bags=('run1', 'run2'), machines=('machine.yaml', 'longer.yaml')
    ),
    'moved-tracker': _stored('moved-tracker'),
    'backlash': _stored('backlash'),
    'explained': _stored('explained', 'diagnose'),
    'unknown': _stored('unknown', 'diagnose'),
}
TABLES = [name for name, own in RECORDINGS.items() if own.verb == 'calibrate']
GAPS = [name for name, own in RECORDINGS.items() if own.verb == 'diagnose']


def golden_file(name):
    """Where the golden result lies."""
    return HERE / 'golden' / f'{name}.json'


def reduced(code, document):
    """What is compared of a result: error_tables.json or gap.json, and the exit code."""
    if 'causes' in document:
        return {'exit': code, **_reduced_gap(document)}
    scalars = ('squareness', 'location')
    return {
        'exit': code,
        'motions': {name: _reduced_table(own) for name, own in document['motions'].items()},
        **{
            kind: {name: _reduced_scalar(own) for name, own in document.get(kind, {}).items()}
            for kind in scalars
        },
        'targets': {
            name: {'value': _rounded(own['place']), 'u': _rounded(_run_u(own))}
            for name, own in document.get('targets', {}).items()
        },
        'reversal': document['reversal']['model'],
        'not_identifiable': sorted(document['not_identifiable']),
    }


def _run_u(entry):
    """Noise and misfit of the run alone, k = 1: ``u_run`` where ``u`` holds more."""
    return entry.get('u_run', entry.get('u', 0.0))


def _reduced_table(own):
    kept = {key: _rounded(own[key]) for key in ('position', 'value')}
    return {**kept, 'u': _rounded(_run_u(own)), 'identifiable': own['identifiable']}


def _reduced_scalar(own):
    if 'value' not in own:
        return {'value': None, 'u': None}
    return {'value': _rounded(own['value']), 'u': _rounded(_run_u(own))}


def _reduced_gap(document):
    causes = [
        {key: cause[key] for key in ('effect', 'axes', 'parameters', 'u')}
        for cause in document['causes']
    ]
    sizes = ('measured_um', 'simulated_um', 'before_um', 'after_um')
    gap = {key: round(document['gap'][key], 4) for key in sizes}
    return {'verdict': document['verdict'], 'causes': causes, 'gap': gap}


def _rounded(value):
    """Far below u, and short in the file."""
    if isinstance(value, list):
        return [_rounded(v) for v in value]
    return None if value is None else float(f'{float(value):.7g}') if abs(value) > 1e-15 else 0.0


def departures(golden, found, share=SHARE):
    """What departs from golden tables by more than a share of u: sentences, and the worst."""
    said, worst = [], 0.0
    for key in ('exit', 'reversal', 'not_identifiable'):
        if golden[key] != found[key]:
            said.append(f'{key}: {found[key]}, was {golden[key]}')
    for kind in ('motions', 'squareness', 'location', 'targets'):
        if set(golden[kind]) != set(found[kind]):
            said.append(f'{kind}: {sorted(found[kind])}, were {sorted(golden[kind])}')
            continue
        for name, was in golden[kind].items():
            ratio = _ratio(was, found[kind][name])
            worst = max(worst, ratio)
            if ratio > share:
                said.append(f'{name}: off by {ratio:.2f} u')
    return said, worst


def gap_departures(golden, found):
    """The same for a diagnosis: verdict and causes are the same, their sizes within u."""
    said, worst = [], 0.0
    for key in ('exit', 'verdict'):
        if golden[key] != found[key]:
            said.append(f'{key}: {found[key]}, was {golden[key]}')
    causes = [[(c['effect'], c['axes']) for c in own['causes']] for own in (golden, found)]
    if causes[0] != causes[1]:
        return [*said, f'causes: {causes[1]}, were {causes[0]}'], np.inf
    for was, now in zip(golden['causes'], found['causes'], strict=True):
        for name, u in was['u'].items():
            ratio = abs(now['parameters'].get(name, np.inf) - was['parameters'][name]) / u
            worst = max(worst, ratio)
            if ratio > 1.0:
                said.append(f'{was["effect"]}: {name} is off by {ratio:.2f} u')
    for key, size in golden['gap'].items():
        if abs(found['gap'][key] - size) > 0.1 + 0.1 * size:
            said.append(f'gap: {key} {found["gap"][key]}, was {size}')
    return said, worst


def _ratio(was, now):
    """Largest change of value and u, in u, at the positions of the golden table."""
    if was['value'] is None or now['value'] is None:
        return 0.0 if was['value'] == now['value'] else np.inf
    if was.get('identifiable', True) != now.get('identifiable', True):
        return np.inf
    old_value, old_u = np.atleast_1d(was['value']), np.atleast_1d(was['u'])
    new_value, new_u = np.atleast_1d(now['value']), np.atleast_1d(now['u'])
    if 'position' in was:  # nodes may lie closer than before
        at = [np.searchsorted(now['position'], p - 1e-9) for p in was['position']]
        if max(at) >= len(now['position']):
            return np.inf
        new_value, new_u = np.interp(was['position'], now['position'], new_value), new_u[at]
    change = np.maximum(np.abs(new_value - old_value), np.abs(new_u - old_u))
    return float(np.max(np.maximum(change - SMALL, 0.0) / np.maximum(old_u, SMALL)))


def write(name, command=otf):
    """Write the golden result of a recording from the code as it is."""
    own = RECORDINGS[name]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'out'
        done = command(*own.words, '--out', out)
        (file,) = out.glob('gap.json' if own.verb == 'diagnose' else 'error_tables.json')
        text = json.dumps(reduced(done.code, read(file)), separators=(',', ':'))
    golden_file(name).parent.mkdir(exist_ok=True)
    golden_file(name).write_text(text.replace(',"E', ',\n"E') + '\n', encoding='utf-8')


if __name__ == '__main__':
    for chosen in sys.argv[1:] or RECORDINGS:
        write(chosen)
        print(chosen, flush=True)
