# SPDX-License-Identifier: Apache-2.0
"""For every backend something to stream from, and something that it has to refuse.

A source yields two sets of parameters, by the names they have in the node: usable ones, and what
to change in them so that connecting fails. At least 300 samples have to come of the usable ones,
in no less than two seconds. What follows the yield cleans up.
"""

import json
from pathlib import Path

from cells import write_machine
from emulated import emulator
from streaming import CARTESIAN, sender

BAG = Path(__file__).parents[1] / 'bags/y-carries-the-table/bag'


def simulated(folder):
    machine = {'machine_file': str(write_machine(folder))}
    yield {**machine, 'simulated.rate': 150.0}, {'simulated.effects': str(folder / 'none.yaml')}


def replay(folder):
    yield {'replay.bag': str(BAG)}, {'replay.bag': str(folder / 'none')}


def emscon(folder):
    with emulator() as running:
        yield {'emscon.port': running.port}, {'emscon.reflector': 'no-such-reflector'}


def stream(folder):
    with sender('tcp', CARTESIAN) as source:
        file = folder / 'source.yaml'
        file.write_text(json.dumps({**CARTESIAN, 'source': source.url}))
        yield {'stream.source': str(file)}, {'stream.source': str(folder / 'none.yaml')}


SOURCES = {'simulated': simulated, 'replay': replay, 'emscon': emscon, 'stream': stream}
