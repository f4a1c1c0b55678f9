"""Ten rewrites of GLSL that change no picture: what a driver's compiler makes of a shader is put in another way.

The idea is GraphicsFuzz's (Donaldson et al. 2017, "Automated testing of graphics shader compilers"); the ten are
chosen for our own shaders. A uniform that nobody sets, and that is 0 therefore, keeps the compiler from seeing that
nothing changes. Each is exact in floats, also where it reorders: a + b is b + a, a - b + c is c + (a - b).
"""

import re
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple
from unittest.mock import patch
from zlib import crc32

import moderngl
import numpy as np

import player.web.essl
from experiments.glsl_statements import (
    ASSIGNED,
    DECLARED,
    FLOATS,
    Function,
    Stage,
    Statement,
    decided,
    float_type,
    outside,
    split,
    stage_of,
    walk,
)

ZERO = "rewritten_zero"
CONSTANT = re.compile(r"^const (\w+) (\w+) = (.*);\n", re.MULTILINE)
LITERAL = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])")
# where what only links and sets up ends
OPENING = re.compile(r"^(?:#version .*\n)(?:precision .*\n)*")


class Assigned(NamedTuple):
    """A statement that gives floats a value: where it stands, its type, what is assigned to, `TARGET = `, the value."""

    function: Function
    body: list[Statement]
    place: int
    kind: str
    target: str
    before: str
    value: str


@dataclass
class Rewriting:
    """One round of one rewrite over a stage: what it draws, names it makes, places it changed."""

    stage: Stage
    rng: np.random.Generator
    prefix: str
    share: float
    sites: int = 0

    def __post_init__(self):
        self.numbers = count()

    def chosen(self) -> bool:
        taken = bool(self.rng.random() < self.share)
        self.sites += taken
        return taken

    def name(self) -> str:
        return f"{self.prefix}_{next(self.numbers)}"

    def simple(self):
        """(function, list, place, statement) for each statement that may be changed."""
        for function in self.stage.functions():
            for body, place in walk(function.body):
                if not body[place].head.startswith("const "):
                    yield function, body, place, body[place]

    def assigned(self):
        """Those that give floats a value."""
        for function, body, place, statement in self.simple():
            found = DECLARED.match(statement.head)
            if found and found[3] and found[1] in FLOATS:
                before = f"{found[1]} {found[2]} = "
                yield Assigned(function, body, place, found[1], found[2], before, found[3])
                continue
            found = None if statement.body is not None else ASSIGNED.match(statement.head)
            kind = float_type(found[1], function.names) if found else None
            if found and kind:
                yield Assigned(function, body, place, kind, found[1], f"{found[1]} {found[2]} ", found[3])


def dead_branches(at: Rewriting) -> None:
    """What never runs spoils what was just computed."""
    for one in list(at.assigned()):
        if at.chosen():
            spoilt = Statement(f"{one.target} *= 2.0;")
            one.body.insert(one.place + 1, Statement(f"if ({ZERO} > 0.5)", [spoilt]))


def loops_of_one(at: Rewriting) -> None:
    """A statement that declares nothing runs in a loop, once."""
    for _, body, place, statement in list(at.simple()):
        follows = place + 1 < len(body) and body[place + 1].head.startswith("else")
        plain = ASSIGNED.match(statement.head) if statement.body is None else statement.head.startswith("if")
        if plain and not follows and not re.search(r"\b(break|continue)\b", statement.text()) and at.chosen():
            k = at.name()
            body[place] = Statement(f"for (int {k} = 0; {k} < 1 + int({ZERO}); {k}++)", [statement])


def times_one(at: Rewriting) -> None:
    for one in at.assigned():
        if at.chosen():
            one.body[one.place] = Statement(f"{one.before}({one.value}) * (1.0 + {ZERO});")


def vectors_split(at: Rewriting) -> None:
    """A vector is computed, taken apart and put together."""
    for one in list(at.assigned()):
        if one.kind != "float" and one.before.endswith(" = ") and at.chosen():
            whole = at.name()
            parts = ", ".join(f"{whole}.{c}" for c in "xyzw"[: int(one.kind[3])])
            one.body[one.place] = Statement(f"{one.before}{one.kind}({parts});")
            one.body.insert(one.place, Statement(f"{one.kind} {whole} = {one.value};"))


def constants_unfolded(at: Rewriting) -> None:
    """A number is a sum that the compiler does not know."""
    for *_, statement in at.simple():
        statement.head = LITERAL.sub(lambda n: f"({n[1]} + {ZERO})" if at.chosen() else n[1], statement.head)


def constants_folded(at: Rewriting) -> None:
    """A constant's name is its value."""
    text = at.stage.text()
    for kind, name, value in CONSTANT.findall(text):
        if at.chosen():
            text = text.replace(f"const {kind} {name} = {value};\n", "")
            text = re.sub(rf"(?<![\w.]){name}\b", lambda _: f"({value})", text)
    at.stage.parts = stage_of(text).parts


def temporaries(at: Rewriting) -> None:
    """A value, also of a function, passes through names of its own."""
    for one in list(at.assigned()):
        if one.before.endswith(" = ") and at.chosen():
            new = at.name()
            given = [Statement(f"{one.kind} {new};"), Statement(f"{new} = {one.value};")]
            one.body[one.place : one.place + 1] = [*given, Statement(f"{one.before}{new};")]
    for function, body, place, statement in list(at.simple()):
        if statement.head.startswith("return ") and at.chosen():
            new = at.name()
            given = Statement(f"{function.kind} {new} = {statement.head[7:]}")
            body[place : place + 1] = [given, Statement(f"return {new};")]


def operands_exchanged(at: Rewriting) -> None:
    """The last sum or product of a value the other way round, unless a matrix is in it."""
    for one in at.assigned():
        other = _exchanged(one.value, one.function)
        if other is not None and at.chosen():
            one.body[one.place] = Statement(f"{one.before}{other};")


def _exchanged(value: str, function: Function) -> str | None:
    if any(function.names.get(name, "").startswith("mat") for name in re.findall(r"\w+", value)):
        return None
    if outside(value, lambda t, k: t[k] in "?<>=&|"):
        return None
    for signs in ("+-", "*/"):
        found = outside(value, lambda t, k: t[k] in signs and t[k - 1 : k + 2] == f" {t[k]} ")
        if found:
            last = found[-1]
            return f"{value[last + 2 :]} {signs[0]} ({value[:last].strip()})" if value[last] == signs[0] else None
    return None


def branches_inverted(at: Rewriting) -> None:
    """The condition is denied, its two sides change places."""
    for _, body, place, statement in list(at.simple()):
        if statement.head.startswith("if ") and at.chosen():
            other = body[place + 1].head if place + 1 < len(body) else ""
            denied, condition = statement.body, f"if (!{statement.head[3:]})"
            if other == "else":
                body[place].head, body[place].body, body[place + 1].body = condition, body[place + 1].body, denied
            elif not other.startswith("else"):
                body[place : place + 1] = [Statement(condition, []), Statement("else", denied)]
    for one in at.assigned():
        pieces = [part for side in split(one.value, "?") for part in split(side, ":")]
        if len(pieces) == 3 and at.chosen():
            condition, yes, no = (piece.strip() for piece in pieces)
            one.body[one.place] = Statement(f"{one.before}!({condition}) ? {no} : {yes};")


def functions_wrapped(at: Rewriting) -> None:
    """A function is another that calls it."""
    parts: list[str | Function] = []
    for part in at.stage.parts:
        parts.append(part)
        if isinstance(part, Function) and at.chosen():
            inner = at.name()
            names = ", ".join(words.split()[-1] for words in part.parameters.split(",") if words.strip())
            call = f"{'' if part.kind == 'void' else 'return '}{inner}({names});"
            outer = Function(part.kind, part.name, part.parameters, [Statement(call)], part.names)
            parts[-1:] = [Function(part.kind, inner, part.parameters, part.body, part.names), "\n", outer]
    at.stage.parts = parts


REWRITES: dict[str, Callable[[Rewriting], None]] = {
    "dead branches": dead_branches,
    "loops of one": loops_of_one,
    "times one": times_one,
    "vectors split": vectors_split,
    "constants unfolded": constants_unfolded,
    "constants folded": constants_folded,
    "temporaries": temporaries,
    "operands exchanged": operands_exchanged,
    "branches inverted": branches_inverted,
    "functions wrapped": functions_wrapped,
}


@dataclass
class Plan:
    """Which rewrites, one after the other, at what share of the places that they fit; and what they did."""

    names: tuple[str, ...]
    seed: int = 0
    share: float = 0.6
    sites: int = 0

    def rewritten(self, source: str) -> str:
        """A stage in another way; the same for the same seed."""
        rng = np.random.default_rng([self.seed, crc32(source.encode())])
        text = decided(source)
        for number, name in enumerate(self.names):
            at = Rewriting(stage_of(text), rng, f"rewritten_{number}", self.share)
            REWRITES[name](at)
            text, self.sites = at.stage.text(), self.sites + at.sites
        opening = OPENING.match(text)
        assert opening is not None, text[:60]
        return f"{opening[0]}uniform float {ZERO};\n{text[opening.end() :]}"


@contextmanager
def rewriting(plan: Plan):
    """Every program that is made in this block, also those of web pages, is rewritten first."""
    plain, essl = moderngl.Context.program, player.web.essl.essl

    def program(self, *, vertex_shader, fragment_shader, **more):
        stages = plan.rewritten(vertex_shader), plan.rewritten(fragment_shader)
        return plain(self, vertex_shader=stages[0], fragment_shader=stages[1], **more)

    anew = lambda source: plan.rewritten(essl(source))
    with patch.object(moderngl.Context, "program", program), patch.object(player.web.essl, "essl", anew):
        yield plan
