# SPDX-License-Identifier: Apache-2.0
"""What the report of a calibration costs: processor time of its sections and of its page.

Usage: PYTHONPATH=src/otf_core python bench/report_cost.py [--repeats 5]
"""

from __future__ import annotations

import argparse
import time

from calibrate_jobs import MACHINE
from child import circumstances, spread
from markdown import heading, row

import otf_core
from otf_core.reports.calibration import calibration_html, calibration_sections, facts_of
from otf_core.reports.page import sections_to_text

SEED = 20_260_012


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--repeats', type=int, default=5)
    repeats = parser.parse_args().repeats
    machine = otf_core.load_machine(MACHINE)
    recording = otf_core.simulate(machine, seed=SEED).recording
    start = time.process_time()
    result = otf_core.calibrate(recording)
    calibrating = time.process_time() - start
    text, page, html = [], [], ''
    for _ in range(repeats):
        facts = facts_of(result)
        start = time.process_time()
        sections_to_text(calibration_sections(facts))
        text.append(time.process_time() - start)
        facts = facts_of(result)
        start = time.process_time()
        html = calibration_html(facts)
        page.append(time.process_time() - start)
    print(
        f'{len(recording.samples)} samples over {recording.samples.time[-1]:.0f} s, '
        f'{result.fit.pieces} path pieces; {repeats} times, {circumstances()}\n'
    )
    print(heading(('', 'processor s')))
    print(row(('calibrating', f'{calibrating:.2f}')))
    print(row(('sections as text, as a terminal shows them', spread(text))))
    print(row((f'sections as a page of {len(html.encode()) / 1e3:.0f} kB', spread(page))))


if __name__ == '__main__':
    main()
