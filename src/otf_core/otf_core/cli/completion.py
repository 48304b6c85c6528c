# SPDX-License-Identifier: Apache-2.0
"""Completion of verbs, options and choices by the shell, made from the parser itself."""

from __future__ import annotations

import argparse

from otf_core.cli.output import say
from otf_core.cli.parser import Parser

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

    made = fish_script if arguments.shell == 'fish' else script
    say(made(_parser()))
    return 0
