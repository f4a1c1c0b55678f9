"""Small errors planted by chance in the numeric core, one at a time: how many do the tests of each file notice?

    pip install cosmic-ray && python -m experiments.sampled_mutants -o docs/mutants.md --count 100 --seed 0

cosmic-ray plants them: another operator, another number, a comparison turned round, a condition negated, a loop not
begun. As many are drawn of each file, evenly over its places, from the seed. One that lives is a hole in the tests:
it gets a test, or a line in `EQUAL` with the reason why no test could tell. Exit code 1: more live than `--most`.
"""

import argparse
import random
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bench.report.writer import markdown_table
from experiments.mutants import HARD, ROOT, copied, outcome
from experiments.program import end_with, note
from files.whole import write_text

# file: tests that should notice
CORE = {
    "avatar/rotation.py": f"tests/avatar/test_rotation.py {HARD}rotations.py",
    "avatar/skinning.py": f"{HARD}skinning.py {HARD}inverse_skinning.py",
    "avatar/kinematics.py": "tests/avatar/test_rotation.py tests/capture/fit/test_close_ups.py",
    "avatar/similarity.py": f"{HARD}registration.py",
    "geometry/icp.py": f"{HARD}registration.py tests/geometry/test_icp.py",
    "geometry/least_squares.py": "tests/geometry/test_icp.py",
    "geometry/isosurface.py": f"tests/geometry/test_isosurface.py {HARD}surface_atlas.py",
    "train/render.py": f"{HARD}volume_rendering.py tests/train/test_integrals.py",
    "train/loss.py": f"{HARD}volume_rendering.py tests/train/test_integrals.py",
    "player/pose/ik.py": "tests/player/test_ik.py",
    "player/live/osc.py": "tests/player/live/test_vmc.py",
    "player/live/one_euro.py": f"tests/player/live/test_take.py {HARD}live.py",
    "player/effects/loose_motion.py": f"tests/player/effects/test_secondary_motion.py {HARD}effects.py",
    "bake/texture/seams.py": "tests/bake/test_video_texture.py tests/bake/test_texels.py",
}
# (file, line as it was, as planted): why it is the same program, or no worse one
EQUAL: dict[tuple[str, str, str], str] = {
    ("avatar/skinning.py", "bones = quaternion_from_matrix(transforms[..., :3, :3])",
     "bones = quaternion_from_matrix(transforms[..., :3, : 4])"): "a fourth column is not read",
    ("train/loss.py", "return (displacement.square().sum(-1) + 1e-12).sqrt().mean()",
     "return (displacement.square().sum(+1) + 1e-12).sqrt().mean()"): "of two axes the second is the last",
    ("player/live/osc.py", "@lru_cache(64)", "@lru_cache( 65)"): "one pattern more is kept",
}  # fmt: skip
# alternatives of types and flags, which are no arithmetic
SKIPPED = ("BitOr", "BitAnd", "BitXor", "RemoveDecorator", "ExceptionReplacer")


class Mutant(NamedTuple):
    file: str
    line: int
    before: str
    after: str
    code: str  # of the whole file


def places(source: str) -> list[tuple[str, int]]:
    """Each error that cosmic-ray knows for a file: its operator's name, and which of its places."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    nodes, found = list(ast_nodes(get_ast(source))), []
    for name in sorted(operator_names()):
        operator = get_operator(name)
        if not operator.arguments() and not any(word in name for word in SKIPPED):
            count = sum(1 for node in nodes for _ in operator().mutation_positions(node))
            found += [(name, place) for place in range(count)]
    return found


def drawn(file: str, count: int, seed: int) -> Iterator[Mutant]:
    """Some errors of a file, each on another line as long as there are any."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (ROOT / file).read_text("utf-8")
    lines, every, used = source.splitlines(), places(source), set()
    random.Random(f"{seed} {file}").shuffle(every)
    for name, place in every:
        code = mutate_code(source, get_operator(name)(), place)
        changed = [
            i for i, pair in enumerate(zip(lines, (code or source).splitlines(), strict=False)) if len(set(pair)) > 1
        ]
        if code is None or not changed or changed[0] in used:
            continue
        used.add(changed[0])
        at = changed[0]
        yield Mutant(file, at + 1, lines[at].strip(), code.splitlines()[at].strip(), code)
        if len(used) == count:
            return


def tried(count: int, seed: int, words: Sequence[str]) -> list[dict[str, Any]]:
    """What became of each."""
    results = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = copied(Path(folder))
        for file, tests in CORE.items():
            if words and not any(word in file for word in words):
                continue
            for mutant in drawn(file, count, seed):
                found = outcome(tree, file, mutant.code, tests)
                why = EQUAL.get((file, mutant.before, mutant.after))
                results.append({"file": file, "line": mutant.line, "before": mutant.before, "after": mutant.after,
                                "outcome": found, "equal": why})  # fmt: skip
                note(f"{file}:{mutant.line} {mutant.after[:70]!r}: {found}{f' ({why})' if why else ''}")
    return results


def page(results: Sequence[dict[str, Any]], count: int, seed: int) -> str:
    """A line for each file, then those that live."""
    rows = []
    for file in dict.fromkeys(result["file"] for result in results):
        own = [result for result in results if result["file"] == file]
        lives = [result for result in own if result["outcome"] == "LIVES"]
        equal = sum(result["equal"] is not None for result in lives)
        rows.append([file, str(len(own)), str(len(own) - len(lives)), str(equal), str(len(lives) - equal), CORE[file]])
    lives = [result for result in results if result["outcome"] == "LIVES"]
    open_ = sum(result["equal"] is None for result in lives)
    cell = lambda text: f"`{text.replace('|', chr(92) + '|')}`"
    return "\n".join([
        "# Errors planted by chance",
        "",
        f"Written by `python -m experiments.sampled_mutants --count {count} --seed {seed}` (errors of cosmic-ray,",
        f"{count} lines of each file at most). {len(results)} were planted; {open_} live",
        f"({open_ / max(len(results), 1):.0%}), {len(lives) - open_} more change nothing.",
        "",
        *markdown_table(["file", "planted", "killed", "the same program", "live", "tests"], rows),
        "",
        "## Those that no test notices",
        "",
        *markdown_table(["where", "was", "planted", "why"], [
            [f"{one['file']}:{one['line']}", cell(one["before"]), cell(one["after"]), one["equal"] or "a hole"]
            for one in lives]),
        "",
    ])  # fmt: skip


def main(argv: Sequence[str]) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        "python -m experiments.sampled_mutants", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("words", nargs="*", help="only files whose name holds one")
    parser.add_argument("-o", "--out", type=Path, help="Markdown page")
    parser.add_argument("--count", type=int, default=10, help="lines of each file (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--most", type=float, default=0.1, help="share that may live (%(default)s)")
    given = parser.parse_args(argv)
    results = tried(given.count, given.seed, given.words)
    if given.out:
        write_text(given.out, page(results, given.count, given.seed))
    live = sum(one["outcome"] == "LIVES" and one["equal"] is None for one in results)
    print(f"{live} of {len(results)} live")
    return int(live > given.most * len(results))


if __name__ == "__main__":
    end_with(main)
