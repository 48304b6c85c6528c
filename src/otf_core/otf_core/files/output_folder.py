# SPDX-License-Identifier: Apache-2.0
"""Where results go: refused before any work, or written aside and put in place as a whole."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from otf_core.errors import ConfigError
from otf_core.files.writing import DiskFull, ensure_folder, unwritable, whole_file, write_text
from otf_core.version import __version__

# manifest.json (``otf-manifest/1``): which files of a folder this program wrote, by their hash.
#
# A file that is not listed, or was changed since, is somebody else's and is never deleted. A
# folder inside may have a manifest of its own. ``missing`` names files that did not fit on the
# disk.

MANIFEST = 'manifest.json'
SCHEMA = 'otf-manifest/1'


def file_digest(path: str | Path) -> str:
    """SHA-256 of the bytes of a file, as sha256sum prints it."""
    digest = hashlib.sha256()
    with open(path, 'rb') as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def write_manifest(
    manifest: Path, files: Iterable[Path], verb: str, missing: Mapping[str, str] | None = None
) -> None:
    """List files that lie in the folder of the manifest or below it, and what is missing there."""
    folder = manifest.parent
    entries = {f.relative_to(folder).as_posix(): file_digest(f) for f in sorted(files)}
    data = {'schema': SCHEMA, 'verb': verb, 'version': __version__, 'sha256': entries}
    if missing:
        data['missing'] = dict(missing)
    write_text(manifest, json.dumps(data, indent=1) + '\n')


def listed_files(manifest: Path) -> dict[Path, str]:
    """Files that a manifest lists, with their hashes; empty if there is none or it is damaged."""
    try:
        data: Any = json.loads(manifest.read_text(encoding='utf-8'))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        return {}
    entries = data.get('sha256')
    if not isinstance(entries, dict):
        return {}
    return {manifest.parent / name: str(digest) for name, digest in entries.items()}


def is_unchanged(path: Path, entries: dict[Path, str]) -> bool:
    """Return whether a file is listed and still what it was then."""
    return path in entries and path.is_file() and file_digest(path) == entries[path]


def written_files(folder: Path) -> list[Path]:
    """All files and links below a folder, manifests left out."""
    files = (p for p in folder.rglob('*') if p.is_symlink() or not p.is_dir())
    return sorted(p for p in files if p.name != MANIFEST)


def foreign_files(folder: Path) -> list[Path]:
    """Files below a folder that no manifest in it lists as they are."""
    entries: dict[Path, str] = {}
    for manifest in folder.rglob(MANIFEST):
        entries |= listed_files(manifest)
    strange = [m for m in folder.rglob(MANIFEST) if not listed_files(m)]
    return strange + [
        p for p in written_files(folder) if p.is_symlink() or not is_unchanged(p, entries)
    ]


# Where results go: refused before any work, or written aside and put in place as a whole.
#
# Every verb uses the same two steps: ``OutputFolder(...)`` checks at once, ``filled()`` yields an
# empty folder beside the final one and gives it the final name if the block succeeds. A folder
# that holds results is replaced only with ``overwrite``, and only if all its files are listed in
# its manifest and unchanged: what this program did not write, it does not delete.
#
# One exception from the whole: where the disk is full or a page fails, a result without it is
# better than none (``writing.write_if_possible``); the manifest names what is missing.

RESERVED = 8192
"""Space kept for the manifest while the other files are written, byte."""
FILES_SHOWN = 3
"""Foreign files named in a message."""


def _refuse(path: Path, problem: str) -> ConfigError:
    return ConfigError(f'{path}: {problem}')


def _probe(folder: Path, path: Path) -> None:
    """Make sure that something can be written into a folder that exists."""
    try:
        os.rmdir(tempfile.mkdtemp(prefix='.otf-', dir=folder))
    except OSError as error:
        where = '' if folder == path else f'{folder}: '
        raise _refuse(path, f'cannot be written ({where}{error.strerror})') from None


def _nearest(path: Path) -> Path:
    """The path, or the nearest folder above it that exists."""
    while not os.path.lexists(path) and path != path.parent:
        path = path.parent
    return path


def _resolved(path: Path) -> Path:
    """Follow links; refuse names that the file system does not take and links to nothing."""
    try:
        if path.is_symlink() and not path.exists():
            target = os.readlink(path)
            raise _refuse(path, f'is a link to {target}, which does not exist; remove it')
        os.lstat(path)
    except FileNotFoundError:
        pass
    except NotADirectoryError:
        nearest = next(p for p in path.absolute().parents if p.exists())
        raise _refuse(path, f'cannot be created ({nearest} is a file)') from None
    except (OSError, ValueError) as error:
        raise _refuse(
            path, f'cannot be written ({getattr(error, "strerror", None) or error})'
        ) from None
    return Path(os.path.realpath(path))


def _check_parent(path: Path, final: Path) -> None:
    nearest = _nearest(final.parent)
    if not nearest.is_dir():
        raise _refuse(path, f'cannot be created ({nearest} is not a folder)')
    _probe(nearest, path)


def _check_inputs(path: Path, final: Path, inputs: Sequence[str | Path]) -> None:
    for name in inputs:
        source = Path(os.path.realpath(name))
        if final == source or final in source.parents:
            raise _refuse(path, f'holds the input {name}; choose another --out')


class OutputFolder:
    """A folder for the results of one command.

    Parameters
    ----------
    path : str or Path
        As the user gave it; a link to a folder is followed.
    overwrite : bool
        Replace results that are there.
    inputs : sequence of str or Path
        What the command reads; none of it may lie in the folder.
    occupied : str
        Begins the message if something is there.

    Attributes
    ----------
    missing : dict of str to str
        Files that were left out, and why; filled by who writes.

    Raises
    ------
    ConfigError
        At once, if the results could not be put there; nothing is changed.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        overwrite: bool = False,
        inputs: Sequence[str | Path] = (),
        occupied: str = 'holds files already',
    ) -> None:
        self.path, self._overwrite, self._occupied = Path(path), overwrite, occupied
        self.missing: dict[str, str] = {}
        self._final = _resolved(self.path)
        self._check_content()
        _check_inputs(self.path, self._final, inputs)
        if self._inside:
            _probe(self._final, self.path)
        else:
            _check_parent(self.path, self._final)

    @property
    def _inside(self) -> bool:
        """True if the folder itself has to stay: other programs stand in it, or it is a mount."""
        final = self._final
        if not final.is_dir():
            return False
        here = Path(os.path.realpath(os.curdir))
        stands = here == final or final in here.parents
        return stands or os.path.ismount(final) or not os.access(final.parent, os.W_OK | os.X_OK)

    def _check_content(self) -> None:
        final = self._final
        if not os.path.lexists(final):
            return
        if not final.is_dir():
            raise _refuse(self.path, 'is a file; the results need a folder of their own')
        try:
            if not any(final.iterdir()):
                return
            strange = foreign_files(final)
        except OSError as error:
            raise _refuse(self.path, f'cannot be read ({error.strerror})') from None
        if not strange and self._overwrite:
            return
        if not strange:
            raise _refuse(
                self.path,
                f'{self._occupied}; choose another folder, or --overwrite replaces the results',
            )
        names = ', '.join(str(p.relative_to(final)) for p in strange[:FILES_SHOWN])
        more = ', ...' if len(strange) > FILES_SHOWN else ''
        raise _refuse(
            self.path,
            f'{self._occupied}, and not only unchanged results of otf ({names}{more}): these are '
            f'never deleted; choose another folder',
        )

    @contextmanager
    def filled(self, verb: str) -> Iterator[Path]:
        """Yield an empty folder; what the block writes there appears as a whole or not at all.

        Parameters
        ----------
        verb : str
            Named in the manifest, which is added.

        Raises
        ------
        ConfigError
            If the folder cannot be written, or somebody has filled it meanwhile.
        """
        base = self._final if self._inside else ensure_folder(self._final.parent)
        new = base / f'.{self._final.name}.{uuid.uuid4().hex[:12]}.new'
        reserve = new.with_suffix('.reserve')
        try:
            new.mkdir()
            reserve.write_bytes(bytes(RESERVED))
            yield new
            reserve.unlink()
            write_manifest(new / MANIFEST, written_files(new), verb, self.missing)
            if not self._inside:  # there, the folder is filled by what lies aside
                self._check_content()
            self._put_in_place(new)
        except OSError as error:
            raise unwritable(self.path, error) from None
        except DiskFull as error:
            raise DiskFull(str(error).replace(str(new), str(self.path))) from None
        finally:
            reserve.unlink(missing_ok=True)
            shutil.rmtree(new, ignore_errors=True)

    @property
    def missing_words(self) -> str:
        """What was left out, in words; empty if nothing was."""
        whys = sorted(set(self.missing.values()))
        return f'{", ".join(whys)}: {", ".join(self.missing)} not written' if whys else ''

    def clear(self) -> None:
        """Delete the results that are there; ``overwrite`` has been checked."""
        if self._final.is_dir():
            self._check_content()
            for item in self._final.iterdir():
                _remove(item)

    def _put_in_place(self, new: Path) -> None:
        final = self._final
        if self._inside:
            for item in [p for p in final.iterdir() if p != new]:
                _remove(item)
            for item in sorted(new.iterdir(), key=lambda p: p.name == MANIFEST):
                os.rename(item, final / item.name)
            return
        if not final.exists() or not any(final.iterdir()):
            if final.exists():
                shutil.copymode(final, new)
                final.rmdir()  # Windows does not rename onto a folder
            os.rename(new, final)
            return
        shutil.copymode(final, new)
        old = new.with_suffix('.old')
        os.rename(final, old)
        try:
            os.rename(new, final)
        except BaseException:  # an interrupt too: the results before stay
            os.rename(old, final)
            raise
        shutil.rmtree(old, ignore_errors=True)


def _remove(item: Path) -> None:
    if item.is_dir() and not item.is_symlink():
        shutil.rmtree(item)
    else:
        item.unlink()


class OutputFile:
    """A single file as result; otherwise as ``OutputFolder``.

    Parameters
    ----------
    is_ours : callable
        Tells whether an existing file is a result of this command, which alone is overwritten.
    """

    def __init__(
        self,
        path: str | Path,
        is_ours: Callable[[Path], bool],
        *,
        overwrite: bool = False,
        inputs: Sequence[str | Path] = (),
    ) -> None:
        self.path, self._overwrite, self._is_ours = Path(path), overwrite, is_ours
        self._final = _resolved(self.path)
        self._check_content()
        _check_inputs(self.path, self._final, inputs)
        _check_parent(self.path, self._final)

    def _check_content(self) -> None:
        if not self._final.exists():
            return
        if self._final.is_dir():
            raise _refuse(self.path, 'is a folder; name the file to write')
        if not self._overwrite:
            raise _refuse(
                self.path, 'exists already; choose another name, or --overwrite replaces it'
            )
        if not self._is_ours(self._final):
            raise _refuse(
                self.path, 'exists and is not a result of this command: it is never overwritten'
            )

    @contextmanager
    def filled(self) -> Iterator[Path]:
        """Yield a temporary name beside the file; it takes the final name at the end."""
        ensure_folder(self._final.parent)
        with whole_file(self._final) as partial:
            yield partial
            self._check_content()
