"""GLSL as our shaders are written, taken apart into functions and statements and put together again.

No grammar of the whole language: one variant of an assembled stage (conditions decided, comments gone), its functions,
and in them declarations, assignments, `if`, `for`, blocks and the rest, with the types of what they name.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

FLOATS = ("float", "vec2", "vec3", "vec4")
TYPE = r"(?:float|int|uint|bool|[iub]?vec[234]|mat[234](?:x[234])?|void)"
FUNCTION = re.compile(rf"^({TYPE}) (\w+)\(([^)]*)\) \{{", re.MULTILINE)
DECLARED = re.compile(rf"^({TYPE}) (\w+)(?: = (.*))?;$", re.DOTALL)
ASSIGNED = re.compile(r"^([\w.\[\]]+) ([-+*/]?=) (.*);$", re.DOTALL)
MEMBER = re.compile(rf"^({TYPE}) (\w+)(?:\[\w+\])?;$", re.MULTILINE)
GLOBAL = re.compile(rf"^(?:flat )?(?:in|out|uniform|const) ({TYPE}) (\w+)\b", re.MULTILINE)
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
CONDITION = re.compile(r"#\s*if (\w+) ([!=]=) (\d+)")
CLOSING = {"(": ")", "{": "}", "[": "]"}


def decided(source: str) -> str:
    """A stage of one variant: its `#if`s followed, without comments, defines and `#line`s; one blank between words.

    Raises:
        ValueError: a directive that player/gl/shader.py does not let through.
    """
    defines, branches, lines = {}, [], []
    for line in COMMENT.sub("", source).splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "#define":
            defines[words[1]] = int(words[2])
        elif words[0] == "#if":
            asked = CONDITION.match(line.strip())
            if asked is None:
                raise ValueError(f"expected `#if NAME == number`, found {line!r}")
            branches.append((defines.get(asked[1], 0) == int(asked[3])) == (asked[2] == "=="))
        elif words[0] == "#else":
            branches[-1] = not branches[-1]
        elif words[0] == "#endif":
            branches.pop()
        elif all(branches) and words[0] != "#line":
            if words[0].startswith("#") and words[0] != "#version":
                raise ValueError(f"an unknown directive: {line!r}")
            lines.append(" ".join(words))
    return "\n".join(lines) + "\n"


@dataclass
class Statement:
    """head: all of a simple statement, or what stands before the body of an `if`, `for`, `else`."""

    head: str
    body: "list[Statement] | None" = None  # of a block

    def text(self) -> str:
        if self.body is None:
            return self.head
        return f"{self.head} {{\n" + "\n".join(one.text() for one in self.body) + "\n}"


@dataclass
class Function:
    """One function, and the types of the names in it."""

    kind: str
    name: str
    parameters: str
    body: list[Statement]
    names: dict[str, str] = field(default_factory=dict)

    def text(self) -> str:
        return Statement(f"{self.kind} {self.name}({self.parameters})", self.body).text() + "\n"


@dataclass
class Stage:
    """A stage: text between functions, and functions, in their order."""

    parts: list[str | Function]

    def functions(self) -> list[Function]:
        return [part for part in self.parts if isinstance(part, Function)]

    def text(self) -> str:
        return "".join(part if isinstance(part, str) else part.text() for part in self.parts)


def end_of(text: str, at: int) -> int:
    """Where the bracket that opens at `at` closes."""
    depth = 0
    for place in range(at, len(text)):
        depth += (text[place] in "({[") - (text[place] in ")}]")
        if depth == 0:
            return place
    raise ValueError(f"nothing closes {text[at : at + 40]!r}")


def outside(text: str, found: Callable[[str, int], bool]) -> list[int]:
    """Places outside of all brackets where a condition holds."""
    places, depth = [], 0
    for place, letter in enumerate(text):
        depth += (letter in "({[") - (letter in ")}]")
        if depth == 0 and found(text, place):
            places.append(place)
    return places


def statements(text: str) -> list[Statement]:
    """The statements of a body."""
    found, at = [], 0
    while text[at:].strip():
        at += len(text[at:]) - len(text[at:].lstrip())
        statement, at = _statement(text, at)
        found += statement
    return found


def _statement(text: str, at: int) -> tuple[list[Statement], int]:
    """A statement from `at` on, a declaration of several names as several, and where it ends."""
    if text[at] == "{":
        end = end_of(text, at)
        return [Statement("", statements(text[at + 1 : end]))], end + 1
    word = re.compile(r"if|for|else if|else").match(text, at)
    if word and not (text[word.end()].isalnum() or text[word.end()] == "_"):
        head = word.end() if word[0] == "else" else end_of(text, text.index("(", at)) + 1
        start = head + len(text[head:]) - len(text[head:].lstrip())
        inner, end = _statement(text, start)
        body = inner[0].body if text[start] == "{" else inner
        return [Statement(" ".join(text[at:head].split()), body)], end
    end = at + outside(text[at:], lambda t, k: t[k] == ";")[0] + 1
    whole = " ".join(text[at:end].split())
    kind = re.match(rf"({TYPE}) (?=\w)", whole)
    if kind is None:
        return [Statement(whole)], end
    pieces = split(whole[kind.end() : -1], ",")
    return [Statement(f"{kind[1]} {piece.strip()};") for piece in pieces], end


def split(text: str, letter: str) -> list[str]:
    """Cut at a letter outside of all brackets."""
    cuts = [-1, *outside(text, lambda t, k: t[k] == letter), len(text)]
    return [text[a + 1 : b] for a, b in zip(cuts, cuts[1:])]


def walk(body: list[Statement]) -> Iterator[tuple[list[Statement], int]]:
    """Every statement, as its list and its place there, last ones first: they may be replaced on the way."""
    for place in reversed(range(len(body))):
        inner = body[place].body
        if inner is not None:
            yield from walk(inner)
        yield body, place


def stage_of(source: str) -> Stage:
    """A stage taken apart; `source` as `decided` leaves it."""
    parts, at = [], 0
    known = [*MEMBER.findall(source), *GLOBAL.findall(source), *(found[:2] for found in FUNCTION.findall(source))]
    everywhere = {name: kind for kind, name in known} | {"gl_Position": "vec4"}
    while (match := FUNCTION.search(source, at)) is not None:
        end = end_of(source, match.end() - 1)
        body = statements(source[match.end() : end])
        given = (words.split()[-2:] for words in match[3].split(",") if words.strip())
        names = everywhere | {name: kind for kind, name in given}
        for owner, place in walk(body):
            found = DECLARED.match(owner[place].head)
            names |= {found[2]: found[1]} if found else {}
        parts += [source[at : match.start()], Function(match[1], match[2], match[3], body, names)]
        at = end + 1
    return Stage([*parts, source[at:]])


def float_type(target: str, names: dict[str, str]) -> str | None:
    """The type of what is assigned to, if it is of floats: a name, or components of one."""
    name, _, components = target.partition(".")
    kind = names.get(name)
    if kind not in FLOATS or "[" in target or "." in components:
        return None
    return FLOATS[len(components) - 1] if components else kind
