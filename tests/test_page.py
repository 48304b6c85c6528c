# SPDX-License-Identifier: Apache-2.0
"""The page by itself: what it answers, that it needs nothing from elsewhere, and in a browser."""

import http.client
import json
import re
import shutil
import subprocess
from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest

from otf_core.errors import ConfigError
from otf_core.live.live_run import LiveRun, LiveSolution, RunProgress, now, scene
from otf_core.model.evaluation import VolumeErrors
from otf_core.model.frames import RigidTransform
from otf_core.model.path import NominalPath
from otf_view.page import page
from otf_view.server import PageServer

BROWSER = next(filter(shutil.which, ('chromium', 'chromium-browser', 'google-chrome')), None)
CORNERS = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0], [0, 0, -0.2]])


@contextmanager
def served():
    """A server that is closed in the end."""
    server = PageServer('127.0.0.1', 0)
    try:
        yield server
    finally:
        server.close()


@contextmanager
def asked(server, place):
    """The answer to a request."""
    link = http.client.HTTPConnection(urlsplit(server.url).netloc, timeout=10)
    try:
        link.request('GET', place)
        with link.getresponse() as answer:
            yield answer
    finally:
        link.close()


def a_run():
    """A run with everything in it, and words that are no HTML."""
    run = LiveRun()
    run.set_path(NominalPath(CORNERS))
    run.set_progress(
        RunProgress('BUFFERING', 'driving', 0.42, 75.0, 1234, 7, 0.3, '<b>go</b>', 5, 3, 'nest-1'),
        1.0,
    )
    solved = {'EXX': (12.34e-6, 0.5e-6), 'EAZ': (0.0, float('nan')), 'EXC': (3e-6, 0.2e-6)}
    square = {'C0Y': (-20e-6, 1e-6)}
    words = ('<script>document.title = "broken"</script>',)
    run.solved = LiveSolution(
        True, 'so far, 5 um', 5e-5, 1e-6, 1e-6, solved, square, {'A0C': (8e-6, 1e-6)}, words
    )
    run.set_pose(RigidTransform(np.eye(3), np.array([0.1, -0.4, 0.0])))
    run.volume = VolumeErrors(CORNERS, np.full((4, 3), 1e-5), np.full((4, 3), 1e-6), True)
    run.track.add(0.0, 0.4, 2e-5)
    return run


def test_page_needs_nothing_from_elsewhere():
    text = page()
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    assert not re.findall(r'https?://|@import|url\(', text)
    assert 'state.json' in text and '--ink' in text


def test_server_answers_page_and_state_and_nothing_else():
    with served() as server:
        server.put('now', {'a': 1})
        with asked(server, '/') as answer:
            assert (answer.status, answer.read().decode()) == (200, page())
            assert "default-src 'none'" in answer.headers['Content-Security-Policy']
        with asked(server, '/state.json?x=1') as answer:
            assert json.load(answer) == {'now': {'a': 1}}
        with asked(server, '/../server.py') as answer:
            assert answer.status == 404


def test_report_of_the_result_is_served_once_there_is_one_and_no_other_file(tmp_path):
    with served() as server:
        assert not server.offer(None) and not server.offer(tmp_path)  # not yet
        with asked(server, '/report.html') as answer:
            assert answer.status == 404
        assert 'report' not in server.state
        (tmp_path / 'report.html').write_text('µm', encoding='utf-8')
        (tmp_path / 'error_tables.json').write_text('{}')
        assert server.offer(tmp_path)
        with asked(server, '/report.html') as answer:
            assert (answer.status, answer.read().decode()) == (200, 'µm')
        assert server.state == {'report': '"report.html"'}
        for other in ('/error_tables.json', '/../report.html', '/x/report.html'):
            with asked(server, other) as answer:
                assert answer.status == 404
        (tmp_path / 'report.html').unlink()
        with asked(server, '/report.html') as answer:
            assert answer.status == 404


def test_address_that_is_taken_is_refused_with_what_to_do():
    with served() as server:
        port = urlsplit(server.url).port
        with pytest.raises(ConfigError, match=f'127.0.0.1:{port} cannot be taken.*give another'):
            PageServer('127.0.0.1', port)


@pytest.mark.skipif(BROWSER is None, reason='no browser')
def test_browser_shows_the_run(tmp_path):
    with served() as server:
        server.put('scene', scene(a_run()))
        server.put('now', now(a_run()))
        server.put('ended', True)  # or the browser would wait for more
        command = [
            BROWSER,
            '--headless',
            '--no-sandbox',
            '--disable-gpu',
            '--virtual-time-budget=3000',
        ]
        command += [f'--user-data-dir={tmp_path}', '--dump-dom', server.url]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    shown = re.sub(r'<(script|style)>.*?</\1>', '', done.stdout, flags=re.DOTALL)
    words = ' '.join(re.sub(r'<[^>]*>', ' ', shown).split())
    for expected in ('this is the last they reported', '1,234', '7 (0.6 %)', '0.3 of 0.9 m',
                     'collecting samples 42 % about 1 min 15 s left', 'so far, 5 µm',
                     '3 of 5, target nest-1', 'EXC 3.0 ± 0.2', 'A0C 8.0 ± 1.0',
                     'EXX 12.3 ± 0.5', 'EAZ not known', 'C0Y -20.0 ± 1.0',
                     '20.0 µm', '0.100, -0.400, 0.000 m', '&lt;b&gt;go', 'so far'):  # fmt: skip
        assert expected in words, words
    assert '<title>On-the-fly calibration' in done.stdout
