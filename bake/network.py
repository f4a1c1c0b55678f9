"""View-dependent residual over the paper's color, distilled from the field inside the cone that was seen.

    color = clamp(base + A |t'| y / (1 + |y|)),   y = W2 relu(W1 x + b1) + b2,   x = [f (4), t' (3), |t'|]

f are four 8-bit features of the surface point. The teacher's residual is C(x, d') - C(x, d_bar), so at d = d_bar the
result is the paper's color whatever the weights. A linear residual (sum f_i M_i) t' over the same features is always
fitted as well, and ships alone where the network gains less than 0.3 dB over it.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array
from torch import nn

from avatar.gltf.avatar_file import ViewNetwork
from avatar.psnr import decibels
from bake.cone import ColorFunction, ViewCone, clamped_tangent, cone_direction, matrix_from_six, tangent_frame
from files.whole import whole_file

AMPLITUDE = 0.6
# sines and cosines of each coordinate that features are made of, and points of a training step
OCTAVES, BATCH = 6, 2048
# Adam's decays, its largest rate, and the share of the steps in which the rate rises
BETAS, RATE, WARM_UP = (0.9, 0.999), 6e-3, 0.3
# share of the directions that are distributed as training saw them
OBSERVED = 0.7
# what a mode must gain over the simpler one to be shipped
GAIN_DB = 0.3
# a field this close to its own paper mode has nothing to add: 1.4 / 255 rms
INVISIBLE_DB = 45.0


class SurfacePoints(NamedTuple):
    """What the feature encoder knows about points of the surface."""

    points: Float[Array, "n 3"]  # canonical, metres
    normals: Float[Array, "n 3"]
    base: Float[Array, "n 3"]  # paper color, [0, 1]
    cone: ViewCone


class Distilled(NamedTuple):
    """How the file shows view dependence; parts that the default view does not need are None."""

    network: ViewNetwork | None
    linear: Float[Array, "features 3 3"] | None
    default_view: Literal["network", "linear", "off"]
    features: Callable[[SurfacePoints], UInt8[Array, "n features"]] | None
    # each mode against the cone field, on samples kept out of training
    decibels: dict[str, float]
    # why this is the default
    reason: str = ""

    def residual(self, features: UInt8[Array, "n features"], tangent: Float[Array, "n 3"]) -> Array:
        """What the default view adds to the base color of points with these features, at t' (n, 3); sRGB."""
        unit = features / 255.0
        if self.network is not None:
            return network_residual(self.network, unit, tangent)
        assert self.linear is not None
        return linear_residual(self.linear, unit, tangent)


class FeatureEncoder(nn.Module):
    """Surface point -> four features in [0, 1], rounded to 1/255 with the gradient passed straight through.

    The encoder ties texels together, so that a few hundred thousand teacher colors are enough for a million
    texels; it is thrown away after its output is stored. Position enters as sines of up to 2^5 periods per
    2 m (about 6 cm): a residual of the view varies no faster.
    """

    def __init__(self):
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(3 + 6 * OCTAVES + 9, 48), nn.ReLU(), nn.Linear(48, 48), nn.ReLU(), nn.Linear(48, 4)
        )

    def inputs(self, surface: SurfacePoints) -> Float[torch.Tensor, "n inputs"]:
        """What the layers are given of points of the surface."""
        columns = [surface.points, surface.normals, surface.base, surface.cone.direction]
        plain = torch.from_numpy(np.concatenate(columns, 1).astype(np.float32))
        waves = [f(plain[:, :3] * (torch.pi * 2**k)) for k in range(OCTAVES) for f in (torch.sin, torch.cos)]
        return torch.cat([plain, *waves], 1)

    def forward(self, inputs: Float[torch.Tensor, "n inputs"]) -> Float[torch.Tensor, "n features"]:
        value = torch.sigmoid(self.layers(inputs))
        return value + (torch.round(value * 255) / 255 - value).detach()


def sampled_directions(cone: ViewCone, rng: np.random.Generator) -> Array:
    """Unit directions: most distributed as training saw them, the rest over the whole sphere."""
    n = len(cone.direction)
    first, second = tangent_frame(cone.direction)
    frame = np.stack([first, second], 1)
    flat = frame @ matrix_from_six(cone.metric) @ frame.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(flat)
    # Q = 1 / (1.6^2 variance): back to the standard deviation along each axis
    spread = 1.0 / (1.6 * np.sqrt(np.maximum(values, 0.15)))
    along = rng.normal(size=(n, 2)) * spread
    tangent = np.einsum("nk,nik,nij->nj", along, vectors, frame)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1.0)
    observed = tangent + cone.direction * np.sqrt(np.maximum(1 - (tangent**2).sum(1, keepdims=True), 0))
    anywhere = rng.normal(size=(n, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    return np.where(rng.random((n, 1)) < OBSERVED, observed, anywhere)


def network_inputs(features: Float[Array, "n features"], tangent: Float[Array, "n 3"]) -> Float[Array, "n inputs"]:
    """x = [features / 255, t', |t'|] from features in [0, 1]."""
    return np.concatenate([features, tangent, np.linalg.norm(tangent, axis=1, keepdims=True)], 1)


def network_residual(
    network: ViewNetwork, features: Float[Array, "n features"], tangent: Float[Array, "n 3"]
) -> Float[Array, "n 3"]:
    """A |t'| y / (1 + |y|) in float64: the reference of the shader."""
    x = network_inputs(features, tangent)
    w1, b1, w2, b2 = (np.asarray(values, np.float64) for values in vars(network).values())
    y = np.maximum(x @ w1.T + b1, 0) @ w2.T + b2
    return AMPLITUDE * x[:, -1:] * y / (1 + np.abs(y))


def linear_residual(
    linear: Float[Array, "features 3 3"], features: Float[Array, "n features"], tangent: Float[Array, "n 3"]
) -> Float[Array, "n 3"]:
    return np.einsum("nf,fij,nj->ni", features, linear, tangent)


def fit_linear(
    features: Float[Array, "n features"], tangent: Float[Array, "n 3"], residual: Float[Array, "n 3"]
) -> Float[Array, "features 3 3"]:
    """Least squares of residual = (sum f_i M_i) t', lightly damped: features may be nearly equal."""
    size = 3 * features.shape[1]
    design = (features[:, :, None] * tangent[:, None, :]).reshape(len(features), size)
    gram = design.T @ design
    solution = np.linalg.solve(gram + (1e-6 * np.trace(gram) + 1e-12) * np.eye(size), design.T @ residual)
    return solution.reshape(-1, 3, 3).transpose(0, 2, 1)


def distil(
    color: ColorFunction, surface: SurfacePoints, *, seed: int = 0, steps: int = 1200,
    report: Callable[[str], None] = lambda line: None,
) -> Distilled:  # fmt: skip
    """Features, network and linear residual for the cone field color(points, directions).

    One eighth of the surface points is kept out and scores the modes. When the field's own view dependence inside the
    cone is below what can be seen, or nothing beats the paper's color, nothing is shipped and the view is "off".
    """
    rng = np.random.default_rng(seed)
    usable = np.flatnonzero(surface.cone.seen > 0.02)
    if len(usable) < 64:
        return Distilled(None, None, "off", None, {"off": float("inf")}, "no camera saw the surface often enough")
    points, normals, base = (values[usable] for values in (surface.points, surface.normals, surface.base))
    surface = SurfacePoints(points, normals, base, surface.cone.of(usable))
    direction = sampled_directions(surface.cone, rng)
    tangent = clamped_tangent(direction, surface.cone)
    paper = color(surface.points, surface.cone.direction)
    residual = color(surface.points, cone_direction(tangent, surface.cone)) - paper
    kept = rng.random(len(usable)) < 0.125
    score = lambda left: decibels(float(np.mean(np.square(left))))
    scores = {"off": score(residual[kept])}
    report(f"cone field against its paper mode: {scores['off']:.1f} dB")
    if scores["off"] >= INVISIBLE_DB:
        reason = f"within the cone the field is {scores['off']:.1f} dB near its own paper mode: nothing to be seen"
        return Distilled(None, None, "off", None, scores, reason)

    encoder, linears = trained(ResidualSamples(surface, tangent, residual, kept), rng=rng, seed=seed, steps=steps)

    def features_of(points: SurfacePoints) -> UInt8[Array, "n features"]:
        with torch.no_grad():
            chunks = encoder.inputs(points).split(1 << 16)
            return np.concatenate([torch.round(encoder(chunk) * 255).to(torch.uint8).numpy() for chunk in chunks])

    network = ViewNetwork(*(p.detach().numpy().copy() for one in linears for p in (one.weight, one.bias)))
    features = features_of(surface) / 255.0
    linear = fit_linear(features[~kept], tangent[~kept], residual[~kept])
    held = features[kept], tangent[kept]
    scores["linear"] = score(linear_residual(linear, *held) - residual[kept])
    scores["network"] = score(network_residual(network, *held) - residual[kept])
    report(f"linear {scores['linear']:.1f} dB, network {scores['network']:.1f} dB on samples kept out")
    return choose(scores, network, linear, features_of)


class ResidualSamples(NamedTuple):
    """What the network is trained on: the cone field's residual at points of the surface."""

    surface: SurfacePoints
    tangent: Float[Array, "n 3"]  # t'
    residual: Float[Array, "n 3"]
    kept: Bool[Array, "n"]  # kept out of training


def trained(
    samples: ResidualSamples, *, rng: np.random.Generator, seed: int, steps: int
) -> tuple[FeatureEncoder, list[nn.Linear]]:
    """The encoder of the features and the layers of the network, fitted together with a linear residual."""
    torch.manual_seed(seed)
    encoder = FeatureEncoder()
    linears = [nn.Linear(8, 16), nn.Linear(16, 3)]
    layers = nn.Sequential(linears[0], nn.ReLU(), linears[1])
    matrices = nn.Parameter(torch.zeros(4, 3, 3))
    inputs = encoder.inputs(samples.surface)
    tangents = torch.from_numpy(samples.tangent.astype(np.float32))
    targets = torch.from_numpy(samples.residual.astype(np.float32))
    bases = torch.from_numpy(samples.surface.base.astype(np.float32))
    train = np.flatnonzero(~samples.kept)
    parameters = [*encoder.parameters(), *layers.parameters(), matrices]
    moments = [(torch.zeros_like(one), torch.zeros_like(one)) for one in parameters]
    for step in range(steps):
        pick = torch.from_numpy(rng.choice(train, min(BATCH, len(train))))
        features, t = encoder(inputs[pick]), tangents[pick]
        size = t.norm(dim=1, keepdim=True)
        y = layers(torch.cat([features, t, size], 1))
        wanted = (bases[pick] + targets[pick]).clamp(0, 1)
        by_network = bases[pick] + AMPLITUDE * size * y / (1 + y.abs())
        by_matrix = bases[pick] + torch.einsum("nf,fij,nj->ni", features, matrices, t)
        loss = (by_network - wanted).abs().mean() + 0.5 * (by_matrix - wanted).abs().mean()
        loss = loss + 3 * (by_network - wanted).square().mean() + (by_matrix - wanted).square().mean()
        adam(parameters, torch.autograd.grad(loss, parameters), moments, step, one_cycle(step / steps))
    return encoder, linears


def adam(
    parameters: Sequence[torch.Tensor], gradients: Sequence[torch.Tensor],
    moments: Sequence[tuple[torch.Tensor, torch.Tensor]], step: int, rate: float,
) -> None:  # fmt: skip
    """A step of Adam (Kingma and Ba 2015), in place. torch.optim imports triton, which takes seconds, and whose LLVM
    crashes a process that Mesa's was loaded into first."""
    fading = [1 - beta ** (step + 1) for beta in BETAS]
    with torch.no_grad():
        for value, gradient, (first, second) in zip(parameters, gradients, moments):
            first.lerp_(gradient, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1 - BETAS[1])
            value.addcdiv_(first, (second / fading[1]).sqrt_().add_(1e-8), value=-rate / fading[0])


def one_cycle(at: float) -> float:
    """The learning rate at a share of the steps: up along a cosine for three tenths, then down to nothing."""
    rises = at < WARM_UP
    share = at / WARM_UP if rises else (1 - at) / (1 - WARM_UP)
    low = RATE / 25 if rises else 0.0
    return low + (RATE - low) * 0.5 * (1 - math.cos(math.pi * share))


def choose(
    scores: dict[str, float], network: ViewNetwork, linear: Float[Array, "features 3 3"],
    features: Callable[[SurfacePoints], UInt8[Array, "n features"]],
) -> Distilled:  # fmt: skip
    """The simplest mode that is not GAIN_DB worse than a richer one; what is not worth it is not in the file."""
    scores_text = ", ".join(f"{mode} {scores[mode]:.1f} dB" for mode in ("network", "linear", "off"))
    reason = f"against the cone field on samples kept out: {scores_text}; a richer mode must gain {GAIN_DB} dB"
    if scores["network"] >= max(scores["linear"], scores["off"]) + GAIN_DB:
        return Distilled(network, linear.astype(np.float32), "network", features, scores, reason)
    if scores["linear"] >= scores["off"] + GAIN_DB:
        return Distilled(None, linear.astype(np.float32), "linear", features, scores, reason)
    return Distilled(None, None, "off", None, scores, reason)


def write_onnx(path: Path, network: ViewNetwork) -> None:
    """The network alone, x (n, 8) -> y (n, 3), for ONNX Runtime: the reference the shader is tested against."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    nodes = [
        helper.make_node("Gemm", ["x", "w1", "b1"], ["z1"], transB=1),
        helper.make_node("Relu", ["z1"], ["h1"]),
        helper.make_node("Gemm", ["h1", "w2", "b2"], ["y"], transB=1),
    ]
    graph = helper.make_graph(
        nodes, "view_network", [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["n", 8])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["n", 3])],
        [numpy_helper.from_array(np.asarray(value, np.float32), name) for name, value in vars(network).items()],
    )  # fmt: skip
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8, producer_name="selfscan"
    )
    onnx.checker.check_model(model)
    with whole_file(path) as file:
        file.write(model.SerializeToString(deterministic=True))
