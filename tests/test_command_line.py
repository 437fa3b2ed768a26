"""What every command has in common: one name for one thing, old names that still work, help, and what is kept."""

import json
import shlex
import subprocess
import sys

import pytest

from gof.commands import everywhere, read
from gof.commands.cli import commands, main
from gof.commands.completion import leaves, words
from gof.commands.declared import config_of, first_of, options_of
from gof.commands.renamed import TABLE, Gone, New, renamed
from gof.core.errors import GofError
from gof.core.ladder import LADDER
from tests.conftest import random_gaussians

MOST_OPTIONS = 200


def options(name: str) -> list:
    return [option for option in options_of(config_of(leaves()[name])) if not option.positional]


def help_of(name: str, capsys, *more: str) -> str:
    with pytest.raises(SystemExit) as done:
        main([*name.split(), *(more or ("-h",))])
    assert done.value.code == 0
    return capsys.readouterr().out


# ---------------------------------------------------------------- how much there is


def test_there_are_at_most_200_options():
    counted = sum(len(options(name)) for name in leaves()) + len(everywhere.OPTIONS)
    assert counted <= MOST_OPTIONS, counted


@pytest.mark.parametrize("name", leaves())
def test_a_first_help_screen_is_short_and_begins_with_examples(name, capsys):
    first = first_of(config_of(leaves()[name]))
    assert len(first) <= read.MOST
    assert all(option in first for option in options(name) if option.required)
    said, whole = help_of(name, capsys), help_of(name, capsys, "--help-all")
    assert said.startswith(f"usage: gof {name}")
    assert said.index("examples:") < said.index("options:") if first else "options:" not in said
    assert f"  gof {name} " in said or f"  gof {name}\n" in said
    assert (f": gof {name} --help-all" in said) == (len(first) < len(options(name)))
    for option in options(name):
        assert f"  {option.name}" in whole and option.text, option
        assert (f"\n  {option.name}" in said) == (option in first), option
    assert "None" not in said + whole and "--no-no" not in whole
    assert all(word.split()[0] in whole for word in everywhere.OPTIONS)


NEEDED = {name: [option for option in options_of(config_of(leaves()[name])) if option.positional] for name in leaves()}


@pytest.mark.parametrize("second", [["--with-clip", "b"], ["--with_clip=b"]])
def test_an_option_of_several_values_is_not_given_twice(second, capsys):
    """Of two, argparse keeps the last one's values alone, and says nothing."""
    assert main(["ingest", "takes/1", "--with-clip", "a", *second]) == 1
    assert "--with-clip: stands there twice; name all of its values behind one --with-clip" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name, needed in NEEDED.items() if any(o.required for o in needed)])
def test_a_command_without_a_word_says_what_to_name(name, capsys):
    """As people type it first; a list that may be empty for the parser is not for the command."""
    try:
        status = main(name.split())
    except SystemExit as usage:  # the parser's own words
        status = usage.code
    told = capsys.readouterr().err
    assert status in (1, 2) and "error in gof itself" not in told
    first = next(option for option in NEEDED[name] if option.required)
    if first.several:
        assert f"name {first.name}; for example: gof {name} " in told


@pytest.mark.parametrize("name", leaves())
def test_every_number_has_a_unit_or_counts(name):
    for option in options(name):
        assert option.value != "NUMBER", f"gof {name} {option.name}: in which unit?"


def test_one_thing_has_one_name():
    """The options of one name mean one thing; the names that another one has replaced are in no command."""
    gone = {"--truth", "--template", "--iterations", "--longest-side", "--width", "--height", "--marker-m", "--blend"}
    found = {option.name for name in leaves() for option in options(name)}
    assert not found & gone
    cameras = {name for name in leaves() for option in options(name) if option.name == "--camera"}
    assert {"report", "import", "figure compare"} <= cameras
    assert all(o.value == "TEXT" for name in cameras for o in options(name) if o.name == "--camera"), "by name"


def test_out_is_always_optional():
    for name in leaves():
        assert not any(option.required for option in options(name) if option.name == "--out"), name


# ---------------------------------------------------------------- old names


def test_the_table_names_options_that_exist_and_none_that_still_does():
    for command, changes in TABLE.items():
        today = {option.name for option in options(command)}
        for old, change in changes.options.items():
            if not isinstance(change, Gone):
                assert getattr(change, "name", "") in {*today, ""}, (command, old)
            kept = command in ("capture target", "capture calibrate") and old == "--marker-mm"
            assert old not in today or kept or command in ("figure modalities", "convert", "video"), (command, old)


@pytest.mark.parametrize(
    "command, old, new",
    [
        ("evaluate", "R --truth D", "R --dataset D"),
        ("evaluate", "R --truth=D", "R --dataset D"),
        ("reconstruct", "D --iterations 7 --longest-side 64", "D --steps 7 --max-size 64"),
        ("reconstruct", "D --longest_side 64", "D --max-size 64"),
        ("ingest", "a b --marker-m 0.055 --stamps --fov 60", "a b --marker-mm 55 --times stamps --fov 60"),
        ("ingest", "a b --fps 400 200 --plate minimum", "a b --times 400 200 --plates minimum"),
        ("capture draw", "b.svg --template=paper_rig", "--out b.svg --board paper_rig"),
        ("capture target", "--marker-mm 19", "--charuco-mm 19"),
        ("capture board", "test --pattern all_on", "test --light all"),
        ("benchmark add", "R S M --run seed_0", "R --dataset S M --run seed_0"),
        ("benchmark make", "W --size smoke", "W --size preview"),
        ("benchmark list", "--size=paper --split test", "--size full --scenes test"),
        ("share", "a b --names x y --title T", "x=a y=b --title T"),
        ("video", "a --path camera --recorded --slow 4", "a --camera-path camera --style recorded slow=4"),
        ("video", "a --time bullet --style stop=1 --slow=4 --fps 5", "a --mode bullet --style stop=1 slow=4 --fps 5"),
        ("study reconstruct", "D --vary iterations presets", "D --vary steps presets"),
    ],
)
def test_old_words_become_todays_and_are_named(command, old, new, capsys):
    assert renamed(command, shlex.split(old)) == shlex.split(new)
    said = capsys.readouterr().err
    assert said.startswith(f"gof {command}: ") and "the old name goes with the next version" in said
    assert renamed(command, shlex.split(new)) == shlex.split(new) or command == "capture target"
    assert not capsys.readouterr().err or command == "capture target"


def test_an_old_name_does_the_same_through_the_command(tiny_dataset, tmp_path, capsys):
    random_gaussians(30).save(tmp_path / "r.npz")
    found = []
    for option in ("--truth", "--dataset"):
        out = tmp_path / option.strip("-")
        assert main(["evaluate", str(tmp_path / "r.npz"), option, str(tiny_dataset), "--out", str(out)]) == 0
        found.append(json.loads((out / "scores.json").read_text())["dve"])
        assert ("gof evaluate: --truth is now --dataset" in capsys.readouterr().err) == (option == "--truth")
    assert found[0] == found[1]


@pytest.mark.parametrize(
    "line, instead",
    [
        ("evaluate R --dataset D --time-unit 2", "gof convert RESULT --time-unit SECONDS"),
        ("video R --flame-only", "gof convert RESULT --flame-only"),
        ("evaluate R --dataset D --order 5", "gof study score RESULT --dataset DATASET --order 3 5"),
        ("ingest a b --depth", "gof depth DATASET --plates"),
        ("ingest a b --width 240", "--max-size"),
        ("capture calibrate a --columns 7", "--squares 7x5"),
        ("share a b --names x", "NAME=a NAME=b"),
    ],
)
def test_what_is_gone_says_what_to_do_instead(line, instead, capsys):
    assert main(line.split()) == 1
    assert instead in capsys.readouterr().err


def test_what_the_table_recommends_exists():
    for command, changes in TABLE.items():
        for old, change in changes.options.items():
            if isinstance(change, Gone):
                said = change.instead.split("gof ")[1].split() if "gof " in change.instead else command.split()
                name = next(n for n in leaves() if said[: len(n.split())] == n.split())
                known = {option.name for option in (*options(name), *options(command))}
                assert {word.strip(";,") for word in change.instead.split() if word.startswith("--")} <= known, old
            if isinstance(change, New):
                assert change.name.startswith("--")


def test_old_presets_mean_what_they_meant(capsys):
    from gof.reconstruct.presets import effort_of

    efforts = {name: effort_of(name) for name in (*LADDER, "draft", "paper")}
    assert efforts["paper"] == efforts["full"] and efforts["draft"].iterations == 10_000
    assert "--preset paper is now --preset full" in capsys.readouterr().err
    steps = [efforts[name].iterations for name in LADDER]
    assert steps == sorted(steps) and len(set(steps)) == len(LADDER)
    with pytest.raises(GofError, match="--preset huge: there are toy, preview, standard, large, full"):
        effort_of("huge")


# ---------------------------------------------------------------- options of every command


@pytest.mark.parametrize("place", [0, 1, 4])
def test_figures_are_written_wherever_the_option_stands(tmp_path, place):
    words, file = ["sample", str(tmp_path / "s")], tmp_path / "figures.json"
    place = min(place, len(words))
    assert main([*words[:place], "--json", str(file), *words[place:]]) == 0
    assert json.loads(file.read_text())["fire"] == (tmp_path / "s/fire").as_posix()


def test_quiet_prints_nothing_and_errors_all_the_same(tmp_path, capfd):
    random_gaussians(20).save(tmp_path / "r.npz")
    assert main(["--quiet", "share", str(tmp_path / "r.npz"), "--json", str(tmp_path / "f.json")]) == 0
    assert capfd.readouterr() == ("", "") and (tmp_path / "f.json").is_file()
    assert main(["share", str(tmp_path / "none.npz"), "--quiet"]) == 1
    assert "no such file" in capfd.readouterr().err
    assert main(["share", str(tmp_path / "r.npz")]) == 0
    assert "share.html" in capfd.readouterr().out.replace("\n", ""), "the next command is not quiet"


@pytest.mark.parametrize("how", ["--verbose", "GOF_DEBUG"])
def test_verbose_shows_where_an_error_comes_from(how, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("GOF_DEBUG", raising=False)
    words = ["share", str(tmp_path / "none.npz")]
    assert main(words) == 1 and "Traceback" not in capsys.readouterr().err
    if how == "GOF_DEBUG":
        monkeypatch.setenv("GOF_DEBUG", "1")
    assert main([*words, *([how] if how == "--verbose" else [])]) == 1
    said = capsys.readouterr().err
    assert "Traceback" in said and said.rstrip().endswith("no such file or folder")


def test_what_has_no_figures_says_so(tmp_path, capsys):
    assert main(["view", "r.npz", "--json", str(tmp_path / "f.json")]) == 2
    assert "writes no figures" in capsys.readouterr().err
    assert main(["share", "--json"]) == 2 and "--json: name the file" in capsys.readouterr().err


def test_words_of_another_program_are_its_own(monkeypatch):
    from gof.commands import baseline

    got = []
    monkeypatch.setattr(baseline, "main", lambda argv: got.append(argv) or 0)
    words = ["--method", "wu", "train.py", "--quiet", "--json", "x"]
    assert main(["--verbose", "baseline", *words]) == 0 and got == [words]


# ---------------------------------------------------------------- what is there already


def finished(tmp_path, tiny_dataset):
    """Commands that write to a named place, each with its words."""
    random_gaussians(30).save(tmp_path / "r/result.npz")
    result, data = str(tmp_path / "r"), str(tiny_dataset)
    yield "share", ["share", result, "--out", "{}/a.html"]
    yield "evaluate", ["evaluate", f"{result}/result.npz", "--dataset", data, "--no-images", "--out", "{}/e"]
    yield "convert", ["convert", f"{result}/result.npz", "{}/a.ply"]
    yield "capture draw", ["capture", "draw", "--out", "{}/d.svg"]
    yield "capture target", ["capture", "target", "--out", "{}/t.pdf"]
    yield "pack", ["pack", data, "--licence", "CC0-1.0", "--authors", "A", "--out", "{}/p"]
    yield "figure removal", ["figure", "removal", data, "--out", "{}/r.png"]


def test_a_finished_file_that_was_named_is_kept_unless_asked(tmp_path, tiny_dataset, capsys):
    for name, line in finished(tmp_path, tiny_dataset):
        line = [word.format(tmp_path / "out") for word in line]
        assert main(line) == 0, name
        capsys.readouterr()
        before = {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in (tmp_path / "out").rglob("*") if p.is_file()}
        assert main(line) == 1 and "--overwrite" in capsys.readouterr().err, name
        assert before == {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in before}, f"{name}: touched"
        assert main([*line, "--overwrite"]) == 0, name
        capsys.readouterr()


def test_what_a_command_places_itself_is_brought_up_to_date(tmp_path, capsys):
    random_gaussians(20).save(tmp_path / "r.npz")
    for _ in range(2):
        assert main(["share", str(tmp_path / "r.npz")]) == 0
    assert str(tmp_path / "share.html") in capsys.readouterr().out.replace("\n", "")


def test_without_out_nothing_lands_in_the_working_folder(tmp_path, tiny_dataset, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    random_gaussians(30).save(tmp_path / "r/result.npz")
    assert main(["share", str(tmp_path / "r")]) == 0
    assert main(["evaluate", str(tmp_path / "r"), "--dataset", str(tiny_dataset), "--no-images"]) == 0
    assert main(["leaderboard", str(tmp_path / "r")]) == 0
    assert main(["figure", "removal", str(tiny_dataset)]) == 0
    assert not list((tmp_path / "here").iterdir())
    assert (tmp_path / "leaderboard/leaderboard.html").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="folders that cannot be written to, as Unix has them")
def test_a_place_that_cannot_be_written_to_has_a_remedy(tmp_path, monkeypatch, capsys):
    random_gaussians(20).save(tmp_path / "r.npz")
    monkeypatch.setattr(everywhere.os, "access", lambda path, mode: False)  # root may write everywhere
    assert main(["share", str(tmp_path / "r.npz")]) == 1
    assert "name another place with --out" in capsys.readouterr().err


# ---------------------------------------------------------------- completion, and where to ask


def test_completion_knows_commands_parts_options_and_values():
    found = words()
    assert set(commands()) <= set(found[""]) and "sync" in found["capture"]
    assert {"--dataset", "--json", "--help-all"} <= set(found["evaluate"])
    assert "gaussians" in found["reconstruct --scene"]


@pytest.mark.long
def test_the_script_for_bash_completes(tmp_path):
    script = subprocess.run([sys.executable, "-m", "gof", "completion", "bash"], capture_output=True, text=True).stdout
    (tmp_path / "gof").write_text(script)

    def completed(*line: str) -> set[str]:
        typed = " ".join(map(shlex.quote, line))
        code = f"source {tmp_path}/gof; COMP_WORDS=({typed}); COMP_CWORD={len(line) - 1}; _gof; echo ${{COMPREPLY[@]}}"
        done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
        return set(done.stdout.split())

    assert completed("gof", "rec") == {"reconstruct"}
    assert completed("gof", "capture", "s") == {"sync"}
    assert completed("gof", "evaluate", "out", "--da") == {"--dataset"}
    assert completed("gof", "reconstruct", "d", "--scene", "") == {"plates", "gaussians"}
    assert completed("gof", "capture", "sync", "a.mp4", "--tick") == {"--tick-us"}


def test_help_version_and_doctor_say_where_to_ask(monkeypatch, capsys):
    from email.message import Message

    from gof.commands import cli

    about = Message()
    about["Project-URL"] = "Homepage, https://example.org/x"
    about["Project-URL"] = "Issues, https://example.org/x/issues"
    monkeypatch.setattr(cli, "metadata", lambda name: about)
    for line in (["--help"], ["--version"], []):
        assert main(line) == 0
        assert "https://example.org/x/issues" in capsys.readouterr().out


def test_a_typo_is_guessed(capsys):
    assert main(["recontruct"]) == 2
    assert "did you mean reconstruct?" in capsys.readouterr().err


# ---------------------------------------------------------------- what moved to another command


def test_orders_of_quadrature_are_compared_by_a_study(tiny_dataset, tmp_path, capsys):
    """Order 3 with the opacity of each time is what `gof evaluate` writes; another weight is another score."""
    random_gaussians(30).save(tmp_path / "r.npz")
    asked = [str(tmp_path / "r.npz"), "--dataset", str(tiny_dataset)]
    assert main(["evaluate", *asked, "--no-images"]) == 0
    file = tmp_path / "s.json"
    varied = ["--order", "1", "3", "--opacity", "temporal", "base", "--json", str(file)]
    assert main(["study", "score", *asked, *varied]) == 0
    dve = json.loads((tmp_path / "scores.json").read_text())["dve"]
    rows = {(row["order"], row["opacity"]): row for row in json.loads(file.read_text())["rows"]}
    assert set(rows) == {(order, opacity) for order in (1, 3) for opacity in ("temporal", "base")}
    assert rows[3, "temporal"]["l2"] == dve["l2"] and rows[3, "base"]["l2"] != dve["l2"]
