# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes of the live view."""

from __future__ import annotations

from dataclasses import dataclass

from otf_core.config import Parameters, parameter


@dataclass(frozen=True)
class ViewerConfig(Parameters):
    """What the markers show."""

    scale: float = parameter(
        0.0, 'factor by which deviations are enlarged; 0: chosen automatically', '', 0, 1e7
    )


@dataclass(frozen=True)
class PageConfig(Parameters):
    """Where the page is served."""

    host: str = parameter(
        '127.0.0.1', 'address to serve the page at; 0.0.0.0: for the whole network, unprotected'
    )
    port: int = parameter(8642, 'TCP port of the page; 0: any that is free', '', 0, 65535)
