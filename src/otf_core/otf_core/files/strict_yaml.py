# SPDX-License-Identifier: Apache-2.0
"""Strict YAML and JSON: duplicate, unknown, missing or mistyped keys are errors that name it."""

from __future__ import annotations

import json
import math
import re
import reprlib
import unicodedata
from collections.abc import Collection, Hashable, Iterable, Mapping
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

from otf_core.errors import ConfigError
from otf_core.files.message_text import shortened
from otf_core.files.writing import unreadable

# Strict YAML: duplicate, unknown, missing and mistyped keys are errors that name the key.

MAX_NESTING = 100
"""Levels of nesting; each costs the parser more than the one before."""
SIMILARITY = 0.9
"""Likeness from which a key may be another one misspelt; u_range and u_angle have 0.86."""


@cache
def _loader() -> Any:
    """Safe loader that reads 5e-07 as a number (YAML 1.2) and refuses duplicate keys."""
    import yaml  # loaded on use: what reads JSON alone needs none

    class Loader(yaml.SafeLoader):
        level = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.level += 1
            if self.level > MAX_NESTING:
                raise RecursionError
            node = super().compose_node(parent, index)
            self.level -= 1
            return node

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
            seen = set()
            for key_node, _ in node.value:
                key = self.construct_object(key_node, deep=True)
                if isinstance(key, Hashable) and key in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key '{key}' appears twice", key_node.start_mark
                    )
                seen.add(key)
            return super().construct_mapping(node, deep)

    Loader.add_implicit_resolver(
        'tag:yaml.org,2002:float',
        re.compile(r'^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$'),
        list('-+.0123456789'),
    )
    return Loader


_WORDS = reprlib.Repr()
_WORDS.maxlevel, _WORDS.maxlist, _WORDS.maxdict, _WORDS.maxtuple = 2, 4, 4, 4
_WORDS.maxstring = _WORDS.maxother = _WORDS.maxlong = 60
_MAX_SHOWN_LETTERS = 250
_NOT_IN_A_LINE = ('Cc', 'Cs', 'Zl', 'Zp')
"""Kinds of characters in Unicode: controls, halves of others, ends of lines and paragraphs."""


def value_text(value: Any) -> str:
    """A value as text of bounded length, however large or nested it is."""
    try:
        text = _WORDS.repr(value)
    except ValueError:  # Python refuses to write integers of thousands of digits
        return 'a number with thousands of digits'
    return shortened(text, _MAX_SHOWN_LETTERS)


def number_words(error: Exception) -> str:
    """First line of what a parser says, in words of ours where Python refuses a number."""
    text = str(error).partition('\n')[0]
    return 'a number with thousands of digits' if 'integer string conversion' in text else text


def read_yaml_bytes(path: str | Path) -> bytes:
    """Return the bytes of a file; ConfigError if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None


def parse_yaml(data: bytes, path: str | Path) -> Any:
    """Return the content of a YAML file whose bytes were read.

    Raises
    ------
    ConfigError
        If it is not a text or no YAML; says line and column.
    """
    import yaml

    try:
        text = data.decode('utf-8')
    except UnicodeDecodeError:
        raise ConfigError(f'{path}: not a text file; expected YAML in UTF-8') from None
    try:
        return yaml.load(text, Loader=_loader())
    except RecursionError:
        raise ConfigError(f'{path}: not usable YAML: nested too deeply') from None
    except (TypeError, ValueError) as error:
        raise ConfigError(f'{path}: not usable YAML: {number_words(error)}') from None
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        place = f' at line {mark.line + 1}, column {mark.column + 1}' if mark else ''
        problem = getattr(error, 'problem', None) or str(error).splitlines()[0]
        raise ConfigError(f'{path}: not valid YAML{place}: {problem}') from None


def read_yaml(path: str | Path) -> Any:
    """Return the content of one YAML file; raises as ``parse_yaml``, or if it is unreadable."""
    return parse_yaml(read_yaml_bytes(path), path)


def _other_unit(value: float, low: float, high: float, unit: str) -> str:
    """Ask for the unit that would make sense of a number, if there is one."""
    for asked, factor in {'m': {'mm': 1e-3, 'um': 1e-6}, 'rad': {'urad': 1e-6}}.get(
        unit, {}
    ).items():
        plausible = high if asked == 'mm' else 1e-2 * high
        if low < factor * value <= plausible and not (asked == 'mm' and high < 1):
            return f'; is it in {asked}? Write {factor * value:g} {unit}'
    return ''


class Fields:
    """The keys of one mapping, taken one by one; what is left over is unknown.

    Parameters
    ----------
    data : object
        Expected to be a mapping; anything else is a ConfigError.
    where : str
        File and key path, for messages.
    known : collection of str
        All keys that there are, if they are known: another one is named before a missing one.
    """

    def __init__(self, data: Any, where: str, known: Collection[str] = ()) -> None:
        if not isinstance(data, Mapping):
            kind = 'nothing' if data is None else type(data).__name__
            raise ConfigError(f'{where}: expected a mapping of keys to values, got {kind}')
        for key in data:
            if not isinstance(key, str):
                raise ConfigError(
                    f'{where}: {value_text(key)} is not a key; decimals have a point, as in 0.3'
                )
        self._data = dict(data)
        self._where = where
        self._taken: list[str] = []
        self._known = known

    @property
    def where(self) -> str:
        """File and key path, for messages."""
        return self._where

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raise a ConfigError about one key."""
        raise ConfigError(f'{self._where}: {shortened(key)}: {problem}')

    @property
    def keys(self) -> list[str]:
        """Keys that nobody has asked for yet, in their order."""
        return [str(key) for key in self._data]

    def has(self, key: str) -> bool:
        """Return whether an optional key is there."""
        return key in self._data

    def take(self, key: str) -> Any:
        """Return the value of a key that must be there."""
        self._taken.append(key)
        if key not in self._data:
            near = [
                k for k in self._data if get_close_matches(key, [k.lower()], cutoff=SIMILARITY)
            ]
            near = near or [k for k in self._data if self._known and k not in self._known]
            if near:
                self.fail(near[0], f'unknown key; did you mean {key}?')
            self.fail(key, 'missing')
        return self._data.pop(key)

    def text(self, key: str) -> str:
        """Return a text that is not empty."""
        value = self.take(key)
        if not isinstance(value, str) or not value.strip():
            self.fail(key, f'expected text, got {value_text(value)}')
        return value

    def line(self, key: str) -> str:
        """Return a text that is not empty, in one line and without control characters."""
        value = self.text(key)
        if any(unicodedata.category(c) in _NOT_IN_A_LINE for c in value):
            self.fail(
                key, f'expected one line without control characters, got {value_text(value)}'
            )
        return value

    def mapping(self, key: str) -> Fields:
        """Return the fields of a nested mapping."""
        return Fields(self.take(key), f'{self._where}: {key}')

    def number(
        self, key: str, low: float, high: float, unit: str, *, closed: bool = False
    ) -> float:
        """Return a number in (low, high], or in [low, high] if closed."""
        value = self._finite(key, self.take(key))
        if not (low <= value if closed else low < value) or value > high:
            bound = 'at least' if closed else 'above'
            self.fail(key, f'{value:g} is out of range; must be {bound} {low:g} and at most '
                           f'{high:g} {unit}{_other_unit(value, low, high, unit)}')  # fmt: skip
        return value

    def vector(self, key: str, size: int) -> list[float]:
        """Return a list of numbers of the given size."""
        value = self.take(key)
        if not isinstance(value, list) or len(value) != size:
            self.fail(key, f'expected a list of {size} numbers, got {value_text(value)}')
        return [self._finite(key, v) for v in value]

    def done(self, known: Iterable[str] = ()) -> None:
        """Refuse keys that nobody asked for; ``known``: optional ones, for the message."""
        if self._data:
            known = ', '.join(known or self._taken)
            self.fail(str(next(iter(self._data))), f'unknown key; known here: {known}')

    def _finite(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.fail(key, f'expected a plain number in SI units, got {value_text(value)}')
        try:
            number = float(value)
        except OverflowError:
            self.fail(key, 'the number is too large')
        if not math.isfinite(number):
            self.fail(key, f'{value} is not finite')
        return number


# JSON files in, with one clear message for whatever is wrong with them.


def read_json(path: str | Path) -> Any:
    """Return the content of a JSON file.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not JSON.
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
