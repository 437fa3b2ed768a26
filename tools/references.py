"""Reference pages made from the code, as Markdown: python -m tools.references [commands|spec|evidence]

A page with the line `<!-- generated: NAME -->` gets that part when the site is built (tools/site.py), in place
of it and of a quoted line before it, which is for other viewers. Texts, defaults and units are those of the classes
that commands and scenes are read into, ranges those that these check. Docstrings list the scripts of evidence.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import os
import re
import subprocess
import sys
import textwrap
import types
import typing
from collections.abc import Callable, Iterable
from typing import Any, Literal

from gof.commands import GROUPS, everywhere
from gof.commands.cli import commands
from gof.commands.completion import leaves
from gof.commands.declared import Option, config_of, options_of, texts_of
from gof.commands.read import parts_of_docstring
from gof_blender.pure import effects
from gof_blender.pure.spec import SceneSpec
from gof_blender.ui.effect_groups import unit_of
from tools import evidence

MARK = re.compile(r"^(?:> .*\n\n)?<!-- generated: (\w+) -->$", re.MULTILINE)  # and the note for other viewers


def filled(page: str) -> str:
    """Return a page with each generated part in place of its mark. Raises KeyError: no such part."""
    return MARK.sub(lambda mark: PARTS[mark[1]](), page)


# ----------------------------------------------------------------
# Commands


def of_commands() -> str:
    """Return every command with its options, grouped as in `gof --help`."""
    parts = [
        "## Every command",
        _table(("option", "what it does"), ((_code(k), _sentence(text)) for k, text in everywhere.OPTIONS.items())),
    ]
    for group in GROUPS:
        parts.append(f"## {group.capitalize()}")
        for name, command in commands().items():
            if command.group != group:
                continue
            if command.foreign:
                parts += [f"### gof {name}", f"{_sentence(command.help)}", f"```text\n{foreign_help()}\n```"]
                continue
            for words, module in leaves().items():
                if words.split()[0] == name:
                    parts.append(_of_command(words, config_of(module)))
    return "\n\n".join(parts)


def foreign_help() -> str:
    """Return the help of `gof baseline`, whose words are another program's."""
    command = [sys.executable, "-m", "gof.on_cpu", "--help"]
    environment = os.environ | {"COLUMNS": "100", "NO_COLOR": "1"}
    return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.strip()


def _of_command(words: str, config: type) -> str:
    summary, more, examples = parts_of_docstring(inspect.getdoc(config))
    parts = [f"### gof {words}", summary]
    if examples:
        parts.append("```text\n" + "\n".join(examples) + "\n```")
    parts += map(_sentence, more)
    parts.append(_options(options_of(config)))
    for title, kind in getattr(config, "MORE", {}).items():
        parts += [f"#### {title.capitalize()} of gof {words}", _options(options_of(kind), as_keys=True)]
    return "\n\n".join(part for part in parts if part)


def _options(options: Iterable[Option], as_keys: bool = False) -> str:
    rows = []
    for option in options:
        name = option.field if as_keys else option.name
        values = [] if option.positional else [*filter(None, option.value.split("|"))]
        value = ", ".join(map(_code, values)) + (" ..." if option.several and values else "")
        default = "required" if option.required else _code(option.default) if option.default else ""
        rows.append((_code(name), _sentence(option.text), value, default))
    return _table(("key" if as_keys else "option", "what it does", "value", "default"), rows) if rows else ""


# ----------------------------------------------------------------
# Scene spec and effects

SECTIONS = {  # heading: the class whose fields it lists, in the order of the page
    "A scene": "SceneSpec",
    "clip": "Clip",
    "domain": "Domain",
    "fire": "Fire",
    "fire of another solver": "GridFire",
    "cameras": "Rig",
    "cameras.placed": "Pose",
    "render": "Render",
    "display": "Display",
    "blend_file": "BlendFile",
}


def of_spec() -> str:
    """Return every field of the scene spec, then every effect with its settings."""
    by_name = {kind.__name__: kind for kind in classes_in(SceneSpec)}
    if set(by_name) != set(SECTIONS.values()):
        raise ValueError(f"SECTIONS lists {sorted(SECTIONS.values())}, the spec is made of {sorted(by_name)}")
    parts = []
    for title, name in SECTIONS.items():
        parts += [f"## {title}", _summary(by_name[name]), _fields(by_name[name])]
    parts.append("## Effects")
    for name in effects.names():
        module = effects.module(name)
        parts += [f"### {name}", _sentence(" ".join(module.__doc__.split("\n\n")[0].split()))]
        for kind in classes_in(module.Settings):
            if kind is not module.Settings:
                parts.append(f"{kind.__name__}:")
            parts.append(_fields(kind) or "No settings.")
    return "\n\n".join(part for part in parts if part)


def classes_in(kind: type) -> list[type]:
    """Return a dataclass, and all that its fields hold, each once."""
    found = {kind: None}
    for hint in typing.get_type_hints(kind).values():
        for inner in _inside(hint):
            found |= dict.fromkeys(classes_in(inner))
    return list(found)


def _inside(hint: Any) -> list[type]:
    if dataclasses.is_dataclass(hint):
        return [hint]
    return (
        [] if typing.get_origin(hint) is Literal else [kind for arg in typing.get_args(hint) for kind in _inside(arg)]
    )


def _summary(kind: type) -> str:
    return " ".join(inspect.getdoc(kind).split("\n\n")[0].split())


def _fields(kind: type) -> str:
    hints, texts, ranges = typing.get_type_hints(kind), texts_of(kind), rules_of(kind)
    rows = []
    for field in dataclasses.fields(kind):
        text = texts.get(field.name, "")
        kinds, rule = _kind(hints[field.name]), ranges.get(field.name, "")
        unit = unit_of(field.name, text) if _is_number(hints[field.name]) else ""
        rows.append((_code(field.name), _sentence(text), kinds, unit, rule, _default(field)))
    return _table(("field", "what it is", "type", "unit", "must be", "default"), rows) if rows else ""


def _is_number(hint: Any) -> bool:
    arguments = set(typing.get_args(hint))
    return hint in (int, float) or (bool(arguments) and arguments <= {int, float})


def _kind(hint: Any) -> str:
    """Return a type as JSON has it."""
    names = {int: "whole number", float: "number", str: "text", bool: "true or false", Any: "object"}
    if hint in names:
        return names[hint]
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is Literal:
        return ", ".join(_code(json.dumps(value)) for value in arguments)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kinds = [_kind(arg) for arg in arguments if arg is not type(None)]
        return " or ".join(dict.fromkeys(kinds)) + (" or `null`" if type(None) in arguments else "")
    if typing.get_origin(hint) is tuple:
        if arguments[-1] is Ellipsis:
            return f"list of {_kind(arguments[0])}s" if arguments[0] is Any else f"list of: {_kind(arguments[0])}"
        return f"{len(arguments)} {_kind(arguments[0])}s"
    return "object"


def _default(field: dataclasses.Field) -> str:
    if field.default_factory is not dataclasses.MISSING:
        return "its own defaults"
    if field.default is dataclasses.MISSING:
        return "required"
    value = field.default
    if any(dataclasses.is_dataclass(item) for item in (value if isinstance(value, tuple) else (value,))):
        return "one"
    return _code(re.sub(r"\.0(?=\D|$)", "", json.dumps(value)))


def rules_of(kind: type) -> dict[str, str]:
    """Return what a class requires of each field: the rules of `require` in its `__post_init__` and `_check...`."""
    found: dict[str, list[str]] = {}
    for name, method in vars(kind).items():
        if name == "__post_init__" or name.startswith("_check"):
            for field, rule in _required(method):
                found.setdefault(field, []).append(rule)
    return {field: "; ".join(dict.fromkeys(rules)) for field, rules in found.items()}


def _required(method: Callable) -> Iterable[tuple[str, str]]:
    """Yield field and rule of each `require(..., "section.field", rule, ...)` of a method, in its order."""
    names: dict[str, ast.expr] = {}
    body = ast.parse(textwrap.dedent(inspect.getsource(method))).body[0]
    for node in _in_order(body):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            names[node.targets[0].id] = node.value
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "require":
            field, rule = node.args[1], node.args[2]
            rule = names.get(rule.id, rule) if isinstance(rule, ast.Name) else rule
            if isinstance(field, ast.Constant):
                yield field.value.rpartition(".")[2], _words(rule, method.__globals__)


def _in_order(node: ast.AST) -> Iterable[ast.AST]:
    for child in ast.iter_child_nodes(node):
        yield child
        yield from _in_order(child)


def _words(rule: ast.expr, known: dict) -> str:
    """Return the text of a rule: constants of its module filled in, what only a spec knows left out."""
    if isinstance(rule, ast.JoinedStr):
        return "".join(_words(part, known) for part in rule.values)
    if isinstance(rule, ast.FormattedValue):
        try:
            value = eval(compile(ast.Expression(rule.value), "rule", "eval"), known)  # of our own source
        except (NameError, AttributeError):
            return "..."
        return format(value, _words(rule.format_spec, known) if rule.format_spec else "")
    return str(rule.value)


# ----------------------------------------------------------------
# Scripts of evidence


def of_evidence() -> str:
    """Return a table of the scripts that measure what pages say."""
    rows = []
    for name, script in evidence.scripts().items():
        pieces = re.split(r" (?=--)", " ".join([name, *script.words]))  # each wraps as a whole
        rows.append((" ".join(map(_code, pieces)), script.measures, script.takes, script.needs))
    return _table(("script", "it measures", "takes", "needs"), rows)


# ----------------------------------------------------------------
# Markdown


def _code(text: str) -> str:
    return f"`{text}`"


def _sentence(text: str) -> str:
    """Return a text that begins with a capital, unless its first word is a name, and whose pages are links."""
    text = re.sub(r"\bdocs/([\w/]+\.md(?:#[\w-]+)?)", r"[docs/\1](\1)", text)
    return text[:1].upper() + text[1:] if re.match(r"[a-z]+\b(?![:/])", text) else text


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    rows = list(rows)
    kept = [
        k
        for k, title in enumerate(head)
        if title not in ("unit", "must be", "value", "default") or any(r[k] for r in rows)
    ]
    lines = [[head[k] for k in kept], ["---"] * len(kept), *([row[k] for k in kept] for row in rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


PARTS = {"commands": of_commands, "spec": of_spec, "evidence": of_evidence}

if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        print(PARTS[part]())
