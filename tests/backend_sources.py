# SPDX-License-Identifier: Apache-2.0
"""For every backend something to stream from, and something that it has to refuse.

A source yields two sets of parameters, by the names they have in the node: usable ones, and what
to change in them so that connecting fails. At least 300 samples have to come of the usable ones,
in no less than two seconds. What follows the yield cleans up.
"""

from pathlib import Path

from cells import write_machine
from emulated import emulator

BAG = Path(__file__).parents[1] / 'bags/y-carries-the-table/bag'


def simulated(folder):
    machine = {'machine_file': str(write_machine(folder))}
    yield {**machine, 'simulated.rate': 150.0}, {'simulated.effects': str(folder / 'none.yaml')}


def replay(folder):
    yield {'replay.bag': str(BAG)}, {'replay.bag': str(folder / 'none')}


def emscon(folder):
    with emulator() as running:
        yield {'emscon.port': running.port}, {'emscon.host': 'no.such.host.invalid'}


SOURCES = {'simulated': simulated, 'replay': replay, 'emscon': emscon}
