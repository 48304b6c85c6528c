# SPDX-License-Identifier: Apache-2.0
"""Serves one page and keeps it up to date by server-sent events (HTML Living Standard, 9.2).

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

MOST_READERS = 32
"""Pages that are kept up to date at once; more are asked to come back."""
ALIVE = 5.0
"""s; so often at least a reader hears something."""
GRACE = 1.0
"""s; so long readers may take to hear of the end."""
SLOWEST = 10.0
"""s; a reader that takes nothing for so long is left."""
REPORT = 'report.html'
"""Of the result, once there is one: beside the page, under its own name."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
POLICY += "; connect-src 'self'; img-src data:; frame-ancestors 'none'"


class Events:
    """The latest event of every name, for any number of readers."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._latest: dict[str, tuple[int, str]] = {}
        self._count = 0
        self.ended = False

    def put(self, name: str, data: Any) -> None:
        """Replace an event; whoever reads gets it."""
        text = json.dumps(data, allow_nan=False, separators=(',', ':'))
        with self._changed:
            self._count += 1
            self._latest[name] = self._count, text
            self._changed.notify_all()

    def end(self) -> None:
        """Let all readers go."""
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def since(self, seen: int, patience: float) -> tuple[int, list[tuple[str, str]]]:
        """Wait for events after a count; return the count now, and names and data, oldest first.

        None come if there was none in time.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._count > seen or self.ended, patience)
            fresh = sorted((k, name, text) for name, (k, text) in self._latest.items() if k > seen)
            return self._count, [(name, text) for _, name, text in fresh]

    def everything(self) -> str:
        """Return the latest events as one JSON object."""
        with self._changed:
            parts = [f'{json.dumps(name)}:{text}' for name, (_, text) in self._latest.items()]
        return '{' + ','.join(parts) + '}'


class PageServer:
    """The page at an address, from now until it is closed.

    Parameters
    ----------
    port : int
        0: any that is free.

    Raises
    ------
    ConfigError
        If the address cannot be taken.
    """

    def __init__(self, host: str, port: int) -> None:
        self.events = Events()
        self._readers = threading.BoundedSemaphore(MOST_READERS)
        self._offered: dict[str, Path] = {}
        own = {'events': self.events, 'readers': self._readers, 'offered': self._offered}
        kind = type('Handler', (_Handler,), own)
        try:
            self._server = _Server((host, port), kind)
        except OSError as error:
            raise ConfigError(
                f'parameter port: {host}:{port} cannot be taken ({error.strerror}); give another '
                f'one, or 0 for any that is free'
            ) from None
        self.url = f'http://{host}:{self._server.server_address[1]}/'
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.2,))
        self._thread.start()

    def offer(self, folder: Path | None) -> bool:
        """Serve the report of a result folder and tell readers; False if there is none yet."""
        file = folder / REPORT if folder else None
        if file is None or not file.is_file():
            return False
        self._offered[f'/{REPORT}'] = file
        self.events.put('report', REPORT)
        return True

    def close(self) -> None:
        """Tell readers that this is the end, and stop."""
        self.events.put('ended', True)
        self.events.end()
        deadline = time.monotonic() + GRACE
        for _ in range(MOST_READERS):
            self._readers.acquire(timeout=max(0.0, deadline - time.monotonic()))
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    """Leaves readers that hang to the end of the process."""

    daemon_threads = True
    request_queue_size = 2 * MOST_READERS


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    events: Events
    readers: threading.BoundedSemaphore
    offered: dict[str, Path]
    protocol_version = 'HTTP/1.1'
    timeout = SLOWEST

    def do_GET(self) -> None:
        place = self.path.partition('?')[0]
        if place == '/':
            self._answer(page(), 'text/html; charset=utf-8')
        elif place == '/state.json':
            self._answer(self.events.everything(), 'application/json')
        elif place == '/events':
            self._stream()
        elif place in self.offered:
            self._file(self.offered[place])
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _head(self, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header('Content-Type', kind)
        self.send_header('Cache-Control', 'no-store')
        self.send_header('Content-Security-Policy', POLICY)
        self.send_header('X-Content-Type-Options', 'nosniff')

    def _file(self, file: Path) -> None:
        try:
            text = file.read_text(encoding='utf-8')
        except OSError:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self._answer(text, 'text/html; charset=utf-8')

    def _answer(self, text: str, kind: str) -> None:
        content = text.encode()
        self._head(kind)
        self.send_header('Content-Length', str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _stream(self) -> None:
        if not self.readers.acquire(blocking=False):
            self.send_error(
                HTTPStatus.SERVICE_UNAVAILABLE, f'{MOST_READERS} pages are connected already'
            )
            return
        try:
            self._head('text/event-stream')
            self.send_header('Connection', 'close')
            self.end_headers()
            seen = 0
            while True:
                seen, fresh = self.events.since(seen, ALIVE)
                lines = [f'event: {name}\ndata: {text}\n\n' for name, text in fresh]
                self.wfile.write(''.join(lines or [': alive\n\n']).encode())
                self.wfile.flush()
                if self.events.ended:
                    return
        except OSError:
            return  # the reader has left
        finally:
            self.close_connection = True
            self.readers.release()

    def log_message(self, *words: object) -> None:
        """Say nothing: the log is for the run."""
