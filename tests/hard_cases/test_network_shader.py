"""Hard cases: the view network in GLSL against ONNX Runtime and float64, and what holds by construction."""

import locale
import os
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
from glsl_probe import probe

from avatar.baked_avatar import NETWORK_ARRAYS, ViewNetwork
from avatar.camera import orbit_camera
from avatar.skeleton import BIG_POSE
from bake.cone import ViewCone, clamped_tangent
from bake.network import write_onnx
from player.gl.blocks import FRAME
from player.gl.constants import linear_constants, literal, network_constants
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

A = 0.6
LEVEL = 1 / 255
RESIDUAL = "vec4(view_residual(features, tangent), 0.0)"
# constants of a frame in which the view counts in full
IN_FULL = np.zeros((), FRAME)
IN_FULL["view_amount"] = 1


def network(scale1=1.0, scale2=1.0, seed=0):
    """Random weights, those of the first layer times scale1, all others times scale2."""
    rng = np.random.default_rng(seed)
    shapes = NETWORK_ARRAYS
    scales = {name: scale1 if name in ("w1", "b1") else scale2 for name in shapes}
    return ViewNetwork(
        **{n: rng.normal(size=shape).astype(np.float32) * np.float32(scales[n]) for n, shape in shapes.items()}
    )


def inputs(count, seed=1):
    """Random features, the corners of their cube, and tangents from 0 to 1 long."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 256, (count, 4)) / 255
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 4)).reshape(4, -1).T
    values[: len(corners)] = corners
    tangent = rng.normal(size=(count, 3))
    tangent *= rng.uniform(0, 1, (count, 1)) / np.linalg.norm(tangent, axis=1, keepdims=True)
    tangent[:100] = 0
    tangent[100:200] *= 1e-20
    return values.astype(np.float32), tangent.astype(np.float32)


def reference(net, features, tangent):
    """float64."""
    far = np.linalg.norm(tangent.astype(float), axis=1, keepdims=True)
    y = np.concatenate([features, tangent, far], 1).astype(float)
    y = np.maximum(y @ net.w1.T.astype(float) + net.b1, 0) @ net.w2.T.astype(float) + net.b2
    return A * far * y / (1 + np.abs(y))


def onnx_runtime(net, features, tangent, path):
    """The file that the bake writes beside an avatar, asked through ONNX Runtime."""
    far = np.linalg.norm(tangent.astype(float), axis=1, keepdims=True).astype(np.float32)
    write_onnx(path, net)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    x = np.concatenate([features, tangent, far], 1).astype(np.float32)
    y = session.run(None, {"x": x})[0].astype(float)
    return A * far * y / (1 + np.abs(y))


def glsl(context, net, features, tangent, stage="fragment"):
    generated = {"network_constants.glsl": network_constants(net, A)}
    values = {"features": features, "tangent": tangent}
    return probe(context, ["view_network.glsl"], RESIDUAL, values, generated, stage=stage)[:, :3]


@pytest.mark.parametrize("stage", ["vertex", "fragment"])
@pytest.mark.parametrize(("scale1", "scale2"), [(1, 1), (1e-8, 1e4), (1e4, 1e-4), (1e-8, 1e-8), (30, 30)])
def test_network_in_glsl_equals_onnx_runtime(context, within, tmp_path, scale1, scale2, stage):
    net = network(scale1, scale2)
    features, tangent = inputs(20_000)
    out = glsl(context, net, features, tangent, stage)
    assert np.isfinite(out).all()
    # where float32 itself cannot tell the sign of y (huge weights, cancelled) both are equally right
    exact, runtime = (reference(net, features, tangent), onnx_runtime(net, features, tangent, tmp_path / "n.onnx"))
    known = np.abs(runtime - exact) < LEVEL / 4
    assert known.mean() > 0.99
    within((out - runtime)[known], LEVEL)
    within((out - exact)[known], LEVEL)


def test_residual_is_zero_at_the_global_direction_and_never_exceeds_A_times_tangent(context, within):
    features, tangent = inputs(60_000, seed=3)
    for seed, scale in [(0, 1.0), (1, 1e4), (2, 1e-8)]:
        out = glsl(context, network(scale, scale, seed), features, tangent)
        far = np.linalg.norm(tangent.astype(float), axis=1, keepdims=True)
        assert np.abs(out[:100]).max() == 0
        within(np.maximum(np.abs(out) - A * far, 0), 1e-6)


def test_linear_in_glsl_equals_float64(context, within):
    features, tangent = inputs(5_000)
    M = np.random.default_rng(4).normal(size=(4, 3, 3)).astype(np.float32)
    generated = {"linear_constants.glsl": linear_constants(M)}
    out = probe(context, ["view_linear.glsl"], RESIDUAL, {"features": features, "tangent": tangent}, generated)[:, :3]
    exact = np.einsum("nf,fij,nj->ni", features.astype(float), M.astype(float), tangent.astype(float))
    within(out - exact, 1e-6)


EXTREMES = np.array([0.0, -0.0, 1e-8, -1e-8, 1e4, -1e4, 1 / 3, np.pi, 16777217.0, 1.5e-38, 3.4e38, 7.0], np.float32)


def test_every_weight_prints_and_parses_as_the_same_float32(context):
    for start in range(0, len(EXTREMES), 4):
        four = EXTREMES[start : start + 4]
        expression = f"vec4({', '.join(literal(float(x)) for x in four)})"
        out = probe(context, [], expression, {"unused": np.zeros(1)})[0]
        assert np.array_equal(out, four)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_constant_that_is_not_finite_is_refused(value):
    with pytest.raises(ValueError, match="finite"):
        literal(value)


def test_a_comma_locale_changes_nothing(context, tmp_path):
    """With a locale that writes 0,5: the text is the same, and the compiler reads it the same."""
    net, values = network(), inputs(500)
    text, drawn = network_constants(net, A), glsl(context, net, *values)
    before = locale.setlocale(locale.LC_ALL)
    try:
        if not _set_comma_locale(tmp_path):
            # no such locale can be had here; then the construction: str.format never asks the locale
            assert f"{0.5:.9g}" == "0.5" and "," not in literal(0.5)
            return
        assert locale.str(0.5) == "0,5"
        assert network_constants(net, A) == text
        assert np.array_equal(glsl(context, net, *values), drawn)
    finally:
        locale.setlocale(locale.LC_ALL, before)


def _set_comma_locale(tmp_path) -> bool:
    for name in ("de_DE.UTF-8", "fr_FR.UTF-8", "de_DE.utf8"):
        try:
            locale.setlocale(locale.LC_ALL, name)
            return True
        except locale.Error:
            pass
    if shutil.which("localedef") is None or not os.path.exists("/usr/share/i18n/locales/de_DE"):
        return False
    command = ["localedef", "-i", "de_DE", "-f", "UTF-8", str(tmp_path / "de_DE.UTF-8")]
    subprocess.run(command, check=False, capture_output=True)
    os.environ["LOCPATH"] = str(tmp_path)
    try:
        locale.setlocale(locale.LC_ALL, "de_DE.UTF-8")
        return True
    except locale.Error:
        return False
    finally:
        del os.environ["LOCPATH"]


def cones(seed, count, *, along, sizes, flat):
    """Directions and cones: the first `along` of d along d̄, as many against it, and as many across it; axes from
    10^sizes[0] to 10^sizes[1] long, every flat-th of no length; every eleventh not seen at all."""
    rng = np.random.default_rng(seed)
    mean, d = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, count, 3)))
    with_it, against, across = (slice(k * along, (k + 1) * along) for k in range(3))
    d[with_it], d[against], side = mean[with_it], -mean[against], np.cross(mean[across], d[across])
    d[across] = side / np.linalg.norm(side, axis=1, keepdims=True)
    axes = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(*sizes, (count, 1))
    axes[::flat] = 0
    q = axes[:, [0, 0, 0, 1, 1, 2]] * axes[:, [0, 1, 2, 1, 2, 2]]
    seen = rng.uniform(size=count)
    seen[::11] = 0
    values = {"d": d, "mean": mean, "q0": q[:, :3], "q1": q[:, 3:], "seen": seen}
    return {name: value.astype(np.float32) for name, value in values.items()}


def test_the_cone_holds_for_every_direction(context, within):
    """d = d̄, d = -d̄, d orthogonal, axes of zero length, enormous or of rank one; |t'| <= |t| <= 1; never NaN."""
    values = cones(5, 4000, along=500, sizes=(-12, 3), flat=7)
    call = "vec4(cone_tangent(d, mean, q0, q1, seen), 0.0)"
    out = probe(context, ["view_cone.glsl"], call, values, blocks={"Frame": IN_FULL})[:, :3]
    assert np.isfinite(out).all() and (out[values["seen"] == 0] == 0).all()
    within(np.maximum(np.linalg.norm(out, axis=1) - 1, 0), 1e-6)
    within(out[:1000], 1e-6)  # along d̄ or against it there is no tangent
    q, (d, mean, seen) = np.hstack([values["q0"], values["q1"]]), (values[name] for name in ("d", "mean", "seen"))
    cone = ViewCone(mean.astype(float), q.astype(float), seen.astype(float))
    within(out - clamped_tangent(d.astype(float), cone), 2e-5)


def test_a_million_directions_through_the_cone_stay_within_A_of_the_base(context, within):
    """|colour - base| <= A |t'| from direction to residual, with cones of every shape; d along d̄ or against it: 0."""
    count, net = 1_000_000, network(3.0, 3.0)
    generated = {"network_constants.glsl": network_constants(net, A)}
    values = cones(7, count, along=1000, sizes=(-3, 2), flat=9)
    values["features"] = (np.random.default_rng(7).integers(0, 256, (count, 4)) / 255).astype(np.float32)
    tangent = "cone_tangent(d, mean, q0, q1, seen)"
    call = RESIDUAL.replace("tangent", tangent).replace("0.0)", f"length({tangent}))")
    out = probe(context, ["view_cone.glsl", "view_network.glsl"], call, values, generated, {"Frame": IN_FULL})
    assert np.isfinite(out).all() and out[:, 3].max() <= 1 + 1e-6
    within(np.maximum(np.abs(out[:, :3]) - A * out[:, 3:], 0), 1e-6)
    within(out[:2000, :3], 1e-6)


@pytest.fixture(scope="module")
def avatar():
    return mannequin()


def test_every_feature_reaches_the_picture(context, avatar):
    """Each of the file's features, changed alone, changes what the network and the matrices draw."""
    level = avatar.levels[0]
    for view in ("linear", "network"):
        before = drawn(context, avatar, view)
        for feature in range(level.features.shape[2]):
            features = level.features.copy()
            features[..., feature] = 255 - features[..., feature]
            other = replace(avatar, levels=(replace(level, features=features),))
            assert not np.array_equal(drawn(context, other, view), before), (view, feature)


POSE = (np.array(BIG_POSE), np.zeros(3))


def drawn(context, avatar, view, amount=1.0, azimuth=0.6, size=(160, 160)):
    renderer = Renderer(context, [avatar], size, view=view)
    renderer.view_amount = amount
    image = renderer.draw([POSE], orbit_camera((0, 0, 0), 2.4, azimuth, 0.1, size))
    renderer.release()
    return image


@pytest.mark.parametrize("view", ["vertex", "linear", "network"])
def test_view_amount_zero_equals_the_base_program_bit_for_bit(context, avatar, view):
    paper = drawn(context, avatar, "off")
    assert np.array_equal(drawn(context, avatar, view, amount=0.0), paper)
    assert not np.array_equal(drawn(context, avatar, view), paper)


@pytest.mark.parametrize("view", ["vertex", "linear", "network"])
def test_unseen_vertices_do_not_change_under_camera_orbit(context, avatar, view):
    level = replace(avatar.levels[0], view_seen=np.zeros_like(avatar.levels[0].view_seen))
    unseen = replace(avatar, levels=(level,))
    for azimuth in np.linspace(0, 2 * np.pi, 5, endpoint=False):
        paper = drawn(context, unseen, "off", azimuth=azimuth)
        assert np.array_equal(drawn(context, unseen, view, azimuth=azimuth), paper)


@pytest.mark.parametrize("view", ["vertex", "network"])
def test_drawn_colour_stays_within_A_of_the_base(context, avatar, view, within):
    for azimuth in np.linspace(0, 2 * np.pi, 5, endpoint=False):
        paper = drawn(context, avatar, "off", azimuth=azimuth).astype(int)
        full = drawn(context, avatar, view, azimuth=azimuth).astype(int)
        # |t'| < 1 / sqrt(q) with the mannequin's round cone of 20 degrees
        bound = A * 1.6 * np.sin(np.radians(20.0)) * 255 + 1
        within(np.abs(full - paper)[..., :3], bound, "/255")
        assert np.array_equal(full[..., 3], paper[..., 3])
