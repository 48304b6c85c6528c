# SPDX-License-Identifier: Apache-2.0
"""All kinds of files, and which one a file is."""

from __future__ import annotations

from pathlib import Path

from otf_core.errors import ConfigError
from otf_core.files.writing import unreadable
from otf_core.info.array_kinds import DIRECT, POINTS, RESIDUALS
from otf_core.info.bag_kind import BAG, TABLE
from otf_core.info.export_kind import EXPORT
from otf_core.info.folder_kind import FOLDER
from otf_core.info.json_kinds import JSON_KINDS, OTHER
from otf_core.info.kind import Explained, Kind
from otf_core.info.program_kind import PROGRAM
from otf_core.info.yaml_kinds import EFFECTS, MACHINE

KINDS: tuple[Kind, ...] = (
    BAG,
    FOLDER,
    EXPORT,
    *JSON_KINDS,
    OTHER,
    EFFECTS,
    MACHINE,
    RESIDUALS,
    DIRECT,
    POINTS,
    PROGRAM,
    TABLE,
)
"""The first that fits counts; a further one is one file and one line here."""


def explain(name: str | Path) -> tuple[Kind, Explained]:
    """Say what a file is and says.

    Raises
    ------
    ConfigError
        If it cannot be read or is of no kind that otf knows.
    InputError
        If it is a bag that cannot be read.
    """
    path = Path(name)
    try:
        path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    for kind in KINDS:
        if kind.is_one(path):
            return kind, kind.explain(path)
    known = ', '.join(kind.name for kind in KINDS)
    raise ConfigError(f'{path}: is nothing that otf writes or reads; known: {known}')
