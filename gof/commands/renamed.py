"""Names of commands and options that have changed: the old ones work for one version, and say so.

One table for everything. It is applied to the command line before that is parsed, so nothing behind it knows the old
names.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

from gof.core.errors import GofError

COMMANDS = {"static": "ingest"}


@dataclass(frozen=True)
class New:
    """The new name of an option; its values stay the same."""

    name: str


@dataclass(frozen=True)
class Scaled:
    """The new name of an option whose number has another unit now: `factor` times the old one."""

    name: str
    factor: float


@dataclass(frozen=True)
class Word:
    """A switch that is a value of another option now."""

    name: str
    word: str


@dataclass(frozen=True)
class Key:
    """An option whose `count` values are one word KEY=VALUES of another option now; a switch has none."""

    name: str
    key: str
    count: int = 1


@dataclass(frozen=True)
class Names:
    """An option that named the leading words in their order; now each word is NAME=WORD."""


@dataclass(frozen=True)
class Gone:
    """An option that is no more: the sentence that goes on from its name says what to do instead."""

    instead: str


Change = New | Scaled | Word | Key | Names | Gone


@dataclass(frozen=True)
class CommandChanges:
    """The changes of a command.

    Attributes:
        options: by old name.
        words: of an option, by old value: the new value.
        leading: by the number of words before all options, the options that these words are now; "" stays a word.
    """

    options: dict[str, Change] = field(default_factory=dict)
    words: dict[str, dict[str, str]] = field(default_factory=dict)
    leading: dict[int, tuple[str, ...]] = field(default_factory=dict)


def _written_down(option: str) -> Gone:
    return Gone(f"is written down once, for every command: gof convert RESULT {option} writes RESULT.gof.json")


CODE_DATE = Gone(
    'stands beside the result now: RESULT.gof.json with {"schema": "gof-import", "version": 1, "code_date": '
    '"2024-09-15"}'
)
CLIP = Gone("is a part of --clip FIRST LAST now, in seconds")
TO_WRITE_DOWN = {
    "--time-unit": "SECONDS",
    "--time-zero": "SECONDS",
    "--frame-time": "SECONDS",
    "--world": "FOLDER",
    "--world-by": "METHOD",
    "--flame-only": "",
}
FOREIGN: dict[str, Change] = {
    "--code-date": CODE_DATE,
    **{option: _written_down(f"{option} {value}".rstrip()) for option, value in TO_WRITE_DOWN.items()},
}
EFFORT: dict[str, Change] = {"--iterations": New("--steps"), "--longest-side": New("--max-size")}
BOARD: dict[str, Change] = {"--template": New("--board")}
CHARUCO: dict[str, Change] = {
    "--marker-mm": New("--charuco-mm"),
    "--columns": Gone("is a part of --squares now: --squares 7x5"),
    "--rows": Gone("is a part of --squares now: --squares 7x5"),
}
WIDTH: dict[str, Change] = {"--width": New("--width-in")}
SIZES = {"--size": {"smoke": "preview", "paper": "full"}}

TABLE: dict[str, CommandChanges] = {
    "background": CommandChanges(
        {
            "--longest-side": New("--max-size"),
            "--depth-weights": Gone("is for maps that are made before: gof depth DATASET --plates --weights FOLDER"),
        }
    ),
    "benchmark add": CommandChanges(FOREIGN, leading={3: ("", "--dataset", "")}),
    "benchmark list": CommandChanges({"--split": New("--scenes")}, SIZES),
    "benchmark make": CommandChanges({"--split": New("--scenes")}, SIZES),
    "benchmark score": CommandChanges({"--split": New("--scenes")}),
    "capture annotate": CommandChanges(BOARD),
    "capture board": CommandChanges(
        {
            "--pattern": New("--light"),
            "--output": Gone("is the number that --light takes: --light 7"),
        },
        {"--light": {"all_on": "all", "all_off": "none"}},
    ),
    "capture calibrate": CommandChanges(CHARUCO),
    "capture draw": CommandChanges(BOARD, leading={1: ("--out",)}),
    "capture sync": CommandChanges(
        BOARD
        | {
            "--row-time-us": New("--row-time"),
            "--sensor": New("--row-time"),
            "--video-codec": Gone("stands behind the layout now: --write-videos plain:mpeg4"),
        }
    ),
    "capture target": CommandChanges(CHARUCO, leading={1: ("--out",)}),
    "convert": CommandChanges(
        {
            "--start": CLIP,
            "--end": CLIP,
            "--code-date": CODE_DATE,
        }
    ),
    "demo": CommandChanges({"--iterations": New("--steps")}),
    "evaluate": CommandChanges(
        FOREIGN
        | {
            "--truth": New("--dataset"),
            "--depth": New("--published"),
            "--disparity": Gone("is found in the folder of --published, which gof depth writes"),
            "--order": Gone("is varied by gof study score RESULT --dataset DATASET --order 3 5; scores have order 3"),
            "--opacity": Gone("is varied by gof study score RESULT --dataset DATASET --opacity temporal base"),
        }
    ),
    "figure compare": CommandChanges(
        FOREIGN
        | WIDTH
        | {"--names": Names(), "--box": Gone("is what --parts takes now, with commas: --parts 60,120,40,40")}
    ),
    "figure modalities": CommandChanges(WIDTH | {"--depth-weights": New("--depth")}),
    "figure removal": CommandChanges(WIDTH),
    "import": CommandChanges({"--blend": New("--out")}),
    "ingest": CommandChanges(
        {
            "--fps": New("--times"),
            "--stamps": Word("--times", "stamps"),
            "--marker-m": Scaled("--marker-mm", 1000),
            "--plate": New("--plates"),
            "--plate-frames": Gone("is a part of --plates now: --plates steady:200"),
            "--width": Gone("is --max-size now, the longer side of a picture and not its width"),
            "--depth": Gone("is a command of its own, to run on the dataset: gof depth DATASET --plates"),
            "--depth-weights": Gone("goes with the maps: gof depth DATASET --plates --weights FOLDER"),
        }
    ),
    "leaderboard": CommandChanges({"--truth": New("--dataset")}),
    "reconstruct": CommandChanges(EFFORT),
    "share": CommandChanges(FOREIGN | {"--names": Names()}),
    "study ablations": CommandChanges(EFFORT),
    "study reconstruct": CommandChanges(EFFORT, {"--vary": {"iterations": "steps", "longest_side": "max-size"}}),
    "video": CommandChanges(
        FOREIGN
        | {
            "--path": New("--camera-path"),
            "--time": New("--mode"),
            "--names": Names(),
            "--recorded": Key("--style", "recorded", 0),
            "--camera": Key("--style", "camera"),
            "--slow": Key("--style", "slow"),
            "--seconds": Key("--style", "seconds"),
            "--stop": Key("--style", "stop"),
            "--degrees": Key("--style", "degrees"),
            "--scene": Key("--style", "scene"),
            "--reduced": Key("--style", "reduced"),
            "--keep-frames": Key("--style", "keep_frames", 0),
            "--height": Gone("is --max-size now, the longer side of a panel and not its height"),
        }
    ),
}


def renamed(command: str, argv: list[str]) -> list[str]:
    """Return the arguments of a command under today's names; says on the error stream what has another name.

    Raises:
        GofError: an option is no more (says what to do instead), or old names do not fit together.
    """
    changes = TABLE.get(command)
    if changes is None:
        return argv
    given = list(_leading(argv))
    rest = argv[len(given) :]
    words: list[str] = []
    for word, option in zip(given, changes.leading.get(len(given), [""] * len(given)), strict=True):
        if option:
            _say(command, f"'{word}' without an option", f"{option} {word}")
        words += [option, word] if option else [word]
    collected: dict[str, list[str]] = {}
    while rest:
        option, equals, value = rest.pop(0).partition("=")
        plain = option.replace("_", "-")
        change = changes.options.get(plain)
        if equals and change is not None:
            rest.insert(0, value)
        if isinstance(change, Gone):
            raise GofError(f"{plain} {change.instead}")
        elif isinstance(change, Names):
            names = _values(rest, None)
            if len(names) != len(given) or not names:
                raise GofError(f"{plain}: put a name before each result: {' '.join(f'NAME={w}' for w in given)}")
            words = [f"{name}={word}" for name, word in zip(names, given, strict=True)] + words[len(given) :]
            _say(command, plain, " ".join(words[: len(given)]))
        elif isinstance(change, Key):
            pair = "=".join([change.key, *_values(rest, change.count)])
            collected.setdefault(change.name, []).append(pair)
            _say(command, plain, f"{change.name} {pair}")
        elif isinstance(change, Word):
            words += [change.name, change.word]
            _say(command, plain, f"{change.name} {change.word}")
        elif isinstance(change, Scaled):
            words += [change.name, *(_times(number, change.factor) for number in _values(rest, 1))]
            _say(command, plain, " ".join(words[-2:]))
        elif isinstance(change, New):
            _say(command, plain, change.name)
            words.append(change.name)
        else:
            words.append(option + equals + value)
        name = words[-1].partition("=")[0] if words else ""
        if name in changes.words:
            rest, words = _with_todays_words(command, name, changes.words[name], words, rest)
    for option, added in collected.items():
        words = _put_behind(words, option, added)
    return words


def _with_todays_words(
    command: str, option: str, known: dict[str, str], words: list[str], rest: list[str]
) -> tuple[list[str], list[str]]:
    """Return the words that are left, and those up to an option and its values, with old ones replaced."""
    _, equals, value = words[-1].partition("=")
    values = [value] if equals else _values(rest, None)
    for old in values:
        if old in known:
            _say(command, f"{option} {old}", f"{option} {known[old]}")
    return rest, [*words[:-1], option, *(known.get(old, old) for old in values)]


def _leading(argv: list[str]) -> Iterator[str]:
    for word in argv:
        if word.startswith("-"):
            return
        yield word


def _values(rest: list[str], count: int | None) -> list[str]:
    """Return the values of an option, taken from the words behind it."""
    found: list[str] = []
    while rest and not rest[0].startswith("--") and (count is None or len(found) < count):
        found.append(rest.pop(0))
    return found


def _times(number: str, factor: float) -> str:
    """Return a number in another unit; what is none stays, and is refused as every wrong value is."""
    try:
        return f"{float(number) * factor:.12g}"
    except ValueError:
        return number


def _put_behind(words: list[str], option: str, added: list[str]) -> list[str]:
    """Return the words with more values of an option, which is added where it is not among them."""
    if option not in words:
        return [*words, option, *added]
    end = words.index(option) + 1
    while end < len(words) and not words[end].startswith("--"):
        end += 1
    return [*words[:end], *added, *words[end:]]


def _say(command: str, old: str, new: str) -> None:
    print(f"gof {command}: {old} is now {new}; the old name goes with the next version", file=sys.stderr)
