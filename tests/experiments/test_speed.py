"""The speed tools: alternating ratios, peers as processes, crowds, long motions, and the program without effects."""

import json
import os
import socket
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from memory_use import at_most
from tiny_avatar import tiny_avatar

from avatar.camera import orbit_camera
from avatar.gltf.avatar_file import write_avatar
from avatar.motion.read import builtin_motion, read_motion
from command.errors import AssetError
from experiments import budgets, effect_rungs, scale, speed_peers, speed_rows
from experiments.alternating import Turn, alternate, here
from experiments.bare_draw import BareDraw, coverage, posed_vertices
from experiments.bare_program import BareProgram
from experiments.live_sender import sending
from experiments.scale import ScaleSteps, bench_scale, crowd, fitted_power, write_still_motion
from experiments.speed import bars, body_frames, main, speed, with_stand_in
from player.budget.ladder import PricedRung
from player.budget.measure import BudgetScene
from player.budget.rung import Rung
from player.draw.raster import Rasteriser
from player.effects.background import Background
from player.live.frame import MalformedError
from player.live.inbox import Inbox
from player.live.osc import parse_packet
from player.scene.effects import PLAIN, STUDIO
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer


@pytest.fixture(scope="module")
def body():
    avatar = mannequin(texture=64)
    poses, camera_of = body_frames(avatar)
    return avatar, poses, camera_of((96, 96))


# where the numbers go

COMMANDS = (scale.main, effect_rungs.main, lambda words: speed(Path(words[0]), Path(words[2])))


@pytest.mark.parametrize("measured", COMMANDS)
def test_the_place_of_the_numbers_is_made_or_refused_before_anything_is_measured(tmp_path, measured):
    with pytest.raises(AssetError, match=r"nobody\.glb: no such file"):
        measured(["nobody.glb", "-o", str(tmp_path / "out" / "numbers")])
    assert (tmp_path / "out").is_dir()
    (tmp_path / "out" / "mine.txt").touch()
    with pytest.raises(AssetError, match=r"mine\.txt in it is not known to be selfscan's"):
        measured(["nobody.glb", "-o", str(tmp_path / "out")])


# alternating rounds


def test_ratios_come_from_rounds_side_by_side_not_from_medians():
    """A machine that slows down meanwhile: b takes twice a's time in every round, and the ratio says so exactly."""
    clock = iter(np.linspace(1, 9, 200))

    def program(factor):
        def turn(number):
            ms = np.full(3, factor * slow[number])
            return Turn(ms, 2 * ms)

        return turn

    slow = {n: next(clock) for n in range(50)}
    times = alternate({"a": program(1.0), "b": program(2.0)}, seconds=0, least=40, most=40)
    assert len(times["a"].rounds) == 40 and len(times["a"].wall) == 120
    assert times["b"].share_of(times["a"]) == {"wall": 0.5, "cpu": 0.5, "spread": 0.0}
    row = times["a"].row()
    assert row["ms_median"] == pytest.approx(np.median(times["a"].wall), abs=1e-3)
    assert row["fps"] == pytest.approx(1000 / row["ms_median"], abs=0.1)
    assert row["ms_median"] < row["ms_p95"] and row["cpu_ms_median"] == pytest.approx(2 * row["ms_median"], abs=2e-3)


def test_every_round_has_every_program_in_an_order_of_its_own():
    order = []
    programs = {name: here(lambda _number, name=name: order.append(name), 1) for name in "abc"}
    alternate(programs, seconds=0, least=30, most=30)
    rounds = np.array(order[6:]).reshape(30, 3, 2)  # after the first turns; each draws one frame untimed
    assert (rounds[:, :, 0] == rounds[:, :, 1]).all()
    assert all(set(row) == set("abc") for row in rounds[:, :, 0])
    assert len({tuple(row) for row in rounds[:, :, 0]}) > 3
    with pytest.raises(ValueError, match="nothing to time"):
        alternate({}, seconds=1)


# the yardstick


def test_the_bare_draw_is_the_players_picture_in_paper_mode(context, body):
    avatar, poses, camera = body
    renderer = Renderer(context, [avatar], camera.size, view="off")
    bare, static = (BareDraw(context, avatar, poses, camera), BareDraw(context, avatar, poses, camera, static=True))
    for number in (0, 5):
        apart = np.abs(bare.draw(number).astype(int) - renderer.draw([poses[number]], camera)).max(-1) > 1
        assert apart.sum() <= 4  # its depth range is that of all poses: a pixel where two surfaces meet may turn
    first = renderer.draw([poses[0]], camera).astype(int)
    assert (np.abs(static.draw(7) - first).max(-1) > 1).mean() < 2e-3  # skinned once here, in float32
    objects = context.counts.objects()
    bare.draw(3)
    assert context.counts.objects() == objects
    for thing in (renderer, bare, static):
        thing.release()


def test_peers_are_given_the_body_that_the_player_draws(context, body, tmp_path):
    avatar, poses, camera = body
    vertices, normals = posed_vertices(avatar, poses[3])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    raster = Rasteriser(context)
    seen = raster.draw(vertices, avatar.levels[0].faces.astype(np.int64), camera, cull=True).face >= 0
    raster.release()
    renderer = Renderer(context, [avatar], camera.size, view="off")
    image = renderer.draw([poses[3]], camera)
    renderer.release()
    assert ((image[..., 3] > 0) != seen).sum() <= 2
    assert coverage(image) == pytest.approx(seen.mean(), abs=1e-3)
    speed_peers.write_body(tmp_path / "body.npz", avatar, poses[:2], camera)
    with np.load(tmp_path / "body.npz") as data:
        assert data["vertices"].shape == data["normals"].shape == (2, len(vertices), 3)
        assert data["faces"].max() < len(vertices)


PEER = """
from turns import serve
import numpy as np

def make(body, lightest):
    def draw(number):
        print("noise on standard output")
        picture = np.zeros((body.height, body.width, 3), np.uint8)
        picture[: body.height // 4] = 200 + number
        if DIES and number == 2:
            raise RuntimeError("no more pictures")
        return picture
    return draw, {"name": "Toy", "version": "1", "settings": "lightest" if lightest else "default"}

serve(make)
"""


@pytest.mark.parametrize("dies", [False, True])
def test_a_peer_answers_in_turns_and_its_death_is_one_line(body, tmp_path, monkeypatch, dies):
    avatar, poses, camera = body
    scripts = tmp_path / "scripts"
    scripts.mkdir()
    (scripts / "turns.py").write_text((speed_peers.SCRIPTS / "turns.py").read_text())
    (scripts / "draw_toy.py").write_text(f"DIES = {dies}\n{PEER}")
    monkeypatch.setattr(speed_peers, "SCRIPTS", scripts)
    monkeypatch.setattr(speed_peers, "environment", lambda _folder, _name: sys.executable)
    speed_peers.write_body(tmp_path / "body.npz", avatar, poses[:4], camera)
    if dies:
        with (
            pytest.raises(speed_peers.AssetError, match=r"toy: ended with 1 .*no more pictures"),
            speed_peers.running(tmp_path, tmp_path / "body.npz", "toy", "default") as peer,
        ):
            peer.turn(0, 3)
        return
    with speed_peers.running(tmp_path, tmp_path / "body.npz", "toy", "lightest") as peer:
        assert peer.facts["settings"] == "lightest" and peer.facts["size"] == [96, 96]
        turn = peer.turn(0, 5)
        assert turn.wall.shape == turn.cpu.shape == (5,) and (turn.wall > 0).all()
        assert speed_peers.covered(peer, tmp_path / "picture.npy") == 0.25
    assert peer.process.poll() is not None


# the session


def test_the_first_frame_is_timed_from_process_start_and_errors_are_told(tmp_path):
    write_avatar(tmp_path / "tiny.glb", tiny_avatar())
    argv = ["render", tmp_path / "tiny.glb", "--size", "32x32", "-o", tmp_path / "x.png"]
    took, memory = speed_rows.started(argv, dict(os.environ))
    assert (tmp_path / "x.png").exists() and took > 0.05 and 20 < memory < 1000
    with pytest.raises(speed_rows.AssetError, match=r"selfscan render ended with 1: .*missing\.glb"):
        speed_rows.started(["render", "missing.glb", "-o", tmp_path / "y.png"], dict(os.environ))


def test_a_long_run_grows_nothing_and_a_leak_is_seen(monkeypatch):
    avatar = tiny_avatar()
    poses = [(np.array(avatar.canonical_pose), np.zeros(3))]
    monkeypatch.setattr(speed_rows, "SETTLED", 20)
    rows = speed_rows.long_run(avatar, poses, frames=50, size=(16, 16))
    assert [r["value"] for r in rows[:2]] == [0, 0] and rows[0]["met"]
    draw, kept = Renderer.draw, []

    def leaking(self, *arguments):
        kept.append(self.context.gl.buffer(reserve=1024))
        return draw(self, *arguments)

    monkeypatch.setattr(Renderer, "draw", leaking)
    rows = speed_rows.long_run(avatar, poses, frames=50, size=(16, 16))
    assert rows[0]["value"] == 50 and not rows[0]["met"] and rows[1]["value"] == pytest.approx(50 / 1024, abs=1e-3)


def test_the_sender_sends_55_bones_and_spoilt_packets_that_no_reader_takes():
    inbox = Inbox("vmc")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(60)
        with sending(listener.getsockname()[1], rate=240.0, fuzz=2000.0, seconds=60):
            packets = [listener.recv(65536) for _ in range(200)]
    good = bad = 0
    for number, packet in enumerate(packets):
        inbox.feed(packet, number / 1000)
        try:
            messages = parse_packet(packet)
        except MalformedError:
            bad += 1
            continue
        good += 1
        assert sum(m.address == "/VMC/Ext/Bone/Pos" for m in messages) == 55
    assert good >= 5 and bad >= 50
    assert inbox.counters.malformed == bad and inbox.counters.received == 200
    found = inbox.sample()
    assert found is not None and np.isfinite(found[1].axis_angle).all()


# the command


def test_the_command_writes_json_table_and_plot(tmp_path, capsys):
    avatar = replace(mannequin(texture=64), network=None, linear=None, default_view="off")
    write_avatar(tmp_path / "body.glb", avatar)
    out = tmp_path / "out"
    words = [str(tmp_path / "body.glb"), "-o", str(out), "--size", "64x48", "--seconds", "0.1", "--rows", "none"]
    assert main(words) == 0
    result = json.loads((out / "speed.json").read_text())
    assert result["network"].startswith("random weights")
    (size,) = result["sizes"]
    assert size["size"] == [64, 48] and size["frames"] >= 36 and 0.01 < size["coverage"] < 0.5
    names = [row["name"] for row in size["rows"]]
    assert names[:3] == ["bare skinned draw", "bare skinned draw, plain sampling", "bare static draw"]
    assert set(names[3:]) == {"network per pixel", "linear", "per vertex", "paper mode"}
    assert size["rows"][0]["of_bare_skinned"] == {"wall": 1.0, "cpu": 1.0, "spread": 0.0}
    assert {p.name for p in out.iterdir()} >= {"speed.json", "speed.md", "speed.png"}
    assert "| paper mode |" in capsys.readouterr().out


def test_a_stand_in_network_is_made_where_there_is_none_and_promises_hold_against_the_fastest():
    avatar = mannequin(texture=64)
    assert with_stand_in(avatar) == (avatar, False)
    made, random = with_stand_in(replace(avatar, network=None))
    assert random and made.network is not None and made.levels[0].features.shape == (32, 32, 4)

    def peer(name, fps, faster, style):
        return {
            "name": name, "version": "1", "style": style, "settings": "s", "coverage": 0.1, "ms_median": 1000 / fps,
            "ms_p95": 2000 / fps, "cpu_ms_median": 1.0, "fps": fps,
            "ours_faster": {"paper mode": {"wall": faster, "cpu": faster, "spread": 0.1}},
        }  # fmt: skip

    peers = {"size": [640, 640], "vertices": 9, "failed": {"c, default": "c: why"}, "rows": [
        peer("a", 10.0, 12.0, "default"), peer("b", 30.0, 4.0, "default"), peer("b", 60.0, 2.0, "lightest"),
    ]}  # fmt: skip
    found = bars([], peers)
    assert [(r["value"], r.get("met")) for r in found] == [(4.0, False), (2.0, None)]


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_is_that_of_the_times(power):
    x = [1, 3, 10, 100]
    exact = np.tile(0.7 * np.array(x, float) ** power, (9, 1))
    assert fitted_power(x, exact) == pytest.approx((power, power, power), abs=1e-12)
    noisy = exact * np.exp(0.1 * np.random.default_rng(1).normal(size=exact.shape))
    found = fitted_power(x, noisy)
    assert found.low < power < found.high and found.high - found.low < 0.15


def test_a_crowd_is_in_the_picture_and_motions_of_any_length_take_constant_memory(context, tmp_path):
    one = crowd(context, mannequin(), 7, size=(96, 96))
    one.draw(0)
    assert one.renderer.last is not None
    image = one.renderer.draw(one.poses[0], one.camera)
    edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert image[..., 3].any() and not edge[..., 3].any(), "somebody is cut off"
    one.renderer.release()
    with at_most(4e6):
        write_still_motion(tmp_path / "long.npz", 100_003)
    motion = read_motion(tmp_path / "long.npz")
    assert motion.frames == 100_003 and not motion.read(100_000, 100_003).axis_angle[:, 1:].any()


def test_every_sweep_is_measured_and_written(tmp_path):
    steps = ScaleSteps(avatars=(1, 3), sides=(16, 32), frames=(600, 1200))
    told = []
    result = bench_scale(mannequin(), tmp_path / "out", rounds=2, size=(48, 48), steps=steps, report=told.append)
    assert json.loads((tmp_path / "out/scale.json").read_text()) == result
    names = [row["name"] for row in result["sweeps"]]
    assert names == told and [name.split(",")[0] for name in names] == [
        "avatars", "pixels", "frames in the motion file"
    ]  # fmt: skip
    assert [row["x"] for row in result["sweeps"]] == [[1, 3], [256, 1024], [600, 1200]]
    text = (tmp_path / "out/scale.md").read_text()
    assert all(name in text for name in names)


LADDER = [Rung(name, "off", level) for level, name in enumerate(("fine", "middle", "coarse"))]
SCENE = BudgetScene([], [([], orbit_camera(np.zeros(3), 2.0, 0.0, 0.0, (8, 8)))], (8, 8), PLAIN, Background(), False)


def priced(times):
    return [PricedRung(rung, ms, ms, float(k)) for k, (rung, ms) in enumerate(zip(LADDER, times, strict=True))]


@pytest.mark.parametrize(
    ("table", "now", "expected"),
    [
        ((9.0, 5.0, 2.0), (9.0, 5.5, 2.0), ("middle", True, 0)),
        ((9.0, 5.0, 2.0), (9.0, 6.5, 2.0), ("middle", False, 0)),
        # steps that would have held
        ((9.0, 7.0, 2.0), (5.0, 4.0, 2.0), ("coarse", True, 2)),
    ],
)
def test_a_budget_holds_or_fails_by_what_is_drawn_and_is_wasted_by_finer_steps_that_hold(
    monkeypatch, context, table, now, expected
):
    drawn = dict(zip(LADDER, now, strict=True))

    def rung_times(context, scene, rungs, rounds):
        return np.array([[drawn[one] for one in rungs]] * rounds)

    monkeypatch.setattr(budgets, "rung_times", rung_times)
    row = budgets.tried(context, SCENE, priced(table), 6.0, 10)
    assert (row["rung"], row["holds"], row["steps_wasted"]) == expected


def test_the_program_without_effects_draws_the_bare_scenes_picture(context):
    """Else the time beside it would say nothing."""
    avatar, size = mannequin(), (160, 120)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    clip = builtin_motion("walking").read(20, 21)
    pose = clip.axis_angle[0].astype(np.float64), np.zeros(3)
    renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
    expected = renderer.draw([pose], camera)
    program = BareProgram(context, avatar, size, STUDIO.color)
    program.draw(pose, camera)
    assert np.array_equal(program.picture(), expected) and len(np.unique(expected)) > 50
    program.release()
    renderer.release()


def test_the_bare_scene_makes_the_calls_of_the_program_and_no_more(context):
    avatar, size = mannequin(), (96, 96)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    poses = [(np.full((52, 3), 0.01 * k), np.zeros(3)) for k in range(4)]
    renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
    program = BareProgram(context, avatar, size, STUDIO.color)
    target, calls = renderer.target, []
    for draw in (lambda pose: renderer.draw_into(target, [pose], camera), lambda pose: program.draw(pose, camera)):
        draw(poses[0])
        before, sent, objects = context.counts.calls.copy(), context.counts.uploaded, context.counts.objects()
        for pose in poses[1:]:
            draw(pose)
        assert context.counts.objects() == objects
        calls.append((context.counts.calls - before, context.counts.uploaded - sent))
    assert calls[0] == calls[1] and calls[0][0]["draw"] == 3
    program.release()
    renderer.release()
