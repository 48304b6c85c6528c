# SPDX-License-Identifier: Apache-2.0
"""The parser of the command line, and the completion of its words by a shell."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from typing import Any

from otf_core.cli.output import say

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


# Completion of verbs, options and choices by the shell, made from the parser itself.

BASH = """\
# completion of otf; zsh: autoload -U bashcompinit && bashcompinit first
_otf() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} words=""
  if [ "$COMP_CWORD" -eq 1 ]; then
    words="{verbs}"
  else
    case "${{COMP_WORDS[1]}} $before" in
{choices}
      *)
        case "$word" in -*)
          case "${{COMP_WORDS[1]}}" in
{options}
          esac ;;
        esac ;;
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _otf otf ./otf
"""
SHELLS = ('bash', 'zsh', 'fish')


def fish_script(parser: Parser) -> str:
    """Return a script for fish."""
    lines = [
        '# completion of otf',
        f'complete -c otf -n __fish_use_subcommand -f -a "{" ".join(parser.verbs)}"',
    ]
    for name, verb in parser.verbs.items():
        under = f'complete -c otf -n "__fish_seen_subcommand_from {name}"'
        for action in verb._actions:
            words = ' '.join(map(str, action.choices or ()))
            long = [o[2:] for o in action.option_strings if o.startswith('--')]
            takes = action.nargs != 0
            listed = f' -x -a "{words}"' if words else ' -r' if takes else ''
            lines += [f'{under} -l {option}{listed}' for option in long]
            if words and not action.option_strings:
                lines.append(f'{under} -f -a "{words}"')
    return '\n'.join(lines) + '\n'


def script(parser: Parser) -> str:
    """Return a script for bash, and for zsh with its functions of bash."""
    choices, options = [], []
    for name, verb in parser.verbs.items():
        assert isinstance(verb, Parser)
        options.append(f'            {name}) words="{" ".join(sorted(verb.options))}" ;;')
        for action in verb._actions:
            if action.choices:
                listed = ' '.join(map(str, action.choices))
                named = (
                    '|'.join(f'"{name} {o}"' for o in action.option_strings) or f'"{name} {name}"'
                )
                choices.append(f'      {named}) words="{listed}" ;;')
    return BASH.format(
        verbs=' '.join(parser.verbs), choices='\n'.join(choices), options='\n'.join(options)
    )


def run_completion(arguments: argparse.Namespace) -> int:
    """Print the script of a shell."""
    from otf_core.cli import _parser

    writer = fish_script if arguments.shell == 'fish' else script
    say(writer(_parser()))
    return 0
