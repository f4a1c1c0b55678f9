"""Settings are written once: names, types, limits, defaults and help of a command line come from a dataclass."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest

from command.command_line import Help, Hidden, Option, OptionGroup, parse, parser_of
from command.settings import LARGEST_INTEGER, Above, AtLeast, AtMost, OneOf, check, settings_json

ABOUT = Help("selfscan try", "Tries settings.", "example: selfscan try a b")


@dataclass(frozen=True)
class Try:
    """Every kind of field that commands have."""

    source: Annotated[Path, Option(positional=True, metavar="SRC"), "what is read"]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "what is written"]
    more: Annotated[tuple[str, ...], Option(positional=True, several=True), "others"] = ()
    count: Annotated[int, AtLeast(1), AtMost(100), "how many"] = 3
    rate: Annotated[float, Above(0), "frames per second"] = 30.0
    seconds: Annotated[float | None, Above(0), "of one turn; none: the film's"] = None
    light: Annotated[str, OneOf(("even", "soft")), "of the room"] = "even"
    quality: Annotated[Literal["normal", "high"], "of the network"] = "normal"
    truth: Annotated[bool, Option(("--no-truth",)), "leave out the truth"] = True
    force: Annotated[bool, "begin anew"] = False
    joint: Annotated[tuple[str, ...], Option(repeated=True), "a joint to look at"] = ()
    compare: Annotated[str | None, Option(const="mannequin", metavar="AVATAR"), "draw one frame"] = None
    first: Annotated[int | None, Option(exclusive="which"), "only this one"] = None
    last: Annotated[int | None, Option(exclusive="which"), "only that one"] = None
    inner: Annotated[int, Hidden(), "no option"] = 7
    size: Annotated[int, OptionGroup("the picture"), "of its side"] = 64
    seed: Annotated[int, OptionGroup("the picture").rare, "of its noise"] = 0
    gpu: Annotated[int, OptionGroup("the machine").rare, "which one"] = 0

    def __post_init__(self):
        check(self)
        if self.force and self.count == 2:
            raise ValueError("count 2 cannot be forced")


def test_what_is_not_given_is_the_default():
    assert parse(Try, ["a", "-o", "b"], ABOUT) == Try(Path("a"), Path("b"))


def test_every_kind_of_field_is_read():
    words = ["a", "x", "y", "-o", "b", "--count", "5", "--rate", "24", "--seconds", "1.5",
             "--light", "soft", "--quality", "high", "--no-truth", "--force", "--joint", "neck",
             "--joint", "head", "--compare"]  # fmt: skip
    expected = Try(Path("a"), Path("b"), ("x", "y"), 5, 24.0, 1.5, "soft", "high", False, True, ("neck", "head"),
                   "mannequin")  # fmt: skip
    assert parse(Try, words, ABOUT) == expected
    assert parse(Try, ["a", "-o", "b", "--compare", "me.glb"], ABOUT).compare == "me.glb"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--count", "0"], "--count: expected at least 1, found 0"),
        (["--count", "101"], "--count: expected at most 100, found 101"),
        (["--count", "9" * 23], "--count: expected at most 9007199254740992, found '9999"),
        (["--count", "9" * 6000], "--count: expected at most"),
        (["--count", "1.5"], "--count: expected a whole number, found '1.5'"),
        (["--count", "٣"], "--count: expected a whole number"),
        (["--rate", "0"], "--rate: expected more than 0, found 0"),
        (["--rate", "nan"], "--rate: expected a finite number, found 'nan'"),
        (["--rate", "1e999"], "--rate: expected a finite number"),
        (["--seconds", "-1"], "--seconds: expected more than 0"),
        (["--light", "dark"], "--light: invalid choice: 'dark'"),
        (["--quality", "best"], "--quality: invalid choice: 'best'"),
        (["--count", "2", "--force"], "count 2 cannot be forced"),
        (["--first", "1", "--last", "2"], "not allowed with argument --first"),
        (["--inner", "3"], "unrecognized arguments: --inner 3;"),
        (["--cuont", "3"], "unrecognized arguments: --cuont 3; did you mean --count?"),
    ],
)
def test_a_mistake_is_one_line_and_wrong_usage(capsys, words, message):
    with pytest.raises(SystemExit) as stopped:
        parse(Try, ["a", "-o", "b", *words], ABOUT)
    assert stopped.value.code == 2
    printed = capsys.readouterr().err
    assert message in printed and printed.count("\n") == 1 and "try --help; `try --help`" not in printed


def test_help_says_meaning_choices_and_default():
    text = " ".join(parser_of(Try, ABOUT).format_help().split())
    assert "--count N how many (default: 3)" in text
    assert "--rate X frames per second (default: 30)" in text
    assert "--light {even,soft} of the room (default: even)" in text
    assert "--no-truth leave out the truth" in text and "--truth" not in text.replace("--no-truth", "")
    assert "example: selfscan try a b" in text and "inner" not in text


def test_help_has_groups_and_help_all_the_rare_options_too(capsys):
    short, full = (parser_of(Try, ABOUT._replace(more="keys"), everything=on).format_help() for on in (False, True))
    assert "the picture:\n  --size N" in short and "all options, 2 more" in short and "keys" not in short
    assert not any(word in short for word in ("--seed", "--gpu", "the machine"))
    assert "--seed N" in full and "the machine:\n  --gpu N" in full and full.endswith("keys\n")
    assert short.startswith("usage: selfscan try SRC [more ...] -o OUT [options]\n")
    for option, text in (("--help", short), ("--help-all", full)):
        with pytest.raises(SystemExit) as stopped:
            parse(Try, [option], ABOUT._replace(more="keys"))
        assert stopped.value.code == 0 and capsys.readouterr().out == text
    assert parse(Try, ["a", "-o", "b", "--seed", "3"], ABOUT).seed == 3


def test_records_made_in_code_obey_the_same_limits():
    with pytest.raises(ValueError, match="count: expected at least 1, found 0"):
        Try(Path("a"), Path("b"), count=0)
    with pytest.raises(ValueError, match="rate: expected a finite number, found inf"):
        Try(Path("a"), Path("b"), rate=float("inf"))
    with pytest.raises(ValueError, match="count: expected at most 9007199254740992, found a number of 17 digits"):
        Try(Path("a"), Path("b"), count=LARGEST_INTEGER * 10)


def test_settings_become_json():
    facts_of = settings_json(Try(Path("a"), Path("b"), joint=("neck",)))
    assert facts_of["source"] == "a" and facts_of["joint"] == ["neck"] and facts_of["rate"] == 30.0


@dataclass(frozen=True)
class Both:
    """A command of its own place and of settings that others use too."""

    run: Annotated[Path, Option(positional=True, metavar="RUN"), "run folder"]
    inner: Annotated[Try, "what is tried"]


def test_settings_inside_settings_are_options_too():
    made = parse(Both, ["r", "a", "-o", "b", "--count", "9"], ABOUT)
    assert made == Both(Path("r"), Try(Path("a"), Path("b"), count=9))
