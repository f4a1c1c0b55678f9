"""Hard cases: cameras and targets at their limits, long runs, spinning and far-away bodies."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from avatar.camera import Camera, look_at, orbit_camera, pinhole
from avatar.motion.clip import Clip
from avatar.skeleton import BIG_POSE
from player.doctor import doctor_main
from player.scene.framing import extent, fitted
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

ROOT = Path(__file__).parents[2]
POSE = (np.array(BIG_POSE), np.zeros(3))


@pytest.fixture(scope="module")
def renderer(context):
    renderer = Renderer(context, [mannequin()], (96, 96), view="vertex", background=(0.5, 0.5, 0.5, 1.0))
    yield renderer
    renderer.release()


BACKGROUND = (128, 128, 128, 255)


def drawn_pixels(image):
    assert image[..., 3].min() == 255
    return int((image != BACKGROUND).any(-1).sum())


def test_a_surface_that_crosses_the_near_plane_is_clipped_not_folded(rasteriser):
    """A floor that runs under and behind the camera: every pixel below the horizon sees it, none above."""
    camera = Camera(pinhole((64, 64), np.radians(60)), look_at((0, 1, 0), (0, 1, -1)), (64, 64))
    vertices = np.array([[-1e3, 0, 1e3], [1e3, 0, 1e3], [1e3, 0, -1e3], [-1e3, 0, -1e3]])
    fragments = rasteriser.draw(vertices, np.array([[0, 1, 2], [0, 2, 3]]), camera)
    hit = fragments.face >= 0
    assert not hit[:31].any()
    # 1 m below the eye; nearer than a thousandth of the farthest point nothing is kept
    seen = 1 / np.tan(np.radians(30)) / (np.arange(64) + 0.5 - 32) * 32
    reach = (seen > 1.5) & (seen < 900)
    assert hit[reach].all()
    assert np.abs(fragments.depth[reach] / seen[reach][:, None] - 1).max() < 1e-3


@pytest.mark.parametrize(("fov", "distance"), [(1.0, 130.0), (170.0, 0.35)])
def test_extreme_fields_of_view_see_the_body(renderer, fov, distance):
    camera = orbit_camera((0, 0, 0), distance, 0.3, 0.0, (96, 96), np.radians(fov))
    assert drawn_pixels(renderer.draw([POSE], camera)) > 300


def test_a_root_that_spins_at_1000_rad_per_second_stays_rigid(renderer):
    """Whatever turn it is caught at, so many turns on, the picture is that of the small angle."""
    camera = orbit_camera((0, 0, 0), 2.4, 0.3, 0.1, (96, 96))
    for frame in (1, 30, 1000):
        angle = 1000 / 30 * frame
        spun, small = np.zeros((2, 52, 3))
        spun[0, 1], small[0, 1] = angle, np.remainder(angle, 2 * np.pi)
        a = renderer.draw([(spun, np.zeros(3))], camera)
        b = renderer.draw([(small, np.zeros(3))], camera)
        assert (np.abs(a.astype(int) - b).max(-1) > 1).sum() <= 2


def test_another_avatar_10_km_behind_cuts_nothing_of_the_one_before_the_camera(render):
    camera, behind = orbit_camera((0, 0, 0), 2.4, 0.0, 0.0, (96, 96)), (POSE[0], np.array([0, 0, -1e4]))
    alone = render(mannequin(), (96, 96), view="off").draw([POSE], camera)
    both = render([mannequin()] * 2, (96, 96), view="off").draw([POSE, behind], camera)
    assert (alone[..., 3] > 0).sum() > 300 and (np.abs(both.astype(int) - alone).max(-1) > 1).sum() <= 2


@pytest.mark.parametrize("fov", [35, 150])
def test_a_fitted_camera_stands_by_size_and_not_by_place(fov, within):
    """Of a thumb-sized person, and of one 1000 km away."""

    def distance(scale=1.0, away=0.0):
        clip = Clip(np.zeros((1, 52, 3)), np.array([[away, 0, 0]]), 30)
        return fitted(scale * extent(mannequin(), clip), 0.0, (96, 96), fov=np.radians(fov)).distance / scale

    within(distance(scale=0.01) - distance(), 1e-9, "m, of a hundredth")
    within(distance(away=1e6) - distance(), 1e-6, "m, 1000 km away")


LONG_RUN = """
import resource, sys
from pathlib import Path
import numpy as np
sys.path.insert(0, "tests")
from tiny_avatar import tiny_avatar
from avatar.camera import orbit_camera
from avatar.skeleton import BIG_POSE
from experiments.gl_counts import counting, counts_of
from player.gl.context import open_context
from player.film.film import Film
from player.film.parts import Parts
from player.scene.renderer import Renderer

parts = Parts(Path(sys.argv[1]) / "long.mp4", 0, 11_000, {})
parts.begin(resume=False)
with counting():
    context = open_context()
counts = counts_of(context)
renderer = Renderer(context, [tiny_avatar()], (16, 16), view="network")
camera, pose = orbit_camera((0, 0, 0), 4.0, 0.0, 0.0, (16, 16)), (np.array(BIG_POSE), np.zeros(3))
with Film(parts.out, 30.0, pieces=list(map(parts.piece, parts.ranges))) as film:
    for frame in range(11_000):
        if frame == 1000:
            objects, live = counts.objects(), counts.live_bytes
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        film.add(renderer.draw([pose], camera, film.canvas((16, 16))))
assert counts.objects() == objects and counts.live_bytes == live
assert parts.missing() == [] and len(film._kept) <= 12
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.slow
def test_ten_thousand_frames_grow_neither_objects_nor_memory(within, tmp_path):
    """Drawn, and filmed in parts."""
    done = subprocess.run([sys.executable, "-c", LONG_RUN, str(tmp_path)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    within(int(done.stdout), 4096, "KiB")


def test_egl_osmesa_and_the_window_show_the_same_frame_in_every_view_mode(osmesa, within, tmp_path, capsys):
    """By `selfscan doctor --compare`: outside a one-pixel silhouette band."""
    assert doctor_main(["--compare", "--json", str(tmp_path / "d.json")]) == 0
    assert "compare: equal" in capsys.readouterr().out
    compared = json.loads((tmp_path / "d.json").read_text())["compare"]
    assert {"egl", "osmesa", "window on the null platform"} <= set(compared["ways"]) and not compared["broken"]
    gaps = [gap for pair in compared["pairs"].values() for gap in pair.values()]
    assert len(gaps) >= 8  # two pairs of four view modes
    within(max(gaps), 1, "/255")
    assert 0 < compared["band"] < 0.1
