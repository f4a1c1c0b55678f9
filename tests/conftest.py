"""What all tests share: the sample data, what is made once for all processes, and the report of the hard cases."""

import contextlib
import fcntl
import os
import platform
import random
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


def sample_data() -> Path | None:
    """The folder of sample people and motions: SELFSCAN_DATA, else ../shared/data beside the repository."""
    for place in (os.environ.get("SELFSCAN_DATA"), ROOT.parent / "shared" / "data"):
        if place and Path(place).is_dir():
            return Path(place)
    return None


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the sample data; without it the test is skipped, and fails in continuous integration."""
    found = sample_data()
    if found is None:
        message = "no sample data: set SELFSCAN_DATA to its folder"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    return found


@pytest.fixture(scope="session")
def made_once(tmp_path_factory) -> Callable[[str, Callable[[Path], object]], Path]:
    """once(name, make): the path that make(path) filled, in one process of pytest-xdist for all; only to read. Runs of
    pytest that name the same folder in SELFSCAN_MADE share it too."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    shared = Path(os.environ.get("SELFSCAN_MADE") or shared)

    def once(name: str, make: Callable[[Path], object]) -> Path:
        place, unfinished = shared / "made" / name, shared / "unfinished" / name
        for folder in (place.parent, unfinished.parent):
            folder.mkdir(exist_ok=True)
        with open(unfinished.with_suffix(".lock"), "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not place.exists():
                make(unfinished)
                unfinished.rename(place)
        return place

    return once


@pytest.fixture(scope="session")
def tiny_capture(made_once) -> Path:
    """A capture folder of the painted body, four frames of 48 pixels for each part."""
    from painted_capture import write_capture

    return made_once("capture", write_capture)


@pytest.fixture(scope="session")
def tiny_run(made_once, tiny_capture) -> Path:
    """The run folder of a training on `tiny_capture` by the preset of tiny.py, seed 1."""
    from tiny import tiny_training

    return made_once("run", lambda out: tiny_training(tiny_capture, out, "--seed", "1"))


@pytest.fixture(scope="session")
def tiny_avatar_file(made_once, tiny_run) -> Path:
    """The avatar that was baked from `tiny_run`."""
    from selfscan.__main__ import main

    def bake(out: Path) -> None:
        assert main(["bake", str(tiny_run), "-o", str(out), "--faces", "3000", "--texture", "256"]) == 0

    return made_once("someone.glb", bake)


@pytest.fixture(scope="session")
def turning(tmp_path_factory):
    """A sound capture of a still person, cameras going round each part."""
    from turning_capture import turning_capture

    return turning_capture(tmp_path_factory.mktemp("turning") / "test")


@pytest.fixture(scope="session")
def run():
    """A person of capsules in the place of a trained run."""
    from capsules import make_run

    return make_run()


@pytest.fixture(scope="session")
def filmed_four(made_once) -> Path:
    """A folder of four raw videos of a painted figure, with keypoints (filmed_figure.py)."""
    from filmed_figure import film_all

    def film(folder: Path) -> None:
        folder.mkdir()
        film_all(folder)

    return made_once("filmed", film)


@pytest.fixture(autouse=True)
def seeded():
    """Every test draws the same numbers, also from the generators that all share, alone or among others."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(0)


@pytest.fixture(scope="module")
def context():
    """An OpenGL context for the tests of a file."""
    from player.gl.context import open_context

    context = open_context()
    yield context
    assert context.gl.error == "GL_NO_ERROR"
    assert context.counts.objects() == {}, "a test left objects behind"
    context.release()


@pytest.fixture
def render(context):
    """Makes renderers and frees them after the test, also when it fails."""
    from player.scene.renderer import Renderer

    made = []

    def make(avatars, size, **options):
        avatars = avatars if isinstance(avatars, list) else [avatars]
        made.append(Renderer(context, avatars, size, **options))
        return made[-1]

    yield make
    for renderer in made:
        renderer.release()


@pytest.fixture(scope="session")
def osmesa():
    """Skips where the distribution's Mesa has no OSMesa (25.1 and later), with which glfw's null platform draws."""
    from player.gl.context import NoContextError, open_context

    try:
        open_context("osmesa").release()
    except NoContextError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def rasteriser(context):
    """A rasteriser of that context."""
    from player.draw.raster import Rasteriser

    rasteriser = Rasteriser(context)
    yield rasteriser
    rasteriser.release()


@pytest.fixture(scope="session")
def backgrounds(tmp_path_factory):
    """A background of each kind: a warm dark picture, a film of a dark and a bright frame, an evening sky."""
    from pictures import radiance_bytes, sky
    from PIL import Image

    from player.effects.background import BACKGROUNDS, Background

    folder = tmp_path_factory.mktemp("backgrounds")
    (folder / "film").mkdir()
    for name, color in (("film/0.png", (40, 40, 40)), ("film/1.png", (200, 200, 200)), ("warm.png", (120, 70, 40))):
        Image.fromarray(np.full((8, 12, 3), color, np.uint8)).save(folder / name)
    (folder / "sky.hdr").write_bytes(radiance_bytes(sky(64)))
    paths = {"image": "warm.png", "video": "film", "hdr": "sky.hdr"}
    return {kind: Background(kind, path=str(folder / paths[kind]) if kind in paths else None) for kind in BACKGROUNDS}


@pytest.fixture
def within(record_property):
    """Asserts measured <= bound and puts both into the report of the hard cases.

    `measured` may be an array; its largest absolute value counts. NaN and an empty array never pass.
    """

    def check(measured, bound: float, unit: str = "") -> None:
        measured = np.abs(np.asarray(measured, float))
        assert measured.size, "nothing was measured: an empty array proves no bound"
        worst = float(measured.max())
        record_property("within", (worst, float(bound), unit))
        assert worst <= bound, f"worst error {worst:.3g} {unit} exceeds the bound {bound:.3g} {unit}"

    return check


def pytest_addoption(parser):
    parser.addoption("--hard-cases-report", metavar="FILE", help="write what tests/hard_cases measured to FILE")


class HardCases:
    """Collects outcome and measured errors of every test under tests/hard_cases."""

    def __init__(self, path: Path):
        self.path, self.rows = path, defaultdict(list)

    def pytest_runtest_logreport(self, report):
        if "tests/hard_cases" not in report.nodeid or (report.when != "call" and report.outcome == "passed"):
            return
        file, _, rest = report.nodeid.partition("::")
        measured = [value for name, value in report.user_properties if name == "within"]
        # each parameter of a test that is marked so is a fact of its own
        name = rest if "rows" in report.keywords else rest.split("[")[0]
        self.rows[(file, name)].append((report.outcome, measured))

    def pytest_sessionfinish(self):
        lines = [
            "# Hard cases, measured",
            "",
            "Written by `make hard-cases`. Each row is one fact; *cases* counts its parametrised values; *worst* is "
            "the",
            "largest error measured against the *bound* that the test asserts. Rows without a number assert an exact",
            "value, a flag or a refusal that names the file and field.",
            "[Limits](limits.md) has where each promise ends.",
            "",
            f"{platform.python_implementation()} {platform.python_version()}, NumPy {np.__version__}, {renderer()}.",
        ]
        files = sorted({file for file, _ in self.rows})
        for file in files:
            lines += ["", f"## {Path(file).stem.removeprefix('test_').replace('_', ' ')}", ""]
            lines += ["| case | cases | outcome | worst | bound |", "|---|---|---|---|---|"]
            for (owner, name), outcomes in self.rows.items():
                if owner == file:
                    lines.append(self.row(name, outcomes))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text("\n".join(lines) + "\n")

    @staticmethod
    def row(name: str, outcomes: list) -> str:
        states = [state for state, _ in outcomes]
        state = next((s for s in ("failed", "skipped") if s in states), "passed")
        measured = [m for _, values in outcomes for m in values]
        tightest: dict[str, tuple[float, float, float]] = {}  # one number per quantity: the one nearest to its bound
        for worst, bound, unit in measured:
            nearness = worst / bound if bound else worst
            if unit not in tightest or nearness > tightest[unit][0]:
                tightest[unit] = (nearness, worst, bound)
        worst = "; ".join(f"{value:.2g} {unit}".strip() for unit, (_, value, _) in tightest.items())
        bound = "; ".join(f"{limit:.2g}" for _, _, limit in tightest.values())
        name, _, which = name.removeprefix("test_").partition("[")
        name = name.replace("_", " ") + f": {which.rstrip(']')}" * bool(which)
        return f"| {name} | {len(outcomes)} | {state} | {worst} | {bound} |"


def renderer() -> str:
    from player.gl.context import open_context

    try:
        context = open_context()
    except Exception as error:
        return f"no OpenGL context ({error})"
    name = f"{context.renderer} ({context.kind})"
    context.release()
    return name


@pytest.fixture(scope="session", autouse=True)
def counted_contexts():
    """Every OpenGL context of this process is counted: `context.counts` (experiments/gl_counts.py)."""
    from experiments.gl_counts import counting, counts_of
    from player.gl.context import Context

    Context.counts = property(counts_of)
    with counting():
        yield


def pytest_collection_modifyitems(items):
    """All of tests/experiments is slow: what it tests is not installed (tests/README.md). The whole path comes first:
    at the end a second process would take half of it over, and make its avatars again."""
    items.sort(key=lambda item: item.path.name != "test_whole_path.py")
    for item in items:
        if ROOT / "tests" / "experiments" in item.path.parents:
            item.add_marker(pytest.mark.slow)


def pytest_configure(config):
    # torch's optimisers import triton, which crashes when Mesa's LLVM was loaded into the process before its own
    with contextlib.suppress(ImportError):
        import torch._dynamo  # noqa: F401
    path = config.getoption("--hard-cases-report")
    if path:
        config.pluginmanager.register(HardCases(Path(path)), "hard-cases")


@pytest.fixture(scope="session")
def pose():
    """Both elbows, a knee, the head and all fingers bent: (axis-angle, root)."""
    axis_angle = np.zeros((52, 3))
    axis_angle[[18, 19], 1] = [-1.2, 1.0]
    axis_angle[[16, 17], 2] = [-0.9, 0.7]
    axis_angle[4, 0], axis_angle[15, 1] = 0.8, 0.5
    axis_angle[22:37, 2], axis_angle[37:52, 2] = -0.4, 0.4
    return axis_angle, np.array([0.1, 0.05, -0.2])
