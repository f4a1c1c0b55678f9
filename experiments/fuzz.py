"""Every reader and parser fuzzed by coverage (Atheris, libFuzzer), with mutators that mend lengths and checksums.

    python -m experiments.fuzz [READER ...] [--seconds 60] [--corpus out/fuzz] [--seed 1] [--page docs/fuzzing.md]

Each reader has a process of its own, its folder of inputs in CORPUS, and a time. A find is an exception that is no
AssetError of one line that names the file, an input that takes more than a second of processor time or a gigabyte, or
the end of the process. Finds lie in CORPUS/finds: the input, and beside it what was said. Numbers gather in
CORPUS/numbers.json from one run to the next; --page writes their table. Needs Atheris (`pip install atheris`). Exit
code 1: there are finds.
"""

import argparse
import hashlib
import json
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).parents[1]
OURS = ("files", "command", "avatar", "capture", "player", "train", "synth")
MOST_SECONDS, MOST_BYTES = 1.0, 1 << 30
# of an input; the largest honest example is a body model of 1.3 MB
LONGEST = 1 << 21
# until libFuzzer ends an input that does not
HANGS = 120
PAGE = """# Readers, fuzzed

Written by `python -m experiments.fuzz --page docs/fuzzing.md`: Atheris over every reader and parser, steered by the
edges of our code, with mutators that know files and mend their lengths and checksums (GLB, zip and npz, PNG, RIFF,
MP4, values of JSON). *Edges* are those that inputs reached; *slowest* is processor time of one input; *MB* is by how
much one made the process grow. A find is a stray exception, more than a second or more than a gigabyte; those of the
last run stand here, earlier ones have their tests (tests/hard_cases/test_named_faults.py).
"""
HEAD = ("| reader | inputs | refused | edges | slowest, s | MB | finds |", "|-|-|-|-|-|-|-|")


@dataclass
class Numbers:
    """Of a reader, over all runs."""

    inputs: int = 0
    refused: int = 0
    # libFuzzer's edges, in the last run
    coverage: int = 0
    seconds: float = 0.0
    slowest: float = 0.0
    megabytes: float = 0.0  # by which the process grew at most
    finds: int = 0


class Target:
    """What libFuzzer calls: one input, looked at."""

    def __init__(self, name: str, finds: Path, numbers: Path):
        from experiments.fuzz_readers import READERS, scratch

        self.kind, self.name, self.finds, self.place = READERS[name], name, finds, numbers
        self.folder, self.numbers, self.known = scratch(), Numbers(), set()
        self.begun = self.noted = time.monotonic()
        self.first = 0

    def __call__(self, data: bytes) -> None:
        from test_hostile_bytes import hostile

        path = self.folder / self.kind.name
        before, began = _grown(), time.process_time()
        try:
            self.numbers.refused += hostile(self.kind, path, data)
        except Exception as error:
            if not (isinstance(error, AssertionError) and "process_time" in str(error)):
                self.find(data, _where(error), traceback.format_exc())
        seconds, grown = time.process_time() - began, _grown() - before
        self.numbers.inputs += 1
        self.numbers.slowest = max(self.numbers.slowest, seconds)
        self.numbers.megabytes = max(self.numbers.megabytes, grown / 1e6)
        if seconds > MOST_SECONDS:
            self.find(data, "slow", f"{seconds:.1f} s of processor time")
        if grown > MOST_BYTES:
            self.find(data, "large", f"{grown / 1e6:.0f} MB")
        if time.monotonic() - self.noted > 1:
            self.note()

    def find(self, data: bytes, where: str, said: str) -> None:
        """Keep the first input of a kind."""
        if where not in self.known:
            self.known.add(where)
            self.numbers.finds += 1
            named = f"{self.name} {where}".replace(" ", "-").replace("/", "-")
            (self.finds / named[:150]).write_bytes(data)
            (self.finds / f"{named[:150]}.txt").write_text(said, errors="backslashreplace")

    def note(self) -> None:
        """The numbers so far: the process may end at any input."""
        self.noted = time.monotonic()
        self.numbers.seconds = self.noted - self.begun
        self.place.write_text(json.dumps(asdict(self.numbers)))


def _grown() -> int:
    """Bytes that this process had at most."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _where(error: Exception) -> str:
    """The kind of an exception and its last place in our code."""
    frames = [one for one in traceback.extract_tb(error.__traceback__) if str(ROOT) in one.filename]
    inner = [one for one in frames if "tests" not in one.filename and "experiments" not in one.filename] or frames[-1:]
    return f"{type(error).__name__} {Path(inner[-1].filename).name}:{inner[-1].lineno}"


def fuzz(name: str, corpus: Path, seconds: int, seed: int) -> NoReturn:
    """In a child: libFuzzer over one reader."""
    import atheris

    from experiments import fuzz_mutators
    from experiments.fuzz_readers import READERS, honest

    inputs, finds = corpus / "inputs" / name.replace(" ", "-"), corpus / "finds"
    for folder in (inputs, finds):
        folder.mkdir(parents=True, exist_ok=True)
    whole = honest(name)
    (inputs / hashlib.sha1(whole).hexdigest()).write_bytes(whole)
    target, text = Target(name, finds, corpus / "running.json"), READERS[name].text

    def mutate(data: bytes, most: int, number: int) -> bytes:
        rng = random.Random(number)

        def plain(part: bytes) -> bytes:
            return atheris.Mutate(part, max(len(part) + 64, 256)) if part else bytes([rng.randrange(256)])

        return fuzz_mutators.mutated(data, rng, plain, text=text)[:most]

    # what the first loads is no input's
    target(whole)
    target.numbers = Numbers()
    artifacts = f"{finds}/{name.replace(' ', '-')}-"
    atheris.Setup(
        ["fuzz", f"-max_total_time={seconds}", f"-timeout={HANGS}", "-rss_limit_mb=4000", f"-max_len={LONGEST}",
         f"-artifact_prefix={artifacts}", f"-seed={seed}", "-len_control=0", str(inputs)],
        target, custom_mutator=mutate,
    )  # fmt: skip
    atheris.Fuzz()
    raise AssertionError("libFuzzer came back")


def forked(name: str, corpus: Path, seconds: int, seed: int) -> tuple[int, str]:
    """The exit status of a child that fuzzes, and what it said: all modules are loaded once, in the parent."""
    with tempfile.TemporaryFile("w+", errors="replace") as said:
        pid = os.fork()
        if not pid:
            for handle in (1, 2):
                os.dup2(said.fileno(), handle)
            try:
                fuzz(name, corpus, seconds, seed)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(99)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        said.seek(0)
        return code, said.read()


def run(name: str, corpus: Path, seconds: int, seed: int) -> Numbers:
    """Fuzz one reader in a child; begun again for what is left of the time where an input ends it."""
    total, end = Numbers(), time.monotonic() + seconds
    while (left := round(end - time.monotonic())) >= 5 or total.inputs == 0:
        running = corpus / "running.json"
        running.unlink(missing_ok=True)
        code, said = forked(name, corpus, max(left, 5), seed)
        found = Numbers(**json.loads(running.read_text())) if running.exists() else Numbers()
        edges = re.findall(r"cov: (\d+)", said)
        total.coverage = max([total.coverage, *map(int, edges)])
        ended = re.findall(r"Test unit written to (.*)", said)
        for field in ("inputs", "refused", "seconds", "finds"):
            setattr(total, field, vars(total)[field] + vars(found)[field])
        total.slowest, total.megabytes = max(total.slowest, found.slowest), max(total.megabytes, found.megabytes)
        for path in ended:
            total.finds += 1
            Path(path).with_name(Path(path).name + ".txt").write_text(said[-6000:])
        if code and not ended:
            raise SystemExit(f"{name}: exit {code}: {said[-3000:]}")
        seed += 1
    return total


def added(old: dict, new: Numbers) -> Numbers:
    """Numbers of several runs."""
    before = Numbers(**old)
    return Numbers(
        before.inputs + new.inputs, before.refused + new.refused, max(before.coverage, new.coverage),
        before.seconds + new.seconds, max(before.slowest, new.slowest), max(before.megabytes, new.megabytes), new.finds,
    )  # fmt: skip


def page(numbers: dict[str, Numbers]) -> str:
    """The table of docs/fuzzing.md."""
    total = sum(one.inputs for one in numbers.values())
    hours = sum(one.seconds for one in numbers.values()) / 3600
    lines = [PAGE, f"{total:,} inputs, {hours:.1f} hours.", "", *HEAD]
    for name, one in sorted(numbers.items(), key=lambda pair: pair[0].lower()):
        share = 100 * one.refused / max(one.inputs, 1)
        cells = [name, f"{one.inputs:,}", f"{share:.0f} %", one.coverage, f"{one.slowest:.2f}", f"{one.megabytes:.0f}"]
        lines.append("| " + " | ".join(map(str, [*cells, one.finds])) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", help="words of their names; all without any")
    parser.add_argument("--seconds", type=int, default=60, help="for each reader")
    parser.add_argument("--corpus", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--page", type=Path, help="write the table of all numbers there")
    asked = parser.parse_args()
    corpus = asked.corpus.resolve()
    sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("", "hard_cases", "player/live")]
    import atheris

    # its stubs lack it
    with atheris.instrument_imports(include=list(OURS), enable_loader_override=False):  # pyright: ignore
        from experiments.fuzz_readers import names_like

    corpus.mkdir(parents=True, exist_ok=True)
    place = corpus / "numbers.json"
    kept = json.loads(place.read_text()) if place.exists() else {}
    finds = 0
    for name in names_like(asked.readers) if asked.seconds else ():
        found = run(name, corpus, asked.seconds, asked.seed)
        finds += found.finds
        kept[name] = asdict(added(kept.get(name, {}), found))
        place.write_text(json.dumps(kept, indent=1))
        print(f"{name}: {found.inputs} inputs, {found.coverage} edges, slowest {found.slowest:.2f} s, "
              f"{found.megabytes:.0f} MB, {found.finds} finds", flush=True)  # fmt: skip
    if asked.page:
        asked.page.write_text(page({name: Numbers(**one) for name, one in kept.items()}))
    return int(finds > 0)


if __name__ == "__main__":
    sys.exit(main())
