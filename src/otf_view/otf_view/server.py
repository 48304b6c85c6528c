# SPDX-License-Identifier: Apache-2.0
"""Serves one page, and the state that it asks for twice a second.

Only looks: nothing can be set or started from here. Every request has a thread of its own, so a
slow reader holds up nobody.
"""

from __future__ import annotations

import json
import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError
from otf_view.page import page

GRACE = 1.0
"""s; so long readers, which ask twice a second, may take to hear of the end."""
SLOWEST = 10.0
"""s; a reader that takes nothing for so long is left."""
REPORT = 'report.html'
"""Of the result, once there is one: beside the page, under its own name."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
POLICY += "; connect-src 'self'; img-src data:; frame-ancestors 'none'"


class PageServer:
    """The page at an address, from now until it is closed.

    Parameters
    ----------
    port : int
        0: any that is free.

    Attributes
    ----------
    state : dict of str to str
        What ``state.json`` holds: JSON by its name.

    Raises
    ------
    ConfigError
        If the address cannot be taken.
    """

    def __init__(self, host: str, port: int) -> None:
        self.state: dict[str, str] = {}
        self._report: Path | None = None
        self._asked = 0.0
        try:
            self._server = ThreadingHTTPServer((host, port), _Handler)
        except OSError as error:
            raise ConfigError(
                f'parameter port: {host}:{port} cannot be taken ({error.strerror}); give another '
                f'one, or 0 for any that is free'
            ) from None
        self._server.daemon_threads = True  # readers that hang are left to the end of the process
        self._server.answer = self._answer  # type: ignore[attr-defined]
        self.url = f'http://{host}:{self._server.server_address[1]}/'
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.2,))
        self._thread.start()

    def put(self, name: str, data: Any) -> None:
        """Replace a part of the state; whoever asks gets it."""
        self.state[name] = json.dumps(data, allow_nan=False, separators=(',', ':'))

    def offer(self, folder: Path | None) -> bool:
        """Serve the report of a result folder and tell readers; False if there is none yet."""
        file = folder / REPORT if folder else None
        if file is None or not file.is_file():
            return False
        self._report = file
        self.put('report', REPORT)
        return True

    def close(self) -> None:
        """Tell readers that this is the end, and stop."""
        self.put('ended', True)
        if time.monotonic() - self._asked < GRACE:
            time.sleep(GRACE)
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _answer(self, place: str) -> tuple[str, str] | None:
        """Type and text of what lies at a place; None if nothing does."""
        if place == '/':
            return 'text/html; charset=utf-8', page()
        if place == '/state.json':
            self._asked = time.monotonic()
            parts = ','.join(f'"{name}":{text}' for name, text in list(self.state.items()))
            return 'application/json', f'{{{parts}}}'
        if place == f'/{REPORT}' and self._report and self._report.is_file():
            return 'text/html; charset=utf-8', self._report.read_text(encoding='utf-8')
        return None


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    protocol_version = 'HTTP/1.1'
    timeout = SLOWEST

    def do_GET(self) -> None:
        answer = self.server.answer(self.path.partition('?')[0])  # type: ignore[attr-defined]
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        kind, content = answer[0], answer[1].encode()
        self.send_response(HTTPStatus.OK)
        self.send_header('Content-Type', kind)
        self.send_header('Content-Length', str(len(content)))
        self.send_header('Cache-Control', 'no-store')
        self.send_header('Content-Security-Policy', POLICY)
        self.send_header('X-Content-Type-Options', 'nosniff')
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *words: object) -> None:
        """Say nothing: the log is for the run."""
