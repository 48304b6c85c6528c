# SPDX-License-Identifier: Apache-2.0
"""Units on a terminal: signs where it has them, ASCII for pipes, files and objects."""

import argparse
import io
import json
import sys

import pytest

from otf_core.cli.output import answer, typeset_units


class Terminal(io.StringIO):
    """A terminal that shows the characters of an encoding."""

    def __init__(self, encoding, terminal=True):
        super().__init__()
        self._encoding, self._terminal = encoding, terminal

    @property
    def encoding(self):
        return self._encoding

    def isatty(self):
        return self._terminal


@pytest.mark.parametrize(
    ('stream', 'shown'),
    [
        (Terminal('utf-8'), 'largest 12 ± 2 µm, 3 µrad/m; mean_um of a minimum'),
        (Terminal('latin-1'), 'largest 12 ± 2 µm, 3 µrad/m; mean_um of a minimum'),
        (Terminal('ascii'), 'largest 12 +/- 2 um, 3 urad/m; mean_um of a minimum'),
        (Terminal('utf-8', terminal=False), 'largest 12 +/- 2 um, 3 urad/m; mean_um of a minimum'),
    ],
)
def test_a_terminal_shows_micrometres_with_their_sign_where_it_has_it(stream, shown):
    assert typeset_units('largest 12 +/- 2 um, 3 urad/m; mean_um of a minimum', stream) == shown


def test_words_of_a_verb_are_shown_so_and_objects_stay_as_they_are(monkeypatch):
    terminal = Terminal('utf-8')
    monkeypatch.setattr(sys, 'stdout', terminal)
    monkeypatch.setattr(sys, 'stderr', Terminal('utf-8'))
    arguments = argparse.Namespace(json=False, quiet=False, verb='noise')
    answer(arguments, '0.5 um', {})
    answer(argparse.Namespace(json=True, quiet=True, verb='noise'), '', {'words': '0.5 um'})
    assert terminal.getvalue().startswith('0.5 µm\n')
    assert json.loads(terminal.getvalue().partition('\n')[2])['words'] == '0.5 um'
