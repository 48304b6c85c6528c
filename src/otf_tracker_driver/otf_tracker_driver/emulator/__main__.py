# SPDX-License-Identifier: Apache-2.0
"""Command line: ``./otf emulate-tracker --machine M.yaml``."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import random
import signal
import sys
from collections.abc import Sequence

from otf_core.cli.parser import Parser
from otf_core.config import ParameterInfo, PlannerConfig
from otf_core.errors import InputError, OtfError
from otf_tracker_driver.emulator.faults import Faults, read_faults

SLOWEST, FASTEST = 15e-6, 20e-6
"""Rates that recorded trackers' clocks differ from those of hosts by."""


async def serve(given: argparse.Namespace, faults: Faults, planning: PlannerConfig) -> None:
    """Simulate the cell, listen, say where, serve until interrupted."""
    # scipy takes seconds on a cold computer; mistakes are told before
    from otf_core.model.machine import load_machine
    from otf_core.prediction.calibration_document import load_tables
    from otf_tracker_driver.emulator.cell import Cell
    from otf_tracker_driver.emulator.server import EmulatedTracker

    drift = random.Random(given.seed).uniform(SLOWEST, FASTEST)
    truth = load_tables(given.tables).tables if given.tables else None
    cell = Cell(load_machine(given.machine), planning, given.seed, drift, truth)
    tracker = EmulatedTracker(cell, faults, given.seed, drift)
    try:
        server = await asyncio.start_server(tracker.accept, given.host, given.port)
    except (OSError, OverflowError) as error:
        reason = getattr(error, 'strerror', None) or error
        where = f'{given.host}:{given.port}'
        raise InputError(f'cannot listen on {where} ({reason}); choose another --port') from None
    try:
        interrupted = asyncio.Event()
        for end in (signal.SIGINT, signal.SIGTERM):  # a background job ignores SIGINT else
            asyncio.get_running_loop().add_signal_handler(end, interrupted.set)
        name, number = server.sockets[0].getsockname()[:2]
        sys.stdout.write(f'listening on {name}:{number}\n')
        sys.stdout.flush()
        await interrupted.wait()
    finally:
        await tracker.close(server)


def _described(info: ParameterInfo) -> str:
    unit = f', {info.unit}' if info.unit else ''
    return f'{info.name} ({info.default:g}{unit}): {info.meaning}'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the emulator; returns the exit code."""
    listed = '; '.join(map(_described, Faults.infos()))
    example = 'Example: ./otf emulate-tracker --machine machine.yaml --faults split,busy=0.1'
    parser = Parser('otf emulate-tracker', description=__doc__, epilog=example)
    parser.add_argument('--machine', required=True, help='machine.yaml of the simulated cell')
    parser.add_argument('--host', default='127.0.0.1', help='address to listen on')
    parser.add_argument('--port', type=int, default=700, help='0: any that is free')
    parser.add_argument('--seed', type=int, default=1, help='seed of cell and faults')
    parser.add_argument('--tables', default='', help='true errors of the machine (drawn)')
    parser.add_argument('--faults', default='', help=f'list such as split,busy=0.1; {listed}')
    for name in ('passes', 'levels'):
        info = next(info for info in PlannerConfig.infos() if info.name == name)
        parser.add_argument(f'--{name}', type=int, default=info.default, help=info.meaning)
    given = parser.parse_args(arguments)
    try:
        planning = PlannerConfig(passes=given.passes, levels=given.levels)
        faults = read_faults(given.faults)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(serve(given, faults, planning))
    except OtfError as error:
        sys.stderr.write(f'error: {error}\n')
        return error.exit_code
    return 0


if __name__ == '__main__':
    sys.exit(main())
