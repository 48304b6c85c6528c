# SPDX-License-Identifier: Apache-2.0
"""Documents: a frozen dataclass states the fields of a result file once.

``stated`` gives a field its meaning, unit and shape; reading, checking, writing and the schema
page follow from the dataclass. Fields without it exist in memory only and need a default.

    @dataclass(frozen=True)
    class Scalar(Document):
        value: float = stated('actual minus nominal', 'rad')

    Scalar.from_dict({'value': 1e-6}, 'error_tables.json: squareness: C0Y')
"""

from __future__ import annotations

import dataclasses
import math
import sys
import types
import typing
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass
from functools import cache
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    NoReturn,
    Union,
    cast,
    get_args,
    get_origin,
)

import numpy as np
from numpy.typing import NDArray

from otf_core.errors import InputError
from otf_core.files.strict_yaml import value_text

if TYPE_CHECKING:  # Python 3.10 has none
    from typing import Self

FIELD = 'otf document field'
"""Key of ``Stated`` in the metadata of a field."""
ARRAYS = {
    'Array': NDArray[np.float64],
    'Index': NDArray[np.int64],
    'Flags': NDArray[np.bool_],
    'numpy': np,
}
"""What the aliases of ``arrays``, which load no numpy, stand for."""
WORDS = {
    float: 'a finite number',
    int: 'a whole number',
    bool: 'true or false',
    str: 'a text',
    Mapping: 'a mapping',
    tuple: 'a list',
}
"""What a value of a type is called in messages."""


@dataclass(frozen=True)
class Stated:
    """Meaning of a field.

    Attributes
    ----------
    meaning : str
        In one sentence.
    unit : str
        SI; empty for what has none.
    shape : tuple of int and str
        Of an array; sizes are checked, names are those of the schema page.
    least : float
        Smallest number allowed.
    unknown : bool
        Numbers may be unknown: NaN and infinity in memory, null in the file.
    sparse : bool
        Left out of the file where it is None.
    """

    meaning: str
    unit: str = ''
    shape: tuple[int | str, ...] = ()
    least: float = -math.inf
    unknown: bool = False
    sparse: bool = False


def stated(
    meaning: str,
    unit: str = '',
    *,
    shape: tuple[int | str, ...] = (),
    least: float = -math.inf,
    unknown: bool = False,
    sparse: bool = False,
    default: Any = MISSING,
    factory: Any = MISSING,
) -> Any:
    """Return a field of a document; ``default`` or ``factory`` make it one that may be missing."""
    own = Stated(meaning, unit, shape, least, unknown, sparse)
    return dataclasses.field(default=default, default_factory=factory, metadata={FIELD: own})


def optional(meaning: str, unit: str = '', **more: Any) -> Any:
    """Return a field that is None in memory and left out of the file where nothing is known."""
    return stated(meaning, unit, default=None, sparse=True, **more)


class Document:
    """Base of the frozen dataclasses that are written to and read from files."""

    def to_dict(self) -> dict[str, Any]:
        """Return the stated fields as plain data, ready for JSON: arrays as lists, NaN as None."""
        stated_fields = fields_of(cast(Any, type(self)))
        pairs = ((name, own, getattr(self, name)) for name, own, _, _ in stated_fields)
        return {n: _plain(v) for n, own, v in pairs if not (own.sparse and v is None)}

    @classmethod
    def from_dict(cls, data: Any, where: str = '') -> Self:
        """Read plain data; fields that are not stated are ignored.

        Raises
        ------
        InputError
            If a field is missing or of another type or shape; ``where`` and its path name it.
        """
        if not isinstance(data, Mapping):
            _refuse(where, Mapping, data)
        values = {}
        for name, own, hint, field in fields_of(cast(Any, cls)):
            place = f'{where}: {name}' if where else name
            if name in data:
                values[name] = _read(hint, data[name], place, own)
            elif field.default is MISSING and field.default_factory is MISSING:
                raise InputError(f'{place}: missing')
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f'{where}: {error}' if where else str(error)) from None


class ResultDocument(Document):
    """Document of a verb: it has a file of its own, and exit codes follow from it."""

    file: ClassVar[str] = ''
    """Name of its file in the folder of results."""

    def to_dict(self) -> dict[str, Any]:
        """Return the stated fields as plain data, the schema first."""
        data = super().to_dict()
        return {n: data.pop(n) for n in ('schema',) if n in data} | data

    @property
    def exit_code(self) -> int:
        """Exit code of the verb."""
        return 0


@cache
def fields_of(cls: Any) -> tuple[tuple[str, Stated, Any, Field[Any]], ...]:
    """Name, ``Stated``, type and field of everything that a document states."""
    hints = typing.get_type_hints(cls, localns=ARRAYS)
    return tuple(
        (f.name, f.metadata[FIELD], hints[f.name], f)
        for f in dataclasses.fields(cls)
        if FIELD in f.metadata
    )


def _plain(value: Any) -> Any:
    if hasattr(value, 'to_dict'):
        return value.to_dict()
    if isinstance(value, np.ndarray):
        known = value.dtype.kind != 'f' or bool(np.isfinite(value).all())
        return value.tolist() if known else _plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, Collection) and not isinstance(value, str):
        return [_plain(v) for v in value]
    return value


def _refuse(where: str, kind: Any, value: Any, beside: str = '') -> NoReturn:
    words = WORDS.get(kind, kind)
    raise InputError(f'{where}: expected {words}{beside}, got {value_text(value)}')


def _read(hint: Any, value: Any, where: str, own: Stated) -> Any:
    """Check a value against a type; return it as it is in memory."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return value
    if origin in (Union, types.UnionType):
        if value is None and types.NoneType in arguments:
            return None
        return _read(next(a for a in arguments if a is not types.NoneType), value, where, own)
    if origin is Literal:
        if value not in arguments:
            _refuse(where, ' or '.join(map(repr, arguments)), value)
        return value
    if origin is np.ndarray:
        return _read_array(hint, value, where, own)
    if origin is tuple:
        kinds = arguments[:1] if len(arguments) == 2 and arguments[1] is ... else arguments
        if not isinstance(value, list) or (arguments[-1] is not ... and len(value) != len(kinds)):
            _refuse(where, tuple, value)
        repeated = kinds * (len(value) if arguments[-1] is ... else 1)
        parts = zip(repeated, value, strict=True)
        return tuple(_read(h, v, f'{where}: entry {k}', own) for k, (h, v) in enumerate(parts))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            _refuse(where, Mapping, value)
        return {str(k): _read(arguments[1], v, f'{where}: {k}', own) for k, v in value.items()}
    if hasattr(hint, 'from_dict'):
        return hint.from_dict(value, where)
    if hint in (int, float):
        return hint(_number(value, where, own, hint))
    if not isinstance(value, hint):
        _refuse(where, hint, value)
    return value


def _number(value: Any, where: str, own: Stated, kind: type) -> float:
    if value is None and own.unknown:
        return math.nan
    right = isinstance(value, int) or (kind is float and isinstance(value, float))
    if isinstance(value, bool) or not right or not abs(value) <= sys.float_info.max:
        _refuse(where, kind, value)
    if value < own.least:
        raise InputError(f'{where}: must be at least {own.least:g}, got {value:g}')
    return value if kind is int else float(value)


def _read_array(hint: Any, value: Any, where: str, own: Stated) -> Any:
    """Read nested lists of numbers or flags; every list of one level has the same length."""
    scalar = get_args(get_args(hint)[1])[0]
    kind = {'f': float, 'i': int, 'b': bool}[np.dtype(scalar).kind]
    shape = own.shape or ('n',)

    def level(part: Any, sizes: tuple[int | str, ...], place: str) -> Any:
        if not sizes:
            if kind is bool:
                return part if isinstance(part, bool) else _refuse(place, bool, part)
            return _number(part, place, own, kind)
        if not isinstance(part, list):
            _refuse(place, tuple, part)
        if isinstance(sizes[0], int) and len(part) != sizes[0]:
            raise InputError(f'{place}: has length {len(part)}, expected {sizes[0]}')
        return [level(v, sizes[1:], f'{place}: entry {k}') for k, v in enumerate(part)]

    try:
        array = np.array(level(value, shape, where), dtype=scalar)
    except ValueError:
        raise InputError(f'{where}: rows of different lengths') from None
    return array if array.ndim == len(shape) else array.reshape(0, *shape[1:])


def schema_rows(cls: Any, path: str = '') -> Iterator[tuple[str, str, str, str]]:
    """Path, type, unit and meaning of every field of a document and the documents in it."""
    for name, own, hint, _ in fields_of(cls):
        inner, shown, place = hint, '', f'{path}{name}'
        while not hasattr(inner, 'from_dict'):
            origin, arguments = get_origin(inner), get_args(inner)
            if origin in (Union, types.UnionType):
                shown += 'or null, ' if types.NoneType in arguments else ''
                inner = next(a for a in arguments if a is not types.NoneType)
            elif origin is tuple and arguments[-1] is ...:
                inner, place = arguments[0], f'{place}[]'
            elif isinstance(origin, type) and issubclass(origin, Mapping):
                inner, place = arguments[1], f'{place}.NAME'
            else:
                break
        if get_origin(inner) is np.ndarray:
            kind = f'array ({", ".join(map(str, own.shape or ("n",)))})'
        elif get_origin(inner) is Literal:
            kind = ' \\| '.join(map(str, get_args(inner)))
        elif get_origin(inner) is tuple:
            kind = f'list of {len(get_args(inner))}'
        else:
            kind = {float: 'number', int: 'count', bool: 'flag', str: 'text', Any: 'any'}.get(
                inner, 'object'
            )
        yield place, f'{shown}{kind}', own.unit, own.meaning
        if isinstance(inner, type) and issubclass(inner, Document):
            yield from schema_rows(inner, f'{place}.')
