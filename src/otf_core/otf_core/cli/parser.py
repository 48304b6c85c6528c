# SPDX-License-Identifier: Apache-2.0
"""The parser of the command line, and the completion of its words by a shell (shtab)."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from typing import Any

from otf_core.cli.output import say
from otf_core.errors import ConfigError

# The parser of the command line: one clear line for every mistake, with what was meant.


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return '; did you mean X?' for the known word nearest to one, or nothing."""
    from difflib import get_close_matches

    near = get_close_matches(word, list(known), 1)
    return f'; did you mean {near[0]}?' if near else ''


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Help whose usage line shows what must be given, not every option twice."""

    def add_usage(
        self,
        usage: str | None,
        actions: Iterable[argparse.Action],
        groups: Any,
        prefix: Any = None,
    ) -> None:
        """Leave out what may be omitted."""
        needed = [a for a in actions if a.required or not a.option_strings]
        super().add_usage(usage, needed, (), prefix)


class Parser(argparse.ArgumentParser):
    """One clear line instead of the usage text in front of every error."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # argparse takes -1e-3, and a list of columns such as -,x_mm,y_mm,z_mm, for an option
        self._negative_number_matcher = re.compile(r'-((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|,.*)$')

    def error(self, message: str) -> Any:
        """Print what is wrong and leave with exit code 2."""
        self.exit(2, f'{self.prog}: {message} (see {self.prog} --help)\n')

    @property
    def verbs(self) -> dict[str, argparse.ArgumentParser]:
        """Parsers of the verbs."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                return dict(action.choices)
        return {}

    @property
    def options(self) -> list[str]:
        """Long options."""
        return [o for o in self._option_string_actions if o.startswith('--')]


def parse_arguments(parser: Parser, argv: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; mistakes point to the help of the verb they were made in."""
    verbs = parser.verbs
    word = next(iter(argv), '')
    if word and not word.startswith('-') and word not in verbs:
        hint = did_you_mean(word, verbs) or ';'
        parser.error(f'unknown command {word!r}{hint} commands: {", ".join(verbs)}')
    arguments, unknown = parser.parse_known_args(argv)
    if unknown:
        verb = verbs[arguments.verb]
        assert isinstance(verb, Parser)
        name = unknown[0].split('=')[0]
        known = did_you_mean(name, verb.options) if name.startswith('-') else ''
        verb.error(f'unknown {"option" if name.startswith("-") else "argument"} {name}{known}')
    return arguments


# Completion of verbs, options and choices by the shell.

SHELLS = ('bash', 'zsh', 'tcsh')


def run_completion(arguments: argparse.Namespace) -> int:
    """Print the script of a shell."""
    try:
        import shtab
    except ImportError:
        raise ConfigError(
            'completion: needs shtab: python3 -m pip install shtab, or apt install python3-shtab'
        ) from None
    from otf_core.cli import _parser

    parser = _parser()
    for verb in parser.verbs.values():
        for action in verb._actions:
            if not action.choices and action.nargs != 0:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    say(shtab.complete(parser, arguments.shell))
    return 0
