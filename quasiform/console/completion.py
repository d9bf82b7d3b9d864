"""Completion of the command line by the shell: a script made from the commands as they are."""

from __future__ import annotations

import argparse
from collections.abc import Mapping

SHELLS = ("bash",)
SCRIPT = """\
# quasiform: completion for bash; zsh takes it after: autoload bashcompinit && bashcompinit
_quasiform() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} words=""
    COMPREPLY=()
    if [ "$COMP_CWORD" -eq 1 ]; then
        words="{commands}"
    else
        case "${{COMP_WORDS[1]}} $before" in
{values}
        *)
            case "${{COMP_WORDS[1]}}" in
{options}
            esac
            ;;
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _quasiform quasiform
"""


def script(parsers: Mapping[str, argparse.ArgumentParser], more: Mapping[str, str]) -> str:
    """Return the script for bash; where nothing fits the word, bash completes file names.

    Parameters
    ----------
    parsers : dict of command to its parser
        The choices of an option are read from its metavar, such as auto|none.
    more : dict of command to words
        That complete its first argument.
    """
    values, options = [], []
    for command, parser in parsers.items():
        flags = []
        for action in parser._actions:
            flags += [flag for flag in action.option_strings if flag.startswith("--")]
            if not action.option_strings or action.nargs == 0:
                continue
            named = action.metavar if isinstance(action.metavar, str) else ""
            choices = [c for c in named.split("|") if c.islower()] if "|" in named else []
            pattern = "|".join(f'"{command} {flag}"' for flag in action.option_strings)
            values.append(f'        {pattern}) words="{" ".join(choices)}" ;;')
        words = " ".join([more.get(command, ""), *flags]).strip()
        options.append(f'            {command}) words="{words}" ;;')
    return SCRIPT.format(
        commands=" ".join([*parsers, "--help", "--version"]),
        values="\n".join(values),
        options="\n".join(options),
    )
