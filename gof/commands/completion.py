"""`gof completion`: a script for a shell that completes commands, parts and options of `gof`."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from gof.commands import everywhere
from gof.commands.declared import config_of, options_of
from gof.commands.read import read_options


@dataclass
class CompletionConfig:
    """Print a script that completes commands, parts and options of `gof` in a shell.

    Examples:
      gof completion bash > ~/.local/share/bash-completion/completions/gof
      gof completion zsh > ~/.zfunc/_gof
      gof completion fish > ~/.config/fish/completions/gof.fish

    A new terminal knows them. For zsh, ~/.zshrc needs: fpath+=~/.zfunc; autoload -Uz compinit; compinit
    """

    shell: tyro.conf.Positional[Annotated[Literal["bash", "zsh", "fish"], tyro.conf.arg(metavar="bash|zsh|fish")]]
    """The shell."""


def main(argv: list[str]) -> int:
    """Run `gof completion`."""
    config = read_options(CompletionConfig, "completion", argv)
    print({"bash": bash, "zsh": zsh, "fish": fish}[config.shell](words()))
    return 0


def parts_of(name: str) -> dict[str, str]:
    """Parts of a command, each with its module; none for a command without parts."""
    from gof.commands.cli import commands

    table = getattr(importlib.import_module(commands()[name].module), "PARTS", {})
    return {part: module for part, (module, _) in table.items()}


def leaves() -> dict[str, str]:
    """Return every command, and every part of one, that takes options: its words after `gof`, and its module."""
    from gof.commands.cli import commands

    found: dict[str, str] = {}
    for name, command in commands().items():
        if command.foreign:
            continue
        parts = parts_of(name)
        found |= {f"{name} {part}": module for part, module in parts.items()} or {name: command.module}
    return found


def words() -> dict[str, list[str]]:
    """Return the words that can follow `gof` and a command's words: commands, parts, or options and their values."""
    from gof.commands.cli import commands

    always = [option.split()[0] for option in everywhere.OPTIONS] + ["--help", "--help-all"]
    found = {"": [*commands(), "help", "--version", *always]}
    for name in commands():
        if parts := parts_of(name):
            found[name] = list(parts)
    for name, module in leaves().items():
        options = options_of(config_of(module))
        named = [option.name for option in options if not option.positional]
        chosen = [choice for option in options if option.positional for choice in option.choices]
        found[name] = [*chosen, *named, *always]
        for option in options:
            if option.choices and not option.positional:
                found[f"{name} {option.name}"] = list(option.choices)
    return found


def bash(table: dict[str, list[str]]) -> str:
    """Return the script for bash: values of an option, then options; files where nothing else fits."""
    cases = "\n".join(f'    "{key}") words="{" ".join(values)}" ;;' for key, values in table.items())
    return f"""# completion of gof for bash, written by: gof completion bash
_gof_words() {{
  local words=""
  case "$1" in
{cases}
  esac
  echo "$words"
}}
_gof() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" last="${{COMP_WORDS[COMP_CWORD-1]}}" command="" k
  for ((k = 1; k < COMP_CWORD && k < 3; k++)); do
    case "${{COMP_WORDS[k]}}" in -*) break ;; esac
    [ -n "$(_gof_words "${{command:+$command }}${{COMP_WORDS[k]}}")" ] || break
    command="${{command:+$command }}${{COMP_WORDS[k]}}"
  done
  local words="$(_gof_words "$command $last")"
  [ -n "$words" ] || words="$(_gof_words "$command")"
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _gof gof"""


def zsh(table: dict[str, list[str]]) -> str:
    """Return the script for zsh, which runs that of bash."""
    return f"#compdef gof\nautoload -U +X bashcompinit && bashcompinit\n{bash(table)}"


def fish(table: dict[str, list[str]]) -> str:
    """Return the script for fish."""
    lines = ["# completion of gof for fish, written by: gof completion fish", "complete -c gof -e"]
    firsts = [word for word in table[""] if not word.startswith("-")]
    lines.append(f'complete -c gof -n __fish_use_subcommand -f -a "{" ".join(firsts)}"')
    for key, values in table.items():
        seen = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in key.split() if not word.startswith("-"))
        if not key or "--" in key:
            continue
        for value in values:
            if value.startswith("--"):
                choices = table.get(f"{key} {value}")
                more = f' -x -a "{" ".join(choices)}"' if choices else ""
                lines.append(f'complete -c gof -n "{seen}" -l {value[2:]}{more}')
            else:
                lines.append(f'complete -c gof -n "{seen}" -f -a {value}')
    return "\n".join(lines)
