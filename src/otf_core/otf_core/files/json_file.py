# SPDX-License-Identifier: Apache-2.0
"""JSON files in, with one clear message for whatever is wrong with them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError
from otf_core.files.strict_yaml import number_words
from otf_core.files.writing import unreadable


def read_json(path: str | Path) -> Any:
    """Return the content of a JSON file.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding='utf-8-sig'))
    except OSError as error:
        raise unreadable(path, error) from None
    except UnicodeDecodeError:
        raise ConfigError(f'{path}: not a text file; expected JSON in UTF-8') from None
    except RecursionError:
        raise ConfigError(f'{path}: not usable JSON (nested too deeply)') from None
    except ValueError as error:
        raise ConfigError(f'{path}: not valid JSON ({number_words(error)})') from None
