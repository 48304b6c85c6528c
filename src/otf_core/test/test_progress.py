# SPDX-License-Identifier: Apache-2.0
"""What is shown of a job under way: on a terminal, in a log, on request nothing."""

import io
import sys
import time

import pytest

from otf_core.cli import output
from otf_core.cli.output import note
from otf_core.live.stages import CALIBRATE, DIAGNOSE, PLAN, of_whole


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    monkeypatch.setattr(output, 'SILENT', {True: 0.0, False: 0.0})
    monkeypatch.setattr(output, 'TICK', 0.01)


def shown(monkeypatch, stream):
    """What a job of three stages writes to a stream."""
    monkeypatch.setattr(sys, 'stderr', stream)
    with output.progress_of('reading', CALIBRATE) as tell:
        for stage in ('aligning', 'solving', 'aligning'):
            tell(stage, 0.0)
            until = time.monotonic() + 5.0
            while f'{stage} ' not in stream.getvalue() and time.monotonic() < until:
                time.sleep(0.01)
        note('a warning')
    return stream.getvalue()


def test_a_terminal_has_one_line_that_is_gone_at_the_end(monkeypatch):
    text = shown(monkeypatch, Terminal())
    assert text.count('\n') == 1  # that of the warning
    lines = text.split('\r')
    assert any(line.startswith('aligning  0 s  5 %') for line in lines)
    assert any(line.startswith('solving  0 s  30 %') for line in lines)
    warned = lines.index('a warning\n')
    assert len(lines[warned - 1]) >= 18 and not lines[warned - 1].strip()  # blanks over the line
    assert not ''.join(lines[warned + 1 :]).strip() or text.endswith('\r')


def test_a_log_has_a_line_a_stage(monkeypatch):
    text = shown(monkeypatch, io.StringIO())
    stages = [line for line in text.splitlines() if line != 'otf: reading ...']
    assert stages == [
        'otf: aligning ...', 'otf: solving ...', 'otf: aligning ...', 'a warning',
    ]  # fmt: skip


@pytest.mark.parametrize('spans', [CALIBRATE, DIAGNOSE, PLAN])
def test_stages_follow_each_other_and_never_go_back(spans):
    ends = [end for span in spans.values() for end in span]
    assert ends == sorted(ends) and ends[0] == 0.0 and ends[-1] == 1.0
    told = []
    tell = of_whole(spans, lambda stage, share: told.append(share))
    for stage in (*spans, *spans, 'something else'):
        tell(stage, 0.5)
    assert told == sorted(told) and told[-1] < 1.0
